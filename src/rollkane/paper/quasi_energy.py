"""Kinetic energy and angular momentum in quasi-velocities, and the applied forces.

What the Euler-Lagrange equations differentiate: functions of the configuration (q, qc,
theta, alpha, t) and the quasi-velocities. Vectors are on BODY axes.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..dynamics.abstract_supported import shares
from ..dynamics.bodies import inertia_about
from ..dynamics.mass_matrix import field_of
from ..dynamics.scene import Scene
from ..dynamics.supported import total
from ..geometry.small_linear import cross, dot, matmul, matvec, matvec_transposed
from ..kinematics.voronets import ChartContact, VoronetsState, charts_of


class Configuration(NamedTuple):
    """What the position of the whole system depends on.

    Attributes:
        q: Chart coordinates on the body, shape (2,).
        q_c: Chart coordinates on the base, shape (2,).
        theta: Angle [rad].
        alpha: Coordinates of what is carried, shape (n,).
        t: Time [s].
    """

    q: Float[Array, "2"]
    q_c: Float[Array, "2"]
    theta: Float[Array, ""]
    alpha: Float[Array, " n"]
    t: Float[Array, ""]


class Place(NamedTuple):
    """Where the contact is, and how the base moves there.

    Attributes:
        rho: Contact point from O [m], body axes.
        frame: ``E``, columns e1, e2, e3, body axes [1].
        j: Velocity of the base's material point [m/s], body axes.
    """

    rho: Float[Array, "3"]
    frame: Float[Array, "3 3"]
    j: Float[Array, "3"]


class Inertia(NamedTuple):
    """Mass properties of the WHOLE system about O, body axes.

    Attributes:
        mass: ``M`` [kg].
        r_C: Mass centre [m].
        Th: ``Theta^O`` [kg m^2], shape (3, 3).
        Q_r: Relative momentum [kg m/s].
        K_r: Relative angular momentum about O [kg m^2/s].
        T_r: Relative kinetic energy [J].
    """

    mass: Float[Array, ""]
    r_C: Float[Array, "3"]
    Th: Float[Array, "3 3"]
    Q_r: Float[Array, "3"]
    K_r: Float[Array, "3"]
    T_r: Float[Array, ""]


def place_of(scene: Scene, x: Configuration, sign: int) -> Place:
    """Contact point, frame and base velocity of a configuration.

    Source: [A] (1.3), (1.4); docs/theory.md, (1.5).
    """
    shell, ground, _, to_base = charts_of(
        scene.body.surface, scene.base.surface, x.q, x.q_c, x.theta, sign
    )
    motion = scene.base.motion
    f = None if motion is None else motion.at(x.t).velocity_at(ground.position)
    j = jnp.zeros_like(shell.position) if f is None else matvec_transposed(to_base, f)
    return Place(shell.position, shell.frame, j)


def inertia_of(
    scene: Scene, x: Configuration, alpha_dot: Float[Array, " n"]
) -> Inertia:
    """Mass properties of body and masses together, as (6.1) has them."""
    body = scene.body
    rows = inertia_about(body.mass, body.center_of_mass, body.inertia)
    Th = jnp.stack(
        [jnp.stack([rows[max(i, j)][min(i, j)] for j in range(3)]) for i in range(3)]
    )
    mass, first = body.mass, body.mass * body.center_of_mass
    Q_r = K_r = jnp.zeros_like(first)
    T_r = jnp.zeros_like(mass)
    for supported, alpha, rates in shares(scene.supported, x.alpha, alpha_dot):
        part = supported.carried(x.t, alpha, rates)
        m, r, v = part.mass[None], part.place, part.velocity
        mass = mass + jnp.sum(part.mass)
        first = first + total(m * r)
        identity = jnp.eye(3, dtype=r.dtype)
        Th = Th + jnp.sum(m * dot(r, r)[None]) * identity - matmul(m * r, r.T)
        Q_r = Q_r + total(m * v)
        K_r = K_r + total(m * cross(r, v))
        T_r = T_r + 0.5 * jnp.sum(m * v * v)
        for turning in part.turnings:
            own = matvec(turning.inertia, turning.velocity)
            Th = Th + turning.inertia
            K_r = K_r + own
            T_r = T_r + 0.5 * dot(turning.velocity, own)
    return Inertia(mass, first / mass, Th, Q_r, K_r, T_r)


def kinetic_energy_with_slip(
    scene: Scene,
    x: Configuration,
    U: Float[Array, "5"],
    alpha_dot: Float[Array, " n"],
    sign: int = -1,
) -> Float[Array, ""]:
    """``T'``, the kinetic energy without the constraints [J].

    Args:
        scene: What rolls on what.
        x: Configuration.
        U: Quasi-velocities: slip U^1, U^2 [m/s] and sigma, tau, n [rad/s].
        alpha_dot: Rates of the coordinates of what is carried.
        sign: ``s``.

    Source: [A] (1.14), second form; docs/theory.md, section 5.
    """
    place, body = place_of(scene, x, sign), inertia_of(scene, x, alpha_dot)
    rho, r_C, M = place.rho, body.r_C, body.mass
    w = matvec(place.frame, U[2:])
    Phi = matvec(place.frame[:, :2], U[:2]) + place.j
    ww, rw = dot(w, w), dot(rho, w)
    twice = (
        M * dot(Phi, Phi)
        - 2.0 * M * dot(Phi, cross(w, rho))
        + dot(w, matvec(body.Th, w))
        + M * dot(rho, rho) * ww
        - M * rw * rw
        + 2.0 * M * dot(Phi, cross(w, r_C))
        - 2.0 * M * (dot(r_C, rho) * ww - dot(r_C, w) * rw)
        + 2.0 * dot(Phi, body.Q_r)
        + 2.0 * dot(w, cross(body.Q_r, rho) + body.K_r)
        + 2.0 * body.T_r
    )
    return 0.5 * twice


def angular_momentum_about_contact(
    place: Place, body: Inertia, v: Float[Array, "3"]
) -> Float[Array, "3"]:
    """``m' = m + m'' = K^M`` [kg m^2/s], body axes.

    Args:
        place: Where the contact is.
        body: Mass properties.
        v: ``(sigma, tau, n)`` [rad/s].

    Source: [A] (1.15), (1.16); docs/theory.md, section 5.
    """
    rho, r_C, M = place.rho, body.r_C, body.mass
    w = matvec(place.frame, v)
    return (
        matvec(body.Th, w)
        + M * dot(rho, rho) * w
        - M * dot(rho, w) * rho
        - 2.0 * M * dot(r_C, rho) * w
        + M * dot(w, r_C) * rho
        + M * dot(w, rho) * r_C
        + cross(body.Q_r, rho)
        + body.K_r
        + M * cross(r_C - rho, place.j)
    )


def applied(
    scene: Scene, t: Float[Array, ""], state: VoronetsState, contact: ChartContact
) -> tuple[Float[Array, "3"], Float[Array, " n"]]:
    """``P'_k = m^M . e_k`` [N m] and ``Q_s`` [J per unit of alpha].

    Moment about the contact point of all applied forces, on (e1, e2, e3), and
    generalized forces.

    Source: [A] (2.7), (2.8); docs/theory.md, section 5.
    """
    field = field_of(scene.loads)
    g = None if field is None else matvec_transposed(contact.rotation, field)
    body = scene.body
    moment = jnp.zeros_like(contact.normal)
    if g is not None:
        c = body.center_of_mass - contact.body_point
        moment = cross(c, body.mass * g)
    for load in scene.loads:
        wrench = load.wrench(t, body, contact)
        moment = moment if wrench is None else moment + wrench[1]
    forces: list[Array] = []
    for supported, alpha, rates in scene.shares(state):
        part = supported.carried(t, alpha, rates)
        m, own = part.mass[None], supported.applied(t, alpha, rates)
        if g is not None:
            arm = total(m * (part.place - contact.body_point[:, None]))
            moment = moment + cross(arm, g)
        for a, u in enumerate(part.partials):
            force = jnp.zeros_like(contact.normal[0]) if own is None else own[a]
            forces.append(force if g is None else force + dot(total(m * u), g))
    Q = jnp.stack(forces) if forces else jnp.zeros(0, moment.dtype)
    return matvec_transposed(contact.shell.frame, moment), Q
