"""Forward mode on traced programs: of one, that of its values and their tangents.

The rules of frequent operations are written here; those of others are JAX's, which
traces them one by one. What does not move has no tangent, and so no equation.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeAlias
from weakref import WeakKeyDictionary

import jax
from jaxtyping import Array

from .called_programs import Rows, rows_of
from .jaxpr_types import ClosedJaxpr, Equation, Variable
from .new_programs import (
    Builder,
    NewEquation,
    NewJaxpr,
    NewProgram,
    NewVariable,
    by_itself,
    is_float,
    is_literal,
    number,
    traced,
)

# A tangent; None is zero.
Dot: TypeAlias = Variable | None
# Which of some arrays have a tangent.
Moves: TypeAlias = tuple[bool, ...]
# Writes an equation and that of its tangents, of those of its inputs.
_Rule: TypeAlias = Callable[["Forward", Equation, list[Dot]], list[Dot]]

# an array's parts, or it in another order: so are its tangent's
MOVED = frozenset(
    """
    broadcast_in_dim copy cumsum dynamic_slice expand_dims gather reduce_sum reshape rev
    slice split squeeze tile transpose unstack
    """.split()  # noqa: SIM905 -- words read better than a column of strings
)
# several arrays in one: so are their tangents, some of which may be zero
JOINED = frozenset(
    "concatenate dynamic_update_slice pad scatter-add stack".split()  # noqa: SIM905
)
# what they give does not move with what they are given
FIXED = frozenset(
    "ceil floor is_finite nextafter round sign stop_gradient".split()  # noqa: SIM905
)


class WithTangents(NamedTuple):
    """A program of values and tangents, and which of its results have one."""

    program: NewProgram
    moved: Moves


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


class Forward(Builder):
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
        found = _RULES.get(equation.primitive.name, _by_jax)(self, equation, dots)
        pairs = zip(equation.outvars, found, strict=True)
        self._dots.update((v, x) for v, x in pairs if x is not None)

    def with_dots(
        self,
        name: str,
        equation: Equation,
        inputs: Sequence[Variable],
        moved: Sequence[bool],
        params: dict[str, Any],
    ) -> list[Dot]:
        """An equation in another's place, whose results' tangents follow them."""
        pairs = zip(equation.outvars, moved, strict=True)
        dots = [NewVariable(v.aval) if moves else None for v, moves in pairs]
        outs = [*equation.outvars, *(x for x in dots if x is not None)]
        self.eqns.append(NewEquation.of(name, params, inputs, outs))
        return [*dots]


def moving(dots: Sequence[Dot]) -> Moves:
    """Which there are."""
    return tuple(x is not None for x in dots)


def _only(dots: Sequence[Dot]) -> list[Variable]:
    return [x for x in dots if x is not None]


# -- arithmetic ------------------------------------------------------------------------


def slope_of(b: Builder, equation: Equation) -> Variable | None:
    """Derivative of a function of one number, written where it is not known by name."""
    name, x, y = equation.primitive.name, equation.invars[0], equation.outvars[0]
    dtype = y.aval.dtype
    if name == "sqrt":
        return b.one("div", number(0.5, dtype), y)
    if name == "sin":
        return b.one("cos", x)
    if name == "cos":
        return b.one("neg", b.one("sin", x))
    if name == "exp":
        return y
    if name == "log":
        return b.one("div", number(1.0, dtype), x)
    if name == "abs":
        return b.one("sign", x)
    if name == "tanh":
        return b.one("sub", number(1.0, dtype), b.one("mul", y, y))
    if name == "square":
        return b.one("mul", number(2.0, dtype), x)
    if name == "integer_pow":
        power = equation.params["y"]
        less = b.one("integer_pow", x, y=power - 1)
        return b.one("mul", number(power, dtype), less)
    return None


SLOPED = frozenset(
    "sqrt sin cos exp log abs tanh square integer_pow".split()  # noqa: SIM905
)


def _of_one(b: Forward, equation: Equation, dots: list[Dot]) -> list[Dot]:
    b.eqns.append(equation)
    slope = slope_of(b, equation)
    assert slope is not None
    return [b.one("mul", dots[0], slope)] if dots[0] is not None else [None]


def _added(b: Forward, equation: Equation, dots: list[Dot]) -> list[Dot]:
    b.eqns.append(equation)
    aval = equation.outvars[0].aval
    x, y = (None if d is None else b.spread(d, aval) for d in dots)
    if equation.primitive.name == "sub":
        if x is not None and y is not None:
            return [b.one("sub", x, y)]
        y = None if y is None else b.one("neg", y)
    return [b.added(x, y)]


def _times(b: Forward, equation: Equation, dots: list[Dot]) -> list[Dot]:
    b.eqns.append(equation)
    x, y = equation.invars
    first = None if dots[0] is None else b.one("mul", dots[0], y)
    second = None if dots[1] is None else b.one("mul", x, dots[1])
    return [b.added(first, second)]


def _divided(b: Forward, equation: Equation, dots: list[Dot]) -> list[Dot]:
    b.eqns.append(equation)
    (_, y), (q,), (x_dot, y_dot) = equation.invars, equation.outvars, dots
    if y_dot is None:
        assert x_dot is not None
        return [b.one("div", x_dot, y)]
    lost = b.one("mul", q, y_dot)
    left = b.one("neg", lost) if x_dot is None else b.one("sub", x_dot, lost)
    return [b.one("div", left, y)]


def _larger(b: Forward, equation: Equation, dots: list[Dot]) -> list[Dot]:
    """Of the larger or the smaller of two, halves where both are it."""
    b.eqns.append(equation)
    aval = equation.outvars[0].aval
    shares = shares_of(b, equation)
    pairs = zip(dots, shares, strict=True)
    terms = [None if x is None else b.one("mul", x, share) for x, share in pairs]
    return [b.added(*(None if x is None else b.spread(x, aval) for x in terms))]


def shares_of(b: Builder, equation: Equation) -> list[Variable]:
    """Of each of two numbers, how far the larger or smaller moves with it."""
    (x, y), (z,) = equation.invars, equation.outvars
    dtype, like = z.aval.dtype, z.aval
    first, second = b.compared("eq", z, x), b.compared("eq", z, y)
    whole, half, none = (
        b.spread(number(value, dtype), like) for value in (1.0, 0.5, 0.0)
    )
    shared = b.chosen(second, whole, half), b.chosen(first, whole, half)
    pairs = zip((first, second), shared, strict=True)
    return [b.chosen(is_it, none, share) for is_it, share in pairs]


def _negated(b: Forward, equation: Equation, dots: list[Dot]) -> list[Dot]:
    b.eqns.append(equation)
    assert dots[0] is not None
    return [b.one("neg", dots[0])]


def _chosen(b: Forward, equation: Equation, dots: list[Dot]) -> list[Dot]:
    b.eqns.append(equation)
    which, *cases = equation.invars
    pairs = zip(dots[1:], cases, strict=True)
    known = [b.known(x, v.aval) for x, v in pairs]
    return [*b.emit("select_n", {}, [which, *known], equation.outvars[0].aval)]


def _product(b: Forward, equation: Equation, dots: list[Dot]) -> list[Dot]:
    b.eqns.append(equation)
    x, y = equation.invars
    aval, params = equation.outvars[0].aval, equation.params
    pairs = [(dots[0], y), (x, dots[1])]
    terms = [
        b.emit("dot_general", params, (p, q), aval)[0]
        for p, q in pairs
        if p is not None and q is not None
    ]
    return [b.added(*terms)]


# -- places of numbers ---------------------------------------------------------------


def _moved(b: Forward, equation: Equation, dots: list[Dot]) -> list[Dot]:
    b.eqns.append(equation)
    assert dots[0] is not None
    inputs = [dots[0], *equation.invars[1:]]
    avals = [v.aval for v in equation.outvars]
    return [*b.emit(equation.primitive.name, equation.params, inputs, *avals)]


def _joined(b: Forward, equation: Equation, dots: list[Dot]) -> list[Dot]:
    b.eqns.append(equation)
    inputs = [
        b.known(x, v.aval) if is_float(v.aval) else v
        for x, v in zip(dots, equation.invars, strict=True)
    ]
    aval = equation.outvars[0].aval
    return [*b.emit(equation.primitive.name, equation.params, inputs, aval)]


def _put(b: Forward, equation: Equation, dots: list[Dot]) -> list[Dot]:
    """A scatter that sets; of one place, or of places that are told to differ."""
    places = equation.invars[1].aval.shape[:-1]
    if equation.params["unique_indices"] or all(n == 1 for n in places):
        return _joined(b, equation, dots)
    return _by_jax(b, equation, dots)


# -- programs inside -----------------------------------------------------------------


def _called(b: Forward, equation: Equation, dots: list[Dot]) -> list[Dot]:
    inner = equation.params["jaxpr"]
    program, moved = with_tangents(inner, moving(dots))
    inputs = [*equation.invars, *_only(dots)]
    return b.with_dots("jit", equation, inputs, moved, {"jaxpr": program})


def _branched(b: Forward, equation: Equation, dots: list[Dot]) -> list[Dot]:
    branches, moves = equation.params["branches"], moving(dots[1:])
    each = [with_tangents(branch, moves).moved for branch in branches]
    moved = tuple(map(any, zip(*each, strict=True)))
    made = tuple(with_tangents(x, moves, moved).program for x in branches)
    inputs = [*equation.invars, *_only(dots)]
    return b.with_dots("cond", equation, inputs, moved, {"branches": made})


def _going_on(body: ClosedJaxpr, fixed: Moves, begun: Moves, rows: Moves) -> Moves:
    """Which of what goes from turn to turn moves, from the first turn on or later."""
    while True:
        moved = with_tangents(body, (*fixed, *begun, *rows)).moved[: len(begun)]
        both = tuple(a or b for a, b in zip(begun, moved, strict=True))
        if both == begun:
            return begun
        begun = both


def _each_with_dots(
    b: Forward, values: Sequence[Variable], dots: Sequence[Dot], moves: Moves
) -> list[Variable]:
    """Values, then the tangents of those that move."""
    triples = zip(values, dots, moves, strict=True)
    return [*values, *(b.known(x, v.aval) for v, x, moved in triples if moved)]


def _looped(b: Forward, equation: Equation, dots: list[Dot]) -> list[Dot]:
    params = equation.params
    more, body = params["cond_jaxpr"], params["body_jaxpr"]
    first, second = params["cond_nconsts"], params["body_nconsts"]
    parts = Rows(second, len(dots) - first - second, 0)
    asked, values = equation.invars[:first], equation.invars[first:]
    fixed, begun, _ = parts.parted([*dots[first:]])
    moves = _going_on(body, moving(fixed), moving(begun), ())
    program, moved = with_tangents(
        body, (*moving(fixed), *moves), moves if any(moves) else None
    )
    if not any(moved):
        b.eqns.append(equation)
        return [None] * len(begun)
    shared, carried, _ = parts.parted([*values])
    inputs = _each_with_dots(b, shared, fixed, moving(fixed))
    turned = _each_with_dots(b, carried, begun, moves)
    known = {
        "cond_jaxpr": _with_more(more, [v.aval for v in turned[len(carried) :]]),
        "body_jaxpr": _in_order(program, parts, moving(fixed), moves, ()),
        "cond_nconsts": first,
        "body_nconsts": len(inputs),
    }
    return b.with_dots("while", equation, [*asked, *inputs, *turned], moved, known)


def _with_more(program: ClosedJaxpr, avals: Sequence[Any]) -> NewProgram:
    """A program with more arguments behind, of which it takes no notice."""
    jaxpr = program.jaxpr
    invars = [*jaxpr.invars, *map(NewVariable, avals)]
    new = NewJaxpr(jaxpr.constvars, invars, jaxpr.outvars, jaxpr.eqns)
    return NewProgram(new, program.consts)


def _in_order(
    program: NewProgram, parts: Rows, fixed: Moves, carried: Moves, rows: Moves
) -> NewProgram:
    """A loop's body, each part of its arguments followed by its tangents."""
    jaxpr, count = program.jaxpr, sum(parts)
    values, dots = jaxpr.invars[:count], iter(jaxpr.invars[count:])
    invars: list[Variable] = []
    known = zip(parts.parted([*values]), (fixed, carried, rows), strict=True)
    for own, moves in known:
        invars += own
        invars += [next(dots) for moved in moves if moved]
    new = NewJaxpr(jaxpr.constvars, invars, jaxpr.outvars, jaxpr.eqns)
    return NewProgram(new, program.consts)


