"""A function of small arrays as a program of single numbers.

The library is written with vectors of three and small matrices. A kernel that works off
many motions pays for each of them: slices, stacks, and the zeros of a plane's frame or
a vertical gravity. Here a traced program is walked once more with every array as a set
of numbers. Slices and stacks are then bookkeeping, what is multiplied by a written zero
or one falls away, and only arithmetic is left: 217 operations on numbers instead of 442
equations on arrays for a disc on a plane.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any, cast

import jax
import numpy as np
from jax.extend import core

from .along_an_axis import ALONG, along
from .by_index import BY_INDEX, FEW, by_index
from .called_programs import CalledPrograms, rows_of
from .data_movement import (
    MOVES,
    PARTS,
    NotElementwiseError,
    Numbers,
    as_objects,
    numbers_of,
    refuse_keys,
)
from .fused import SUMS
from .jaxpr_types import ClosedJaxpr, Equation, Jaxpr, Params, Variable, numbers_in
from .known_numbers import KNOWN, SHORTCUTS, of_known
from .tracing import becoming_c

# of one or more numbers gives one number, whatever the shape
ELEMENTWISE = frozenset(
    """
    abs acos acosh add add_any and asin asinh atan atan2 atanh cbrt ceil clamp
    convert_element_type copy cos cosh div eq erf erfc exp exp2 expm1 floor ge gt
    integer_pow is_finite le le_to lgamma log log1p logistic lt lt_to max min mul ne neg
    nextafter not one_minus_square or pow rem round rsqrt select_n shift_left
    shift_right_arithmetic shift_right_logical sign sin sinh sqrt square
    stop_gradient sub tan tanh xor
    """.split()  # noqa: SIM905 -- words read better than a column of strings
)
REDUCTIONS = {
    "reduce_sum": "add",
    "reduce_prod": "mul",
    "reduce_max": "max",
    "reduce_min": "min",
    "reduce_and": "and",
    "reduce_or": "or",
}

# numbers of a loop that is written out: beyond, compilers take too long
_MOST_NUMBERS = 50_000

# name, parameters, operands and type of the result of an operation
Operate = Callable[[str, Params, list[Any], np.dtype], Any]
Axes = Sequence[int]


class Program:
    """What a function does to single numbers.

    Attributes:
        outputs: Shapes and types of the outputs, in order of leaves.
        closed: Arrays that it closes over.
    """

    outputs: list[jax.ShapeDtypeStruct]
    closed: list[Any]

    def __init__(self, function: Callable[..., Any], *arguments: Any):
        """Trace a function.

        Args:
            function: Of trees of arrays, to a tree of arrays.
            arguments: Trees of arrays, or of their shapes and types.

        Raises:
            NotElementwiseError: keys of random numbers.
        """
        with becoming_c():
            self._closed = cast(ClosedJaxpr, jax.make_jaxpr(function)(*arguments))
        self.outputs = [
            jax.ShapeDtypeStruct(x.shape, x.dtype) for x in self._closed.out_avals
        ]
        self.closed = self._closed.consts
        refuse_keys([*self._closed.in_avals, *self.closed])

    def __call__(
        self,
        values: list[Numbers],
        operate: Operate,
        closed: list[Numbers] | None = None,
    ) -> list[Numbers]:
        """Outputs for the numbers of the arguments' leaves, both in order of leaves.

        Args:
            values: Arrays of objects: NumPy scalars where known, else whatever
                ``operate`` understands.
            operate: ``operate(name, params, operands, dtype)`` -> a value: one of
                XLA's operations on numbers, of which at least one is not known;
                ``"copy"``: a sum of it and zero.
            closed: Numbers of what it closes over; None: of those arrays.

        Raises:
            NotElementwiseError: something else than arithmetic and bookkeeping.
        """
        if closed is None:
            closed = [numbers_of(x) for x in self.closed]
        with np.errstate(all="ignore"):  # known numbers may overflow, as XLA's do
            return Walk(operate).through(self._closed.jaxpr, closed, values)


def _alone(value: Any) -> Numbers:
    return as_objects([value], ())


def as_array(x: Any) -> Numbers:
    """A row of numbers, of which NumPy gives the only one without its array."""
    return cast(Numbers, x) if isinstance(x, np.ndarray) else _alone(x)


class Walk:
    """One way through a traced program.

    Attributes:
        operate: What is done to numbers.
        programs: That its equations call.
    """

    def __init__(self, operate: Operate):
        """Of numbers that this operates on."""
        self.operate = operate
        self.programs = CalledPrograms()

    def through(
        self, jaxpr: Jaxpr, closed: Sequence[Any], values: list[Numbers]
    ) -> list[Numbers]:
        """Outputs of a program inside of the program."""
        known: dict[Variable, Numbers] = dict(
            zip((*jaxpr.constvars, *jaxpr.invars), (*closed, *values), strict=True)
        )

        def read(v: Any) -> Numbers:  # a variable or a literal
            return numbers_of(v.val) if isinstance(v, core.Literal) else known[v]

        for equation in jaxpr.eqns:
            results = self.results(equation, [read(v) for v in equation.invars])
            known.update(zip(equation.outvars, results, strict=True))
        return [read(v) for v in jaxpr.outvars]

    def results(self, equation: Equation, inputs: list[Numbers]) -> list[Numbers]:
        """What one equation gives."""
        name, params = equation.primitive.name, equation.params
        inner = self.programs.of(equation)
        if inner is not None:
            consts = [numbers_of(x) for x in inner.consts]
            return self.through(inner.jaxpr, consts, inputs)
        made = equation.outvars[0].aval.dtype if equation.outvars else None
        dtype = cast(np.dtype, made)  # what has no results is none of these
        if name in ELEMENTWISE:
            shape = equation.outvars[0].aval.shape
            return [self.elementwise(name, params, inputs, shape, dtype)]
        if name in REDUCTIONS:
            return [self.reduced(REDUCTIONS[name], inputs[0], params["axes"], dtype)]
        if name in ALONG:
            types = equation.invars[0].aval.dtype, dtype
            return [along(self.operation, name, inputs[0], params, *types)]
        if name in PARTS:
            return PARTS[name](inputs[0], params)
        if name == "dot_general" and not any(params["dimension_numbers"][1]):
            a, b = inputs
            return [self.contracted(a, b, params["dimension_numbers"][0], dtype)]
        if name in MOVES:
            return [MOVES[name](inputs, params)]
        if name in BY_INDEX:
            return [by_index(self.operation, name, inputs, params, dtype)]
        if name == "dynamic_slice":
            return [self.sliced(inputs[0], inputs[1:], params["slice_sizes"], dtype)]
        return self.controlled(equation, inputs)

    def controlled(self, equation: Equation, inputs: list[Numbers]) -> list[Numbers]:
        """What an equation gives that holds programs, and says which of them to run."""
        name = equation.primitive.name
        if name == "scan":
            return self.repeated(equation, inputs)
        if name == "cond":
            branches = equation.params["branches"]
            return self.chosen(inputs[0][()], branches, inputs[1:])
        raise NotElementwiseError(name)

    def elementwise(
        self,
        name: str,
        params: Params,
        inputs: list[Numbers],
        shape: tuple[int, ...],
        dtype: np.dtype,
    ) -> Numbers:
        """One operation on the numbers of arrays."""
        if not shape:
            alone = [x[()] for x in inputs]
            return _alone(self.operation(name, params, alone, dtype))
        # an axis of length one, and an operand without axes, serve all
        spread = [x if x.shape == shape else np.broadcast_to(x, shape) for x in inputs]
        rows = zip(*(x.reshape(-1) for x in spread), strict=True)
        found = [self.operation(name, params, list(row), dtype) for row in rows]
        return as_objects(found, shape)

    def operation(
        self, name: str, params: Params, operands: list[Any], dtype: np.dtype
    ) -> Any:
        """One operation on numbers, left out where it does nothing."""
        known = [isinstance(x, np.generic) for x in operands]
        if name == "select_n" and known[0]:
            return operands[1 + int(operands[0])]
        if name == "select_n" and len(operands) > 3:
            return self.one_of(operands[0], operands[1:], dtype)
        if name == "integer_pow":
            return self.power(operands[0], params["y"], dtype)
        if all(known):
            return of_known(name, params, operands, dtype)
        short = SHORTCUTS[name](*operands) if name in SHORTCUTS else None
        # a sum with zero is one whether the zero is known or not
        if name in SUMS and any(short is x for x in operands):
            return self.operate("copy", {}, [short], dtype)
        if short is not None:
            return short
        return self.operate(name, params, operands, dtype)

    def one_of(self, which: Any, options: list[Any], dtype: np.dtype) -> Any:
        """The one of some numbers that has an index."""
        found = options[-1]
        for i, option in reversed([*enumerate(options[:-1])]):
            here = self.operation("le", {}, [which, np.int32(i)], np.dtype(bool))
            found = self.operation("select_n", {}, [here, found, option], dtype)
        return found

    def power(self, x: Any, exponent: int, dtype: np.dtype) -> Any:
        """A whole power by repeated squares."""
        one = dtype.type(1)
        if exponent < 0:
            below = self.power(x, -exponent, dtype)
            return self.operation("div", {}, [one, below], dtype)
        total = one
        while exponent:
            if exponent % 2:
                total = self.operation("mul", {}, [total, x], dtype)
            exponent //= 2
            if exponent:
                x = self.operation("mul", {}, [x, x], dtype)
        return total

    def sliced(
        self,
        numbers: Numbers,
        starts: list[Numbers],
        sizes: tuple[int, ...],
        dtype: np.dtype,
    ) -> Numbers:
        """A part of an array, which begins at an index that may be unknown."""
        unknown: list[tuple[int, Any, int]] = []
        for axis, (start, size) in enumerate(zip(starts, sizes, strict=True)):
            first, last = start[()], numbers.shape[axis] - size
            if last == 0:
                continue
            if isinstance(first, np.generic):
                begin = int(np.clip(first, 0, last))
                numbers = np.take(numbers, range(begin, begin + size), axis)
            else:
                unknown.append((axis, first, last))
        if not unknown:
            return numbers
        if len(unknown) > 1:
            raise NotElementwiseError("a lookup by two indices")
        ((axis, first, last),) = unknown
        result = np.empty(sizes, object)
        for index in np.ndindex(result.shape):
            row = np.moveaxis(numbers, axis, -1)[*index[:axis], *index[axis + 1 :]]
            candidates = row[index[axis] : index[axis] + last + 1]
            result[index] = self.looked_up(first, candidates, dtype)
        return result

    def looked_up(self, place: Any, numbers: Numbers, dtype: np.dtype) -> Any:
        """The number at a place; of a few that are computed, by as many choices."""
        try:
            return self.operate("lookup", {}, [place, numbers], dtype)
        except NotElementwiseError:
            if len(numbers) > FEW:
                raise
        return self.one_of(place, list(numbers), dtype)

    def chosen(
        self, which: Any, branches: Sequence[ClosedJaxpr], inputs: list[Numbers]
    ) -> list[Numbers]:
        """The results of one of some branches: of all of them, one is taken."""
        last = len(branches) - 1

        def results(branch: ClosedJaxpr) -> list[Numbers]:
            consts = [numbers_of(x) for x in branch.consts]
            return self.through(branch.jaxpr, consts, inputs)

        if isinstance(which, KNOWN):
            return results(branches[int(np.clip(which, 0, last))])
        found = results(branches[last])
        for i in reversed(range(last)):
            here = self.operation("le", {}, [which, np.int32(i)], np.dtype(bool))
            found = [
                self.elementwise("select_n", {}, [_alone(here), a, b], b.shape, x.dtype)
                for a, b, x in zip(
                    found, results(branches[i]), branches[i].out_avals, strict=True
                )
            ]
        return found

    def repeated(self, equation: Equation, inputs: list[Numbers]) -> list[Numbers]:
        """A loop of known length, turn by turn."""
        params = equation.params
        inner, length = params["jaxpr"], params["length"]
        if length * numbers_in(inner.jaxpr) > _MOST_NUMBERS:
            raise NotElementwiseError("a long scan")
        consts = [numbers_of(x) for x in inner.consts]
        parts = rows_of(equation)
        behind = parts.carried
        shared, carry, rows = parts.parted(inputs)
        turns = range(length)[:: -1 if params["reverse"] else 1]
        kept: list[list[Numbers]] = []
        for i in turns:
            given = [*shared, *carry, *(x[i] for x in rows)]
            found = self.through(inner.jaxpr, consts, [as_array(x) for x in given])
            carry = found[:behind]
            kept.append(found[behind:])
        kept = kept[:: -1 if params["reverse"] else 1]
        shapes = [x.shape for x in inner.out_avals[behind:]]
        columns: Iterable[Sequence[Numbers]]
        columns = zip(*kept, strict=True) if kept else ([] for _ in shapes)
        stacked = [
            as_objects([v for x in column for v in x.reshape(-1)], (length, *shape))
            for column, shape in zip(columns, shapes, strict=True)
        ]
        return [*carry, *stacked]

    def folded(self, name: str, numbers: list[Any], dtype: np.dtype) -> Any:
        """The sum, the largest and so on of some numbers."""
        total = numbers[0]
        for x in numbers[1:]:
            total = self.operation(name, {}, [total, x], dtype)
        return total

    def reduced(
        self, name: str, numbers: Numbers, axes: Axes, dtype: np.dtype
    ) -> Numbers:
        """The sums and so on along some axes; along none each number is its own."""
        if not axes:
            return numbers
        kept = [i for i in range(numbers.ndim) if i not in axes]
        rows = numbers.transpose([*kept, *axes])
        result = np.empty(rows.shape[: len(kept)], object)
        for index in np.ndindex(result.shape):
            result[index] = self.folded(name, list(rows[index].reshape(-1)), dtype)
        return result

    def contracted(
        self, a: Numbers, b: Numbers, axes: Sequence[Axes], dtype: np.dtype
    ) -> Numbers:
        """Sums of products over pairs of axes, or products alone over none."""
        a, b = (_in_rows(x, along) for x, along in zip((a, b), axes, strict=True))
        rows, columns = a.shape[:-1], b.shape[:-1]
        result = np.empty(rows + columns, object)
        for i in np.ndindex(rows):
            for j in np.ndindex(columns):
                pairs = zip(a[i], b[j], strict=True)
                products = [
                    self.operation("mul", {}, list(pair), dtype) for pair in pairs
                ]
                result[i + j] = self.folded("add", products, dtype)
        return result


def _in_rows(x: Numbers, axes: Axes) -> Numbers:
    """Numbers with some axes, in their order, joined into a last one."""
    kept = [i for i in range(x.ndim) if i not in axes]
    length = math.prod(x.shape[i] for i in axes)
    x = x.transpose([*kept, *axes])
    return x.reshape([*x.shape[: len(kept)], length])
