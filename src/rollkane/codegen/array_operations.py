"""What operations of a traced program are to arrays in memory."""

from collections.abc import Callable, Sequence
from typing import Any, cast

import numpy as np

from .array_memory import Index, Look, Memory
from .data_movement import sliced
from .jaxpr_types import Aval, Equation, Params
from .memory_walk import MemoryWalk, Value
from .row_loops import Place, Read
from .scalar_program import ELEMENTWISE, REDUCTIONS, Axes, NotElementwiseError
from .scalars import Number, in_c
from .whole_numbers import type_of


def in_memory(
    walk: MemoryWalk, equation: Equation, inputs: list[Value]
) -> list[Memory]:
    """Results of an equation with arrays in memory.

    Args:
        walk: Writes the program.
        equation: Of which at least one array is larger than a few numbers.
        inputs: Single numbers, or arrays in memory.

    Raises:
        NotElementwiseError: an operation that is not written in C.
    """
    name, params = equation.primitive.name, equation.params
    aval = equation.outvars[0].aval
    if name in ELEMENTWISE:
        return [_elementwise(walk, name, params, inputs, equation)]
    stored = [
        walk.arrays.in_memory(x, type_of(v.aval.dtype))
        for x, v in zip(inputs, equation.invars, strict=True)
    ]
    if name in REDUCTIONS:
        return [_reduced(walk, REDUCTIONS[name], stored[0], params["axes"], aval)]
    if name in _VIEWS:
        return [_view(walk, stored[0], lambda x: _VIEWS[name](x, params))]
    if name in _JOINED:
        joined = _JOINED[name]
        return [joined(walk, stored, params, aval)]
    if name == "split":
        return _split(walk, stored[0], params)
    if name == "unstack":
        return _unstacked(walk, stored[0], params["axis"])
    if name == "dot_general":
        a, b = stored
        return [_contracted(walk, a, b, params["dimension_numbers"], aval)]
    if name == "iota":
        to = walk.arrays.new(aval.shape, type_of(aval.dtype))
        axis: int = params["dimension"]
        at: Callable[[Index], Number] = lambda index: in_c(_index(index[axis]))
        return [walk.arrays.filled(to, at)]
    raise NotElementwiseError(f"{name} of {aval.shape}")


def _index(i: int | str) -> Any:
    """An index of a loop as a number."""
    return np.int64(i) if isinstance(i, int) else Number(i, "whole")


def _elementwise(
    walk: MemoryWalk,
    name: str,
    params: Params,
    inputs: list[Value],
    equation: Equation,
) -> Memory:
    aval = equation.outvars[0].aval
    shape, kind = aval.shape, type_of(aval.dtype)
    operands: list[Any] = []
    for x, v in zip(inputs, equation.invars, strict=True):
        if isinstance(x, Memory) or x.size > 1:
            place = walk.arrays.in_memory(x, type_of(v.aval.dtype))
            operands.append(place.spread(shape))
        else:
            operands.append(x.reshape(-1)[0])
    to = walk.arrays.new(shape, kind)
    same: Callable[[Place], list[Place]] = lambda at: [at]

    def value(numbers: Sequence[Number]) -> Any:
        taken = iter(numbers)
        given = [next(taken) if isinstance(x, Memory) else x for x in operands]
        found = walk.operation(name, params, given, aval.dtype)
        return walk.operate("copy", {}, [found], aval.dtype)

    reads = [Read(x, same) for x in operands if isinstance(x, Memory)]
    walk.rows.fill(to, reads, value)
    return to


def _joined_index(kept: Index, along: Index, axes: Axes) -> Index:
    """An index of an array, of those that are kept and those along some axes."""
    rest, own = iter(kept), dict(zip(axes, along, strict=True))
    return tuple(
        own[k] if k in own else next(rest) for k in range(len(kept) + len(axes))
    )


_NONE = {"add": 0, "mul": 1}  # what a sum and a product of nothing are


