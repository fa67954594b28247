"""What a run of a file's scene is refused for, put where the file says it."""

import re
from typing import Any

from ...simulation.run import check_run
from ...validation.checks import FieldError
from .positions import Path, given_at
from .problems import Report

_EVENT = re.compile(r"simulate\.events\[(\d+)\]")
# where the file gives what a run is refused for
_PLACES: dict[str, Path] = {
    "simulate.times": ("run", "duration"),
    "simulate.rtol": ("run", "rtol"),
    "simulate.atol": ("run", "atol"),
    "simulate.method": ("run", "method"),
    "simulate.second_contact": ("run", "second_contact"),
    "simulate.modes": ("modes",),
    "simulate.events": ("events",),
    "simulate.start": ("start",),
}


def check_run_of(report: Report, scene: Any, start: Any, times: Any, how: Any) -> None:
    """Note what :func:`rollkane.simulate` would refuse before it runs anything.

    Args:
        report: Of the file; takes the problem.
        scene: As the file has it.
        start: The same.
        times: Output times [s].
        how: Further arguments of ``simulate``, by name.
    """
    try:
        check_run(scene, start, times, **how)
    except FieldError as error:
        path = _place(error.field)
        # of a table the key says more than its value
        at_key = isinstance(given_at(report.document, path), dict | list)
        report.add(path, error.problem, error.remedy, at_key=at_key)


def _place(field: str) -> Path:
    """Where the file gives a field of ``simulate`` or of ``Modes``."""
    event = _EVENT.match(field)
    if event is not None:
        return "events", int(event[1])
    owner, _, name = field.partition(".")
    if owner == "Modes":
        return "modes", name
    known = [name for name in _PLACES if field.startswith(name)]
    return _PLACES[known[0]] if known else ()
