"""Rigid bodies that nothing holds: what rolling contacts are put between."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array

from ..geometry.rotations import quaternion_rates, rotation_matrix
from ..validation.checks import FieldError, is_traced, real
from .contact_system import Frame
from .parts import Load, RigidBody
from .system import KaneSystem
from .system_arguments import in_a_row


class FreeBodies(NamedTuple):
    """Bodies that nothing holds.

    Attributes:
        system: Coordinates of each body: its mass centre [m], fixed axes, and its
            quaternion, scalar first, body to fixed [1]; speeds: its velocity [m/s] and
            angular velocity [rad/s], both on FIXED axes.
        frames: Axes of each, for contacts.
    """

    system: KaneSystem
    frames: tuple[Frame, ...]


def free_bodies(
    masses: Sequence[ArrayLike],
    inertias: Sequence[Any],
    gravity: Any = (0.0, 0.0, -9.81),
) -> FreeBodies:
    """Bodies that nothing holds, with a quaternion each: 7 coordinates, 6 speeds.

    Args:
        masses: Of each body [kg].
        inertias: About its mass centre, on its own axes [kg m^2], (3, 3) each.
        gravity: [m/s^2], fixed axes, shape (3,).

    Raises:
        FieldError: another number of inertias than of masses; functions; what
            ``KaneSystem`` raises.
    """
    masses = in_a_row("free_bodies.masses", masses)
    inertias = in_a_row("free_bodies.inertias", inertias)
    if len(masses) != len(inertias):
        raise FieldError(
            "free_bodies.inertias",
            len(inertias),
            "are not as many as masses",
            "give one for each body",
        )
    for name, numbers in (("masses", masses), ("inertias", inertias)):
        _refuse_functions(f"free_bodies.{name}", numbers)
    g = real("free_bodies.gravity", gravity, (3,), "three accelerations [m/s^2]")
    count = len(masses)
    parts = [
        RigidBody(mass, inertia, _Velocity(k), _Spin(k))
        for k, (mass, inertia) in enumerate(zip(masses, inertias, strict=True))
    ]
    loads: list[Load] = []
    if is_traced(g) or np.any(np.asarray(g)):
        loads = [Load(part.velocity, _Weight(part.mass * g)) for part in parts]
    system = KaneSystem(7 * count, 6 * count, _kinematics, parts, loads)
    frames = [Frame(_Position(k), _Rotation(k)) for k in range(count)]
    return FreeBodies(system, tuple(frames))


def _refuse_functions(field: str, given: tuple[Any, ...]) -> None:
    for k, number in enumerate(given):
        if callable(number):
            raise FieldError(
                f"{field}[{k}]",
                number,
                "is a function, and free bodies have no parameters for it to take",
                "give a number, or write a KaneSystem(parameters=...) for its bodies",
            )


def _kinematics(t: Array, q: Array, u: Array) -> Array:
    rates: list[Array] = []
    for k in range(q.shape[0] // 7):
        turn = q[7 * k + 3 : 7 * k + 7]
        own = rotation_matrix(turn).T @ u[6 * k + 3 : 6 * k + 6]
        rates += [u[6 * k : 6 * k + 3], quaternion_rates(turn, own)]
    return jnp.concatenate(rates)


class _OfBody(eqx.Module):
    """Something of the k-th body."""

    k: int = eqx.field(static=True)


class _Position(_OfBody):
    def __call__(self, t: Array, q: Array, u: Array) -> Array:
        return q[7 * self.k : 7 * self.k + 3]


class _Rotation(_OfBody):
    def __call__(self, t: Array, q: Array, u: Array) -> Array:
        return rotation_matrix(q[7 * self.k + 3 : 7 * self.k + 7])


class _Velocity(_OfBody):
    """Of the mass centre [m/s], fixed axes."""

    def __call__(self, t: Array, q: Array, u: Array) -> Array:
        return u[6 * self.k : 6 * self.k + 3]


class _Spin(_OfBody):
    def __call__(self, t: Array, q: Array, u: Array) -> Array:
        R = rotation_matrix(q[7 * self.k + 3 : 7 * self.k + 7])
        return R.T @ u[6 * self.k + 3 : 6 * self.k + 6]


class _Weight(eqx.Module):
    """Force of gravity [N]."""

    force: Array

    def __call__(self, t: Array, q: Array, u: Array) -> Array:
        return self.force
