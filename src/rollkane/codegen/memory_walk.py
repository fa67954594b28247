"""One way through a traced program with arrays in memory.

Small arrays are single numbers, larger ones lie in memory. What operations are to those
(:mod:`.array_operations`, :mod:`.indexed_operations`) needs no more of the walk than
this; loops and branches come with :mod:`.control_flow`.
"""

from typing import Any

import numpy as np
from jax.typing import DTypeLike

from .array_memory import Arrays, Memory
from .data_movement import numbers_of
from .fused import Products
from .jaxpr_types import Params
from .row_loops import RowLoops
from .scalar_program import NotElementwiseError, Walk
from .scalars import Number, expression, in_c
from .statement_writer import Writer, stays
from .whole_numbers import type_of

# numbers of an array that are written one by one
SMALL = 32

# Numbers or Memory: a walk's methods for single numbers alone take those
Value = Any


class MemoryWalk(Walk):
    """A walk that writes a program in C, with arrays in memory.

    Attributes:
        small: Numbers of an array that are written one by one.
        writer: What is written.
        arrays: Its arrays in memory.
        rows: Loops over rows of these.
    """

    def __init__(self, dtype: DTypeLike):
        """An empty program of real numbers of this type."""
        super().__init__(self._operate)
        self.small = SMALL
        self.dtype = np.dtype(dtype)
        self.writer = Writer()
        self.arrays = Arrays(self.writer)
        self.rows = RowLoops(self.arrays)
        self._products = Products()

    def _operate(
        self, name: str, params: Params, operands: list[Any], dtype: np.dtype
    ) -> Number:
        if dtype.kind == "f" and dtype != self.dtype:
            raise NotElementwiseError(f"numbers of {dtype}")
        if name == "copy":
            (x,) = operands
            return self.writer.copy(x) if self._products.holds(x) else x
        if dtype.kind == "f":
            name, operands = self._products.fused(name, operands)
        text = expression(name, params, operands, dtype)
        number = self.writer.let(text, type_of(dtype))
        if dtype.kind == "f" and all(map(stays, operands)):
            self._products.note(name, operands, number.text)
        return number

    def of_its_size(self, x: Value) -> Value:
        """Single numbers only if they are few, else an array in memory."""
        if isinstance(x, Memory):
            return x
        if x.size <= SMALL:
            return x if x.dtype == object else numbers_of(x)
        if x.dtype != object:
            return self.arrays.known(np.asarray(x))
        return self.arrays.in_memory(x, in_c(x.reshape(-1)[0]).type)

    def numbers(self, x: Value) -> Value:
        """Single numbers if they are few: read from memory where they are used."""
        small = isinstance(x, Memory) and x.size <= SMALL
        return self.arrays.loaded(x) if small else x


def kept(x: Value) -> Value:
    """A value that is read again: nothing changes it in place."""
    return x._replace(owned=False) if isinstance(x, Memory) else x
