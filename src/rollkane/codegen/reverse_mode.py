"""Reverse mode on traced programs: of one, that of its arguments' cotangents.

Its equations forwards as far as they are needed, then back through them. As in
:mod:`.forward_mode`, the rules of rare operations are JAX's.
"""

from collections.abc import Callable, Sequence
from typing import Any, TypeAlias, cast
from weakref import WeakKeyDictionary

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .forward_mode import FIXED, SLOPED, Moves, moving, shares_of, slope_of
from .jaxpr_types import Aval, ClosedJaxpr, Equation, Variable
from .new_programs import (
    Builder,
    NewJaxpr,
    NewProgram,
    NewVariable,
    by_itself,
    is_float,
    is_literal,
    pruned,
    shaped,
    traced,
)
from .scalar_program import NotElementwiseError

# A cotangent; None is zero.
Bar: TypeAlias = Variable | None
# Cotangents of an equation's inputs, of those that are asked for, from its results'.
_Rule: TypeAlias = Callable[["Reverse", Equation, list[Bar], Moves], list[Bar]]

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


class Reverse(Builder):
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

    def fitting(self, bar: Bar, v: Variable) -> Bar:
        """Of an array that a number, or what has axes of length one, was spread to."""
        if bar is None or bar.aval.shape == v.aval.shape:
            return bar
        return self.gathered(bar, v.aval, tuple(range(v.aval.ndim)))

    def gathered(self, bar: Variable, aval: Aval, kept: Sequence[int]) -> Variable:
        """What an array's cotangent is of one that was spread to it, along these axes."""
        shape = bar.aval.shape
        pairs = zip(kept, aval.shape, strict=True)
        own = {axis for axis, n in pairs if n == shape[axis]}
        axes = tuple(i for i in range(len(shape)) if i not in own)
        if axes:
            left = [n for i, n in enumerate(shape) if i in own]
            like = shaped(left, aval.dtype)
            bar = self.emit("reduce_sum", {"axes": axes}, [bar], like)[0]
        return bar if bar.aval.shape == aval.shape else self.reshaped(bar, aval)

    def reshaped(self, bar: Variable, aval: Aval) -> Variable:
        """The same numbers in another shape."""
        params = {"new_sizes": aval.shape, "dimensions": None}
        return self.emit("reshape", params, [bar], aval)[0]


# -- arithmetic ------------------------------------------------------------------------


def _of_one(b: Reverse, equation: Equation, bars: list[Bar], needs: Moves) -> list[Bar]:
    (bar,) = bars
    slope = slope_of(b, equation)
    assert bar is not None
    assert slope is not None
    return [b.one("mul", bar, slope)]


def _added(b: Reverse, equation: Equation, bars: list[Bar], needs: Moves) -> list[Bar]:
    (bar,), (x, y) = bars, equation.invars
    assert bar is not None
    other = bar
    if equation.primitive.name == "sub" and needs[1]:
        other = b.one("neg", bar)
    return [b.fitting(bar, x), b.fitting(other, y)]


def _times(b: Reverse, equation: Equation, bars: list[Bar], needs: Moves) -> list[Bar]:
    (bar,), (x, y) = bars, equation.invars
    assert bar is not None
    pairs = zip((x, y), (y, x), needs, strict=True)
    return [
        b.fitting(b.one("mul", bar, other), own) if needed else None
        for own, other, needed in pairs
    ]


def _divided(
    b: Reverse, equation: Equation, bars: list[Bar], needs: Moves
) -> list[Bar]:
    (bar,), (x, y), (q,) = bars, equation.invars, equation.outvars
    assert bar is not None
    share = b.one("div", bar, y)
    lost = b.one("neg", b.one("mul", share, q)) if needs[1] else None
    return [b.fitting(share, x), b.fitting(lost, y)]


def _larger(b: Reverse, equation: Equation, bars: list[Bar], needs: Moves) -> list[Bar]:
    (bar,) = bars
    assert bar is not None
    pairs = zip(shares_of(b, equation), equation.invars, strict=True)
    return [b.fitting(b.one("mul", bar, share), v) for share, v in pairs]


