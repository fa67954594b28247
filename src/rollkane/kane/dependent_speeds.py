"""Whether constraints go on determining a motion as they did at its start.

Where the determinant of their part of the constraints passes zero, no equations of the
independent speeds are left: next to it they grow as one over its square, and a step
that jumps across has an error that its estimate does not see. Where a whole row passes
zero, as that of a rod as long as its crank, the determinant of rows of unit length says
nothing: motions part there, and an error of a step decides which one is followed. So
rates are NaN beyond either, at every stage of a step.

By multipliers no choice can fail, but constraints that come to follow from each other
can: motions part there as well (a parallelogram that is flat), and next to it the rates
of one turn into those of the other, by errors that are as small as one likes. What a
row adds to the others is a length without a sign: a step that looks at no such place
goes across, on the motion that it came by, and rates are NaN where one looks.
"""

import dataclasses
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..codegen.compile_effort import for_few_operations, stays_as_it_is
from ..validation.checks import is_traced
from ..validation.remembered import remembered
from .closure import kept
from .linear_solves import determinant, next_to
from .system import KaneState, KaneSystem

# Least singular value of rows of unit length that a start may have: rates of one with
# less are known to 1e-16 / 1e-12.
NEAR = 1e-6
# A motion's determinant may fall to three times the root of the tolerance, of what it
# began with: errors go with one over its square, and are a ninth of the rates there. Of
# tolerances above 1e-5 that would be much of what motions do: a hundredth is enough
_TIMES, _LOOSE = 3.0, 1e-2
# That counts for so many rows, a fourth root each: of many, all may become a little
# shorter, as those of a chain of 15 links do, and nothing is undetermined
_FEW = 4
# By multipliers, loose runs open what is closed by their tolerance, and turn off as far
# from the place as the root of that: of 1e-3 a hundredth is nearer
_TURNS = 0.1
# what a row adds to others is known to the root of roundings of its length, by squares:
# ten of them are told from none
_SQUARES = 10.0
# How near to either a run is stuck: steps of the clock, 1e-14 of it, are far below
_THERE = 1e-3
_KEPT = 16  # motions of a system


def on_its_side(
    system: KaneSystem,
    t: Any,
    state: KaneState,
    rtol: Any,
    by_speeds: Float[Array, "k m"] | None,
) -> KaneSystem:
    """A system whose rates are NaN beyond such a place, of a motion that begins here.

    Args:
        system: The system.
        t: Time [s].
        state: Coordinates and independent speeds.
        rtol: Relative tolerance of the motion [1].
        by_speeds: Derivatives of the constraints by all speeds, where they are known.
    """
    if not is_watched(system):
        return system
    if by_speeds is None:
        by_speeds = _by_speeds(system, t, state)
    loose = jnp.asarray(rtol, by_speeds.dtype)
    own = by_speeds[:, : system.speeds]
    if system.by_multipliers:
        largest = _TURNS if system.projection is None else _LOOSE
        return of_side(system, _alone(own, _TIMES * jnp.sqrt(loose), largest))
    return of_side(system, _side(own, system.dependent, loose))


def is_watched(system: KaneSystem) -> bool:
    """Whether there are constraints, by dependent speeds or by multipliers."""
    return system.constraints is not None


@for_few_operations
def _alone(
    C: Float[Array, "k m"], least: Float[Array, ""], largest: float
) -> Float[Array, " k"]:
    """What is multiplied by what rows add to others, which has to be larger than one.

    Args:
        C: Derivatives of the constraints by the speeds, at the start.
        least: Of what each adds there, what has to be left.
        largest: That it is at most.
    """
    added = _added(next_to(C))
    known = _SQUARES * float(np.finfo(C.dtype).eps) ** 0.5
    lengths = jnp.sqrt(jnp.sum(C * C, axis=1))
    side = 1.0 / jnp.maximum(jnp.minimum(least, largest) * added, known * lengths)
    return jax.lax.stop_gradient(jnp.where(jnp.isfinite(side), side, 0.0))


def _added(nearest: Float[Array, "m k"]) -> Float[Array, " k"]:
    """How long the part of each constraint is that is across all others."""
    return 1.0 / jnp.sqrt(jnp.sum(nearest * nearest, axis=0))


