"""Arrays of numbers that change places, where nothing is computed."""

from collections.abc import Callable, Iterable
from typing import Any

import jax
import numpy as np

from ..validation.checks import is_traced
from .jaxpr_types import Params

Numbers = np.ndarray  # of objects: NumPy scalars where known, else a target's values


class NotElementwiseError(ValueError):
    """A program has an operation that is not one on single numbers."""


def refuse_keys(arrays: Iterable[Any]) -> None:
    """Refuse ``jax.random.key``: what is in it only JAX knows.

    Raises:
        NotElementwiseError: a type of JAX's own.
    """
    for x in arrays:
        if not isinstance(x.dtype, np.dtype):
            raise NotElementwiseError(f"numbers of {x.dtype}")


def numbers_of(array: Any) -> Numbers:
    """The numbers of an array, as objects: NumPy scalars, or JAX's if it is traced."""
    if isinstance(array, jax.Array):
        refuse_keys([array])
    if is_traced(array):
        flat = jax.numpy.reshape(array, -1)
        return as_objects(jax.numpy.unstack(flat) if flat.size else (), array.shape)
    array = np.asarray(array)
    return as_objects([*array.reshape(-1)], array.shape)


def as_objects(values: Any, shape: tuple[int, ...]) -> Numbers:
    """Values in order as an array of objects: NumPy would look into them."""
    return np.fromiter(values, object, len(values)).reshape(shape)


def _broadcast(inputs: list[Numbers], params: Params) -> Numbers:
    spread = [1] * len(params["shape"])
    axes = zip(params["broadcast_dimensions"], inputs[0].shape, strict=True)
    for axis, size in axes:
        spread[axis] = size
    return np.broadcast_to(inputs[0].reshape(spread), params["shape"])


def sliced(x: np.ndarray, params: Params) -> np.ndarray:
    """The part of an array that a slice takes."""
    starts, limits = params["start_indices"], params["limit_indices"]
    strides = params["strides"] or (1,) * len(starts)
    return x[tuple(map(slice, starts, limits, strides))]


def _iota(inputs: list[Numbers], params: Params) -> Numbers:
    del inputs
    shape, axis = params["shape"], params["dimension"]
    count = np.arange(shape[axis], dtype=params["dtype"])
    along = [-1 if i == axis else 1 for i in range(len(shape))]
    return numbers_of(np.broadcast_to(count.reshape(along), shape))


def _padded(inputs: list[Numbers], params: Params) -> Numbers:
    numbers, filling = inputs
    gaps = params["padding_config"]
    shape = [
        low + high + n + max(n - 1, 0) * between
        for n, (low, high, between) in zip(numbers.shape, gaps, strict=True)
    ]
    result = np.empty([max(n, 0) for n in shape], object)
    result[...] = filling[()]
    for index in np.ndindex(numbers.shape):
        place = tuple(
            low + i * (between + 1)
            for i, (low, _, between) in zip(index, gaps, strict=True)
        )
        if all(0 <= i < n for i, n in zip(place, shape, strict=True)):
            result[place] = numbers[index]
    return result


# bookkeeping: numbers change places, and nothing is computed
MOVES: dict[str, Callable[[list[Numbers], Params], Numbers]] = {
    "broadcast_in_dim": _broadcast,
    "concatenate": lambda x, p: np.concatenate(x, p["dimension"]),
    "expand_dims": lambda x, p: np.expand_dims(x[0], p["dimensions"]),
    "iota": _iota,
    "pad": _padded,
    "reshape": lambda x, p: x[0].reshape(p["new_sizes"]),
    "rev": lambda x, p: np.flip(x[0], p["dimensions"]),
    "slice": lambda x, p: sliced(x[0], p),
    "squeeze": lambda x, p: np.squeeze(x[0], tuple(p["dimensions"])),
    "stack": lambda x, p: np.stack(x, p["axis"]),
    "tile": lambda x, p: np.tile(x[0], p["reps"]),
    "transpose": lambda x, p: x[0].transpose(p["permutation"]),
}


def _split(x: Numbers, params: Params) -> list[Numbers]:
    return np.split(x, np.cumsum(params["sizes"])[:-1], params["axis"])


def _unstacked(x: Numbers, params: Params) -> list[Numbers]:
    rows = np.moveaxis(x, params["axis"], 0)
    return [rows[i : i + 1].reshape(rows.shape[1:]) for i in range(len(rows))]


PARTS = {"split": _split, "unstack": _unstacked}
