"""Rate of the momentum, and accelerations of a point together with the others."""

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..geometry.small_linear import (
    Entry,
    Solver,
    components,
    cross,
    dot,
    factored_spd,
)
from ..kinematics.contact import Contact
from .mass_matrix import System
from .scene import Scene
from .supported import total


class Solution(NamedTuple):
    """Accelerations at one instant, vectors on BODY axes.

    Attributes:
        angular_acceleration: ``w'`` [rad/s^2].
        alpha_ddot: [unit of alpha / s^2], shape (n,).
        slip_acceleration: Part of the acceleration of the body's point at the contact
            that the forces determine, along the surface [m/s^2]; None: it rolls.
        moment: Of the contact on the body [N m]; None: none.
        margin: What the normal force is divided by [1]; where it is not positive no
            normal force fits (Painleve); None: nothing is proportional to it.
        turn: Slip times the rate at which friction turns it [m/s^2]; None: not asked.
    """

    angular_acceleration: Float[Array, "3"]
    alpha_ddot: Float[Array, " n"]
    slip_acceleration: Float[Array, "3"] | None = None
    moment: Float[Array, "3"] | None = None
    margin: Float[Array, ""] | None = None
    turn: Float[Array, ""] | None = None


class Momentum(NamedTuple):
    """Rate of the momentum, ``K + w' x S + columns alpha''``, on body axes.

    Attributes:
        mass: Of everything [kg].
        first_moment: ``S = sum m s`` about the contact point [kg m].
        known: K less the loads' forces [N]: what the contact force is without w',
            alpha'' and slip acceleration.
        columns: ``sum m dr/dalpha`` for each coordinate [kg m per unit].
    """

    mass: Float[Array, ""]
    first_moment: Float[Array, "3"]
    known: Float[Array, "3"]
    columns: list[Float[Array, "3"]]

    def force(self, solution: Solution) -> Float[Array, "3"]:
        """Contact force ``Rc = dP/dt - F`` [N], (6.2)."""
        value = self.known + cross(solution.angular_acceleration, self.first_moment)
        for column, rate in zip(
            self.columns, components(solution.alpha_ddot), strict=True
        ):
            value = value + rate * column
        if solution.slip_acceleration is not None:
            value = value + self.mass * solution.slip_acceleration
        return value


def momentum_rate(scene: Scene, contact: Contact, system: System) -> Momentum:
    """The rate of the momentum, as far as it is known, and what multiplies the rest.

    Source: docs/theory.md, (6.2).
    """
    w, c, mass = contact.angular_velocity, system.arm, scene.body.mass
    first = mass * c
    known = mass * (cross(w, cross(w, c)) + system.proper)
    if system.force is not None:
        known = known - system.force
    columns: list[Array] = []
    for part, s, drive, _ in system.masses:
        m = part.mass[None]
        first = first + total(m * s)
        known = known + total(drive)
        columns += [total(m * u) for u in part.partials]
        mass = mass + jnp.sum(part.mass)
    return Momentum(mass, first, known, columns)


def coupled_along(
    P: Momentum, directions: Sequence[Float[Array, "3"]]
) -> list[Sequence[Entry]]:
    """What couples a point's accelerations along directions to the others."""
    return [
        [*components(cross(P.first_moment, e)), *(dot(u, e) for u in P.columns)]
        for e in directions
    ]


def coupled_along_axes(P: Momentum) -> list[Sequence[Entry]]:
    """The same along the body's axes."""
    x, y, z = components(P.first_moment)
    turned = (None, z, -y), (-z, None, x), (y, -x, None)
    columns = list(map(components, P.columns))
    return [[*turned[k], *(u[k] for u in columns)] for k in range(3)]


def with_point(
    P: Momentum, system: System, couplings: Sequence[Sequence[Entry]]
) -> Solver:
    """Solves the system with accelerations of the reference point, its last unknowns.

    Which are eliminated first: they are coupled to all others, but not to one another.

    Args:
        P: Rate of the momentum.
        system: Mass matrix of the others.
        couplings: Of each such acceleration to the others.
    """
    d = len(couplings)
    first: list[list[Entry]] = [[*[None] * k, P.mass] for k in range(d)]
    others = [
        [*(coupling[i] for coupling in couplings), *row[: i + 1]]
        for i, row in enumerate(system.rows)
    ]
    solve = factored_spd([*first, *others])

    def in_order(rhs: Sequence[Entry]) -> list[Array]:
        x = solve([*rhs[-d:], *rhs[:-d]])
        return [*x[d:], *x[:d]]

    return in_order