def _reduced(walk: MemoryWalk, name: str, x: Memory, axes: Axes, aval: Aval) -> Memory:
    """Sums, largest numbers and so on."""
    arrays = walk.arrays
    kind, along = type_of(aval.dtype), tuple(x.shape[k] for k in axes)
    first = (0,) * len(axes)
    to = arrays.new(aval.shape, kind)
    outer = walk.rows.axes(x.shape)
    if outer == walk.rows.axes(to.shape) and all(k >= outer for k in axes):
        _reduced_rows(walk, name, x, axes, aval, to)
        return to
    with arrays.loops(aval.shape) as kept:
        begun = arrays.number_at(x, _joined_index(kept, first, axes))
        none = aval.dtype.type(_NONE[name]) if name in _NONE else begun
        total = walk.writer.variable(kind, in_c(none))
        with arrays.loops(along) as index:
            one = arrays.number_at(x, _joined_index(kept, index, axes))
            found = walk.operation(name, {}, [total, one], aval.dtype)
            walk.writer.line(f"{total.text} = {in_c(found).text};")
        walk.writer.line(f"{to.at(kept)} = {total.text};")
    return to


def _reduced_rows(
    walk: MemoryWalk, name: str, x: Memory, axes: Axes, aval: Aval, to: Memory
) -> None:
    """The same within rows, by the same operations."""
    within = [k - walk.rows.axes(x.shape) for k in axes]
    kind = type_of(aval.dtype)
    along = [x.shape[k] for k in axes]

    def places(kept: Place) -> list[Place]:
        each = (_joined_index(kept, index, within) for index in np.ndindex(*along))
        return cast("list[Place]", list(each))

    def value(numbers: Sequence[Number]) -> Any:
        total: Any = numbers[0]
        if name in _NONE:
            total = Number(in_c(aval.dtype.type(_NONE[name])).text, kind)
        for one in numbers:
            total = walk.operation(name, {}, [total, one], aval.dtype)
        return total

    walk.rows.fill(to, [Read(x, places)], value)


def _view(walk: MemoryWalk, x: Memory, function: Look) -> Memory:
    return x.looked_at(function)


def _broadcast(x: np.ndarray, params: Params) -> np.ndarray:
    spread = [1] * len(params["shape"])
    for axis, size in zip(params["broadcast_dimensions"], x.shape, strict=True):
        spread[axis] = size
    return np.broadcast_to(_reshaped(x, spread), params["shape"])


def _reshaped(x: np.ndarray, shape: Sequence[int]) -> np.ndarray:
    """With axes of length one put in or left out: strides only, whatever they are."""
    kept = [s for s, n in zip(x.strides, x.shape, strict=True) if n != 1]
    sizes = iter(kept)
    strides = [0 if n == 1 else next(sizes) for n in shape]
    return np.lib.stride_tricks.as_strided(x, shape, strides, writeable=False)


_VIEWS: dict[str, Callable[[np.ndarray, Params], np.ndarray]] = {
    "broadcast_in_dim": _broadcast,
    "expand_dims": lambda x, p: np.expand_dims(x, p["dimensions"]),
    "rev": lambda x, p: np.flip(x, p["dimensions"]),
    "slice": sliced,
    "squeeze": lambda x, p: np.squeeze(x, tuple(p["dimensions"])),
    "transpose": lambda x, p: x.transpose(p["permutation"]),
}


def in_shape(walk: MemoryWalk, x: Memory, shape: tuple[int, ...]) -> Memory:
    """The same numbers in another shape."""
    if not x.is_packed:
        x = walk.arrays.copied(x)
    return x.looked_at(lambda a: a.reshape(shape))


def _reshape(
    walk: MemoryWalk, stored: list[Memory], params: Params, aval: Aval
) -> Memory:
    del params
    return in_shape(walk, stored[0], aval.shape)


def _concatenated(
    walk: MemoryWalk, stored: list[Memory], params: Params, aval: Aval
) -> Memory:
    return _laid(walk, stored, params["dimension"], aval)


def _stacked(
    walk: MemoryWalk, stored: list[Memory], params: Params, aval: Aval
) -> Memory:
    axis = params["axis"]
    rows = [x.looked_at(lambda a: np.expand_dims(a, axis)) for x in stored]
    return _laid(walk, rows, axis, aval)


