"""Rolling with many coordinates, each of which moves few of the masses.

Coordinates of different parts, or of different masses of one part, meet only through
the body: they are eliminated part by part, mass by mass (static condensation), and what
is left is a system for the angular acceleration alone (docs/theory.md, (4.3)). Its time
grows with their number, not with its cube.
"""

from collections.abc import Callable
from typing import NamedTuple, TypeAlias

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..geometry.small_linear import components, cross, dot, matvec, solve_spd
from ..kinematics.contact import Contact
from ..kinematics.voronets import AnyState
from .abstract_supported import AbstractSupported, rolling_parts
from .carried import without_columns
from .coordinate_functions import FEW
from .mass_matrix import (
    Masses,
    System,
    inertia_rows,
    masses_of,
    of_the_body,
    with_generalized,
)
from .momentum import Solution, momentum_rate
from .scene import Scene
from .supported import total

_TURN = 3  # unknowns of the body: its angular acceleration
_Sum: TypeAlias = Callable[[Array], Array]
_same: _Sum = lambda x: x


def condenses(scene: Scene) -> bool:
    """Whether a scene's coordinates are many and can be eliminated apart."""
    law = scene.contact
    plain = law.touches and not (law.slips or law.without_spin)
    if not plain or any(load.needs_normal_force for load in scene.loads):
        return False
    if rolling_parts(scene.supported):
        return False
    if sum(part.count for part in scene.supported) <= FEW:
        return False
    return all(_together(part) <= FEW for part in scene.supported)


def _together(part: AbstractSupported) -> int:
    """How many coordinates of a part are solved for together."""
    if part.count <= FEW:
        return part.count
    apart = part.apart
    return part.count if apart is None else apart.each


class _Eliminated(NamedTuple):
    """Accelerations of a part's coordinates, ``free - by_turn w'``.

    Attributes:
        free: Of every coordinate; where they are apart, of the first one of all masses,
            of the second one, ...
        by_turn: The same, for each component of w'.
    """

    free: list[Array]
    by_turn: list[list[Array]]

    def accelerations(self, turn: list[Array]) -> list[Array]:
        """Those for an angular acceleration."""
        found = self.free
        for column, rate in zip(self.by_turn, turn, strict=True):
            found = [x - y * rate for x, y in zip(found, column, strict=True)]
        return found


class Condensed(NamedTuple):
    """Accelerations of a scene that rolls, found part by part.

    Attributes:
        solution: Angular acceleration and alpha''.
        system: Of the body; what is carried, with columns as :class:`_Eliminated`.
        by_part: Accelerations that belong to those columns.
    """

    solution: Solution
    system: System
    by_part: list[list[Array]]

    def force(self, scene: Scene, contact: Contact) -> Float[Array, "3"]:
        """Contact force [N], BODY axes; (6.2)."""
        still = [m._replace(part=without_columns(m.part)) for m in self.system.masses]
        P = momentum_rate(scene, contact, self.system._replace(masses=tuple(still)))
        value = P.known + cross(self.solution.angular_acceleration, P.first_moment)
        for masses, rates in zip(self.system.masses, self.by_part, strict=True):
            part = masses.part
            for u, rate in zip(part.partials, rates, strict=True):
                value = value + total((part.mass * rate)[None] * u)
        return value


