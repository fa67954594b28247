"""Rolling without slipping: the formulation that `simulate` uses.

One symmetric positive definite system per evaluation, on body axes, about the contact
point (theory, section 4.1).
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from .bodies import inertia_about
from .contact import Contact, rolling_contact
from .coordinates import State, state_rates
from .scene import Scene
from .small_linear import components, cross, dot, matvec, solve_spd


def contact_of(scene: Scene, state: State) -> Contact:
    """The contact of a scene's body in a state."""
    return rolling_contact(
        scene.body.surface,
        scene.base.surface,
        state.orientation,
        state.angular_velocity,
        state.contact_on_base,
        state.contact_on_body,
    )


def rolling_derivative(scene: Scene, t: Float[Array, ""], state: State) -> State:
    """Rates of the state of a rolling body: the right-hand side itself.

    Args:
        scene: What rolls on what, under which loads.
        t: Time [s].
        state: Where the body is and how it turns.

    Returns:
        Rates of every number of the state [its unit / s], as a state.

    Source: theory, section 4.1. Sign: the normal points out of each surface.
    """
    del t
    contact = contact_of(scene, state)
    acceleration, _ = angular_acceleration(scene, state, contact)
    return state_rates(state, contact, acceleration, state.alpha_dot)


def angular_acceleration(
    scene: Scene, state: State, contact: Contact
) -> tuple[Float[Array, "3"], Float[Array, "3"]]:
    """Angular acceleration, and the load that is not carried by inertia.

    Returns:
        Angular acceleration [rad/s^2] and ``F - M a_P`` [N], both on BODY axes, where
        a_P is the acceleration of the body's material point at the contact.

    Source: theory, section 4.1, ``Th^M w' = c x (F - M a_P) - w x Th^M w``.
    """
    body, w = scene.body, state.angular_velocity
    c = body.center_of_mass - contact.body_point
    Th = inertia_about(body.mass, c, body.inertia)
    a_P = cross(contact.velocity, w)
    drive = -body.mass * a_P
    for load in scene.loads:
        drive = drive + load.force(body, contact)
    rhs = cross(c, drive) - cross(w, _times_lower(Th, w))
    return solve_spd(Th, rhs), drive


def contact_force(scene: Scene, state: State) -> Float[Array, "3"]:
    """Force of the base on the body [N], FIXED axes, shape (3,).

    Source: theory, section 5, ``Rc = M (a_P + w' x c + w x (w x c)) - F``.
    """
    contact = contact_of(scene, state)
    w_dot, drive = angular_acceleration(scene, state, contact)
    w = state.angular_velocity
    c = scene.body.center_of_mass - contact.body_point
    relative = cross(w_dot, c) + cross(w, cross(w, c))
    return matvec(contact.rotation, scene.body.mass * relative - drive)


def kinetic_energy(scene: Scene, state: State) -> Float[Array, ""]:
    """Kinetic energy [J], from the inertia about the contact point (theory, 3)."""
    contact = contact_of(scene, state)
    c = scene.body.center_of_mass - contact.body_point
    w = state.angular_velocity
    Th = inertia_about(scene.body.mass, c, scene.body.inertia)
    return 0.5 * dot(w, _times_lower(Th, w))


def _times_lower(lower: list[list[Array]], v: Float[Array, "3"]) -> Float[Array, "3"]:
    """Symmetric matrix, given by its lower triangle, times a vector."""
    n, x = len(lower), components(v)
    rows = [[lower[max(i, j)][min(i, j)] * x[j] for j in range(n)] for i in range(n)]
    return jnp.stack([sum(row[1:], row[0]) for row in rows])
