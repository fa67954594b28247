"""Motions as tables of comma-separated values, which any program reads."""

import csv
import io
import itertools
import os

import numpy as np

from ..simulation.trajectory import Trajectory
from ..validation.checks import FieldError
from .atomic_file import write_whole
from .export import BASE_AXIS, COORDINATES, quantities

_LABELS: dict[str, list[str]] = {
    name: labels for name, (_, labels) in (COORDINATES | BASE_AXIS).items()
}


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


def _labels(dimension: str, count: int) -> list[str]:
    return _LABELS.get(dimension, [str(k) for k in range(count)])
