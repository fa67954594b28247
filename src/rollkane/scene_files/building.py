"""From checked tables to a scene and its start, with every refusal put in its place.

Each part is made by its own constructor. What a constructor refuses is noted at the
field of the file, a stand-in takes that field's place, and the constructor is asked
again, so that all bad fields of all parts are known at once.
"""

import functools
import math
from collections.abc import Callable, Iterable
from typing import Any

import jax.numpy as jnp
import numpy as np

from ..bodies import Body
from ..checks import FieldError
from ..coordinates import State
from ..loads import Gravity
from ..placement import place
from ..scene import Base, Scene
from ..surfaces import (
    AbstractSurface,
    Cone,
    Cylinder,
    DiscEdge,
    Ellipsoid,
    Graph,
    Implicit,
    Parametric,
    Plane,
    Revolution,
    Sphere,
    Torus,
)
from .checking import likely_kind
from .formulas import CONSTANTS, FUNCTIONS, Formula, FormulaError, parse
from .positions import Path
from .problems import Report
from .tables import SURFACES, StartTable

_CATALOGUE = {
    "plane": Plane,
    "sphere": Sphere,
    "ellipsoid": Ellipsoid,
    "torus": Torus,
    "cylinder": Cylinder,
    "cone": Cone,
    "disc-edge": DiscEdge,
}
# kind -> (constructor, its argument, fields with formulas, coordinates)
_BY_FORMULA = {
    "graph": (Graph, "f", ("f",), ("x", "y")),
    "revolution": (Revolution, "profile", ("radius", "height"), ("s",)),
    "parametric": (Parametric, "position", ("x", "y", "z"), ("q1", "q2")),
    "implicit": (Implicit, "f", ("f",), ("x", "y", "z")),
}
# Unobjectionable values for fields that were refused.
_STAND_INS = {
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
}

_UNTURNED = (1.0, 0.0, 0.0, 0.0)

Note = Callable[[str, FieldError], None]


def build(report: Report) -> tuple[Scene, State] | None:
    """Make what a file describes, and note what the library refuses.

    Args:
        report: Knows the file, its checked tables and what is wrong with it.

    Returns:
        The scene and its start, or None where something was wrong.
    """
    body = _body(report)
    base = _base(report)
    loads = _loads(report)
    _check_tolerance(report)
    scene = None
    if body is not None and base is not None and loads is not None:
        scene = Scene(body, base, loads=loads)
    start = _start(scene, report)
    if scene is None or start is None:
        return None
    return scene, start


def _attempt(
    make: Callable[..., Any],
    arguments: dict[str, Any],
    note: Note,
    stand_ins: dict[str, Any] | None = None,
) -> Any:
    """What ``make`` makes, or None after noting each argument that it refuses."""
    stand_ins = _STAND_INS if stand_ins is None else stand_ins
    refused = set()
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


def _noting(path: Path, fields: Any, report: Report) -> Note:
    """Note a refusal at its field, or at the part where the part has no such field."""

    def note(name: str, error: FieldError) -> None:
        where = (*path, name) if name in fields else path
        problem = error.problem
        if where == path and name:
            problem = f"{name} {problem}"
        report.add(where, problem, error.remedy)

    return note


