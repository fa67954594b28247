"""What a motion is measured by: pose, velocities, contact, energy, momentum, forces.

Functions of the scene, the time and one state, in either coordinates.
"""

from collections.abc import Iterator
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..geometry.rotations import quaternion_of
from ..geometry.small_linear import (
    components,
    cross,
    dot,
    matvec,
    norm,
    safe_norm,
)
from ..kinematics.contact import Contact
from ..kinematics.voronets import AnyState
from .bodies import inertia_about
from .equations import quasi_velocities
from .mass_matrix import Masses, field_of, times_lower
from .rolling import contact_of, press_and_pull, solved
from .scene import Scene
from .supported import total


class _Moving(NamedTuple):
    """Masses of the system at one instant, on body axes."""

    mass: Float[Array, " k"]
    arm: Float[Array, "3 k"]  # from the contact point [m]
    velocity: Float[Array, "3 k"]  # absolute [m/s]
    own_spin: Float[Array, "3"] | None  # own angular momentum of rigid parts
    own_energy: Float[Array, ""] | None


def _moving(
    scene: Scene, t: Float[Array, ""], state: AnyState, contact: Contact
) -> Iterator[_Moving]:
    """The body, then everything that it carries."""
    w, j = contact.angular_velocity, contact.point_velocity
    body = scene.body
    c = body.center_of_mass - contact.body_point
    v = cross(w, c) if j is None else j + cross(w, c)
    zero = jnp.zeros_like(c)
    spin = times_lower(inertia_about(body.mass, zero, body.inertia), w)
    yield _Moving(body.mass[None], c[:, None], v[:, None], spin, 0.5 * dot(w, spin))
    for supported, alpha, alpha_dot in scene.shares(state):
        part = supported.carried(t, alpha, alpha_dot)
        s = part.place - contact.body_point[:, None]
        v = cross(w, s) + part.velocity
        v = v if j is None else v + j[:, None]
        spin = energy = None
        for turning in part.turnings:
            W = w + turning.velocity
            own = matvec(turning.inertia, W)
            spin = own if spin is None else spin + own
            stored = 0.5 * dot(W, own)
            energy = stored if energy is None else energy + stored
        yield _Moving(part.mass, s, v, spin, energy)


def position(scene: Scene, t: Float[Array, ""], state: Any) -> Float[Array, "3"]:
    """Body origin O [m], FIXED axes."""
    return contact_of(scene, t, state).position


def velocity(scene: Scene, t: Float[Array, ""], state: Any) -> Float[Array, "3"]:
    """Of the body origin O [m/s], FIXED axes: ``v_O = j + U + w x (O - M)``.

    Source: docs/theory.md, (1.3); the material point at the contact M goes with the
    base's, ``j``, and slips by ``U``.
    """
    return velocity_of_origin(contact_of(scene, t, state))


def velocity_of_origin(contact: Contact) -> Float[Array, "3"]:
    """As :func:`velocity`, of a contact that is known."""
    glide = cross(contact.body_point, contact.angular_velocity)
    point = contact.point_velocity
    return matvec(contact.rotation, glide if point is None else glide + point)


def orientation(scene: Scene, t: Float[Array, ""], state: Any) -> Float[Array, "4"]:
    """Unit quaternion, scalar first, body to fixed axes [1]."""
    contact = contact_of(scene, t, state)
    if contact.orientation is None:
        return quaternion_of(contact.rotation)
    return contact.orientation / norm(contact.orientation)


def angular_velocity(
    scene: Scene, t: Float[Array, ""], state: Any
) -> Float[Array, "3"]:
    """Absolute [rad/s], FIXED axes."""
    contact = contact_of(scene, t, state)
    return matvec(contact.rotation, contact.angular_velocity)


def slip(scene: Scene, t: Float[Array, ""], state: Any) -> Float[Array, "3"]:
    """``U``, of the body's point over the base [m/s], FIXED axes; zero in flight."""
    contact = contact_of(scene, t, state)
    if contact.slip is None or not state.touches:
        return jnp.zeros_like(contact.normal)
    return matvec(contact.rotation, contact.slip)


def contact_on_body(scene: Scene, t: Float[Array, ""], state: Any) -> Float[Array, "3"]:
    """Contact point from the body origin [m], body axes; NaN in flight."""
    point = contact_of(scene, t, state).body_point
    return point if state.touches else jnp.full_like(point, jnp.nan)


