"""Bodies apart: the gap between body and base, and how it closes."""

from collections.abc import Callable
from typing import Any, TypeAlias, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ..codegen import prepare_calls
from ..codegen.compile_effort import for_one_call
from ..codegen.tracing import shared_in_c
from ..geometry.local_geometry import LocalGeometry, from_normal
from ..geometry.rotations import rotation_matrix
from ..geometry.small_linear import (
    components,
    cross,
    dot,
    matmul,
    matvec,
    matvec_transposed,
    norm,
    solve_2x2,
)
from ..kinematics.coordinates import FlyingState, SlidingState, shared_parts
from ..validation.checks import real_and_known, refuse
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
# Steps taken, the points, and what was left before the last step and the gap there [m].
_Search: TypeAlias = tuple[Int[Array, ""], _Places, Float[Array, ""], Float[Array, ""]]


def nearest(
    scene: Scene, t: Float[Array, ""], state: FlyingState, steps: int = _NEWTON
) -> tuple[Float[Array, ""], FlyingState]:
    """Gap between the surfaces [m], and the state with their nearest points.

    Args:
        scene: What flies over what.
        t: Time [s].
        state: Its contact coordinates are where the search begins.
        steps: Of the search, at most.

    The gap is the distance along the base's normal, less than zero in the base; NaN
    where the search did not converge. Where there are several nearest points, the ones
    next to the start are followed.
    """
    places, found = _searched(*jax.lax.stop_gradient((scene, t, state)), steps)
    gap, state = _nearest_from(scene, t, state, places)
    return jnp.where(jnp.isnan(found), jnp.nan, gap), state


def _searched(
    scene: Scene, t: Float[Array, ""], state: FlyingState, steps: Any = _NEWTON
) -> tuple[_Places, Float[Array, ""]]:
    """The nearest points, and their gap, NaN if the search did not converge."""
    size = 1.0 + norm(state.position)
    close: Float[Array, ""] = _CLOSE * np.finfo(size.dtype).eps * size

    def going(carry: _Search) -> Bool[Array, ""]:
        count, _, left, _ = carry
        return (count < steps) & (left > close)

    def improve(carry: _Search) -> _Search:
        count, places, _, _ = carry
        return count + 1, *_improved(scene, t, eqx.tree_at(_places, state, places))

    far = jnp.full_like(close, jnp.inf)
    carry = jnp.asarray(0), _places(state), far, far
    _, found, left, gap = jax.lax.while_loop(going, improve, carry)
    converged = left <= (1e-9 if close.dtype == jnp.float64 else 1e-4) * size
    return found, jnp.where(converged, gap, jnp.nan)


def _nearest_from(
    scene: Scene, t: Float[Array, ""], state: FlyingState, places: _Places
) -> tuple[Float[Array, ""], FlyingState]:
    """:func:`nearest` from points that are it, to which it gives their derivative.

    One step more of the search has it, by the implicit function; the gap is stationary
    there, and does not move with the points.
    """
    found, _, gap = _improved(scene, t, eqx.tree_at(_places, state, places))
    return gap, eqx.tree_at(_places, state, found)


@shared_in_c
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

    def near(low: tuple[Array, Float[Array, "3"]]) -> tuple[_Places, Array]:
        # no step, which finds nothing, from where there is no low sample
        gap, place = low
        steps = jnp.where(jnp.isfinite(gap), _NEWTON, 0)
        return _searched(*fixed[:2], begun(place), steps)

    # one after the other: a program of one is compiled in a fraction of the time
    closest, found = cast("tuple[_Places, Array]", jax.lax.map(near, (gaps, starts)))
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
    ground = scene.base.surface.geometry(state.contact_on_base)
    w, v = state.angular_velocity, state.velocity
    if moving is not None:
        v = moving.to_base(v)
        pushed = moving.velocity_at(place)
        v = v if pushed is None else v - pushed
    spin = matvec(to_base, w)
    if moving is not None and moving.angular_velocity is not None:
        spin = spin - moving.angular_velocity
    point = _body_point(scene, state, ground, to_base)
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
    prepare_calls()  # a run follows
    numbers = {
        "orientation": (orientation, 4),
        "angular_velocity": (angular_velocity, 3),
        "position": (position, 3),
        "velocity": (velocity, 3),
        "alpha": (alpha, scene.coordinate_count),
        "alpha_dot": (alpha_dot, scene.coordinate_count),
    }
    e, w, r, v, a, a_dot = (
        real_and_known(f"release.{name}", value, (size,), "numbers in SI units")
        for name, (value, size) in numbers.items()
    )
    t = real_and_known("release.time", time, (), "seconds", r.dtype)
    gap, on_base, on_body = _places_below(scene, t, e, r, near_on_base)
    place = refuse(
        r,
        ~(gap >= 0.0),
        "release.position",
        "is in the base, or the search for the nearest point of it failed",
        "let the body go above the base, or give near_on_base",
    )
    spin = matvec_transposed(rotation_matrix(e), w)
    return FlyingState(e, spin, on_base, on_body, a, a_dot, place, v)


