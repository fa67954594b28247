"""Check the tables of a scene file: every wrong name, type and shape at once."""

import copy
import re
from collections.abc import Iterator
from typing import Any

from pydantic import ValidationError

from ..scene_file_limits import MOST_PARTS
from .positions import Given, Path, given_at
from .problems import Report, dotted, nearest, suggestion
from .tables import SURFACES, SceneTable, kinds_at, table_at

_PAIRS = (("orientation", "rotations"), ("angular_velocity", "angular_velocity_body"))
_TABLES = (
    "body",
    "base",
    "surface",
    "on",
    "motion",
    "contact",
    "modes",
    "start",
    "run",
)
_WANTED = {
    "float_type": "must be a number",
    "int_type": "must be a whole number",
    "string_type": "must be text",
    "bool_type": "must be true or false",
    "finite_number": "must be finite",
    "list_type": "must be a list",
    "tuple_type": "must be a list",
    "dict_type": "must be a table",
    "model_type": "must be a table",
    "model_attributes_type": "must be a table",
    "greater_than": "must be positive",
}


def check_document(document: dict[str, Any], report: Report) -> None:
    """Note everything that is wrong with names, types and shapes.

    Args:
        document: The file's tables, as ``tomllib`` gives them.
        report: Takes the problems.

    Raises:
        SceneFileError: so much is wrong that it is not worth going on.
    """
    _refuse_too_many(document, report)
    for path, error in _errors(document):
        _note(path, error, document, report)
    # errors behind an unknown kind: read the table as the kind that was likely meant
    likely = _with_likely_kinds(document)
    if likely is not None:
        for path, error in _errors(likely):
            _note(path, error, likely, report)
    start: Given = document.get("start")
    if isinstance(start, dict):
        for pair in _PAIRS:
            _check_pair(start, pair, report)
    if report.is_full:  # what is wrong but not noted would be made
        report.raise_if_any()


def _refuse_too_many(document: dict[str, Any], report: Report) -> None:
    """Refuse lists of more parts than can be checked and made in a moment."""
    for name in ("loads", "supported", "events"):
        parts: Given = document.get(name)
        if isinstance(parts, list) and len(parts) > MOST_PARTS:
            problem = f"must have {MOST_PARTS} entries at most, not {len(parts)}"
            remedy = "put parts that act alike together, or build the scene in Python"
            report.add((name,), problem, remedy, at_key=True)
            report.raise_if_any()


def _errors(document: dict[str, Any]) -> Iterator[tuple[Path, Any]]:
    try:
        SceneTable.model_validate(document)
    except ValidationError as failure:
        for error in failure.errors(include_url=False):
            yield _without_tags(error["loc"]), error


def _without_tags(location: tuple[str | int, ...]) -> Path:
    """The path without the kind that pydantic writes into it behind a table's name."""
    path: Path = ()
    for step in location:
        kinds = kinds_at(path)
        if kinds is None or step not in kinds:
            path = (*path, step)
    return path


def _note(path: Path, error: Any, document: dict[str, Any], report: Report) -> None:
    kind, context = error["type"], error.get("ctx", {})
    remedy = f"give {_meaning(path, document)}"
    if kind == "missing":
        _note_missing(path, report, remedy)
    elif kind == "extra_forbidden":
        owner = table_at(path[:-1], _kind_of(path[:-1], document))
        known = owner.model_fields if owner is not None else ()
        remedy = suggestion(str(path[-1]), known)
        report.add(path, "is an unknown name", remedy, at_key=True)
    elif kind == "union_tag_not_found":
        known = ", ".join(kinds_at(path) or ())
        report.add((*path, "kind"), "is missing", f"add kind = ..., one of: {known}")
    elif kind == "union_tag_invalid":
        tag = _kind_of(path, document)
        remedy = suggestion(tag if isinstance(tag, str) else "", kinds_at(path) or ())
        report.add((*path, "kind"), "is not a known kind", remedy)
    elif kind in ("too_short", "too_long"):
        wanted = context.get("min_length", context.get("max_length"))
        found = context["actual_length"]
        report.add(path, f"must have {wanted} entries, not {found}", remedy)
    elif kind == "literal_error":
        choices = re.findall(r"[^', ]+(?=')|-?\d+", context["expected"])
        remedy = suggestion(str(error["input"]), choices)
        noun = "kind" if path[-1] == "kind" else "name"
        problem = f"is not a known {noun}"
        if choices[0].lstrip("-").isdigit():
            problem, remedy = (
                "is none of its values",
                f"use one of: {', '.join(choices)}",
            )
        report.add(path, problem, remedy)
    elif kind == "less_than_equal":
        report.add(path, f"must be {context['le']} or less", remedy)
    elif kind == "greater_than_equal":
        report.add(path, f"must be {context['ge']} or more", remedy)
    else:
        report.add(path, str(_WANTED.get(kind, error["msg"])), remedy)


