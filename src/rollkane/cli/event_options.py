"""Events on the command line: which of them end a run, and what is told of them."""

from collections.abc import Iterator, Sequence
from typing import Any

import click

_LIFT_OFF = "lift-off"
_SHOWN = 4


def watched(file: Any, stop: Sequence[str]) -> dict[str, Any]:
    """Options of ``rollkane.simulate``: events of a scene file, and those that end it.

    Args:
        file: The scene file.
        stop: Names of its events, or ``"lift-off"``.

    Raises:
        click.UsageError: another name.
    """
    named = {event.name: event for event in file.events}
    known = (*named, *(() if _LIFT_OFF in named else (_LIFT_OFF,)))
    for name in stop:
        if name not in known:
            listed = ", ".join(known)
            raise click.UsageError(f"--stop: there is no event {name!r}; use {listed}")
    rest = tuple(event for event in file.events if event.name not in stop)
    ending = tuple(named.get(name, name) for name in dict.fromkeys(stop))
    return {"events": rest, "stop": ending or None}


def ended(result: Any) -> bool:
    """Whether a run came to its end, or to the one that an event was to make."""
    from ..validation.codes import Code  # not before JAX is set up

    return int(result.code) in (Code.COMPLETED, Code.STOPPED)


def event_lines(result: Any) -> Iterator[str]:
    """What a run found of each event, in lines."""
    found: dict[str, Any] = result.events or {}
    for name, crossings in found.items():
        count = int(crossings.count)
        times = ", ".join(f"{float(t):.6g}" for t in crossings.times[:_SHOWN])
        more = ", ..." if count > _SHOWN else ""
        at = f" at {times}{more} s" if count else ""
        yield f"  {f'event {name}':<17} {count} time{'' if count == 1 else 's'}{at}"
    if int(result.code) and ended(result):
        yield f"  {'stopped':<18}at {float(result.final_time):.6g} s, by an event"
