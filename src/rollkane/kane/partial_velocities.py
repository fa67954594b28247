"""Partial velocities of a system, and what follows from them alone.

Velocities are affine in the speeds, so that one derivative at rest gives every partial
velocity. Source: docs/theory.md, section 9.
"""

from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias, cast

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..validation.user_functions import GivenFunction
from .parts import RigidBody
from .system import KaneSystem


class Velocities(NamedTuple):
    """Something for each of a system's functions that are affine in the speeds."""

    points: list[Any]
    turnings: list[Any]
    on_loads: list[Any]
    constraints: Any
    kinematics: Any


_Both: TypeAlias = tuple[Velocities, Velocities]


class Partials(NamedTuple):
    """Velocities at rest, and their derivatives by the speeds."""

    at_rest: Velocities
    by_speeds: Velocities

    def at(self, name: str, u: Float[Array, " m"]) -> Any:
        """Values of one kind at given speeds."""
        rest, by_speeds = getattr(self.at_rest, name), getattr(self.by_speeds, name)

        def moved(v: Array, V: Array) -> Array:
            return v + V @ u

        return jax.tree.map(moved, rest, by_speeds)


def values_of(
    system: KaneSystem, t: Array, q: Float[Array, " n"], u: Float[Array, " m"]
) -> Velocities:
    """Of every function that is affine in the speeds."""
    functions = Velocities(
        [part.velocity for part in system.parts],
        [part.angular_velocity for part in turning_parts(system)],
        [load.velocity for load in system.loads],
        system.constraints,
        system.kinematics,
    )
    alone: Callable[[Any], bool] = lambda x: isinstance(x, GivenFunction)
    return jax.tree.map(evaluation(system, t, q, u), functions, is_leaf=alone)


def evaluation(
    system: KaneSystem, t: Array, q: Float[Array, " n"], u: Float[Array, " m"]
) -> Callable[[GivenFunction | None], Any]:
    """``of(f)``: what a function of the system's gives at a state; None of None.

    What its functions share is computed once.
    """
    more = system.more(t, q, u)
    return lambda f: None if f is None else f(t, q, u, more)


def partials_of(system: KaneSystem, t: Array, q: Float[Array, " n"]) -> Partials:
    """All partial velocities."""

    def of_speeds(u: Array) -> tuple[Velocities, Velocities]:
        values = values_of(system, t, q, u)
        return values, values

    rest = jnp.zeros(system.speeds + system.auxiliary, q.dtype)
    found = cast(_Both, jax.jacfwd(of_speeds, has_aux=True)(rest))
    by_speeds, at_rest = found
    return Partials(at_rest, by_speeds)


def masses_of(system: KaneSystem, partials: Partials) -> Float[Array, "m m"]:
    """Mass matrix of all speeds, auxiliary ones included."""
    by_speeds = partials.by_speeds
    size = by_speeds.kinematics.shape[1]
    masses = jnp.zeros((size, size), by_speeds.kinematics.dtype)
    turnings = iter(by_speeds.turnings)
    for part, V in zip(system.parts, by_speeds.points, strict=True):
        if isinstance(part, RigidBody):
            W = next(turnings)
            masses = masses + W.T @ (system.number(part.inertia) @ W)
        masses = masses + system.number(part.mass) * (V.T @ V)
    return masses


def energy_of(
    system: KaneSystem, partials: Partials, u: Float[Array, " m"]
) -> Float[Array, ""]:
    """Kinetic energy [J]."""
    twice = jnp.zeros((), u.dtype)
    turnings = iter(partials.at("turnings", u))
    for part, v in zip(system.parts, partials.at("points", u), strict=True):
        twice = twice + system.number(part.mass) * jnp.sum(v * v)
        if isinstance(part, RigidBody):
            w = next(turnings)
            twice = twice + jnp.sum(w * (system.number(part.inertia) @ w))
    return 0.5 * twice


def turning_parts(system: KaneSystem) -> list[RigidBody]:
    """Its rigid bodies."""
    return [part for part in system.parts if isinstance(part, RigidBody)]
