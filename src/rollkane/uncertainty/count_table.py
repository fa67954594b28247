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

        Where members that have another number than most are worth 20 or fewer that are
        equally far away, it is drawn out to what so few tell of the probabilities of a
        larger and of a smaller one: where none differs, of one by 1. A mean is no less
        than the probability of one or more, whose interval does not reach below zero.

        Args:
            low: Student's lower end [1]; NaN: there is none.
            high: His upper end [1].
            level: Of confidence [1].

        Source: of a difference, Zou and Donner, Statistics in Medicine 27 (2008).
        """
        if self.counts is None or math.isnan(low):
            return low, high
        total, most = int(self.counts.sum()), int(np.argmax(self.counts))
        if self._rests_on_few:
            (up, above), (down, below) = (
                (_part(side, away, total, level), _middle(side, away, total))
                for side, away in self._sides
            )
            down *= most > 0  # nothing is less than none
            middle = most + above - below
            low = min(low, middle - math.hypot(above - up[0], down[1] - below))
            high = max(high, middle + math.hypot(up[1] - above, below - down[0]))
        some = probability_interval(self.at_least(1), total, level)[0]
        return max(low, float(some)), high

    @property
    def note(self) -> str:
        """What its interval supposes, as a sentence; "" where members tell enough."""
        if self.counts is None or not self._rests_on_few:
            return ""
        total, most = int(self.counts.sum()), int(np.argmax(self.counts))
        differ = total - int(self.counts[most])
        far = max(
            int(np.max(away[members > 0], initial=0)) for members, away in self._sides
        )
        seen = (
            f"{differ:,} of {total:,} members have another number than {most}, by up "
            f"to {far}: its interval supposes that none is farther away"
            if differ
            else f"all {total:,} members have {most}: its interval supposes that "
            "others are off by 1"
        )
        return f"{seen}, and holds less often where rare ones are"

    @property
    def _sides(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Members with a larger, and with a smaller number than most; how far away."""
        assert self.counts is not None
        away = np.arange(self.counts.size) - int(np.argmax(self.counts))
        sides = away > 0, away < 0
        return [(np.where(side, self.counts, 0), abs(away)) for side in sides]

    @property
    def _rests_on_few(self) -> bool:
        if self.counts is None or self.counts.size > MOST:
            return False
        return bool(few_hits(sum(_worth(*side)[0] for side in self._sides)))


def _worth(members: np.ndarray, away: np.ndarray) -> tuple[float, float]:
    """Of how many equal members the sum varies as much, and how far away they are.

    Source: Fay and Feuer, Statistics in Medicine 16 (1997), section 2.
    """
    far, square = float(members @ away), float(members @ away**2)
    return (far**2 / square, square / far) if far else (0.0, 1.0)


def _middle(members: np.ndarray, away: np.ndarray, total: int) -> float:
    return float(members @ away) / total


def _part(
    members: np.ndarray, away: np.ndarray, total: int, level: float
) -> np.ndarray:
    """What few members add to a mean: both ends.

    Of members that are unequally far away the sum varies as that of fewer, equal ones,
    which are told of. Chance may hold back one as large as the largest: mid-P intervals
    count half of one more, and that half is as far away (Tiwari, Clegg and Zou,
    Statistical Methods in Medical Research 15, 2006).

    Args:
        members: How many, by their number.
        away: By how much each number is away from the most frequent one.
        total: Of all members.
        level: Of confidence [1].
    """
    worth, size = _worth(members, away)
    low = size * _hits_end(worth, total, level, 0)
    seen = np.flatnonzero(members * away)
    largest = np.arange(members.size) == seen[np.argmax(away[seen])] if seen.size else 0
    if seen.size:
        worth, size = _worth(members + 0.5 * largest, away)
        worth -= 0.5
    return np.array([low, size * _hits_end(worth, total, level, 1)])


def _hits_end(hits: float, total: int, level: float, end: int) -> float:
    """An end of a probability's interval [1], between those of whole hits."""
    whole = np.array([math.floor(hits), math.ceil(hits)])
    ends = probability_interval(whole, total, level)[end]
    return float(ends[0] + (hits - whole[0]) * (ends[1] - ends[0]))


def note_of(tables: Sequence[CountTable], whole: bool) -> str:
    """What intervals of entries of one name suppose, "" for nothing: the first note."""
    counts = (x for x in tables if whole or x.distinct > 1)
    return next((x.note for x in counts if x.note), "")


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
