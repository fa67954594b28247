"""What an impact of a body on its base changes, by one of two laws of restitution."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ..geometry.rotations import tangent_pair
from ..geometry.small_linear import (
    components,
    cross,
    dot,
    matmul,
    matvec,
    matvec_transposed,
    norm,
    solve_spd,
)
from ..kinematics.contact import Contact
from ..kinematics.coordinates import FlyingState, SlidingState, shared_parts
from .contact_laws import impulse_response
from .impact_process import NEVER_SLIPS, Impact, collided
from .mass_matrix import assemble
from .rolling import contact_of
from .scene import Scene

# Of the kinetic energy at the contact before an impact: what rounding may add to it
_GAIN = 1e-9
# Of a place [1]: how far the nearest points may be from those of the contact. The
# search leaves rounding of what it compares, squared steps of 1e-5 (1e-2) at most
_MISPLACED = {"float64": 1e-8, "float32": 1e-3}


class Rebound(NamedTuple):
    """A body behind an impact.

    Attributes:
        flying: Its state in flight.
        touching: Its state in contact; slip is zero where it sticks.
        speed: Of the rebound [m/s]; zero where it stays in contact.
        impulse: Of the base on the body [N s], FIXED axes.
    """

    flying: FlyingState
    touching: SlidingState
    speed: Float[Array, ""]
    impulse: Float[Array, "3"]


def impact(
    scene: Scene,
    t: Float[Array, ""],
    state: FlyingState,
    restitution: Float[Array, ""],
    friction: Float[Array, ""] | None,
    rest_speed: Float[Array, ""],
    law: str = "energetic",
    happens: Bool[Array, ""] | bool = True,
) -> Rebound:
    """A body that hits its base, with all that it supports.

    Args:
        scene: With a slipping contact.
        t: Time [s].
        state: At the impact, with the nearest points touching; where they do not, what
            is behind it is NaN.
        restitution: Of the energy of compression (its root), or of the normal velocity
            [1].
        friction: [1]; None: the body never slips.
        rest_speed: What would rebound slower than this stays in contact [m/s].
        law: ``"energetic"`` (:mod:`rollkane.dynamics.impact_process`), or
            ``"newton"``, whose states are NaN where it would pull, turn a slip against
            its friction, or add energy.
        happens: Whether it does: in a batch others wait for what is integrated.

    Source: docs/theory.md, (8.6) to (8.11).
    """
    touching = SlidingState(**shared_parts(state), slip=jnp.zeros_like(state.velocity))
    contact = contact_of(scene, t, touching)
    system = assemble(scene, t, touching, contact)
    response, others = impulse_response(scene, contact, system)
    first, second = tangent_pair(contact.normal)
    axes = jnp.stack([first, second, -contact.normal])  # rows: t1, t2, n
    mu = jnp.full_like(t, NEVER_SLIPS) if friction is None else friction
    arguments = (
        jnp.where(happens, matvec(axes, _approach(state, contact)), 0.0),
        matmul(matmul(axes, response), axes.T),
        mu,
        restitution,
        rest_speed,
    )
    hit = (collided if law == "energetic" else _by_newton)(*arguments)
    off, size = contact.position - state.position, 1.0 + norm(state.position)
    off, size = jax.lax.stop_gradient((off, size))
    apart = happens & ~(norm(off) <= _MISPLACED[str(off.dtype)] * size)
    hit = Impact(*(jnp.where(apart, jnp.nan, x) for x in hit))
    J, after = (matvec_transposed(axes, x) for x in hit)
    jump = matvec(others, J)
    w, alpha_dot = state.angular_velocity + jump[:3], state.alpha_dot + jump[3:]
    parts: dict[str, Any] = shared_parts(state) | {
        "angular_velocity": w,
        "alpha_dot": alpha_dot,
    }
    R, j = contact.rotation, contact.base_velocity
    v = after - cross(w, contact.body_point)
    v = v if j is None else v + j
    flying = FlyingState(**parts, position=contact.position, velocity=matvec(R, v))
    along = hit.velocity.at[2].set(0.0)
    slip = matvec(R, matvec_transposed(axes, along))
    return Rebound(
        flying, SlidingState(**parts, slip=slip), hit.velocity[2], matvec(R, J)
    )


def _approach(state: FlyingState, contact: Contact) -> Float[Array, "3"]:
    """Velocity of the body's nearest point over the base [m/s], body axes."""
    v = matvec_transposed(contact.rotation, state.velocity)
    v = v + cross(state.angular_velocity, contact.body_point)
    j = contact.base_velocity
    return v if j is None else v - j


def _by_newton(
    velocity: Float[Array, "3"],
    G: Float[Array, "3 3"],
    friction: Float[Array, ""],
    restitution: Float[Array, ""],
    rest_speed: Float[Array, ""],
) -> Impact:
    """The normal velocity reversed, times the restitution; friction as if at once.

    ``J = G^-1 (u+ - u-)`` with ``u+ = -e u_n n`` where the cone has it, else
    ``J = J_n (n - mu u_t / |u_t|)``, with J_n by the normal velocity.
    """
    rows = [components(row) for row in components(G)]
    u_n, u_t = velocity[2], velocity[:2]
    rebound = -restitution * u_n
    rebound = jnp.where(rebound < rest_speed, 0.0, rebound)
    zero = jnp.zeros_like(u_t)
    sticking = solve_spd(rows, components(jnp.append(zero, rebound) - velocity))
    sticking = jnp.stack(sticking)
    size = norm(jnp.where(dot(u_t, u_t) > 0.0, u_t, 1.0))
    way = u_t / size
    limit = jnp.append(-friction * way, jnp.ones_like(u_n))
    sliding = (rebound - u_n) / dot(G[2], limit) * limit
    along = sticking[:2]
    sticks = dot(along, along) <= (friction * sticking[2]) ** 2
    sticks &= (sticking[2] >= 0.0) & (friction > 0.0)
    J = jnp.where(sticks, sticking, sliding)
    after = velocity + matvec(G, J)
    slip = jnp.where(sticks, 0.0, after[:2])
    after = jnp.append(slip, rebound)
    weight = jnp.stack(solve_spd(rows, components(velocity)))
    pulls = ~(J[2] >= 0.0)
    turned = ~sticks & (dot(slip, u_t) < 0.0)
    gains = dot(velocity + after, J) > _GAIN * dot(velocity, weight)
    wrong = pulls | turned | gains
    return Impact(jnp.where(wrong, jnp.nan, J), jnp.where(wrong, jnp.nan, after))
