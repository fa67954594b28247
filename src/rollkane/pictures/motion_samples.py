"""One motion as plain numbers: what pictures of it are drawn from.

Everything is evaluated in one program and handed over as NumPy arrays in double
precision, so that drawing never meets JAX's rules of shapes and dtypes.
"""

from typing import Any, NamedTuple, cast

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..dynamics.abstract_supported import AbstractRollingPart, rolling_parts
from ..dynamics.carried import Pairing
from ..dynamics.observables import (
    energy,
    kept_energy,
    moving_energy,
    velocity_of_origin,
)
from ..dynamics.rolling import contact_force, contact_of
from ..dynamics.rolling_body_observables import (
    force_on,
    motion_of,
    paths_of_rolling,
)
from ..dynamics.scene import Scene
from ..dynamics.supported import SupportedBody
from ..geometry.numpy_rotations import rotated
from ..geometry.rotations import in_one_sense, quaternion_of
from ..geometry.small_linear import dot, matvec, norm
from ..kinematics.base_motion import BaseKinematics
from ..simulation.trajectory import Trajectory
from ..validation.checks import FieldError

_SIZES = {
    "position": 3,
    "orientation": 4,
    "angular_velocity": 3,
    "velocity": 3,
    "contact_on_base": 3,
    "contact_on_body": 3,
    "outward": 3,
    "base_outward": 3,
    "body_outward": 3,
    "contact_force": 3,
    "energy": 1,
    "moving_energy": 1,
    "base_origin": 3,
    "base_orientation": 4,
    "base_velocity": 3,
    "base_angular_velocity": 3,
}

_ROLLING = {
    "position": 3,
    "velocity": 3,
    "orientation": 4,
    "angular_velocity": 3,
    "contact_on_body": 3,
    "body_outward": 3,
    "contact_on_carrier": 3,
    "carrier_outward": 3,
    "normal_force": 1,
}


class MotionSamples(NamedTuple):
    """A motion at T times; rows that the run did not reach are NaN.

    Attributes:
        time: [s], shape (T,).
        position: Body origin [m], fixed axes, shape (T, 3).
        orientation: Unit quaternion, scalar first, body to fixed [1], shape (T, 4).
        angular_velocity: [rad/s], fixed axes, shape (T, 3).
        velocity: Of the body origin [m/s], fixed axes, shape (T, 3).
        contact_on_base: [m], base axes, shape (T, 3); in flight the body's origin.
        contact_on_body: [m], body axes, shape (T, 3); in flight 0, its origin.
        outward: Unit normal out of the base at the contact [1], fixed axes, (T, 3); of
            no length in flight, as are the two below.
        base_outward: The same on base axes [1], shape (T, 3).
        body_outward: Unit normal out of the body there [1], body axes, shape (T, 3).
        contact_force: On the body [N], fixed axes, shape (T, 3).
        energy: Kinetic plus potential energy [J], shape (T,).
        moving_energy: ``E - v_Oc . P - w_c . J_Oc`` [J], shape (T,).
        base_origin: Of the base's axes [m], fixed axes, shape (T, 3).
        base_orientation: Unit quaternion, base to fixed axes [1], shape (T, 4).
        base_velocity: Of the base's origin [m/s], fixed axes, shape (T, 3).
        base_angular_velocity: [rad/s], fixed axes, shape (T, 3).
        alpha: Coordinates of what is carried, shape (T, n).
        carried: Where carried masses are [m], body axes, shape (T, k, 3); a rigid body
            is six masses on its own axes, with its moments of inertia.
        masses: Of each of them [kg], shape (k,).
        things: Of which mass or rigid body it is, counted from 0, shape (k,).
        rolling: Of each body that rolls on or in the body, in the order of its path:
            position, velocity, orientation and angular velocity, fixed axes, contact
            point on it and normal out of it, its own axes, the same of its carrier's
            surface, and the normal force, shape (T, b, 26); ``rolling_column`` takes
            them apart.
        base_moves: Whether the base moves.
        kept: What the motion has to keep: "energy", "moving energy", or "" where the
            base or forces inside do work.
        rounding: Spacing of the run's own numbers at 1 [1].
    """

    time: np.ndarray
    position: np.ndarray
    orientation: np.ndarray
    angular_velocity: np.ndarray
    velocity: np.ndarray
    contact_on_base: np.ndarray
    contact_on_body: np.ndarray
    outward: np.ndarray
    base_outward: np.ndarray
    body_outward: np.ndarray
    contact_force: np.ndarray
    energy: np.ndarray
    moving_energy: np.ndarray
    base_origin: np.ndarray
    base_orientation: np.ndarray
    base_velocity: np.ndarray
    base_angular_velocity: np.ndarray
    alpha: np.ndarray
    carried: np.ndarray
    rolling: np.ndarray
    masses: np.ndarray
    things: np.ndarray
    base_moves: bool
    kept: str
    rounding: float

    @property
    def reached(self) -> np.ndarray:
        """Which rows hold a state, shape (T,)."""
        motion = np.concatenate([self.position, self.orientation], axis=1)
        return np.isfinite(motion).all(axis=1) & np.isfinite(self.time)

    @property
    def touches(self) -> np.ndarray:
        """Which rows hold a contact, shape (T,): all but those in flight."""
        return self.reached & self.outward.any(axis=1)

    @property
    def spin(self) -> np.ndarray:
        """Angular velocity along the base's outward normal [rad/s], shape (T,).

        NaN in flight, where there is no normal.
        """
        along = np.sum(self.angular_velocity * self.outward, axis=1)
        return np.where(self.touches, along, np.nan)

    @property
    def contact(self) -> np.ndarray:
        """Contact point [m], FIXED axes, shape (T, 3)."""
        return self.base_origin + rotated(self.base_orientation, self.contact_on_base)

    @property
    def normal_force(self) -> np.ndarray:
        """Contact force along the base's outward normal [N], (T,); 0 in flight."""
        return np.sum(self.contact_force * self.outward, axis=1)

    @property
    def energy_error(self) -> np.ndarray:
        """``|E - E0| / |E0|`` [1], shape (T,); of the largest |E| where E0 is 0.

        E is what the motion has to keep; where it keeps neither energy, NaN.
        """
        value = self.moving_energy if self.kept == "moving energy" else self.energy
        known = value[np.isfinite(value)]
        if not known.size or not self.kept:
            return np.full_like(value, np.nan)
        scale = abs(known[0]) or np.max(np.abs(known)) or 1.0
        return np.abs(value - known[0]) / scale

    def rolling_column(self, k: int, name: str) -> np.ndarray:
        """A column of the k-th rolling body, shape (T, n)."""
        first = 0
        for column, size in _ROLLING.items():
            if column == name:
                return self.rolling[:, k, first : first + size]
            first += size
        raise KeyError(name)

    @property
    def carried_centers(self) -> np.ndarray:
        """Mass centres of carried masses and rigid bodies [m], body axes, (T, c, 3)."""
        points = np.bincount(self.things)
        share = np.eye(points.size)[self.things] / points
        return np.einsum("tki,kc->tci", self.carried, share)

    @property
    def columns(self) -> dict[str, np.ndarray]:
        """What has a row for each time, by name."""
        whole = ("masses", "things", "base_moves", "kept", "rounding")
        return {k: v for k, v in self._asdict().items() if k not in whole}

    def rows(self, which: np.ndarray) -> "MotionSamples":
        """The same motion at some of its times only.

        Args:
            which: Row numbers, or one truth value per row.
        """
        return self._replace(**{k: v[which] for k, v in self.columns.items()})


