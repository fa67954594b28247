"""From tables of events to events: of a scene's file, and of a study's."""

import sys
from collections.abc import Callable
from typing import Any, cast

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ...dynamics.events import Event
from ...dynamics.ready_observables import READY, SCALARS
from ...validation.checks import FieldError
from .positions import Path
from .problems import Report, suggestion
from .tables import LIFT_OFF, EventTable

OBSERVABLES = (LIFT_OFF, *SCALARS)


class _Crossing(eqx.Module):
    """An observable less the level that is looked for."""

    of: Callable[..., Any] = eqx.field(static=True)
    level: Float[Array, ""]  # no part of the program: another compiles nothing

    def __call__(self, scene: Any, t: Any, state: Any) -> Any:
        value = self.of(scene, t, state)
        return value - self.level.astype(value.dtype)


def events_of(report: Report) -> tuple[Event, ...]:
    """Events of a file's ``[[events]]``; what is wrong with them is noted.

    Args:
        report: Knows the file and its tables, checked or not; what is noted already is
            left out.
    """
    given: Any = report.document.get("events", [])
    if not isinstance(given, list):
        _note(report, ("events",), "must be a list of tables", "write [[events]]")
        return ()
    found: list[Event] = []
    for i, table in enumerate(cast("list[Any]", given)):
        event = _event(("events", i), table, report)
        if event is None:
            continue
        if event.name in [other.name for other in found]:
            problem = f"is called {event.name!r}, as another one is"
            remedy = "give each a name of its own"
            if "name" not in table:
                remedy += "; without one it takes that of its observable"
            report.add(("events", i), problem, remedy)
        found.append(event)
    return tuple(found)


def _event(where: Path, table: Any, report: Report) -> Event | None:
    if report.has_below(where):
        return None
    if not isinstance(table, dict):
        report.add(where, "must be a table", "write [[events]]")
        return None
    given = cast("dict[str, Any]", table)
    _check(where, given, report)
    if report.has_below(where):
        return None
    of, stop = given["of"], given.get("stop", False)
    name = given.get("name", of)
    try:
        if of == LIFT_OFF:
            return Event.lift_off(stop, name)
        level = jnp.asarray(float(given.get("level", 0.0)))
        crossing = _Crossing(READY[of], level)
        return Event(crossing, given.get("direction", 0), stop, name)
    except FieldError as error:
        field = error.field.rpartition(".")[2]
        report.add((*where, field), error.problem, error.remedy)
        return None


def _check(where: Path, given: dict[str, Any], report: Report) -> None:
    """Note what is wrong with a table, as far as its event does not tell itself."""
    known = EventTable.model_fields
    for key in given:
        if key not in known:
            remedy = suggestion(key, known) or f"use some of {', '.join(known)}"
            report.add((*where, key), "is not known", remedy, at_key=True)
    of, level = given.get("of"), given.get("level", 0.0)
    if of not in OBSERVABLES:
        remedy = f"use one of {', '.join(OBSERVABLES)}"
        report.add((*where, "of"), "is no number to look for", remedy)
    if isinstance(level, bool) or not isinstance(level, (int, float)):
        report.add((*where, "level"), "must be a number", "give the value crossed")
    elif not abs(level) <= sys.float_info.max:  # of whole numbers of any length, too
        report.add((*where, "level"), "must be finite", "give the value crossed")
    if of == LIFT_OFF and {"level", "direction"} & set(given):
        problem = "is where the normal force falls through zero: it has no level"
        remedy = 'leave out level and direction, or write of = "normal_force"'
        report.add((*where, "of"), problem, remedy)


def _note(report: Report, where: Path, problem: str, remedy: str) -> None:
    if not report.has_below(where):
        report.add(where, problem, remedy)
