"""What a header says of the columns: the time first, and nothing but accelerations.

Only a line that has a cell for each column is a line of names, and only what it names
plainly is judged: headers are full of prose that names nothing.
"""

import re
from collections.abc import Mapping

from .accelerogram_lines import Lines
from .accelerogram_units import TIMES, Said, said

_SINGLE = re.compile(r"[avdu][xyz\d]?$")
_REMEDY = "leave only the time and accelerations"
_ORDER = "put the time [s] into the first column, and accelerations behind it"
# between cells, not within the brackets of a unit
_APART = re.compile(r"\s*[;,|\t]+\s*(?![^(\[{]*[)\]}])")
_UNIT = re.compile(r"\s*[(\[{]([^)\]}]*)[)\]}]?|(?<=\w)\s*/\s*(.+)$")
_TIME = re.compile(
    rf"(?:(?:elapsed|relative)\s)?(?:t|times?)(?:[\s_.]*(?:{'|'.join(TIMES)}))?\.?$"
)
_ACCELERATION = re.compile(r"(?:a|a[xyz\d]|acc(?:el\w*)?[xyz\d]?)(?![^\W\d_])")
# numbers of rows, and what spectra go by
_NO_TIME = re.compile(
    r"(?:(?:sample|point|row|data)\s)?"
    r"(?:i|k|n|id|no|nr|num|number|count|index|idx|samples?|points?|rows?|steps?)\.?$"
    r"|period|freq(?:uency)?$"
)
_DIRECTION = re.compile(
    r"(?:[a-z]\d?|ns|sn|ew|we|ud|du|ver\w*|hor\w*|long\w*|trans\w*|rad|radial|up|down"
    r"|north|south|east|west|comp\w*|ch\w*|n?\d+[a-z]*|[ns]\d+[ew])$"
)
_OTHER_UNITS = ("rad", "deg", "°", "hz", "kn", "pa", "kpa", "mpa", "°c", "k", "%")


def check_columns(file: Lines, header: Mapping[int, Said], columns: int) -> None:
    """Refuse columns in another order, and of what is no acceleration, by their names.

    Args:
        file: The file.
        header: What its lines say.
        columns: How many there are.

    Raises:
        FieldError: a line names another first column than the time, or one behind it
            that holds no accelerations.
    """
    for i, says in header.items():
        cells = _cells(file.lines[i], columns)
        if cells:
            _check_order(file, i, cells)
        names = re.split(r"[\s,;|]+", file.lines[i].lower().strip("#| \t"))
        if len(names) < 2 or not re.match(r"t(ime)?\b", names[0]):
            continue
        # single letters a, v, d, u are names, too
        single = all(_SINGLE.match(name) for name in names[1:])
        others = single and any(name[0] != "a" for name in names[1:])
        if others or says.kinds - {"acceleration"}:
            file.refuse(i, "names columns that are not accelerations", _REMEDY)
        if cells and _is_time(cells[0]):
            _check_others(file, i, cells[1:])


def _cells(line: str, columns: int) -> list[str]:
    """Names of all columns, with their units; none where a line does not name them.

    Between blanks words may be prose: there each has to be such a name.
    """
    text = line.strip("# \t").rstrip(",;|")
    cells = _APART.split(text)
    if len(cells) == 1:
        cells = re.sub(r"\s+(?=[(\[{])", "", text).split()
        known = _is_time, _is_acceleration, _is_direction, _is_no_time
        if not all(any(is_one(cell) for is_one in known) for cell in cells):
            return []
    return cells if len(cells) == columns else []


def _check_order(file: Lines, line: int, cells: list[str]) -> None:
    first = cells[0]
    if _is_time(first):
        return
    times = [k for k, cell in enumerate(cells) if _is_time(cell)]
    if times:
        place = times[0]
        problem = (
            f"names the time, {cells[place]!r}, as column {place + 1}, not the first"
        )
        file.refuse(line, problem, _ORDER)
    if _is_no_time(first) and any(_is_acceleration(cell) for cell in cells[1:]):
        problem = f"names {first!r} as the first column, which is no time"
        file.refuse(line, problem, _ORDER)


def _check_others(file: Lines, line: int, cells: list[str]) -> None:
    """Refuse units of something else, and other names beside those of accelerations."""
    named = any(_is_acceleration(cell) for cell in cells)
    for cell in cells:
        if _is_acceleration(cell) or _is_direction(cell):
            continue
        unit = _unit(cell)
        if named or unit in _OTHER_UNITS or "/" in unit:
            problem = f"names a column {cell!r}, which is no acceleration"
            file.refuse(line, problem, _REMEDY)


def _name(cell: str) -> str:
    """A name without its unit."""
    return _UNIT.sub("", cell).strip("'\" ").lower()


def _unit(cell: str) -> str:
    found = _UNIT.search(cell)
    return (found[1] or found[2] or "").strip().lower() if found else ""


def _is_time(cell: str) -> bool:
    return _TIME.match(_name(cell)) is not None


def _is_no_time(cell: str) -> bool:
    return _NO_TIME.match(_name(cell)) is not None


def _is_acceleration(cell: str) -> bool:
    says = said(cell)
    kinds = {*says.kinds, *(kind for kind, _ in says.units)}
    return "acceleration" in kinds or _ACCELERATION.match(_name(cell)) is not None


def _is_direction(cell: str) -> bool:
    """Whether name and unit are directions: of the component."""
    words = re.split(r"[\s_\-/.]+", f"{_name(cell)} {_unit(cell)}".strip())
    return all(_DIRECTION.match(word) for word in words)
