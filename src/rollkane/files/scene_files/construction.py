"""Make a part of a scene, and note at its field whatever its constructor refuses.

A stand-in takes a refused field's place and the constructor is asked again, so that
all bad fields of all parts are known at once.
"""

import math
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from ...validation.checks import FieldError
from .positions import Path
from .problems import Report

# Unobjectionable values for fields that were refused.
STAND_INS = {
    "mass": 1.0,
    "center_of_mass": (0.0, 0.0, 0.0),
    "inertia": np.eye(3),
    "radius": 1.0,
    "center": (0.0, 0.0, 0.0),
    "semi_axes": (1.0, 1.0, 1.0),
    "major_radius": 1e30,  # above any tube, so that the tube is judged alone
    "minor_radius": 1e-30,
    "slope": 1.0,
    "size": 1.0,
    "acceleration": (0.0, 0.0, 0.0),
    "linear": 0.0,
    "quadratic": 0.0,
    "angular": 0.0,
    "viscous": 0.0,
    "dry": 0.0,
    "regularization": 1.0,
    "coefficient": 0.0,
    "static": 0.0,
    "kinetic": 0.0,
    "speed": 1.0,
    "friction": 0.0,
    "static_friction": 0.0,
    "restitution": 0.0,
    "rest_speed": 1.0,
    "rate": 1.0,
    "start_velocity": (0.0, 0.0, 0.0),
    "start_position": (0.0, 0.0, 0.0),
}


Note = Callable[[str, FieldError], None]


def attempt(
    make: Callable[..., Any],
    arguments: dict[str, Any],
    note: Note,
    stand_ins: dict[str, Any] | None = None,
) -> Any:
    """What ``make`` makes, or None after noting each argument that it refuses."""
    stand_ins = STAND_INS if stand_ins is None else stand_ins
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


def noting(path: Path, fields: Any, report: Report) -> Note:
    """Note a refusal at its field, or at the part where the part has no such field."""

    def note(name: str, error: FieldError) -> None:
        where = (*path, name) if name in fields else path
        problem = error.problem
        if where == path and name:
            problem = f"{name} {problem}"
        report.add(where, problem, error.remedy)

    return note


def usable(
    path: Path, names: Iterable[str], required: Iterable[str], report: Report
) -> dict[str, Any]:
    """The fields of a table that are of the right type; stand-ins for required ones.

    So the good fields of a table are judged even where others are known to be bad.
    """
    table = report.value(path)
    given = {
        name: table[name]
        for name in names
        if name in table and not report.has_below((*path, name))
    }
    return {name: STAND_INS[name] for name in required} | given


def product_of_turns(turns: list[tuple[str, float]]) -> np.ndarray:
    """Quaternion of turns about x, y or z [degrees], matrices left to right."""
    a, v = 1.0, np.zeros(3)
    for axis, degrees in turns:
        half = 0.5 * math.radians(degrees)
        b, w = math.cos(half), math.sin(half) * np.eye(3)["xyz".index(axis)]
        a, v = a * b - v @ w, a * w + b * v + np.cross(v, w)
    return np.array([a, *v])
