"""Histograms of a stream: with given bins, or with bins that grow as values come."""

import dataclasses
import math
from typing import NamedTuple

import numpy as np

BINS = 128  # at most, of a histogram that chooses its own
_FIRST = 64  # at most of them for the first values
_FINEST = 45  # halvings of the values' size: bins no narrower, so places are exact


class Counted(NamedTuple):
    """A histogram.

    Attributes:
        edges: Of the bins, increasing [the value's unit], shape (B + 1,).
        counts: Values in each bin, its left edge included, shape (B,); the last of
            given bins has its right edge, too.
        below: Values below the first edge.
        above: Values above the last.
    """

    edges: np.ndarray
    counts: np.ndarray
    below: int
    above: int


@dataclasses.dataclass(frozen=True, eq=False)
class FixedHistogram:
    """With bins that are given.

    Attributes:
        edges: Increasing, shape (B + 1,).
        counts: Below, in each bin, and above, shape (B + 2,).
    """

    edges: np.ndarray
    counts: np.ndarray

    @classmethod
    def of_nothing(cls, edges: np.ndarray) -> "FixedHistogram":
        """Of no values."""
        return cls(edges, np.zeros(len(edges) + 1, np.int64))

    def add(self, values: np.ndarray) -> "FixedHistogram":
        """With more values, finite ones, shape (n,)."""
        place = np.searchsorted(self.edges, values, side="right")
        place = np.where(values == self.edges[-1], len(self.edges) - 1, place)
        found = np.bincount(place, minlength=len(self.counts))
        return FixedHistogram(self.edges, self.counts + found)

    @property
    def counted(self) -> Counted:
        """Edges and counts."""
        below, *_, above = self.counts.tolist()
        return Counted(self.edges, self.counts[1:-1], below, above)


@dataclasses.dataclass(frozen=True, eq=False)
class GrowingHistogram:
    """With bins of one width, doubled whenever a value would need more than 128.

    Bins lie between multiples of their width, a power of two, so two of them make one
    of the next width without any remainder, and the counts are what they would be if
    all values had come at once. The first values choose the width.

    Attributes:
        width: Of a bin; 0 before the first value.
        first: The first bin is from ``first * width`` on.
        counts: Shape (B,).
    """

    width: float = 0.0
    first: int = 0
    counts: np.ndarray = dataclasses.field(
        default_factory=lambda: np.zeros(0, np.int64)
    )

    def add(self, values: np.ndarray) -> "GrowingHistogram":
        """With more values, finite ones, shape (n,)."""
        if not values.size:
            return self
        low, high = float(values.min()), float(values.max())
        if self.counts.size:
            # the middles of the outer bins, as an edge belongs to the bin above it
            low = min(low, (self.first + 0.5) * self.width)
            high = max(high, (self.first + self.counts.size - 0.5) * self.width)
        width = _width(low, high, self.width, BINS if self.width else _FIRST)
        first = math.floor(low / width)
        counts = np.zeros(math.floor(high / width) - first + 1, np.int64)
        if self.counts.size:
            halvings = min(round(math.log2(width) - math.log2(self.width)), 62)
            places = self.first + np.arange(self.counts.size, dtype=np.int64)
            np.add.at(counts, (places >> halvings) - first, self.counts)
        places = np.floor(values / width).astype(np.int64) - first
        counts += np.bincount(places, minlength=counts.size)
        return GrowingHistogram(width, first, counts)

    @property
    def counted(self) -> Counted:
        """Edges and counts; no value lies outside."""
        edges = (self.first + np.arange(self.counts.size + 1)) * self.width
        return Counted(edges, self.counts, 0, 0)


def _width(low: float, high: float, least: float, bins: int) -> float:
    """The least power of two, and multiple of the width before, that needs few bins."""
    size = max(abs(low), abs(high), 1e-290)
    finest = 2.0 ** (math.frexp(size)[1] - _FINEST)
    spread = high / bins - low / bins
    if spread > 0.0:
        finest = max(finest, 2.0 ** (math.frexp(spread)[1] - 1))
    width = max(finest, least)
    while math.floor(high / width) - math.floor(low / width) >= bins:
        width *= 2.0
    return width
