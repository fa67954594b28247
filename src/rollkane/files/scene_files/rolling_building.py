"""From checked tables to bodies that roll on or in the body, and their states."""

from typing import Any

import numpy as np

from ...dynamics.rolling_bodies import RollingBody
from ...dynamics.scene import Rolling, RubberRolling
from ...kinematics.coordinates import State
from ...validation.checks import FieldError
from .construction import attempt, product_of_turns, usable
from .positions import Given, Path
from .problems import Report
from .surface_building import body_of, surface_of
from .tables import RollingStartTable

_STILL = (0.0, 0.0, 0.0)
_UNTURNED = (1.0, 0.0, 0.0, 0.0)

Parts = tuple[tuple[RollingBody, ...], tuple[State, ...]]


def rolling_of(report: Report) -> Parts | None:
    """Bodies that roll on the body, and their states; None where one is wrong.

    Args:
        report: Knows the file and its tables; takes the problems.
    """
    given: Given = report.document.get("rolling")
    tables: list[Given] = given if isinstance(given, list) else []
    carried: dict[int | None, list[tuple[RollingBody, State]]] = {}
    # a carrier stands before what it carries, and is made behind it
    for i, table in reversed(list(enumerate(tables))):
        if not isinstance(table, dict):
            continue
        made = _made(("rolling", i), table, carried.get(i, []), report)
        carrier: Any = table.get("carrier")
        if isinstance(carrier, int) and carrier >= i:
            problem = "must be the number of a table before this one"
            before = (
                f"give 0 to {i - 1}" if i else "leave it out: the body carries this"
            )
            report.add(("rolling", i, "carrier"), problem, before)
        elif made is not None:
            carried.setdefault(carrier, []).insert(0, made)
    if report.has_below(("rolling",)):
        return None
    outermost = carried.get(None, [])
    return tuple(part for part, _ in outermost), tuple(own for _, own in outermost)


def _made(
    path: Path,
    table: dict[str, Any],
    inner: list[tuple[RollingBody, State]],
    report: Report,
) -> tuple[RollingBody, State] | None:
    body = body_of((*path, "body"), report)
    on = surface_of((*path, "on"), report)
    if body is None or on is None or report.has_below(path):
        return None
    where = usable(path, ("position",), report)
    if "rotations" in table:
        where["rotation"] = product_of_turns(table["rotations"])
    law = RubberRolling() if table.get("without_spin") else Rolling()
    parts = tuple(part for part, _ in inner)
    part = RollingBody(body, on, parts, law, **where)
    state = _state(part, path, tuple(own for _, own in inner), report)
    return None if state is None else (part, state)


def _state(
    part: RollingBody, path: Path, inner: tuple[State, ...], report: Report
) -> State | None:
    path = (*path, "start")
    given = usable(path, RollingStartTable.model_fields, report)
    if "orientation" in given and "rotations" in given:
        problem = "says the same as orientation"
        remedy = "leave out orientation or rotations"
        report.add((*path, "rotations"), problem, remedy, at_key=True)
    orientation = given.get("orientation", _UNTURNED)
    if "rotations" in given:
        orientation = product_of_turns(given["rotations"])
    arguments = {
        "orientation": orientation,
        "angular_velocity": given.get("angular_velocity", _STILL),
        "contact_on_base": given["contact_on_carrier"],
        "base_normal": given.get("base_normal"),
        "near_on_body": given.get("near_on_body"),
        "allow_overlap": given.get("allow_overlap", False),
        "supported": inner,
    }

    def note(name: str, error: FieldError) -> None:
        field = "contact_on_carrier" if name not in given else name
        report.add((*path, field), error.problem, error.remedy)

    length = float(np.linalg.norm(orientation))
    unit = np.asarray(orientation) / length if length else np.asarray(_UNTURNED)
    return attempt(part.place, arguments, note, {"orientation": unit})
