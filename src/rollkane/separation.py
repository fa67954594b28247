"""Bodies apart: the gap between body and base, and what an impact changes."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .checks import real, refuse
from .contact import body_to_base
from .contact_laws import impulse_response
from .coordinates import FlyingState, SlidingState, shared_parts
from .mass_matrix import assemble
from .one_call import for_one_call
from .rolling import contact_of
from .rotations import rotation_matrix
from .scene import Scene
from .small_linear import (
    components,
    cross,
    dot,
    matmul,
    matvec,
    matvec_transposed,
    norm,
    solve_2x2,
    solve_spd,
)

# Newton steps from the last nearest points: their error squares each time, so that
# half a radian is below rounding
_NEWTON = 6


def nearest(
    scene: Scene, t: Float[Array, ""], state: FlyingState
) -> tuple[Float[Array, ""], FlyingState]:
    """Gap between the surfaces [m], and the state with their nearest points.

    Args:
        scene: What flies over what.
        t: Time [s].
        state: Its contact coordinates are where the search begins.

    The gap is the distance along the base's normal, less than zero in the base. Where
    there are several nearest points, the ones next to the start are followed.
    """
    improve = lambda state, _: (_improved(scene, t, state), None)
    state, _ = jax.lax.scan(improve, state, length=_NEWTON)
    return _apart(scene, t, state, jnp.zeros(_unknowns(scene)))[1], state


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
def _found(scene: Scene, t, e, w, r, v, a, a_dot, near):
    base, body, motion = scene.base.surface, scene.body.surface, scene.base.motion
    moving = None if motion is None else motion.at(t)
    R = rotation_matrix(e)
    if near is None:
        near = r
        if moving is not None:
            origin = 0.0 if moving.position is None else moving.position
            near = moving.to_base(r - origin)
    on_base = base.locate(jnp.asarray(near, r.dtype))
    on_body = jnp.zeros(0, r.dtype)
    if scene.carries_point:
        down = -matvec_transposed(R, base.geometry(on_base).frame[:, 2])
        on_body = body.locate(down)
    spin = matvec_transposed(R, w)
    state = FlyingState(e, spin, on_base, on_body, a, a_dot, r, v)
    from_far = lambda state, _: (nearest(scene, t, state)[1], None)
    state, _ = jax.lax.scan(from_far, state, length=4)
    return nearest(scene, t, state)


def _unknowns(scene: Scene) -> int:
    return 4 if scene.carries_point else 2


def _improved(scene: Scene, t, state: FlyingState) -> FlyingState:
    rest = jnp.zeros(_unknowns(scene), state.position.dtype)
    left = _apart(scene, t, state, rest)[0]
    slope = jax.jacfwd(lambda x: _apart(scene, t, state, x)[0])(rest)
    if left.shape[0] == 2:
        return _moved(scene, state, -solve_2x2(slope, left))
    return _moved(scene, state, -_solve_by_points(slope, left))


def _solve_by_points(slope, left) -> Float[Array, "4"]:
    """Moves of both points; the base's, whose block is near its metric, eliminated."""
    own = solve_2x2(slope[:2, :2], left[:2])
    by_body = solve_2x2(slope[:2, :2], slope[:2, 2:])
    rest = slope[2:, 2:] - matmul(slope[2:, :2], by_body)
    body = solve_2x2(rest, left[2:] - matvec(slope[2:, :2], own))
    return jnp.concatenate([own - matvec(by_body, body), body])


def _moved(scene: Scene, state: FlyingState, x) -> FlyingState:
    """The state with nearest points moved by tangent coordinates."""
    base, body = scene.base.surface, scene.body.surface
    on_base, on_body = state.contact_on_base, state.contact_on_body
    ground = base.geometry(on_base)
    on_base = on_base + base.coordinate_rates(on_base, ground, x[:2])
    if scene.carries_point:
        shell = body.geometry(on_body)
        on_body = on_body + body.coordinate_rates(on_body, shell, x[2:])
    places = base.settled(on_base), body.settled(on_body)
    return eqx.tree_at(lambda s: (s.contact_on_base, s.contact_on_body), state, places)


