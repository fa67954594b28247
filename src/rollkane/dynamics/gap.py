"""Bodies apart: the gap between body and base, and how it closes."""

from collections.abc import Callable
from typing import Any, TypeAlias, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ..codegen.compile_effort import for_one_call
from ..geometry.local_geometry import LocalGeometry
from ..geometry.rotations import rotation_matrix
from ..geometry.small_linear import (
    cross,
    dot,
    matmul,
    matvec,
    matvec_transposed,
    norm,
    solve_2x2,
)
from ..kinematics.coordinates import FlyingState, SlidingState, shared_parts
from ..validation.checks import real, refuse
from .bodies import Vector
from .clearance import flying_pose, lowest_places, may_touch_twice, reach_of
from .rolling import contact_of
from .scene import Scene

# Newton steps to the nearest points, most: their error squares each time
_NEWTON = 16
# Of the size of what is compared, where the search has ended: it ends no closer where
# rounding does not let it
_CLOSE = 64

# Coordinates of the nearest points on base and body.
_Places: TypeAlias = tuple[Array, Array]
# Steps taken, the points, and what was left before the last step [m].
_Search: TypeAlias = tuple[Int[Array, ""], _Places, Float[Array, ""]]


def nearest(
    scene: Scene, t: Float[Array, ""], state: FlyingState
) -> tuple[Float[Array, ""], FlyingState]:
    """Gap between the surfaces [m], and the state with their nearest points.

    Args:
        scene: What flies over what.
        t: Time [s].
        state: Its contact coordinates are where the search begins.

    The gap is the distance along the base's normal, less than zero in the base; NaN
    where the search did not converge. Where there are several nearest points, the ones
    next to the start are followed.
    """
    places, converged = _searched(*jax.lax.stop_gradient((scene, t, state)))
    gap, state = _nearest_from(scene, t, state, places)
    return jnp.where(converged, gap, jnp.nan), state


def _searched(
    scene: Scene, t: Float[Array, ""], state: FlyingState
) -> tuple[_Places, Bool[Array, ""]]:
    """The nearest points, and whether the search converged."""
    size = 1.0 + norm(state.position)
    close: Float[Array, ""] = _CLOSE * np.finfo(size.dtype).eps * size

    def going(carry: _Search) -> Bool[Array, ""]:
        count, _, left = carry
        return (count < _NEWTON) & (left > close)

    def improve(carry: _Search) -> _Search:
        count, places, _ = carry
        return count + 1, *_improved(scene, t, eqx.tree_at(_places, state, places))

    carry = jnp.asarray(0), _places(state), jnp.full_like(close, jnp.inf)
    _, found, left = jax.lax.while_loop(going, improve, carry)
    return found, left <= (1e-9 if close.dtype == jnp.float64 else 1e-4) * size


def _nearest_from(
    scene: Scene, t: Float[Array, ""], state: FlyingState, places: _Places
) -> tuple[Float[Array, ""], FlyingState]:
    """:func:`nearest` from points that are it, to which it gives their derivative.

    One step more of the search has it, by the implicit function.
    """
    found, _ = _improved(scene, t, eqx.tree_at(_places, state, places))
    state = eqx.tree_at(_places, state, found)
    return _apart(scene, t, state)[1], state


def nearest_anywhere(
    scene: Scene, t: Float[Array, ""], state: FlyingState
) -> tuple[Float[Array, ""], FlyingState]:
    """The same of the whole surfaces, where they may touch at several places.

    The search begins where samples of both surfaces are nearest
    (:func:`rollkane.dynamics.clearance.lowest_places`), wherever the state's
    coordinates are.
    """
    if not may_touch_twice(scene):
        return nearest(scene, t, state)
    fixed = jax.lax.stop_gradient((scene, t, state))
    gaps, starts = lowest_places(*fixed)
    base, body = fixed[0].base.surface, fixed[0].body.surface

    def begun(place: Float[Array, "3"]) -> FlyingState:
        on_body = fixed[2].contact_on_body
        if scene.has_contact_coordinates:
            on_body = body.locate(on_body_axes(*fixed, place))
        return eqx.tree_at(_places, fixed[2], (base.locate(place), on_body))

    def near(place: Float[Array, "3"]) -> tuple[Array, _Places]:
        gap, closest = nearest(*fixed[:2], begun(place))
        return gap, _places(closest)

    # one after the other: a program of one is compiled in a fraction of the time
    found, closest = cast("tuple[Array, _Places]", jax.lax.map(near, starts))
    # far from an uneven base Newton's method may go astray: there the samples will do
    size = reach_of(body, gaps.dtype)
    strays = ~(jnp.abs(found - gaps) <= 0.1 * size + 0.2 * jnp.abs(gaps))
    best = jnp.argmin(jnp.where(strays, gaps, found))
    at_best: Callable[[Array], Array] = lambda x: x[best]
    place = jax.tree.map(at_best, closest)
    gap, closest = _nearest_from(scene, t, state, place)
    return jnp.where(strays[best], gaps[best], gap), closest


