"""Records of motions from tables of samples."""

import difflib
import os
import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from ..identification import body_sensors, sensors
from ..identification.channels import AbstractChannel
from ..identification.records import Record
from ..validation.checks import FieldError
from .accelerogram_units import TIMES
from .accelerogram_units import UNITS as ACCELERATIONS
from .record_tables import READER, Table, end_of_name, table_of

Columns = str | Sequence[str]

# what one unit is worth in that of the channel, which comes first
_RATES = {"rad/s": 1.0, "deg/s": np.pi / 180.0}
_ACCELERATIONS = {"m/s2": 1.0, "m/s^2": 1.0} | ACCELERATIONS
_LENGTHS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
_FORCES = {"N": 1.0, "kN": 1e3, "mN": 1e-3}
# Times in whole numbers with steps above this look like milliseconds [s].
_LONG_STEP = 0.5


class Kind(NamedTuple):
    """A kind of channel.

    Attributes:
        make: The channel of samples, sigma, and ``at`` where it has one.
        columns: How many it is read from.
        units: What they may be in, each by its worth in SI.
        axes: That its numbers are on, as tables of runs name them.
        placed: Whether it is of a point of the body.
    """

    make: Callable[..., AbstractChannel]
    columns: int
    units: Mapping[str, float]
    axes: str
    placed: bool = False


KINDS = {
    "gyro": Kind(body_sensors.Gyro, 3, _RATES, "body"),
    "accelerometer": Kind(
        body_sensors.Accelerometer, 3, _ACCELERATIONS, "body", placed=True
    ),
    "position": Kind(sensors.Position, 3, _LENGTHS, "fixed", placed=True),
    "orientation": Kind(sensors.Orientation, 4, {"1": 1.0}, "body to fixed"),
    "marker": Kind(sensors.Marker, 3, _LENGTHS, "fixed", placed=True),
    "contact_path": Kind(sensors.ContactPath, 3, _LENGTHS, "base"),
    "normal_force": Kind(sensors.NormalForce, 1, _FORCES, ""),
}
_AXES = "fixed", "body", "base", "body to fixed", "base to fixed", "own to fixed"


def read_record(
    path: str | os.PathLike[str] | Any,
    time: str = "t",
    *,
    sigma: Mapping[str, ArrayLike] | None = None,
    units: Mapping[str, str] | None = None,
    at: Mapping[str, ArrayLike] | None = None,
    between: tuple[float | None, float | None] | None = None,
    **channels: Columns,
) -> Record:
    """A record from a CSV or NetCDF file, or from a data frame.

    ``read_record("run.csv", gyro=("wx", "wy", "wz"), sigma={"gyro": 0.02})``. A CSV
    file has a header row and cells between commas, semicolons or tabs; lines that begin
    with # are comments, empty cells and "nan" missing samples.

    Args:
        path: File (``.nc``, ``.nc4``, ``.h5``, ``.hdf5``: NetCDF), or anything with
            ``columns`` and ``[name]``, as a pandas ``DataFrame``. Of a NetCDF variable
            of two dimensions the columns are ``name_x`` and so on.
        time: Column of times [s], increasing.
        sigma: Standard deviation of the noise by channel [rad/s, m/s^2, m, rad, N],
            one number or one for each column; left out, a fit estimates it.
        units: Of the columns by channel, where they are not SI: "deg/s"; "g", "cm/s2",
            "mm/s2"; "cm", "mm"; "mN", "kN"; "time": "ms", "us". A NetCDF file's own
            units count without it, and those in brackets behind a column's name:
            "wx [deg/s]", "ax (g)". A name that ends in one ("x_cm") needs it.
        at: Where a sensor or marker sits by channel, body axes [m], shape (3,).
        between: First and last time [s] of the rows that are kept, which keep their
            times; None for all, or for either end.
        channels: Columns by channel: ``gyro``, ``accelerometer``, ``position``,
            ``marker``, ``contact_path`` (three each), ``orientation`` (four, scalar
            first), ``normal_force`` (one); a number behind the name makes one more of
            the kind (``marker2``).

    Returns:
        The record, whose start is the first row that is kept.

    Raises:
        FieldError: a column that is missing, with those that there are; times out of
            order, cells that are not numbers, with their row; unknown channels, units.
        ImportError: a NetCDF file, without the extra ``results``.
    """
    kinds = _kinds(channels)
    table = table_of(path)
    sigma, units, at = sigma or {}, units or {}, at or {}
    _check_keys("sigma", sigma, [*channels])
    _check_keys("units", units, ["time", *channels])
    _check_keys("at", at, [*channels])
    times = _times(table, time, units.get("time"))
    kept = _kept(table, times, between)
    found: dict[str, AbstractChannel] = {}
    for name, kind in kinds.items():
        names = _names(name, channels[name], kind.columns, time)
        columns = [table.column(name, one, beside=time)[kept] for one in names]
        worth = _worth(table, name, names, kind.units, units.get(name))
        _check_axes(table, name, names, kind.axes)
        samples = worth * np.stack(columns, axis=1)
        place = _place(name, kind, at)
        found[name] = kind.make(samples, sigma.get(name), **place)
    return Record(times[kept], found)


def kind_of(name: str) -> Kind | None:
    """The kind of a channel by its name, which may end in a number."""
    return KINDS.get(name.rstrip("0123456789_"))


def _near(name: str, known: Sequence[str]) -> str:
    near = difflib.get_close_matches(name, known, n=1)
    return f"did you mean {near[0]!r}? " if near else ""


