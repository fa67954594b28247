"""What is read of JAX's traced programs: their own types leave shapes open.

JAX declares a variable's ``aval`` as an abstract value, of which it is not known that
it has a shape. Programs of arrays, the only ones that become C, have these.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Protocol, cast

import numpy as np
from jax.extend.core import Primitive

Params = Mapping[str, Any]  # of an equation, by name


class Shaped(Protocol):
    """An array, or its shape and type."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Length of each axis."""
        ...

    @property
    def dtype(self) -> np.dtype:
        """Type of its numbers."""
        ...


class Aval(Shaped, Protocol):
    """What is known of an array before it is computed."""

    @property
    def size(self) -> int:
        """How many numbers."""
        ...

    @property
    def ndim(self) -> int:
        """How many axes."""
        ...


class Variable(Protocol):
    """A name in a program, or a number that is written there."""

    @property
    def aval(self) -> Aval:
        """What is known of it."""
        ...


class Literal(Variable, Protocol):
    """A number that is written in a program."""

    @property
    def val(self) -> Any:
        """It."""
        ...


class Equation(Protocol):
    """One operation of a program."""

    @property
    def primitive(self) -> Primitive:
        """Which."""
        ...

    @property
    def params(self) -> Params:
        """How."""
        ...

    @property
    def invars(self) -> Sequence[Variable]:
        """Of what."""
        ...

    @property
    def outvars(self) -> Sequence[Variable]:
        """Its results."""
        ...


class Jaxpr(Protocol):
    """A program; the values of ``constvars`` are what it closes over."""

    @property
    def constvars(self) -> Sequence[Variable]:
        """Names of what it closes over."""
        ...

    @property
    def invars(self) -> Sequence[Variable]:
        """Its arguments."""
        ...

    @property
    def outvars(self) -> Sequence[Variable]:
        """Its results."""
        ...

    @property
    def eqns(self) -> Sequence[Equation]:
        """Its operations, in order."""
        ...


class ClosedJaxpr(Protocol):
    """A program with the arrays that it closes over."""

    @property
    def jaxpr(self) -> Jaxpr:
        """The program."""
        ...

    @property
    def consts(self) -> list[Any]:
        """The arrays."""
        ...

    @property
    def in_avals(self) -> Sequence[Aval]:
        """Of its arguments."""
        ...

    @property
    def out_avals(self) -> Sequence[Aval]:
        """Of its results."""
        ...


def parts_of(params: Params) -> list[Any]:
    """The programs among an equation's parameters."""
    several = (tuple, list)
    values: list[Any] = []
    for value in params.values():
        values += cast(Any, value) if isinstance(value, several) else [value]
    return [x for x in values if hasattr(x, "eqns") or hasattr(x, "jaxpr")]


def numbers_in(jaxpr: Jaxpr) -> int:
    """How many numbers the equations of a program give, those of its parts too."""
    total = 0
    for equation in jaxpr.eqns:
        parts = parts_of(equation.params)
        if parts:
            total += sum(numbers_in(getattr(x, "jaxpr", x)) for x in parts)
        else:
            total += sum(v.aval.size for v in equation.outvars)
    return total
