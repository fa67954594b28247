"""Independent coordinates of the states that a contact allows, around one of them.

A state has more numbers than the constrained motion: lengths that do not matter, a
normal that has to meet another, a spin or a slip that the contact leaves out. Around a
reference state these are exact coordinates of what is left: n of positions and n' of
velocities.
"""

from typing import Any, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..codegen.compile_effort import for_one_call
from ..dynamics.abstract_supported import refuse_rolling_parts
from ..dynamics.consistency import consistent
from ..dynamics.rolling import contact_of
from ..dynamics.scene import Scene, require_scene
from ..geometry.rotations import multiply, tangent_pair
from ..geometry.small_linear import dot, inverse_sqrt
from ..geometry.surfaces import AbstractSurface
from ..kinematics.coordinates import SlidingState, State, shared_parts
from ..validation.checks import FieldError

# below this share of the largest singular value a direction is no direction: the
# square root of the rounding, as of any rank decision with columns of unit length
_RANK = {8: 1e-8, 4: 1e-4}
# Parts of the coordinates that are velocities.
VELOCITIES = "angular velocity", "alpha rate", "slip"


class IndependentCoordinates(eqx.Module):
    """Coordinates x, shape (n,), of the states around a reference, which is x = 0.

    Attributes:
        scene: What rolls on what.
        time: At which the base is where it is [s].
        reference: A state, rolling or slipping, that the contact allows.

    In their order, positions first: a rotation vector on body axes [rad] (three; the
    turn about the normal alone where the body has explicit contact coordinates), local
    coordinates of the contact point on the base (two), on the body (two, where it has
    them), alpha; then the angular velocity on body axes [rad/s] (three, or two along
    the surface under ``RubberRolling``), alpha', and the slip along the surface [m/s]
    (two, where it slips).
    """

    scene: Scene
    time: Float[Array, ""]
    reference: State

    @property
    def sizes(self) -> dict[str, int]:
        """How many coordinates each part of the state has, in order."""
        own = self.scene.has_contact_coordinates
        rubber = self.scene.contact.without_spin and not self.reference.slips
        count = self.reference.alpha.shape[0]
        return {
            "turn": 1 if own else 3,
            "contact on base": 2,
            "contact on body": 2 if own else 0,
            "alpha": count,
            "angular velocity": 2 if rubber else 3,
            "alpha rate": count,
            "slip": 2 if self.reference.slips else 0,
        }

    @property
    def count(self) -> int:
        """Number n of positions and velocities together."""
        return sum(self.sizes.values())

    @property
    def names(self) -> tuple[str, ...]:
        """A name for each coordinate."""
        axes = {3: ("x", "y", "z"), 2: ("1", "2"), 1: ("about the normal",)}
        found: list[str] = []
        for part, size in self.sizes.items():
            if part in ("alpha", "alpha rate"):
                found += [f"{part}[{k}]" for k in range(size)]
            elif size:
                found += [f"{part} {axis}" for axis in axes[size]]
        return tuple(found)

    def state(self, x: Float[Array, " n"]) -> State:
        """The state at coordinates x: allowed by the contact to rounding."""
        scene, y = self.scene, self.reference
        parts = self._split(x)
        contact = contact_of(scene, self.time, y)
        normal = contact.normal
        turn = parts["turn"]
        if turn.shape[0] == 1:
            turn = turn[0] * normal
        on_body = y.contact_on_body
        if on_body.shape[0]:
            body = scene.body.surface
            on_body = body.neighbour(on_body, parts["contact on body"])
        w = parts["angular velocity"]
        if w.shape[0] == 2:
            w = _along(w, tangent_pair(normal))
        moved = State(
            orientation=multiply(y.orientation, rotation_of(turn)),
            angular_velocity=y.angular_velocity + w,
            contact_on_base=scene.base.surface.neighbour(
                y.contact_on_base, parts["contact on base"]
            ),
            contact_on_body=on_body,
            alpha=y.alpha + parts["alpha"],
            alpha_dot=y.alpha_dot + parts["alpha rate"],
        )
        if isinstance(y, SlidingState):
            out = contact.rotation @ normal
            slip = y.slip + _along(parts["slip"], tangent_pair(out))
            moved = SlidingState(**shared_parts(moved), slip=slip)
        return cast(State, consistent(scene, self.time, moved))

    def _split(self, x: Float[Array, " n"]) -> dict[str, Array]:
        parts: dict[str, Array] = {}
        first = 0
        for part, size in self.sizes.items():
            parts[part] = x[first : first + size]
            first += size
        return parts

    def image(self, state: State) -> Float[Array, " m"]:
        """What tells states apart, and nothing else of them: shape (m,), m >= n.

        Unit quaternion of the sign of the reference, points and normals in place of
        contact coordinates, and all other numbers as they are: no length that does not
        matter is in it.
        """
        q = state.orientation
        sign = jnp.where(dot(q, self.reference.orientation) < 0.0, -1.0, 1.0)
        sign = sign.astype(q.dtype)
        parts = [q * (sign * inverse_sqrt(dot(q, q)))]
        parts += _place(self.scene.base.surface, state.contact_on_base)
        if state.contact_on_body.shape[0]:
            parts += _place(self.scene.body.surface, state.contact_on_body)
        parts += [state.alpha, state.angular_velocity, state.alpha_dot]
        if isinstance(state, SlidingState):
            parts.append(state.slip)
        return jnp.concatenate(parts)

    def basis(self, x: Float[Array, " n"] | None = None) -> Float[Array, "m n"]:
        """Derivative of the image by the coordinates, at x or at the reference."""
        x = jnp.zeros(self.count, self.reference.orientation.dtype) if x is None else x

        def image(x: Array) -> Array:
            return self.image(self.state(x))

        return cast(Array, jax.jacfwd(image)(x))

    def coordinates(self, state: State) -> Float[Array, " n"]:
        """Coordinates of a state near the reference: the inverse to first order.

        Smooth, blind to lengths that do not matter and to the sign of a quaternion,
        zero at the reference, with the identity as its derivative there.
        """
        offset = self.image(state) - self.image(self.reference)
        return least_squares(self.basis(), offset)

    def velocity(self, x: Float[Array, " n"], rates: State) -> Float[Array, " n"]:
        """Rates of the coordinates from those of the state at x.

        Args:
            x: Coordinates.
            rates: Of every number of ``state(x)`` [its unit / s]. Of a base that turns,
                less those with which it carries the state along.
        """
        _, moved = jax.jvp(self.image, (self.state(x),), (rates,))
        return least_squares(self.basis(x), moved)


