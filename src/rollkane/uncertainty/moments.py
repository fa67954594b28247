"""Means, variances and covariances of a stream, stable to rounding."""

import dataclasses

import numpy as np

# Powers of two up to which squares of differences, and of roundings of these, have all
# their digits; and the largest by which numbers can be divided.
_PLAIN, _MOST = 300, 1000


@dataclasses.dataclass(frozen=True, eq=False)
class Moments:
    """Count, mean, sum of squares and extremes of D entries, each by itself.

    Values are taken relative to a number among the first of them (their median), which
    loses nothing where they are close to each other; pieces are put together by Chan's
    formula. What is not finite is left out, entry by entry. Differences whose squares
    would leave the range of numbers, or their digits, are told in a power of two.

    Attributes:
        count: Finite values, shape (D,).
        shift: What was subtracted [the entry's unit], shape (D,).
        power: Differences are in units of two to it; nearly always 0, shape (D,).
        mean: Of the differences, shape (D,).
        squares: Sum of squared deviations from the mean, shape (D,).
        minimum: Of the values, infinite for none, shape (D,).
        maximum: Of the values, shape (D,).

    Source: Chan, Golub and LeVeque, Algorithms for computing the sample variance, The
    American Statistician 37 (1983), (2.1) and (3.1).
    """

    count: np.ndarray
    shift: np.ndarray
    power: np.ndarray
    mean: np.ndarray
    squares: np.ndarray
    minimum: np.ndarray
    maximum: np.ndarray

    @classmethod
    def of_nothing(cls, entries: int) -> "Moments":
        """Of no values of so many entries."""
        zeros = np.zeros(entries)
        infinite = np.full(entries, np.inf)
        whole = zeros.astype(int)
        return cls(whole, zeros, whole, zeros, zeros, infinite, -infinite)

    @property
    def least(self) -> np.ndarray:
        """Smallest value of each entry, NaN for none, shape (D,)."""
        return np.where(self.count > 0, self.minimum, np.nan)

    @property
    def most(self) -> np.ndarray:
        """Largest value of each entry, NaN for none, shape (D,)."""
        return np.where(self.count > 0, self.maximum, np.nan)

    def add(self, values: np.ndarray) -> "Moments":
        """With more values, shape (D, n), contiguous."""
        finite = np.isfinite(values)
        count = finite.sum(axis=1)
        shift, new = self.shift, self.count == 0
        if new.any():
            shift = np.where(new, _medians(values, finite), shift)
        size = np.maximum(count, 1)
        before = self._in_powers_for(values, shift, finite)
        unit = np.ldexp(1.0, -before.power)
        with np.errstate(invalid="ignore", over="ignore"):
            plain = not before.power.any()
            moved = (
                values - shift[:, None]
                if plain
                else values * unit[:, None] - (shift * unit)[:, None]
            )
            moved = np.where(finite, moved, 0.0)
            mean = moved.sum(axis=1) / size
            away = np.where(finite, moved - mean[:, None], 0.0)
            # the second sum takes out what rounding of the mean added
            squares = (away * away).sum(axis=1) - away.sum(axis=1) ** 2 / size
            return before._joined(count, shift, mean, squares, values, finite)

    def _in_powers_for(
        self, values: np.ndarray, shift: np.ndarray, finite: np.ndarray
    ) -> "Moments":
        """The same, in units in which squares of new differences have digits."""
        half = np.where(finite, 0.5 * values - 0.5 * shift[:, None], 0.0)
        _, power = np.frexp(abs(half).max(axis=1, initial=0.0))
        power = np.where(abs(power) > _PLAIN, np.clip(power, -_MOST, _MOST), 0)
        # what was the same so far has no size yet; what grew so far keeps no old digits
        same = (self.mean == 0.0) & (self.squares == 0.0)
        power = np.where(same | (power > self.power), power, self.power)
        if np.array_equal(power, self.power):
            return self
        change = self.power - power
        return dataclasses.replace(
            self,
            power=power,
            mean=np.ldexp(self.mean, change),
            squares=np.ldexp(self.squares, 2 * change),
        )

    def _joined(
        self,
        count: np.ndarray,
        shift: np.ndarray,
        mean: np.ndarray,
        squares: np.ndarray,
        values: np.ndarray,
        finite: np.ndarray,
    ) -> "Moments":
        total = self.count + count
        share = count / np.maximum(total, 1)
        apart = mean - self.mean
        return Moments(
            count=total,
            shift=shift,
            power=self.power,
            mean=self.mean + apart * share,
            squares=self.squares + squares + apart**2 * self.count * share,
            minimum=np.minimum(
                self.minimum,
                np.where(finite, values, np.inf).min(axis=1, initial=np.inf),
            ),
            maximum=np.maximum(
                self.maximum,
                np.where(finite, values, -np.inf).max(axis=1, initial=-np.inf),
            ),
        )

    @property
    def average(self) -> np.ndarray:
        """Mean of the values [the entry's unit], NaN for none, shape (D,)."""
        moved = np.ldexp(self.mean, self.power)
        return np.where(self.count > 0, self.shift + moved, np.nan)

    @property
    def deviation(self) -> np.ndarray:
        """Standard deviation (n - 1), NaN for fewer than two, shape (D,)."""
        variance = self.squares / np.maximum(self.count - 1, 1)
        found = np.ldexp(np.sqrt(np.maximum(variance, 0.0)), self.power)
        return np.where(self.count > 1, found, np.nan)


def _medians(values: np.ndarray, finite: np.ndarray) -> np.ndarray:
    """One of the finite values of each row, in the middle of them; 0 for none."""
    count = finite.sum(axis=1)
    ordered = np.sort(np.where(finite, values, np.inf), axis=1)
    if not ordered.shape[1]:
        return np.zeros(len(values))
    middle = np.take_along_axis(ordered, (np.maximum(count, 1) - 1)[:, None] // 2, 1)
    return np.where(count > 0, middle[:, 0], 0.0)


@dataclasses.dataclass(frozen=True, eq=False)
class JointMoments:
    """Means and products of D entries together: of members that have them all.

    Attributes:
        count: Members whose entries are all finite.
        mean: Of their differences from the shifts, shape (D,).
        products: Sums of products of deviations, shape (D, D).
    """

    count: int
    mean: np.ndarray
    products: np.ndarray

    @classmethod
    def of_nothing(cls, entries: int) -> "JointMoments":
        """Of no members with so many entries."""
        return cls(0, np.zeros(entries), np.zeros((entries, entries)))

    def add(self, values: np.ndarray, shift: np.ndarray) -> "JointMoments":
        """With more members.

        Args:
            values: Shape (D, n), contiguous.
            shift: What is subtracted, always the same, shape (D,).
        """
        moved = values[:, np.isfinite(values).all(axis=0)] - shift[:, None]
        count = moved.shape[1]
        if not count:
            return self
        with np.errstate(invalid="ignore", over="ignore"):
            mean = moved.sum(axis=1) / count
            away = np.ascontiguousarray(moved - mean[:, None])
            rest = away.sum(axis=1)
            products = away @ away.T - np.outer(rest, rest) / count
            apart, share = mean - self.mean, count / (self.count + count)
            return JointMoments(
                self.count + count,
                self.mean + apart * share,
                self.products + products + np.outer(apart, apart) * self.count * share,
            )

    @property
    def covariance(self) -> np.ndarray:
        """With n - 1, NaN for fewer than two members, shape (D, D)."""
        if self.count < 2:
            return np.full(self.products.shape, np.nan)
        return self.products / (self.count - 1)