def _laid(walk: MemoryWalk, stored: list[Memory], axis: int, aval: Aval) -> Memory:
    """One beside the other along an axis."""
    to, first = walk.arrays.new(aval.shape, type_of(aval.dtype)), 0
    for x in stored:
        part = [slice(None)] * len(aval.shape)
        part[axis] = slice(first, first + x.shape[axis])
        here = tuple(part)
        if not x.size:
            continue
        place = to.looked_at(lambda a, here=here: a[here])
        if not (x.is_packed and place.is_packed):
            walk.rows.fill(place, [Read(x, lambda at: [at])], lambda given: given[0])
        else:
            walk.arrays.copied(x, place)
        first += x.shape[axis]
    return to


def _padded(
    walk: MemoryWalk, stored: list[Memory], params: Params, aval: Aval
) -> Memory:
    x, filling = stored
    to = walk.arrays.new(aval.shape, type_of(aval.dtype))
    one = Number(filling.at((0,) * len(filling.shape)), filling.type)
    walk.arrays.filled(to, lambda index: one)
    here: list[tuple[int, int]] = []
    for low, high, between in params["padding_config"]:
        if low < 0 or high < 0:
            raise NotElementwiseError("negative padding")
        here.append((low, between + 1))
    part = tuple(
        slice(low, low + (n - 1) * step + 1 if n else low, step)
        for (low, step), n in zip(here, x.shape, strict=True)
    )
    walk.arrays.copied(x, to.looked_at(lambda a: a[part]))
    return to


def _tiled(
    walk: MemoryWalk, stored: list[Memory], params: Params, aval: Aval
) -> Memory:
    (x,), to = stored, walk.arrays.new(aval.shape, type_of(aval.dtype))
    count = len(x.shape)
    parts = [n for pair in zip(params["reps"], x.shape, strict=True) for n in pair]
    each = to.looked_at(lambda a: a.reshape(parts))
    place = tuple(range(0, 2 * count, 2))
    spread = x.looked_at(lambda a: np.expand_dims(a, place)).spread(each.shape)
    walk.arrays.copied(spread, each)
    return to


_Joined = Callable[[MemoryWalk, list[Memory], Params, Aval], Memory]
_JOINED: dict[str, _Joined] = {
    "concatenate": _concatenated,
    "pad": _padded,
    "reshape": _reshape,
    "stack": _stacked,
    "tile": _tiled,
}


def _split(walk: MemoryWalk, x: Memory, params: Params) -> list[Memory]:
    cuts, axis = np.cumsum(params["sizes"])[:-1], params["axis"]
    count = len(params["sizes"])
    part: Callable[[int], Look]
    part = lambda k: lambda a: np.split(a, cuts, axis)[k]
    return [_view(walk, x, part(k)) for k in range(count)]


def _unstacked(walk: MemoryWalk, x: Memory, axis: int) -> list[Memory]:
    row: Callable[[int], Look]
    row = lambda i: lambda a: np.moveaxis(a, axis, 0)[i, ...]
    return [_view(walk, x, row(i)) for i in range(x.shape[axis])]


def _contracted(
    walk: MemoryWalk, a: Memory, b: Memory, numbers: Any, aval: Aval
) -> Memory:
    """Sums of products over some axes, for each place along others."""
    (over_a, over_b), (each_a, each_b) = numbers
    free: Callable[[Memory, Axes, Axes], list[int]]
    free = lambda x, over, each: [
        k for k in range(len(x.shape)) if k not in (*over, *each)
    ]
    rows, columns = free(a, over_a, each_a), free(b, over_b, each_b)
    a = a.looked_at(lambda x: x.transpose([*each_a, *rows, *over_a]))
    b = b.looked_at(lambda x: x.transpose([*each_b, *columns, *over_b]))
    batch, inner = len(each_a), len(over_a)
    along = a.shape[len(a.shape) - inner :]
    arrays, writer = walk.arrays, walk.writer
    to = arrays.new(aval.shape, type_of(aval.dtype))
    with arrays.loops(aval.shape) as index:
        each, of_a = index[:batch], index[batch : batch + len(rows)]
        of_b = index[batch + len(rows) :]
        total = writer.variable("real", in_c(np.float64(0.0)))
        with arrays.loops(along) as k:
            x, y = a.at((*each, *of_a, *k)), b.at((*each, *of_b, *k))
            writer.line(f"{total.text} = fma_one({x}, {y}, {total.text});")
        writer.line(f"{to.at(index)} = {total.text};")
    return to
