"""Statistics of a study's members, from what is kept of each."""

from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np

from .sampling import Sampler
from .statistics import Statistics
from .unit_runs import Column, Columns


class MemberStatistics:
    """Running statistics of blocks of members, in order.

    Of observables their values; of an event its name: whether it happened, ``NAME
    time``: when it first did [s], among those where it did, ``NAME count``: how often.
    Series are kept of every member, and have no running statistics.

    Attributes:
        running: The statistics.
        codes: How many members ended with each code.
        faults: How many with each code and fault.
    """

    def __init__(
        self, columns: Mapping[str, Column], ends: Sequence[int], sampler: Sampler
    ):
        """Of no members yet.

        Args:
            columns: What is kept of each member.
            ends: Codes of those that ended as they should.
            sampler: Which members are independent.
        """
        self.running = Statistics(sampler.group_count)
        self.codes: Counter[int] = Counter()
        self.faults: Counter[tuple[int, int]] = Counter()
        self._columns = dict(columns)
        self._ends, self._sampler = tuple(ends), sampler

    def good(self, columns: Columns) -> np.ndarray:
        """Which members ended as they should, shape (n,)."""
        return np.isin(columns["code"], self._ends)

    def add(self, first: int, columns: Columns) -> None:
        """Take a block in.

        Args:
            first: Number of its first member.
            columns: What is kept of each.
        """
        codes, faults = columns["code"].tolist(), columns["fault"].tolist()
        self.codes.update(codes)
        self.faults.update(zip(codes, faults, strict=True))
        groups = self._sampler.groups(first, len(codes))
        values = values_of(self._columns, columns)
        self.running.add(values, self.good(columns), groups)


def statistics_of(known: Mapping[str, Column]) -> tuple[str, ...]:
    """Names of what has a mean or a probability.

    Args:
        known: What is kept of each member.
    """
    nothing = {name: np.zeros((0, *c.shape), c.dtype) for name, c in known.items()}
    return tuple(values_of(known, nothing))


def values_of(known: Mapping[str, Column], columns: Columns) -> dict[str, np.ndarray]:
    """Values of members by the names that statistics have.

    Args:
        known: What is kept of each member.
        columns: Of some members.
    """
    found: dict[str, np.ndarray] = {}
    for name, column in known.items():
        kept = columns[name]
        if column.kind == "observed":
            found[name] = kept
        elif column.kind == "truth":
            found[name] = kept == 1.0
        elif column.kind == "count":
            event = name.removesuffix(".count")
            found[event] = kept > 0
            found[f"{event} time"] = columns[f"{event}.time"][:, 0]
            found[f"{event} count"] = kept
    return found
