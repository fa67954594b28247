"""Running statistics of many members, without keeping them."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from ..validation.checks import FieldError, whole
from .count_table import MOST, note_of, of_counts
from .histogram import Counted
from .intervals import checked_level, mean_half_width, probability_interval
from .statistics_checks import checked_block, checked_edges, checked_share
from .statistics_table import table
from .totals import Layout, Name, Piece, Totals, joined, labels

# Members are taken in pieces of so many, counted from the first: their sums do not
# depend on the blocks in which they come.
_PIECE = 4096


class Statistics:
    """Statistics of a stream of members, in memory that grows with its logarithm only.

    ``add`` takes blocks of members in order; everything else is read off at any time,
    from the members so far. Bit for bit it depends on these members and their order,
    not on the blocks. Truth values are told as probabilities, numbers as moments,
    quantiles and histograms, entry by entry for values with axes. Members that failed
    are counted and left out; a number that is not finite is counted as missing, and is
    left out by itself.

    Intervals hold for plain samples, whose members are independent. With groups
    (``group_count``: scrambles of a Sobol sequence, Latin sets), which are independent
    of each other but whose members are not, intervals of means and probabilities are
    Student's over the means of the groups that have at least half of the members of
    the largest; they need two of them. Fewer than 20 hits or misses, or groups that all
    agree, say too little for that: then a probability has the interval of a plain
    sample, which such designs only make wider than needed, and which is never of zero
    width. So it is with quantiles, of up to 64 groups. Means of groups of few members
    whose values are very skewed are no more normal than those of so few plain ones.

    Attributes:
        group_count: How many groups there are; None for a plain sample.
    """

    def __init__(
        self, group_count: int | None = None, edges: Mapping[str, Any] | None = None
    ):
        """No members yet.

        Args:
            group_count: How many independent groups members belong to; None: members
                are independent themselves.
            edges: Of histograms' bins, by the name of a number (``"end"``) or of an
                entry (``"end[0]"``) [its unit], increasing; others choose their own.

        Raises:
            FieldError: a count below 1, or edges that do not increase.
        """
        if group_count is not None:
            group_count = whole("group_count", group_count, 1, "give None or a number")
        self.group_count = group_count
        self._edges = checked_edges({} if edges is None else edges)
        self._layout = Layout({}, {})
        self._totals: Totals | None = None
        self._waiting: list[Piece] = []
        self._settled: Totals | None = None

    def add(self, values: Mapping[str, Any], valid: Any, groups: Any = None) -> None:
        """Take the next members.

        Args:
            values: By name, truth values or real numbers, shape (n, ...); the same
                names and shapes each time.
            valid: Which did not fail, shape (n,); values of others are not looked at.
            groups: Which group each belongs to, from 0, shape (n,); only with
                ``group_count``.

        Raises:
            FieldError: other names, shapes or types than before, or a group that does
                not exist.
        """
        layout, totals = self._layout, self._totals
        if totals is None:
            layout = Layout.of(values, self._edges)
            totals = Totals.of_nothing(layout, self.group_count)
        piece = checked_block(layout, self.group_count, values, valid, groups)
        self._layout, self._totals, self._settled = layout, totals, None
        self._waiting.append(piece)
        if sum(len(piece.valid) for piece in self._waiting) < _PIECE:
            return
        everything = joined(self._waiting)
        whole_pieces = len(everything.valid) // _PIECE
        for k in range(whole_pieces):
            part = everything.part(slice(k * _PIECE, (k + 1) * _PIECE))
            totals = totals.add(part)
        rest = everything.part(slice(whole_pieces * _PIECE, None))
        self._totals = totals
        self._waiting = [Piece(*(array.copy() for array in rest))]

    @property
    def _now(self) -> Totals:
        """With the members that fill no piece yet."""
        if self._totals is None:
            return Totals.of_nothing(self._layout, self.group_count)
        if self._settled is None:
            waiting = joined(self._waiting)
            some = len(waiting.valid) > 0
            self._settled = self._totals.add(waiting) if some else self._totals
        return self._settled

    @property
    def count(self) -> int:
        """Members that did not fail."""
        return self._now.members - self._now.failed

    @property
    def failed(self) -> int:
        """Members that failed."""
        return self._now.failed

    @property
    def numbers(self) -> tuple[str, ...]:
        """Names of what is a real number."""
        return tuple(n for n, x in self._layout.names.items() if not x.truth)

    @property
    def truths(self) -> tuple[str, ...]:
        """Names of what is true or false."""
        return tuple(n for n, x in self._layout.names.items() if x.truth)

    @property
    def names(self) -> tuple[str, ...]:
        """Labels of all entries that are numbers, as ``"end[0]"``."""
        return tuple(self._layout.labels(truth=False))

    def labels(self, name: str) -> tuple[str, ...]:
        """Labels of the entries of one name."""
        return tuple(labels(name, self._named(name).shape))

    @property
    def missing(self) -> dict[str, Any]:
        """Members that did not fail but have no finite number, by name."""
        return self._numbers(self.count - self._now.moments.count)

    @property
    def mean(self) -> dict[str, Any]:
        """Mean of each number [its unit], in its shape, NaN without any."""
        return self._numbers(self._now.moments.average)

    @property
    def standard_deviation(self) -> dict[str, Any]:
        """Standard deviation of each number (n - 1) [its unit]."""
        return self._numbers(self._now.moments.deviation)

    @property
    def minimum(self) -> dict[str, Any]:
        """Smallest value of each number [its unit], NaN without any."""
        return self._numbers(self._now.moments.least)

    @property
    def maximum(self) -> dict[str, Any]:
        """Largest value of each number [its unit], NaN without any."""
        return self._numbers(self._now.moments.most)

    @property
    def covariance(self) -> np.ndarray:
        """Covariance of all entries that are numbers, in the order of ``names``.

        Of the members that have them all, shape (D, D), in products of their units.

        Raises:
            FieldError: there are more than 256 entries.
        """
        joint = self._now.joint
        if joint is None:
            problem = "has too many entries: covariances of up to 256 are kept"
            remedy = "observe fewer numbers, or keep the members"
            raise FieldError("covariance", len(self.names), problem, remedy)
        return joint.covariance

    @property
    def probability(self) -> dict[str, Any]:
        """Share of members for which each truth value is true [1], NaN without any."""
        share = self._now.hits / self.count if self.count else self._now.hits * np.nan
        return {n: self._shaped(n, share) for n in self.truths}

    @property
    def standard_error(self) -> dict[str, Any]:
        """Standard error of each mean [its unit] and of each probability [1].

        Over the means of groups, where there are any.
        """
        now = self._now
        found: dict[str, Any] = {}
        for name, entry in self._layout.names.items():
            if now.groups is not None:
                error = now.replicates(entry).error
            elif entry.truth:
                share = np.asarray(self.probability[name]).reshape(-1)
                error = np.sqrt(share * (1.0 - share) / max(self.count, 1))
            else:
                count = np.maximum(now.moments.count, 1)
                error = (now.moments.deviation / np.sqrt(count))[entry.where]
            found[name] = _shaped(error, entry.shape)
        return found

    def interval(self, name: str, level: float = 0.95) -> tuple[Any, Any]:
        """Interval of a mean or of a probability.

        Args:
            name: Of a number or a truth value.
            level: Of confidence [1].

        Returns:
            Both ends [the unit of the value, or 1], each in its shape: Student's for
            means (of counts as ``count_table`` has it), Wilson's for probabilities;
            over groups as the class says. NaN where ``reason`` says why.

        Raises:
            FieldError: an unknown name, or a level that is none.
        """
        level, entry, now = checked_level(level), self._named(name), self._now
        where, groups = entry.where, now.groups
        if entry.truth:
            hits, count = now.hits[where], self.count
            low, high = probability_interval(hits, count, level)
            if groups is not None:
                found = now.replicates(entry)
                low, high = found.probability_interval(hits, count, level)
            return _shaped(low, entry.shape), _shaped(high, entry.shape)
        if groups is None:
            of = now.moments
            middle, deviation = of.average[where], of.deviation[where]
            half = mean_half_width(deviation, of.count[where], level)
        else:
            found = now.replicates(entry)
            middle, half = found.mean, found.half_width(level)
        low, high = middle - half, middle + half
        low, high = of_counts(now.tables[where], entry.whole, low, high, level)
        return _shaped(low, entry.shape), _shaped(high, entry.shape)

    def reason(self, name: str) -> str:
        """Why a name has no interval, as a sentence; "" if it has.

        Raises:
            FieldError: an unknown name.
        """
        low = np.asarray(self.interval(name)[0])
        if not np.isnan(low).any():
            return ""
        if self.group_count is None:
            return "an interval needs two members that did not fail"
        there = int(self._now.replicates(self._named(name)).groups.min())
        return (
            "an interval needs two groups (independent scrambles, Latin sets) with "
            f"at least half of the members of the largest; there is {there}"
        )

    def note(self, name: str) -> str:
        """What the interval of a mean count supposes, as a sentence; "" if nothing.

        Raises:
            FieldError: an unknown name.
        """
        entry = self._named(name)
        return (
            "" if entry.truth else note_of(self._now.tables[entry.where], entry.whole)
        )

    def bounds(self, name: str) -> tuple[Any, Any]:
        """What a probability would be if all failed members were false, or all true.

        Args:
            name: Of a truth value.

        Returns:
            Both shares of all members [1], in the shape of the value.

        Raises:
            FieldError: it is no truth value.
        """
        entry, now = self._named(name, truth=True), self._now
        hits, members = now.hits[entry.where], now.members
        low, high = hits / max(members, 1), (hits + now.failed) / max(members, 1)
        if not members:
            high = high + 1.0
        return _shaped(low, entry.shape), _shaped(high, entry.shape)

    def quantile(
        self, name: str, q: float, level: float = 0.95
    ) -> tuple[Any, Any, Any]:
        """A quantile of a number, with its interval.

        Args:
            name: Of a number.
            q: Which quantile, between 0 and 1 [1].
            level: Of confidence [1].

        Returns:
            Value and both ends [the unit of the value], each in its shape: order
            statistics, moved outwards by the error of rank of what is kept
            (:class:`~rollkane.uncertainty.quantile_sketch.GroupedSketch`).

        Raises:
            FieldError: no number, or q or level outside of 0 to 1.
        """
        level, entry = checked_level(level), self._named(name, truth=False)
        share = checked_share(q)
        sketches = self._now.sketches[entry.where]
        found = np.array([x.quantile(share, level) for x in sketches]).reshape(-1, 3)
        value, low, high = (_shaped(column, entry.shape) for column in found.T)
        return value, low, high

    def rank_error(self, name: str) -> Any:
        """By how many ranks quantiles of a number may be off at most [members]."""
        entry = self._named(name, truth=False)
        sketches = self._now.sketches[entry.where]
        return _shaped(np.array([max(x.above, x.below) for x in sketches]), entry.shape)

    def histogram(self, label: str) -> Counted:
        """The histogram of a number without axes, or of one entry (``"end[0]"``).

        Args:
            label: One of ``names``.

        Returns:
            ``edges`` (B + 1,) [the unit of the value], ``counts`` (B,), and how many
            are ``below`` and ``above``.

        Raises:
            FieldError: it is none of ``names``.
        """
        if label not in self.names:
            remedy = f"give one of {list(self.names)}"
            raise FieldError("label", label, "is no number without axes", remedy)
        return self._now.histograms[self.names.index(label)].counted

    def at_least(
        self, name: str, number: int, level: float = 0.95
    ) -> tuple[Any, Any, Any]:
        """How probable so many or more are, of a number that counts.

        Args:
            name: Of a number whose values are 0, 1, 2, ...
            number: How many, up to 1000.
            level: Of confidence [1].

        Returns:
            Probability and the ends of its interval [1], as of a plain sample, each in
            the shape of the value.

        Raises:
            FieldError: a value was negative or no whole number, or too large a number
                is asked for.
        """
        level, entry = checked_level(level), self._named(name, truth=False)
        number = whole("number", number, 0, f"give a number up to {MOST}")
        if number > MOST:
            problem = f"is more than {MOST}, up to which members are told apart"
            raise FieldError("number", number, problem, "ask for fewer")
        tables = self._now.tables[entry.where]
        if any(x.counts is None for x in tables):
            problem = "had a value that is negative or no whole number"
            raise FieldError(name, name, problem, "ask for a histogram or a quantile")
        hits = np.array([x.at_least(number) for x in tables])
        count = self._now.moments.count[entry.where]
        share = np.where(count > 0, hits / np.maximum(count, 1), np.nan)
        found = (share, *probability_interval(hits, count, level))
        value, low, high = (_shaped(x, entry.shape) for x in found)
        return value, low, high

    def __str__(self) -> str:
        """A table of everything."""
        return table(self)

    def _named(self, name: str, truth: bool | None = None) -> Name:
        entry = self._layout.names.get(name)
        if entry is None:
            remedy = f"give one of {[*self._layout.names]}"
            raise FieldError("name", name, "is unknown", remedy)
        if truth is not None and truth != entry.truth:
            kind = "truth value" if truth else "number"
            remedy = f"give one of {list(self.truths if truth else self.numbers)}"
            raise FieldError("name", name, f"is no {kind}", remedy)
        return entry

    def _shaped(self, name: str, flat: np.ndarray) -> Any:
        entry = self._layout.names[name]
        return _shaped(flat[entry.where], entry.shape)

    def _numbers(self, flat: np.ndarray) -> dict[str, Any]:
        return {name: self._shaped(name, flat) for name in self.numbers}


def _shaped(flat: np.ndarray, shape: tuple[int, ...]) -> Any:
    """In the shape of the value; of no axes, a number."""
    return flat.reshape(shape)[()]
