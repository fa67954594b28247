"""Programs that a program calls at several places, written once as functions in C.

JAX keeps one program for all calls of a jitted function with arguments of one form
(``traced_once``). Where such a one is long, so is it here: its compiler's time is then
that of one call.
"""

from collections import Counter
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from .array_memory import Memory
from .data_movement import Numbers, as_objects
from .jaxpr_types import ClosedJaxpr, Jaxpr, parts_of
from .known_numbers import KNOWN
from .memory_walk import MemoryWalk, Value
from .scalars import IN_C, Number
from .statement_writer import part

# equations of a program that is worth a function: a call moves some hundred numbers
_LONG = 100

# Outputs of a program for values of its arguments.
_Write = Callable[[list[Numbers]], list[Value]]


class _Function(NamedTuple):
    """A function in C.

    Attributes:
        place: Among the functions, by which its name is known.
        results: Outputs, known numbers as they are, others as places in what it leaves.
        types: Of the numbers that it leaves.
    """

    place: int
    results: list[Numbers]
    types: list[str]


class SharedCalls:
    """Functions in C of the long programs that a program calls more than once."""

    def __init__(self, walk: MemoryWalk, jaxpr: Jaxpr):
        """Of the calls in a program, however deep inside."""
        self._walk = walk
        self._counts: Counter[int] = Counter()
        self._sizes: dict[int, int] = {}
        self._written: dict[Any, _Function | None] = {}
        self._count(jaxpr)

    def _count(self, jaxpr: Jaxpr) -> int:
        """Equations of a program, those of its parts among them."""
        total = 0
        for equation in jaxpr.eqns:
            called = self._walk.programs.of(equation)
            parts: list[Any] = parts_of(equation.params) if called is None else [called]
            for inner in parts:
                key = id(inner)
                if called is not None:
                    self._counts[key] += 1
                if key not in self._sizes:
                    self._sizes[key] = self._count(getattr(inner, "jaxpr", inner))
                total += self._sizes[key]
            total += not parts
        return total

    def called(
        self, program: ClosedJaxpr, inputs: list[Value], write: _Write
    ) -> list[Value] | None:
        """What a call gives; None: it is not one of a function.

        Args:
            program: That is called.
            inputs: Its arguments.
            write: Writes the program itself, of values of its arguments.
        """
        if self._counts[id(program)] < 2 or self._sizes[id(program)] < _LONG:
            return None
        if any(isinstance(x, Memory) for x in inputs):
            return None
        form = tuple((x.shape, tuple(map(_form_of, x.reshape(-1)))) for x in inputs)
        key = id(program), form
        if key not in self._written:
            self._written[key] = self._function(inputs, write)
        function = self._written[key]
        return None if function is None else self._call(function, inputs)

    def _function(self, inputs: list[Numbers], write: _Write) -> _Function | None:
        """A program as a function in C; None where it leaves arrays in memory."""
        writer = self._walk.writer
        with writer.apart() as block:
            given: list[Numbers] = []
            count = 0
            for x in inputs:
                own: list[Any] = []
                for number in x.reshape(-1):
                    if isinstance(number, Number):
                        kind = number.type
                        text = f"({IN_C[kind]})given[{count}]"
                        own.append(writer.let(text, kind))
                        count += 1
                    else:
                        own.append(number)
                given.append(as_objects(own, x.shape))
            found = write(given)
            if any(isinstance(x, Memory) for x in found):
                return None
            types: list[str] = []
            results: list[Numbers] = []
            for x in found:
                places: list[Any] = []
                for number in x.reshape(-1):
                    if not isinstance(number, Number):
                        places.append(number)
                        continue
                    places.append(len(types))
                    writer.line(f"left[{len(types)}] = (double){number.text};")
                    types.append(number.type)
                results.append(as_objects(places, x.shape))
        index = len(writer.functions)
        writer.functions.append("\n".join([f"{part(index)} {{", *block.lines, "}"]))
        return _Function(index, results, types)

    def _call(self, function: _Function, inputs: list[Numbers]) -> list[Numbers]:
        """What a call of a function leaves."""
        writer = self._walk.writer
        unknown = [n for x in inputs for n in x.reshape(-1) if isinstance(n, Number)]
        handed = ", ".join(f"(double){x.text}" for x in unknown)
        left = writer.called(function.place, handed or "0", function.types)
        results: list[Numbers] = []
        for x in function.results:
            numbers = [left[n] if isinstance(n, int) else n for n in x.reshape(-1)]
            results.append(as_objects(numbers, x.shape))
        return results


def _form_of(x: Any) -> Any:
    """What a function's text depends on: a number's type, or itself where known."""
    if isinstance(x, Number):
        return x.type
    assert isinstance(x, KNOWN)
    return np.dtype(x.dtype).str, x.tobytes()