def contact_on_base(scene: Scene, t: Float[Array, ""], state: Any) -> Float[Array, "3"]:
    """Contact point [m], base axes; NaN in flight."""
    point = contact_of(scene, t, state).base_point
    return point if state.touches else jnp.full_like(point, jnp.nan)


def base_position(scene: Scene, t: Float[Array, ""], state: Any) -> Float[Array, "3"]:
    """Base origin [m], FIXED axes."""
    still = jnp.zeros_like(state.angular_velocity)
    motion = scene.base.motion
    return still if motion is None else motion.at(t).placed(still)


def base_rotation(scene: Scene, t: Float[Array, ""], state: Any) -> Float[Array, "3 3"]:
    """Base to FIXED axes [1]."""
    motion = scene.base.motion
    rotation = None if motion is None else motion.at(t).rotation
    level = jnp.eye(3, dtype=state.angular_velocity.dtype)
    return level if rotation is None else rotation


def kinetic_energy(
    scene: Scene, t: Float[Array, ""], state: AnyState
) -> Float[Array, ""]:
    """Kinetic energy of the body and of all that it carries [J], (6.1)."""
    contact = contact_of(scene, t, state)
    energy = jnp.zeros_like(contact.angular_velocity[0])
    for mass, _, v, _, own in _moving(scene, t, state, contact):
        energy = energy + 0.5 * jnp.sum(mass * dot(v, v))
        energy = energy if own is None else energy + own
    return energy


def energy(scene: Scene, t: Float[Array, ""], state: AnyState) -> Float[Array, ""]:
    """Kinetic plus potential energy [J]: of fields and potentials of loads, of springs.

    The potential of a field is ``-sum m g . r`` from the fixed origin; a spring counts
    where it is given by a potential.
    """
    value = kinetic_energy(scene, t, state)
    contact = contact_of(scene, t, state)
    field = field_of(scene.loads)
    if field is not None:
        for mass, s, *_ in _moving(scene, t, state, contact):
            arm = matvec(contact.rotation, total(mass[None] * s))
            value = value - dot(field, jnp.sum(mass) * contact.place + arm)
    for supported, alpha, _ in scene.shares(state):
        stored = supported.potential_energy(alpha)
        value = value if stored is None else value + stored
    for load in scene.loads:
        stored = load.potential_energy(t, scene.body, contact)
        value = value if stored is None else value + stored
    return value


def momentum(scene: Scene, t: Float[Array, ""], state: AnyState) -> Float[Array, "3"]:
    """``P``, momentum of the whole system [kg m/s], FIXED axes, (6.1)."""
    contact = contact_of(scene, t, state)
    return matvec(contact.rotation, _momentum(scene, t, state, contact))


def _momentum(
    scene: Scene, t: Float[Array, ""], state: AnyState, contact: Contact
) -> Float[Array, "3"]:
    parts = [
        total(mass[None] * v) for mass, _, v, *_ in _moving(scene, t, state, contact)
    ]
    return sum(parts[1:], parts[0])


def contact_angular_momentum(
    scene: Scene, t: Float[Array, ""], state: AnyState
) -> Float[Array, "3"]:
    """``K^M``, about the contact point, in absolute motion [kg m^2/s], FIXED axes.

    Source: docs/theory.md, (6.1), about M; [A], last formula: it is m', the gradient
    of Theta'.
    """
    contact = contact_of(scene, t, state)
    parts: list[Array] = []
    for mass, s, v, own, _ in _moving(scene, t, state, contact):
        spin = total(mass[None] * cross(s, v))
        parts.append(spin if own is None else spin + own)
    return matvec(contact.rotation, sum(parts[1:], parts[0]))


def angular_momentum(
    scene: Scene, t: Float[Array, ""], state: AnyState
) -> Float[Array, "3"]:
    """``J``, about the fixed origin, in absolute motion [kg m^2/s], FIXED axes."""
    contact = contact_of(scene, t, state)
    spin = contact_angular_momentum(scene, t, state)
    return spin + cross(contact.place, momentum(scene, t, state))


def moving_energy(
    scene: Scene, t: Float[Array, ""], state: AnyState
) -> Float[Array, ""]:
    """``E - v_Oc . P - w_c . J_Oc`` [J], with J about the base's origin.

    Constant on a base that turns and glides steadily along loads that it does not
    change, such as E - Omega J_z on a horizontal turntable. On a base at rest, E.
    """
    contact = contact_of(scene, t, state)
    value, base = energy(scene, t, state), contact.base
    if base is None:
        return value
    P = momentum(scene, t, state)
    if base.velocity is not None:
        value = value - dot(base.velocity, P)
    if base.angular_velocity is not None:
        arm = base.to_fixed(contact.base_point)
        J = contact_angular_momentum(scene, t, state) + cross(arm, P)
        value = value - dot(base.to_fixed(base.angular_velocity), J)
    return value


