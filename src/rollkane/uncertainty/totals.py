"""Everything that is kept of a stream of members: sums, sketches and tables."""

import dataclasses
import itertools
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from ..validation.checks import FieldError
from .count_table import CountTable
from .group_totals import GroupTotals, Replicates
from .histogram import FixedHistogram, GrowingHistogram
from .moments import JointMoments, Moments
from .quantile_sketch import GroupedSketch

# Entries of which covariances are kept: products of more would cost more than motions.
JOINTLY = 256
# Values in all buffers of one level together (8 MB), in one of them at most and least.
_BUFFERED, _LARGEST, _SMALLEST = 1 << 20, 1 << 15, 1 << 6
# Groups that have sketches of their own, at most.
_MOST_PARTS = 64


class Name(NamedTuple):
    """Where values of one name stand among the entries of its kind.

    Attributes:
        shape: Of one member's value.
        truth: Whether it is true or false; a number otherwise.
        where: Its entries.
        whole: Whether it is of a type of whole numbers.
    """

    shape: tuple[int, ...]
    truth: bool
    where: slice
    whole: bool


@dataclasses.dataclass(frozen=True)
class Layout:
    """What each member gives.

    Attributes:
        names: By name, in the order of the first members.
        edges: Of histograms with given bins, by the label of an entry.
    """

    names: dict[str, Name]
    edges: dict[str, np.ndarray]

    @classmethod
    def of(cls, values: Mapping[str, Any], edges: Mapping[str, np.ndarray]) -> "Layout":
        """Of the first members' values.

        Raises:
            FieldError: values that are neither truth values nor real numbers, or
                edges for what is not there.
        """
        names: dict[str, Name] = {}
        ends = {True: 0, False: 0}
        for name, given in values.items():
            array = np.asarray(given)
            if array.dtype.kind not in "biuf":
                remedy = "give arrays of truth values or real numbers, members first"
                raise FieldError(f"values[{name!r}]", given, "has another type", remedy)
            truth, shape = array.dtype.kind == "b", array.shape[1:]
            first = ends[truth]
            ends[truth] += int(np.prod(shape, dtype=int))
            where, whole = slice(first, ends[truth]), array.dtype.kind in "iu"
            names[name] = Name(shape, truth, where, whole)
        found = cls(names, dict(edges))
        for label in edges:
            if label not in found.labels(truth=False):
                remedy = f"give labels among {found.labels(truth=False)}"
                raise FieldError("edges", label, "are for no number", remedy)
        return found

    def labels(self, truth: bool) -> list[str]:
        """Of all truth values, or of all numbers: "end[0]" of a vector's first."""
        return [
            text
            for name, entry in self.names.items()
            if entry.truth == truth
            for text in labels(name, entry.shape)
        ]

    def rows(
        self, values: Mapping[str, np.ndarray], truth: bool, count: int
    ) -> np.ndarray:
        """Entries of one kind of so many members, shape (n, D)."""
        dtype = bool if truth else np.float64
        parts = [
            np.asarray(values[name], dtype).reshape(
                count, entry.where.stop - entry.where.start
            )
            for name, entry in self.names.items()
            if entry.truth == truth
        ]
        return np.concatenate([np.zeros((count, 0), dtype), *parts], axis=1)


def labels(name: str, shape: tuple[int, ...]) -> list[str]:
    """Of the entries of a value: the name itself, or with places in brackets."""
    if not shape:
        return [name]
    places = itertools.product(*map(range, shape))
    return [f"{name}[{','.join(map(str, place))}]" for place in places]


class Piece(NamedTuple):
    """Some members in order.

    Attributes:
        numbers: Shape (n, D).
        truths: Shape (n, B).
        valid: Which did not fail, shape (n,).
        groups: Shape (n,).
    """

    numbers: np.ndarray
    truths: np.ndarray
    valid: np.ndarray
    groups: np.ndarray

    def part(self, where: slice) -> "Piece":
        """Some of them."""
        return Piece(*(array[where] for array in self))


def joined(pieces: list[Piece]) -> Piece:
    """Pieces one behind the other."""
    return Piece(*(np.concatenate(arrays) for arrays in zip(*pieces, strict=True)))


