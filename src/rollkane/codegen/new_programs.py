"""Traced programs that are written here, equation by equation, as JAX's own are.

A derivative of a traced program is such a program again. JAX would trace it anew, for a
tenth of a millisecond an equation.
"""

import functools
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple, TypeGuard, cast

import jax
import numpy as np
from jax.core import ShapedArray
from jax.extend import core
from jaxtyping import Array

from .jaxpr_types import Aval, ClosedJaxpr, Equation, Jaxpr, Literal, Params, Variable


class NewVariable:
    """A name in a program."""

    __slots__ = ("aval",)

    def __init__(self, aval: Aval):
        """One for arrays of a shape and type."""
        self.aval = aval


class _Named(NamedTuple):
    """What stands for one of XLA's operations."""

    name: str


class NewEquation(NamedTuple):
    """One operation of a program."""

    primitive: Any
    params: Params
    invars: Sequence[Variable]
    outvars: Sequence[Variable]

    @staticmethod
    def of(
        name: str,
        params: Params,
        inputs: Iterable[Variable],
        outputs: Iterable[Variable],
    ) -> "NewEquation":
        """An operation of this name."""
        return NewEquation(_Named(name), params, [*inputs], [*outputs])


class NewJaxpr(NamedTuple):
    """The equations of a program, and what goes in and out."""

    constvars: Sequence[Variable]
    invars: Sequence[Variable]
    outvars: Sequence[Variable]
    eqns: Sequence[Equation]


class NewProgram:
    """A program with the arrays that it closes over; equal to itself alone.

    Attributes:
        jaxpr: Its equations.
        consts: Values of the jaxpr's ``constvars``.
    """

    def __init__(self, jaxpr: Jaxpr, consts: list[Any]):
        """Of equations."""
        self.jaxpr, self.consts = jaxpr, consts

    @property
    def in_avals(self) -> list[Aval]:
        """Of the arguments."""
        return [v.aval for v in self.jaxpr.invars]

    @property
    def out_avals(self) -> list[Aval]:
        """Of the results."""
        return [v.aval for v in self.jaxpr.outvars]


def is_literal(v: object) -> TypeGuard[Literal]:
    """Whether a variable is a number that is written in its place."""
    return isinstance(v, core.Literal)


def is_float(aval: Aval) -> bool:
    """Whether an array can have a tangent."""
    return aval.dtype.kind == "f"


def shaped(shape: Sequence[int], dtype: np.dtype) -> Aval:
    """Of arrays of a shape and type."""
    return cast(Aval, ShapedArray(tuple(shape), dtype))


def number(value: float, dtype: np.dtype) -> Literal:
    """A number, written in a program."""
    aval: Any = ShapedArray((), dtype)
    return cast(Literal, core.Literal(np.asarray(value, dtype)[()], aval))


class Builder:
    """Equations as they are written.

    Attributes:
        eqns: They.
    """

    def __init__(self):
        """None yet."""
        self.eqns: list[Equation] = []

    def emit(
        self,
        name: str,
        params: Params,
        inputs: Iterable[Variable],
        *outputs: Aval,
    ) -> list[NewVariable]:
        """Results of an operation."""
        found = [NewVariable(aval) for aval in outputs]
        self.eqns.append(NewEquation.of(name, params, inputs, found))
        return found

    def one(self, name: str, *inputs: Variable, **params: Any) -> Variable:
        """Result of an operation on numbers; an axis of length one serves all."""
        shape = np.broadcast_shapes(*(v.aval.shape for v in inputs))
        return self.emit(name, params, inputs, shaped(shape, inputs[0].aval.dtype))[0]

    def compared(self, name: str, a: Variable, b: Variable) -> Variable:
        """Truth of a comparison."""
        aval = shaped(a.aval.shape, np.dtype(bool))
        return self.emit(name, {}, (a, b), aval)[0]

    def chosen(self, which: Variable, no: Variable, yes: Variable) -> Variable:
        """One of two numbers."""
        return self.emit("select_n", {}, (which, no, yes), yes.aval)[0]

    def added(self, *terms: Variable | None) -> Variable | None:
        """Their sum; None is zero."""
        known = [x for x in terms if x is not None]
        if not known:
            return None
        return functools.reduce(lambda a, b: self.one("add_any", a, b), known)

    def zeros(self, aval: Aval) -> Variable:
        """Zeros in the form of an array."""
        zero = number(0.0, aval.dtype)
        return self.spread(zero, aval) if aval.shape else zero

    def known(self, x: Variable | None, aval: Aval) -> Variable:
        """An array; None is zero."""
        return self.zeros(aval) if x is None else x

    def spread(self, x: Variable, aval: Aval) -> Variable:
        """A number, or what has axes of length one, for every place of an array."""
        if x.aval.shape == aval.shape:
            return x
        params = {
            "shape": aval.shape,
            "broadcast_dimensions": tuple(range(x.aval.ndim)),
        }
        return self.emit("broadcast_in_dim", params, [x], aval)[0]


def pruned(eqns: Sequence[Equation], outvars: Iterable[Variable]) -> list[Equation]:
    """Those equations that something depends on."""
    used = {v for v in outvars if not is_literal(v)}
    kept: list[Equation] = []
    for equation in reversed(eqns):
        if used.isdisjoint(equation.outvars):
            continue
        kept.append(equation)
        used.update(v for v in equation.invars if not is_literal(v))
    return kept[::-1]


class ByItself(NamedTuple):
    """An equation of JAX's as a function.

    Attributes:
        function: ``function(*arrays)`` -> results.
        inputs: Its variables.
        outputs: Likewise.
    """

    function: Callable[..., Sequence[Array]]
    inputs: list[Variable]
    outputs: list[Variable]


def by_itself(jaxpr: Any, equation: Any) -> ByItself:
    """An equation of one of JAX's programs."""
    inputs = list(dict.fromkeys(v for v in equation.invars if not is_literal(v)))
    outputs = list(equation.outvars)
    alone = jaxpr.replace(constvars=[], invars=inputs, outvars=outputs, eqns=[equation])
    function = cast(Any, core.jaxpr_as_fun)(core.ClosedJaxpr(alone, []))
    return ByItself(function, inputs, outputs)


def traced(function: Callable[..., Any], avals: Iterable[Aval]) -> ClosedJaxpr:
    """JAX's program of a function of arrays."""
    like = (jax.ShapeDtypeStruct(x.shape, x.dtype) for x in avals)
    return cast(ClosedJaxpr, jax.make_jaxpr(function)(*like))
