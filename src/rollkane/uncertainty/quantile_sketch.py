"""Quantiles of a stream of values in bounded memory, with a known error of rank."""

import dataclasses
import functools
import math

import numpy as np

from .intervals import of_replicates, quantile_ranks, student_quantile

# Of fewer members beyond a quantile shares over groups are too far from normal.
_RARE = 20


@dataclasses.dataclass(frozen=True, eq=False)
class QuantileSketch:
    """Values of which, once they are many, every second of a sorted buffer is kept.

    Buffers of ``size`` values are sorted; two of one level are merged, and every second
    value of the two goes to the level above, where it stands for twice as many. A level
    keeps even and odd places in turn: even ones may only raise the rank of a number,
    odd ones only lower it, by no more than what one value stands for. The two sums of
    that, ``above`` and ``below``, bound the error of every rank; they are exact in the
    sense that no order of the values makes it larger. Nothing is random, and buffers
    hold values in the order in which they came: how they were handed over in pieces
    does not matter.

    Attributes:
        size: Values of a buffer, even. Up to twice as many are kept exactly.
        count: Values so far.
        recent: Those that fill no buffer yet, in pieces.
        levels: Sorted buffers of shape (size,) or None; a value of level j stands for
            2^j.
        turns: How many times each level was merged.
        above: By how much a rank that is told may be too large [values].
        below: By how much it may be too small [values].
        lowest: Of the values that filled buffers; infinite without any.
        highest: Of the same.

    Source: Manku, Rajagopalan and Lindsay, Approximate medians and other quantiles in
    one pass and with limited memory, SIGMOD 1998; Munro and Paterson, Selection and
    sorting with limited storage, Theoretical Computer Science 12 (1980).
    """

    size: int
    count: int = 0
    recent: tuple[np.ndarray, ...] = ()
    levels: tuple[np.ndarray | None, ...] = ()
    turns: tuple[int, ...] = ()
    above: int = 0
    below: int = 0
    lowest: float = math.inf
    highest: float = -math.inf

    def add(self, values: np.ndarray) -> "QuantileSketch":
        """The sketch of more values, finite ones, shape (n,)."""
        found, held, recent = self, self.count % self.size, self.recent
        count = self.count + values.size
        while held + values.size >= self.size:
            taken, values = np.split(values, [self.size - held])
            found = found._carried(np.sort(np.concatenate([*recent, taken])), 0)
            held, recent = 0, ()
        if values.size:
            recent = (*recent, values.copy())
        return QuantileSketch(
            self.size, count, recent, found.levels, found.turns, *found._bounds
        )

    def merge(self, other: "QuantileSketch") -> "QuantileSketch":
        """The sketch of the values of two, with buffers of one size."""
        found = dataclasses.replace(
            self,
            count=self.count + other.count - other.count % other.size,
            above=self.above + other.above,
            below=self.below + other.below,
            lowest=min(self.lowest, other.lowest),
            highest=max(self.highest, other.highest),
        )
        for level, buffer in enumerate(other.levels):
            if buffer is not None:
                found = found._carried(buffer, level)
        return found.add(np.concatenate([np.zeros(0), *other.recent]))

    @property
    def _bounds(self) -> tuple[int, int, float, float]:
        return self.above, self.below, self.lowest, self.highest

    @property
    def extremes(self) -> tuple[float, float]:
        """Smallest and largest of all values, infinite without any."""
        recent = [*self.recent, np.array([self.lowest, self.highest])]
        return min(float(x.min()) for x in recent), max(float(x.max()) for x in recent)

    def _carried(self, buffer: np.ndarray, level: int) -> "QuantileSketch":
        """With one more buffer, merged upwards while its level is taken."""
        missing = level + 1 - len(self.levels)
        levels = [*self.levels, *[None] * missing]
        turns = [*self.turns, *[0] * missing]
        above, below = self.above, self.below
        lowest = min(self.lowest, float(buffer[0]))
        highest = max(self.highest, float(buffer[-1]))
        while (other := levels[level]) is not None:
            both = np.sort(np.concatenate([other, buffer]), kind="stable")
            odd = turns[level] % 2
            buffer = both[odd::2].copy()
            above, below = above + (1 - odd << level), below + (odd << level)
            levels[level] = None
            turns[level] += 1
            level += 1
            if level == len(levels):
                levels.append(None)
                turns.append(0)
        levels[level] = buffer
        return dataclasses.replace(
            self,
            levels=tuple(levels),
            turns=tuple(turns),
            above=above,
            below=below,
            lowest=lowest,
            highest=highest,
        )

    @functools.cached_property
    def kept(self) -> tuple[np.ndarray, np.ndarray]:
        """All values that are kept, sorted, and how many each stands for."""
        parts = [(j, x) for j, x in enumerate(self.levels) if x is not None]
        values = np.concatenate([np.zeros(0), *self.recent, *(x for _, x in parts)])
        weights = np.ones(values.size, np.int64)
        first = values.size - self.size * len(parts)
        for k, (j, _) in enumerate(parts):
            weights[first + k * self.size :][: self.size] = 1 << j
        order = np.argsort(values, kind="stable")
        return values[order], weights[order]

    def share_below(self, value: float) -> float:
        """The share of values that are not above one, as far as is known [1]."""
        values, weights = self.kept
        place = int(np.searchsorted(values, value, side="right"))
        return float(weights[:place].sum() / max(self.count, 1))

    def quantile(self, q: float, level: float = 0.95) -> tuple[float, float, float]:
        """A quantile and its interval; see :meth:`GroupedSketch.quantile`."""
        return GroupedSketch((self,)).quantile(q, level)


