"""A study from a TOML file: a scene file, what varies in it, what is looked at."""

import functools
import re
from collections.abc import Callable, Iterable, Mapping
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple, cast

import jax.numpy as jnp

from ..dynamics.ready_observables import READY
from ..files.scene_files.event_building import events_of
from ..files.scene_files.loading import SceneFile, load_scene, read_tables
from ..files.scene_files.problems import Report, SceneFileError, suggestion
from ..identification import paths
from ..validation.checks import FieldError
from .checked_parts import checked, checked_parts
from .distribution_tables import distribution_of
from .scene_model import SceneModel, touched_at
from .study import Study

_KEYS = (
    *("title", "scene", "times", "size", "seed", "sampling", "block"),
    *("vary", "observe", "series", "events"),
)

_EVENT = re.compile(r"Study\.events\[(\d+)\]")


class StudyFile(NamedTuple):
    """A study, and how it is run where nothing else is said.

    Attributes:
        study: What varies, moves and is looked at.
        title: A line of text.
        size: Members; None where the file leaves it open.
        seed: Of the random numbers.
        sampling: Kind of the samples.
        block: Members of a block; None: the default.
    """

    study: Study
    title: str
    size: int | None
    seed: int
    sampling: str
    block: int | None


def load_study(source: str | PathLike[str]) -> StudyFile:
    """Read a study.

    Args:
        source: Path of a TOML file. ``scene`` names a built-in scene or a scene file
            beside it; ``[vary."PATH"]`` tables give distributions; ``observe`` and
            ``series`` list ready observables, ``[[events]]`` where one of them crosses
            a level. Paths are those of the scene (``body.mass``), and of the start, as
            :func:`rollkane.place` takes it: ``start.angular_velocity[2]``, fixed axes;
            and of the modes, ``modes.friction``.

    Raises:
        SceneFileError: with everything that is wrong, each with line, field and remedy.
    """
    report = read_tables(source)
    known = _Checked(report, Path(source).parent)
    report.raise_if_any()
    return known.study_file()


