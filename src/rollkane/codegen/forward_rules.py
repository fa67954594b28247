"""Forward mode's rules of operations on arrays; :mod:`.forward_mode` applies them."""

import abc
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeAlias

from .jaxpr_types import ClosedJaxpr, Equation, Variable
from .new_programs import (
    Builder,
    NewEquation,
    NewProgram,
    NewVariable,
    is_float,
    number,
)

# A tangent; None is zero.
Dot: TypeAlias = Variable | None
# Which of some arrays have a tangent.
Moves: TypeAlias = tuple[bool, ...]
# Writes an equation and that of its tangents, of those of its inputs.
Rule: TypeAlias = Callable[["WithDots", Equation, list[Dot]], list[Dot]]

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


class WithDots(Builder, abc.ABC):
    """A program as it is written, with tangents.

    Attributes:
        program: That it is of.
    """

    program: ClosedJaxpr

    @abc.abstractmethod
    def dot(self, v: Variable) -> Dot:
        """A variable's tangent."""

    @abc.abstractmethod
    def inside(
        self, program: ClosedJaxpr, moves: Moves, wanted: Moves | None = None
    ) -> WithTangents:
        """A program inside of it, with tangents; see ``forward_mode.with_tangents``."""

    @abc.abstractmethod
    def by_jax(self, equation: Equation, dots: list[Dot]) -> list[Dot]:
        """What JAX's own rule makes of an equation."""

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


def only(dots: Sequence[Dot]) -> list[Variable]:
    """Those that there are."""
    return [x for x in dots if x is not None]


# -- arithmetic ------------------------------------------------------------------------


def slope_of(b: Builder, equation: Equation) -> Variable | None:
    """Derivative of a function of one number, written where it is not known by name."""
    name, x, y = equation.primitive.name, equation.invars[0], equation.outvars[0]
    dtype, params = y.aval.dtype, equation.params
    if name == "sqrt":
        return b.one("div", number(0.5, dtype), y)
    if name == "sin":
        # as accurate: XLA, which is asked where x is known, has no default
        return b.one("cos", x, **params)
    if name == "cos":
        return b.one("neg", b.one("sin", x, **params))
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
        power = params["y"]
        less = b.one("integer_pow", x, y=power - 1)
        return b.one("mul", number(power, dtype), less)
    return None


SLOPED = frozenset(
    "sqrt sin cos exp log abs tanh square integer_pow".split()  # noqa: SIM905
)


def _of_one(b: WithDots, equation: Equation, dots: list[Dot]) -> list[Dot]:
    b.eqns.append(equation)
    slope = slope_of(b, equation)
    assert slope is not None
    return [b.one("mul", dots[0], slope)] if dots[0] is not None else [None]


def _added(b: WithDots, equation: Equation, dots: list[Dot]) -> list[Dot]:
    b.eqns.append(equation)
    aval = equation.outvars[0].aval
    x, y = (None if d is None else b.spread(d, aval) for d in dots)
    if equation.primitive.name == "sub":
        if x is not None and y is not None:
            return [b.one("sub", x, y)]
        y = None if y is None else b.one("neg", y)
    return [b.added(x, y)]


def _times(b: WithDots, equation: Equation, dots: list[Dot]) -> list[Dot]:
    b.eqns.append(equation)
    x, y = equation.invars
    first = None if dots[0] is None else b.one("mul", dots[0], y)
    second = None if dots[1] is None else b.one("mul", x, dots[1])
    return [b.added(first, second)]


def _divided(b: WithDots, equation: Equation, dots: list[Dot]) -> list[Dot]:
    b.eqns.append(equation)
    (_, y), (q,), (x_dot, y_dot) = equation.invars, equation.outvars, dots
    if y_dot is None:
        assert x_dot is not None
        return [b.one("div", x_dot, y)]
    lost = b.one("mul", q, y_dot)
    left = b.one("neg", lost) if x_dot is None else b.one("sub", x_dot, lost)
    return [b.one("div", left, y)]


def _larger(b: WithDots, equation: Equation, dots: list[Dot]) -> list[Dot]:
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


def _negated(b: WithDots, equation: Equation, dots: list[Dot]) -> list[Dot]:
    b.eqns.append(equation)
    assert dots[0] is not None
    return [b.one("neg", dots[0])]


def _chosen(b: WithDots, equation: Equation, dots: list[Dot]) -> list[Dot]:
    b.eqns.append(equation)
    which, *cases = equation.invars
    pairs = zip(dots[1:], cases, strict=True)
    known = [b.known(x, v.aval) for x, v in pairs]
    return [*b.emit("select_n", {}, [which, *known], equation.outvars[0].aval)]


def _product(b: WithDots, equation: Equation, dots: list[Dot]) -> list[Dot]:
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


def _moved(b: WithDots, equation: Equation, dots: list[Dot]) -> list[Dot]:
    b.eqns.append(equation)
    assert dots[0] is not None
    inputs = [dots[0], *equation.invars[1:]]
    avals = [v.aval for v in equation.outvars]
    return [*b.emit(equation.primitive.name, equation.params, inputs, *avals)]


def _joined(b: WithDots, equation: Equation, dots: list[Dot]) -> list[Dot]:
    b.eqns.append(equation)
    inputs = [
        b.known(x, v.aval) if is_float(v.aval) else v
        for x, v in zip(dots, equation.invars, strict=True)
    ]
    aval = equation.outvars[0].aval
    return [*b.emit(equation.primitive.name, equation.params, inputs, aval)]


def _put(b: WithDots, equation: Equation, dots: list[Dot]) -> list[Dot]:
    """A scatter that sets; of one place, or of places that are told to differ."""
    places = equation.invars[1].aval.shape[:-1]
    if equation.params["unique_indices"] or all(n == 1 for n in places):
        return _joined(b, equation, dots)
    return b.by_jax(equation, dots)


RULES: dict[str, Rule] = {
    "add": _added,
    "add_any": _added,
    "convert_element_type": _moved,
    "div": _divided,
    "dot_general": _product,
    "max": _larger,
    "min": _larger,
    "mul": _times,
    "neg": _negated,
    "scatter": _put,
    "select_n": _chosen,
    "sub": _added,
    **dict.fromkeys(JOINED, _joined),
    **dict.fromkeys(MOVED, _moved),
    **dict.fromkeys(SLOPED, _of_one),
}