def _places(state: FlyingState) -> _Places:
    return state.contact_on_base, state.contact_on_body


def closing(
    scene: Scene, t: Float[Array, ""], state: FlyingState
) -> tuple[Float[Array, ""], Float[Array, ""], Float[Array, ""]]:
    """How fast the gap opens at the nearest points, and how fast it could close.

    Args:
        scene: What flies over what.
        t: Time [s].
        state: With its nearest points.

    Returns:
        Rate of the gap [m/s]; speed of the body's origin over the base [m/s]; length of
        the angular velocity relative to it [rad/s].
    """
    moving, place, to_base = flying_pose(scene, t, state)
    ground, point = _points(scene, state, to_base)
    w, v = state.angular_velocity, state.velocity
    if moving is not None:
        v = moving.to_base(v)
        pushed = moving.velocity_at(place)
        v = v if pushed is None else v - pushed
    spin = matvec(to_base, w)
    if moving is not None and moving.angular_velocity is not None:
        spin = spin - moving.angular_velocity
    moved = v + cross(spin, matvec(to_base, point))
    return dot(ground.frame[:, 2], moved), norm(v), norm(spin)


def release(
    scene: Scene,
    orientation: Any,
    angular_velocity: Any,
    position: Any,
    velocity: Any,
    alpha: Any = (),
    alpha_dot: Any = (),
    *,
    time: Any = 0.0,
    near_on_base: Any = None,
) -> FlyingState:
    """The state of a body that is let go above its base, for a run with ``modes``.

    Args:
        scene: What will fall on what.
        orientation: Unit quaternion, scalar first, body to fixed axes [1], shape (4,).
        angular_velocity: Absolute, FIXED axes [rad/s], shape (3,).
        position: Body origin, FIXED axes [m], shape (3,).
        velocity: Of the body origin, FIXED axes [m/s], shape (3,).
        alpha: Coordinates of what is supported, shape (n,).
        alpha_dot: Their rates, shape (n,).
        time: When the motion starts [s]; matters only where the base moves.
        near_on_base: Where the base is nearest, about, base axes [m]; by default from
            the body's place.

    Raises:
        FieldError: numbers of another shape, a body that is in its base already.
    """
    numbers = {
        "orientation": (orientation, 4),
        "angular_velocity": (angular_velocity, 3),
        "position": (position, 3),
        "velocity": (velocity, 3),
        "alpha": (alpha, scene.coordinate_count),
        "alpha_dot": (alpha_dot, scene.coordinate_count),
    }
    e, w, r, v, a, a_dot = (
        real(f"release.{name}", value, (size,), "numbers in SI units")
        for name, (value, size) in numbers.items()
    )
    t = jnp.asarray(time, r.dtype)
    gap, state = _found(scene, t, e, w, r, v, a, a_dot, near_on_base)
    place = refuse(
        state.position,
        ~(gap >= 0.0),
        "release.position",
        "is in the base, or the search for the nearest point of it failed",
        "let the body go above the base, or give near_on_base",
    )
    return eqx.tree_at(lambda s: s.position, state, place)


@for_one_call
def _found(
    scene: Scene,
    t: Float[Array, ""],
    e: Float[Array, "4"],
    w: Float[Array, "3"],
    r: Float[Array, "3"],
    v: Float[Array, "3"],
    a: Float[Array, " n"],
    a_dot: Float[Array, " n"],
    near: Vector | None,
) -> tuple[Float[Array, ""], FlyingState]:
    base, body, motion = scene.base.surface, scene.body.surface, scene.base.motion
    moving = None if motion is None else motion.at(t)
    R = rotation_matrix(e)
    if near is None:
        near = r if moving is None else moving.on_base(r)
    on_base = base.locate(jnp.asarray(near, r.dtype))
    on_body = jnp.zeros(0, r.dtype)
    if scene.has_contact_coordinates:
        down = -matvec_transposed(R, base.geometry(on_base).frame[:, 2])
        on_body = body.locate(down)
    spin = matvec_transposed(R, w)
    state = FlyingState(e, spin, on_base, on_body, a, a_dot, r, v)
    from_far: Callable[[FlyingState, None], tuple[FlyingState, None]] = (
        lambda state, _: (nearest(scene, t, state)[1], None)
    )
    state, _ = jax.lax.scan(from_far, state, length=4)
    return nearest_anywhere(scene, t, state)


