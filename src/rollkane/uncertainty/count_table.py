"""How many members have each whole number: of events that are counted."""

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from .intervals import few_hits, probability_interval

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

    @property
    def distinct(self) -> int:
        """How many different numbers there are; 0 of what is no count."""
        return 0 if self.counts is None else int((self.counts > 0).sum())

    def at_least(self, number: int) -> int:
        """Members with so many or more, of a table that is still kept."""
        return 0 if self.counts is None else int(self.counts[number:].sum())

    def mean_interval(
        self, low: float, high: float, level: float
    ) -> tuple[float, float]:
        """Student's interval of the mean, right where few members tell of it.

        Where 20 members or fewer have another number than most, it is drawn out to what
        so few tell of the probabilities of a larger and of a smaller one: where none
        differs, of one by 1. A mean is no less than the probability of one or more,
        whose interval does not reach below zero.

        Args:
            low: Student's lower end [1]; NaN: there is none.
            high: His upper end [1].
            level: Of confidence [1].
        """
        if self.counts is None or math.isnan(low):
            return low, high
        total, most = int(self.counts.sum()), int(np.argmax(self.counts))
        away = np.arange(self.counts.size) - most
        sides = [np.where(side, self.counts, 0) for side in (away > 0, away < 0)]
        if few_hits(sum(side.sum() for side in sides)) and self.counts.size <= MOST:
            up, down = (_part(side, abs(away), total, level) for side in sides)
            down *= most > 0  # nothing is less than none
            low = min(low, most + up[0] - down[1])
            high = max(high, most + up[1] - down[0])
        some = probability_interval(self.at_least(1), total, level)[0]
        return max(low, float(some)), high


def _part(
    members: np.ndarray, away: np.ndarray, total: int, level: float
) -> np.ndarray:
    """What few members add to a mean: both ends.

    Of members that are unequally far away the sum varies as that of fewer, equal ones
    (Fay and Feuer, Statistics in Medicine 16, 1997, section 2): so many are told of.

    Args:
        members: How many, by their number.
        away: By how much each number is away from the most frequent one.
        total: Of all members.
        level: Of confidence [1].
    """
    far, square = int(members @ away), int(members @ away**2)
    worth = far**2 // square if far else 0
    ends = np.array(probability_interval(worth, total, level))
    return ends * (far / worth if far else 1.0)


def of_counts(
    tables: Sequence[CountTable],
    whole: bool,
    low: np.ndarray,
    high: np.ndarray,
    level: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Intervals of means, of counts as :meth:`CountTable.mean_interval` has them.

    Args:
        tables: Of entries of one name.
        whole: Whether they are of a type of whole numbers; of others, a single number
            does not tell that it counts.
        low: Student's lower ends, of as many.
        high: His upper ends.
        level: Of confidence [1].
    """
    low, high = low.copy(), high.copy()
    for k, table in enumerate(tables):
        if whole or table.distinct > 1:
            ends = float(low[k]), float(high[k])
            low[k], high[k] = table.mean_interval(*ends, level)
    return low, high
