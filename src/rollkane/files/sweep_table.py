"""What a sweep observed, as a NetCDF file over the numbers that vary, and time.

Needs the extra ``rollkane[results]`` (xarray, h5netcdf, h5py).
"""

import os
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from .export import COORDINATES, imported, labels, write_netcdf

_AXES = {3: "axis", 4: "quaternion"}


def write_sweep(
    path: str | os.PathLike[str],
    grids: Sequence[tuple[str, Sequence[float]]],
    time: np.ndarray,
    observed: Mapping[str, np.ndarray],
    ends: Mapping[str, np.ndarray],
    units: Mapping[str, str],
    title: str,
) -> None:
    """Write a sweep, whole or not at all.

    Args:
        path: The file, .nc; replaced if it exists. Its folder must exist.
        grids: What varied and its values; the last one fastest.
        time: Output times [s], shape (T,).
        observed: By name, shape (N, T) or (N, T, components).
        ends: Of each motion, shape (N,).
        units: Of what was observed, by name.
        title: Of the scene.

    Raises:
        FieldError: another ending.
        ImportError: xarray, h5netcdf or h5py is not installed.
        OSError: the file cannot be written.
    """
    xarray = imported("xarray")
    names = tuple(name for name, _ in grids)
    shape = tuple(len(values) for _, values in grids)
    coordinates: dict[str, Any] = {name: list(values) for name, values in grids}
    coordinates |= {"time": ("time", time, labels("time", "s", ""))}
    variables: dict[str, Any] = {}
    for name, x in observed.items():
        behind = ("time", *(_AXES[n] for n in x.shape[2:]))
        coordinates |= {dim: COORDINATES[dim] for dim in behind[1:]}
        about = labels(name.replace("_", " "), units[name], "")
        variables[name] = (*names, *behind), x.reshape(*shape, *x.shape[1:]), about
    for name, x in ends.items():
        plain = x.astype(str) if x.dtype == object else x
        variables[name] = names, plain.reshape(shape)
    write_netcdf(xarray.Dataset(variables, coordinates, {"title": title}), path)
