"""What operations of a traced program are to arrays in memory, and by unknown indices.

Each takes the walk that writes the program, an equation and its inputs, single numbers
or arrays in memory, and gives its results.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from ..numberwise import ELEMENTWISE, REDUCTIONS, NotElementwiseError
from ..rearrangements import as_objects, numbers_of
from .memory import Memory
from .scalars import Number, in_c, type_of

# of so few numbers one is chosen, where more are looked up
_CHOSEN = 4


def in_memory(walk: Any, equation: Any, inputs: list) -> list:
    """Results of an equation with arrays in memory."""
    name, params = equation.primitive.name, equation.params
    aval = equation.outvars[0].aval
    stored = [
        walk.arrays.in_memory(x, type_of(v.aval.dtype))
        for x, v in zip(inputs, equation.invars, strict=True)
    ]
    if name in ELEMENTWISE:
        return [_elementwise(walk, name, params, inputs, equation)]
    if name in REDUCTIONS:
        return [_reduced(walk, REDUCTIONS[name], stored[0], params["axes"], aval)]
    if name in _VIEWS:
        return [_view(walk, stored[0], lambda x: _VIEWS[name](x, params))]
    if name in _JOINED:
        return [_JOINED[name](walk, stored, params, aval)]
    if name == "split":
        return _split(walk, stored[0], params)
    if name == "unstack":
        return _unstacked(walk, stored[0], params["axis"])
    if name == "dot_general":
        return [_contracted(walk, *stored, params["dimension_numbers"], aval)]
    if name == "iota":
        to = walk.arrays.new(aval.shape, type_of(aval.dtype))
        at = lambda index: in_c(_index(index[params["dimension"]]))
        return [walk.arrays.filled(to, at)]
    raise NotElementwiseError(f"{name} of {aval.shape}")


def _index(i: Any) -> Any:
    """An index of a loop as a number."""
    return np.int64(i) if isinstance(i, int) else Number(i, "whole")


def _elementwise(walk, name, params, inputs, equation) -> Memory:
    aval = equation.outvars[0].aval
    shape, kind = aval.shape, type_of(aval.dtype)
    operands = []
    for x, v in zip(inputs, equation.invars, strict=True):
        if isinstance(x, Memory) or x.size > 1:
            place = walk.arrays.in_memory(x, type_of(v.aval.dtype))
            operands.append(place.spread(shape))
        else:
            operands.append(x.reshape(-1)[0])
    to = walk.arrays.new(shape, kind)
    with walk.arrays.loops(shape) as index:
        given = [
            walk.arrays.number_at(x, index) if isinstance(x, Memory) else x
            for x in operands
        ]
        found = walk.operation(name, params, given, aval.dtype)
        walk.writer.line(f"{to.at(index)} = {in_c(found).text};")
    return to


def _joined_index(kept, along, axes) -> tuple:
    """An index of an array, of those that are kept and those along some axes."""
    rest, own = iter(kept), dict(zip(axes, along, strict=True))
    return tuple(own[k] if k in own else next(rest) for k in range(len(kept) + len(axes)))


_NONE = {"add": 0, "mul": 1}  # what a sum and a product of nothing are


def _reduced(walk, name: str, x: Memory, axes: Any, aval: Any) -> Any:
    """Sums, largest numbers and so on."""
    arrays = walk.arrays
    kind, along = type_of(aval.dtype), tuple(x.shape[k] for k in axes)
    first = (0,) * len(axes)
    to = arrays.new(aval.shape, kind)
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


def _view(walk, x: Memory, function: Callable) -> Memory:
    return x.looked_at(function)


def _sliced(x: Any, params: Any) -> Any:
    starts, limits = params["start_indices"], params["limit_indices"]
    strides = params["strides"] or (1,) * len(starts)
    return x[tuple(map(slice, starts, limits, strides))]


def _broadcast(x: Any, params: Any) -> Any:
    spread = [1] * len(params["shape"])
    for axis, size in zip(params["broadcast_dimensions"], x.shape, strict=True):
        spread[axis] = size
    return np.broadcast_to(_reshaped(x, spread), params["shape"])


def _reshaped(x: Any, shape: Any) -> Any:
    """With axes of length one put in or left out: strides only, whatever they are."""
    kept = [s for s, n in zip(x.strides, x.shape, strict=True) if n != 1]
    sizes = iter(kept)
    strides = [0 if n == 1 else next(sizes) for n in shape]
    return np.lib.stride_tricks.as_strided(x, shape, strides, writeable=False)


_VIEWS: dict[str, Callable] = {
    "broadcast_in_dim": _broadcast,
    "expand_dims": lambda x, p: np.expand_dims(x, p["dimensions"]),
    "rev": lambda x, p: np.flip(x, p["dimensions"]),
    "slice": _sliced,
    "squeeze": lambda x, p: np.squeeze(x, tuple(p["dimensions"])),
    "transpose": lambda x, p: x.transpose(p["permutation"]),
}


def in_shape(walk, x: Memory, shape: tuple[int, ...]) -> Memory:
    """The same numbers in another shape."""
    if not x.is_packed:
        x = walk.arrays.copied(x)
    return x.looked_at(lambda a: a.reshape(shape))


def _reshape(walk, stored: list[Memory], params: Any, aval: Any) -> Memory:
    del params
    return in_shape(walk, stored[0], aval.shape)


def _concatenated(walk, stored: list[Memory], params: Any, aval: Any) -> Memory:
    return _laid(walk, stored, params["dimension"], aval)


def _stacked(walk, stored: list[Memory], params: Any, aval: Any) -> Memory:
    axis = params["axis"]
    rows = [x.looked_at(lambda a: np.expand_dims(a, axis)) for x in stored]
    return _laid(walk, rows, axis, aval)


def _laid(walk, stored: list[Memory], axis: int, aval: Any) -> Memory:
    """One beside the other along an axis."""
    to, first = walk.arrays.new(aval.shape, type_of(aval.dtype)), 0
    for x in stored:
        part = [slice(None)] * len(aval.shape)
        part[axis] = slice(first, first + x.shape[axis])
        here = tuple(part)
        if x.size:
            walk.arrays.copied(x, to.looked_at(lambda a, here=here: a[here]))
        first += x.shape[axis]
    return to


def _padded(walk, stored: list[Memory], params: Any, aval: Any) -> Memory:
    x, filling = stored
    to = walk.arrays.new(aval.shape, type_of(aval.dtype))
    one = Number(filling.at((0,) * len(filling.shape)), filling.type)
    walk.arrays.filled(to, lambda index: one)
    here = []
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


def _tiled(walk, stored: list[Memory], params: Any, aval: Any) -> Memory:
    (x,), to = stored, walk.arrays.new(aval.shape, type_of(aval.dtype))
    count = len(x.shape)
    parts = [n for pair in zip(params["reps"], x.shape, strict=True) for n in pair]
    each = to.looked_at(lambda a: a.reshape(parts))
    place = tuple(range(0, 2 * count, 2))
    spread = x.looked_at(lambda a: np.expand_dims(a, place)).spread(each.shape)
    walk.arrays.copied(spread, each)
    return to


_JOINED: dict[str, Callable] = {
    "concatenate": _concatenated,
    "pad": _padded,
    "reshape": _reshape,
    "stack": _stacked,
    "tile": _tiled,
}


def _split(walk, x: Memory, params: Any) -> list[Memory]:
    cuts, axis = np.cumsum(params["sizes"])[:-1], params["axis"]
    count = len(params["sizes"])
    part = lambda k: lambda a: np.split(a, cuts, axis)[k]
    return [_view(walk, x, part(k)) for k in range(count)]


def _unstacked(walk, x: Memory, axis: int) -> list[Memory]:
    row = lambda i: lambda a: np.moveaxis(a, axis, 0)[i]
    return [_view(walk, x, row(i)) for i in range(x.shape[axis])]


def _contracted(walk, a: Memory, b: Memory, numbers: Any, aval: Any) -> Memory:
    """Sums of products over some axes, for each place along others."""
    (over_a, over_b), (each_a, each_b) = numbers
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
            writer.line(f"{total.text} += {x} * {y};")
        writer.line(f"{to.at(index)} = {total.text};")
    return to


# -- by indices that are not known, and along an axis --------------------------------


def _clipped(walk, start: Any, last: int) -> Any:
    """An index within an array."""
    whole = np.dtype(np.int64)
    least = walk.operation("max", {}, [start, np.int64(0)], whole)
    return walk.operation("min", {}, [least, np.int64(last)], whole)


def _text(i: Any) -> Any:
    """An index in C, or a known one."""
    return i.text if isinstance(i, Number) else int(i)


def _taken(walk, equation, inputs: list) -> list:
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

    def at(index):
        return x.at([_plus(s, i) for s, i in zip(shifts, index, strict=True)])

    to = walk.arrays.new(aval.shape, kind)
    if to.size <= walk.small:
        found = [
            walk.writer.let(_read(at(i), kind), kind, True)
            for i in np.ndindex(aval.shape)
        ]
        return [as_objects(found, aval.shape)]
    return [walk.arrays.filled(to, lambda index: Number(at(index), kind))]


def _read(text: str, kind: str) -> str:
    return {"truth": f"({text} != 0)", "whole": f"(long){text}"}.get(kind, text)


def _plus(shift: Any, i: Any) -> Any:
    if isinstance(shift, int) and isinstance(i, int):
        return shift + i
    if i == 0 and isinstance(i, int):
        return shift
    if shift == 0 and isinstance(shift, int):
        return i
    return f"({shift} + {i})"


def _chosen(walk, x, begin, axis: int, sizes, dtype) -> Any:
    """A part of a few single numbers."""
    last = x.shape[axis] - sizes[axis]
    part = lambda i: np.take(x, range(i, i + sizes[axis]), axis)
    found = part(last)
    for i in reversed(range(last)):
        here = walk.operation("le", {}, [begin, np.int64(i)], np.dtype(bool))
        found = _selected(walk, here, part(i), found, dtype)
    return found


def _selected(walk, here, yes, no, dtype) -> Any:
    found = np.empty(yes.shape, object)
    for index in np.ndindex(yes.shape):
        options = [here, no[index], yes[index]]
        found[index] = walk.operation("select_n", {}, options, dtype)
    return found


def _put(walk, equation, inputs: list) -> list:
    """An array with a part that begins at indices that may be unknown."""
    x, update, *starts = inputs
    begins = [
        _clipped(walk, walk.numbers(s)[()], n - size)
        for s, n, size in zip(starts, x.shape, update.shape, strict=True)
    ]
    return [_written(walk, equation, x, update, begins, None, False)]


def _written(walk, equation, x, update, begins, inside, adds: bool) -> Any:
    """An array with a part that is written, or added to, where an index is inside."""
    aval = equation.outvars[0].aval
    kind = type_of(aval.dtype)
    if x.size <= walk.small:
        x, update = walk.numbers(x), walk.numbers(update)
        return _written_small(walk, x, update, begins, inside, adds, aval.dtype)
    x = walk.arrays.in_memory(x, kind)
    if not x.owned:
        x = walk.arrays.copied(x)._replace(owned=True)
    shifts = [_text(b) for b in begins]
    head = "" if inside is None else f"if ({in_c(inside).text})"
    with walk.writer.braces(head):
        if isinstance(update, Memory):
            with walk.arrays.loops(update.shape) as index:
                at = x.at([_plus(s, i) for s, i in zip(shifts, index, strict=True)])
                sign = "+=" if adds else "="
                walk.writer.line(f"{at} {sign} {update.at(index)};")
        else:
            for index in np.ndindex(update.shape):
                at = x.at([_plus(s, i) for s, i in zip(shifts, index, strict=True)])
                sign = "+=" if adds else "="
                walk.writer.line(f"{at} {sign} {in_c(update[index]).text};")
    return x


def _written_small(walk, x, update, begins, inside, adds, dtype) -> Any:
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


def _outside(dtype: Any, value: Any) -> Any:
    """What is read outside of an array: by default what is least or not a number."""
    if value is not None:
        return dtype.type(value)
    if np.issubdtype(dtype, np.floating):
        return dtype.type(np.nan)
    if dtype == np.bool_:
        return np.bool_(True)
    whole = np.iinfo(dtype)
    return dtype.type(whole.min if whole.min < 0 else whole.max)


def _gathered(walk, equation, inputs: list) -> list:
    """Rows of an array, of indices that may be unknown."""
    x, indices = inputs[0], walk.numbers(inputs[1])
    params, aval = equation.params, equation.outvars[0].aval
    numbers, rest = params["dimension_numbers"], x.shape[1:]
    many = indices.shape[:-1]
    tail = tuple(range(len(many), len(many) + len(rest)))
    plain = numbers.collapsed_slice_dims == (0,) and numbers.start_index_map == (0,)
    plain &= not numbers.operand_batching_dims and numbers.offset_dims == tail
    if not plain or tuple(params["slice_sizes"]) != (1, *rest):
        raise NotElementwiseError("a lookup of parts of rows")
    kind, filling = type_of(aval.dtype), None
    if "FILL" in str(params["mode"]):
        filling = _outside(aval.dtype, params["fill_value"])
    if not isinstance(indices, Memory) and not isinstance(x, Memory):
        known = [isinstance(i, np.generic) for i in indices.reshape(-1)]
        if all(known) and filling is None:
            places = indices[..., 0].astype(int).clip(0, x.shape[0] - 1)
            return [x[places]]
    x = walk.arrays.in_memory(x, kind)
    indices = walk.arrays.in_memory(indices, "whole")
    to = walk.arrays.new(aval.shape, kind)
    with walk.arrays.loops(aval.shape) as index:
        asked = walk.arrays.number_at(indices, (*index[: len(many)], 0))
        row = _clipped(walk, asked, x.shape[0] - 1)
        value = x.at((_text(row), *index[len(many) :]))
        if filling is not None:
            value = f"{asked.text} == {row.text} ? {value} : {in_c(filling).text}"
        walk.writer.line(f"{to.at(index)} = {value};")
    return [to]


def _scattered(walk, equation, inputs: list) -> list:
    """An array with one row that is written, or added to, if there is such a one."""
    x, index, update = inputs
    numbers = equation.params["dimension_numbers"]
    plain = index.shape == (1,) and not numbers.operand_batching_dims
    plain &= numbers.inserted_window_dims == (0,)
    plain &= numbers.scatter_dims_to_operand_dims == (0,)
    if not plain or update.shape != x.shape[1:]:
        raise NotElementwiseError("writing to parts of rows")
    row, truth = walk.numbers(index)[0], np.dtype(bool)
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


_RUNNING = {"cumsum": "add", "cumprod": "mul", "cummax": "max", "cummin": "min"}


def _running(walk, equation, inputs: list) -> list:
    """Sums and so on of all numbers up to each, along an axis."""
    params, aval = equation.params, equation.outvars[0].aval
    name, axis = _RUNNING[equation.primitive.name], params["axis"]
    (x,) = inputs
    if not isinstance(x, Memory):
        rows = np.moveaxis(np.array(x, object), axis, 0)
        rows = rows[::-1] if params["reverse"] else rows
        for i in range(1, len(rows)):
            for k in np.ndindex(rows.shape[1:]):
                pair = [rows[(i - 1, *k)], rows[(i, *k)]]
                rows[(i, *k)] = walk.operation(name, {}, pair, aval.dtype)
        rows = rows[::-1] if params["reverse"] else rows
        return [np.moveaxis(rows, 0, axis)]
    front = lambda a: np.moveaxis(a, axis, 0)
    turned = (lambda a: np.flip(front(a), 0)) if params["reverse"] else front
    to = walk.arrays.new(aval.shape, type_of(aval.dtype))
    a, b = x.looked_at(turned), to.looked_at(turned)
    with walk.arrays.loops(a.shape[1:]) as rest:
        total = walk.writer.variable(a.type, Number(a.at((0, *rest)), a.type))
        walk.writer.line(f"{b.at((0, *rest))} = {total.text};")
        with walk.arrays.loops((a.shape[0] - 1,)) as (k,):
            at = _plus(1, k)
            one = walk.arrays.number_at(a, (at, *rest))
            found = walk.operation(name, {}, [total, one], aval.dtype)
            walk.writer.line(f"{total.text} = {in_c(found).text};")
            walk.writer.line(f"{b.at((at, *rest))} = {total.text};")
    return [to]


def _place_of_best(walk, equation, inputs: list) -> list:
    """Index of the largest or least number along an axis; of what is not one first."""
    aval, (axis,) = equation.outvars[0].aval, equation.params["axes"]
    better = {"argmax": "gt", "argmin": "lt"}[equation.primitive.name]
    (x,), arrays = inputs, walk.arrays
    dtype = equation.invars[0].aval.dtype
    kind, truth = type_of(dtype), np.dtype(bool)

    def wins(one, best):
        more = walk.operation(better, {}, [one, best], truth)
        if kind != "real":
            return more
        lost = walk.operation("ne", {}, [one, one], truth)
        fine = walk.operation("eq", {}, [best, best], truth)
        lost = walk.operation("and", {}, [lost, fine], truth)
        return walk.operation("or", {}, [more, lost], truth)

    if not isinstance(x, Memory):
        rows = np.moveaxis(x, axis, 0)
        place = np.empty(rows.shape[1:], object)
        for k in np.ndindex(place.shape):
            best, at = rows[(0, *k)], np.int64(0)
            for i in range(1, len(rows)):
                one = rows[(i, *k)]
                won = wins(one, best)
                best = walk.operation("select_n", {}, [won, best, one], dtype)
                options = [won, at, np.int64(i)]
                at = walk.operation("select_n", {}, options, aval.dtype)
            place[k] = at
        return [place]
    turned = x.looked_at(lambda a: np.moveaxis(a, axis, 0))
    to = arrays.new(aval.shape, "whole")
    with arrays.loops(aval.shape) as rest:
        best = walk.writer.variable(kind, Number(turned.at((0, *rest)), kind))
        place = walk.writer.variable("whole", Number("0L", "whole"))
        with arrays.loops((turned.shape[0],)) as (i,):
            one = arrays.number_at(turned, (i, *rest))
            with walk.writer.braces(f"if ({in_c(wins(one, best)).text})"):
                walk.writer.line(f"{best.text} = {one.text}; {place.text} = {i};")
        walk.writer.line(f"{to.at(rest)} = {place.text};")
    return [to]


def _largest(walk, equation, inputs: list) -> list:
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


def _unset(walk, equation, inputs: list) -> list:
    """An array of which nothing is read before it is written."""
    del inputs
    aval = equation.outvars[0].aval
    if aval.size > walk.small:
        return [walk.arrays.new(aval.shape, type_of(aval.dtype))]
    return [numbers_of(np.zeros(aval.shape, aval.dtype))]


OPERATIONS: dict[str, Callable] = {
    "argmax": _place_of_best,
    "argmin": _place_of_best,
    "dynamic_slice": _taken,
    "dynamic_update_slice": _put,
    "empty": _unset,
    "empty2": _unset,
    "gather": _gathered,
    "scatter": _scattered,
    "scatter-add": _scattered,
    "top_k": _largest,
    **dict.fromkeys(_RUNNING, _running),
}
