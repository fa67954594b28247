"""Where in a TOML text each key and each value stands.

``tomllib`` gives the values of a file but not their places. This scanner gives the
places but not the values: it reads only text that ``tomllib`` has accepted, so it
checks nothing, and never has to decide what a number or a date is.
"""

import re
from typing import Any, NamedTuple

Path = tuple[str | int, ...]
# what a file gives at a path (dates, which no field takes, are not listed)
Given = dict[str, Any] | list[Any] | str | float | None

_BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")
_BLANK = re.compile(r"(?:[ \t\n]|#[^\n]*)*")
_SPACE = re.compile(r"[ \t]*")
_SCALAR = re.compile(r"[^,\]}#\n]*")


class Place(NamedTuple):
    """Offsets in the text [characters].

    Attributes:
        key: Where the key, or the table's header, starts.
        value: Where the value starts; for a table, where its header starts.
        end: First character behind the value.
    """

    key: int
    value: int
    end: int


def positions(text: str) -> dict[Path, Place]:
    r"""Places of all keys and values of a TOML text.

    Args:
        text: A text that ``tomllib.loads`` accepts, with line ends ``\n``.

    Returns:
        Path to place; a path holds keys, and indices of arrays counted from 0.
    """
    scanner = _Scanner(text)
    scanner.document()
    return scanner.places


def given_at(document: Any, path: Path) -> Any:
    """What a document holds at a path; None where it holds nothing."""
    for step in path:
        try:
            document = document[step]
        except (KeyError, IndexError, TypeError):
            return None
    return document


def line_and_column(text: str, offset: int) -> tuple[int, int]:
    """Line and column of an offset, both counted from 1."""
    before = text[:offset]
    return before.count("\n") + 1, offset - (before.rfind("\n") + 1) + 1


class _Scanner:
    """One pass over a valid text; ``at`` is the offset reached."""

    def __init__(self, text: str):
        self.text, self.at = text, 0
        self.places: dict[Path, Place] = {}
        self.array_lengths: dict[Path, int] = {}

    def document(self) -> None:
        """The whole text: headers, and keys with values."""
        table: Path = ()
        self.skip(_BLANK)
        while self.at < len(self.text):
            if self.text[self.at] == "[":
                table = self.header()
            else:
                self.key_value(table)
            self.skip(_BLANK)

    def skip(self, pattern: re.Pattern[str]) -> str:
        """Go on behind what a pattern matches here; its text."""
        match = pattern.match(self.text, self.at)
        assert match is not None  # every pattern used here matches the empty string
        self.at = match.end()
        return match.group()

    def header(self) -> Path:
        """``[a.b]`` or ``[[a.b]]``: the table that the next lines belong to."""
        start = self.at
        is_array = self.text.startswith("[[", start)
        self.at += 2 if is_array else 1
        self.skip(_SPACE)
        *owners, last = self.dotted_key()
        self.skip(_SPACE)
        self.at += 2 if is_array else 1
        table: Path = ()
        for name in owners:
            table = self.newest((*table, name))
        table = (*table, last)
        if is_array:
            self.array_lengths[table] = self.array_lengths.get(table, 0) + 1
            self.places.setdefault(table, Place(start, start, self.at))
        table = self.newest(table)
        self.places[table] = Place(start, start, self.at)
        return table

    def newest(self, table: Path) -> Path:
        """The table itself, or the last element where it is an array of tables."""
        length = self.array_lengths.get(table)
        return table if length is None else (*table, length - 1)

    def key_value(self, table: Path) -> None:
        """``a.b = value``, in a table."""
        start = self.at
        names = self.dotted_key()
        self.skip(_SPACE)
        self.at += 1  # the equals sign
        self.skip(_SPACE)
        value = self.at
        path = (*table, *names)
        self.value(path)
        for count in range(1, len(names)):  # tables that a dotted key opens
            owner = (*table, *names[:count])
            self.places.setdefault(owner, Place(start, start, self.at))
        self.places[path] = Place(start, value, self.at)

    def dotted_key(self) -> list[str]:
        """``a.b."c d"``: its names."""
        names = [self.key()]
        self.skip(_SPACE)
        while self.text.startswith(".", self.at):
            self.at += 1
            self.skip(_SPACE)
            names.append(self.key())
            self.skip(_SPACE)
        return names

    def key(self) -> str:
        """One name, bare or quoted."""
        if self.text[self.at] in "\"'":
            start = self.at
            self.string()
            return self.text[start + 1 : self.at - 1]
        return self.skip(_BARE_KEY)

    def value(self, path: Path) -> None:
        """Any value; notes its place and those of what it holds."""
        start, first = self.at, self.text[self.at]
        if first in "\"'":
            self.string()
        elif first == "[":
            self.array(path)
        elif first == "{":
            self.inline_table(path)
        else:
            self.at = start + len(self.skip(_SCALAR).rstrip())
        self.places[path] = Place(start, start, self.at)

    def array(self, path: Path) -> None:
        """``[1, 2]``, with its elements."""
        self.at += 1
        self.skip(_BLANK)
        index = 0
        while self.text[self.at] != "]":
            self.value((*path, index))
            index += 1
            self.skip(_BLANK)
            if self.text[self.at] == ",":
                self.at += 1
                self.skip(_BLANK)
        self.at += 1

    def inline_table(self, path: Path) -> None:
        """``{ a = 1 }``, with its keys."""
        self.at += 1
        self.skip(_BLANK)
        while self.text[self.at] != "}":
            self.key_value(path)
            self.skip(_BLANK)
            if self.text[self.at] == ",":
                self.at += 1
                self.skip(_BLANK)
        self.at += 1

    def string(self) -> None:
        """A string in one of the four kinds of quotes."""
        quote = self.text[self.at]
        mark = quote * 3 if self.text.startswith(quote * 3, self.at) else quote
        self.at += len(mark)
        while not self.text.startswith(mark, self.at):
            escaped = quote == '"' and self.text[self.at] == "\\"
            self.at += 2 if escaped else 1
        self.at += len(mark)
        if len(mark) == 3:  # up to two quotes may stand before the closing three
            while self.text.startswith(quote, self.at):
                self.at += 1
