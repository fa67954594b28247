"""Events of runs as variables of labelled data sets."""

from collections.abc import Collection, Iterable, Mapping
from typing import Any

import numpy as np

from ..validation.checks import FieldError

# dimensions, values and labels
Variable = tuple[tuple[str, ...], np.ndarray, dict[str, str]]


def variable_of(name: str) -> str:
    """A name as variables have it: without the slash, which NetCDF keeps for groups."""
    return name.replace("/", "_")


def refuse_names(events: Iterable[str], taken: Collection[str]) -> None:
    """Refuse names of events that would be another variable's, or one another's.

    Args:
        events: Their names.
        taken: Names that the data set has otherwise.

    Raises:
        FieldError: one is.
    """
    there = {*taken}
    for event in events:
        for own in (f"{variable_of(event)}_{what}" for what in ("time", "count")):
            if own in there:
                problem = f'would be another "{own}" in a data set'
                raise FieldError("Event.name", event, problem, "give another name")
            there.add(own)


def event_variables(
    events: Mapping[str, Any], front: tuple[str, ...], taken: Collection[str]
) -> dict[str, Variable]:
    """How often each happened, ``NAME_count``, and when [s], ``NAME_time``.

    Args:
        events: By name, as ``Trajectory.events`` and ``Ensemble.events`` have them.
        front: Dimensions that they have in front.
        taken: Names that the data set has otherwise.

    Raises:
        FieldError: an event has a name such as "final", whose ``final_time`` is there
            already.
    """
    refuse_names(events, taken)
    found: dict[str, Variable] = {}
    for event, crossings in events.items():
        name = variable_of(event)
        times, count = np.asarray(crossings.times), np.asarray(crossings.count)
        when = {"long_name": f'times of "{event}"', "units": "s"}
        often = {"long_name": f'how often "{event}" happened', "units": "1"}
        own = {
            f"{name}_time": ((*front, f"{name}_crossing"), times, when),
            f"{name}_count": (front, count, often),
        }
        found |= own
    return found
