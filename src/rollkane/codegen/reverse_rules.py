"""Reverse mode's rules of operations on arrays; :mod:`.reverse_mode` applies them."""

from collections.abc import Callable, Sequence
from typing import TypeAlias

import numpy as np

from .forward_rules import SLOPED, Moves, shares_of, slope_of
from .jaxpr_types import Aval, ClosedJaxpr, Equation, Params, Variable
from .new_programs import Builder, shaped

# A cotangent; None is zero.
Bar: TypeAlias = Variable | None
# Cotangents of an equation's inputs, of those that are asked for, from its results'.
Rule: TypeAlias = Callable[["WithBars", Equation, list[Bar], Moves], list[Bar]]


class WithBars(Builder):
    """A program as it is written, and its way back.

    Attributes:
        program: That it is of.
    """

    program: ClosedJaxpr

    def fitting(self, bar: Bar, v: Variable) -> Bar:
        """Of an array that a number, or what has axes of length one, was spread to."""
        if bar is None or bar.aval.shape == v.aval.shape:
            return bar
        return self.gathered(bar, v.aval, tuple(range(v.aval.ndim)))

    def gathered(self, bar: Variable, aval: Aval, kept: Sequence[int]) -> Variable:
        """Of an array that was spread along these axes."""
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


def _of_one(
    b: WithBars, equation: Equation, bars: list[Bar], needs: Moves
) -> list[Bar]:
    (bar,) = bars
    slope = slope_of(b, equation)
    assert bar is not None
    assert slope is not None
    return [b.one("mul", bar, slope)]


def _added(b: WithBars, equation: Equation, bars: list[Bar], needs: Moves) -> list[Bar]:
    (bar,), (x, y) = bars, equation.invars
    assert bar is not None
    other = bar
    if equation.primitive.name == "sub" and needs[1]:
        other = b.one("neg", bar)
    return [b.fitting(bar, x), b.fitting(other, y)]


def _times(b: WithBars, equation: Equation, bars: list[Bar], needs: Moves) -> list[Bar]:
    (bar,), (x, y) = bars, equation.invars
    assert bar is not None
    pairs = zip((x, y), (y, x), needs, strict=True)
    return [
        b.fitting(b.one("mul", bar, other), own) if needed else None
        for own, other, needed in pairs
    ]


def _divided(
    b: WithBars, equation: Equation, bars: list[Bar], needs: Moves
) -> list[Bar]:
    (bar,), (x, y), (q,) = bars, equation.invars, equation.outvars
    assert bar is not None
    share = b.one("div", bar, y)
    lost = b.one("neg", b.one("mul", share, q)) if needs[1] else None
    return [b.fitting(share, x), b.fitting(lost, y)]


def _larger(
    b: WithBars, equation: Equation, bars: list[Bar], needs: Moves
) -> list[Bar]:
    (bar,) = bars
    assert bar is not None
    pairs = zip(shares_of(b, equation), equation.invars, strict=True)
    return [b.fitting(b.one("mul", bar, share), v) for share, v in pairs]


def _negated(
    b: WithBars, equation: Equation, bars: list[Bar], needs: Moves
) -> list[Bar]:
    (bar,) = bars
    assert bar is not None
    return [b.one("neg", bar)]


def _chosen(
    b: WithBars, equation: Equation, bars: list[Bar], needs: Moves
) -> list[Bar]:
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
    b: WithBars, equation: Equation, bars: list[Bar], needs: Moves
) -> list[Bar]:
    (bar,) = bars
    assert bar is not None
    return [b.reshaped(bar, equation.invars[0].aval)]


def _copied(
    b: WithBars, equation: Equation, bars: list[Bar], needs: Moves
) -> list[Bar]:
    return [*bars]


def _converted(
    b: WithBars, equation: Equation, bars: list[Bar], needs: Moves
) -> list[Bar]:
    (bar,), (x,) = bars, equation.invars
    assert bar is not None
    params = {"new_dtype": x.aval.dtype, "weak_type": False}
    return [b.emit("convert_element_type", params, [bar], x.aval)[0]]


def _spread(
    b: WithBars, equation: Equation, bars: list[Bar], needs: Moves
) -> list[Bar]:
    (bar,), x = bars, equation.invars[0]
    assert bar is not None
    return [b.gathered(bar, x.aval, equation.params["broadcast_dimensions"])]


