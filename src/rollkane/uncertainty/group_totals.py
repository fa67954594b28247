"""Means of independent groups of members, and what they say of the mean of all."""

import dataclasses
from typing import NamedTuple

import numpy as np

from .intervals import of_replicates, probability_interval, student_quantile

# Groups are compared when they have this share of the largest group's members.
COMPLETE = 0.5
# Of fewer hits or misses the means of groups are too far from normal.
_RARE = 20


class Replicates(NamedTuple):
    """What independent groups say of a mean.

    Attributes:
        mean: Of the groups that are compared, weighted by their members [the entry's
            unit], shape (D,).
        error: Its standard error, NaN for fewer than two groups, shape (D,).
        groups: How many are compared, shape (D,).
    """

    mean: np.ndarray
    error: np.ndarray
    groups: np.ndarray

    def half_width(self, level: float) -> np.ndarray:
        """Half width of Student's interval of the mean, shape (D,)."""
        factor = np.full(self.groups.shape, np.nan)
        for groups in np.unique(self.groups):
            if groups > 1:
                factor[self.groups == groups] = student_quantile(level, int(groups) - 1)
        return factor * self.error

    def probability_interval(
        self, hits: np.ndarray, count: int, level: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Interval of a probability, whose values are 0 or 1.

        That of a plain sample where hits or misses are fewer than 20 or all groups
        agree, else Student's within 0 to 1.

        Args:
            hits: Of all members, shape (D,).
            count: Of members that did not fail.
            level: Of confidence [1].
        """
        low, high = probability_interval(hits, count, level)
        half = self.half_width(level)
        rare = np.minimum(hits, count - hits) < _RARE
        plain = rare | (self.error == 0.0)
        return (
            np.where(plain, low, np.maximum(self.mean - half, 0.0)),
            np.where(plain, high, np.minimum(self.mean + half, 1.0)),
        )


@dataclasses.dataclass(frozen=True, eq=False)
class GroupTotals:
    """Sums over the members of each of G groups.

    Members of a group (a Latin set, a scramble of a Sobol sequence) lie where the
    others are not, so their values say little of the error of their mean; groups are
    independent, so their means do.

    Attributes:
        members: Whether they failed or not, shape (G,).
        counts: With a finite value, shape (G, D).
        sums: Of the values less a shift, shape (G, D).
    """

    members: np.ndarray
    counts: np.ndarray
    sums: np.ndarray

    @classmethod
    def of_nothing(cls, groups: int, entries: int) -> "GroupTotals":
        """Of no members."""
        zeros = np.zeros((groups, entries))
        return cls(np.zeros(groups, np.int64), zeros.astype(np.int64), zeros)

    def add(
        self,
        values: np.ndarray,
        shift: np.ndarray,
        groups: np.ndarray,
        valid: np.ndarray,
    ) -> "GroupTotals":
        """With more members.

        Args:
            values: Of those that did not fail, shape (D, n).
            shift: What is subtracted, always the same, shape (D,).
            groups: Of all members, shape (m,).
            valid: Which did not fail, shape (m,): n of them.
        """
        size = len(self.members)
        members = self.members + np.bincount(groups, minlength=size)
        counts, sums, own = self.counts.copy(), self.sums.copy(), groups[valid]
        for k, row in enumerate(values):
            finite = np.isfinite(row)
            counts[:, k] += np.bincount(own[finite], minlength=size)
            with np.errstate(invalid="ignore", over="ignore"):
                weights = np.where(finite, row - shift[k], 0.0)
                sums[:, k] += np.bincount(own, weights, minlength=size)
        return GroupTotals(members, counts, sums)

    def replicates(self, shift: np.ndarray) -> Replicates:
        """Mean and error, from groups with at least half as many as the largest."""
        complete = self.members >= COMPLETE * max(self.members.max(initial=0), 1)
        counts = np.where(complete[:, None], self.counts, 0)
        mean, error = of_replicates(self.sums / np.maximum(self.counts, 1), counts)
        return Replicates(shift + mean, error, (counts > 0).sum(axis=0))