def _negated(
    b: Reverse, equation: Equation, bars: list[Bar], needs: Moves
) -> list[Bar]:
    (bar,) = bars
    assert bar is not None
    return [b.one("neg", bar)]


def _chosen(b: Reverse, equation: Equation, bars: list[Bar], needs: Moves) -> list[Bar]:
    (bar,), (which, *cases) = bars, equation.invars
    assert bar is not None
    none = b.zeros(bar.aval)
    found: list[Bar] = [None]
    for k, needed in enumerate(needs[1:]):
        own = [bar if i == k else none for i in range(len(cases))]
        chosen = b.emit("select_n", {}, [which, *own], bar.aval)[0] if needed else None
        found.append(chosen)
    return found


# -- places of numbers ---------------------------------------------------------------


def _as_it_was(
    b: Reverse, equation: Equation, bars: list[Bar], needs: Moves
) -> list[Bar]:
    (bar,) = bars
    assert bar is not None
    return [b.reshaped(bar, equation.invars[0].aval)]


def _copied(b: Reverse, equation: Equation, bars: list[Bar], needs: Moves) -> list[Bar]:
    return [*bars]


def _converted(
    b: Reverse, equation: Equation, bars: list[Bar], needs: Moves
) -> list[Bar]:
    (bar,), (x,) = bars, equation.invars
    assert bar is not None
    params = {"new_dtype": x.aval.dtype, "weak_type": False}
    return [b.emit("convert_element_type", params, [bar], x.aval)[0]]


def _spread(b: Reverse, equation: Equation, bars: list[Bar], needs: Moves) -> list[Bar]:
    (bar,), x = bars, equation.invars[0]
    assert bar is not None
    return [b.gathered(bar, x.aval, equation.params["broadcast_dimensions"])]


def _summed(b: Reverse, equation: Equation, bars: list[Bar], needs: Moves) -> list[Bar]:
    (bar,), x = bars, equation.invars[0]
    assert bar is not None
    axes = equation.params["axes"]
    kept = tuple(i for i in range(x.aval.ndim) if i not in axes)
    params = {"shape": x.aval.shape, "broadcast_dimensions": kept}
    return [b.emit("broadcast_in_dim", params, [bar], x.aval)[0]]


def _sliced(b: Reverse, equation: Equation, bars: list[Bar], needs: Moves) -> list[Bar]:
    (bar,), x, params = bars, equation.invars[0], equation.params
    assert bar is not None
    strides = params["strides"] or (1,) * x.aval.ndim
    gaps: list[tuple[int, int, int]] = []
    each = zip(
        params["start_indices"], strides, bar.aval.shape, x.aval.shape, strict=True
    )
    for first, stride, count, n in each:
        last = first + (count - 1) * stride + 1 if count else first
        gaps.append((first, n - last, stride - 1))
    zero = b.zeros(shaped((), bar.aval.dtype))
    return [b.emit("pad", {"padding_config": tuple(gaps)}, [bar, zero], x.aval)[0]]


def _transposed(
    b: Reverse, equation: Equation, bars: list[Bar], needs: Moves
) -> list[Bar]:
    (bar,), x = bars, equation.invars[0]
    assert bar is not None
    back = tuple(int(i) for i in np.argsort(equation.params["permutation"]))
    return [b.emit("transpose", {"permutation": back}, [bar], x.aval)[0]]


def _reversed(
    b: Reverse, equation: Equation, bars: list[Bar], needs: Moves
) -> list[Bar]:
    (bar,), x = bars, equation.invars[0]
    assert bar is not None
    return [b.emit("rev", equation.params, [bar], x.aval)[0]]


def _unstacked(
    b: Reverse, equation: Equation, bars: list[Bar], needs: Moves
) -> list[Bar]:
    pairs = zip(bars, equation.outvars, strict=True)
    known = [b.known(bar, v.aval) for bar, v in pairs]
    axis = {"axis": equation.params["axis"]}
    return [*b.emit("stack", axis, known, equation.invars[0].aval)]


def _stacked(
    b: Reverse, equation: Equation, bars: list[Bar], needs: Moves
) -> list[Bar]:
    (bar,) = bars
    assert bar is not None
    avals = [v.aval for v in equation.invars]
    return [*b.emit("unstack", {"axis": equation.params["axis"]}, [bar], *avals)]


