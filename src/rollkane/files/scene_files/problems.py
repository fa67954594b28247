"""What is wrong in a scene file, all of it at once, each with its place and remedy."""

import difflib
import json
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from .positions import Path, Place, given_at, line_and_column

_WIDEST = 500  # characters that are shown of a line, or of a name
_MOST_PROBLEMS = 100  # that are noted of a file


@dataclass(frozen=True)
class Problem:
    """One thing that is wrong in a scene file.

    Attributes:
        file: Name of the file, as the user gave it.
        line: Counted from 1; 0 where there is no file to read.
        column: Counted from 1 [characters].
        field: Dotted path of the field, for example ``body.mass``; may be empty.
        problem: What is wrong with it.
        value: What was given, as it may be written in the file; None if nothing was.
        remedy: What to do.
        source_line: Text of that line.
    """

    file: str
    line: int
    column: int
    field: str
    problem: str
    value: str | None
    remedy: str
    source_line: str

    def __str__(self) -> str:
        """One line that says it all, then the source line with a caret."""
        name = f"{_shortened(self.field)}: " if self.field else ""
        got = "" if self.value is None else f", got {self.value}"
        where = f":{self.line}:{self.column}" if self.line else ""
        head = f"{self.file}{where}: error: {name}{self.problem}{got} — {self.remedy}"
        if not self.source_line.strip():
            return head
        first = max(self.column - 1 - _WIDEST // 2, 0)
        if len(self.source_line) <= _WIDEST:
            first = 0
        before = self.source_line[first : self.column - 1]
        indent = "".join("\t" if c == "\t" else " " for c in before)
        shown = self.source_line[first : first + _WIDEST]
        return f"{head}\n    {shown}\n    {indent}^"


class SceneFileError(ValueError):
    """A scene file that cannot be used.

    Attributes:
        problems: Everything that is wrong with it, in the order of the file.
    """

    def __init__(self, problems: Iterable[Problem]):
        """Refuse a file for everything that is wrong with it."""
        self.problems = list(problems)
        super().__init__("\n".join(str(problem) for problem in self.problems))


class Report:
    """Collects the problems of one file, the first hundred that are found."""

    def __init__(self, file: str, text: str, document: Any = None):
        r"""Start with none.

        Args:
            file: Name of the file, for the messages.
            text: Its text, with line ends ``\n``.
            document: Its tables, as ``tomllib`` gives them; None before they are known.
        """
        self.file, self.text, self.document = file, text, document
        self.places: dict[Path, Place] = {}
        self._found: dict[tuple[str, str], tuple[int, Problem]] = {}

    def add(
        self,
        path: Path,
        problem: str,
        remedy: str,
        *,
        at_key: bool = False,
        shift: int | None = None,
    ) -> None:
        """Note a problem of a field.

        Args:
            path: Where it is: keys, and indices of arrays. What the file does not hold
                is reported at the innermost table that it does hold.
            problem: What is wrong.
            remedy: What to do.
            at_key: Point at the key instead of the value, and show no value.
            shift: Point at this character of a string value; at its start if None.
        """
        place = self.places.get(path) if self._holds(path) else None
        shown = None
        if place is None:
            offset = self._around(path)
        elif at_key:
            offset = place.key
        else:
            offset = place.value
            shown = written(self.value(path))
            if shift is not None:
                offset += self._into_string(place, shift)
        self._note(offset, dotted(path), problem, shown, remedy)

    def add_at(self, offset: int, problem: str, remedy: str) -> None:
        """Note a problem at an offset of the text that belongs to no field."""
        self._note(offset, "", problem, None, remedy)

    def value(self, path: Path) -> Any:
        """What the file gives at a path that it holds."""
        found = self.document
        for step in path:
            found = found[step]
        return found

    def _holds(self, path: Path) -> bool:
        """Whether a field is there: another table may be in the place of the file's."""
        return not path or given_at(self.document, path) is not None  # TOML has no null

    def has_below(self, path: Path) -> bool:
        """Whether a problem was noted for a field or anything in it."""
        name = dotted(path)
        return any(
            found == name or found.startswith((name + ".", name + "["))
            for found, *_ in self._found
        )

    @property
    def problems(self) -> list[Problem]:
        """All problems, in the order of the file."""
        return [p for _, p in sorted(self._found.values(), key=lambda item: item[0])]

    @property
    def is_full(self) -> bool:
        """Whether further problems are not noted."""
        return len(self._found) >= _MOST_PROBLEMS

    def raise_if_any(self) -> None:
        """Refuse the file.

        Raises:
            SceneFileError: if there is a problem.
        """
        if self._found:
            raise SceneFileError(self.problems)

    def _around(self, path: Path) -> int:
        """Offset of the innermost table that holds, or would hold, a field."""
        for end in range(len(path) - 1, 0, -1):
            owner = path[:end]
            if owner in self.places:
                return self.places[owner].key
            inner = [p.key for q, p in self.places.items() if q[:end] == owner]
            if inner:  # a table that is only opened by a table in it
                return min(inner)
        return 0

    def _into_string(self, place: Place, shift: int) -> int:
        """Characters from a string's opening quote to its ``shift``-th character."""
        source = self.text[place.value : place.end]
        if "\\" in source:  # escapes: written and meant characters differ in number
            return 0
        mark = 3 if source.startswith(('"""', "'''")) else 1
        newline = 1 if mark == 3 and source[3:4] == "\n" else 0
        return mark + newline + shift

    def _note(
        self, offset: int, field: str, problem: str, value: str | None, remedy: str
    ) -> None:
        if self.is_full:  # each looks through the whole text
            return
        line, column = line_and_column(self.text, offset)
        source = self.text.split("\n")[line - 1]
        self._found.setdefault(
            (field, problem),
            (
                offset,
                Problem(self.file, line, column, field, problem, value, remedy, source),
            ),
        )


def _shortened(text: str) -> str:
    return text if len(text) <= _WIDEST else text[: _WIDEST - 3] + "..."


def dotted(path: Path) -> str:
    """A path as text: ``loads[0].acceleration``."""
    text = ""
    for step in path:
        text += f"[{step}]" if isinstance(step, int) else f".{step}"
    return text.removeprefix(".")


def written(value: Any) -> str:
    """A value about as it is written in the file, shortened."""
    if isinstance(value, dict):
        return "a table"
    if isinstance(value, (str, bool, int, float, list)):
        try:
            text = json.dumps(value, ensure_ascii=False)
        except (TypeError, ValueError):  # a date, or a number of thousands of digits
            text = "this"
        text = text.replace("NaN", "nan").replace("Infinity", "inf")
    else:
        text = str(value)
    return text if len(text) <= 80 else text[:77] + "..."


def suggestion(name: str, known: Iterable[str]) -> str:
    """Remedy for an unknown name: the nearest known one, and all of them."""
    known = list(known)
    near = nearest(name, known)
    listed = ", ".join(known)
    if near is None:
        return f"use one of: {listed}"
    return f"did you mean {near}? (known: {listed})"


def nearest(name: Any, known: Iterable[str]) -> str | None:
    """The known name that looks most like one, or None."""
    if not isinstance(name, str):
        return None
    plain = {_plain(k): k for k in known}
    close = difflib.get_close_matches(_plain(name), plain, n=1, cutoff=0.6)
    return plain[close[0]] if close else None


def _plain(name: str) -> str:
    return name.lower().replace("_", "-")