def condensed(
    scene: Scene, t: Float[Array, ""], state: AnyState, contact: Contact
) -> Condensed:
    """Accelerations of a scene that :func:`condenses`, and what they follow from.

    Args:
        scene: What rolls on what.
        t: Time [s].
        state: Its state.
        contact: Its contact.

    Source: docs/theory.md, (4.3), solved for alpha'' first.
    """
    system = of_the_body(scene, t, contact)
    rows, right = system.rows, system.rhs
    parts = list(scene.shares(state))
    unknowns = _TURN + sum(part.count for part, *_ in parts)
    zeros = [jnp.zeros_like(right[0])] * unknowns
    further = with_generalized(zeros, scene, t, state)
    right = [a + b for a, b in zip(right, further[:_TURN], strict=True)]
    further = further[_TURN:]
    carried: list[Masses] = []
    eliminated: list[_Eliminated] = []
    aparts = [part.apart if part.count > FEW else None for part, *_ in parts]
    for (part, alpha, alpha_dot), apart in zip(parts, aparts, strict=True):
        own = part.carried_apart(apart, t, alpha, alpha_dot)
        masses = masses_of(own, contact, system.proper)
        pushes, further = further[: part.count], further[part.count :]
        applied = part.applied(t, alpha, alpha_dot)
        if applied is not None:
            pushes = [a + b for a, b in zip(pushes, applied, strict=True)]
        by_mass = apart is not None
        if by_mass:
            pushes = apart.split(jnp.stack(pushes))
        rows, right, found = _without(rows, right, masses, pushes, by_mass)
        carried.append(masses)
        eliminated.append(found)
    turn = solve_spd(rows, right)
    by_part = [found.accelerations(turn) for found in eliminated]
    rates = [
        jnp.stack(own) if apart is None else apart.joined(own)
        for apart, own in zip(aparts, by_part, strict=True)
        if own
    ]
    solution = Solution(jnp.stack(turn), jnp.concatenate(rates))
    return Condensed(solution, system._replace(masses=tuple(carried)), by_part)


def _without(
    rows: list[list[Array]],
    right: list[Array],
    masses: Masses,
    pushes: list[Array],
    by_mass: bool,
) -> tuple[list[list[Array]], list[Array], _Eliminated]:
    """The body's system with a part whose coordinates are eliminated."""
    part, s, drive, torques = masses
    moment = total(cross(s, drive))
    for torque in torques:
        moment = moment + torque
    inertias = [turning.inertia for turning in part.turnings]
    added = inertia_rows(part.mass, s, inertias)
    rows = [
        [a + b for a, b in zip(*pair, strict=True)]
        for pair in zip(rows, added, strict=True)
    ]
    right = [a - b for a, b in zip(right, components(moment), strict=True)]
    coupling, matrix, pushes = _blocks(masses, pushes, by_mass)
    if not pushes:
        return rows, right, _Eliminated([], [[]] * _TURN)
    columns = [[c[i] for c in coupling] for i in range(_TURN)]
    free, *by_turn = _solutions(matrix, [pushes, *columns])
    summed: _Sum = jnp.sum if by_mass else _same

    def product(i: int, column: list[Array]) -> Array:
        terms = [c[i] * x for c, x in zip(coupling, column, strict=True)]
        return summed(sum(terms[1:], terms[0]))

    rows = [
        [x - product(i, by_turn[j]) for j, x in enumerate(row)]
        for i, row in enumerate(rows)
    ]
    right = [x - product(i, free) for i, x in enumerate(right)]
    return rows, right, _Eliminated(free, by_turn)


def _solutions(
    matrix: list[list[Array]], columns: list[list[Array]]
) -> list[list[Array]]:
    """Of one system for several right-hand sides."""
    if len(matrix) == 1:
        inverse = 1.0 / matrix[0][0]
        return [[inverse * x for x in column] for column in columns]
    return [solve_spd(matrix, column) for column in columns]


def _blocks(
    masses: Masses, pushes: list[Array], by_mass: bool
) -> tuple[list[list[Array]], list[list[Array]], list[Array]]:
    """Of each coordinate: its columns to w', the matrix by rows, what drives it."""
    part, s, drive, torques = masses
    summed: _Sum = _same if by_mass else jnp.sum
    vector: _Sum = _same if by_mass else total
    coupling: list[list[Array]] = []
    matrix: list[list[Array]] = []
    driven: list[Array] = []
    moved = [part.mass[None] * u for u in part.partials]
    for a, (u, push) in enumerate(zip(part.partials, moved, strict=True)):
        column = vector(cross(s, push))
        row = [summed(dot(push, part.partials[b])) for b in range(a + 1)]
        value = pushes[a] - summed(dot(u, drive))
        for turning, torque in zip(part.turnings, torques, strict=True):
            stored = matvec(turning.inertia, turning.partials[a])
            column = column + stored
            value = value - dot(turning.partials[a], torque)
            row = [x + dot(stored, turning.partials[b]) for b, x in enumerate(row)]
        coupling.append(components(column))
        matrix.append(row)
        driven.append(value)
    return coupling, matrix, driven
