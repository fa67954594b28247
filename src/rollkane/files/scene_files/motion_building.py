"""Motions of the base and carried masses, from their tables."""

from pathlib import Path as FilePath
from typing import Any, cast

from ...dynamics.supported import AbstractSupported, Prescribed
from ...kinematics.base_motion import AbstractBaseMotion, BaseMotion, Spin
from ...kinematics.recorded_motion import RecordedMotion
from ...validation.checks import FieldError
from ..accelerograms import (
    Accelerogram,
    builtin_record,
    read_at2,
    read_single_column,
    read_two_column,
    read_v2a,
)
from .checking import likely_kind
from .construction import attempt, made_from, noting, product_of_turns, usable
from .formulas import (
    CONSTANTS,
    FUNCTIONS,
    ArrayFormula,
    ForceFormula,
    Formula,
    FormulaError,
    TurnsFormula,
    is_name,
    parse,
)
from .moving_tables import MOTIONS, SUPPORTED, FunctionsTable, RecordTable, SpinTable
from .positions import Given, Path, given_at
from .problems import Report

_MOTION: Path = ("base", "motion")
_READERS = {
    "at2": read_at2,
    "single-column": read_single_column,
    "two-column": read_two_column,
    "v2a": read_v2a,
}


def checked_formulas(
    path: Path,
    texts: list[tuple[Path, Any]],
    coordinates: tuple[str, ...],
    report: Report,
) -> Formula:
    """Formulas of one table as a function; zeros where one of them cannot be read.

    Args:
        path: The table; its ``parameters`` may be named in the formulas.
        texts: Where each formula stands, and what stands there.
        coordinates: Names that stand for coordinates.
        report: Takes the problems.
    """
    given: Given = report.value(path).get("parameters", {})
    parameters = tuple(given) if isinstance(given, dict) else ()
    for name in parameters:
        taken = name in (*coordinates, *FUNCTIONS, *CONSTANTS)
        if taken or not is_name(name):
            problem = "is taken already" if taken else "is not a name for a formula"
            remedy = "use another name of letters, digits and _"
            report.add((*path, "parameters", name), problem, remedy, at_key=True)
    for where, text in texts:
        if not isinstance(text, str):
            continue
        try:
            parse(text, coordinates, parameters)
        except FormulaError as error:
            report.add(where, error.problem, error.remedy, shift=error.shift)
    if report.has_below(path):
        return Formula(("0",) * max(len(texts), 1), coordinates)
    return Formula(tuple(text for _, text in texts), coordinates, parameters)


def motion_of(report: Report) -> AbstractBaseMotion | None:
    """The base's motion; None for none, or where something was wrong with it."""
    table: Given = given_at(report.document, _MOTION)
    if not isinstance(table, dict):
        return None
    kind = likely_kind(table, MOTIONS)
    if kind == "spin":
        return _spin(table, report)
    if kind == "functions":
        return _functions(table, report)
    return _record(table, report) if kind == "record" else None


def _spin(table: dict[str, Any], report: Report) -> Spin | None:
    if "orientation" in table and "rotations" in table:
        problem = "says the same as rotations"
        remedy = "leave out rotations or orientation"
        report.add((*_MOTION, "orientation"), problem, remedy, at_key=True)
    given = usable(_MOTION, ("orientation", "rotations"), report)
    if "rotations" in given:
        given["orientation"] = product_of_turns(given.pop("rotations"))
    return made_from(_MOTION, SpinTable, report, **given)


def _listed(path: Path, name: str, table: dict[str, Any]) -> list[tuple[Path, Any]]:
    """Places and texts of a list of formulas, also of rows of them."""
    found: list[tuple[Path, Any]] = []
    for i, entry in enumerate(_entries(table, name)):
        if isinstance(entry, list):
            found += [((*path, name, i, j), text) for j, text in enumerate(entry)]
        else:
            found.append(((*path, name, i), entry))
    return found


def _entries(table: dict[str, Any], name: str) -> list[list[Any] | str]:
    """Of a list; of anything else, which has been noted, none."""
    given: Given = table.get(name)
    return cast(list[list[Any] | str], given) if isinstance(given, list) else []


def _turns(
    path: Path, table: dict[str, Any], coordinates: tuple[str, ...], report: Report
) -> TurnsFormula:
    given = _entries(table, "rotations")
    turns = [turn for turn in given if isinstance(turn, list)]
    texts = [
        ((*path, "rotations", i, 1), turn[1] if len(turn) > 1 else None)
        for i, turn in enumerate(turns)
    ]
    formula = checked_formulas(path, texts, coordinates, report)
    axes = () if report.has_below(path) else tuple(turn[0] for turn in turns)
    return TurnsFormula(axes, formula)


def _functions(table: dict[str, Any], report: Report) -> BaseMotion | None:
    arguments: dict[str, Any] = {}
    if "position" in table:
        texts = _listed(_MOTION, "position", table)
        arguments["position"] = checked_formulas(_MOTION, texts, ("t",), report)
    if "rotations" in table:
        arguments["rotation"] = _turns(_MOTION, table, ("t",), report)
    if report.has_below(_MOTION):
        return None
    if table.get("parameters"):
        arguments["parameters"] = table["parameters"]
    return made_from(_MOTION, FunctionsTable, report, **arguments)


