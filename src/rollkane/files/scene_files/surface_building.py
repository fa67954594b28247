"""From checked tables to surfaces, and to bodies with them."""

from typing import Any

from ...dynamics.bodies import Body
from ...geometry.surfaces import AbstractSurface, Sphere
from .checking import likely_kind
from .construction import made_from, usable
from .formulas import Formula
from .motion_building import checked_formulas
from .positions import Given, Path, given_at
from .problems import Report
from .tables import SURFACES, BodyTable

# kind -> (argument of its constructor, fields with formulas, coordinates)
_BY_FORMULA = {
    "graph": ("f", ("f",), ("x", "y")),
    "revolution": ("profile", ("radius", "height"), ("s",)),
    "parametric": ("position", ("x", "y", "z"), ("q1", "q2")),
    "implicit": ("f", ("f",), ("x", "y", "z")),
}


def body_of(path: Path, report: Report) -> Body | None:
    """The body of a table; None where something was wrong with it.

    Args:
        path: Where the table stands.
        report: Takes the problems.
    """
    surface = surface_of((*path, "surface"), report)
    if not isinstance(given_at(report.document, path), dict):
        return None
    surface = Sphere(1.0) if surface is None else surface
    return made_from(path, BodyTable, report, surface=surface)


def surface_of(path: Path, report: Report) -> AbstractSurface | None:
    """The surface of a table; None where something was wrong with it.

    Args:
        path: Where the table stands.
        report: Takes the problems.
    """
    table: Given = given_at(report.document, path)
    if not isinstance(table, dict):
        return None
    kind = likely_kind(table)
    if kind is None:
        return None
    others: dict[str, Any] = {}
    if kind in _BY_FORMULA:
        argument, texts, coordinates = _BY_FORMULA[kind]
        others = usable(path, ("domain",), report)
        others[argument] = formula = _formula(path, texts, coordinates, report)
        if formula.parameters:
            others["parameters"] = table["parameters"]
    return made_from(path, SURFACES[kind], report, **others)


def _formula(
    path: Path, fields: tuple[str, ...], coordinates: tuple[str, ...], report: Report
) -> Formula:
    """The formulas of a surface; zero where one of them cannot be read."""
    table = report.value(path)
    where = [((*path, field), table.get(field)) for field in fields]
    return checked_formulas(path, where, coordinates, report)
