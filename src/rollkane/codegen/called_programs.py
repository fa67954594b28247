"""Programs that equations of a traced program call."""

import functools
import operator
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple, TypeVar, cast

import jax

from .jaxpr_types import Aval, ClosedJaxpr, Equation
from .linear_call import LINEAR, run_linear
from .small_matrices import arithmetic_of

_T = TypeVar("_T")

DERIVED = "rollkane_derived"  # a derivative (derivatives.py)
# programs inside a program, by the name of the parameter that holds them
_CALLS = {
    DERIVED: "program",
    "jit": "jaxpr",
    "pjit": "jaxpr",
    "closed_call": "call_jaxpr",
    "core_call": "call_jaxpr",
    "custom_jvp_call": "call_jaxpr",
    "custom_vjp_call": "call_jaxpr",
}


def calls(equation: Equation) -> bool:
    """Whether an equation is a call of a program."""
    return equation.primitive.name in _CALLS or _written_by(equation) is not None


def _written_by(equation: Equation) -> Callable[..., Any] | None:
    """The function of which an equation is a call, where its program is not there."""
    if equation.primitive.name == LINEAR:
        return run_linear
    if equation.primitive.name == "call_hi_primitive":
        # from jax 0.11 on, of searchsorted and others
        return cast(Any, equation.primitive).to_lojax
    return arithmetic_of(equation)


class Rows(NamedTuple):
    """A scan's arguments: what all turns share, what goes on, and rows by turns."""

    shared: int
    carried: int
    rows: int

    def parted(self, values: list[_T]) -> tuple[list[_T], list[_T], list[_T]]:
        """These parts of one value for each."""
        behind = self.shared + self.carried
        return values[: self.shared], values[self.shared : behind], values[behind:]


def rows_of(equation: Equation) -> Rows:
    """A scan's arguments, of which each release tells in ways of its own."""
    body = equation.params["jaxpr"]
    # rows have an axis more outside of the turns
    axes: Callable[[Iterable[Aval]], list[int]]
    axes = lambda values: [v.ndim for v in values]
    outer, turned = axes(v.aval for v in equation.outvars), axes(body.out_avals)
    carried = sum(map(operator.eq, outer, turned))
    given = axes(v.aval for v in equation.invars)
    rows = sum(map(operator.ne, given, axes(body.in_avals)))
    return Rows(len(given) - carried - rows, carried, rows)


class CalledPrograms:
    """Those that equations call; traced once where they are not there."""

    def __init__(self):
        """None yet."""
        self._traced: dict[int, tuple[Equation, ClosedJaxpr]] = {}

    def of(self, equation: Equation) -> ClosedJaxpr | None:
        """The program that an equation calls, with what it closes over; None: none."""
        name, params = equation.primitive.name, equation.params
        if name in _CALLS:
            return params[_CALLS[name]]
        function = _written_by(equation)
        if function is None:
            return None
        if id(equation) not in self._traced:
            avals = (v.aval for v in equation.invars)
            like = (jax.ShapeDtypeStruct(x.shape, x.dtype) for x in avals)
            made: Any = jax.make_jaxpr(functools.partial(function, **params))
            # kept together: as long as one is there, its number is no other's
            self._traced[id(equation)] = equation, made(*like)
        return self._traced[id(equation)][1]
