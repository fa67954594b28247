"""Running sums, and places of the largest, of arrays of single numbers.

``operation(name, params, operands, dtype)`` writes one operation on numbers
(``scalar_program``), and leaves it out where they are known.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from .data_movement import Numbers
from .jaxpr_types import Params

Operation = Callable[[str, Params, list[Any], np.dtype], Any]
_TRUTH = np.dtype(bool)
RUNNING = {"cumsum": "add", "cumprod": "mul", "cummax": "max", "cummin": "min"}
_BETTER = {"argmax": "gt", "argmin": "lt"}
ALONG = frozenset((*RUNNING, *_BETTER))


def along(
    operation: Operation,
    name: str,
    numbers: Numbers,
    params: Params,
    of: np.dtype,
    dtype: np.dtype,
) -> Numbers:
    """What one of these operations gives.

    Args:
        operation: Writes one on numbers.
        name: Of ``ALONG``.
        numbers: Of which.
        params: Along which axis.
        of: Their type.
        dtype: Of the results.
    """
    if name in RUNNING:
        return running(operation, name, numbers, params, dtype)
    (axis,) = params["axes"]
    return place_of_best(operation, name, numbers, axis, of, dtype)


def running(
    operation: Operation, name: str, numbers: Numbers, params: Params, dtype: np.dtype
) -> Numbers:
    """Sums and so on of all numbers up to each, along an axis."""
    rows = np.moveaxis(np.array(numbers, object), params["axis"], 0)
    rows = rows[::-1] if params["reverse"] else rows
    for i in range(1, len(rows)):
        for k in np.ndindex(rows.shape[1:]):
            pair = [rows[(i - 1, *k)], rows[(i, *k)]]
            rows[(i, *k)] = operation(RUNNING[name], {}, pair, dtype)
    rows = rows[::-1] if params["reverse"] else rows
    return np.moveaxis(rows, 0, params["axis"])


def wins(
    operation: Operation, name: str, one: Any, best: Any, dtype: np.dtype
) -> tuple[Any, Any]:
    """Whether a number is better than the best, NaN than all, and which is then."""
    if dtype == _TRUTH:
        more, less = (one, best) if name == "argmax" else (best, one)
        but = operation("not", {}, [less], _TRUTH)
        better = operation("and", {}, [more, but], _TRUTH)
        both = "or" if name == "argmax" else "and"
        return better, operation(both, {}, [one, best], _TRUTH)
    better = operation(_BETTER[name], {}, [one, best], _TRUTH)
    if dtype.kind == "f":
        lost = operation("ne", {}, [one, one], _TRUTH)
        fine = operation("eq", {}, [best, best], _TRUTH)
        lost = operation("and", {}, [lost, fine], _TRUTH)
        better = operation("or", {}, [better, lost], _TRUTH)
    return better, operation("select_n", {}, [better, best, one], dtype)


def place_of_best(
    operation: Operation,
    name: str,
    numbers: Numbers,
    axis: int,
    of: np.dtype,
    dtype: np.dtype,
) -> Numbers:
    """Index of the largest or least number along an axis; of what is not one first.

    Args:
        operation: Writes one.
        name: ``argmax`` or ``argmin``.
        numbers: Among which.
        axis: Along which.
        of: Their type.
        dtype: Of an index.
    """
    rows = np.moveaxis(numbers, axis, 0)
    place = np.empty(rows.shape[1:], object)
    for k in np.ndindex(place.shape):
        best, at = rows[(0, *k)], dtype.type(0)
        for i in range(1, len(rows)):
            better, best = wins(operation, name, rows[(i, *k)], best, of)
            at = operation("select_n", {}, [better, at, dtype.type(i)], dtype)
        place[k] = at
    return place
