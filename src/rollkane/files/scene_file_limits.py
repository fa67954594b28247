"""How large a scene file may be: what would take minutes to read is refused at once."""

import re
from collections.abc import Iterable
from typing import Any, cast

MOST_OUTPUTS = 10_000_000  # states of 14 numbers each: a gigabyte
MOST_PARTS = 1000  # loads, supported masses or events; checked in about a second
MOST_CHARACTERS = 8_000_000
MOST_LEVELS = 64  # of tables in tables, where none takes more than five

_NAME = r"""(?:[\w-]+|"(?:[^"\\\n]|\\[^\n]?)*(?:"|$)|'[^'\n]*(?:'|$))"""
# whole keys, one after the other: no character is looked at twice
_KEY = re.compile(rf"{_NAME}(?:[ \t]*\.[ \t]*{_NAME})*", re.MULTILINE | re.ASCII)


def too_long(text: str) -> tuple[int, str, str] | None:
    """What would keep a reader of TOML busy: its offset, what it is, and the remedy.

    The time that ``tomllib`` takes for a key grows with the square of its levels.

    Args:
        text: A file's text, not yet read.
    """
    if len(text) > MOST_CHARACTERS:
        problem = f"has {len(text)} characters, more than {MOST_CHARACTERS}"
        return 0, problem, "leave records of a motion in files of their own"
    for key in _KEY.finditer(text):
        if (
            text.count(".", *key.span()) >= MOST_LEVELS
            and _levels(key[0]) > MOST_LEVELS
        ):
            problem = f"a key of more than {MOST_LEVELS} levels"
            return key.start(), problem, "write one such as body.surface.radius"
    return None


def _levels(key: str) -> int:
    return len(re.findall(_NAME, key, re.MULTILINE | re.ASCII))


def too_deep(document: Any) -> bool:
    """Whether tables and lists stand in one another in too many levels."""
    level: list[Any] = [document]
    for _ in range(MOST_LEVELS):
        level = [x for one in level for x in _inside(one) if isinstance(x, dict | list)]
        if not level:
            return False
    return True


def _inside(one: Any) -> Iterable[Any]:
    if isinstance(one, dict):
        return cast("dict[str, Any]", one).values()
    return cast("list[Any]", one)