class _Checked:
    """One file under way: what is wrong is reported, what is right is kept."""

    def __init__(self, report: Report, folder: Path):
        self._report, self._document = report, cast("dict[str, Any]", report.document)
        self._unknown((), self._document, _KEYS)
        if not isinstance(self._document.get("title", ""), str):
            report.add(("title",), "must be text", "give a line of text")
        self.file = self._scene(folder)
        self.varied = self._vary()
        self.observe, self.series = self._named("observe"), self._named("series")
        self.events = events_of(report)
        self.size = self._whole("size", 1)
        self.block = self._whole("block", 1)
        self.seed = self._whole("seed", 0) or 0
        self.sampling = self._one_of("sampling", ("plain", "latin", "sobol"))

    def study_file(self) -> StudyFile:
        """The study; a scene in which nothing can vary so is refused.

        Raises:
            SceneFileError: it is.
        """
        assert self.file is not None
        document, file = self._document, self.file
        times = document.get("times", (file.times[0], file.times[-1]))
        try:
            study = Study(
                _make_of(file, tuple(self.varied), _first(times, file.times[0])),
                {_word(path): one for path, one in self.varied.items()},
                times,
                observe=self.observe,
                series=self.series,
                events=self._all_events(file),
                modes=None if _draws_modes(self.varied) else file.modes,
                rtol=file.rtol,
                atol=file.atol,
                method=file.method,
                second_contact=file.second_contact,
            )
        except FieldError as error:
            self._refused(error, file)
            self._report.raise_if_any()
            raise
        title = document.get("title") or file.title
        how = self.size, self.seed, self.sampling, self.block
        return StudyFile(study, title, *how)

    def _refused(self, error: FieldError, file: SceneFile) -> None:
        """Note what the study refuses, where this file gives it."""
        event = _EVENT.fullmatch(error.field)
        if event is not None:
            own = int(event[1]) - len(self._all_events(file)) + len(self.events)
            self._event_name(own, error)
        elif error.field.endswith("times"):
            self._report.add(("times",), error.problem, error.remedy)
        else:
            self._report.add((), str(error), "change the study")

    def _event_name(self, own: int, error: FieldError) -> None:
        """Note a name that the event with a number cannot have.

        Args:
            own: Its number in this file; negative: it is in the scene's.
            error: What the study says of it.
        """
        name = error.value
        known = {"observe": self.observe, "series": self.series}
        lists = "".join(field for field, names in known.items() if name in names)
        if own < 0:
            problem = f"has an event {name!r}, which {error.problem}"
            if lists:
                problem = f"has an event {name!r}, and {lists} lists that name, too"
            remedy = "give that event another name, in the scene's file"
            self._report.add(("scene",), problem, remedy)
        elif "name" in self._document["events"][own]:
            problem = f"is what {lists} lists, too" if lists else error.problem
            remedy = "take another name" if lists else error.remedy
            self._report.add(("events", own, "name"), problem, remedy)
        else:
            problem = f"has no name and takes its observable's, {name!r}"
            if lists:
                problem += f", which {lists} lists, too"
            remedy = 'give it one of its own, such as name = "crossing"'
            self._report.add(("events", own), problem, remedy, at_key=True)

    def _all_events(self, file: SceneFile) -> tuple[Any, ...]:
        """Those of the scene's file, but for names that it has itself, and its own."""
        own = [event.name for event in self.events]
        return (*(e for e in file.events if e.name not in own), *self.events)

    def _scene(self, folder: Path) -> SceneFile | None:
        given: Any = self._document.get("scene")
        remedy = 'write for example scene = "rattleback"'
        if not isinstance(given, str):
            self._report.add(("scene",), "must name a scene", remedy)
            return None
        beside = folder / given
        try:
            file = load_scene(beside if beside.is_file() else given)
        except SceneFileError as error:
            self._report.add(("scene",), f"cannot be used: {error.problems[0]}", remedy)
            return None
        return file

    def _vary(self) -> dict[str, Any]:
        tables: Any = self._document.get("vary")
        if not isinstance(tables, Mapping) or not tables:
            remedy = 'write a table such as [vary."start.angular_velocity[2]"]'
            self._report.add(("vary",), "must say what is random", remedy)
            return {}
        found: dict[str, Any] = {}
        for path, table in cast("Mapping[str, Any]", tables).items():
            where = "vary", path
            self._check_apart(where, path, found)
            if self.file is not None:
                self._check_path(where, path)
            try:
                found[path] = distribution_of(table)
            except FieldError as error:
                self._report.add(where, error.problem, error.remedy)
                continue
            if not self._report.has_below(where):
                self._check_shape(where, path, found[path])
        return found

    def _check_apart(self, where: Any, path: str, known: Mapping[str, Any]) -> None:
        """Of a number and an array that holds it, one would be drawn in vain."""
        own = self._plain(path)
        for other in known:
            keys = self._plain(other)
            if own[: len(keys)] == keys[: len(own)]:
                problem = f"varies what {other} varies, too"
                remedy = "vary the whole, or its entries"
                self._report.add(where, problem, remedy, at_key=True)

    def _plain(self, path: str) -> paths.Keys:
        """Keys that are the same for all spellings of a path."""
        try:
            keys = _keys(path)
        except FieldError:  # told otherwise
            return (path,)
        return (
            keys if self.file is None else paths.plain(SceneModel.of(self.file), keys)
        )

    def _check_shape(self, where: tuple[str, ...], path: str, one: Any) -> None:
        if self.file is None:
            return
        wanted = jnp.shape(_number_at(SceneModel.of(self.file), path))
        if one.shape != wanted:
            problem = f"draws numbers of shape {one.shape}, where {wanted} is needed"
            remedy = "give arrays of that shape, or the path of one entry, such as [2]"
            self._report.add(where, problem, remedy)

    def _check_path(self, where: tuple[str, ...], path: str) -> None:
        assert self.file is not None
        try:
            value = _number_at(SceneModel.of(self.file), path)
        except (FieldError, LookupError):
            known = [*paths.floats(self.file.scene), *_other_paths(self.file)]
            problem = "is no number of the scene, the start or the modes"
            meant = suggestion(path, known)
            listed = f"use one of {', '.join(known[:20])}"
            self._report.add(where, problem, meant or listed, at_key=True)
            return
        if not paths.is_floating(value):
            problem, remedy = "is no number that can vary", "give the path of a float"
            self._report.add(where, problem, remedy, at_key=True)
        if _is_half(_keys(path)):
            problem = "is one half of a symmetric tensor, which would not stay so"
            remedy = 'vary the whole: distribution = "inertia"'
            self._report.add(where, problem, remedy, at_key=True)

    def _named(self, field: str) -> dict[str, Any]:
        given: Any = self._document.get(field, [])
        known = f"use some of {', '.join(READY)}"
        if not isinstance(given, list):
            self._report.add((field,), "must be a list of names", known)
            return {}
        found: dict[str, Any] = {}
        for i, name in enumerate(cast("list[Any]", given)):
            if str(name) not in READY:
                meant = suggestion(str(name), READY) or known
                self._report.add((field, i), "is not known", meant)
                continue
            # at the end and along the way are two things
            found[f"{name} series" if field == "series" else name] = READY[name]
        return found

    def _unknown(self, where: Any, table: Any, known: tuple[str, ...]) -> None:
        for key in table:
            if key not in known:
                remedy = suggestion(key, known) or f"use some of {', '.join(known)}"
                self._report.add((*where, key), "is not known", remedy, at_key=True)

    def _whole(self, name: str, least: int) -> int | None:
        value = self._document.get(name)
        if value is None:
            return None
        if not isinstance(value, int) or isinstance(value, bool) or value < least:
            problem = f"must be a whole number of at least {least}"
            self._report.add((name,), problem, "give one, or leave it out")
        return value

    def _one_of(self, name: str, known: tuple[str, ...]) -> str:
        value = self._document.get(name, known[0])
        if value not in known:
            remedy = f"use one of {', '.join(known)}"
            self._report.add((name,), "is not known", remedy)
        return value


