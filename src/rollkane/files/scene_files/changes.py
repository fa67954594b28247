"""Numbers of a scene file that are given otherwise than the file gives them."""

import re
import tomllib
from collections.abc import Iterable, Mapping
from typing import Any, cast

from .positions import Path
from .problems import Report, dotted

_PART = re.compile(r"\.?([A-Za-z_][A-Za-z_0-9-]*)|\[(\d+)\]")


def change(report: Report, changes: Mapping[str, str]) -> None:
    """Put values into the tables of a file.

    What cannot be put is noted as the file's problems are.

    Args:
        report: Of the file; its tables are changed.
        changes: Value by path (``"body.mass"``, ``"loads[0].acceleration"``,
            ``"start.angular_velocity[2]"``), as TOML writes it; a bare word is text.
    """
    lost = undone(changes)
    if lost is not None:
        problem = f"{lost[0]} is given again by {lost[1]}, which would undo it"
        report.add((), problem, "give each once, the whole before its entries")
        return
    for path, text in changes.items():
        keys = _keys(path)
        if not keys:
            remedy = "write for example body.mass=2.0 or start.angular_velocity[2]=5"
            report.add((), f"{path!r} is no path of a field", remedy)
            continue
        owner = _owner(report, keys)
        if owner is not None:
            owner[keys[-1]] = _value(text)


def undone(given: Iterable[str]) -> tuple[str, str] | None:
    """The first of some paths that a later one puts a value over, and that later one.

    An entry behind the whole of its list changes that; the whole behind an entry, or
    the same path again, however it is spelled, leaves nothing of what was given first.

    Args:
        given: Paths, in the order in which their values are put.

    Returns:
        Both as they are spelled, or None where every value stays.
    """
    before: list[tuple[str, Path]] = []
    for path in given:
        keys = _keys(path)
        for other, its in before:
            if keys and its[: len(keys)] == keys:
                return other, path
        before.append((path, keys))
    return None


def same_field(path: str, keys: Path) -> bool:
    """Whether a path, however it is spelled, is that of a field."""
    return _keys(path) == keys


def _keys(path: str) -> Path:
    keys: list[str | int] = []
    at = 0
    while at < len(path):
        part = _PART.match(path, at)
        if part is None:
            return ()
        keys.append(int(part[2]) if part[2] else part[1])
        at = part.end()
    is_path = keys and isinstance(keys[0], str) and not path.startswith(".")
    return tuple(keys) if is_path else ()


def _owner(report: Report, keys: Path) -> Any:
    """The table or list that a path ends in; tables that are not there are made."""
    found: Any = report.document
    for i, key in enumerate(keys):
        problem = remedy = ""
        if isinstance(key, int):
            if not isinstance(found, list) or key >= len(cast("list[Any]", found)):
                problem = f"{dotted(keys[: i + 1])} is not there to be changed"
                remedy = "give the whole list, or another index"
        elif not isinstance(found, dict):
            problem = f"{dotted(keys[:i])} is no table that holds {key}"
            remedy = "give the path of a field"
        if problem:
            report.add(keys[:i], problem, remedy)
            return None
        if i == len(keys) - 1:
            break
        inner: Any = cast(Any, found)
        if isinstance(key, str):
            inner.setdefault(key, {})
        found = inner[key]
    return cast(Any, found)


def _value(text: str) -> Any:
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except ValueError:  # not TOML, or of more digits than Python reads
        return text
