"""Read a scene file: from a name or a path to a scene, its start and its run."""

import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from ..scene_file_limits import too_deep, too_long
from .changes import change
from .checking import check_document
from .positions import positions
from .problems import Problem, Report, SceneFileError, nearest
from .tables import RunTable

_TOO_DEEP = "is nested too deeply", "use fewer brackets"
_TOO_MANY_DIGITS = "holds a whole number of too many digits", "write it as 1e300"
_MANY_DIGITS = re.compile(r"[\d_]{1000,}")
_OF_A_RUN = "rtol", "atol", "method", "second_contact"
_AT = re.compile(r" \(at (?:line (\d+), column (\d+)|end of document)\)$")


@dataclass(frozen=True)
class SceneFile:
    """A scene with its start and its run, as a file describes them.

    Attributes:
        scene: A ``rollkane.Scene``: what rolls on what, under which loads.
        start: A ``rollkane.State``: how the motion starts.
        modes: ``rollkane.Modes``, or None: the contact never changes.
        times: Output times [s], shape (T,).
        rtol: Relative tolerance of a step [1], or None for the default.
        atol: Absolute tolerance of a step [unit of the state], or None.
        method: Which loop makes the run, as ``rollkane.simulate`` takes it.
        second_contact: Whether the run ends at a second contact with the base.
        events: ``rollkane.Event`` values that a run looks for.
        title: A line of text; the name where the file has none.
        description: Text; may be empty.
        axes: How the body axes lie, as text; may be empty.
        name: Name of the built-in scene, or of the file without its ending.
    """

    scene: Any
    start: Any
    modes: Any
    times: np.ndarray
    rtol: float | None
    atol: float | None
    method: str
    second_contact: bool
    events: tuple[Any, ...]
    title: str
    description: str
    axes: str
    name: str


def load_scene(
    source: str | PathLike[str],
    changes: Mapping[str, str] | None = None,
    parts: dict[Any, Any] | None = None,
) -> SceneFile:
    """Read a scene.

    Numbers take the precision that JAX is set to: double, if ``jax_enable_x64`` is on.

    Args:
        source: Name of a built-in scene (see :func:`builtin_scenes`), or path of a
            TOML file (see :func:`scene_schema`).
        changes: Values in the place of the file's, by path, as TOML writes them:
            ``{"body.mass": "2.0"}``.
        parts: Of the scenes that were read from the same file before: bases, supported
            masses and rolling bodies whose tables are the same are taken again, and
            others are put here. An empty dictionary to begin with.

    Returns:
        The scene, ready for ``rollkane.simulate``.

    Raises:
        SceneFileError: with everything that is wrong with the file: each problem with
            its line, column, field, value and remedy.
    """
    file, name, text = _read(source)
    report = Report(file, text)
    document = _parsed(report)
    change(report, changes or {})
    check_document(document, report)
    # needs JAX, which the listing of scenes and the schema should not wait for
    from .event_building import events_of
    from .run_checking import check_run_of
    from .scene_building import build

    made, events = build(report, parts), events_of(report)
    report.raise_if_any()
    assert made is not None  # whatever could not be made has been noted
    scene, start, modes = made
    run = RunTable.model_validate(document["run"])
    times = np.linspace(0.0, run.duration, run.outputs)
    how: dict[str, Any] = {name: getattr(run, name) for name in _OF_A_RUN}
    how |= {"modes": modes, "events": events}
    check_run_of(report, scene, start, times, how)
    report.raise_if_any()
    return SceneFile(
        scene=scene,
        start=start,
        times=times,
        **how,
        title=document.get("title") or name,
        description=document.get("description", ""),
        axes=document.get("axes", ""),
        name=name,
    )


def read_tables(source: str | PathLike[str]) -> Report:
    """The tables of any TOML file, with the places of their keys and values.

    Args:
        source: Its path.

    Raises:
        SceneFileError: it cannot be read, or is not TOML.
    """
    file, _, text = _read(source)
    report = Report(file, text)
    _parsed(report)
    return report


