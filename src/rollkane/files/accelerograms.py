"""Recorded ground accelerations: readers of the usual files, and built-in records."""

import gzip
import os
import re
from collections.abc import Callable
from importlib import resources
from importlib.resources.abc import Traversable
from numbers import Real
from typing import Any, NamedTuple

import numpy as np

from ..validation.checks import FieldError
from .accelerogram_columns import check_columns
from .accelerogram_headers import (
    check_name,
    check_unit,
    counted,
    header_says,
    in_si,
    sample_unit,
    time_unit,
)
from .accelerogram_lines import NUMBER, Lines
from .accelerogram_units import TIMES, UNITS
from .accelerogram_v2a import v2a_components

# what a row has instead of a number that was lost or misprinted
_SPOILT = re.compile(
    r"[-+]?\.?\d|[-+*.?]+$|[-+]?(?:nan|inf|na|n/a|null|none)$|[oOlI\d]*\.[oOlI\d]+$",
    re.IGNORECASE,
)
BUILTIN_RECORDS = ("eqsig-test-motion", "kaikoura-2016-wtmc")


class Accelerogram(NamedTuple):
    """A recorded acceleration.

    Attributes:
        time: [s], equally spaced, shape (N,).
        acceleration: [m/s^2], shape (N, k), one column for each component.
        components: Names of the components' directions; "" where not known.
        title: A line of text.
    """

    time: np.ndarray
    acceleration: np.ndarray
    components: tuple[str, ...]
    title: str

    def window(self, start: float, end: float) -> "Accelerogram":
        """The part between two times [s], with its own clock from zero.

        Args:
            start: First time [s]; the first sample at or after it.
            end: Last time [s].

        Raises:
            FieldError: not within the record, or less than two samples in it.
        """
        field = "Accelerogram.window"
        asked = [_seconds(field, start), _seconds(field, end)]
        if len(self.time) < 2:
            raise FieldError(
                field, asked, "needs a record of two samples or more", "give such a one"
            )
        slack = 1e-6 * (self.time[1] - self.time[0])
        inside = (self.time >= asked[0] - slack) & (self.time <= asked[1] + slack)
        outside = asked[0] < self.time[0] - slack or asked[1] > self.time[-1] + slack
        if outside or np.count_nonzero(inside) < 2:
            raise FieldError(
                field,
                asked,
                f"is not within the record, {self.time[0]:g} to {self.time[-1]:g} s, "
                "or holds less than two samples",
                "give a start and an end within it, the start first",
            )
        time = self.time[inside]
        return self._replace(
            time=time - time[0], acceleration=self.acceleration[inside]
        )


def _seconds(field: str, value: Any) -> float:
    """A finite time [s]."""
    number = value.item() if getattr(value, "ndim", None) == 0 else value
    if isinstance(number, bool) or not isinstance(number, Real):
        raise FieldError(field, value, "must be two times", "give numbers in seconds")
    seconds = float(number)
    if not np.isfinite(seconds):
        raise FieldError(field, value, "must be finite", "give numbers in seconds")
    return seconds


def read_at2(path: str | os.PathLike[str], unit: str | None = None) -> Accelerogram:
    """Read a record in the AT2 form of the PEER data base.

    Args:
        path: Text file: header lines, ``NPTS= 2000, DT= .02000 SEC`` (or the older
            ``2000 .0200 NPTS, DT``; MSEC is read, too), then the samples.
        unit: Of the samples: "g", "m/s2", "cm/s2" or "mm/s2". None: what the header
            says, or else g.

    Returns:
        One component [m/s^2].

    Raises:
        FieldError: the file cannot be read, or is not such a record (.VT2 and .DT2
            files hold velocities and displacements), an unknown unit, or one that the
            header contradicts.
    """
    check_unit("read_at2", unit)
    file = Lines("read_at2", path)
    for i, line in enumerate(file.lines):
        if "NPTS" in line.upper():
            return _column(file, i, unit, "write NPTS= 2000, DT= .02 SEC")
    file.refuse(None, "has no line with NPTS and DT", "give an AT2 file")


