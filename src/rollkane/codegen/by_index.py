"""Lookups and writes by indices: where these are known, numbers change places.

Which go where is found by NumPy, as XLA defines it: JAX would compile a program for it.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from .along_an_axis import Operation
from .data_movement import NotElementwiseError, Numbers, numbers_of
from .jaxpr_types import Params
from .known_numbers import KNOWN

# of so many one is chosen, where they do not lie in memory to be looked up: as many
# lines for every lookup
FEW = 32
# what becomes of the number that was there; None: it is written over
_WRITES = {
    "scatter": None,
    "scatter-add": "add",
    "scatter_add": "add",  # of later releases of JAX
    "scatter-mul": "mul",
    "scatter_mul": "mul",
    "scatter-min": "min",
    "scatter_min": "min",
    "scatter-max": "max",
    "scatter_max": "max",
}
BY_INDEX = frozenset(("gather", *_WRITES))


def by_index(
    operation: Operation,
    name: str,
    inputs: list[Numbers],
    params: Params,
    dtype: np.dtype,
) -> Numbers:
    """What a lookup or a write gives.

    Args:
        operation: Writes one on numbers.
        name: Of ``BY_INDEX``.
        inputs: The array, the indices and, of a write, what is written.
        params: Its parameters.
        dtype: Of the results.

    Raises:
        NotElementwiseError: indices that are not known.
    """
    x, indices = inputs[:2]
    if not all(isinstance(i, KNOWN) for i in indices.reshape(-1)):
        if name == "gather" and x.size <= FEW:
            return _chosen(operation, (x, indices), params, dtype)
        if name != "gather" and x.size <= FEW and indices.size == 1:
            known = functools.partial(by_index, operation, name)
            return _put(operation, known, inputs, params, dtype)
        raise NotElementwiseError(f"{name} by an index that is computed")
    at = np.array(indices.reshape(-1).tolist(), np.int64).reshape(indices.shape)
    if name == "gather":
        return _looked_up(x, at, params, dtype)
    return _written(operation, _WRITES[name], (x, at, inputs[2]), params, dtype)


class _Axes(NamedTuple):
    """Which axes belong together: an array's, the indices', and those of a result.

    A result is what is looked up or written.

    Attributes:
        window: The result's that are the array's.
        dropped: The array's, of which one place is taken and none is left.
        begins: The array's, at which the numbers of an index say where to begin.
        of_array: The array's that go along with the indices', and
        of_indices: those.
    """

    window: tuple[int, ...]
    dropped: tuple[int, ...]
    begins: tuple[int, ...]
    of_array: tuple[int, ...]
    of_indices: tuple[int, ...]

    @property
    def gone(self) -> tuple[int, ...]:
        """The array's that a window has not."""
        return *self.dropped, *self.of_array


def _places(
    shape: tuple[int, ...],
    at: np.ndarray,
    result: tuple[int, ...],
    axes: _Axes,
    sizes: tuple[int, ...],
    clips: bool,
) -> np.ndarray:
    """Of each number that is looked up or written, its place in an array; -1: none.

    Args:
        shape: Of the array.
        at: The indices: where windows begin, along the last axis.
        result: Its shape.
        axes: Which axes are which.
        sizes: Of a window.
        clips: Whether one that is not inside of the array is moved there.
    """
    many = [k for k in range(len(result)) if k not in axes.window]
    index = np.indices(result)
    # where its window begins, of each number
    which = tuple(index[k] for k in many)
    begin = np.zeros((len(shape), *result), np.int64)
    for k, axis in enumerate(axes.begins):
        begin[axis] = at[(*which, k)]
    for axis, k in zip(axes.of_array, axes.of_indices, strict=True):
        begin[axis] = which[k]
    column = (-1, *[1] * len(result))
    last = np.subtract(shape, sizes).reshape(column)
    if clips:
        begin = np.clip(begin, 0, last)
    inside = np.all((begin >= 0) & (begin <= last), axis=0)
    kept = [axis for axis in range(len(shape)) if axis not in axes.gone]
    for axis, k in zip(kept, axes.window, strict=True):
        begin[axis] += index[k]
    steps = np.cumprod((1, *shape[:0:-1]))[::-1] if shape else np.ones(0, int)
    found = np.sum(begin * steps.astype(np.int64).reshape(column), axis=0)
    return np.where(inside, found, -1)


def _clips(params: Params) -> bool:
    """Whether windows are moved inside: told, or promised that they are there."""
    mode = str(params["mode"])
    if not any(name in mode for name in ("CLIP", "FILL", "PROMISE")):
        raise NotElementwiseError(f"indices by {mode}")
    return "FILL" not in mode


