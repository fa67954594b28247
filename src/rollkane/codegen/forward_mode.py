"""Forward mode on traced programs: of one, that of its values and their tangents.

The rules of frequent operations are written here; those of others are JAX's, which
traces them one by one. What does not move has no tangent, and so no equation.
"""

from typing import Any
from weakref import WeakKeyDictionary

import jax
from jaxtyping import Array

from .forward_loops import LOOPS
from .forward_rules import (
    FIXED,
    RULES,
    Dot,
    Moves,
    WithDots,
    WithTangents,
    moving,
    only,
)
from .jaxpr_types import ClosedJaxpr, Equation, Variable
from .new_programs import (
    NewJaxpr,
    NewProgram,
    NewVariable,
    by_itself,
    is_float,
    is_literal,
    traced,
)

_RULES = RULES | LOOPS
_KEPT: WeakKeyDictionary[Any, dict[Any, WithTangents]] = WeakKeyDictionary()


def with_tangents(
    program: ClosedJaxpr, moves: Moves, wanted: Moves | None = None
) -> WithTangents:
    """A program of a program's results, behind them their tangents.

    Args:
        program: One of JAX's.
        moves: Which of its arguments have a tangent; these are given behind them.
        wanted: Of which results one is wanted, zero if need be; None: where there is
            one.
    """
    kept = _KEPT.setdefault(program.jaxpr, {})
    if (moves, wanted) not in kept:
        kept[moves, wanted] = Forward(program).made(moves, wanted)
    return kept[moves, wanted]


class Forward(WithDots):
    """A program as it is written, with tangents."""

    def __init__(self, program: ClosedJaxpr):
        """Of a program."""
        super().__init__()
        self.program = program
        self._dots: dict[Variable, Variable] = {}

    def made(self, moves: Moves, wanted: Moves | None) -> WithTangents:
        """The whole."""
        jaxpr = self.program.jaxpr
        dots: list[Variable] = []
        for v, moved in zip(jaxpr.invars, moves, strict=True):
            if moved:
                self._dots[v] = NewVariable(v.aval)
                dots.append(self._dots[v])
        for equation in jaxpr.eqns:
            self._write(equation)
        found = [self.dot(v) for v in jaxpr.outvars]
        asked = wanted or tuple(x is not None for x in found)
        outs = [
            self.known(x, v.aval)
            for x, v, shown in zip(found, jaxpr.outvars, asked, strict=True)
            if shown
        ]
        ends = [*jaxpr.invars, *dots], [*jaxpr.outvars, *outs]
        new = NewJaxpr(jaxpr.constvars, *ends, self.eqns)
        return WithTangents(NewProgram(new, list(self.program.consts)), asked)

    def dot(self, v: Variable) -> Dot:
        """A variable's tangent."""
        return None if is_literal(v) else self._dots.get(v)

    def _write(self, equation: Equation) -> None:
        dots = [self.dot(v) for v in equation.invars]
        still = all(x is None for x in dots) or equation.primitive.name in FIXED
        if still or not any(is_float(v.aval) for v in equation.outvars):
            self.eqns.append(equation)
            return
        rule = _RULES.get(equation.primitive.name)
        found = rule(self, equation, dots) if rule else self.by_jax(equation, dots)
        pairs = zip(equation.outvars, found, strict=True)
        self._dots.update((v, x) for v, x in pairs if x is not None)

    def inside(
        self, program: ClosedJaxpr, moves: Moves, wanted: Moves | None = None
    ) -> WithTangents:
        """A program inside of it, with tangents."""
        return with_tangents(program, moves, wanted)

    def by_jax(self, equation: Equation, dots: list[Dot]) -> list[Dot]:
        """What JAX's own rule makes of an equation, traced."""
        alone = by_itself(self.program.jaxpr, equation)
        known = [self.dot(v) for v in alone.inputs]
        moves = moving(known)
        floats = [is_float(v.aval) for v in equation.outvars]

        def changed(*arrays: Array) -> list[Array]:
            primals = arrays[: len(moves)]
            live = [x for x, m in zip(primals, moves, strict=True) if m]

            def run(*live: Array) -> Any:
                mixed = iter(live)
                pairs = zip(primals, moves, strict=True)
                return alone.function(*(next(mixed) if m else x for x, m in pairs))

            outs, changes = jax.jvp(run, tuple(live), tuple(arrays[len(moves) :]))
            pairs = zip(changes, floats, strict=True)
            return [*outs, *(x for x, shown in pairs if shown)]

        inputs = [*alone.inputs, *only(known)]
        program = traced(changed, (v.aval for v in inputs))
        return self.with_dots("jit", equation, inputs, floats, {"jaxpr": program})