def _apart(scene: Scene, t, state: FlyingState, x):
    """How far the points are from being nearest, and their distance [m]."""
    state = _moved(scene, state, x)
    motion, base, body = scene.base.motion, scene.base.surface, scene.body.surface
    moving = None if motion is None else motion.at(t)
    place = state.position
    if moving is not None:
        origin = 0.0 if moving.position is None else moving.position
        place = moving.to_base(place - origin)
    to_base = body_to_base(rotation_matrix(state.orientation), moving)
    ground = base.geometry(state.contact_on_base)
    first, second, out = ground.frame[:, 0], ground.frame[:, 1], ground.frame[:, 2]
    aligned = []
    if scene.carries_point:
        shell = body.geometry(state.contact_on_body)
        point, normal = shell.position, matvec(to_base, shell.frame[:, 2])
        aligned = [dot(normal, first), dot(normal, second)]
    else:
        of_normal = body.normal_map(base.is_flat)
        assert of_normal is not None
        point = of_normal(-matvec_transposed(to_base, out))
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


def impact(
    scene: Scene,
    t: Float[Array, ""],
    state: FlyingState,
    restitution: Float[Array, ""],
    friction: Float[Array, ""],
    rest_speed: Float[Array, ""],
) -> tuple[FlyingState, SlidingState, Float[Array, ""]]:
    """The states after a body has hit its base: in flight, or in contact.

    The normal velocity is reversed, times the restitution (Newton); the impulse along
    the surface ends the slip if the friction coefficient allows, else it acts against
    the slip with its limit (Coulomb).

    Args:
        scene: With a slipping contact.
        t: Time [s].
        state: At the impact, with the nearest points touching.
        restitution: [1].
        friction: [1].
        rest_speed: What would rebound slower than this stays in contact [m/s].

    Returns:
        The state in flight, the state in contact, and the speed of the rebound [m/s]:
        zero where it stays in contact.
    """
    touching = _in_contact(scene, t, state)
    contact = contact_of(scene, t, touching)
    system = assemble(scene, t, touching, contact)
    G, others = impulse_response(scene, contact, system)
    N, U = contact.normal, _approach(state, contact)
    speed = dot(U, N)  # towards the base
    rebound = restitution * speed
    rebound = jnp.where(rebound < rest_speed, 0.0, rebound)
    change = -(speed + rebound) * N
    slip = U - speed * N
    rows = [components(row) for row in components(G)]
    sticking = jnp.stack(solve_spd(rows, components(change - slip)))
    push = -dot(sticking, N)
    along = sticking + push * N
    size = norm(jnp.where(dot(slip, slip) > 0.0, slip, N))
    direction = slip / size
    limit = -(N + friction * direction)
    limited = (speed + rebound) / -dot(N, matvec(G, limit)) * limit
    sticks = dot(along, along) <= (friction * push) ** 2
    J = jnp.where(sticks, sticking, limited)
    jump = matvec(others, J)
    after = U + matvec(G, J)
    w, alpha_dot = state.angular_velocity + jump[:3], state.alpha_dot + jump[3:]
    parts = shared_parts(state) | {"angular_velocity": w, "alpha_dot": alpha_dot}
    j = contact.base_velocity
    v = after - cross(w, contact.body_point)
    v = v if j is None else v + j
    R = contact.rotation
    flying = FlyingState(**parts, position=contact.position, velocity=matvec(R, v))
    slid = after - N * dot(after, N)
    slid = jnp.where(sticks, 0.0, slid)
    return flying, SlidingState(**parts, slip=matvec(R, slid)), rebound


def _in_contact(scene: Scene, t, state: FlyingState) -> SlidingState:
    return SlidingState(**shared_parts(state), slip=jnp.zeros_like(state.velocity))


def _approach(state: FlyingState, contact) -> Float[Array, "3"]:
    """Velocity of the body's nearest point over the base [m/s], body axes."""
    v = matvec_transposed(contact.rotation, state.velocity)
    v = v + cross(state.angular_velocity, contact.body_point)
    j = contact.base_velocity
    return v if j is None else v - j