def _summed(
    b: WithBars, equation: Equation, bars: list[Bar], needs: Moves
) -> list[Bar]:
    (bar,), x = bars, equation.invars[0]
    assert bar is not None
    axes = equation.params["axes"]
    kept = tuple(i for i in range(x.aval.ndim) if i not in axes)
    params = {"shape": x.aval.shape, "broadcast_dimensions": kept}
    return [b.emit("broadcast_in_dim", params, [bar], x.aval)[0]]


def _sliced(
    b: WithBars, equation: Equation, bars: list[Bar], needs: Moves
) -> list[Bar]:
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
    b: WithBars, equation: Equation, bars: list[Bar], needs: Moves
) -> list[Bar]:
    (bar,), x = bars, equation.invars[0]
    assert bar is not None
    back = tuple(int(i) for i in np.argsort(equation.params["permutation"]))
    return [b.emit("transpose", {"permutation": back}, [bar], x.aval)[0]]


def _reversed(
    b: WithBars, equation: Equation, bars: list[Bar], needs: Moves
) -> list[Bar]:
    (bar,), x = bars, equation.invars[0]
    assert bar is not None
    return [b.emit("rev", equation.params, [bar], x.aval)[0]]


def _unstacked(
    b: WithBars, equation: Equation, bars: list[Bar], needs: Moves
) -> list[Bar]:
    pairs = zip(bars, equation.outvars, strict=True)
    known = [b.known(bar, v.aval) for bar, v in pairs]
    axis = {"axis": equation.params["axis"]}
    return [*b.emit("stack", axis, known, equation.invars[0].aval)]


def _stacked(
    b: WithBars, equation: Equation, bars: list[Bar], needs: Moves
) -> list[Bar]:
    (bar,) = bars
    assert bar is not None
    avals = [v.aval for v in equation.invars]
    return [*b.emit("unstack", {"axis": equation.params["axis"]}, [bar], *avals)]


def _concatenated(
    b: WithBars, equation: Equation, bars: list[Bar], needs: Moves
) -> list[Bar]:
    (bar,) = bars
    axis: int = equation.params["dimension"]
    assert bar is not None
    sizes = [v.aval.shape[axis] for v in equation.invars]
    avals = [v.aval for v in equation.invars]
    return [*b.emit("split", {"sizes": tuple(sizes), "axis": axis}, [bar], *avals)]


def _split(b: WithBars, equation: Equation, bars: list[Bar], needs: Moves) -> list[Bar]:
    pairs = zip(bars, equation.outvars, strict=True)
    known = [b.known(bar, v.aval) for bar, v in pairs]
    along = {"dimension": equation.params["axis"]}
    return [*b.emit("concatenate", along, known, equation.invars[0].aval)]


def _taken(b: WithBars, equation: Equation, bars: list[Bar], needs: Moves) -> list[Bar]:
    (bar,), (x, *places) = bars, equation.invars
    assert bar is not None
    inputs = [b.zeros(x.aval), bar, *places]
    found = b.emit("dynamic_update_slice", {}, inputs, x.aval)
    return [*found, *[None] * len(places)]


def _put(b: WithBars, equation: Equation, bars: list[Bar], needs: Moves) -> list[Bar]:
    (bar,), (x, part, *places) = bars, equation.invars
    assert bar is not None
    inputs = [bar, b.zeros(part.aval), *places]
    first = b.emit("dynamic_update_slice", {}, inputs, x.aval) if needs[0] else [None]
    taken: Params = {"slice_sizes": part.aval.shape}
    second = b.emit("dynamic_slice", taken, [bar, *places], part.aval)
    return [*first, *second, *[None] * len(places)]


RULES: dict[str, Rule] = {
    "add": _added,
    "add_any": _added,
    "broadcast_in_dim": _spread,
    "concatenate": _concatenated,
    "convert_element_type": _converted,
    "copy": _copied,
    "div": _divided,
    "dynamic_slice": _taken,
    "dynamic_update_slice": _put,
    "expand_dims": _as_it_was,
    "max": _larger,
    "min": _larger,
    "mul": _times,
    "neg": _negated,
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
    **dict.fromkeys(SLOPED, _of_one),
}
