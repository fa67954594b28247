"""Bodies apart: how the gap between body and base closes, and where a flight begins."""

from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ..codegen import prepare_calls
from ..codegen.compile_effort import for_one_call
from ..geometry.rotations import rotation_matrix
from ..geometry.small_linear import cross, dot, matvec, matvec_transposed, norm
from ..kinematics.coordinates import FlyingState, SlidingState, shared_parts
from ..validation.checks import real, refuse
from .bodies import Vector
from .clearance import flying_pose, may_touch_twice
from .nearest_anywhere import nearest_anywhere
from .nearest_points import NEWTON, begun_at, nearest, places_of
from .rolling import contact_of
from .scene import Scene


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
    # the body's point is along the normal from the base's: moved alike along it
    moved = v + cross(spin, ground.position - place)
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

    The nearest points have first derivatives; their second ones are not right (runs
    with ``modes`` refuse them).

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
    dtype = scene.body.mass.dtype
    numbers = {
        "orientation": (orientation, 4),
        "angular_velocity": (angular_velocity, 3),
        "position": (position, 3),
        "velocity": (velocity, 3),
        "alpha": (alpha, scene.coordinate_count),
        "alpha_dot": (alpha_dot, scene.coordinate_count),
    }
    e, w, r, v, a, a_dot = (
        real(f"release.{name}", value, (size,), "numbers in SI units", dtype)
        for name, (value, size) in numbers.items()
    )
    t = real("release.time", time, (), "seconds", dtype)
    none_found, on_base, on_body = _places_below(scene, t, e, r, near_on_base)
    place = refuse(
        r,
        none_found,
        "release.position",
        "is in the base, over the flat of a disc, or too far to find the nearest point",
        "let the body go above the base's surface, or give near_on_base",
    )
    return FlyingState(e, _on_body_axes(e, w), on_base, on_body, a, a_dot, place, v)


@for_one_call
def _on_body_axes(e: Float[Array, "4"], w: Float[Array, "3"]) -> Float[Array, "3"]:
    return matvec_transposed(rotation_matrix(e), w)


@for_one_call  # known then, too, where only masses or speeds are traced
def _places_below(
    scene: Scene,
    t: Float[Array, ""],
    e: Float[Array, "4"],
    r: Float[Array, "3"],
    near: Vector | None,
) -> tuple[Bool[Array, ""], Array, Array]:
    """Whether a body at rest there has no gap, and the nearest points' coordinates."""
    base, body, motion = scene.base.surface, scene.body.surface, scene.base.motion
    moving = None if motion is None else motion.at(t)
    if near is None:
        near = r if moving is None else moving.on_base(r)
    near = jnp.asarray(near, r.dtype)
    on_base = base.locate(near)
    none = jnp.zeros(0, r.dtype)
    on_body = none
    if scene.has_contact_coordinates:
        axis = base.geometry(on_base).frame[:, 2]
        on_body = body.locate(-matvec_transposed(rotation_matrix(e), axis))
    still = jnp.zeros_like(r)
    state = FlyingState(e, still, on_base, on_body, none, none, r, still)
    if base.is_edge or body.is_edge:  # towards the base: the body's origin has no place
        state = begun_at(scene, t, state, base.point(on_base))
    if may_touch_twice(scene):
        gap, state = nearest_anywhere(scene, t, state)
    else:  # it may be far
        gap, state = nearest(scene, t, state, steps=4 * NEWTON)
    apart = (gap >= 0.0) & (gap < jnp.inf)
    # a place that is refused has no nearest points, and is what a run then names
    on_base, on_body = (jnp.where(apart, x, 0.0) for x in places_of(state))
    return ~apart, on_base, on_body


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
