"""A scene whose numbers are dragged: which numbers there are, and the run for others.

The loop is compiled once; another number is another argument of it.
"""

from collections.abc import Mapping, Sequence
from os import PathLike
from typing import Any, NamedTuple, cast

import numpy as np

from ..files.scene_files import SceneFile, load_scene
from ..files.scene_files.loading import read_tables, scene_text
from ..files.scene_files.problems import dotted
from ..simulation.run import simulate
from ..simulation.trajectory import Trajectory
from ..validation.checks import FieldError
from .viewer import view_data

OUTPUTS = 301  # frames that the page moves smoothly between
# of a step: more than a picture shows, but of motions that part quickly
LEAST_RTOL = 1e-7
_MOST_NUMBERS = 24
_TABLES = "body", "base", "start", "loads", "supported", "rolling", "contact", "modes"
# what is not to be dragged: it would be another scene
_LEFT_OUT = {"inertia", "outputs", "orientation", "time", "seed", "switches", "carrier"}
_MOST_PARTS = 64  # kept of numbers that were dragged before, some megabytes at most
_FACTOR = 3.0  # up to which a positive number is dragged, and down by


class Draggable(NamedTuple):
    """A number of the scene file and the range in which it is dragged.

    Attributes:
        path: Such as ``body.mass`` or ``start.angular_velocity[2]``.
        value: That of the file.
        low: Least.
        high: Greatest.
    """

    path: str
    value: float
    low: float
    high: float


class LiveRun:
    """Runs of a scene for numbers in the place of the file's.

    Attributes:
        source: Name or path of the scene.
        file: As it is read.
        numbers: What can be dragged.
    """

    def __init__(
        self,
        source: str | PathLike[str],
        ranges: Mapping[str, tuple[float, float]] | None = None,
    ):
        """Read a scene.

        Args:
            source: Name of a built-in scene, or path of a TOML file.
            ranges: Numbers to drag, by path, with their least and greatest values;
                left out, those of the file (the first 24 at most).

        Raises:
            SceneFileError: everything that is wrong with the file.
            FieldError: a range that is none, or of what is no number of the file.
        """
        self._parts: dict[Any, Any] = {}
        self.source = source
        self.file: SceneFile = load_scene(source, None, self._parts)
        found = {one.path: one for one in _numbers(_tables(source))}
        self.numbers = list(found.values())[:_MOST_NUMBERS]
        if ranges:
            self.numbers = [_chosen(found, *one) for one in ranges.items()]
        self._times = np.linspace(0.0, self.file.times[-1], OUTPUTS)

    def run(self, values: Mapping[str, float]) -> Trajectory:
        """The motion for other numbers.

        Args:
            values: By path.

        Raises:
            SceneFileError: numbers that the scene cannot have.
            FieldError: a path that is not dragged.
        """
        known = {one.path for one in self.numbers}
        for path in values:
            if path not in known:
                problem = "is no number that is dragged"
                raise FieldError("values", path, problem, f"use {sorted(known)}")
        changes = {path: repr(float(value)) for path, value in values.items()}
        if len(self._parts) > _MOST_PARTS:
            self._parts.clear()
        file = load_scene(self.source, changes, self._parts)
        names = "modes", "method", "second_contact", "events"
        how: dict[str, Any] = {name: getattr(file, name) for name in names}
        rtol = max(file.rtol or LEAST_RTOL, LEAST_RTOL)
        return simulate(file.scene, file.start, self._times, rtol=rtol, **how)

    def data(
        self,
        values: Mapping[str, float],
        shapes: bool = True,
        drawn: Sequence[Any] = (),
    ) -> dict[str, Any]:
        """What the page shows of it, as :func:`rollkane.pictures.viewer.view_data`.

        Args:
            values: By path.
            shapes: Whether with the meshes of the surfaces; without, ``body``, ``base``
                and ``rolling`` are left out, as they are the same as before.
            drawn: How far they are drawn, as :func:`view_data` takes it: they come,
                too, where the motion leaves that.

        Raises:
            SceneFileError: numbers that the scene cannot have.
            FieldError: a path that is not dragged; a run of which no state is finite.
        """
        return view_data(self.run(values), self.file.title, shapes=shapes, drawn=drawn)

    def changes_shapes(
        self, values: Mapping[str, float], shown: Mapping[str, float]
    ) -> bool:
        """Whether the surfaces may differ from those that are shown.

        Args:
            values: By path; left out, those of the file.
            shown: Those of the motion before.
        """
        file = {one.path: one.value for one in self.numbers}
        then, now = file | dict(shown), file | dict(values)
        changed = [path for path, x in now.items() if then.get(path) != x]
        return any("surface" in path or path.startswith("rolling") for path in changed)


def _tables(source: str | PathLike[str]) -> dict[str, Any]:
    import tomllib

    from ..files.scene_files import builtin_scenes

    if isinstance(source, str) and source in builtin_scenes():
        return tomllib.loads(scene_text(source))
    return cast("dict[str, Any]", read_tables(source).document)


def _numbers(tables: Mapping[str, Any]) -> list[Draggable]:
    """Every real number of a file's tables that can be dragged."""
    found: list[Draggable] = []
    for name in _TABLES:
        if name in tables:
            _walk(tables[name], (name,), found)
    return found


def _walk(value: Any, path: tuple[str | int, ...], found: list[Draggable]) -> None:
    if isinstance(value, Mapping):
        for key, inner in cast("Mapping[str, Any]", value).items():
            if key not in _LEFT_OUT:
                _walk(inner, (*path, key), found)
    elif isinstance(value, list):
        numbers = cast("list[Any]", value)
        plain = [x for x in numbers if _is_number(x)]
        size = float(np.linalg.norm(plain)) if plain else 0.0
        for k, inner in enumerate(numbers):
            if _is_number(inner):
                found.append(_component(dotted((*path, k)), float(inner), size))
            elif isinstance(inner, Mapping | list):
                _walk(inner, (*path, k), found)
    elif _is_number(value):
        found.append(_alone(dotted(path), float(value)))


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _alone(path: str, value: float) -> Draggable:
    """A number of one sign: between a third and three times of it."""
    if value == 0.0:
        return Draggable(path, value, -1.0, 1.0)
    ends = sorted((value / _FACTOR, value * _FACTOR))
    return Draggable(path, value, *ends)


def _component(path: str, value: float, size: float) -> Draggable:
    """One of a vector: as much to both sides as the vector is long."""
    if "semi_axes" in path:
        return _alone(path, value)
    reach = 2.0 * size or 1.0
    return Draggable(path, value, -reach, reach)


def _chosen(
    found: Mapping[str, Draggable], path: str, ends: Sequence[float]
) -> Draggable:
    if path not in found:
        remedy = f"use one of {', '.join(found)}"
        raise FieldError("ranges", path, "is no number of the file", remedy)
    low, high = (float(x) for x in ends)
    if not (np.isfinite([low, high]).all() and low < high):
        raise FieldError("ranges", ends, "is no range", "give low < high")
    return found[path]._replace(low=low, high=high)