def _note_missing(path: Path, report: Report, remedy: str) -> None:
    if isinstance(path[-1], int):  # an entry of a pair that is too short
        report.add(path[:-1], "must have 2 entries", remedy)
        return
    is_table = path[-1] in _TABLES
    add = f"add [{dotted(path)}]" if is_table else f"add {path[-1]} = ..."
    report.add(path, "is missing", f"{add}: {remedy.removeprefix('give ')}")


def _kind_of(path: Path, document: dict[str, Any]) -> Any:
    table: Given = given_at(document, path)
    return table.get("kind") if isinstance(table, dict) else None


def _meaning(path: Path, document: dict[str, Any]) -> str:
    """What the field at a path, or the one that holds it, stands for."""
    for end in range(len(path), 0, -1):
        owner, name = path[: end - 1], str(path[end - 1])
        table = table_at(owner, _kind_of(owner, document))
        field = table.model_fields.get(name) if table is not None else None
        if field is not None and field.description:
            return field.description
    return "what `rollkane schema` says"


def likely_kind(table: dict[str, Any], known_kinds: Any = SURFACES) -> str | None:
    """The kind of a table; the likely one where it names none that is known.

    Args:
        table: A table, such as a surface's, with or without a good ``kind``.
        known_kinds: Kind to model, for what may stand there.

    Returns:
        The known kind that looks most like its ``kind``, or else the only kind with
        all its names, or None.
    """
    kind = table.get("kind")
    if isinstance(kind, str) and kind in known_kinds:
        return kind
    names = set(table) - {"kind"}
    fitting = [
        known
        for known, model in known_kinds.items()
        if names <= set(model.model_fields)
    ]
    return nearest(kind, known_kinds) or (fitting[0] if len(fitting) == 1 else None)


def _with_likely_kinds(document: dict[str, Any]) -> dict[str, Any] | None:
    """The document with likely kinds for unknown ones; None if all are known."""
    changed = copy.deepcopy(document)
    paths: list[Path] = [("body", "surface"), ("base", "surface"), ("base", "motion")]
    paths.append(("contact",))
    for name in ("supported", "loads"):
        parts: Given = document.get(name)
        count = len(parts) if isinstance(parts, list) else 0
        paths += [(name, i) for i in range(count)]
    rolling: Given = document.get("rolling")
    for i in range(len(rolling) if isinstance(rolling, list) else 0):
        paths += [("rolling", i, "on"), ("rolling", i, "body", "surface")]
    for path in paths:
        table: Given = given_at(changed, path)
        likely = likely_kind(table, kinds_at(path)) if isinstance(table, dict) else None
        if isinstance(table, dict) and likely:
            table["kind"] = likely
    return None if changed == document else changed


def _check_pair(start: dict[str, Any], pair: tuple[str, str], report: Report) -> None:
    given = [name for name in pair if name in start]
    if not given:
        remedy = f"add {pair[0]} = ... or {pair[1]} = ..."
        report.add(("start", pair[0]), "is missing", remedy)
    elif len(given) == 2:
        report.add(
            ("start", pair[1]),
            f"says the same as {pair[0]}",
            f"leave out {pair[0]} or {pair[1]}",
            at_key=True,
        )
