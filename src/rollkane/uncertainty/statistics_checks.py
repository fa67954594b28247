"""Blocks of members that a statistic can use, and sentences for those it cannot."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from ..validation.checks import FieldError, real
from .intervals import open_share
from .totals import Layout, Piece


def checked_edges(edges: Mapping[str, Any]) -> dict[str, np.ndarray]:
    """Edges of bins, each shape (B + 1,) and increasing.

    Raises:
        FieldError: they are not.
    """
    found: dict[str, np.ndarray] = {}
    for label, given in edges.items():
        field = f"edges[{label!r}]"
        real(field, given, (None,), "edges of bins")
        array = np.asarray(given, np.float64)
        if len(array) < 2 or not np.all(np.diff(array) > 0.0):
            remedy = "give at least two numbers, each larger than the one before"
            raise FieldError(field, given, "must increase", remedy)
        found[label] = array
    return found


def checked_share(q: Any) -> float:
    """Which quantile, between 0 and 1 [1].

    Raises:
        FieldError: it is not.
    """
    remedy = "give 0.5 for the median; minimum and maximum are there, too"
    return open_share("q", q, "which quantile, as 0.5", remedy)


def checked_block(
    layout: Layout,
    group_count: int | None,
    values: Mapping[str, Any],
    valid: Any,
    groups: Any,
) -> Piece:
    """A block as numbers and truth values, members first.

    Raises:
        FieldError: other names, shapes or types than the layout's, or a group that does
            not exist.
    """
    good = np.asarray(valid)
    if good.ndim != 1 or good.dtype.kind != "b":
        remedy = "give True for each member that did not fail"
        raise FieldError("valid", valid, "must be truth values of shape (n,)", remedy)
    if set(values) != set(layout.names):
        remedy = f"give {[*layout.names]} for every block"
        raise FieldError("values", sorted(values), "have other names", remedy)
    arrays = {name: np.asarray(x) for name, x in values.items()}
    for name, entry in layout.names.items():
        array, shape = arrays[name], (len(good), *entry.shape)
        if array.shape != shape:
            problem = f"must have shape {shape}, not {array.shape}"
            remedy = "give values of one shape, members first"
            raise FieldError(f"values[{name!r}]", array, problem, remedy)
        if array.dtype.kind not in ("b" if entry.truth else "iuf"):
            kind = "truth values" if entry.truth else "real numbers"
            remedy = "give one type for every block"
            raise FieldError(f"values[{name!r}]", array, f"must be {kind}", remedy)
    return Piece(
        layout.rows(arrays, truth=False, count=len(good)),
        layout.rows(arrays, truth=True, count=len(good)),
        good.copy(),
        _checked_groups(group_count, groups, len(good)),
    )


def _checked_groups(group_count: int | None, groups: Any, count: int) -> np.ndarray:
    if group_count is None:
        return np.zeros(count, np.int64)
    array = np.asarray(groups)
    whole = array.shape == (count,) and array.dtype.kind in "iu"
    if not whole or np.any((array < 0) | (array >= group_count)):
        problem = f"must be {count} whole numbers from 0 to {group_count - 1}"
        raise FieldError("groups", groups, problem, "give the group of each member")
    return array.astype(np.int64)
