"""Make a part of a scene, and note at its field whatever its constructor refuses.

A stand-in takes a refused field's place and the constructor is asked again, so that
all bad fields of all parts are known at once.
"""

import math
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np
from pydantic.fields import FieldInfo

from ...geometry.numpy_rotations import product
from ...validation.checks import FieldError
from .derived_tables import DerivedTable
from .positions import Path
from .problems import Report

# Where a default, or a one, would not do: a tube above any radius, so that the other
# is judged alone; a friction that any other may go with.
_STAND_INS = {
    "major_radius": 1e30,
    "minor_radius": 1e-30,
    "inertia": np.eye(3),
    "friction": 0.0,
}
Note = Callable[[str, FieldError], None]


def attempt(
    make: Callable[..., Any],
    arguments: dict[str, Any],
    note: Note,
    stand_ins: Mapping[str, Any],
) -> Any:
    """What ``make`` makes, or None after noting each argument that it refuses."""
    refused: set[str] = set()
    while True:
        try:
            made = make(**arguments)
        except FieldError as error:
            name = error.field.partition(".")[2]
            note(name, error)
            if name in refused or name not in stand_ins:
                return None
            refused.add(name)
            arguments = arguments | {name: stand_ins[name]}
        else:
            return None if refused else made


def made_from(
    path: Path, table: type[DerivedTable], report: Report, **others: Any
) -> Any:
    """What a table's constructor makes; None after noting what it refuses.

    The good fields are judged even where others are known to be bad.

    Args:
        path: Where the table stands.
        table: What it is held against.
        report: Takes the problems.
        others: Arguments that the file does not give as they are.
    """
    given, fields = report.value(path), table.model_fields
    stand_ins = {
        name: _STAND_INS.get(name, _unobjectionable(fields[name]))
        for name in table.arguments
    }
    arguments = others | {
        name: given[name] if good else stand_ins[name]
        for name in table.arguments
        if (good := name in given and not report.has_below((*path, name)))
        or fields[name].is_required()
    }
    note = noting(path, given, report)
    made = attempt(table.made_by(), arguments, note, stand_ins)
    return None if report.has_below(path) else made


def _unobjectionable(field: FieldInfo) -> Any:
    """A value that no constructor refuses: the default, or one, or three ones."""
    if not field.is_required():
        return field.default
    return 1.0 if field.annotation is float else (1.0, 1.0, 1.0)


def noting(path: Path, fields: Any, report: Report) -> Note:
    """Note a refusal at its field, or at the part where the part has no such field."""

    def note(name: str, error: FieldError) -> None:
        where = (*path, name) if name in fields else path
        problem = error.problem
        if where == path and name:
            problem = f"{name} {problem}"
        report.add(where, problem, error.remedy)

    return note


def usable(path: Path, names: Iterable[str], report: Report) -> dict[str, Any]:
    """The fields of a table that are given, and of the right type."""
    table = report.value(path)
    good = (name for name in names if not report.has_below((*path, name)))
    return {name: table[name] for name in good if name in table}


def product_of_turns(turns: list[tuple[str, float]]) -> np.ndarray:
    """Quaternion of turns about x, y or z [degrees], matrices left to right."""
    whole = np.array([1.0, 0.0, 0.0, 0.0])
    for axis, degrees in turns:
        half = 0.5 * math.radians(degrees)
        along = np.eye(3)["xyz".index(axis)]
        whole = product(whole, [math.cos(half), *(math.sin(half) * along)])
    return whole
