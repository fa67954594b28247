"""Systems that are ready: a free body, a bar on a frame, Kane's babyboot, a disc."""

from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..geometry.rotations import about_axis
from ..geometry.small_linear import cross
from ..validation.checks import FieldError
from .parts import Load, RigidBody
from .system import KaneState, KaneSystem, Motion, Numbers

# A parameter: a number, or an array without axes.
Number: TypeAlias = float | Array
_Vector: TypeAlias = Callable[[Array, Array, Array], Array]


def euler_parameters_to_rotation(e: Float[Array, "4"]) -> Float[Array, "3 3"]:
    """Body to fixed axes [1] from Euler parameters.

    Args:
        e: Euler parameters [1], SCALAR LAST, shape (4,).

    Source: [B], the transpose of [R]; docs/theory.md, (4.5).
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
    mass: Number,
    inertia: Numbers,
    force: Motion | None = None,
    torque: Motion | None = None,
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

    def kinematics(t: Array, q: Array, u: Array) -> Array:
        R = euler_parameters_to_rotation(q[3:])
        e, s, w = q[3:6], q[6], u[3:]
        turned = 0.5 * (s * w + cross(e, w))
        return jnp.concatenate([R @ u[:3], turned, -0.5 * jnp.sum(e * w)[None]])

    velocity: _Vector = lambda t, q, u: u[:3]
    spin: _Vector = lambda t, q, u: u[3:]
    loads = [] if force is None else [Load(velocity, force)]
    loads += [] if torque is None else [Load(spin, torque)]
    part = RigidBody(mass, inertia, velocity, spin, own_axes=True)
    return KaneSystem(7, 6, kinematics, [part], loads)


def bar_on_frame(
    mass: Number,
    length: Number,
    distance: Number,
    frame_torque: Motion,
    bar_torque: Motion,
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

    def velocity(t: Array, q: Array, u: Array) -> Array:
        return u[0] * jnp.stack([-jnp.sin(q[0]), jnp.cos(q[0]), 0.0 * q[0]])

    def bar_spin(t: Array, q: Array, u: Array) -> Array:
        turn = u[0] / distance
        return jnp.stack([-turn * jnp.sin(q[1]), u[1], turn * jnp.cos(q[1])])

    def frame_spin(t: Array, q: Array, u: Array) -> Array:
        return jnp.stack([0.0 * u[0], 0.0 * u[0], u[0] / distance])

    def on_bar(t: Array, q: Array, u: Array) -> Array:
        return bar_torque(t, q, u) * jnp.array([0.0, 1.0, 0.0])

    def on_frame(
        t: Array, q: Array, u: Array
    ) -> Array:  # n2 of the frame is e2 of the bar; k has no share of it
        return frame_torque(t, q, u) * jnp.array([0.0, 0.0, 1.0]) - on_bar(t, q, u)

    part = RigidBody(
        mass, jnp.diag(jnp.array([0.0, 1.0, 1.0])) * moment, velocity, bar_spin
    )
    loads = [Load(bar_spin, on_bar), Load(frame_spin, on_frame)]
    kinematics: _Vector = lambda t, q, u: jnp.stack([u[0] / distance, u[1]])
    return KaneSystem(2, 2, kinematics, [part], loads)


def babyboot(
    rod_mass: Number = 0.01,
    plate_mass: Number = 0.1,
    rod_length: Number = 0.075,
    plate_length: Number = 0.2,
    rod_moment: Number = 5e-6,
    plate_moments: Sequence[float] | Array | np.ndarray = (2.5e-4, 5e-5, 2e-4),
    gravity: Number = 9.81,
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

    def at(length: Number) -> _Vector:
        def velocity(t: Array, q: Array, u: Array) -> Array:
            along = jnp.stack([0.0 * q[0], jnp.cos(q[0]), jnp.sin(q[0])])
            return length * u[0] * along

        return velocity

    def weight(mass: Number) -> _Vector:
        return lambda t, q, u: mass * gravity * jnp.array([0.0, 0.0, -1.0])

    rod_spin: _Vector = lambda t, q, u: jnp.stack([u[0], 0.0 * u[0], 0.0 * u[0]])

    def plate_spin(t: Array, q: Array, u: Array) -> Array:
        return jnp.stack([u[0] * jnp.cos(q[1]), -u[0] * jnp.sin(q[1]), u[1]])

    rates: _Vector = lambda t, q, u: u
    rod, plate = at(rod_length), at(plate_length)
    parts = [
        RigidBody(rod_mass, rod_moment * np.eye(3), rod, rod_spin),
        RigidBody(plate_mass, _diagonal(plate_moments), plate, plate_spin),
    ]
    loads = [Load(rod, weight(rod_mass)), Load(plate, weight(plate_mass))]
    return KaneSystem(2, 2, rates, parts, loads)


DISC_SPEEDS = ("coordinate rates", "lean axes", "body axes")


def rolling_disc(
    mass: Number,
    radius: Number,
    moments: Sequence[float] | Array | np.ndarray,
    speeds: str = "coordinate rates",
    gravity: Number = 9.81,
) -> KaneSystem:
    """A thin disc that rolls on a plane, by one of three choices of speeds.

    q = (x, y of the contact point [m], heading, lean, spin about the axle [rad]); the
    disc stands upright at lean 0 and lies flat at pi/2. u [rad/s] is

    * ``"coordinate rates"``: heading', lean', spin';
    * ``"lean axes"``: angular velocity along the path, the axle, and the radius away
      from the contact;
    * ``"body axes"``: angular velocity on axes fixed in the disc, the second its axle.

    Args:
        mass: [kg].
        radius: [m].
        moments: About a diameter and about the axle [kg m^2], shape (2,).
        speeds: One of ``DISC_SPEEDS``.
        gravity: [m/s^2].

    Raises:
        FieldError: another choice of speeds.
    """
    _known_speeds("rolling_disc.speeds", speeds)
    across, along = moments

    def rates(q: Array, u: Array) -> Array:
        """Heading', lean', spin'; singular where the disc lies flat."""
        if speeds == "coordinate rates":
            return u
        path, axle, radial = u if speeds == "lean axes" else about_axis(1, q[4]) @ u
        heading = radial / jnp.cos(q[3])
        return jnp.stack([heading, path, axle - heading * jnp.sin(q[3])])

    def on_lean_axes(q: Array, u: Array) -> Array:
        if speeds == "body axes":
            return about_axis(1, q[4]) @ u
        return u if speeds == "lean axes" else _on_lean_axes(q, u)

    def kinematics(t: Array, q: Array, u: Array) -> Array:
        turned = rates(q, u)
        path = radius * turned[2] * jnp.stack([jnp.cos(q[2]), jnp.sin(q[2])])
        return jnp.concatenate([path, turned])

    def spin(t: Array, q: Array, u: Array) -> Array:
        return about_axis(1, q[4]).T @ on_lean_axes(q, u)

    def velocity(t: Array, q: Array, u: Array) -> Array:
        w = on_lean_axes(q, u)
        to_fixed = about_axis(2, q[2]) @ about_axis(0, q[3])
        return to_fixed @ (radius * jnp.stack([w[1], -w[0], 0.0 * w[2]]))

    inertia = _diagonal([across, along, across])
    weight: _Vector = lambda t, q, u: mass * gravity * jnp.array([0.0, 0.0, -1.0])
    part = RigidBody(mass, inertia, velocity, spin)
    return KaneSystem(5, 3, kinematics, [part], [Load(velocity, weight)])