def _concatenated(
    b: Reverse, equation: Equation, bars: list[Bar], needs: Moves
) -> list[Bar]:
    (bar,), axis = bars, equation.params["dimension"]
    assert bar is not None
    sizes = tuple(v.aval.shape[axis] for v in equation.invars)
    avals = [v.aval for v in equation.invars]
    return [*b.emit("split", {"sizes": sizes, "axis": axis}, [bar], *avals)]


def _split(b: Reverse, equation: Equation, bars: list[Bar], needs: Moves) -> list[Bar]:
    pairs = zip(bars, equation.outvars, strict=True)
    known = [b.known(bar, v.aval) for bar, v in pairs]
    along = {"dimension": equation.params["axis"]}
    return [*b.emit("concatenate", along, known, equation.invars[0].aval)]


def _taken(b: Reverse, equation: Equation, bars: list[Bar], needs: Moves) -> list[Bar]:
    (bar,), (x, *places) = bars, equation.invars
    assert bar is not None
    inputs = [b.zeros(x.aval), bar, *places]
    found = b.emit("dynamic_update_slice", {}, inputs, x.aval)
    return [*found, *[None] * len(places)]


def _put(b: Reverse, equation: Equation, bars: list[Bar], needs: Moves) -> list[Bar]:
    (bar,), (x, part, *places) = bars, equation.invars
    assert bar is not None
    inputs = [bar, b.zeros(part.aval), *places]
    first = b.emit("dynamic_update_slice", {}, inputs, x.aval) if needs[0] else [None]
    sizes: dict[str, Any] = {"slice_sizes": part.aval.shape}
    second = b.emit("dynamic_slice", sizes, [bar, *places], part.aval)
    return [*first, *second, *[None] * len(places)]


# -- programs inside -----------------------------------------------------------------


def _known(bars: list[Bar]) -> list[Variable]:
    return [x for x in bars if x is not None]


def _in_places(found: Sequence[Bar], needs: Moves) -> list[Bar]:
    rest = iter(found)
    return [next(rest) if needed else None for needed in needs]


def _called(b: Reverse, equation: Equation, bars: list[Bar], needs: Moves) -> list[Bar]:
    program = with_cotangents(equation.params["jaxpr"], needs, moving(bars))
    inputs = [*equation.invars, *_known(bars)]
    found = b.emit("jit", {"jaxpr": program}, inputs, *program.out_avals)
    return _in_places(found, needs)


def _branched(
    b: Reverse, equation: Equation, bars: list[Bar], needs: Moves
) -> list[Bar]:
    branches, ends = equation.params["branches"], moving(bars)
    made = tuple(with_cotangents(x, needs[1:], ends) for x in branches)
    inputs = [*equation.invars, *_known(bars)]
    found = b.emit("cond", {"branches": made}, inputs, *made[0].out_avals)
    return [None, *_in_places(found, needs[1:])]


def _looped(b: Reverse, equation: Equation, bars: list[Bar], needs: Moves) -> list[Bar]:
    raise NotElementwiseError("the way back through a loop of unknown length")


# -- all others ----------------------------------------------------------------------


def _by_jax(b: Reverse, equation: Equation, bars: list[Bar], needs: Moves) -> list[Bar]:
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


_RULES: dict[str, _Rule] = {
    "add": _added,
    "add_any": _added,
    "broadcast_in_dim": _spread,
    "concatenate": _concatenated,
    "cond": _branched,
    "convert_element_type": _converted,
    "copy": _copied,
    "div": _divided,
    "dynamic_slice": _taken,
    "dynamic_update_slice": _put,
    "expand_dims": _as_it_was,
    "jit": _called,
    "max": _larger,
    "min": _larger,
    "mul": _times,
    "neg": _negated,
    "pjit": _called,
    "reduce_sum": _summed,
    "reshape": _as_it_was,
    "rev": _reversed,
    "select_n": _chosen,
    "slice": _sliced,
    "split": _split,
    "squeeze": _as_it_was,
    "stack": _stacked,
    "sub": _added,
    "transpose": _transposed,
    "unstack": _unstacked,
    "while": _looped,
    **dict.fromkeys(SLOPED, _of_one),
}
