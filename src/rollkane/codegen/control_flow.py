"""A traced program as one in C, with its loops and branches.

Small arrays are single numbers, larger ones lie in memory and are worked off in loops.
A branch that is not taken costs nothing, a loop has its body once.
"""

import functools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from jax.typing import DTypeLike

from .array_memory import Index, Memory
from .array_operations import in_memory, in_shape
from .called_programs import calls, rows_of
from .data_movement import as_objects
from .indexed_operations import OPERATIONS
from .jaxpr_types import (
    Aval,
    ClosedJaxpr,
    Equation,
    Jaxpr,
    Variable,
    numbers_in,
)
from .loop_carry import Carry
from .loop_invariants import invariants
from .memory_walk import SMALL, MemoryWalk, Value, kept
from .new_programs import pruned
from .scalar_program import ELEMENTWISE, NotElementwiseError
from .scalars import Number, in_c
from .shared_calls import SharedCalls
from .statement_writer import Block, Target
from .value_uses import is_free, is_literal, last_uses, read
from .whole_numbers import type_of

# numbers of a loop of known length that is written out
_WRITTEN_OUT = 300
# equations of a branch that is computed whether it is taken or not
_CHEAP = 4

_AGAIN = ("remat", "checkpoint", "remat2")
_WITH_PROGRAMS = ("while", "scan", "cond", *_AGAIN)
# what an array is looked at by, or made of one number
_MOVES = {"broadcast_in_dim", "reshape", "squeeze", "transpose", "slice", "iota"}

_Written = list[tuple[Block, list[Value]]]  # branches, and what each of them gives