def disc_state(
    q: Numbers,
    rates: Numbers,
    speeds: str = "coordinate rates",
) -> KaneState:
    """A state of ``rolling_disc`` from its coordinates and their rates.

    Args:
        q: x, y of the contact point [m], heading, lean, spin [rad].
        rates: heading', lean', spin' [rad/s].
        speeds: One of ``DISC_SPEEDS``.

    Raises:
        FieldError: another choice of speeds.
    """
    _known_speeds("disc_state.speeds", speeds)
    q, u = jnp.asarray(q, float), jnp.asarray(rates, float)
    if speeds != "coordinate rates":
        u = _on_lean_axes(q, u)
    if speeds == "body axes":
        u = about_axis(1, q[4]).T @ u
    return KaneState(q, u)


def _on_lean_axes(q: Float[Array, "5"], rates: Float[Array, "3"]) -> Float[Array, "3"]:
    heading, lean, spin = rates
    along = heading * jnp.sin(q[3])
    return jnp.stack([lean, spin + along, heading * jnp.cos(q[3])])


def _known_speeds(field: str, speeds: str) -> None:
    if speeds not in DISC_SPEEDS:
        raise FieldError(
            field, speeds, "is no choice of speeds", f"take one of {DISC_SPEEDS}"
        )


def _diagonal(moments: Sequence[Any] | Array | np.ndarray) -> list[list[Any]]:
    """A tensor of moments, some of which may be traced."""
    return [
        [moment if i == j else 0.0 for j in range(len(moments))]
        for i, moment in enumerate(moments)
    ]
