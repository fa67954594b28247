"""Whipple's bicycle: rear frame with rider, front fork, two wheels, knife-edge rims.

Axes as in the benchmark: x forward, y to the right, z DOWN; the rear contact is the
origin while the bicycle stands upright and straight.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple, TypeAlias

import equinox as eqx
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from ..geometry.rotations import about_axis
from ..geometry.small_linear import cross
from .parts import Load, RigidBody
from .system import KaneState, KaneSystem

LEAN_AND_STEER = (3, 5)  # coordinates, for ``linearize``


_Time: TypeAlias = Float[Array, ""]
_Q: TypeAlias = Float[Array, "8"]
_U: TypeAlias = Float[Array, "6"]
_Vector: TypeAlias = Float[Array, "3"]


class Bicycle(eqx.Module):
    """Dimensions and masses; left out, those of the published benchmark.

    Attributes:
        wheel_base: w [m].
        trail: c [m].
        steer_tilt: lambda, of the steering axis from the vertical [rad].
        gravity: g [m/s^2].
        rear_radius: [m].
        rear_mass: [kg].
        rear_moments: Ixx, Iyy of the wheel, y along its axle [kg m^2], shape (2,).
        frame_mass_center: x, z of frame and rider [m], shape (2,).
        frame_mass: [kg].
        frame_inertia: Ixx, Iyy, Izz, Ixz (entries of the matrix) [kg m^2], shape (4,).
        fork_mass_center: x, z [m], shape (2,).
        fork_mass: [kg].
        fork_inertia: Ixx, Iyy, Izz, Ixz [kg m^2], shape (4,).
        front_radius: [m].
        front_mass: [kg].
        front_moments: Ixx, Iyy [kg m^2], shape (2,).
        steer_torque: Of the rider on the fork [N m], against the frame.

    Source: Meijaard, Papadopoulos, Ruina and Schwab (2007), table 1.
    """

    wheel_base: Any = 1.02
    trail: Any = 0.08
    steer_tilt: Any = math.pi / 10.0
    gravity: Any = 9.81
    rear_radius: Any = 0.3
    rear_mass: Any = 2.0
    rear_moments: Any = (0.0603, 0.12)
    frame_mass_center: Any = (0.3, -0.9)
    frame_mass: Any = 85.0
    frame_inertia: Any = (9.2, 11.0, 2.8, 2.4)
    fork_mass_center: Any = (0.9, -0.7)
    fork_mass: Any = 4.0
    fork_inertia: Any = (0.05892, 0.06, 0.00708, -0.00756)
    front_radius: Any = 0.35
    front_mass: Any = 3.0
    front_moments: Any = (0.1405, 0.28)
    steer_torque: Any = 0.0


def whipple_bicycle(bicycle: Bicycle | None = None) -> KaneSystem:
    """A bicycle as a system: eight coordinates, six speeds, three of them dependent.

    q = (x, y of the rear contact [m], yaw, lean, pitch, steer, turn of rear wheel, turn
    of front wheel [rad]); u = rates of the last six [rad/s]. Independent speeds: lean,
    steer, rear wheel (forward is NEGATIVE); pitch is the dependent coordinate. Lean and
    steer are positive to the right.

    Args:
        bicycle: Dimensions and masses, the system's parameters; None for the benchmark.
    """
    bicycle = Bicycle() if bicycle is None else bicycle
    parts = [
        RigidBody(_Mass("rear_mass"), _Moments("rear_moments"), _rear, _rear_spin),
        RigidBody(_Mass("frame_mass"), _Inertia("frame_inertia"), _frame, _frame_spin),
        RigidBody(_Mass("fork_mass"), _Inertia("fork_inertia"), _fork, _fork_spin),
        RigidBody(_Mass("front_mass"), _Moments("front_moments"), _front, _front_spin),
    ]
    weights = [Load(part.velocity, _Weight(part.mass)) for part in parts]
    return KaneSystem(
        8,
        6,
        _kinematics,
        parts,
        [*weights, Load(_steering, _steer_torque)],
        constraints=_front_slip,
        dependent=(0, 2, 5),
        configuration=_front_height,
        dependent_coordinates=(4,),
        parameters=bicycle,
        shared=_posture,
    )


def bicycle_state(speed: ArrayLike, bicycle: Bicycle | None = None) -> KaneState:
    """A bicycle that goes straight and upright.

    Args:
        speed: Forward [m/s].
        bicycle: Its dimensions; None for the benchmark.
    """
    bicycle = Bicycle() if bicycle is None else bicycle
    wheel = -jnp.asarray(speed, float) / bicycle.rear_radius
    still = jnp.zeros_like(wheel)
    return KaneState(jnp.zeros(8, wheel.dtype), jnp.stack([still, still, wheel]))


class _Posture(NamedTuple):
    """What the parts share; vectors on FIXED axes, their points from the rear contact.

    ``frame``, ``fork``: rotations to fixed axes. ``*_spin``: angular velocities.
    ``rear``, ``head``, ``front``: rear axle, foot of the steering axis, front axle.
    ``touching``: front contact.
    """

    bicycle: Bicycle
    frame: Float[Array, "3 3"]
    fork: Float[Array, "3 3"]
    steer_axis: Float[Array, "3"]
    frame_spin: Float[Array, "3"]
    fork_spin: Float[Array, "3"]
    rear_spin: Float[Array, "3"]
    front_spin: Float[Array, "3"]
    rear: Float[Array, "3"]
    head: Float[Array, "3"]
    front: Float[Array, "3"]
    touching: Float[Array, "3"]


def _posture(t: _Time, q: _Q, u: _U, bicycle: Bicycle) -> _Posture:
    w, c, tilt = bicycle.wheel_base, bicycle.trail, bicycle.steer_tilt
    r_rear, r_front = bicycle.rear_radius, bicycle.front_radius
    down = jnp.array([0.0, 0.0, 1.0], q.dtype)
    heading = about_axis(2, q[2])
    lean = heading @ about_axis(0, q[3])
    frame = lean @ about_axis(1, q[4])
    tilted = about_axis(1, tilt)  # the steering axis is its z
    fork = frame @ tilted @ about_axis(2, q[5]) @ tilted.T
    axis = (frame @ tilted)[:, 2]
    path, axle = heading[:, 0], lean[:, 1]
    frame_spin = u[0] * down + u[1] * path + u[2] * axle
    fork_spin = frame_spin + u[3] * axis
    rear = -r_rear * lean[:, 2]
    head = rear + frame @ _vector(w + c, r_rear)
    front = head + fork @ _vector(-c, -r_front)
    front_axle = fork[:, 1]
    in_wheel = down - front_axle[2] * front_axle
    return _Posture(
        bicycle,
        frame,
        fork,
        axis,
        frame_spin,
        fork_spin,
        frame_spin + u[4] * axle,
        fork_spin + u[5] * front_axle,
        rear,
        head,
        front,
        front + r_front * in_wheel / jnp.sqrt(jnp.sum(in_wheel * in_wheel)),
    )


def _kinematics(t: _Time, q: _Q, u: _U, now: _Posture) -> _Q:
    forward = -now.bicycle.rear_radius * (u[2] + u[4])
    return jnp.concatenate(
        [jnp.stack([forward * jnp.cos(q[2]), forward * jnp.sin(q[2])]), u]
    )


def _rear(t: _Time, q: _Q, u: _U, now: _Posture) -> _Vector:
    return cross(now.rear_spin, now.rear)


def _frame(t: _Time, q: _Q, u: _U, now: _Posture) -> _Vector:
    x, z = now.bicycle.frame_mass_center
    place = now.frame @ _vector(x, z + now.bicycle.rear_radius)
    return _rear(t, q, u, now) + cross(now.frame_spin, place)


def _head(t: _Time, q: _Q, u: _U, now: _Posture) -> _Vector:
    return _rear(t, q, u, now) + cross(now.frame_spin, now.head - now.rear)


def _fork(t: _Time, q: _Q, u: _U, now: _Posture) -> _Vector:
    x, z = now.bicycle.fork_mass_center
    foot = now.bicycle.wheel_base + now.bicycle.trail
    place = now.fork @ _vector(x - foot, z)
    return _head(t, q, u, now) + cross(now.fork_spin, place)


def _front(t: _Time, q: _Q, u: _U, now: _Posture) -> _Vector:
    return _head(t, q, u, now) + cross(now.fork_spin, now.front - now.head)


def _front_slip(t: _Time, q: _Q, u: _U, now: _Posture) -> _Vector:
    """Velocity of the front wheel's point at the ground: zero."""
    return _front(t, q, u, now) + cross(now.front_spin, now.touching - now.front)