def _record(table: dict[str, Any], report: Report) -> RecordedMotion | None:
    given = ("record" in table) + ("file" in table)
    if given != 1:
        problem = "says the same as record" if given else "is missing"
        where = (*_MOTION, "file" if given else "record")
        remedy = "give either record = ... or file = ..."
        report.add(where, problem, remedy, at_key=bool(given))
    for name in ("format", "unit") if given == 1 and "record" in table else ():
        if name in table and not report.has_below((*_MOTION, name)):
            problem = "is of a file, and a built-in record has its own"
            report.add((*_MOTION, name), problem, f"leave out {name}", at_key=True)
    if report.has_below(_MOTION):
        return None
    asked = RecordTable.model_validate(table)
    record = _read(asked, report)
    if record is None:
        return None
    axes = asked.axes[: record.acceleration.shape[1]]
    if len(set(axes)) < len(axes) or not axes:
        report.add((*_MOTION, "axes"), "must name each axis once", "list x, y and z")
        return None
    if "axes" in table and len(axes) < len(asked.axes):
        problem = f"names {len(asked.axes)} axes for {len(axes)} components"
        report.add((*_MOTION, "axes"), problem, "leave out the last")
        return None
    columns = [
        asked.scale * record.acceleration[:, axes.index(axis)]
        if axis in axes
        else 0.0 * record.acceleration[:, 0]
        for axis in ("x", "y", "z")
    ]
    arguments = {
        "time": record.time,
        "acceleration": list(zip(*columns, strict=True)),
        "start_velocity": asked.start_velocity,
        "start_position": asked.start_position,
    }
    note = noting(_MOTION, tuple(table), report)
    return attempt(RecordedMotion, arguments, note, {})


def _read(asked: RecordTable, report: Report) -> Accelerogram | None:
    """The record, and of it the window."""
    source = "record" if asked.record is not None else "file"
    try:
        if asked.record is not None:
            record = builtin_record(asked.record)
        else:
            path = FilePath(report.file).parent / str(asked.file)
            record = _READERS[asked.format](path, asked.unit)
        source = "window"
        return record if asked.window is None else record.window(*asked.window)
    except FieldError as error:
        source = "unit" if error.field.endswith(".unit") else source
        report.add((*_MOTION, source), error.problem, error.remedy)
        return None


def supported_of(report: Report) -> tuple[AbstractSupported, ...] | None:
    """What the body carries; None where something was wrong with it."""
    given: Given = report.document.get("supported")
    parts: list[AbstractSupported | None] = []
    tables: list[Given] = given if isinstance(given, list) else []
    for i, table in enumerate(tables):
        if not isinstance(table, dict):
            continue
        kind = likely_kind(table, SUPPORTED)
        if kind is not None:
            parts.append(_part(("supported", i), kind, table, report))
    if report.has_below(("supported",)):
        return None
    return tuple(cast(list[AbstractSupported], parts))  # what is None has been noted


def _part(
    path: Path, kind: str, table: dict[str, Any], report: Report
) -> AbstractSupported | None:
    _check_names(path, table, report)
    if report.has_below(path):
        return None
    names = tuple(table["coordinates"])
    _check_counts(path, kind, table, len(names), report)
    texts = _listed(path, "position", table)
    position = checked_formulas(path, texts, names, report)
    arguments: dict[str, Any] = {"coordinates": len(names)}
    shape = (len(table["position"]), 3) if kind == "point-masses" else (3,)
    arguments["position"] = ArrayFormula(position, shape)
    if kind == "point-masses":
        arguments["mass"] = table["mass"]
    else:
        arguments["rotation"] = _turns(path, table, names, report)
    if "force" in table:
        rates = tuple(f"{name}_dot" for name in names)
        texts = _listed(path, "force", table)
        formula = checked_formulas(path, texts, ("t", *names, *rates), report)
        arguments["force"] = ForceFormula(formula)
    if "potential" in table:
        texts = [((*path, "potential"), table["potential"])]
        formula = checked_formulas(path, texts, names, report)
        arguments["potential"] = ArrayFormula(formula, ())
    motion = None
    if "motion" in table:
        texts = _listed(path, "motion", table)
        motion = ArrayFormula(
            checked_formulas(path, texts, ("t",), report), (len(names),)
        )
    if report.has_below(path):
        return None
    if table.get("parameters"):
        arguments["parameters"] = table["parameters"]
    part = made_from(path, SUPPORTED[kind], report, **arguments)
    if part is None or motion is None:
        return part
    return Prescribed(part, motion, table.get("parameters") or None)


def _check_names(path: Path, table: dict[str, Any], report: Report) -> None:
    """Names of coordinates must be names, each once, and free."""
    names: Given = table.get("coordinates")
    taken = {"t", *FUNCTIONS, *CONSTANTS}
    for i, name in enumerate(names if isinstance(names, list) else ()):
        if not isinstance(name, str):
            continue
        good = is_name(name)
        if not good or name in taken:
            problem = "is taken already" if good else "is not a name for a formula"
            remedy = "use another name of letters, digits and _"
            report.add((*path, "coordinates", i), problem, remedy)
        taken |= {name, f"{name}_dot"}


def _check_counts(
    path: Path, kind: str, table: dict[str, Any], count: int, report: Report
) -> None:
    """Lists of formulas must have an entry for each mass or each coordinate."""
    wanted = {"force": count, "motion": count}
    if kind == "point-masses":
        wanted["position"] = len(table["mass"])
    for name, number in wanted.items():
        if name in table and len(table[name]) != number:
            each = "mass" if name == "position" else "coordinate"
            report.add(
                (*path, name),
                f"must have {number} entries, not {len(table[name])}",
                f"give one for each {each}",
            )
