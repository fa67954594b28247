"""What a sweep found at its points, as columns of a table and over time."""

import warnings
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from ..files.export_events import variable_of
from ..validation.codes import Code
from .sweep_points import Varied

_AXES = {3: "xyz", 4: "wxyz"}
_NOT_RUN = "not run"


class Swept(NamedTuple):
    """What a sweep found at N points.

    Attributes:
        over: What varied.
        time: Output times [s], shape (T,); None where points have times of their own.
        observed: By name, shape (N, T, ...), NaN where not reached; nothing where
            points have times of their own.
        told: Of each observed number its last value, the least and the greatest, shape
            (N,) each.
        events: How often each happened and when first [s], shape (N,) each.
        outcome: Why each motion ended, shape (N,); ``"not run"`` of those that Ctrl-C
            left out.
        final_time: [s], shape (N,).
        ended: Whether each came to its end, or to an event that was to end it.
        loops: Which loops ran, and why.
    """

    over: Sequence[Varied]
    time: Any
    observed: dict[str, Any]
    told: dict[str, Any]
    events: dict[str, Any]
    outcome: Any
    final_time: Any
    ended: Any
    loops: list[str]

    @property
    def columns(self) -> dict[str, Any]:
        """The table, shape (N,) each: what varied, what is told, how it ended."""
        values = np.meshgrid(*(one.values for one in self.over), indexing="ij")
        found: dict[str, Any] = {
            one.path: x.ravel() for one, x in zip(self.over, values, strict=True)
        }
        return found | self.told | self.events | self.ends

    @property
    def ends(self) -> dict[str, Any]:
        """When and why each motion ended."""
        return {"final_time": self.final_time, "outcome": self.outcome}

    @property
    def not_run(self) -> int:
        """How many Ctrl-C left out."""
        return int((self.outcome == _NOT_RUN).sum())


def joined(
    over: Sequence[Varied],
    time: Any,
    count: int,
    done: Sequence[tuple[Any, Any]],
    observe: Any,
) -> Swept:
    """Blocks, each with the numbers of its points, as what the sweep found.

    Args:
        over: What varied.
        time: Output times of all points [s], or None.
        count: How many points there are.
        done: Numbers of points, and the block that has them.
        observe: The function by which the blocks were observed.
    """
    outcome = np.full(count, _NOT_RUN, dtype=object)
    final_time, ended = np.full(count, np.nan), np.zeros(count, bool)
    told: dict[str, Any] = {}
    events: dict[str, Any] = {}
    observed: dict[str, Any] = {}
    loops: set[str] = set()

    def put(where: dict[str, Any], places: Any, found: dict[str, Any]) -> None:
        for name, x in found.items():
            whole = where.setdefault(name, np.full((count, *x.shape[1:]), np.nan))
            whole[places] = x

    for places, block in done:
        outcome[places], final_time[places] = block.outcomes, block.final_time
        ended[places] = np.isin(block.code, (Code.COMPLETED, Code.STOPPED))
        loops.add(f"{block.method}{': ' if block.why else ''}{block.why}")
        put(told, places, _told(block, observe))
        put(events, places, _events_of(block))
        if time is not None:
            put(observed, places, block.observed)
    return Swept(
        *(over, time, observed, told, events),
        *(outcome, final_time, ended, sorted(loops)),
    )


def _told(block: Any, observe: Any) -> dict[str, Any]:
    """Of each observed number its last value, the least and the greatest.

    A motion that an event was to end has its last value there, between two outputs.
    """
    last = {name: x[:, -1] for name, x in block.observed.items()}
    stopped = block.code == Code.STOPPED
    if stopped.any():
        at_end = block.final.each(observe)
        for name, x in last.items():
            here = stopped.reshape(-1, *[1] * (x.ndim - 1))
            last[name] = np.where(here, at_end[name], x)
    found: dict[str, Any] = {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of those without any
        for name, x in block.observed.items():
            every = np.concatenate([x, last[name][:, None]], axis=1)
            least, most = np.nanmin(every, axis=1), np.nanmax(every, axis=1)
            for part, at in _parts(name, x.shape[2:]):
                found[f"{part}_last"] = last[name][at]
                found[f"{part}_min"] = least[at]
                found[f"{part}_max"] = most[at]
    return found


def _parts(name: str, shape: tuple[int, ...]) -> list[tuple[str, Any]]:
    """Names of numbers and where they stand: components of vectors by their axes."""
    if not shape:
        return [(name, ...)]
    return [(f"{name}_{axis}", (..., k)) for k, axis in enumerate(_AXES[shape[0]])]


def _events_of(block: Any) -> dict[str, Any]:
    """How often each event happened, and when first [s]; NaN where it did not."""
    found: dict[str, Any] = {}
    for event, crossings in block.events.items():
        name = variable_of(event)
        found[f"{name}_count"] = np.asarray(crossings.count)
        found[f"{name}_time"] = np.asarray(crossings.times)[:, 0]
    return found