def _front_height(t: _Time, q: _Q, u: _U, now: _Posture) -> Float[Array, "1"]:
    return now.touching[2:]


def _rear_spin(t: _Time, q: _Q, u: _U, now: _Posture) -> _Vector:
    return (now.frame @ about_axis(1, q[6])).T @ now.rear_spin


def _frame_spin(t: _Time, q: _Q, u: _U, now: _Posture) -> _Vector:
    return now.frame.T @ now.frame_spin


def _fork_spin(t: _Time, q: _Q, u: _U, now: _Posture) -> _Vector:
    return now.fork.T @ now.fork_spin


def _front_spin(t: _Time, q: _Q, u: _U, now: _Posture) -> _Vector:
    return (now.fork @ about_axis(1, q[7])).T @ now.front_spin


def _steering(t: _Time, q: _Q, u: _U, now: _Posture) -> _Vector:
    """Angular velocity of the fork against the frame."""
    return u[3] * now.steer_axis


def _steer_torque(t: _Time, q: _Q, u: _U, now: _Posture) -> _Vector:
    return now.bicycle.steer_torque * now.steer_axis


class _Of(eqx.Module):
    """A field of a bicycle."""

    name: str = eqx.field(static=True)


class _Mass(_Of):
    def __call__(self, bicycle: Bicycle) -> Array:
        return jnp.asarray(getattr(bicycle, self.name))


class _Inertia(_Of):
    def __call__(self, bicycle: Bicycle) -> Float[Array, "3 3"]:
        return _matrix(getattr(bicycle, self.name))


class _Moments(_Of):
    """Of a wheel."""

    def __call__(self, bicycle: Bicycle) -> Float[Array, "3 3"]:
        about_diameter, about_axle = (getattr(bicycle, self.name)[k] for k in (0, 1))
        return _matrix((about_diameter, about_axle, about_diameter, 0.0))


class _Weight(eqx.Module):
    mass: _Mass

    def __call__(self, t: _Time, q: _Q, u: _U, now: _Posture) -> _Vector:
        return self.mass(now.bicycle) * _vector(0.0, now.bicycle.gravity)


def _vector(x: ArrayLike, z: ArrayLike) -> _Vector:
    """In the plane of symmetry."""
    return jnp.stack([jnp.asarray(a, float) for a in (x, 0.0, z)])


def _matrix(entries: Sequence[ArrayLike] | Array) -> Float[Array, "3 3"]:
    xx, yy, zz, xz = (jnp.asarray(entries[k], float) for k in range(4))
    o = jnp.zeros_like(xx)
    rows = [[xx, o, xz], [o, yy, o], [xz, o, zz]]
    return jnp.stack([jnp.stack(row) for row in rows])