def _kinds(channels: Mapping[str, Columns]) -> dict[str, Kind]:
    known = ", ".join(KINDS)
    if not channels:
        remedy = f'give for example gyro=("wx", "wy", "wz"); channels are: {known}'
        raise FieldError(f"{READER}.channels", (), "names no channel", remedy)
    found: dict[str, Kind] = {}
    for name in channels:
        kind = kind_of(name)
        if kind is None:
            remedy = f"{_near(name, [*KINDS])}channels are: {known}"
            raise FieldError(f"{READER}.{name}", name, "is not a channel", remedy)
        found[name] = kind
    return found


def _check_keys(field: str, given: Mapping[str, Any], known: list[str]) -> None:
    for name in given:
        if name not in known:
            remedy = f"{_near(name, known)}the record has: {', '.join(known)}"
            raise FieldError(f"{READER}.{field}", name, "is not read", remedy)


def _names(channel: str, columns: Columns, count: int, time: str) -> tuple[str, ...]:
    names = (columns,) if isinstance(columns, str) else tuple(map(str, columns))
    remedy = 'give their names, for example ("wx", "wy", "wz")'
    if len(names) != count:
        problem = f"must name {count} column{'s' if count > 1 else ''}"
        raise FieldError(f"{READER}.{channel}", columns, problem, remedy)
    if len({*names, time}) != count + 1:
        problem = "names a column twice, or that of the times"
        raise FieldError(f"{READER}.{channel}", columns, problem, remedy)
    return names


def _worth(
    table: Table,
    channel: str,
    names: Sequence[str],
    known: Mapping[str, float],
    unit: str | None,
) -> Float[np.ndarray, " k"]:
    """What the columns' units are worth in SI."""
    field = f"{READER}.units[{channel!r}]"
    worth = np.ones(len(names))
    for k, name in enumerate(names):
        own = table.of(name).unit if unit is None else unit
        if own is not None and own not in known:
            whose = "" if unit is not None else f" of column {name!r}"
            remedy = f"give units={{{channel!r}: ...}}, one of: {', '.join(known)}"
            raise FieldError(field, own, f"is no known unit{whose}", remedy)
        worth[k] = 1.0 if own is None else known[own]
        if own is None:
            _refuse_suffix(field, channel, name, known)
    return worth


def _refuse_suffix(
    field: str, channel: str, name: str, known: Mapping[str, float]
) -> None:
    """Refuse a column of no told unit whose name ends like one that is not of SI."""
    end = end_of_name(name)
    if known.get(end, 1.0) != 1.0:
        problem = f"is not given, and {name!r} ends like {end!r}"
        remedy = f"give units={{{channel!r}: {end!r}}}, or the unit that it is in"
        raise FieldError(field, None, problem, remedy)


def _check_axes(table: Table, channel: str, names: Sequence[str], axes: str) -> None:
    for name in names:
        said = table.of(name).axes
        if said in _AXES and said != axes:
            problem = f"has {name!r} on {said} axes, and {channel} is on {axes} axes"
            remedy = "turn it first: of a run `state` has body axes, its results fixed"
            table.refuse(channel, name, problem, remedy)


def _place(name: str, kind: Kind, at: Mapping[str, ArrayLike]) -> dict[str, ArrayLike]:
    if name in at and not kind.placed:
        remedy = "leave it out"
        raise FieldError(f"{READER}.at", name, "reads the same at any place", remedy)
    if name not in at and kind.make is body_sensors.Accelerometer:
        remedy = f"give at={{{name!r}: (x, y, z)}}, from the body origin [m]"
        raise FieldError(f"{READER}.at", dict(at), f"does not place {name!r}", remedy)
    return {"at": at[name]} if name in at else {}


def _times(table: Table, column: str, unit: str | None) -> Float[np.ndarray, " T"]:
    """Times [s], in order."""
    written = table.column("time", column)
    if np.isnan(written).any():
        row = table.row(int(np.argmax(np.isnan(written))))
        table.refuse("time", column, f"{row}: has no time", "give the row its time")
    steps = np.diff(written)
    if (steps <= 0.0).any():
        k = int(np.argmax(steps <= 0.0)) + 1
        problem = (
            f"{table.row(k)}: times are out of order: {written[k]:.9g} after "
            f"{written[k - 1]:.9g}"
        )
        table.refuse("time", column, problem, "sort the rows, and leave repeats out")
    told = unit is not None or table.of(column).unit is not None
    whole = bool(np.all(written == np.round(written)))
    if not told and whole and steps.size and np.median(steps) > _LONG_STEP:
        message = (
            f"{table.source}: times look like milliseconds: whole numbers, "
            f'{np.median(steps):g} apart; give units={{"time": "ms"}} (or "s")'
        )
        warnings.warn(message, UserWarning, stacklevel=3)
    return written * _worth(table, "time", [column], TIMES, unit)


def _kept(table: Table, times: Float[np.ndarray, " T"], between: Any) -> slice:
    """Rows between two times."""
    if between is None:
        return slice(0, times.size)
    remedy = f"give two times of {times[0]:g} to {times[-1]:g} s, the first one first"
    try:
        pairs = zip(between, (-np.inf, np.inf), strict=True)
        first, last = (float(open_end if x is None else x) for x, open_end in pairs)
    except (TypeError, ValueError) as error:
        field = f"{READER}.between"
        raise FieldError(field, between, "must be two times", remedy) from error
    begin = int(np.searchsorted(times, first, side="left"))
    end = int(np.searchsorted(times, last, side="right"))
    if not first < last or end - begin < 2:
        table.refuse("between", between, "has less than two rows between them", remedy)
    return slice(begin, end)
