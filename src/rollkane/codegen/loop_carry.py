"""What goes from turn to turn of a loop in C, in variables and arrays of its own."""

from .array_memory import Memory
from .data_movement import as_objects
from .indexed_operations import WRITING
from .jaxpr_types import Aval, ClosedJaxpr
from .memory_walk import SMALL, MemoryWalk, Value
from .scalars import in_c
from .statement_writer import Target
from .whole_numbers import type_of


class Carry:
    """What goes from turn to turn of a loop, in variables and arrays of its own.

    Attributes:
        values: What a turn begins with, and what the loop leaves.
    """

    def __init__(
        self,
        walk: MemoryWalk,
        body: ClosedJaxpr,
        first: int,
        begun: list[Value],
        homes: list[Memory | None],
    ):
        """Of a loop's body, in which it begins at one of the arguments.

        Arrays that have a home are there from the first.
        """
        self.walk = walk
        jaxpr = body.jaxpr
        places = jaxpr.invars[first : first + len(begun)]
        ends = jaxpr.outvars[: len(begun)]
        self.stays = [a is b for a, b in zip(places, ends, strict=True)]
        written = {e.invars[0] for e in jaxpr.eqns if e.primitive.name in WRITING}
        self.in_memory = [v in written or v.aval.size > SMALL for v in places]
        self.values = [
            x if stays else self._own(x, v.aval, home, large)
            for x, stays, v, home, large in zip(
                begun, self.stays, places, homes, self.in_memory, strict=True
            )
        ]

    def _own(self, x: Value, aval: Aval, home: Memory | None, large: bool) -> Value:
        kind = type_of(aval.dtype)
        if large:
            x = self.walk.arrays.in_memory(x, kind)
        x = x if large else self.walk.numbers(x)
        if isinstance(x, Memory):
            if home is None and x.owned and x.is_packed:
                return x
            return self.walk.arrays.copied(x, home)._replace(owned=True)
        variables = [self.walk.writer.variable(kind, in_c(v)) for v in x.reshape(-1)]
        return as_objects(variables, x.shape)

    def targets(self, found: list[Value]) -> list[Target]:
        """What a turn leaves; the turn is being written."""
        walk = self.walk
        bases = {x.base for x in self.values if isinstance(x, Memory)}
        names = {
            v.text
            for x, stays in zip(self.values, self.stays, strict=True)
            if not isinstance(x, Memory) and not stays
            for v in x.reshape(-1)
        }
        moved: list[tuple[Memory, Memory]] = []
        targets: list[Target] = []
        for to, x, stays in zip(self.values, found, self.stays, strict=True):
            if stays:
                continue
            if isinstance(to, Memory):
                x = walk.arrays.in_memory(x, to.type)
                if x.is_at(to):
                    continue
                if x.base in bases:  # another's, which may be changed before
                    x = walk.arrays.copied(x)
                moved.append((to, x))
                continue
            numbers = walk.numbers(x).reshape(-1)
            for a, b in zip(to.reshape(-1), numbers, strict=True):
                b = in_c(b)
                if b.text == a.text:
                    continue
                if b.text in names:
                    b = walk.writer.copy(b)
                targets.append(Target(a.text, b))
        for to, x in moved:
            walk.arrays.copied(x, to)
        return targets