def share_by_multipliers(
    system: KaneSystem, nearest: Float[Array, "m k"]
) -> Float[Array, ""]:
    """What is smallest, of the least that a motion may have; below one it ends.

    Args:
        system: Of a motion.
        nearest: Least changes of the speeds that alter each constraint by one.
    """
    assert system.side is not None
    return jnp.min(_added(nearest) * system.side)


@for_few_operations
def _side(
    C: Float[Array, "k m"], dependent: tuple[int, ...], rtol: Float[Array, ""]
) -> Float[Array, " r"]:
    """What measures are multiplied by, so that they have to be larger than one."""
    least = jnp.minimum(_TIMES * jnp.sqrt(rtol), _LOOSE)
    powers = np.ones(1 + len(dependent))
    powers[0] = max(1.0, len(dependent) / _FEW)
    side = 1.0 / (least ** jnp.asarray(powers, C.dtype) * _measures(C, dependent))
    return jax.lax.stop_gradient(jnp.where(jnp.isfinite(side), side, 0.0))


def _measures(C: Float[Array, "k m"], dependent: tuple[int, ...]) -> Float[Array, " r"]:
    """Determinant of what rows of unit length have of the dependent speeds; lengths."""
    lengths = jnp.sqrt(jnp.sum(C * C, axis=1))
    bound = jnp.asarray(np.eye(C.shape[1])[:, list(dependent)], C.dtype)
    found = determinant((C / lengths[:, None]) @ bound)
    return jnp.concatenate([found[None], lengths])


def share_of(system: KaneSystem, C: Float[Array, "k m"]) -> Float[Array, ""]:
    """What is smallest, of the least that a motion may have; below one it ends."""
    assert system.side is not None
    own = C[:, : system.speeds]  # what a row has of auxiliary speeds holds nothing
    return jnp.min(_measures(own, system.dependent) * system.side)


def of_side(system: KaneSystem, side: Any) -> KaneSystem:
    """A system with constraints as a motion's; others as they are."""
    if not is_watched(system):
        return system
    if is_traced(side):
        return _with(system, side)
    known, key = _of_sides(system), np.asarray(side).tobytes()
    if key not in known:
        if len(known) >= _KEPT:
            known.clear()
        known[key] = _with(system, side)
    return known[key]


@remembered(stays_as_it_is)
def _of_sides(system: KaneSystem) -> dict[bytes, KaneSystem]:
    """A system's motions: of the same one what was looked up before is known."""
    del system
    return {}


def _with(system: KaneSystem, side: Any) -> KaneSystem:
    found = object.__new__(type(system))  # eqx.tree_at takes a millisecond
    for field in dataclasses.fields(system):
        own = side if field.name == "side" else getattr(system, field.name)
        object.__setattr__(found, field.name, own)
    return found


def with_as_many_numbers(system: KaneSystem) -> KaneSystem:
    """A system that has as many numbers as a motion's, by which faults are told."""
    determinants = 0 if system.by_multipliers else 1
    return of_side(system, np.zeros(determinants + system.constraint_count))


def undetermined(system: KaneSystem, t: Array, state: KaneState) -> Array:
    """Whether a run that got stuck did so as constraints do not determine it.

    Args:
        system: The system, of a motion.
        t: Time that was reached [s].
        state: State that was reached.
    """
    C = _by_speeds(system, t, state)
    if system.by_multipliers:
        share = share_by_multipliers(system, next_to(C[:, : system.speeds]))
    else:
        share = share_of(system, C)
    return ~(share > 1.0 + _THERE)


def _by_speeds(system: KaneSystem, t: Array, state: KaneState) -> Float[Array, "k m"]:
    """Derivatives of the constraints by all speeds."""
    assert system.constraints is not None
    constraints, q = system.constraints, kept(system, t, state.q)

    def violated(u: Array) -> Array:
        return system.at(constraints, t, q, u)

    rest = jnp.zeros(system.speeds + system.auxiliary, q.dtype)
    return cast(Array, jax.jacfwd(violated)(rest))