def motion_samples(trajectory: Trajectory) -> MotionSamples:
    """Evaluate a single trajectory for drawing.

    Args:
        trajectory: One run, not a batch.

    Raises:
        FieldError: a batch.
    """
    if trajectory.time.ndim != 1 or trajectory.state.angular_velocity.ndim != 2:
        raise FieldError(
            "trajectory",
            trajectory.state.angular_velocity.shape[:-2],
            "is a batch, and one picture shows one run",
            "draw one lane: jax.tree.map(lambda x: x[i], trajectory)",
        )
    rows = np.asarray(trajectory.each(_row), dtype=float)
    scene = trajectory.scene
    bodies = sum(_ROLLING.values()) * len(list(paths_of_rolling(scene)))
    ends = np.cumsum([*_SIZES.values(), bodies])
    *pieces, rolling, carried = np.split(rows, ends, axis=1)
    columns = dict(zip(_SIZES, pieces, strict=True))
    for name in ("energy", "moving_energy"):
        columns[name] = columns[name][:, 0]
    # of a state without a quaternion, and of a base, the sign is open
    columns["orientation"] = np.asarray(trajectory.orientation, dtype=float)
    turned = jnp.asarray(columns["base_orientation"])
    columns["base_orientation"] = np.asarray(in_one_sense(turned))
    masses = _masses(scene)
    return MotionSamples(
        time=np.asarray(trajectory.time, dtype=float),
        **columns,
        alpha=np.asarray(trajectory.alpha, dtype=float),
        carried=carried.reshape(len(rows), -1, 3),
        rolling=rolling.reshape(len(rows), -1, sum(_ROLLING.values())),
        masses=np.concatenate([np.zeros(0), *masses]),
        things=np.repeat(np.arange(len(masses)), [x.size for x in masses]),
        base_moves=scene.base.motion is not None,
        kept=kept_energy(scene),
        rounding=float(cast(float, jnp.finfo(trajectory.time.dtype).eps)),
    )


def reached_samples(trajectory: Trajectory) -> tuple[MotionSamples, np.ndarray]:
    """What a run reached, for drawing.

    Args:
        trajectory: One run, not a batch.

    Returns:
        The samples, and their row numbers among the outputs, shape (T,), T > 0.

    Raises:
        FieldError: a batch, or a run of which no state is finite.
    """
    motion = motion_samples(trajectory)
    rows = np.flatnonzero(motion.reached)
    if not rows.size:
        problem = "holds no state that could be shown"
        remedy = "repair the start"
        raise FieldError("trajectory", trajectory.reason, problem, remedy)
    return motion.rows(rows), rows


