"""Quantiles of a stream of values in bounded memory, with a known error of rank."""

import dataclasses
import functools
import math

import numpy as np

from .intervals import quantile_ranks


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
        lowest: Of all values; infinite without any.
        highest: Of all values.

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
        if not values.size:
            return self
        found, held = self, sum(piece.size for piece in self.recent)
        lowest = min(self.lowest, float(values.min()))
        highest = max(self.highest, float(values.max()))
        while held + values.size >= self.size:
            taken, values = np.split(values, [self.size - held])
            buffer = np.sort(np.concatenate([*found.recent, taken]))
            found = dataclasses.replace(found._carried(buffer, 0), recent=())
            held = 0
        recent = (*found.recent, values.copy()) if values.size else found.recent
        count = sum(piece.size for piece in recent) + found._stored
        return dataclasses.replace(
            found, recent=recent, count=count, lowest=lowest, highest=highest
        )

    def merge(self, other: "QuantileSketch") -> "QuantileSketch":
        """The sketch of the values of two, with buffers of one size."""
        found = dataclasses.replace(
            self,
            count=self.count + other.count,
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
    def _stored(self) -> int:
        """Values that the buffers stand for."""
        full = (j for j, buffer in enumerate(self.levels) if buffer is not None)
        return sum(self.size << j for j in full)

    def _carried(self, buffer: np.ndarray, level: int) -> "QuantileSketch":
        """With one more buffer, merged upwards while its level is taken."""
        missing = level + 1 - len(self.levels)
        levels = [*self.levels, *[None] * missing]
        turns = [*self.turns, *[0] * missing]
        above, below = self.above, self.below
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
            self, levels=tuple(levels), turns=tuple(turns), above=above, below=below
        )

    @functools.cached_property
    def _ranked(self) -> tuple[np.ndarray, np.ndarray]:
        """All that is kept, sorted, and the rank that each is told to have."""
        parts = [(j, x) for j, x in enumerate(self.levels) if x is not None]
        values = np.concatenate([*self.recent, *(x for _, x in parts)])
        weights = np.ones(values.size, np.int64)
        first = values.size - self.size * len(parts)
        for k, (j, _) in enumerate(parts):
            weights[first + k * self.size :][: self.size] = 1 << j
        order = np.argsort(values, kind="stable")
        return values[order], np.cumsum(weights[order])

    def quantile(self, q: float, level: float = 0.95) -> tuple[float, float, float]:
        """A quantile and its interval.

        Args:
            q: Which, between 0 and 1 [1].
            level: Of confidence [1].

        Returns:
            The value of rank ``ceil(q n)`` (off by ``above`` and ``below`` ranks at
            most), and the ends of an interval: order statistics that hold the quantile
            of the distribution with the level, moved outwards by these ranks. An end is
            infinite where there are too few values for it; all are NaN for none.
        """
        if not self.count:
            return math.nan, math.nan, math.nan
        values, ranks = self._ranked
        last = values.size - 1
        wanted = min(max(math.ceil(q * self.count), 1), self.count)
        value = values[min(np.searchsorted(ranks, wanted), last)]
        lower, upper = quantile_ranks(q, self.count, level)
        # the largest value whose rank is surely no more, the least surely no less
        k = int(np.searchsorted(ranks, lower - self.below, side="right")) - 1
        low = values[k] if k >= 0 else self.lowest
        k = int(np.searchsorted(ranks, upper + self.above))
        high = values[k] if k <= last else self.highest
        low = low if lower >= 1 else -math.inf
        high = high if upper <= self.count else math.inf
        return float(value), float(low), float(high)
