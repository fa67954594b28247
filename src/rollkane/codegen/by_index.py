"""Lookups and writes by indices: where these are known, numbers change places.

Which go where is found by JAX itself, which does the same to the places' numbers.
"""

import functools
from collections.abc import Callable
from typing import Any

import jax
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
# Places times numbers that are written: 8 MB of ones and zeros, in 0.03 s, and 0.4 s
# for the first of a shape, which XLA compiles
_MOST = 1_000_000


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
    with jax.ensure_compile_time_eval():
        if name == "gather":
            return _looked_up(x, at, params, dtype)
        if _WRITES[name] is None:
            return _written(x, at, inputs[2], params)
        return _combined(operation, _WRITES[name], (x, at, inputs[2]), params, dtype)


def _places(x: Numbers, first: int = 0) -> np.ndarray:
    # by NumPy, which compiles nothing
    return np.arange(first, first + x.size).reshape(x.shape)


def _looked_up(x: Numbers, at: np.ndarray, params: Params, dtype: np.dtype) -> Numbers:
    places: Any = _places(x)
    found = jax.lax.gather(
        places,
        at,
        params["dimension_numbers"],
        params["slice_sizes"],
        indices_are_sorted=params["indices_are_sorted"],
        unique_indices=params["unique_indices"],
        mode=params["mode"],
        fill_value=-1,
    )
    outside = numbers_of(np.asarray(filled(dtype, params["fill_value"]), dtype))
    return _of(x, outside, found)


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
    with jax.ensure_compile_time_eval():
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


def _of(x: Numbers, others: Numbers, places: Any) -> Numbers:
    """Numbers by their places among those of an array and others behind them."""
    places = np.asarray(places)
    every = np.append(x.reshape(-1), others.reshape(-1))
    return every[places.reshape(-1)].reshape(places.shape)


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


def _how(params: Params) -> dict[str, Any]:
    names = "dimension_numbers", "indices_are_sorted", "unique_indices", "mode"
    return {name: params[name] for name in names}


def _written(x: Numbers, at: np.ndarray, update: Numbers, params: Params) -> Numbers:
    given: Any = _places(x), at, _places(update, x.size)
    found = jax.lax.scatter(*given, **_how(params))
    return _of(x, update, found)


def _combined(
    operation: Operation,
    name: Any,
    inputs: tuple[Numbers, np.ndarray, Numbers],
    params: Params,
    dtype: np.dtype,
) -> Numbers:
    x, at, update = inputs
    if x.size * update.size > _MOST:
        raise NotElementwiseError("writing many numbers to many places")
    rest: Any = np.zeros(x.shape, int)
    each = np.eye(update.size, dtype=int).reshape(update.size, *update.shape)
    one: Callable[[Any], Any]
    one = lambda own: jax.lax.scatter_add(rest, at, own, **_how(params))
    hits = np.asarray(jax.vmap(one)(each)).reshape(update.size, x.size)
    found, new = np.array(x, object).reshape(-1), update.reshape(-1)
    for k, place in np.argwhere(hits):
        found[place] = operation(name, {}, [found[place], new[k]], dtype)
    return found.reshape(x.shape)