def _looked_up(x: Numbers, at: np.ndarray, params: Params, dtype: np.dtype) -> Numbers:
    numbers, sizes = params["dimension_numbers"], tuple(params["slice_sizes"])
    axes = _Axes(
        numbers.offset_dims,
        numbers.collapsed_slice_dims,
        numbers.start_index_map,
        numbers.operand_batching_dims,
        numbers.start_indices_batching_dims,
    )
    window = iter(n for axis, n in enumerate(sizes) if axis not in axes.gone)
    many = iter(at.shape[:-1])
    rank = len(axes.window) + at.ndim - 1
    result = tuple(next(window if k in axes.window else many) for k in range(rank))
    places = _places(x.shape, at, result, axes, sizes, _clips(params))
    outside = numbers_of(np.asarray(filled(dtype, params["fill_value"]), dtype))
    every = np.append(x.reshape(-1), outside.reshape(-1))
    return every[places.reshape(-1)].reshape(places.shape)


def _chosen(
    operation: Operation, inputs: tuple[Numbers, Numbers], params: Params, dtype: Any
) -> Numbers:
    """A lookup by indices that are computed: each chooses among all that it may be."""
    x, indices = inputs
    numbers = params["dimension_numbers"]
    if len(numbers.start_index_map) != 1 or numbers.operand_batching_dims:
        raise NotElementwiseError("a lookup by two indices")
    (axis,) = numbers.start_index_map
    last = x.shape[axis] - params["slice_sizes"][axis]
    options: list[Numbers] = []
    for place in range(last + 1):
        at = np.full(indices.shape, place)
        options.append(_looked_up(x, at, params, dtype))
    found = options[0].copy()
    outside = filled(dtype, params["fill_value"])
    fills = "FILL" in str(params["mode"])
    truth = np.dtype(bool)
    many = [k for k in range(found.ndim) if k not in numbers.offset_dims]
    for index in np.ndindex(found.shape):
        place = indices[(*(index[k] for k in many), 0)]
        chosen = options[-1][index]
        for i in reversed(range(last)):
            here = operation("le", {}, [place, np.int64(i)], truth)
            chosen = operation("select_n", {}, [here, chosen, options[i][index]], dtype)
        if fills:
            for name, end in (("ge", 0), ("le", last)):
                inside = operation(name, {}, [place, np.int64(end)], truth)
                chosen = operation("select_n", {}, [inside, outside, chosen], dtype)
        found[index] = chosen
    return found


def _put(
    operation: Operation,
    written: Callable[..., Numbers],
    inputs: list[Numbers],
    params: Params,
    dtype: Any,
) -> Numbers:
    """A write by one index that is computed: each number is chosen."""
    x, indices, update = inputs
    numbers = params["dimension_numbers"]
    axes = numbers.scatter_dims_to_operand_dims
    if len(axes) != 1 or axes != numbers.inserted_window_dims:
        raise NotElementwiseError("a write of several rows by an index")
    found, place, last = x.copy(), indices.reshape(-1)[0], x.shape[axes[0]] - 1
    drops = "FILL" in str(params["mode"])
    for i in range(last + 1):
        at = numbers_of(np.full(indices.shape, i))
        option = written([x, at, update], params, dtype)
        ends = "eq" if drops or 0 < i < last else ("le" if i == 0 else "ge")
        here = operation(ends, {}, [place, np.int64(i)], np.dtype(bool))
        for index in np.ndindex(x.shape):
            if option[index] is not x[index]:
                both = [here, found[index], option[index]]
                found[index] = operation("select_n", {}, both, dtype)
    return found


def filled(dtype: np.dtype, value: Any) -> Any:
    """What is read outside of an array: by default what is least or not a number."""
    if value is not None:
        return dtype.type(value)
    if np.issubdtype(dtype, np.floating):
        return dtype.type(np.nan)
    if dtype == np.bool_:
        return np.bool_(True)
    whole = np.iinfo(dtype)
    return dtype.type(whole.min if whole.min < 0 else whole.max)


def _written(
    operation: Operation,
    name: str | None,
    inputs: tuple[Numbers, np.ndarray, Numbers],
    params: Params,
    dtype: np.dtype,
) -> Numbers:
    """What a write leaves; None for a name: of what was there nothing."""
    x, at, update = inputs
    numbers = params["dimension_numbers"]
    axes = _Axes(
        numbers.update_window_dims,
        numbers.inserted_window_dims,
        numbers.scatter_dims_to_operand_dims,
        numbers.operand_batching_dims,
        numbers.scatter_indices_batching_dims,
    )
    window = iter(update.shape[k] for k in axes.window)
    sizes = tuple(1 if axis in axes.gone else next(window) for axis in range(x.ndim))
    places = _places(x.shape, at, update.shape, axes, sizes, _clips(params))
    found = np.array(x, object).reshape(-1)
    for place, new in zip(places.reshape(-1), update.reshape(-1), strict=True):
        if place >= 0:
            both = [found[place], new]
            found[place] = new if name is None else operation(name, {}, both, dtype)
    return found.reshape(x.shape)