def independent_coordinates(
    scene: Scene, state: State, time: float = 0.0
) -> IndependentCoordinates:
    """Coordinates around a state, whose number is that of its rank.

    Args:
        scene: What rolls on what.
        state: Rolling or slipping, in pole-free coordinates.
        time: [s].

    Raises:
        FieldError: a state of another kind, or one where the coordinates are not
            independent: the end of a surface, the pole of a chart.
    """
    refuse_kind(scene, state)
    t = jnp.asarray(time, state.orientation.dtype)
    made = IndependentCoordinates(scene, t, cast(State, consistent(scene, t, state)))
    refuse_rank(np.asarray(_basis(made)))
    return made


def alike(around: IndependentCoordinates) -> np.ndarray:
    """Changes of the coordinates that are alike, velocities in one second, shape (n,).

    A radian; of a contact, what moves it by the body's length or turns the normal by a
    radian, whichever is less: none of it depends on the units of a scene.
    """
    scene, y = around.scene, around.reference
    length = body_length(scene)
    size: dict[str, Any] = {"slip": length}
    places = [("base", scene.base.surface, y.contact_on_base)]
    if scene.has_contact_coordinates:
        places.append(("body", scene.body.surface, y.contact_on_body))
    for owner, surface, u in places:
        size[f"contact on {owner}"] = _contact_size(surface, u, length)
    parts = [np.ones(k) * size.get(name, 1.0) for name, k in around.sizes.items()]
    return np.concatenate(parts)


def body_length(scene: Scene) -> float:
    """Radius of gyration of the body [m], for like lengths; 1 of one without any."""
    mass = float(scene.body.mass)
    moment = float(np.trace(np.asarray(scene.body.inertia)))
    if mass > 0.0 and moment > 0.0:
        return float(np.sqrt(moment / (2.0 * mass)))
    arm = float(np.linalg.norm(np.asarray(scene.body.center_of_mass)))
    return arm if arm > 0.0 else 1.0