def scene_text(name: str) -> str:
    """Text of a built-in scene's file.

    Raises:
        SceneFileError: there is no such scene.
    """
    files = _builtin_files()
    if name not in files:
        missing = FileNotFoundError(name)
        raise SceneFileError([_unreadable(name, missing)])
    return files[name].read_text(encoding="utf-8")


def builtin_scenes() -> dict[str, str]:
    """Names of the scenes that come with rollkane, with the first line of each.

    Returns:
        Name to first line of the description, by name.
    """
    lines: dict[str, str] = {}
    for name, file in sorted(_builtin_files().items()):
        description = tomllib.loads(file.read_text(encoding="utf-8"))["description"]
        lines[name] = description.strip().split("\n")[0]
    return lines


def _builtin_files() -> dict[str, Any]:
    folder = resources.files("rollkane") / "scenes"
    return {
        file.name.removesuffix(".toml"): file
        for file in folder.iterdir()
        if file.name.endswith(".toml")
    }


def _read(source: str | PathLike[str]) -> tuple[str, str, str]:
    """Name for messages, name of the scene, and text."""
    if isinstance(source, str) and source in (builtin := _builtin_files()):
        text = builtin[source].read_text(encoding="utf-8")
        return f"{source}.toml", source, text
    path = Path(source)
    try:
        raw = path.read_bytes()
    except (OSError, ValueError) as error:  # the latter of a name with a NUL in it
        raise SceneFileError([_unreadable(source, error)]) from error
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = raw[: error.start].count(b"\n") + 1
        column = error.start - raw.rfind(b"\n", 0, error.start)
        problem = Problem(
            file=str(path),
            line=line,
            column=column,
            field="",
            problem="the text is not UTF-8",
            value=f"byte 0x{raw[error.start]:02x}",
            remedy="save the file as UTF-8",
            source_line="",
        )
        raise SceneFileError([problem]) from error
    return str(path), path.stem, text.replace("\r\n", "\n")


def _unreadable(source: str | PathLike[str], error: OSError | ValueError) -> Problem:
    known = sorted(_builtin_files())
    near = nearest(str(source), known)
    guess = f"did you mean {near}? Else " if near else ""
    why = error.strerror if isinstance(error, OSError) else str(error)
    if isinstance(error, FileNotFoundError):
        why = "there is no such file or built-in scene"
    return Problem(
        file=str(source).replace("\0", "\\0"),
        line=0,
        column=0,
        field="",
        problem=f"cannot read the scene: {why}",
        value=None,
        remedy=f"{guess}give the path of a TOML file or one of: {', '.join(known)}",
        source_line="",
    )


def _parsed(report: Report) -> dict[str, Any]:
    """The file's tables; fills in the places too."""
    long = too_long(report.text)
    if long is not None:
        report.add_at(*long)
        report.raise_if_any()
    try:
        document = tomllib.loads(report.text)
    except tomllib.TOMLDecodeError as error:
        message = str(error)
        match = _AT.search(message)
        lines = report.text.split("\n")
        offset = len(report.text.rstrip())
        if match is not None and match.group(1):
            line, column = int(match.group(1)), int(match.group(2))
            offset = sum(len(text) + 1 for text in lines[: line - 1]) + column - 1
        problem = f"not TOML: {_AT.sub('', message)}"
        remedy = "correct the line; text needs quotes, lists need [ ] and commas"
        report.add_at(offset, problem, remedy)
        report.raise_if_any()
        raise
    except ValueError as error:  # of more digits than Python reads
        digits = _MANY_DIGITS.search(report.text)
        report.add_at(digits.start() if digits else 0, *_TOO_MANY_DIGITS)
        raise SceneFileError(report.problems) from error
    except RecursionError as error:
        report.add_at(0, *_TOO_DEEP)
        raise SceneFileError(report.problems) from error
    if too_deep(document):
        report.add_at(0, *_TOO_DEEP)
        report.raise_if_any()
    report.document = document
    report.places = positions(report.text)
    return document
