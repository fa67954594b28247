"""What the header of a record settles: the unit of its samples, its count and step.

What the header says and what the caller says must agree. Where neither says anything,
the format's usual unit holds, unless the header mentions another one beside a number.
"""

import re
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from ..validation.checks import FieldError
from .accelerogram_lines import Lines
from .accelerogram_units import TIMES, UNITS, Said, said

_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eEdD][-+]?\d+)?"
# what stands behind a step: the rest of a number that is none (1,02), or one word
_BEHIND = r"(?P<behind>,\d[^\s;]*|[^\s,;]+|\s*[(\[]?\s*[A-Za-zµμ]*)"
# NPTS= 2000, DT= .02000 SEC
_COUNT = re.compile(r"\bNPTS?\s*[=:]\s*([^\s,;]+)", re.IGNORECASE)
_STEP = re.compile(
    rf"\bDT\s*(?:[(\[][^)\]]*[)\]]\s*)?[=:]\s*(?P<step>{_NUMBER}){_BEHIND}",
    re.IGNORECASE,
)
# 2000 .02000 NPTS, DT
_PLAIN = re.compile(
    rf"\s*(?P<count>{_NUMBER})\s*(?:,|;|\s)\s*(?P<step>{_NUMBER}){_BEHIND}",
    re.IGNORECASE,
)
_RATE = re.compile(r"\bSPS\b|\bHZ\b|\bSAMPLES?\s*(?:/|PER)\s*S", re.IGNORECASE)
_NO_UNIT = ("", "npts", "npt", "points", "pts", "dt")
_WORDS = re.compile(r"[A-Za-zµμ]+$")
_BY_NAME = {".vt2": "velocities", ".dt2": "displacements"}
_OF_OTHERS = "give the record of accelerations (.AT2 of PEER), or mend the line"


class Counted(NamedTuple):
    """Count and step as a line of a header gives them.

    Attributes:
        samples: How many there are.
        step: [s].
    """

    samples: int
    step: float


def check_name(field: str, name: Any, known: Mapping[str, Any]) -> None:
    """Refuse what is not a text among the known ones.

    Raises:
        FieldError: also for values that are no text, which cannot even be looked up.
    """
    if not (isinstance(name, str) and name in known):
        remedy = f"use one of: {', '.join(known)}"
        raise FieldError(field, name, "is not known", remedy)


def check_unit(reader: str, unit: Any) -> None:
    """Refuse what is neither None nor a known unit of acceleration.

    Raises:
        FieldError: it is.
    """
    if unit is not None:
        check_name(f"{reader}.unit", unit, UNITS)


def header_says(file: Lines, start: int, end: int) -> dict[int, Said]:
    """What each line of a header says, by its number."""
    return {i: said(file.lines[i]) for i in range(start, end)}


def sample_unit(
    file: Lines, header: Mapping[int, Said], unit: str | None, usual: str = "g"
) -> str:
    """The unit of the samples, of those in UNITS.

    Args:
        file: The file.
        header: What its lines say.
        unit: What the caller says; None for nothing.
        usual: Unit of the format, where neither says anything.

    Raises:
        FieldError: the header says something else than accelerations in one known
            unit, or than the caller.
    """
    _check_kinds(file, header)
    line, told = _said_unit(file, header)
    suffix = file.path[-4:].lower()
    if suffix in _BY_NAME:
        problem = f"is a file of {_BY_NAME[suffix]} by its name"
        file.refuse(None, problem, "give the .AT2 file, of accelerations")
    if told is None:
        if unit is None:
            _check_mentions(file, header, usual)
        return unit or usual
    if unit not in (None, told):
        raise FieldError(
            f"{file.reader}.unit",
            unit,
            f"is not the unit that {file.path}, line {line + 1} names, which is "
            f"{told}: {file.lines[line].strip()!r}",
            "leave out the unit, or mend the line",
        )
    return told


def _check_kinds(file: Lines, header: Mapping[int, Said]) -> None:
    """Refuse velocities and displacements.

    A line that names a quantity with its unit, or as a time history, decides; a word
    elsewhere only where no line does.
    """
    others = {"velocity", "displacement"}
    declares = {
        i: says.kinds
        for i, says in header.items()
        if says.kinds and (says.units or _is_title(file.lines[i]))
    }
    accelerations = [i for i, kinds in declares.items() if "acceleration" in kinds]
    judged = declares if accelerations else {i: s.kinds for i, s in header.items()}
    for i, kinds in judged.items():
        for kind in sorted(others & kinds):
            file.refuse(i, f"names a {kind}, and accelerations are read", _OF_OTHERS)