def read_single_column(
    path: str | os.PathLike[str], unit: str | None = None
) -> Accelerogram:
    """Read a title, a line with count and step, and one sample after the other.

    Args:
        path: Text file.
        unit: Of the samples: "g", "m/s2", "cm/s2" or "mm/s2". None: what the header
            says, or else g.

    Returns:
        One component [m/s^2].

    Raises:
        FieldError: the file cannot be read, is not such a record, an unknown unit, or
            one that the header contradicts.
    """
    check_unit("read_single_column", unit)
    file = Lines("read_single_column", path)
    if len(file.lines) < 3:
        problem = "has no title, count and step, and samples"
        file.refuse(None, problem, "give a file of that form")
    return _column(file, 1, unit, "write for example 4684 0.0100")


def _column(file: Lines, at: int, unit: str | None, remedy: str) -> Accelerogram:
    """A record of one component behind the line with its count and step."""
    header = header_says(file, 0, at + 1)
    told = sample_unit(file, header, unit)
    size = counted(file, at, header)
    if size is None:
        file.refuse(at, "gives no count and step", remedy)
    samples = file.column(at + 1, size.samples)
    time = size.step * np.arange(size.samples)
    return Accelerogram(
        time, in_si(file, samples[:, None], told), ("",), _title(file, at)
    )


def _title(file: Lines, end: int) -> str:
    return " ".join(" ".join(file.lines[:end]).split())


def read_two_column(
    path: str | os.PathLike[str], unit: str | None = None
) -> Accelerogram:
    """Read rows of time and one to three accelerations, after any header lines.

    Args:
        path: Text file; columns separated by blanks, tabs, commas or semicolons. Times
            are in seconds where no header says another unit.
        unit: Of the accelerations: "g", "m/s2", "cm/s2" or "mm/s2". None: what the
            header says, or else g.

    Returns:
        One to three components [m/s^2].

    Raises:
        FieldError: the file cannot be read, is not such a record (gaps, unequal
            steps, columns that a header names otherwise: velocities, or the time
            behind them), an unknown unit, or one that the header contradicts.
    """
    check_unit("read_two_column", unit)
    file = Lines("read_two_column", path)
    places, rows = _rows(file)
    header = header_says(file, 0, places[0])
    told = sample_unit(file, header, unit)
    check_columns(file, header, len(rows[0]))
    _, seconds = time_unit(file, header)
    table = np.array(
        [file.numbers(row, i) for i, row in zip(places, rows, strict=True)]
    )
    seconds = seconds or "s"
    time, step = _equal_steps(file, places, rows, table[:, 0], seconds)
    factor = TIMES[seconds]
    _check_counted(file, header, len(rows), factor * step)
    return Accelerogram(
        factor * time,
        in_si(file, table[:, 1:], told),
        ("",) * (table.shape[1] - 1),
        _title(file, places[0]),
    )


def _rows(file: Lines) -> tuple[list[int], list[list[str]]]:
    """Line numbers and words of the rows behind the header."""
    places: list[int] = []
    rows: list[list[str]] = []
    above = (0, [""])
    for i, words in file.rest(0):
        if not rows and not all(NUMBER.match(word) for word in words):
            above = (i, words)  # a header
            continue
        if not 2 <= len(words) <= 4 or (rows and len(words) != len(rows[0])):
            wanted = len(rows[0]) if rows else "2 to 4"
            problem = f"holds {len(words)} columns, not {wanted}"
            file.refuse(i, problem, "give time and accelerations")
        rows.append(words)
        places.append(i)
    if len(rows) < 2:
        file.refuse(None, "holds no rows of time and acceleration", "give such a file")
    line, words = above
    # a spoilt first row is no header: it would be lost, and the clock shifted
    row_like = all(NUMBER.match(word) or _SPOILT.match(word) for word in words)
    if len(words) == len(rows[0]) and row_like:
        file.numbers(words, line)
    for column in range(len(rows[0])):
        file.check_end([row[column] for row in rows])
    return places, rows


def _resolution(words: list[str]) -> float:
    """Unit of the last place to which times are printed [unit of time]."""
    units: list[float] = []
    for word in words:
        digits, _, power = re.sub("[dD]", "e", word).lower().partition("e")
        # 0e999 is a number
        exponent = min(int(power or 0), 300)
        units.append(10.0 ** (exponent - len(digits.partition(".")[2])))
    # with powers the unit grows with the time; without, zeros may be left out
    return max(units) if any("e" in word.lower() for word in words) else min(units)