@for_one_call  # known then, too, where only masses or speeds are traced
def _places_below(
    scene: Scene,
    t: Float[Array, ""],
    e: Float[Array, "4"],
    r: Float[Array, "3"],
    near: Vector | None,
) -> tuple[Float[Array, ""], Array, Array]:
    """Gap of a body at rest there [m], and the coordinates of the nearest points."""
    base, body, motion = scene.base.surface, scene.body.surface, scene.base.motion
    moving = None if motion is None else motion.at(t)
    if near is None:
        near = r if moving is None else moving.on_base(r)
    on_base = base.locate(jnp.asarray(near, r.dtype))
    none = jnp.zeros(0, r.dtype)
    on_body = none
    if scene.has_contact_coordinates:
        axis = base.geometry(on_base).frame[:, 2]
        on_body = body.locate(-matvec_transposed(rotation_matrix(e), axis))
    still = jnp.zeros_like(r)
    state = FlyingState(e, still, on_base, on_body, none, none, r, still)
    if may_touch_twice(scene):
        gap, state = nearest_anywhere(scene, t, state)
    else:  # it may be far
        gap, state = nearest(scene, t, state, steps=4 * _NEWTON)
    return gap, *_places(state)


def _improved(
    scene: Scene, t: Float[Array, ""], state: FlyingState
) -> tuple[_Places, Float[Array, ""], Float[Array, ""]]:
    """Points after a Newton step; the largest of what was left before it, and the gap.

    Nearest are points whose join is across both tangents of the base, to which the
    body's normal is, too.
    """
    base, body = scene.base.surface, scene.body.surface
    _, origin, to_base = flying_pose(scene, t, state)
    ground = base.geometry(state.contact_on_base)
    shell = _body_geometry(scene, state, ground, to_base)
    tangents = components(ground.frame.T[:2])
    join = origin + matvec(to_base, shell.position) - ground.position
    gap = dot(ground.normal, join)
    left = [dot(tangent, join) for tangent in tangents]
    normal = None
    if scene.has_contact_coordinates:
        normal = matvec(to_base, shell.normal)
        left += [dot(tangent, normal) for tangent in tangents]

    def moved(x: Float[Array, " m"]) -> _Places:
        on_base, on_body = _places(state)
        on_base = on_base + base.coordinate_rates(on_base, still[0], x[:2])
        if normal is not None:
            on_body = on_body + body.coordinate_rates(on_body, still[1], x[2:])
        return base.settled(on_base), body.settled(on_body)

    # at the nearest points nothing is left that a change of the slope could move
    still = jax.lax.stop_gradient((ground, shell, to_base, gap, normal))
    move = -_solved(*still, jnp.stack(left))
    return moved(move), jnp.max(jnp.abs(jnp.stack(left))), gap


def _solved(
    ground: LocalGeometry,
    shell: LocalGeometry,
    to_base: Float[Array, "3 3"],
    gap: Float[Array, ""],
    normal: Float[Array, "3"] | None,
    left: Float[Array, " m"],
) -> Float[Array, " m"]:
    """What is left, by its slope in the coordinates of both points.

    Tangents turn by ``d t_i = e3 W dx``, points move by ``t_i L dx``, (2.3). How the
    tangents turn about the normal does not matter where the points are nearest.
    """
    W, L = ground.frame_rates, ground.lengths
    by_base = gap * W - L
    if normal is None:  # the body's point moves with its normal, on the same tangents
        return solve_2x2(by_base + matmul(shell.lengths, W), left)
    mixing = matmul(ground.frame.T[:2], matmul(to_base, shell.frame[:, :2]))
    aligned = dot(normal, ground.normal) * W
    by_body = matmul(mixing, shell.lengths)
    by_turning = -matmul(mixing, shell.frame_rates)
    # the base's point, whose block is near its metric, eliminated
    own = solve_2x2(by_base, left[:2])
    of_body = solve_2x2(by_base, by_body)
    rest = by_turning - matmul(aligned, of_body)
    body = solve_2x2(rest, left[2:] - matvec(aligned, own))
    return jnp.concatenate([own - matvec(of_body, body), body])


def on_body_axes(
    scene: Scene, t: Float[Array, ""], state: FlyingState, point: Float[Array, "3"]
) -> Float[Array, "3"]:
    """A point on base axes [m], on those of the body in flight."""
    _, place, to_base = flying_pose(scene, t, state)
    return matvec_transposed(to_base, point - place)


def _body_point(
    scene: Scene,
    state: FlyingState,
    ground: LocalGeometry,
    to_base: Float[Array, "3 3"],
) -> Float[Array, "3"]:
    """The body's nearest point [m], body axes."""
    body = scene.body.surface
    if scene.has_contact_coordinates:
        return body.point(state.contact_on_body)
    of_normal = body.normal_map(scene.base.surface.is_flat)
    assert of_normal is not None
    return of_normal(-matvec_transposed(to_base, ground.normal))


def _body_geometry(
    scene: Scene,
    state: FlyingState,
    ground: LocalGeometry,
    to_base: Float[Array, "3 3"],
) -> LocalGeometry:
    """The body there; on the base's tangents, where the point is that of a normal."""
    body = scene.body.surface
    if scene.has_contact_coordinates:
        return body.geometry(state.contact_on_body)
    of_normal = body.normal_map(scene.base.surface.is_flat)
    assert of_normal is not None
    first, second, out = (
        matvec_transposed(to_base, axis) for axis in components(ground.frame.T)
    )
    return from_normal(of_normal, -out, (first, second))


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