@dataclasses.dataclass(frozen=True, eq=False)
class GroupedSketch:
    """Values of independent groups, each in a sketch of its own.

    Attributes:
        parts: One for each group; a single one for a plain sample.
    """

    parts: tuple[QuantileSketch, ...]

    @classmethod
    def of_nothing(cls, groups: int, size: int) -> "GroupedSketch":
        """Of no values, with buffers of so many values for each group."""
        return cls((QuantileSketch(size),) * groups)

    def add(self, values: np.ndarray, groups: np.ndarray) -> "GroupedSketch":
        """With more values, finite ones, and the group of each, shape (n,)."""
        if len(self.parts) == 1:
            return GroupedSketch((self.parts[0].add(values),))
        # by radix, which a narrow type is sorted by
        values = values[np.argsort(groups.astype(np.uint16), kind="stable")]
        ends = np.cumsum(np.bincount(groups, minlength=len(self.parts)))
        own = np.split(values, ends[:-1])
        return GroupedSketch(tuple(map(QuantileSketch.add, self.parts, own)))

    @property
    def above(self) -> int:
        """By how much a rank among all values may be too large when told [values]."""
        return sum(part.above for part in self.parts)

    @property
    def below(self) -> int:
        """By how much it may be too small [values]."""
        return sum(part.below for part in self.parts)

    @property
    def count(self) -> int:
        """Values so far."""
        return sum(part.count for part in self.parts)

    @functools.cached_property
    def _ranked(self) -> tuple[np.ndarray, np.ndarray]:
        """All that is kept, sorted, and the rank that each is told to have."""
        values, weights = (
            np.concatenate(x) for x in zip(*(p.kept for p in self.parts), strict=True)
        )
        order = np.argsort(values, kind="stable")
        return values[order], np.cumsum(weights[order])

    def quantile(self, q: float, level: float = 0.95) -> tuple[float, float, float]:
        """A quantile and its interval.

        The interval's ends are order statistics, moved outwards by ``above`` and
        ``below`` ranks. Of a plain sample they hold the distribution's quantile with
        the level whatever the distribution is. Of groups they are the ranks of
        Student's interval for the share of members below the quantile, over the
        groups; where 20 members or fewer are expected beyond it, or groups all agree,
        those of a plain sample.

        Args:
            q: Which, between 0 and 1 [1].
            level: Of confidence [1].

        Returns:
            The value of rank ``ceil(q n)`` (off by ``above`` and ``below`` ranks at
            most), and both ends. An end is infinite where there are too few values
            for it; all are NaN for none.

        Source: Woodruff, Confidence intervals for medians and other position measures,
        Journal of the American Statistical Association 47 (1952).
        """
        if not self.count:
            return math.nan, math.nan, math.nan
        values, ranks = self._ranked
        last = values.size - 1
        wanted = min(max(math.ceil(q * self.count), 1), self.count)
        value = float(values[min(int(np.searchsorted(ranks, wanted)), last)])
        lower, upper = self._rank_interval(q, value, level)
        # the largest value whose rank is surely no more, the least surely no less
        k = int(np.searchsorted(ranks, lower - self.below, side="right")) - 1
        low = values[k] if k >= 0 else min(p.extremes[0] for p in self.parts)
        k = int(np.searchsorted(ranks, upper + self.above))
        high = values[k] if k <= last else max(p.extremes[1] for p in self.parts)
        low = low if lower >= 1 else -math.inf
        high = high if upper <= self.count else math.inf
        return value, float(low), float(high)

    def _rank_interval(self, q: float, value: float, level: float) -> tuple[int, int]:
        plain = quantile_ranks(q, self.count, level)
        counts = np.array([part.count for part in self.parts])
        some = counts >= max(1.0, 0.5 * counts.max())
        groups = int(some.sum())
        if groups < 2 or min(q, 1.0 - q) * self.count <= _RARE:
            return plain
        shares = np.array([part.share_below(value) for part in self.parts])
        _, error = of_replicates(shares, np.where(some, counts, 0))
        half = self.count * student_quantile(level, groups - 1) * float(error)
        if half == 0.0:
            return plain
        middle = self.count * q
        return max(math.floor(middle - half), 0), math.ceil(middle + half) + 1