def spans(flags: np.ndarray) -> list[tuple[int, int]]:
    """First and last rows of each run of true values."""
    edges = np.diff(np.concatenate([[0], flags.astype(int), [0]]))
    starts, ends = np.nonzero(edges == 1)[0], np.nonzero(edges == -1)[0] - 1
    return list(zip(starts.tolist(), ends.tolist(), strict=True))


def _row(scene: Scene, t: Array, state: Any) -> Float[Array, " n"]:
    """All quantities of one state in the order of ``_SIZES``, then what is carried."""
    contact = contact_of(scene, t, state)
    rotation = contact.rotation
    spin = matvec(rotation, contact.angular_velocity)
    arm = matvec(rotation, contact.body_point)
    quaternion = contact.orientation
    if quaternion is None:
        quaternion = quaternion_of(rotation)
    return jnp.concatenate(
        [
            contact.position,
            quaternion / norm(quaternion),
            spin,
            velocity_of_origin(contact),
            contact.base_point,
            contact.body_point,
            -matvec(rotation, contact.normal),
            -matvec(contact.to_base, contact.normal),
            contact.normal,
            contact_force(scene, t, state),
            energy(scene, t, state)[None],
            moving_energy(scene, t, state)[None],
            *_base_row(contact.base, arm),
            *_rolling_rows(scene, t, state),
            *_carried_rows(scene, t, state),
        ]
    )


def _base_row(base: BaseKinematics | None, like: Array) -> list[Array]:
    """Pose and velocities of the base, fixed axes."""
    still = jnp.zeros_like(like)
    straight = jnp.concatenate([jnp.ones_like(still[:1]), still])
    if base is None:
        return [still, straight, still, still]
    turn, glide = base.angular_velocity, base.velocity
    return [
        base.placed(still),
        straight if base.rotation is None else quaternion_of(base.rotation),
        still if glide is None else glide,
        still if turn is None else base.to_fixed(turn),
    ]


def _carried_rows(scene: Scene, t: Array, state: Any) -> list[Array]:
    """Places of carried masses on body axes, one after the other."""
    rows: list[Array] = []
    for supported, alpha, rates in scene.shares(state):
        part = supported.carried(t, alpha, rates)
        places = part.place.T
        if part.pairing is not None:
            places = places[_points_beside(part.pairing)]
        elif part.turnings:
            (turning,) = part.turnings
            spread = _spread(cast(SupportedBody, supported.part))
            arms = spread[:, None] * turning.rotation.T
            places = jnp.concatenate([places + arms, places - arms])
        rows.append(places.reshape(-1))
    return rows


def _points_beside(pairing: Pairing) -> np.ndarray:
    """Which masses that move with a rolling body are no rolling bodies themselves."""

    def bodies(pairing: Pairing, first: int) -> list[int]:
        inner = zip(pairing.inner, pairing.first_of_inner, strict=True)
        return [first, *(k for own, at in inner for k in bodies(own, first + at))]

    return np.setdiff1d(np.arange(pairing.masses), bodies(pairing, 0))


def _rolling_rows(scene: Scene, t: Array, state: Any) -> list[Array]:
    """Columns of ``_ROLLING`` of each rolling body, one after the other."""
    rows: list[Array] = []
    for path in paths_of_rolling(scene):
        seen = motion_of(scene, t, state, path)
        press = -dot(force_on(scene, t, state, path), seen.outward)
        columns = seen._asdict() | {"normal_force": press[None]}
        rows += [columns[name] for name in _ROLLING]
    return rows


def _spread(part: SupportedBody) -> Float[Array, "3"]:
    """Distances of six equal masses on its axes that have a body's moments [m]."""
    moments = jnp.stack([part.inertia[i, i] for i in range(3)])
    across = jnp.sum(moments) - 2.0 * moments
    return jnp.sqrt(jnp.maximum(1.5 * across / part.mass, 0.0))


def _masses(scene: Scene) -> list[np.ndarray]:
    """Masses of the points of ``_carried_rows`` [kg], of each mass and rigid body."""
    masses: list[np.ndarray] = []
    for supported in scene.supported:
        if isinstance(supported, AbstractRollingPart):
            continue
        own: Any = supported.part
        mass = np.asarray(own.mass, dtype=float)
        if isinstance(own, SupportedBody):
            masses.append(np.full(6, mass / 6))
        else:
            masses += np.split(mass, mass.size)
    for part in rolling_parts(scene.supported):
        beside = _masses_beside(part.scene)
        masses += np.split(beside, beside.size) if beside.size else []
    return masses


def _masses_beside(scene: Scene) -> np.ndarray:
    """Of what a rolling body carries, as ``_points_beside`` has it [kg]."""
    masses: list[np.ndarray] = []
    for supported in scene.supported:
        if not isinstance(supported, AbstractRollingPart):
            own: Any = supported.part
            masses.append(np.atleast_1d(np.asarray(own.mass, dtype=float)))
    masses += [_masses_beside(part.scene) for part in rolling_parts(scene.supported)]
    return np.concatenate([np.zeros(0), *masses])