def _is_title(line: str) -> bool:
    return re.search(r"TIME\s*(HISTORY|SERIES)", line, re.IGNORECASE) is not None


def _said_unit(file: Lines, header: Mapping[int, Said]) -> tuple[int, str | None]:
    """The one unit that a header says, and where; None for no unit."""
    line, told = 0, None
    for i, says in header.items():
        for kind, unit in says.units:
            if kind in ("velocity", "displacement"):
                problem = f"names {unit}, a unit of {kind}, and accelerations are read"
                file.refuse(i, problem, _OF_OTHERS)
            if unit not in UNITS:
                remedy = f"convert the record to one of: {', '.join(UNITS)}"
                file.refuse(i, f"names the unit {unit!r}, which is not known", remedy)
            if told not in (None, unit):
                problem = f"names the unit {unit}, and line {line + 1} names {told}"
                file.refuse(i, problem, "mend the one that is wrong")
            line, told = i, unit
    return line, told


def _check_mentions(file: Lines, header: Mapping[int, Said], usual: str) -> None:
    for i, says in header.items():
        for kind, unit in says.mentions:
            if kind not in ("velocity", "displacement") and unit != usual:
                file.refuse(
                    i,
                    f"mentions {unit} and no line says the unit of the samples, which "
                    f"is usually {usual}",
                    "say it by the argument unit",
                )


def in_si(file: Lines, samples: np.ndarray, unit: str) -> np.ndarray:
    """Samples of a unit in m/s^2.

    Raises:
        FieldError: one of them is too large for a number.
    """
    with np.errstate(over="ignore"):
        scaled = samples * UNITS[unit]
    if not np.isfinite(scaled).all():
        file.refuse(None, "holds a sample that is too large", "mend the sample")
    return scaled


def time_unit(file: Lines, header: Mapping[int, Said]) -> tuple[int, str | None]:
    """The one unit of time that a header says, and where; None for no unit."""
    line, told = 0, None
    for i, says in header.items():
        for unit in says.times:
            if unit not in TIMES:
                problem = f"counts time in {unit!r}, which is not read"
                file.refuse(i, problem, "give times in seconds")
            if told is not None and TIMES[told] != TIMES[unit]:
                problem = f"counts time in {unit}, and line {line + 1} in {told}"
                file.refuse(i, problem, "mend the one that is wrong")
            line, told = i, unit
    return line, told


def counted(file: Lines, line: int, header: Mapping[int, Said]) -> Counted | None:
    """Count and step by a line; None where it gives none.

    Args:
        file: The file.
        line: Such as ``NPTS= 2000, DT= 20.0 MSEC`` or ``2000 .0200 NPTS, DT``.
        header: What the lines of the header say, with their units of time.

    Raises:
        FieldError: the count is not whole, the step has no known unit of time, or
            less than two samples or no positive step.
    """
    text = file.lines[line]
    count, step = _COUNT.search(text), _STEP.search(text)
    if count is not None and step is not None:
        number = count[1]
    else:
        step = _PLAIN.match(text)
        if step is None or re.search(r"\bDT\b.*NPTS", text, re.IGNORECASE):
            return None
        number = step["count"]
        if _RATE.search(text) and not re.search(r"\bDT\b", text, re.IGNORECASE):
            problem, remedy = "gives a rate, not a step", "write the step in seconds"
            file.refuse(line, problem, remedy)
    samples = file.whole(number, line)
    (value,) = file.numbers([step["step"]], line)
    value *= TIMES[_step_unit(file, line, step["behind"], header)]
    if not (samples >= 2 and value > 0 and np.isfinite(value * samples)):
        problem = "needs two samples or more and a positive step"
        file.refuse(line, problem, "mend it")
    return Counted(samples, value)


def _step_unit(file: Lines, line: int, behind: str, header: Mapping[int, Said]) -> str:
    """Unit of time of a step, by the word behind it or by the header."""
    word = behind.strip("()[]. \t")
    if word and not _WORDS.match(word):
        problem = f"has a step that goes on with {word!r}"
        file.refuse(line, problem, "write a number and a unit of time: .02 SEC")
    own = word.lower()
    if own not in TIMES and own not in _NO_UNIT:
        problem = f"has a step in {word!r}, which is no known unit of time"
        file.refuse(line, problem, "write SEC or MSEC, or no unit for seconds")
    where, told = time_unit(file, header)
    if own in _NO_UNIT:
        return told or "s"
    if told is not None and TIMES[told] != TIMES[own]:
        problem = f"has a step in {word}, and line {where + 1} names {told}"
        file.refuse(line, problem, "mend the one that is wrong")
    return own
