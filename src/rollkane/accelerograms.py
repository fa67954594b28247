"""Recorded ground accelerations: readers of the usual files, and built-in records."""

import gzip
import os
import re
from collections.abc import Callable, Iterator
from importlib import resources
from pathlib import Path
from typing import NamedTuple, NoReturn

import numpy as np

from .checks import FieldError

STANDARD_GRAVITY = 9.80665  # m/s^2, by which records "in g" are scaled
_UNITS = {"g": STANDARD_GRAVITY, "m/s2": 1.0, "cm/s2": 1e-2, "mm/s2": 1e-3}
_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eEdD][-+]?\d+)?$")
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
            FieldError: less than two samples in it.
        """
        slack = 1e-6 * (self.time[1] - self.time[0])
        inside = (self.time >= start - slack) & (self.time <= end + slack)
        if np.count_nonzero(inside) < 2 or end > self.time[-1] + slack:
            raise FieldError(
                "Accelerogram.window",
                [start, end],
                f"is not within the record, {self.time[0]:g} to {self.time[-1]:g} s",
                "give a start and an end within it, the start first",
            )
        time = self.time[inside]
        return self._replace(
            time=time - time[0], acceleration=self.acceleration[inside]
        )


class _Lines:
    """The lines of a file, and how to refuse what is in them."""

    def __init__(self, reader: str, path: str | os.PathLike[str]):
        self.reader, self.path = reader, str(path)
        try:
            raw = Path(path).read_bytes()
        except OSError as error:
            self.refuse(None, f"cannot be read: {error.strerror}", "give a file's path")
        if b"\0" in raw:
            self.refuse(None, "holds binary data", "give the text file of the record")
        self.lines = raw.decode("latin-1").splitlines()

    def refuse(self, line: int | None, problem: str, remedy: str) -> NoReturn:
        """Raise, naming the file and the line (counted from 0; None for the whole)."""
        where = "" if line is None else f", line {line + 1}"
        value = self.path
        if line is not None and line < len(getattr(self, "lines", ())):
            value = self.lines[line].strip()
        raise FieldError(
            f"{self.reader}.path", value, f"{self.path}{where}: {problem}", remedy
        )

    def numbers(self, words: list[str], line: int) -> list[float]:
        """Words of a line as finite numbers."""
        found = []
        for word in words:
            if not _NUMBER.match(word):
                self.refuse(line, f"holds {word!r}, not a number", "mend the line")
            found.append(float(word.replace("D", "E").replace("d", "e")))
        return found

    def rest(self, start: int) -> Iterator[tuple[int, list[str]]]:
        """Words of every line that is not empty, from a line on."""
        for i in range(start, len(self.lines)):
            words = re.split(r"[\s,;]+", self.lines[i].strip())
            if words != [""]:
                yield i, words

    def column(self, start: int, count: int) -> np.ndarray:
        """All numbers from a line on; as many as the file's header says."""
        values: list[float] = []
        for i, words in self.rest(start):
            values += self.numbers(words, i)
        if len(values) != count:
            problem = f"holds {len(values)} samples, and its header says {count}"
            self.refuse(None, problem, "mend the header, or get the whole file")
        return np.array(values)


_COUNTS = (
    re.compile(r"NPTS\s*=\s*(\d+)\s*,?\s*DT\s*=\s*([\d.EeDd+-]+)", re.IGNORECASE),
    re.compile(r"^\s*(\d+)\s+([\d.EeDd+-]+)\s.*NPTS", re.IGNORECASE),
)


def read_at2(path: str | os.PathLike[str]) -> Accelerogram:
    """Read a record in the AT2 form of the PEER data base, in units of g.

    Args:
        path: Text file: header lines, ``NPTS= 2000, DT= .02000 SEC`` (or the older
            ``2000 .0200 NPTS, DT``), then the samples.

    Returns:
        One component [m/s^2].

    Raises:
        FieldError: the file cannot be read, or is not such a record.
    """
    file = _Lines("read_at2", path)
    for i, line in enumerate(file.lines):
        if "NPTS" not in line.upper():
            continue
        named = re.search(
            r"NPTS\s*=\s*(\d+)\s*,?\s*DT\s*=\s*([\d.EeDd+-]+)", line, re.I
        )
        plain = re.match(r"\s*(\d+)\s+([\d.EeDd+-]+)\s.*NPTS", line, re.I)
        found = named or plain
        if found is None:
            file.refuse(i, "gives no count and step", "write NPTS= 2000, DT= .02 SEC")
        (step,) = file.numbers([found[2]], i)
        return _equal(file, i, i + 1, int(found[1]), step, "g")
    file.refuse(None, "has no line with NPTS and DT", "give an AT2 file")


