"""Components of a V2A file (volume 2, corrected) of GeoNet, New Zealand.

For each component 16 lines of text, 10 lines of numbers, and blocks of acceleration,
velocity and displacement in fields of eight characters. All of it is read through, so
that a line that is missing anywhere, which would shift what follows, is noticed.
"""

import re
from typing import NamedTuple

import numpy as np

from .accelerogram_headers import header_says, in_si, sample_unit
from .accelerogram_lines import Lines
from .accelerogram_units import TIMES, Said

_TEXT, _NUMBERS, _WIDTH, _ACROSS = 16, 10, 8, 10
_NAME, _PEAK, _COUNTS, _STEP = 12, 13, 3, 6  # lines of the text, and of the numbers
_COMPONENTS = 3
_INTERVAL = re.compile(
    r"([\d.]+)\s*([a-z]+)\s+intervals|intervals\s+of\s+([\d.]+)\s*([a-z]+)",
    re.IGNORECASE,
)
_WHOLE = "get the whole file"


class Component(NamedTuple):
    """One component.

    Attributes:
        name: Of its direction.
        samples: [m/s^2].
        step: [s].
    """

    name: str
    samples: np.ndarray
    step: float


def v2a_components(file: Lines, unit: str | None) -> list[Component]:
    """All components of a file.

    Args:
        file: The file.
        unit: Of the samples; None: what the text says, or else mm/s2.

    Raises:
        FieldError: it is not such a file, or not a whole one.
    """
    found: list[Component] = []
    at = _next_text(file, 0)
    while at < len(file.lines):
        component, end = _component(file, at, unit)
        found.append(component)
        at = _next_text(file, end)
    if not found:
        file.refuse(None, "is empty", "give a V2A file")
    if len({(len(part.samples), part.step) for part in found}) > 1:
        problem = "has components of different lengths or steps"
        file.refuse(None, problem, _WHOLE)
    # three, the vertical one last; files of fewer that end with it are whole, too
    vertical = re.match(r"(up|down|vert|z)", found[-1].name, re.IGNORECASE)
    if len(found) > _COMPONENTS or (len(found) < _COMPONENTS and vertical is None):
        names = ", ".join(part.name for part in found)
        problem = f"holds the components {names}, and a V2A file has three"
        file.refuse(None, problem, _WHOLE)
    return found


def _next_text(file: Lines, line: int) -> int:
    """The next line that is not blank; the number of lines where none is left."""
    while line < len(file.lines) and not file.lines[line].strip():
        line += 1
    return line


def _component(file: Lines, at: int, unit: str | None) -> tuple[Component, int]:
    """The component whose text begins at a line, and the line behind it."""
    head = at + _TEXT
    start = head + _NUMBERS
    if len(file.lines) < start:
        file.refuse(at, "begins a component that is cut off", _WHOLE)
    name = re.match(r"Component\s+(\S+)", file.lines[at + _NAME])
    if name is None:
        remedy = "give a V2A file (volume 2, corrected)"
        file.refuse(at + _NAME, "does not name a component", remedy)
    told = sample_unit(file, _text_says(file, at), unit, usual="mm/s2")
    counts = [
        file.whole(word, head + _COUNTS) for word in _fields(file, head + _COUNTS, 3, 6)
    ]
    (word,) = _fields(file, head + _STEP, 5, 6)
    (step,) = file.numbers([word], head + _STEP)
    if not (counts[0] >= 2 and step > 0 and min(counts) >= 0):
        problem = "needs two samples of acceleration or more and a positive step"
        file.refuse(head + (_COUNTS if step > 0 else _STEP), problem, "mend it")
    _check_text(file, at, counts[0], step)
    blocks: list[list[float]] = []
    for count in counts:
        block, start = _block(file, start, count)
        blocks.append(block)
    samples = in_si(file, np.array(blocks[0]), told)
    return Component(name[1], samples, step), start


def _text_says(file: Lines, at: int) -> dict[int, Said]:
    """What the text says of the acceleration; its peak tells the unit.

    The lines behind that are of the velocity and the displacement.
    """
    says = header_says(file, at, at + _PEAK + 1)
    peak = says[at + _PEAK]
    says[at + _PEAK] = peak._replace(
        units=tuple(dict.fromkeys((*peak.units, *peak.mentions))), mentions=()
    )
    return says


def _check_text(file: Lines, at: int, count: int, step: float) -> None:
    """Count and interval must be those of the text, where it gives them."""
    for i in range(at, at + _TEXT):
        text = file.lines[i]
        points = re.match(r"Number of points\s+(\S+)", text, re.IGNORECASE)
        if points is not None and file.whole(points[1], i) != count:
            problem = f"says {points[1]} points, and the numbers below say {count}"
            file.refuse(i, problem, _WHOLE)
        interval = _INTERVAL.search(text)
        if interval is None:
            continue
        word, unit = (part for part in interval.groups() if part is not None)
        if unit.lower() not in TIMES:
            problem = f"has intervals in {unit!r}, which is no known unit of time"
            file.refuse(i, problem, "give intervals in seconds")
        (value,) = file.numbers([word], i)
        place = 10.0 ** -len(word.partition(".")[2])
        factor = TIMES[unit.lower()]
        # half a unit of the place to which the text prints it, and of the fourth
        # place of the numbers
        slack = 0.51 * (factor * place + 1e-4)
        if abs(factor * value - step) > slack:
            problem = f"has intervals of {word} {unit}, and the step below is {step:g}"
            file.refuse(i, problem, "mend the one that is wrong")


def _block(file: Lines, start: int, count: int) -> tuple[list[float], int]:
    """A block of samples, ten a line, and the line behind it."""
    values: list[float] = []
    end = start - (-count // _ACROSS)
    for i in range(start, end):
        wanted = min(_ACROSS, count - len(values))
        if i >= len(file.lines):
            file.refuse(None, f"ends too early, at line {i}", _WHOLE)
        words = _words(file, i)
        if len(words) != wanted:
            problem = f"holds {len(words)} numbers, and by its count {wanted} are due"
            file.refuse(i, problem, _WHOLE)
        values += file.numbers(words, i)
    return values, end


def _words(file: Lines, line: int) -> list[str]:
    """Fields of eight characters, which may touch."""
    text = file.lines[line].rstrip()
    if len(text) % _WIDTH:
        problem = "is cut off, or not in fields of eight characters"
        file.refuse(line, problem, _WHOLE)
    return [text[i : i + _WIDTH].strip() for i in range(0, len(text), _WIDTH)]


def _fields(file: Lines, line: int, first: int, end: int) -> list[str]:
    """Some of the fields of a line of the numbers."""
    words = _words(file, line)
    if len(words) < end:
        problem = f"holds {len(words)} numbers, and {end} are needed"
        file.refuse(line, problem, _WHOLE)
    return words[first:end]