def _usable(
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
    return {name: _STAND_INS[name] for name in required} | given


def _body(report: Report) -> Body | None:
    surface = _surface(("body", "surface"), report)
    if not isinstance(report.document.get("body"), dict):
        return None
    numbers = ("mass", "center_of_mass", "inertia")
    arguments = _usable(("body",), numbers, ("mass", "inertia"), report)
    arguments["surface"] = Sphere(1.0) if surface is None else surface
    body = _attempt(Body, arguments, _noting(("body",), numbers, report))
    return None if report.has_below(("body",)) else body


def _base(report: Report) -> Base | None:
    if "base" not in report.document:
        return Base()
    surface = _surface(("base", "surface"), report)
    return None if report.has_below(("base",)) or surface is None else Base(surface)


def _loads(report: Report) -> tuple[Gravity, ...] | None:
    given = report.document.get("loads")
    if given is None:
        return (Gravity(),)
    loads = []
    for i, table in enumerate(given if isinstance(given, list) else ()):
        path = ("loads", i)
        if isinstance(table, dict):
            arguments = _usable(path, ("acceleration",), (), report)
            loads.append(_attempt(Gravity, arguments, _noting(path, arguments, report)))
    return None if report.has_below(("loads",)) else tuple(loads)


def _surface(path: Path, report: Report) -> AbstractSurface | None:
    owner = report.document.get(path[0])
    table = owner.get(path[1]) if isinstance(owner, dict) else None
    if not isinstance(table, dict):
        return None
    kind = likely_kind(table)
    if kind is None:
        return None
    fields = SURFACES[kind].model_fields
    required = {name for name, field in fields.items() if field.is_required()}
    if kind in _CATALOGUE:
        make = _CATALOGUE[kind]
        arguments = _usable(path, set(fields) - {"kind"}, required - {"kind"}, report)
    else:
        make, argument, texts, coordinates = _BY_FORMULA[kind]
        names = set(fields) - {"kind", "parameters", *texts}
        arguments = _usable(path, names, (), report)
        formula = _formula(path, texts, coordinates, report)
        arguments[argument] = formula
        if formula.parameters:
            arguments["parameters"] = table["parameters"]
    surface = _attempt(make, arguments, _noting(path, tuple(fields), report))
    return None if report.has_below(path) else surface


def _formula(
    path: Path, fields: tuple[str, ...], coordinates: tuple[str, ...], report: Report
) -> Formula:
    """The formulas of a surface; zero where one of them cannot be read."""
    table = report.value(path)
    given = table.get("parameters", {})
    parameters = tuple(given) if isinstance(given, dict) else ()
    for name in parameters:
        taken = name in (*coordinates, *FUNCTIONS, *CONSTANTS)
        if taken or not (name.isidentifier() and name.isascii()):
            problem = "is taken already" if taken else "is not a name for a formula"
            remedy = "use another name of letters, digits and _"
            report.add((*path, "parameters", name), problem, remedy, at_key=True)
    for field in fields:
        if not isinstance(table.get(field), str):
            continue
        try:
            parse(table[field], coordinates, parameters)
        except FormulaError as error:
            where = (*path, field)
            report.add(where, error.problem, error.remedy, shift=error.shift)
    if report.has_below(path):
        return Formula(("0",) * len(fields), coordinates)
    return Formula(tuple(table[field] for field in fields), coordinates, parameters)


def _check_tolerance(report: Report) -> None:
    run = report.document.get("run")
    if not isinstance(run, dict) or "rtol" not in run:
        return
    dtype = jnp.result_type(float)
    least = 10 * float(jnp.finfo(dtype).eps)
    if not report.has_below(("run", "rtol")) and run["rtol"] < least:
        problem = f"is below what {dtype} can hold"
        report.add(("run", "rtol"), problem, f"give {least:.1g} or more")


def _start(scene: Scene | None, report: Report) -> State | None:
    if not isinstance(report.document.get("start"), dict):
        return None
    given = _usable(("start",), StartTable.model_fields, (), report)
    if "rotations" in given:
        orientation = _product(given["rotations"])
    else:
        orientation = given.get("orientation", _UNTURNED)
    velocity = given.get("angular_velocity", (0.0, 0.0, 0.0))
    if "angular_velocity_body" in given:
        velocity = _rotated(orientation, given["angular_velocity_body"])
    arguments = {
        "orientation": orientation,
        "angular_velocity": velocity,
        "contact_on_base": given.get("contact_on_base", (0.0, 0.0, 0.0)),
        "base_normal": given.get("base_normal"),
    }
    where = None if report.has_below(("start",)) else scene
    if where is None:  # some part is missing: judge at least what needs no scene
        where = Scene(Body(1.0, np.eye(3), Sphere(1.0)))
        scene = None
        arguments |= {"contact_on_base": (0.0, 0.0, 0.0), "base_normal": None}

    def note(name: str, error: FieldError) -> None:
        # a refusal by the base's surface itself is one of the contact point
        field = name if name in arguments else "contact_on_base"
        if field == "orientation" and "rotations" in given:
            field = "rotations"
        report.add(("start", field), error.problem, error.remedy)

    start = _attempt(
        functools.partial(place, where),
        arguments,
        note,
        {"orientation": _unit(orientation)},
    )
    return None if scene is None else start


def _product(turns: list[tuple[str, float]]) -> np.ndarray:
    """Quaternion of turns about x, y or z [degrees], matrices left to right."""
    a, v = 1.0, np.zeros(3)
    for axis, degrees in turns:
        half = 0.5 * math.radians(degrees)
        b, w = math.cos(half), math.sin(half) * np.eye(3)["xyz".index(axis)]
        a, v = a * b - v @ w, a * w + b * v + np.cross(v, w)
    return np.array([a, *v])


def _rotated(quaternion: Any, vector: Any) -> np.ndarray:
    """Body components [any unit] in the fixed axes, for a quaternion of any length."""
    a, *v = quaternion
    square = max(float(np.dot(quaternion, quaternion)), 1e-300)  # refused later if zero
    turn = 2.0 * np.cross(v, vector) / square
    return np.asarray(vector) + a * turn + np.cross(v, turn)


def _unit(quaternion: Any) -> np.ndarray:
    length = float(np.linalg.norm(quaternion))
    if length == 0.0:
        return np.array(_UNTURNED)
    return np.asarray(quaternion) / length