def read_single_column(path: str | os.PathLike[str], unit: str = "g") -> Accelerogram:
    """Read a title, a line with count and step, and one sample after the other.

    Args:
        path: Text file.
        unit: Of the samples: "g", "m/s2", "cm/s2" or "mm/s2".

    Returns:
        One component [m/s^2].

    Raises:
        FieldError: the file cannot be read, is not such a record, or an unknown unit.
    """
    _check_unit("read_single_column", unit)
    file = _Lines("read_single_column", path)
    if len(file.lines) < 3:
        problem = "has no title, count and step, and samples"
        file.refuse(None, problem, "give a file of that form")
    words = file.lines[1].replace(",", " ").split()
    if len(words) < 2:
        file.refuse(1, "gives no count and step", "write for example 4684 0.0100")
    count, step = file.numbers(words[:2], 1)
    return _equal(file, 1, 2, int(count), step, unit)


def _equal(file: _Lines, at: int, start: int, count: int, step: float, unit: str):
    """A record of one component by its count and step."""
    if not (count >= 2 and step > 0):
        file.refuse(at, "needs two samples or more and a positive step", "mend it")
    samples = file.column(start, count) * _UNITS[unit]
    title = " ".join(" ".join(file.lines[:at]).split())
    return Accelerogram(step * np.arange(count), samples[:, None], ("",), title)


def read_two_column(path: str | os.PathLike[str], unit: str = "g") -> Accelerogram:
    """Read rows of time and one to three accelerations, after any header lines.

    Args:
        path: Text file; columns separated by blanks, tabs, commas or semicolons.
        unit: Of the accelerations: "g", "m/s2", "cm/s2" or "mm/s2".

    Returns:
        One to three components [m/s^2].

    Raises:
        FieldError: the file cannot be read, is not such a record (gaps, unequal
            steps), or an unknown unit.
    """
    _check_unit("read_two_column", unit)
    file = _Lines("read_two_column", path)
    rows, places, printed = [], [], 0
    for i, words in file.rest(0):
        if not rows and not all(_NUMBER.match(word) for word in words):
            continue  # a header
        if not 2 <= len(words) <= 4 or (rows and len(words) != len(rows[0])):
            wanted = len(rows[0]) if rows else "2 to 4"
            problem = f"holds {len(words)} columns, not {wanted}"
            file.refuse(i, problem, "give time and accelerations")
        rows.append(file.numbers(words, i))
        places.append(i)
        printed = max(printed, len(words[0].partition(".")[2]))
    if len(rows) < 2:
        file.refuse(None, "holds no rows of time and acceleration", "give such a file")
    table = np.array(rows)
    time = table[:, 0]
    step = (time[-1] - time[0]) / (len(time) - 1)
    usual = float(np.median(np.diff(time)))
    # half a unit of the last printed place, and the same of both ends
    slack = 1.01 * 10.0**-printed + 1e-9 * abs(step)
    off = np.abs(time - (time[0] + step * np.arange(len(time)))) > slack
    # a rounding shifts a step by a printed unit, a gap by a step
    uneven = np.abs(np.diff(time) - usual) > min(slack, 0.6 * abs(usual))
    if usual <= 0 or np.any(off) or np.any(uneven):
        worst = int(np.argmax(np.abs(np.diff(time) - usual))) + 1
        file.refuse(
            places[worst],
            f"comes {time[worst] - time[worst - 1]:g} s after the row before, and the "
            f"usual step is {usual:g} s",
            "fill the gap, or resample the record to equal steps",
        )
    return Accelerogram(
        time[0] + step * np.arange(len(time)),
        table[:, 1:] * _UNITS[unit],
        ("",) * (table.shape[1] - 1),
        " ".join(" ".join(file.lines[: places[0]]).split()),
    )