def _contact_size(surface: AbstractSurface, u: Array, length: float) -> np.ndarray:
    if surface.is_flat:
        return np.full(2, length)
    slopes = np.asarray(_place_slopes(surface, u), float)
    moved, turned = np.linalg.norm(slopes.reshape(2, 3, 2), axis=1)
    far = moved / length + turned
    good = np.isfinite(far) & (far > 0.0)  # of a state without coordinates: refused
    return np.where(good, 1.0 / np.where(good, far, 1.0), 1.0)


@for_one_call
def _place_slopes(surface: AbstractSurface, u: Array) -> Float[Array, "6 2"]:
    """Derivatives of point and normal by the local coordinates."""

    def place(x: Array) -> Array:
        return jnp.concatenate(_place(surface, surface.neighbour(u, x)))

    return cast(Array, jax.jacfwd(place)(jnp.zeros(2, u.dtype)))


def refuse_kind(scene: Scene, state: Any) -> None:
    """Refuse a state that is in flight, in charts, or of another contact law.

    And a scene in which bodies roll on the rolling body: their coordinates are not
    here.
    """
    remedy = "give a Scene: only steady_motion and linearize take Kane systems"
    require_scene("scene", scene, remedy)
    refuse_rolling_parts("scene", scene.supported)
    wanted = SlidingState if scene.contact.slips else State
    if type(state) is not wanted:
        remedy = f"give a {wanted.__name__}, as rollkane.place makes it"
        raise FieldError("state", type(state).__name__, "is of another kind", remedy)


def refuse_rank(basis: np.ndarray) -> None:
    """Refuse a state where the coordinates are not independent."""
    found = rank(basis)
    if found < basis.shape[1]:
        problem = f"has fewer independent coordinates than {basis.shape[1]}"
        remedy = "move the contact off the end of the surface or the pole of its chart"
        raise FieldError("state", f"one of rank {found}", problem, remedy)


@for_one_call
def _basis(made: IndependentCoordinates) -> Array:
    return made.basis()


def rank(columns: np.ndarray) -> int:
    """Rank of a matrix whose columns are made of unit length; -1 of bad numbers."""
    if not np.all(np.isfinite(columns)):
        return -1
    size = np.linalg.norm(columns, axis=0)
    scaled = columns / np.where(size > 0.0, size, 1.0)
    values = np.linalg.svd(scaled, compute_uv=False)
    return int(np.sum(values > _RANK[columns.dtype.itemsize] * values[0]))


def rotation_of(vector: Float[Array, "3"]) -> Float[Array, "4"]:
    """Unit quaternion of a rotation vector [rad], smooth at zero."""
    square = 0.25 * dot(vector, vector)
    near = square < 1e-4  # the next term of the series is 2e-16 there
    safe = jnp.sqrt(jnp.where(near, 1.0, square))
    sine = 1.0 - square / 6.0 + square * square / 120.0
    cosine = 1.0 - square / 2.0 + square * square / 24.0 - square**3 / 720.0
    sine = jnp.where(near, sine, jnp.sin(safe) / safe)
    cosine = jnp.where(near, cosine, jnp.cos(safe))
    return jnp.concatenate([cosine[None], 0.5 * sine * vector])


def _along(
    parts: Float[Array, "2"], pair: tuple[Float[Array, "3"], Float[Array, "3"]]
) -> Float[Array, "3"]:
    return parts[0] * pair[0] + parts[1] * pair[1]


def _place(surface: AbstractSurface, u: Float[Array, " k"]) -> list[Array]:
    """Where a contact coordinate lies: point and normal."""
    if surface.is_flat:
        return [u]
    geometry = surface.geometry(u)
    return [geometry.position, geometry.normal]


def least_squares(
    columns: Float[Array, "m n"], target: Float[Array, " m"]
) -> Float[Array, " n"]:
    """By the normal equations of columns of unit length, far from singular."""
    size = jax.lax.stop_gradient(jnp.sqrt(jnp.sum(columns * columns, axis=0)))
    scaled = columns / size[None]
    square = scaled.T @ scaled
    return cast(Array, jnp.linalg.solve(square, scaled.T @ target)) / size
