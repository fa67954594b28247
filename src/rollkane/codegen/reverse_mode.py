"""Reverse mode on traced programs: of one, that of its arguments' cotangents.

Its equations forwards as far as they are needed, then back through them. As in
:mod:`.forward_mode`, the rules of rare operations are JAX's.
"""

from collections.abc import Sequence
from typing import Any, cast
from weakref import WeakKeyDictionary

import jax
import jax.numpy as jnp
from jaxtyping import Array

from .forward_rules import FIXED, Moves, moving
from .jaxpr_types import ClosedJaxpr, Equation, Variable
from .new_programs import (
    NewJaxpr,
    NewProgram,
    NewVariable,
    by_itself,
    is_float,
    is_literal,
    pruned,
    traced,
)
from .reverse_rules import RULES, Bar, Rule, WithBars
from .scalar_program import NotElementwiseError

_KEPT: WeakKeyDictionary[Any, dict[Any, NewProgram]] = WeakKeyDictionary()


def with_cotangents(program: ClosedJaxpr, moves: Moves, ends: Moves) -> NewProgram:
    """A program of the cotangents of a program's arguments.

    Args:
        program: One of JAX's.
        moves: Which of its arguments have one.
        ends: Of which of its results one is given, behind the arguments.

    Raises:
        NotElementwiseError: a loop of unknown length, of which there is no way back.
    """
    kept = _KEPT.setdefault(program.jaxpr, {})
    if (moves, ends) not in kept:
        kept[moves, ends] = Reverse(program).made(moves, ends)
    return kept[moves, ends]


class Reverse(WithBars):
    """A program as it is written, and its way back."""

    def __init__(self, program: ClosedJaxpr):
        """Of a program."""
        super().__init__()
        self.program = program
        self._bars: dict[Variable, Variable] = {}

    def made(self, moves: Moves, ends: Moves) -> NewProgram:
        """The whole."""
        jaxpr = self.program.jaxpr
        pairs = zip(jaxpr.invars, moves, strict=True)
        live = {v for v, moved in pairs if moved}
        for equation in jaxpr.eqns:
            if equation.primitive.name not in FIXED:
                known = any(not is_literal(v) and v in live for v in equation.invars)
                live.update(v for v in equation.outvars if known and is_float(v.aval))
        self.eqns += jaxpr.eqns
        given: list[Variable] = []
        for v, asked in zip(jaxpr.outvars, ends, strict=True):
            if asked:
                given.append(NewVariable(v.aval))
                self._add(v, given[-1], live)
        for equation in reversed(jaxpr.eqns):
            bars = [self._bars.pop(v, None) for v in equation.outvars]
            if any(x is not None for x in bars):
                self._back(equation, bars, live)
        outs = [
            self.known(self._bars.get(v), v.aval)
            for v, moved in zip(jaxpr.invars, moves, strict=True)
            if moved
        ]
        invars = [*jaxpr.invars, *given]
        new = NewJaxpr(jaxpr.constvars, invars, outs, pruned(self.eqns, outs))
        return NewProgram(new, list(self.program.consts))

    def _add(self, v: Variable, bar: Bar, live: set[Variable]) -> None:
        if bar is None or is_literal(v) or v not in live:
            return
        total = self.added(self._bars.get(v), bar)
        assert total is not None
        self._bars[v] = total

    def _back(self, equation: Equation, bars: list[Bar], live: set[Variable]) -> None:
        needs = tuple(not is_literal(v) and v in live for v in equation.invars)
        if not any(needs):
            return
        rule = _RULES.get(equation.primitive.name, _by_jax)
        found = rule(self, equation, bars, needs)
        for v, bar, needed in zip(equation.invars, found, needs, strict=True):
            if needed:
                self._add(v, bar, live)


# -- programs inside -----------------------------------------------------------------


def _known(bars: list[Bar]) -> list[Variable]:
    return [x for x in bars if x is not None]


def _in_places(found: Sequence[Bar], needs: Moves) -> list[Bar]:
    rest = iter(found)
    return [next(rest) if needed else None for needed in needs]


def _called(
    b: WithBars, equation: Equation, bars: list[Bar], needs: Moves
) -> list[Bar]:
    program = with_cotangents(equation.params["jaxpr"], needs, moving(bars))
    inputs = [*equation.invars, *_known(bars)]
    found = b.emit("jit", {"jaxpr": program}, inputs, *program.out_avals)
    return _in_places(found, needs)


def _branched(
    b: WithBars, equation: Equation, bars: list[Bar], needs: Moves
) -> list[Bar]:
    branches, ends = equation.params["branches"], moving(bars)
    made = tuple(with_cotangents(x, needs[1:], ends) for x in branches)
    inputs = [*equation.invars, *_known(bars)]
    found = b.emit("cond", {"branches": made}, inputs, *made[0].out_avals)
    return [None, *_in_places(found, needs[1:])]


def _looped(
    b: WithBars, equation: Equation, bars: list[Bar], needs: Moves
) -> list[Bar]:
    raise NotElementwiseError("the way back through a loop of unknown length")


# -- all others ----------------------------------------------------------------------


def _by_jax(
    b: WithBars, equation: Equation, bars: list[Bar], needs: Moves
) -> list[Bar]:
    """By JAX's own rule, traced."""
    alone = by_itself(b.program.jaxpr, equation)
    needed = {v for v, n in zip(equation.invars, needs, strict=True) if n}
    moves = tuple(v in needed for v in alone.inputs)
    ends, avals = moving(bars), [v.aval for v in equation.outvars]

    def pulled(*arrays: Array) -> Any:
        primals, given = arrays[: len(moves)], iter(arrays[len(moves) :])
        live = [x for x, m in zip(primals, moves, strict=True) if m]

        def run(*live: Array) -> Any:
            mixed = iter(live)
            pairs = zip(primals, moves, strict=True)
            outs = alone.function(*(next(mixed) if m else x for x, m in pairs))
            return [x for x, v in zip(outs, avals, strict=True) if is_float(v)]

        known: list[Array] = []
        for aval, shown in zip(avals, ends, strict=True):
            if is_float(aval):
                none = jnp.zeros(aval.shape, aval.dtype)
                known.append(next(given) if shown else none)
        return cast(Any, jax.vjp(run, *live)[1])(known)

    inputs = [*alone.inputs, *_known(bars)]
    program = traced(pulled, (v.aval for v in inputs))
    found = b.emit("jit", {"jaxpr": program}, inputs, *program.out_avals)
    own = dict(zip(alone.inputs, _in_places(found, moves), strict=True))
    # an input that stands at several places has its cotangent once
    return [
        own.pop(v, None) if n else None
        for v, n in zip(equation.invars, needs, strict=True)
    ]


_RULES: dict[str, Rule] = RULES | {
    "cond": _branched,
    "jit": _called,
    "pjit": _called,
    "while": _looped,
}
