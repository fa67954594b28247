"""What came out of a study."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ..validation.checks import FieldError
from ..validation.codes import Fields
from .histogram import Counted
from .member_statistics import MemberStatistics
from .sampling import sampler
from .store import Store, dimensions
from .unit_runs import Column, Columns

if TYPE_CHECKING:
    import xarray

_QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)


class Rates(NamedTuple):
    """What a call has computed.

    Attributes:
        members: Computed, not read from a store.
        seconds: That it took [s].
        method: ``"native"`` or ``"diffrax"``; empty where nothing was computed here.
        why: Why it was not the loop in C.
    """

    members: int = 0
    seconds: float = 0.0
    method: str = ""
    why: str = ""


class MonteCarlo:
    """Statistics of a study, and its members where they are kept.

    Statistics are those of :class:`Statistics`, by the names of observables and events:
    an event's own name is the truth of whether it happened, ``NAME time`` when it first
    did [s], ``NAME count`` how often. Members that failed are in none of them.

    Attributes:
        about: Provenance: digests of the study, seed, sampling, versions.
        columns: What is kept of each member, by name.
        times: Output times [s], shape (T,).
        store: Where the members are; None where they are in memory, or not kept.
        rates: What this call has computed.
        note: What a user should know of the samples, the store, or a precision that was
            not reached; None: nothing.
        complete: Whether every block is there, whole.
    """

    def __init__(
        self,
        statistics: MemberStatistics,
        columns: Mapping[str, Column],
        times: np.ndarray,
        about: Mapping[str, Any],
        store: Store | None = None,
        kept: list[Columns] | None = None,
        rates: Rates | None = None,
        note: str | None = None,
        complete: bool = True,
    ):
        """Of statistics that are complete; see the class."""
        self._of_members = statistics
        self.statistics = statistics.running
        self.about, self.columns, self.times = dict(about), dict(columns), times
        self.store, self._kept = store, kept
        self.rates, self.note = rates or Rates(), note
        self.complete = complete

    @property
    def has_members(self) -> bool:
        """Whether members are kept."""
        return self.store is not None or self._kept is not None

    @property
    def size(self) -> int:
        """Members that statistics are of, those that failed as well."""
        return sum(self._of_members.codes.values())

    @property
    def failed(self) -> int:
        """Members that failed."""
        return self.statistics.failed

    @property
    def codes(self) -> dict[int, int]:
        """How many members ended with each of :class:`Code`."""
        return dict(sorted(self._of_members.codes.items()))

    @property
    def reasons(self) -> dict[str, int]:
        """Why motions ended, and how many ended so."""
        known: Any = self.about["fields"]
        fields = Fields(tuple(known["names"]), int(known["of_model"]))
        faults = sorted(self._of_members.faults.items())
        return {fields.reason(*why): n for why, n in faults}

    @property
    def mean(self) -> dict[str, np.ndarray]:
        """Means by name [unit of each]."""
        return self.statistics.mean

    @property
    def standard_error(self) -> dict[str, np.ndarray]:
        """Standard errors of the means and probabilities by name."""
        return self.statistics.standard_error

    @property
    def standard_deviation(self) -> dict[str, np.ndarray]:
        """Standard deviations of members by name."""
        return self.statistics.standard_deviation

    @property
    def covariance(self) -> np.ndarray:
        """Of all numbers that ``statistics.names`` lists, together."""
        return self.statistics.covariance

    @property
    def probability(self) -> dict[str, Any]:
        """Of truth values and of events by name [1]."""
        return self.statistics.probability

    @property
    def quantiles(self) -> dict[str, dict[float, np.ndarray]]:
        """By name and probability: 5, 25, 50, 75 and 95 %."""
        names = self.statistics.mean
        return {
            name: {q: self.quantile(name, q)[0] for q in _QUANTILES} for name in names
        }

    def quantile(self, name: str, q: float, level: float = 0.95) -> Any:
        """A quantile and its interval, ``(value, low, high)``.

        Args:
            name: Of a number.
            q: Probability below it [1].
            level: Of confidence [1].
        """
        return self.statistics.quantile(name, q, level)

    def interval(self, name: str, level: float = 0.95) -> Any:
        """Interval of a mean or a probability, ``(low, high)``.

        Args:
            name: Of an observable or an event.
            level: Of confidence [1].
        """
        return self.statistics.interval(name, level)

    def at_least(self, event: str, count: int, level: float = 0.95) -> Any:
        """Probability that an event happens so often, ``(value, low, high)``.

        Args:
            event: Its name.
            count: How often, 1 or more.
            level: Of confidence [1].
        """
        return self.statistics.at_least(f"{event} count", count, level)

    def histogram(self, name: str) -> Counted:
        """Edges of bins, and how many members are in each.

        Args:
            name: Of a number, or of one entry (``"end[0]"``).
        """
        return self.statistics.histogram(name)

    def values(self, name: str) -> np.ndarray:
        """What is kept of all members, shape (N, ...); NaN where a motion failed.

        Args:
            name: One of ``columns``: an observable, a series, ``draw.NAME``,
                ``EVENT.count``, ``EVENT.time``, ``code``, ``final_time``.

        Raises:
            FieldError: no such column, or members were not kept.
        """
        if name not in self.columns:
            remedy = f"use one of {tuple(self.columns)}"
            raise FieldError("MonteCarlo.values", name, "is not kept", remedy)
        if self.store is not None:
            return self.store.values(name)
        if self._kept is None:
            remedy = "leave out keep=False, or give a store"
            raise FieldError("MonteCarlo.values", name, "was not kept", remedy)
        return np.concatenate([block[name] for block in self._kept])

    def to_xarray(self) -> "xarray.Dataset":
        """Members as an ``xarray.Dataset`` over ``member`` and ``time`` [s].

        Raises:
            FieldError: members were not kept.
        """
        if self.store is not None:
            return self.store.to_xarray()
        import xarray

        variables: dict[str, Any] = {}
        for name, column in self.columns.items():
            attributes = {"kind": column.kind}
            found = dimensions(name, column), self.values(name), attributes
            variables[name] = found
        return xarray.Dataset(variables, {"time": ("time", self.times, {"units": "s"})})

    def plot(self, path: str | os.PathLike[str] | None = None, title: str = "") -> Any:
        """Histograms, probabilities with their intervals, series as fans.

        Args:
            path: File to write, .png, .svg or .pdf; None for none.
            title: Above the figure.

        Returns:
            The matplotlib figure, or None where a file was written.
        """
        from ..pictures.plot_study import figure_study, plot_study

        if path is None:
            return figure_study(self, title)
        return plot_study(self, Path(path), title)

    def to_dict(self, level: float = 0.95) -> dict[str, Any]:
        """Statistics as plain numbers and lists, for JSON.

        Args:
            level: Of the intervals' confidence [1].
        """
        running = self.statistics
        either = (*running.numbers, *running.truths)
        return {
            "members": self.size,
            "failed": self.failed,
            "reasons": self.reasons,
            "mean": self.mean,
            "probability": self.probability,
            "standard_error": self.standard_error,
            "standard_deviation": self.standard_deviation,
            "interval": {name: self.interval(name, level) for name in either},
            "level": level,
            "minimum": running.minimum,
            "maximum": running.maximum,
            "quantiles": self.quantiles,
            "seconds": self.rates.seconds,
            "computed": self.rates.members,
            "note": self.note,
        }

    def __str__(self) -> str:
        """A table of the statistics, and why members failed."""
        lines = [str(self.statistics)]
        lines += [f"{n} x {why}" for why, n in self.reasons.items()]
        lines += [f"note: {self.note}"] if self.note else []
        return "\n".join(lines)


def read_study(path: str | os.PathLike[str]) -> MonteCarlo:
    """The study of a store, as far as it has come.

    Every block is checked against its checksum: Zarr gives fill values for one that is
    not there.

    Args:
        path: The store's folder.

    Returns:
        Statistics of all blocks that are there [unit of each observable]; ``note``
        says of those that are not.

    Raises:
        StoreError: no store of a study.
    """
    store = Store(path)
    about: Any = store.about
    samples = sampler(
        about["sampling"], about["dimension"], about["seed"], about["size"]
    )
    found = MemberStatistics(store.columns, about["ends"], samples)
    bad: list[str] = []
    absent = 0
    for k in range(store.block_count):
        problem = store.problem(k)
        if problem is None:
            found.add(store.span(k)[0], store.read(k))
        elif problem:
            bad.append(problem)
        else:
            absent += 1
    notes = [*bad]
    if absent:
        notes.append(f"{absent} of {store.block_count} blocks are not computed yet")
    note = "; ".join(notes) or samples.note
    times = np.asarray(store.times)
    whole = not notes
    return MonteCarlo(
        *(found, store.columns, times, about, store), note=note, complete=whole
    )
