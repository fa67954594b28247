"""What a traced program does by indices that are not known, and along an axis.

Each function takes the walk that writes the program, an equation and its inputs, single
numbers or arrays in memory, and gives its results.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from .along_an_axis import RUNNING, place_of_best, running, wins
from .array_memory import Index, Look, Memory, value_of
from .by_index import by_index, filled
from .data_movement import Numbers, as_objects, numbers_of
from .jaxpr_types import Equation
from .memory_walk import MemoryWalk, Value
from .scalar_program import NotElementwiseError
from .scalars import Number, in_c
from .whole_numbers import type_of

# of so few numbers one is chosen, where more are looked up
_CHOSEN = 4


def _clipped(walk: MemoryWalk, start: Any, last: int) -> Any:
    """An index within an array."""
    whole = np.dtype(np.int64)
    least = walk.operation("max", {}, [start, np.int64(0)], whole)
    return walk.operation("min", {}, [least, np.int64(last)], whole)


def _text(i: Any) -> int | str:
    """An index in C, or a known one."""
    return i.text if isinstance(i, Number) else int(i)


def _taken(walk: MemoryWalk, equation: Equation, inputs: list[Value]) -> list[Value]:
    """A part of an array, which begins at indices that may be unknown."""
    x, starts = inputs[0], [walk.numbers(s)[()] for s in inputs[1:]]
    sizes, aval = equation.params["slice_sizes"], equation.outvars[0].aval
    kind = type_of(aval.dtype)
    begins = [
        _clipped(walk, s, n - size) if n > size else np.int64(0)
        for s, n, size in zip(starts, x.shape, sizes, strict=True)
    ]
    if not isinstance(x, Memory):
        unknown = [k for k, b in enumerate(begins) if isinstance(b, Number)]
        here = tuple(
            slice(None) if k in unknown else slice(int(b), int(b) + size)
            for k, (b, size) in enumerate(zip(begins, sizes, strict=True))
        )
        x = x[here]
        if not unknown:
            return [x]
        begins = [b if k in unknown else np.int64(0) for k, b in enumerate(begins)]
        (axis, *more) = unknown
        if not more and x.shape[axis] - sizes[axis] < _CHOSEN:
            return [_chosen(walk, x, begins[axis], axis, sizes, aval.dtype)]
        x = walk.arrays.stored(x, kind)
    shifts = [_text(b) for b in begins]

    def at(index: Index) -> str:
        return x.at([_plus(s, i) for s, i in zip(shifts, index, strict=True)])

    if aval.size <= walk.small:
        found = [
            walk.writer.let(value_of(at(i), kind), kind, True)
            for i in np.ndindex(aval.shape)
        ]
        return [as_objects(found, aval.shape)]
    to = walk.arrays.new(aval.shape, kind)
    return [walk.arrays.filled(to, lambda index: Number(at(index), kind))]


def _plus(shift: int | str, i: int | str) -> int | str:
    if isinstance(shift, int) and isinstance(i, int):
        return shift + i
    if i == 0 and isinstance(i, int):
        return shift
    if shift == 0 and isinstance(shift, int):
        return i
    return f"({shift} + {i})"


def _chosen(
    walk: MemoryWalk,
    x: Numbers,
    begin: Any,
    axis: int,
    sizes: Sequence[int],
    dtype: np.dtype,
) -> Numbers:
    """A part of a few single numbers."""
    last = x.shape[axis] - sizes[axis]
    part: Callable[[int], Numbers]
    part = lambda i: np.take(x, range(i, i + sizes[axis]), axis)
    found = part(last)
    for i in reversed(range(last)):
        here = walk.operation("le", {}, [begin, np.int64(i)], np.dtype(bool))
        found = _selected(walk, here, part(i), found, dtype)
    return found


def _selected(
    walk: MemoryWalk, here: Any, yes: Numbers, no: Numbers, dtype: np.dtype
) -> Numbers:
    found = np.empty(yes.shape, object)
    for index in np.ndindex(yes.shape):
        options = [here, no[index], yes[index]]
        found[index] = walk.operation("select_n", {}, options, dtype)
    return found


def _put(walk: MemoryWalk, equation: Equation, inputs: list[Value]) -> list[Value]:
    """An array with a part that begins at indices that may be unknown."""
    x, update, *starts = inputs
    begins = [
        _clipped(walk, walk.numbers(s)[()], n - size)
        for s, n, size in zip(starts, x.shape, update.shape, strict=True)
    ]
    return [_written(walk, equation, x, update, begins, None, False)]


def _written(
    walk: MemoryWalk,
    equation: Equation,
    x: Value,
    update: Value,
    begins: list[Any],
    inside: Any,
    adds: bool,
) -> Value:
    """An array with a part that is written, or added to, where an index is inside."""
    aval = equation.outvars[0].aval
    kind = type_of(aval.dtype)
    if x.size <= walk.small and not (isinstance(x, Memory) and x.owned):
        x, update = walk.numbers(x), walk.numbers(update)
        return _written_small(walk, x, update, begins, inside, adds, aval.dtype)
    x = walk.arrays.in_memory(x, kind)
    if not x.owned or not x.is_packed:  # one number may stand for many
        x = walk.arrays.copied(x)._replace(owned=True)
    shifts = [_text(b) for b in begins]
    head = "" if inside is None else f"if ({in_c(inside).text})"
    sign = "+=" if adds else "="

    def write(index: Index, text: str) -> None:
        at = x.at([_plus(s, i) for s, i in zip(shifts, index, strict=True)])
        walk.writer.line(f"{at} {sign} {text};")

    with walk.writer.braces(head):
        if isinstance(update, Memory):
            with walk.arrays.loops(update.shape) as index:
                write(index, update.at(index))
        else:
            for index in np.ndindex(update.shape):
                write(index, in_c(update[index]).text)
    return x


def _written_small(
    walk: MemoryWalk,
    x: Numbers,
    update: Numbers,
    begins: list[Any],
    inside: Any,
    adds: bool,
    dtype: np.dtype,
) -> Numbers:
    """The same of single numbers: each is chosen."""
    found = np.array(x, object)
    truth = np.dtype(bool)
    for place in np.ndindex(x.shape):
        for index in np.ndindex(update.shape):
            here = np.bool_(True) if inside is None else inside
            for b, i, k in zip(begins, index, place, strict=True):
                same = walk.operation("eq", {}, [b, np.int64(k - i)], truth)
                here = walk.operation("and", {}, [here, same], truth)
            new = update[index]
            if adds:
                new = walk.operation("add", {}, [x[place], new], dtype)
            options = [here, found[place], new]
            found[place] = walk.operation("select_n", {}, options, dtype)
    return found


def _at_known(
    walk: MemoryWalk, equation: Equation, inputs: list[Value]
) -> list[Value] | None:
    """The same of single numbers by indices that are known; None: of others."""
    given = [walk.numbers(x) for x in inputs]
    few = all(not isinstance(x, Memory) for x in given)
    known = few and all(isinstance(i, np.generic) for i in given[1].reshape(-1))
    name, dtype = equation.primitive.name, equation.outvars[0].aval.dtype
    if not known and not (few and name == "gather" and given[0].size <= _CHOSEN**2):
        return None
    return [by_index(walk.operation, name, given, equation.params, dtype)]


def _gathered(walk: MemoryWalk, equation: Equation, inputs: list[Value]) -> list[Value]:
    """Rows of an array, of indices that may be unknown."""
    x, indices = inputs[0], walk.numbers(inputs[1])
    params, aval = equation.params, equation.outvars[0].aval
    if (found := _at_known(walk, equation, inputs)) is not None:
        return found
    numbers, rest = params["dimension_numbers"], x.shape[1:]
    many = indices.shape[:-1]
    # a row that was looked up as a slice keeps an axis of its own, of length one
    first = len(many) + 1 - len(numbers.collapsed_slice_dims)
    tail = tuple(range(len(many), first + len(rest)))
    plain = numbers.collapsed_slice_dims in ((0,), ())
    plain &= not numbers.operand_batching_dims and numbers.offset_dims == tail
    # where else a row begins does not matter: it is whole
    clips = "CLIP" in str(params["mode"])
    plain &= numbers.start_index_map == tuple(range(indices.shape[-1] if clips else 1))
    if not plain or tuple(params["slice_sizes"]) != (1, *rest):
        raise NotElementwiseError("a lookup of parts of rows")
    kind, filling = type_of(aval.dtype), None
    if "FILL" in str(params["mode"]):
        filling = filled(aval.dtype, params["fill_value"])
    x = walk.arrays.in_memory(x, kind)
    indices = walk.arrays.in_memory(indices, "whole")
    to = walk.arrays.new(aval.shape, kind)
    with walk.arrays.loops(aval.shape) as index:
        asked = walk.arrays.number_at(indices, (*index[: len(many)], 0))
        row = _clipped(walk, asked, x.shape[0] - 1)
        value = x.at((_text(row), *index[first:]))
        if filling is not None:
            value = f"{asked.text} == {row.text} ? {value} : {in_c(filling).text}"
        walk.writer.line(f"{to.at(index)} = {value};")
    return [to]


def _scattered(
    walk: MemoryWalk, equation: Equation, inputs: list[Value]
) -> list[Value]:
    """An array with one row that is written, or added to, if there is such a one."""
    x, index, update = inputs
    numbers = equation.params["dimension_numbers"]
    if (found := _at_known(walk, equation, inputs)) is not None:
        return found
    plain = index.shape == (1,) and not numbers.operand_batching_dims
    plain &= numbers.inserted_window_dims == (0,)
    plain &= numbers.scatter_dims_to_operand_dims == (0,)
    if not plain or update.shape != x.shape[1:]:
        raise NotElementwiseError("writing to parts of rows")
    row, truth, inside = walk.numbers(index)[0], np.dtype(bool), None
    if "CLIP" in str(equation.params["mode"]):
        row = _clipped(walk, row, x.shape[0] - 1)
    else:
        least = walk.operation("ge", {}, [row, np.int64(0)], truth)
        most = walk.operation("lt", {}, [row, np.int64(x.shape[0])], truth)
        inside = walk.operation("and", {}, [least, most], truth)
    adds = equation.primitive.name in ("scatter-add", "scatter_add")
    if isinstance(update, Memory):
        update = update.looked_at(lambda a: np.expand_dims(a, 0))
    else:
        update = update[None]
    begins = [row, *[np.int64(0)] * (len(x.shape) - 1)]
    return [_written(walk, equation, x, update, begins, inside, adds)]


def _running(walk: MemoryWalk, equation: Equation, inputs: list[Value]) -> list[Value]:
    """Sums and so on of all numbers up to each, along an axis."""
    params, aval = equation.params, equation.outvars[0].aval
    (x,), axis, name = inputs, params["axis"], equation.primitive.name
    if not isinstance(x, Memory):
        return [running(walk.operation, name, x, params, aval.dtype)]
    front: Look = lambda a: np.moveaxis(a, axis, 0)
    turned: Look
    turned = (lambda a: np.flip(front(a), 0)) if params["reverse"] else front
    to = walk.arrays.new(aval.shape, type_of(aval.dtype))
    a, b = x.looked_at(turned), to.looked_at(turned)
    with walk.arrays.loops(a.shape[1:]) as rest:
        total = walk.writer.variable(a.type, Number(a.at((0, *rest)), a.type))
        walk.writer.line(f"{b.at((0, *rest))} = {total.text};")
        with walk.arrays.loops((a.shape[0] - 1,)) as (k,):
            at = _plus(1, k)
            one = walk.arrays.number_at(a, (at, *rest))
            found = walk.operation(RUNNING[name], {}, [total, one], aval.dtype)
            walk.writer.line(f"{total.text} = {in_c(found).text};")
            walk.writer.line(f"{b.at((at, *rest))} = {total.text};")
    return [to]


def _place_of_best(
    walk: MemoryWalk, equation: Equation, inputs: list[Value]
) -> list[Value]:
    """Index of the largest or least number along an axis; of what is not one first."""
    aval, (axis,) = equation.outvars[0].aval, equation.params["axes"]
    name, (x,), arrays = equation.primitive.name, inputs, walk.arrays
    dtype = equation.invars[0].aval.dtype
    kind = type_of(dtype)
    if not isinstance(x, Memory):
        given = name, x, axis, dtype, aval.dtype
        return [place_of_best(walk.operation, *given)]
    turned = x.looked_at(lambda a: np.moveaxis(a, axis, 0))
    to = arrays.new(aval.shape, "whole")
    with arrays.loops(aval.shape) as rest:
        best = walk.writer.variable(kind, Number(turned.at((0, *rest)), kind))
        place = walk.writer.variable("whole", Number("0L", "whole"))
        with arrays.loops((turned.shape[0],)) as (i,):
            one = arrays.number_at(turned, (i, *rest))
            better, _ = wins(walk.operation, name, one, best, dtype)
            with walk.writer.braces(f"if ({in_c(better).text})"):
                walk.writer.line(f"{best.text} = {one.text}; {place.text} = {i};")
        walk.writer.line(f"{to.at(rest)} = {place.text};")
    return [to]


def _largest(walk: MemoryWalk, equation: Equation, inputs: list[Value]) -> list[Value]:
    """The largest numbers of a row, in order, and their places."""
    values, places = (v.aval for v in equation.outvars)
    if len(values.shape) != 1:
        raise NotElementwiseError("the largest numbers of several rows")
    arrays, writer = walk.arrays, walk.writer
    x = arrays.in_memory(inputs[0], type_of(values.dtype))
    top, at = arrays.new(values.shape, x.type), arrays.new(places.shape, "whole")
    writer.line(
        f"largest({x.size}, &{x.at((0,))}, {x.strides[0]}, {values.shape[0]}, "
        f"{top.base}, {at.base});"
    )
    return [top, at]


def _sorted(walk: MemoryWalk, equation: Equation, inputs: list[Value]) -> list[Value]:
    """Numbers in order along an axis, of what is not one last; others go with them."""
    if len(inputs) > 2 or equation.params["num_keys"] > 1:
        raise NotElementwiseError("a sort of more than two arrays, or by more than one")
    arrays, axis = walk.arrays, equation.params["dimension"]
    rows: list[Memory] = []
    for given, out in zip(inputs, equation.outvars, strict=True):
        x = arrays.in_memory(given, type_of(out.aval.dtype))
        rows.append(arrays.copied(x.looked_at(lambda a: np.moveaxis(a, axis, -1))))
    shape = rows[0].shape
    room = [arrays.new(shape[-1:], x.type).base for x in rows]
    with arrays.loops(shape[:-1]) as row:
        places = [f"&{x.at((*row, 0))}" for x in rows]
        pairs = [f"{x}, {to}" for x, to in zip(places, room, strict=True)]
        others = ["NULL, NULL"] * (2 - len(pairs))
        walk.writer.line(f"sort({', '.join([str(shape[-1]), *pairs, *others])});")
    return [x.looked_at(lambda a: np.moveaxis(a, -1, axis)) for x in rows]


def _unset(walk: MemoryWalk, equation: Equation, inputs: list[Value]) -> list[Value]:
    """An array of which nothing is read before it is written."""
    del inputs
    aval = equation.outvars[0].aval
    if aval.size > walk.small:
        return [walk.arrays.new(aval.shape, type_of(aval.dtype))]
    return [numbers_of(np.zeros(aval.shape, aval.dtype))]


# those that write to a part of their first operand
WRITING = ("dynamic_update_slice", "scatter", "scatter-add")
_Operation = Callable[[MemoryWalk, Equation, list[Value]], list[Value]]
OPERATIONS: dict[str, _Operation] = {
    "argmax": _place_of_best,
    "argmin": _place_of_best,
    "dynamic_slice": _taken,
    "dynamic_update_slice": _put,
    "empty": _unset,
    "empty2": _unset,
    "gather": _gathered,
    "scatter": _scattered,
    "scatter-add": _scattered,
    "sort": _sorted,
    "top_k": _largest,
    **dict.fromkeys(RUNNING, _running),
}
