"""What the live page asks its server, taken apart and checked."""

import json
import math
from typing import Any, NamedTuple, cast


class MalformedQuestion(ValueError):
    """A question that no page of ours asks; its text is one sentence that says why."""


class Question(NamedTuple):
    """A motion that is asked for.

    Attributes:
        values: Numbers of the scene, by path.
        shown: Those of the motion that the page shows.
        drawn: Boxes of the meshes that it shows, each two corners [m], or None.
    """

    values: dict[str, float]
    shown: dict[str, float]
    drawn: list[Any]


def question_of(text: bytes) -> Question:
    """A question as the page writes it, in JSON.

    Args:
        text: An object with ``values`` and ``shown``, and perhaps ``drawn``.

    Raises:
        MalformedQuestion: it is none.
    """
    if not text.strip():
        raise MalformedQuestion("the question is empty")
    try:
        asked: Any = json.loads(text)
    except RecursionError as error:
        raise MalformedQuestion("the question is nested too deeply") from error
    except ValueError as error:
        raise MalformedQuestion(f"the question is no JSON: {error}") from error
    if not isinstance(asked, dict):
        raise MalformedQuestion("the question is no object with values and shown")
    told = cast("dict[str, Any]", asked)
    boxes = told.get("drawn", [])
    if not isinstance(boxes, list):
        raise MalformedQuestion("drawn is no list of boxes")
    drawn = [_box(box) for box in cast("list[Any]", boxes)]
    return Question(_numbers(told, "values"), _numbers(told, "shown"), drawn)


def _numbers(told: dict[str, Any], name: str) -> dict[str, float]:
    given = told.get(name)
    if not isinstance(given, dict):
        raise MalformedQuestion(f"{name} is no object of numbers by path")
    pairs = cast("dict[str, Any]", given).items()
    return {path: _number(value, f"{name} of {path!r}") for path, value in pairs}


def _box(given: Any) -> list[list[float]] | None:
    if given is None:
        return None
    corners = cast("list[Any]", given if isinstance(given, list) else [])
    sizes = [len(cast("list[Any]", x)) for x in corners if isinstance(x, list)]
    if sizes != [3, 3] or len(corners) != 2:
        raise MalformedQuestion("a box in drawn is not two corners of three numbers")
    return [[_number(x, "a box in drawn") for x in corner] for corner in corners]


def _number(value: Any, what: str) -> float:
    try:
        number = math.nan if isinstance(value, bool) else float(value)
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    if isinstance(value, str) or not math.isfinite(number):
        raise MalformedQuestion(f"{what} is no finite number")
    return number
