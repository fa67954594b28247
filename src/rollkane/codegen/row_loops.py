"""Loops over the rows of arrays in memory, one for operations that follow one another.

A function of one row, mapped over all of them, is a chain of operations on arrays of as
many rows. A loop for each takes a compiler 2 ms; one loop does all, and hands numbers
on without reading them from memory.
"""

import math
import re
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from .array_memory import Arrays, Index, Memory, heads_of, value_of
from .scalars import Number, in_c
from .statement_writer import Block

# Numbers of a row that are written one by one: three lines each, which take a compiler
# the 2 ms of a loop in place of them
_SHORT = 12
# a number that is written to an array, and the name of one
_WRITE, _ARRAY = re.compile(r"^(m\d+)\[[^\]]*\] = (.*);$"), re.compile(r"\bm\d+\b")

Place: TypeAlias = tuple[int, ...]  # of a number in its row


class Read(NamedTuple):
    """An array that is read, and where in a row, for a place in the result's."""

    array: Memory
    places: Callable[[Place], Iterable[Place]]


class _RowLoop:
    """A loop that may go on, while nothing stands behind it.

    Attributes:
        block: Where it stands.
        start: Of its lines there.
        end: Behind them.
        body: What it repeats.
        count: How many rows, along each of its axes.
        index: Of a row, in C.
        known: Numbers, by the text of the places in memory that hold them.
        written: Arrays that it writes.
    """

    def __init__(self, block: Block, count: Place, index: Index):
        """An empty one, behind what stands there."""
        self.block, self.start, self.end = block, len(block.lines), len(block.lines)
        self.body, self.count, self.index = Block(), count, index
        self.known: dict[str, Number] = {}
        self.written: set[str] = set()

    def is_last(self, block: Block) -> bool:
        """Whether it stands in this block, and nothing behind it."""
        return self.block is block and self.end == len(block.lines)

    def has(self, read: list[tuple[Memory, Place]]) -> bool:
        """Whether it can read this: of arrays that it writes, what it has written."""
        return all(
            x.base not in self.written or x.at((*self.index, *at)) in self.known
            for x, at in read
        )

    def put(self) -> None:
        """Write it down, in place of what it was."""
        pairs = zip(self.index, self.count, strict=True)
        heads = " ".join(heads_of(pairs))
        self.block.lines[self.start :] = [f"{heads} {{", *self.body.lines, "}"]
        self.block.named |= self.body.named
        self.end = len(self.block.lines)


class RowLoops:
    """Arrays that are written row by row."""

    def __init__(self, arrays: Arrays):
        """Of a program."""
        self._arrays = arrays
        self._last: _RowLoop | None = None
        arrays.ahead = self._ahead

    @staticmethod
    def axes(shape: tuple[int, ...]) -> int:
        """Along how many axes of an array there are rows: the others are short."""
        behind = (k for k in range(1, len(shape)) if math.prod(shape[k:]) <= _SHORT)
        return next(behind, len(shape))

    def fill(
        self, to: Memory, reads: Sequence[Read], value: Callable[[list[Number]], Any]
    ) -> None:
        """Write an array that nothing has read yet.

        Args:
            to: The array.
            reads: What each of its numbers is a function of.
            value: The function. Memory has no products to be fused with sums: what it
                gives is none either.
        """
        writer, axes = self._arrays.writer, self.axes(to.shape)
        places = list(np.ndindex(to.shape[axes:]))
        read = [[(r.array, at) for r in reads for at in r.places(p)] for p in places]
        loop = self._loop(to.shape[:axes], read)
        with writer.reopened(loop.body):
            for place, own in zip(places, read, strict=True):
                found = in_c(value([self._number(loop, *one) for one in own]))
                text = to.at((*loop.index, *place))
                writer.line(f"{text} = {found.text};")
                loop.known[text] = Number(found.text, to.type)
        loop.written.add(to.base)
        loop.put()
        self._last = loop

    def _loop(self, count: Place, read: list[list[tuple[Memory, Place]]]) -> _RowLoop:
        """Over as many rows: the last one, where that can go on."""
        last, block = self._last, self._arrays.writer.block
        alike = last is not None and last.is_last(block) and last.count == count
        if last is not None and alike and all(map(last.has, read)):
            return last
        return _RowLoop(block, count, self._arrays.index(count))

    def _number(self, loop: _RowLoop, array: Memory, place: Place) -> Number:
        text = array.at((*loop.index, *place))
        if text not in loop.known:
            read = value_of(text, array.type)
            loop.known[text] = self._arrays.writer.let(read, array.type, True)
        return loop.known[text]

    def _ahead(self, lines: list[str]) -> None:
        """Statements that read no memory, ahead of a loop that may go on."""
        loop, block = self._last, self._arrays.writer.block
        if loop is None or not loop.is_last(block):
            block.lines += lines
            return
        block.lines[loop.start : loop.start] = lines
        loop.start += len(lines)
        loop.end += len(lines)


def without_lost_writes(functions: list[str]) -> list[str]:
    """A program's functions without what they write to arrays that nothing reads.

    As of arrays whose numbers their loop has handed on.
    """
    texts = [text.split("\n") for text in functions]
    writes = [[_WRITE.match(line) for line in lines] for lines in texts]
    pairs = [list(zip(*both, strict=True)) for both in zip(texts, writes, strict=True)]
    read = {
        name
        for lines in pairs
        for line, write in lines
        for name in _ARRAY.findall(write[2] if write else line)
    }
    return [
        "\n".join(line for line, write in lines if not write or write[1] in read)
        for lines in pairs
    ]