def _improved(
    scene: Scene, t: Float[Array, ""], state: FlyingState
) -> tuple[_Places, Array]:
    """Points after a Newton step, and the largest of what was left before it."""
    base, body = scene.base.surface, scene.body.surface
    ground = base.geometry(state.contact_on_base)
    shell = None
    if scene.has_contact_coordinates:
        shell = body.geometry(state.contact_on_body)

    def moved(x: Float[Array, " m"]) -> _Places:
        on_base, on_body = _places(state)
        on_base = on_base + base.coordinate_rates(on_base, ground, x[:2])
        if shell is not None:
            on_body = on_body + body.coordinate_rates(on_body, shell, x[2:])
        return base.settled(on_base), body.settled(on_body)

    def apart(x: Float[Array, " m"]) -> tuple[Array, Array]:
        left, _ = _apart(scene, t, eqx.tree_at(_places, state, moved(x)))
        return left, left

    rest = jnp.zeros(2 if shell is None else 4, state.position.dtype)
    slope, left = cast("tuple[Array, Array]", jax.jacfwd(apart, has_aux=True)(rest))
    solve = solve_2x2 if shell is None else _solve_by_points
    return moved(-solve(slope, left)), jnp.max(jnp.abs(left))


def _solve_by_points(
    slope: Float[Array, "4 4"], left: Float[Array, "4"]
) -> Float[Array, "4"]:
    """Moves of both points; the base's, whose block is near its metric, eliminated."""
    own = solve_2x2(slope[:2, :2], left[:2])
    by_body = solve_2x2(slope[:2, :2], slope[:2, 2:])
    rest = slope[2:, 2:] - matmul(slope[2:, :2], by_body)
    body = solve_2x2(rest, left[2:] - matvec(slope[2:, :2], own))
    return jnp.concatenate([own - matvec(by_body, body), body])


def on_body_axes(
    scene: Scene, t: Float[Array, ""], state: FlyingState, point: Float[Array, "3"]
) -> Float[Array, "3"]:
    """A point on base axes [m], on those of the body in flight."""
    _, place, to_base = flying_pose(scene, t, state)
    return matvec_transposed(to_base, point - place)


def _points(
    scene: Scene, state: FlyingState, to_base: Float[Array, "3 3"]
) -> tuple[LocalGeometry, Float[Array, "3"]]:
    """The base at its nearest point, and the body's nearest point [m], body axes."""
    base, body = scene.base.surface, scene.body.surface
    ground = base.geometry(state.contact_on_base)
    if scene.has_contact_coordinates:
        return ground, body.point(state.contact_on_body)
    of_normal = body.normal_map(base.is_flat)
    assert of_normal is not None
    return ground, of_normal(-matvec_transposed(to_base, ground.frame[:, 2]))


def _apart(
    scene: Scene, t: Float[Array, ""], state: FlyingState
) -> tuple[Float[Array, " m"], Float[Array, ""]]:
    """How far the points are from being nearest, and their distance [m]."""
    _, place, to_base = flying_pose(scene, t, state)
    ground, point = _points(scene, state, to_base)
    first, second, out = ground.frame[:, 0], ground.frame[:, 1], ground.frame[:, 2]
    aligned = []
    if scene.has_contact_coordinates:
        shell = scene.body.surface.geometry(state.contact_on_body)
        normal = matvec(to_base, shell.frame[:, 2])
        aligned = [dot(normal, first), dot(normal, second)]
    across = place + matvec(to_base, point) - ground.position
    left = [dot(first, across), dot(second, across), *aligned]
    return jnp.stack(left), dot(out, across)


def in_flight(state: SlidingState, scene: Scene, t: Float[Array, ""]) -> FlyingState:
    """The state at which a contact ends."""
    contact = contact_of(scene, t, state)
    moved = contact.point_velocity
    v = -cross(contact.angular_velocity, contact.body_point)
    v = v if moved is None else v + moved
    parts = shared_parts(state)
    if contact.orientation is not None:
        parts["orientation"] = contact.orientation  # brought onto the base's normal
    return FlyingState(
        **parts, position=contact.position, velocity=matvec(contact.rotation, v)
    )
