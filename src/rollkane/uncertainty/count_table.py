"""How many members have each whole number: of events that are counted."""

import dataclasses

import numpy as np

MOST = 1000  # larger numbers are counted together


@dataclasses.dataclass(frozen=True, eq=False)
class CountTable:
    """Members by their number, as long as all are whole and none is negative.

    Attributes:
        counts: Members with 0, 1, 2, ... up to 1000 (1000 and more), as far as there
            are any; None once a value was no such number.
    """

    counts: np.ndarray | None = dataclasses.field(
        default_factory=lambda: np.zeros(1, np.int64)
    )

    def add(self, values: np.ndarray) -> "CountTable":
        """With more values, finite ones, shape (n,)."""
        if self.counts is None or not values.size:
            return self
        if values.min() < 0.0 or np.any(values != np.rint(values)):
            return CountTable(None)
        places = np.minimum(values, MOST).astype(np.int64)
        found = np.bincount(places, minlength=self.counts.size)
        found[: self.counts.size] += self.counts
        return CountTable(found)

    def at_least(self, number: int) -> int:
        """Members with so many or more, of a table that is still kept."""
        return 0 if self.counts is None else int(self.counts[number:].sum())
