"""Motions as tables of comma-separated values, which any program reads."""

import csv
import io
import itertools
import os
import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..simulation.trajectory import Trajectory
from ..validation.checks import FieldError
from .atomic_file import write_whole
from .export import ALWAYS, BASE_AXIS, COORDINATES, QUANTITIES, ROLLING, quantities

_LABELS: dict[str, list[str]] = {
    name: labels for name, (_, labels) in (COORDINATES | BASE_AXIS).items()
}
# of bodies that roll in the body: their path, and a column of theirs
_OF_ROLLING = re.compile(r"rolling(?:_\d+)+_(.+)")


def write_csv(run: Trajectory, path: str | os.PathLike[str]) -> None:
    """Write one run as a table, whole or not at all.

    A line for each time, in columns ``time`` [s], ``position_x`` [m] and so on: the
    variables of :func:`rollkane.files.export.to_xarray`, in the units named there, a
    column for each component, as :func:`rollkane.read_record` names those of a NetCDF
    file. Numbers are written so that they read back exactly; what was not reached is
    ``nan``.

    Args:
        run: One run, not a batch.
        path: The file, .csv; replaced if it exists. Its folder must exist.

    Raises:
        FieldError: a batch.
        OSError: the file cannot be written.
    """
    if run.code.ndim:
        remedy = "write runs one by one, or all in a .nc file"
        raise FieldError("run", run.code.shape, "is a batch of runs", remedy)
    columns = {"time": np.asarray(run.time)}
    for name, (dims, values, _) in quantities(run, run.scene, ("time",)).items():
        parts = [_labels(dim, n) for dim, n in zip(dims, values.shape, strict=True)]
        for label in itertools.product(*(range(len(part)) for part in parts[1:])):
            words = [part[k] for part, k in zip(parts[1:], label, strict=True)]
            columns["_".join([name, *words])] = values[(slice(None), *label)]
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(
        zip(*(column.tolist() for column in columns.values()), strict=True)
    )
    write_whole(path, text.getvalue().encode())


def axes_of(names: Sequence[str]) -> dict[str, str]:
    """Axes of the columns of a table of :func:`write_csv`, which has none in it.

    Args:
        names: Of all columns of a table.

    Returns:
        Axes by column; nothing of a table that lacks a column which each run has.
    """
    known, rolling = _axes_by_column(QUANTITIES), _axes_by_column(ROLLING)
    if not {"time", *_axes_by_column(ALWAYS)} <= set(names):
        return {}
    found: dict[str, str] = {}
    for name in names:
        inner = _OF_ROLLING.fullmatch(name)
        axes = rolling.get(inner[1]) if inner else known.get(name)
        if axes:
            found[name] = axes
    return found


def _axes_by_column(described: Mapping[str, Any]) -> dict[str, str]:
    found: dict[str, str] = {}
    for name, (dims, _, _, axes) in described.items():
        for words in itertools.product(*(_LABELS[dim] for dim in dims)):
            found["_".join([name, *words])] = axes
    return found


def _labels(dimension: str, count: int) -> list[str]:
    return _LABELS.get(dimension, [str(k) for k in range(count)])