def _equal_steps(
    file: Lines, places: list[int], rows: list[list[str]], time: np.ndarray, unit: str
) -> tuple[np.ndarray, float]:
    """Equally spaced times for those of a column, and their step.

    Raises:
        FieldError: the times are off by more than their printing explains.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        gaps = np.diff(time)
        step = float(time[-1] / (len(time) - 1) - time[0] / (len(time) - 1))
        usual = float(np.median(gaps))
        equal = time[0] + step * np.arange(len(time))
        # half a unit of the last printed place, and the same of both ends; a rounding
        # shifts a step by a printed unit, a gap by a step
        slack = min(
            1.01 * _resolution([row[0] for row in rows]) + 1e-9 * abs(step),
            0.6 * abs(usual),
        )
        good = (np.abs(time - equal) <= slack).all()
        good &= (np.abs(gaps - usual) <= slack).all()
    falls = np.flatnonzero(gaps <= 0.0)
    if falls.size:
        row = int(falls[0]) + 1
        file.refuse(
            places[row],
            f"has the time {time[row]!s} {unit} after {time[row - 1]!s} {unit}",
            "sort the rows by time, and leave out repeated ones (of times that are "
            "rounded to the same number, write more digits)",
        )
    if not good:
        worst = int(np.argmax(np.abs(gaps - usual))) + 1
        file.refuse(
            places[worst],
            f"comes {time[worst] - time[worst - 1]:g} {unit} after the row before, and "
            f"the usual step is {usual:g} {unit}",
            "fill the gap, or resample the record to equal steps",
        )
    return equal, step


def _check_counted(file: Lines, header: Any, count: int, step: float) -> None:
    """Rows must be those that a line with NPTS and DT in the header counts, if any.

    By times printed to a tenth of a step, ten rows tell it to a hundredth.
    """
    for i in header:
        if "NPTS" not in file.lines[i].upper():
            continue
        size = counted(file, i, {i: header[i]})
        if size is None:
            continue
        if size.samples != count or abs(size.step - step) > 0.02 * step:
            problem = (
                f"says {size.samples} samples every {size.step:g} s, and {count} every "
                f"{step:g} s follow"
            )
            file.refuse(i, problem, "mend the header, or get the whole file")


def read_v2a(path: str | os.PathLike[str], unit: str | None = None) -> Accelerogram:
    """Read a corrected accelerogram of GeoNet (New Zealand), all its components.

    Args:
        path: V2A file: for each component 16 lines of text, 10 lines of numbers, and
            blocks of acceleration, velocity and displacement, of which the first is
            taken.
        unit: Of the accelerations: "g", "m/s2", "cm/s2" or "mm/s2". None: what the
            text says, or else mm/s2, as the format has it.

    Returns:
        Its components [m/s^2].

    Raises:
        FieldError: the file cannot be read, is not such a record or not a whole one,
            an unknown unit, or one that the text contradicts.
    """
    check_unit("read_v2a", unit)
    file = Lines("read_v2a", path)
    parts = v2a_components(file, unit)
    return Accelerogram(
        parts[0].step * np.arange(len(parts[0].samples)),
        np.stack([part.samples for part in parts], axis=1),
        tuple(part.name for part in parts),
        " ".join(next(line for line in file.lines if line.strip()).split()),
    )


def builtin_record(name: str) -> Accelerogram:
    """A record that comes with rollkane.

    Args:
        name: "eqsig-test-motion" (one component, 46.8 s) or "kaikoura-2016-wtmc"
            (Kaikoura 2016, station WTMC of GeoNet, New Zealand: N28W, S62W, Up;
            163.8 s, CC BY) [m/s^2]; see records/README.md for sources and licences.

    Raises:
        FieldError: another name.
    """
    check_name("builtin_record.name", name, _BUILTIN)
    return _BUILTIN[name](resources.files("rollkane") / "records")


def _eqsig(folder: Traversable) -> Accelerogram:
    with resources.as_file(folder / "eqsig-test-motion.txt") as path:
        return read_single_column(path, "g")


def _kaikoura(folder: Traversable) -> Accelerogram:
    text = gzip.decompress((folder / "kaikoura-2016-wtmc.txt.gz").read_bytes())
    title, names, *rows = text.decode("ascii").splitlines()
    table = np.array([row.split() for row in rows], float) * UNITS["mm/s2"]
    return Accelerogram(
        0.02 * np.arange(len(table)), table, tuple(names.split()), title
    )


_BUILTIN: dict[str, Callable[[Traversable], Accelerogram]] = {
    "eqsig-test-motion": _eqsig,
    "kaikoura-2016-wtmc": _kaikoura,
}