def _other_paths(file: SceneFile) -> list[str]:
    """Of the start and of the modes."""
    start = SceneModel.of(file).start
    found = [f"start.{name}" for name, x in start.items() if x.size]
    return found + ([] if file.modes is None else [*paths.floats(file.modes, "modes")])


def _keys(path: str) -> paths.Keys:
    keys = paths.keys_of(path)
    return keys if keys[0] in ("scene", "start", "modes") else ("scene", *keys)


def _is_half(keys: paths.Keys) -> bool:
    """Whether a path is that of an inertia's entry beside the diagonal, or of a row."""
    if "inertia" not in keys:
        return False
    entry = keys[keys.index("inertia") + 1 :]
    return len(entry) == 1 or (len(entry) == 2 and entry[0] != entry[1])


def _draws_modes(varied: Iterable[str]) -> bool:
    return any(_keys(path)[0] == "modes" for path in varied)


def _number_at(model: SceneModel, path: str) -> Any:
    return paths.found(model, _keys(path))


def _word(path: str) -> str:
    """A path as a word: what a draw is called."""
    text = "".join(c if c.isalnum() else "_" for c in path)
    return text.strip("_")


def _first(times: Any, default: Any) -> float:
    """When a motion begins [s]; of times that are none, which are refused, any."""
    try:
        return float(times[0])
    except (TypeError, ValueError, LookupError):
        return float(default)


def _make_of(
    file: SceneFile, varied: tuple[str, ...], time: float
) -> Callable[..., Any]:
    model = SceneModel.of(file)
    parts = checked_parts(model, map(_keys, varied))
    return functools.partial(_made, model, touched_at(file), time, varied, parts)


def _made(
    model: SceneModel,
    near: Any,
    time: float,
    varied: tuple[str, ...],
    parts: list[paths.Keys],
    draw: Any,
) -> Any:
    """Scene and start of one draw; and modes, where they vary."""
    for path in varied:
        keys = _keys(path)
        old = paths.found(model, keys)
        new = jnp.asarray(draw[_word(path)], old.dtype)
        model = paths.replaced(model, keys, new)
    model = checked(model, parts)
    found = model.scene, model.placed(near, time)
    return (*found, model.modes) if _draws_modes(varied) else found
