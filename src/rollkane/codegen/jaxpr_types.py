"""What is read of JAX's traced programs: their own types leave shapes open.

JAX declares a variable's ``aval`` as an abstract value, of which it is not known that
it has a shape. Programs of arrays, the only ones that become C, have these.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

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

    aval: Aval


class Literal(Variable, Protocol):
    """A number that is written in a program."""

    val: Any


class Equation(Protocol):
    """One operation of a program."""

    primitive: Primitive
    params: Params
    invars: Sequence[Variable]
    outvars: Sequence[Variable]


class Jaxpr(Protocol):
    """A program; the values of ``constvars`` are what it closes over."""

    constvars: Sequence[Variable]
    invars: Sequence[Variable]
    outvars: Sequence[Variable]
    eqns: Sequence[Equation]


class ClosedJaxpr(Protocol):
    """A program with the arrays that it closes over."""

    jaxpr: Jaxpr
    consts: list[Any]
    in_avals: Sequence[Aval]
    out_avals: Sequence[Aval]