def power(scene: Scene, t: Float[Array, ""], state: AnyState) -> Float[Array, ""]:
    """Rate at which energy is given to the system [W].

    The contact force gives ``Rc . (j + U)`` (nothing where the body rolls on a base at
    rest, less than nothing by friction), the contact's moment ``M . w``, forces on the
    coordinates ``Q_s alpha'^s`` (springs with a potential excepted), forces of loads on
    the body (potentials excepted) theirs, and prescribed motions whatever they need. It
    is the rate of :func:`energy` exactly.

    Source: docs/theory.md, (6.3).
    """
    contact, carried, solution, force = solved(scene, t, state)
    w_dot, slid = solution.angular_acceleration, solution.slip_acceleration
    w, j = contact.angular_velocity, contact.point_velocity
    value = jnp.zeros_like(w[0])
    if j is not None:
        value = value + dot(j, force())
    if solution.moment is not None:
        value = value + dot(w, solution.moment)
    for load in scene.loads:
        wrench = load.wrench(t, scene.body, contact)
        stored = load.potential_energy(t, scene.body, contact)
        if wrench is not None and stored is None:
            value = value + dot(w, wrench[1])
            value = value if j is None else value + dot(j, wrench[0])
        given = load.generalized(scene, t, state)
        if given is not None:
            moves = jnp.stack(quasi_velocities(scene, t, state))
            value = value + dot(jnp.stack(given), moves)
    first = 0
    rates = components(solution.alpha_ddot)
    listed = zip(scene.shares(state), carried, strict=True)
    for (supported, *moving), masses in listed:
        own = rates[first : first + supported.count]
        first += supported.count
        given = _driven_power(masses, w_dot, slid, own)
        value = value if given is None else value + given
        given = supported.drive_power(t, *moving)
        value = value if given is None else value + given
    return value


def _driven_power(
    masses: Masses, turn: Array, slid: Array | None, accelerations: list[Array]
) -> Float[Array, ""] | None:
    """Power of the drives of prescribed motions [W]; None: there are none."""
    part = masses.part
    if part.driven is None:
        return None
    need = masses.inertial_force(turn, slid, accelerations)
    value = jnp.sum(dot(part.driven, need))
    for turning, torque in zip(part.turnings, masses.torques, strict=True):
        if turning.driven is None:
            continue
        push = turn
        for partial, rate in zip(turning.partials, accelerations, strict=True):
            push = push + rate * partial
        spin = matvec(turning.inertia, push) + torque
        value = value + dot(turning.driven, spin)
    return value


def normal_force(
    scene: Scene, t: Float[Array, ""], state: AnyState
) -> Float[Array, ""]:
    """Normal force [N]; negative where the contact would have to pull."""
    return press_and_pull(scene, t, state)[0]


def outward(scene: Scene, t: Float[Array, ""], state: AnyState) -> Float[Array, "3"]:
    """Unit normal out of the body at the contact [1], FIXED axes; NaN in flight."""
    contact = contact_of(scene, t, state)
    normal = matvec(contact.rotation, contact.normal)
    return normal if state.touches else jnp.full_like(normal, jnp.nan)


def friction_ratio(
    scene: Scene, t: Float[Array, ""], state: AnyState
) -> Float[Array, ""]:
    """Friction coefficient that rolling needs, ``|T| / N`` [1]; NaN in flight.

    Where nothing pulls along the surface its derivative is taken as zero.
    """
    if not state.touches:
        return jnp.full_like(t, jnp.nan)
    press, pull = press_and_pull(scene, t, state)
    return safe_norm(pull) / press


def kept_energy(scene: Scene) -> str:
    """Which energy a motion has to keep: "energy", "moving energy", or "" for none."""
    motion, field = scene.base.motion, field_of(scene.loads)
    if scene.does_work:
        return ""
    if motion is None:
        return "energy"
    fixed_in_space = any(load.is_fixed_in_space for load in scene.loads)
    if not motion.turns_steadily or fixed_in_space:
        return ""
    if field is not None:
        axis = np.asarray(motion.at(jnp.zeros((), field.dtype)).rotation)[:, 2]
        field = np.asarray(field)
        along = np.linalg.norm(np.cross(axis, field)) <= 1e-6 * np.linalg.norm(field)
        return "moving energy" if along else ""
    return "moving energy"