@dataclasses.dataclass(frozen=True, eq=False)
class Totals:
    """What is kept of all members so far: nothing grows with their number but a log.

    Attributes:
        members: All of them.
        failed: Those that are left out.
        moments: Of numbers.
        joint: Of numbers together; None where they are too many.
        hits: How often truth values were true, shape (B,).
        groups: Of numbers and, behind them, truth values; None for plain samples.
        sketches: One for each number.
        histograms: One for each number.
        tables: One for each number.
    """

    members: int
    failed: int
    moments: Moments
    joint: JointMoments | None
    hits: np.ndarray
    groups: GroupTotals | None
    sketches: tuple[GroupedSketch, ...]
    histograms: tuple[FixedHistogram | GrowingHistogram, ...]
    tables: tuple[CountTable, ...]

    @classmethod
    def of_nothing(cls, layout: Layout, group_count: int | None) -> "Totals":
        """Of no members."""
        numbers, truths = layout.labels(truth=False), layout.labels(truth=True)
        size = len(numbers)
        parts = 1 if group_count is None or group_count > _MOST_PARTS else group_count
        buffer = _buffer(size, parts)
        count = size + len(truths)
        edges = [layout.edges.get(label) for label in numbers]
        return cls(
            members=0,
            failed=0,
            moments=Moments.of_nothing(size),
            joint=JointMoments.of_nothing(size) if size <= JOINTLY else None,
            hits=np.zeros(len(truths), np.int64),
            groups=None
            if group_count is None
            else GroupTotals.of_nothing(group_count, count),
            sketches=(GroupedSketch.of_nothing(parts, buffer),) * size,
            histograms=tuple(
                GrowingHistogram() if x is None else FixedHistogram.of_nothing(x)
                for x in edges
            ),
            tables=(CountTable(),) * size,
        )

    @property
    def shift(self) -> np.ndarray:
        """Of the sums of groups, shape (D + B,)."""
        return np.concatenate([self.moments.shift, np.zeros(len(self.hits))])

    def replicates(self, entry: Name) -> Replicates:
        """What groups say of the entries of a name."""
        offset = len(self.moments.shift) if entry.truth else 0
        where = slice(entry.where.start + offset, entry.where.stop + offset)
        if self.groups is None:
            nan = np.full(where.stop - where.start, np.nan)
            return Replicates(nan, nan, np.zeros(nan.shape, int))
        return Replicates(*(x[where] for x in self.groups.replicates(self.shift)))

    def add(self, piece: Piece) -> "Totals":
        """With more members."""
        numbers = np.ascontiguousarray(piece.numbers[piece.valid].T)
        truths = piece.truths[piece.valid]
        moments, groups = self.moments.add(numbers), self.groups
        if groups is not None:
            both = np.concatenate([numbers, truths.T.astype(float)])
            shift = np.concatenate([moments.shift, np.zeros(len(self.hits))])
            groups = groups.add(both, shift, piece.groups, piece.valid)
        finite = [np.isfinite(row) for row in numbers]
        rows = [row[good] for row, good in zip(numbers, finite, strict=True)]
        groups_of = piece.groups[piece.valid]
        joint = self.joint
        return Totals(
            members=self.members + len(piece.valid),
            failed=self.failed + int(np.sum(~piece.valid)),
            moments=moments,
            joint=None if joint is None else joint.add(numbers, moments.shift),
            hits=self.hits + truths.sum(axis=0),
            groups=groups,
            sketches=tuple(
                sketch.add(row, groups_of[good])
                for sketch, row, good in zip(self.sketches, rows, finite, strict=True)
            ),
            histograms=tuple(
                h.add(x) for h, x in zip(self.histograms, rows, strict=True)
            ),
            tables=tuple(map(CountTable.add, self.tables, rows)),
        )


def _buffer(entries: int, parts: int) -> int:
    """Values of a buffer of each sketch, a power of two."""
    most = min(_BUFFERED // max(entries * parts, 1), _LARGEST)
    return 1 << (max(most, _SMALLEST).bit_length() - 1)