def _scanned(b: Forward, equation: Equation, dots: list[Dot]) -> list[Dot]:
    params, parts = equation.params, rows_of(equation)
    body = params["jaxpr"]
    shared, begun, rows = parts.parted(dots)
    fixed, by_rows = moving(shared), moving(rows)
    moves = _going_on(body, fixed, moving(begun), by_rows)
    free = with_tangents(body, (*fixed, *moves, *by_rows)).moved
    moved = (*moves, *free[parts.carried :])
    program, _ = with_tangents(body, (*fixed, *moves, *by_rows), moved)
    if not any(moved):
        b.eqns.append(equation)
        return [None] * len(moved)
    values = parts.parted([*equation.invars])
    groups = zip(values, (shared, begun, rows), (fixed, moves, by_rows), strict=True)
    inputs = [v for group in groups for v in _each_with_dots(b, *group)]
    jaxpr = _in_order(program, parts, fixed, moves, by_rows).jaxpr
    # what goes on, its tangents, then the rows that are left, and theirs
    outs, behind = equation.outvars, parts.carried
    all_dots = [
        NewVariable(v.aval) if m else None for v, m in zip(outs, moved, strict=True)
    ]
    left = [*outs[:behind], *_only(all_dots[:behind])]
    left += [*outs[behind:], *_only(all_dots[behind:])]
    count, going = len(outs), sum(moves)
    own, more = jaxpr.outvars[:count], jaxpr.outvars[count:]
    turned = [*own[:behind], *more[:going], *own[behind:], *more[going:]]
    new = NewJaxpr(jaxpr.constvars, jaxpr.invars, turned, jaxpr.eqns)
    known = {
        "jaxpr": NewProgram(new, program.consts),
        "length": params["length"],
        "reverse": params["reverse"],
    }
    b.eqns.append(NewEquation.of("scan", known, inputs, left))
    return [*all_dots]


# -- all others ----------------------------------------------------------------------


def _by_jax(b: Forward, equation: Equation, dots: list[Dot]) -> list[Dot]:
    """By JAX's own rule, traced."""
    alone = by_itself(b.program.jaxpr, equation)
    known = [b.dot(v) for v in alone.inputs]
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

    inputs = [*alone.inputs, *_only(known)]
    program = traced(changed, (v.aval for v in inputs))
    return b.with_dots("jit", equation, inputs, floats, {"jaxpr": program})


_RULES: dict[str, _Rule] = {
    "add": _added,
    "add_any": _added,
    "cond": _branched,
    "convert_element_type": _moved,
    "div": _divided,
    "dot_general": _product,
    "jit": _called,
    "max": _larger,
    "min": _larger,
    "mul": _times,
    "neg": _negated,
    "pjit": _called,
    "scan": _scanned,
    "scatter": _put,
    "select_n": _chosen,
    "sub": _added,
    "while": _looped,
    **dict.fromkeys(JOINED, _joined),
    **dict.fromkeys(MOVED, _moved),
    **dict.fromkeys(SLOPED, _of_one),
}
