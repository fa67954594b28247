"""Arrays of a program in C that lie in memory, and loops over them.

They hold real numbers, whatever their type. An array that is looked at in another order
is the same memory, unless it may be changed in place.
"""

import itertools
import math
from collections.abc import Callable, Generator, Iterable, Sequence
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np

from .data_movement import Numbers, as_objects
from .scalar_source import literal
from .scalars import IN_C, Number, in_c
from .statement_writer import Writer
from .whole_numbers import type_of

Index = tuple[int | str, ...]  # of a number in an array: known, or a text in C


Look = Callable[[np.ndarray], np.ndarray]  # at an array, in another order


class Memory(NamedTuple):
    """An array in memory.

    Attributes:
        base: Where it is, in C.
        type: ``real``, ``whole`` or ``truth``.
        shape: As of an array.
        strides: From one number to the next along each axis.
        offset: Of the first number.
        owned: Whether what reads it next may change it in place.
    """

    base: str
    type: str
    shape: tuple[int, ...]
    strides: tuple[int, ...]
    offset: int = 0
    owned: bool = False

    @property
    def size(self) -> int:
        """How many numbers."""
        return math.prod(self.shape)

    @property
    def is_packed(self) -> bool:
        """Whether its numbers lie one behind the other, in order."""
        return self.strides == packed(self.shape)

    def is_at(self, other: "Memory") -> bool:
        """Whether its numbers are those of another."""
        place: Callable[[Memory], object] = lambda x: (x.base, x.offset, x.strides)
        return place(self) == place(other)

    def at(self, index: Sequence[int | str]) -> str:
        """One of its numbers, in C; an index is a number or a text."""
        pairs = zip(index, self.strides, strict=True)
        terms: list[str] = []
        constant = self.offset
        for i, stride in pairs:
            if isinstance(i, int):
                constant += i * stride
            elif stride:
                terms.append(i if stride == 1 else f"{i} * {stride}")
        if constant or not terms:
            terms.append(str(constant))
        return f"{self.base}[{' + '.join(terms)}]"

    def spread(self, shape: tuple[int, ...]) -> "Memory":
        """With its axes of length one as long as another's."""
        pairs = zip(self.strides, self.shape, shape, strict=True)
        strides = tuple(0 if n == 1 != m else s for s, n, m in pairs)
        return self._replace(shape=shape, strides=strides)

    def looked_at(self, function: Look) -> "Memory":
        """What a function of arrays that computes nothing makes of it: no copy."""
        # addresses of an array as large, whose strides tell those of the result
        first = np.lib.stride_tricks.as_strided(
            np.empty(0, np.int8), self.shape, self.strides, writeable=False
        )
        seen = function(first)
        assert not seen.flags.owndata, "a copy is no other look"
        start = (
            seen.__array_interface__["data"][0] - first.__array_interface__["data"][0]
        )
        return self._replace(
            shape=seen.shape, strides=seen.strides, offset=self.offset + start
        )


def packed(shape: tuple[int, ...]) -> tuple[int, ...]:
    """Strides of an array whose numbers lie one behind the other."""
    behind = itertools.accumulate(reversed(shape[1:]), lambda a, b: a * b, initial=1)
    return tuple(reversed(list(behind)))[: len(shape)]


def heads_of(loops: Iterable[tuple[int | str, int]]) -> list[str]:
    """Heads of loops, by their indices and how often; none of those that are known."""
    return [f"for (long {i} = 0; {i} < {n}; {i}++)" for i, n in loops if i != 0]


def value_of(text: str, kind: str) -> str:
    """A number that lies in memory, with its type."""
    if kind == "truth":
        return f"({text} != 0)"
    return text if kind == "real" else f"({IN_C[kind]}){text}"


class Arrays:
    """Arrays in memory, written and read."""

    def __init__(self, writer: Writer):
        """Of a program."""
        self.writer = writer
        self._loops = itertools.count()
        self._known: dict[tuple[np.dtype, bytes], str] = {}
        # writes statements that read no memory
        self.ahead: Callable[[list[str]], None] = lambda x: writer.block.lines.extend(x)

    def new(self, shape: tuple[int, ...], kind: str) -> Memory:
        """Memory for an array, of which this is the only name."""
        place = self.writer.place(math.prod(shape))
        return Memory(place, kind, shape, packed(shape), owned=True)

    def index(self, shape: tuple[int, ...]) -> Index:
        """Names for the indices of loops along axes; 0 where that is all."""
        return tuple(0 if n == 1 else f"i{next(self._loops)}" for n in shape)

    @contextmanager
    def loops(self, shape: tuple[int, ...]) -> Generator[Index, None, None]:
        """A loop over each axis; gives the indices, in C."""
        index = self.index(shape)
        with self.writer.braces(" ".join(heads_of(zip(index, shape, strict=True)))):
            yield index

    def stored(self, numbers: Numbers, kind: str) -> Memory:
        """Single numbers as an array in memory."""
        flat = list(numbers.reshape(-1))
        if not any(isinstance(x, Number) for x in flat):
            texts = (f"(real){in_c(x).text}" for x in flat)
            name = self.writer.table(texts)
            return Memory(name, kind, numbers.shape, packed(numbers.shape))
        to = self.new(numbers.shape, kind)
        self.ahead([f"{to.base}[{i}] = {in_c(x).text};" for i, x in enumerate(flat)])
        return to

    def known(self, array: np.ndarray) -> Memory:
        """A known array: a table of as many numbers is written once."""
        kind, key = type_of(array.dtype), (array.dtype, array.tobytes())
        if key not in self._known:
            real = kind == "real"  # 1.0 us each instead of 1.6
            flat = array.reshape(-1)
            texts = (
                map(literal, flat.tolist()) if real else [in_c(x).text for x in flat]
            )
            self._known[key] = self.writer.table(texts)
        return Memory(self._known[key], kind, array.shape, packed(array.shape))

    def in_memory(self, x: Any, kind: str) -> Memory:
        """An array in memory, or single numbers there."""
        if isinstance(x, Memory):
            return x
        if x.size > 1 and all(v is x.reshape(-1)[0] for v in x.reshape(-1)[1:]):
            one = self.stored(as_objects([x.reshape(-1)[0]], (1,)), kind)
            return one._replace(shape=x.shape, strides=(0,) * x.ndim)
        return self.stored(x, kind)

    def loaded(self, memory: Memory) -> Numbers:
        """An array in memory as single numbers."""
        found = [
            self.writer.let(value_of(memory.at(i), memory.type), memory.type, True)
            for i in np.ndindex(memory.shape)
        ]
        return as_objects(found, memory.shape)

    def number_at(self, memory: Memory, index: Sequence[int | str]) -> Number:
        """One number of an array in memory."""
        text = value_of(memory.at(index), memory.type)
        return self.writer.let(text, memory.type, True)

    def filled(self, to: Memory, value: Callable[[Index], Any]) -> Memory:
        """An array whose number at an index is this one."""
        with self.loops(to.shape) as index:
            self.writer.line(f"{to.at(index)} = {in_c(value(index)).text};")
        return to

    def copied(self, x: Memory, to: Memory | None = None) -> Memory:
        """Its numbers in another place."""
        if to is None:
            to = self.new(x.shape, x.type)
        if x.is_packed and to.is_packed:
            first = f"{to.base} + {to.offset}", f"{x.base} + {x.offset}"
            size = f"{x.size} * sizeof(real)"
            self.writer.line(f"memcpy({first[0]}, {first[1]}, {size});")
            return to
        return self.filled(to, lambda index: Number(x.at(index), x.type))
