"""One motion as plain numbers: what pictures of it are drawn from.

Everything is evaluated in one program and handed over as NumPy arrays in double
precision, so that drawing never meets JAX's rules of shapes and dtypes.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .checks import FieldError
from .observables import energy
from .rolling import contact_force, contact_of
from .rotations import quaternion_of
from .scene import Scene
from .small_linear import cross, matvec, norm
from .trajectory import Trajectory

_SIZES = {
    "position": 3,
    "orientation": 4,
    "angular_velocity": 3,
    "velocity": 3,
    "contact_on_base": 3,
    "contact_on_body": 3,
    "outward": 3,
    "body_outward": 3,
    "contact_force": 3,
    "energy": 1,
    "base_origin": 3,
    "base_rotation": 9,
}


class History(NamedTuple):
    """A motion at T times; rows that the run did not reach are NaN.

    Attributes:
        time: [s], shape (T,).
        position: Body origin [m], fixed axes, shape (T, 3).
        orientation: Unit quaternion, scalar first, body to fixed [1], shape (T, 4).
        angular_velocity: [rad/s], fixed axes, shape (T, 3).
        velocity: Of the body origin [m/s], fixed axes, shape (T, 3).
        contact_on_base: [m], base axes, shape (T, 3).
        contact_on_body: [m], body axes, shape (T, 3).
        outward: Unit normal out of the base at the contact [1], fixed axes, (T, 3).
        body_outward: Unit normal out of the body there [1], body axes, shape (T, 3).
        contact_force: On the body [N], fixed axes, shape (T, 3).
        energy: [J], shape (T,).
        base_origin: Of the base's axes [m], fixed axes, shape (T, 3).
        base_rotation: Base to fixed axes [1], shape (T, 3, 3).
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
    body_outward: np.ndarray
    contact_force: np.ndarray
    energy: np.ndarray
    base_origin: np.ndarray
    base_rotation: np.ndarray
    rounding: float

    @property
    def reached(self) -> np.ndarray:
        """Which rows hold a state, shape (T,)."""
        motion = np.concatenate([self.position, self.orientation], axis=1)
        return np.isfinite(motion).all(axis=1) & np.isfinite(self.time)

    @property
    def spin(self) -> np.ndarray:
        """Angular velocity along the base's outward normal [rad/s], shape (T,)."""
        return np.sum(self.angular_velocity * self.outward, axis=1)

    @property
    def normal_force(self) -> np.ndarray:
        """Contact force along the base's outward normal [N], shape (T,)."""
        return np.sum(self.contact_force * self.outward, axis=1)

    @property
    def energy_error(self) -> np.ndarray:
        """``|E - E0| / |E0|`` [1], shape (T,); of the largest |E| where E0 is 0."""
        known = self.energy[np.isfinite(self.energy)]
        if not known.size:
            return np.full_like(self.energy, np.nan)
        scale = abs(known[0]) or np.max(np.abs(known)) or 1.0
        return np.abs(self.energy - known[0]) / scale

    def rows(self, which: np.ndarray) -> "History":
        """The same motion at some of its times only.

        Args:
            which: Row numbers, or one truth value per row.
        """
        columns = {name: self._asdict()[name][which] for name in self._fields[:-1]}
        return self._replace(**columns)


def history(trajectory: Trajectory) -> History:
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
    ends = np.cumsum(list(_SIZES.values()))[:-1]
    columns = dict(zip(_SIZES, np.split(rows, ends, axis=1), strict=True))
    columns["energy"] = columns["energy"][:, 0]
    columns["base_rotation"] = columns["base_rotation"].reshape(-1, 3, 3)
    # of a state without a quaternion the sign is open
    columns["orientation"] = np.asarray(trajectory.orientation, dtype=float)
    return History(
        time=np.asarray(trajectory.time, dtype=float),
        **columns,
        rounding=float(jnp.finfo(trajectory.time.dtype).eps),
    )


def _row(scene: Scene, t: Array, state: Any) -> Float[Array, " n"]:
    """All quantities of one state in the order of ``_SIZES``."""
    contact = contact_of(scene, t, state)
    rotation = contact.rotation
    spin = matvec(rotation, contact.angular_velocity)
    arm = matvec(rotation, contact.body_point)
    quaternion = contact.orientation
    if quaternion is None:
        quaternion = quaternion_of(rotation)
    velocity = cross(arm, spin)  # no slip: the point at the contact moves with the base
    if contact.base_velocity is not None:
        velocity = velocity + matvec(rotation, contact.base_velocity)
    still, level = jnp.zeros_like(arm), jnp.eye(3, dtype=arm.dtype)
    base = contact.base
    base_origin = still if base is None else base.placed(still)
    turned = None if base is None else base.rotation
    return jnp.concatenate(
        [
            contact.position,
            quaternion / norm(quaternion),
            spin,
            velocity,
            contact.base_point,
            contact.body_point,
            -matvec(rotation, contact.normal),
            contact.normal,
            contact_force(scene, t, state),
            energy(scene, t, state)[None],
            base_origin,
            (level if turned is None else turned).reshape(9),
        ]
    )