class Structured(MemoryWalk):
    """One way through a traced program, which writes it in C.

    Attributes:
        homes: Where larger arrays are left in the end that a loop makes.
    """

    def __init__(self, dtype: DTypeLike, jaxpr: Jaxpr):
        """An empty program of real numbers of this type, for a traced one."""
        super().__init__(dtype)
        self.homes: dict[Variable, Memory] = {}
        self._loops = 0  # that hold what is being written
        self._shared = SharedCalls(self, jaxpr)
        self._kept: dict[int, tuple[Jaxpr, list[Equation]]] = {}

    def through(
        self,
        jaxpr: Jaxpr,
        closed: Sequence[Any],
        values: list[Value],
        ready: dict[Variable, Value] | None = None,
    ) -> list[Value]:
        """Outputs of a program inside of the program.

        Args:
            jaxpr: The program.
            closed: What it closes over.
            values: Its arguments.
            ready: What has been computed of it.
        """
        begun = (*map(self.of_its_size, closed), *values)
        known = dict(zip((*jaxpr.constvars, *jaxpr.invars), begun, strict=True))
        equations = self._needed(jaxpr)
        if ready:
            known |= ready
            equations = [e for e in equations if e.outvars[0] not in ready]
        self._follow(equations, jaxpr.outvars, known)
        return [read(v, known) for v in jaxpr.outvars]

    def _follow(
        self,
        equations: list[Equation],
        outvars: Sequence[Variable],
        known: dict[Variable, Value],
    ) -> None:
        """Add to what is known what equations give."""
        last: dict[Variable, float] | None = None
        for i, equation in enumerate(equations):
            inputs = [read(v, known) for v in equation.invars]
            if any(isinstance(x, Memory) for x in inputs):
                last = last or last_uses(equations, outvars)
                inputs = self._of_memory(equation, i, known, last)
            results = map(self.of_its_size, self.results(equation, inputs))
            known.update(zip(equation.outvars, results, strict=True))

    def _ahead(self, body: ClosedJaxpr, fixed: list[Value]) -> dict[Variable, Value]:
        """What a loop's body computes of larger arrays that no turn changes."""
        jaxpr, first = body.jaxpr, len(fixed)
        names = *jaxpr.constvars, *jaxpr.invars[:first]
        equations = invariants(self._needed(jaxpr), names, _is_work)
        if not equations:
            return {}
        given = *map(self.of_its_size, body.consts), *fixed
        known = dict(zip(names, map(kept, given), strict=True))
        results = [v for equation in equations for v in equation.outvars]
        self._follow(equations, results, known)
        return {v: kept(known[v]) for v in results}

    def _needed(self, jaxpr: Jaxpr) -> list[Equation]:
        """Equations on which a program's results depend."""
        if id(jaxpr) not in self._kept:
            # with the program: as long as it is there, its number is no other's
            self._kept[id(jaxpr)] = jaxpr, pruned(jaxpr.eqns, jaxpr.outvars)
        return self._kept[id(jaxpr)][1]

    def _of_memory(
        self,
        equation: Equation,
        i: int,
        known: dict[Variable, Value],
        last: dict[Variable, float],
    ) -> list[Value]:
        """Inputs of equation i: numbers, or arrays, owned where it may change them."""
        names = [v for v in equation.invars if not is_literal(v)]
        if not _takes_memory(equation):
            known.update((v, self.numbers(known[v])) for v in names)
        free = {v for v in names if is_free(v, known, names, last, i)}
        return [
            read(v, known) if is_literal(v) or v in free else kept(known[v])
            for v in equation.invars
        ]

    def results(self, equation: Equation, inputs: list[Value]) -> list[Value]:
        """What one equation gives."""
        name = equation.primitive.name
        if name in ELEMENTWISE and not _has_large(equation):  # most of them
            out = equation.outvars[0].aval
            how = name, equation.params
            return [self.elementwise(*how, inputs, out.shape, out.dtype)]
        if name in _AGAIN:
            return self.through(equation.params["jaxpr"], [], inputs)
        if name in ("optimization_barrier", "copy_p"):
            return inputs
        inner = self.programs.of(equation)
        if inner is not None:
            write = functools.partial(self._alone, inner)
            shared = self._shared.called(inner, inputs, write)
            return self._run(inner, inputs) if shared is None else shared
        own = OPERATIONS.get(name)
        if own is not None:
            return own(self, equation, inputs)
        if name in _WITH_PROGRAMS:
            return super().results(equation, inputs)
        if not _has_large(equation):
            return super().results(equation, inputs)
        return in_memory(self, equation, inputs)

    def controlled(self, equation: Equation, inputs: list[Value]) -> list[Value]:
        """What an equation gives that holds programs."""
        name = equation.primitive.name
        if name == "while":
            return self._looped(equation, inputs)
        if name == "scan":
            return self._scanned(equation, inputs)
        if name == "cond":
            return self._branched(equation.params["branches"], inputs)
        raise NotElementwiseError(name)

    # -- loops -----------------------------------------------------------------------

    def _looped(self, equation: Equation, inputs: list[Value]) -> list[Value]:
        params = equation.params
        more, body = params["cond_jaxpr"], params["body_jaxpr"]
        first, second = params["cond_nconsts"], params["body_nconsts"]
        closed = list(map(kept, inputs[: first + second]))
        of_cond, of_body = closed[:first], closed[first:]
        homes = [self.homes.get(v) for v in equation.outvars]
        ready = self._ahead(body, of_body)
        carry = Carry(self, body, second, inputs[first + second :], homes)
        (asked,) = more.out_avals
        with self.writer.braces("for (;;)"):
            (going,) = self._run(more, [*of_cond, *map(kept, carry.values)])
            going = self.numbers(going)
            # an inner loop is a search, of which half is not a number to go on with
            told = "" if self._loops else " || to_end_now()"
            self.writer.line(f"if (!({self._any(going)}){told}) break;")
            self._loops += 1
            with self.writer.inner() as block:
                if asked.shape:  # each member of a batch has its own number of turns
                    begun = list(map(kept, carry.values))
                    found = self._run(body, [*of_body, *begun], ready)
                    avals = body.out_avals
                    found = [
                        self._where(going, a, b, v)
                        for a, b, v in zip(found, begun, avals, strict=True)
                    ]
                else:
                    found = self._run(body, [*of_body, *carry.values], ready)
                targets = carry.targets(found)
            self._loops -= 1
            self.writer.put(block, targets)
        return carry.values

    def _any(self, going: Value) -> str:
        """Whether one of some truth values is true, in C."""
        if not isinstance(going, Memory):
            truth = np.dtype(bool)
            return in_c(self.folded("or", list(going.reshape(-1)), truth)).text
        some = self.writer.variable("truth", Number("0", "truth"))
        with self.arrays.loops(going.shape) as index:
            self.writer.line(f"{some.text} |= {going.at(index)} != 0;")
        return some.text

    def _where(self, going: Value, new: Value, old: Value, aval: Aval) -> Value:
        """What a turn leaves, for the members of a batch that it is for."""
        new, old = self.numbers(new), self.numbers(old)
        shape, kind = aval.shape, type_of(aval.dtype)
        axes = (*going.shape, *[1] * (len(shape) - len(going.shape)))
        if not any(isinstance(x, Memory) for x in (going, new, old)):
            inputs = [going.reshape(axes), old, new]
            return self.elementwise("select_n", {}, inputs, shape, aval.dtype)
        place = self.arrays.in_memory(going, "truth")
        place = in_shape(self, place, axes).spread(shape)
        parts = [self.arrays.in_memory(x, kind) for x in (new, old)]

        def chosen(index: Index) -> Number:
            a, b = (x.at(index) for x in parts)
            return Number(f"({place.at(index)} != 0 ? {a} : {b})", "real")

        return self.arrays.filled(self.arrays.new(shape, kind), chosen)

    def _scanned(self, equation: Equation, inputs: list[Value]) -> list[Value]:
        params = equation.params
        body, length = params["jaxpr"], params["length"]
        parts = rows_of(equation)
        first, behind = parts.shared, parts.carried
        numbers = length * numbers_in(body.jaxpr)
        small = max([x.size for x in inputs], default=0) <= SMALL
        if numbers <= _WRITTEN_OUT and small:
            return self.repeated(equation, list(map(self.numbers, inputs)))
        shared, begun, rows = parts.parted(inputs)
        shared = list(map(kept, shared))
        kinds = [type_of(v.aval.dtype) for v in equation.invars[first + behind :]]
        stacks = list(map(self.arrays.in_memory, rows, kinds))
        ready = self._ahead(body, shared)
        carry = Carry(self, body, first, begun, [None] * behind)
        outs = [
            self.arrays.new((length, *v.shape), type_of(v.dtype))
            for v in body.out_avals[behind:]
        ]
        turn = self.writer.variable("whole", Number("0L", "whole"))
        with self.writer.braces(f"for (; {turn.text} < {length}; {turn.text}++)"):
            at = turn.text
            if params["reverse"]:
                at = self.writer.let(f"{length - 1} - {turn.text}", "whole").text
            with self.writer.inner() as block:
                taken = [self._row(x, at) for x in stacks]
                found = self._run(body, [*shared, *carry.values, *taken], ready)
                for to, x in zip(outs, found[behind:], strict=True):
                    self._leave(to, at, x)
                targets = carry.targets(found[:behind])
            self.writer.put(block, targets)
        return [*carry.values, *outs]

    def _row(self, x: Memory, at: str) -> Value:
        """A row of an array, which nothing changes."""
        shape = x.shape[1:]
        if math.prod(shape) <= SMALL:
            found = [self.arrays.number_at(x, (at, *i)) for i in np.ndindex(shape)]
            return as_objects(found, shape)
        to = self.arrays.new(shape, x.type)
        return self.arrays.filled(to, lambda i: Number(x.at((at, *i)), x.type))

    def _leave(self, to: Memory, at: str, x: Value) -> None:
        """A row of an array that is written row by row."""
        if isinstance(x, Memory):
            with self.arrays.loops(x.shape) as index:
                self.writer.line(f"{to.at((at, *index))} = {x.at(index)};")
            return
        for index in np.ndindex(x.shape):
            self.writer.line(f"{to.at((at, *index))} = {in_c(x[index]).text};")

    # -- branches --------------------------------------------------------------------

    def _branched(
        self, branches: Sequence[ClosedJaxpr], inputs: list[Value]
    ) -> list[Value]:
        which, given = self.numbers(inputs[0])[()], inputs[1:]
        cheap = all(len(branch.jaxpr.eqns) <= _CHEAP for branch in branches)
        small = all(x.size <= SMALL for x in given)
        if isinstance(which, np.generic) or (cheap and small):
            return self.chosen(which, branches, list(map(self.numbers, given)))
        written: _Written = []
        for branch in branches:
            with self.writer.inner() as block:
                found = self._run(branch, given)
                written.append((block, list(map(self.numbers, found))))
        avals = branches[0].out_avals
        left = [
            self._choice([found[k] for _, found in written], written, aval)
            for k, aval in enumerate(avals)
        ]
        for i, (block, found) in enumerate(written):
            last = len(written) - 1
            if which.type == "truth":
                head = ("else", f"if ({which.text})")[i == 1]
                head = f"if (!{which.text})" if i == 0 else "else"
            else:
                head = "else" if i == last else f"if ({which.text} <= {i})"
                head = f"else {head}" if 0 < i < last else head
            targets: list[Target] = []
            with self.writer.reopened(block):
                for to, x in zip(left, found, strict=True):
                    targets += self._settled(to, x)
            self.writer.line(head)
            self.writer.put(block, targets)
        return left

    def _choice(self, found: list[Value], written: _Written, aval: Aval) -> Value:
        """Where branches leave one of their results."""
        kind = type_of(aval.dtype)
        if isinstance(found[0], Memory):
            if all(x.is_at(found[0]) for x in found):
                return found[0]._replace(owned=all(x.owned for x in found))
            return self.arrays.new(aval.shape, kind)
        named = {name for block, _ in written for name in block.named}
        result = np.empty(aval.shape, object)
        for index in np.ndindex(aval.shape):
            options = [x[index] for x in found]
            texts = {in_c(x).text for x in options}
            same = len(texts) == 1 and not texts & named
            result[index] = options[0] if same else self.writer.variable(kind)
        return result

    def _settled(self, to: Value, x: Value) -> list[Target]:
        """What leaves a result where it belongs."""
        if isinstance(to, Memory):
            if not x.is_at(to):
                self.arrays.copied(x, to)
            return []
        pairs = zip(to.reshape(-1), x.reshape(-1), strict=True)
        return [
            Target(a.text, in_c(b))
            for a, b in pairs
            if isinstance(a, Number) and a.text != in_c(b).text
        ]

    def _alone(self, closed: ClosedJaxpr, values: list[Value]) -> list[Value]:
        """A program as a function, which may be called in a loop."""
        loops, self._loops = self._loops, self._loops + 1
        found = self._run(closed, values)
        self._loops = loops
        return list(map(self.numbers, found))

    def _run(
        self,
        closed: ClosedJaxpr,
        values: list[Value],
        ready: dict[Variable, Value] | None = None,
    ) -> list[Value]:
        """A program inside of the program."""
        return self.through(closed.jaxpr, closed.consts, values, ready)


def _takes_memory(equation: Equation) -> bool:
    """Whether an equation has its own way with small arrays in memory."""
    name = equation.primitive.name
    if name in _WITH_PROGRAMS or name in OPERATIONS:
        return True
    return calls(equation) or _has_large(equation)


def _has_large(equation: Equation) -> bool:
    """Whether any array of an equation is one in memory."""
    arrays = *equation.invars, *equation.outvars
    return any(_count(v.aval.shape) > SMALL for v in arrays)


def _is_work(equation: Equation) -> bool:
    """Whether an equation computes a larger array, beyond moving numbers."""
    return _has_large(equation) and equation.primitive.name not in _MOVES


_count = functools.cache(math.prod)  # of the few shapes that there are
