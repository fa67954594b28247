"""Systems that are ready: a free body, a bar on a frame, Kane's babyboot, a disc."""

from collections.abc import Callable

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .system import KaneSystem, Load, RigidBody


def euler_parameters_to_rotation(e: Float[Array, "4"]) -> Float[Array, "3 3"]:
    """Body to fixed axes [1] from Euler parameters, SCALAR LAST.

    Source: [B], the transpose of [R]; theory, section 8a.
    """
    e1, e2, e3, e4 = e[0], e[1], e[2], e[3]
    squares = e * e
    rows = [
        [
            squares[0] - squares[1] - squares[2] + squares[3],
            2.0 * (e1 * e2 - e3 * e4),
            2.0 * (e1 * e3 + e2 * e4),
        ],
        [
            2.0 * (e1 * e2 + e3 * e4),
            -squares[0] + squares[1] - squares[2] + squares[3],
            2.0 * (e2 * e3 - e1 * e4),
        ],
        [
            2.0 * (e1 * e3 - e2 * e4),
            2.0 * (e2 * e3 + e1 * e4),
            -squares[0] - squares[1] + squares[2] + squares[3],
        ],
    ]
    return jnp.stack([jnp.stack(row) for row in rows])


def free_rigid_body(
    mass, inertia, force: Callable | None = None, torque: Callable | None = None
) -> KaneSystem:
    """A free rigid body: 13 first-order equations.

    q = (x, y, z of the mass centre [m], Euler parameters, scalar last); u = (velocity
    of the mass centre [m/s], angular velocity [rad/s]), both on BODY axes.

    Args:
        mass: [kg].
        inertia: About the mass centre [kg m^2], shape (3, 3).
        force: ``force(t, q, u)`` at the mass centre [N], body axes; None for none.
        torque: ``torque(t, q, u)`` [N m], body axes; None for none.

    Source: [B], example 1, (1) to (3).
    """

    def kinematics(t, q, u):
        R = euler_parameters_to_rotation(q[3:])
        e, s, w = q[3:6], q[6], u[3:]
        turned = 0.5 * (s * w + jnp.cross(e, w))
        return jnp.concatenate([R @ u[:3], turned, -0.5 * jnp.sum(e * w)[None]])

    velocity, spin = (lambda t, q, u: u[:3]), (lambda t, q, u: u[3:])
    loads = [] if force is None else [Load(velocity, force)]
    loads += [] if torque is None else [Load(spin, torque)]
    part = RigidBody(mass, inertia, velocity, spin, own_axes=True)
    return KaneSystem(7, 6, kinematics, [part], loads)


def bar_on_frame(
    mass, length, distance, frame_torque: Callable, bar_torque: Callable
) -> KaneSystem:
    """A bar hinged on a massless frame that turns about the vertical, with two motors.

    q = (phi of the frame, theta of the bar) [rad]; u = (speed of the bar's centre
    [m/s], theta' [rad/s]).

    Args:
        mass: Of the bar [kg].
        length: Of the bar [m].
        distance: Of its centre from the vertical axis [m].
        frame_torque: ``M_phi(t, q, u)`` between ground and frame [N m], a number.
        bar_torque: ``M_theta(t, q, u)`` between frame and bar [N m], a number.

    Source: [B], example 2, (4) to (6).
    """
    moment = mass * length**2 / 12.0

    def velocity(t, q, u):
        return u[0] * jnp.stack([-jnp.sin(q[0]), jnp.cos(q[0]), 0.0 * q[0]])

    def bar_spin(t, q, u):
        turn = u[0] / distance
        return jnp.stack([-turn * jnp.sin(q[1]), u[1], turn * jnp.cos(q[1])])

    def frame_spin(t, q, u):
        return jnp.stack([0.0 * u[0], 0.0 * u[0], u[0] / distance])

    def on_bar(t, q, u):
        return bar_torque(t, q, u) * jnp.array([0.0, 1.0, 0.0])

    def on_frame(t, q, u):  # n2 of the frame is e2 of the bar; k has no share of it
        return frame_torque(t, q, u) * jnp.array([0.0, 0.0, 1.0]) - on_bar(t, q, u)

    part = RigidBody(
        mass, jnp.diag(jnp.array([0.0, 1.0, 1.0])) * moment, velocity, bar_spin
    )
    loads = [Load(bar_spin, on_bar), Load(frame_spin, on_frame)]
    kinematics = lambda t, q, u: jnp.stack([u[0] / distance, u[1]])
    return KaneSystem(2, 2, kinematics, [part], loads)


def babyboot(
    rod_mass=0.01,
    plate_mass=0.1,
    rod_length=0.075,
    plate_length=0.2,
    rod_moment=5e-6,
    plate_moments=(2.5e-4, 5e-5, 2e-4),
    gravity=9.81,
) -> KaneSystem:
    """Kane's babyboot: a plate that turns about a swinging rod; chaotic.

    q = (qA of the rod from the vertical, qB of the plate about the rod) [rad], u = q'.

    Args:
        rod_mass: [kg].
        plate_mass: [kg].
        rod_length: From the hinge to the rod's mass centre [m].
        plate_length: From the hinge to the plate's mass centre [m].
        rod_moment: About the hinge's direction, through the rod's centre [kg m^2].
        plate_moments: About the plate's axes; the third is along the rod [kg m^2].
        gravity: [m/s^2].
    """

    def at(length):
        def velocity(t, q, u):
            along = jnp.stack([0.0 * q[0], jnp.cos(q[0]), jnp.sin(q[0])])
            return length * u[0] * along

        return velocity

    def weight(mass):
        return lambda t, q, u: mass * gravity * jnp.array([0.0, 0.0, -1.0])

    rod_spin = lambda t, q, u: jnp.stack([u[0], 0.0 * u[0], 0.0 * u[0]])

    def plate_spin(t, q, u):
        return jnp.stack([u[0] * jnp.cos(q[1]), -u[0] * jnp.sin(q[1]), u[1]])

    rod, plate = at(rod_length), at(plate_length)
    parts = [
        RigidBody(rod_mass, rod_moment * np.eye(3), rod, rod_spin),
        RigidBody(plate_mass, np.diag(plate_moments), plate, plate_spin),
    ]
    loads = [Load(rod, weight(rod_mass)), Load(plate, weight(plate_mass))]
    return KaneSystem(2, 2, lambda t, q, u: u, parts, loads)