_V2A_TEXT, _V2A_NUMBERS, _V2A_WIDTH = 16, 10, 8


def read_v2a(path: str | os.PathLike[str]) -> Accelerogram:
    """Read a corrected accelerogram of GeoNet (New Zealand), all its components.

    Args:
        path: V2A file: for each component 16 lines of text, 10 lines of numbers, and
            blocks of acceleration [mm/s^2], velocity and displacement, of which the
            first is read.

    Raises:
        FieldError: the file cannot be read, or is not such a record.
    """
    file = _Lines("read_v2a", path)
    names, columns, steps, at = [], [], [], 0
    while at < len(file.lines) and file.lines[at].strip():
        head = at + _V2A_TEXT
        if len(file.lines) < head + _V2A_NUMBERS:
            file.refuse(at, "begins a component that is cut off", "get the whole file")
        name = re.match(r"Component\s+(\S+)", file.lines[at + 12])
        if name is None:
            remedy = "give a V2A file (volume 2, corrected)"
            file.refuse(at + 12, "does not name a component", remedy)
        counts = [
            int(file.numbers([word], head + 3)[0])
            for word in file.lines[head + 3].split()[3:6]
        ]
        step = float(_fields(file, head + 6)[5])
        blocks = [-(-count // 10) for count in counts]
        start = head + _V2A_NUMBERS
        samples: list[float] = []
        for i in range(start, start + blocks[0]):
            samples += _fields(file, i)
        if len(samples) != counts[0] or not step > 0:
            problem = f"holds {len(samples)} samples, and its header says {counts[0]}"
            file.refuse(at, problem, "get the whole file")
        names.append(name[1])
        columns.append(samples)
        steps.append((len(samples), step))
        at = start + sum(blocks)
    if not columns:
        file.refuse(None, "is empty", "give a V2A file")
    if len(set(steps)) > 1:
        problem = "has components of different lengths or steps"
        file.refuse(None, problem, "get the whole file")
    count, step = steps[0]
    title = " ".join(file.lines[0].split())
    acceleration = np.array(columns).T * _UNITS["mm/s2"]
    return Accelerogram(step * np.arange(count), acceleration, tuple(names), title)


def _fields(file: _Lines, line: int) -> list[float]:
    """Numbers of a line in fields of eight characters, which may touch."""
    if line >= len(file.lines):
        file.refuse(None, "ends too early", "get the whole file")
    text = file.lines[line].rstrip()
    words = [text[i : i + _V2A_WIDTH].strip() for i in range(0, len(text), _V2A_WIDTH)]
    return file.numbers([word for word in words if word], line)


def builtin_record(name: str) -> Accelerogram:
    """A record that comes with rollkane.

    Args:
        name: "eqsig-test-motion" (one component, 46.8 s) or "kaikoura-2016-wtmc"
            (Kaikoura 2016, station WTMC of GeoNet, New Zealand: N28W, S62W, Up;
            163.8 s, CC BY) [m/s^2]; see records/README.md for sources and licences.

    Raises:
        FieldError: another name.
    """
    read = _BUILTIN.get(name)
    if read is None:
        raise FieldError(
            "builtin_record.name", name, "is not known", f"use one of {BUILTIN_RECORDS}"
        )
    return read(resources.files("rollkane") / "records")


def _eqsig(folder) -> Accelerogram:
    with resources.as_file(folder / "eqsig-test-motion.txt") as path:
        return read_single_column(path, "g")


def _kaikoura(folder) -> Accelerogram:
    text = gzip.decompress((folder / "kaikoura-2016-wtmc.txt.gz").read_bytes())
    title, names, *rows = text.decode("ascii").splitlines()
    table = np.array([row.split() for row in rows], float) * _UNITS["mm/s2"]
    return Accelerogram(
        0.02 * np.arange(len(table)), table, tuple(names.split()), title
    )


_BUILTIN: dict[str, Callable] = {
    "eqsig-test-motion": _eqsig,
    "kaikoura-2016-wtmc": _kaikoura,
}


def _check_unit(reader: str, unit: str) -> None:
    if unit not in _UNITS:
        known = ", ".join(_UNITS)
        raise FieldError(f"{reader}.unit", unit, "is not known", f"use one of: {known}")
