"""Intervals of what is computed from sums over independent units of a sample.

An estimate that is a function of sums (a ratio of means, a moment) needs no more than
the sums over units that are independent of one another: rows of a plain sample, or the
independent scrambles of a Sobol sequence. Many units are resampled with replacement
(the bootstrap: Efron and Tibshirani, An Introduction to the Bootstrap, 1993, ch. 13); a
few, for which percentiles of a bootstrap are too narrow, give Student's t of the
estimates that leave each unit out (the jackknife; for randomized quasi-Monte Carlo the
most reliable of these: L'Ecuyer, Nakayama, Owen and Tuffin, Confidence Intervals for
Randomized Quasi-Monte Carlo Estimators, WSC 2023).
"""

from collections.abc import Callable, Mapping

import numpy as np
from scipy import special  # pyright: ignore[reportMissingTypeStubs]

Sums = Mapping[str, np.ndarray]
Estimate = Callable[[Sums], dict[str, np.ndarray]]
# Numbers of a block of resampled sums.
_BLOCK = 2**22


class Spread:
    """Intervals of estimates that are functions of sums over units.

    Attributes:
        estimate: From the sums over all units, by name.
    """

    def __init__(
        self,
        sums: Sums,
        function: Estimate,
        level: float,
        resamples: int | None,
        seed: int = 0,
    ):
        """Resample.

        Args:
            sums: By name, units in front: shape (G, ...) [any unit].
            function: Of sums without the axis of units, or with any axes in front of
                the others: gives estimates with the same axes in front.
            level: Probability that an interval covers [1].
            resamples: Of the bootstrap; None: the jackknife, for few units.
            seed: Of the bootstrap's random numbers.
        """
        self._tail = 0.5 * (1.0 - level)
        self._count = len(next(iter(sums.values())))
        whole = {name: x.sum(axis=0) for name, x in sums.items()}
        self.estimate = function(whole)
        self._resampled = resamples is not None
        if resamples is not None:
            self._others = _bootstrap(sums, function, resamples, seed)
        else:
            left = {name: whole[name][None] - x for name, x in sums.items()}
            self._others = function(left)

    def interval(self, name: str) -> np.ndarray:
        """Lower and upper end of an estimate's interval, shape (2, ...)."""
        others = self._others[name]
        if self._resampled:
            return np.quantile(others, [self._tail, 1.0 - self._tail], axis=0)
        quantile = special.stdtrit(self._count - 1, 1.0 - self._tail)
        wide = float(quantile) * self.error(name)
        return np.stack([self.estimate[name] - wide, self.estimate[name] + wide])

    def mean(self, name: str) -> np.ndarray:
        """Mean over the resampled sums, as of a distance from the estimate."""
        return self._others[name].mean(axis=0)

    def error(self, name: str) -> np.ndarray:
        """Standard error of an estimate, of its shape."""
        others = self._others[name]
        if self._resampled:
            return others.std(axis=0, ddof=1)
        around = ((others - others.mean(axis=0)) ** 2).sum(axis=0)
        return np.sqrt((self._count - 1) / self._count * around)


def _bootstrap(
    sums: Sums, function: Estimate, resamples: int, seed: int
) -> dict[str, np.ndarray]:
    """Estimates of units drawn with replacement, shape (resamples, ...)."""
    rng = np.random.default_rng([seed, 0xB007])
    count = len(next(iter(sums.values())))
    parts: list[dict[str, np.ndarray]] = []
    left = resamples
    while left:
        some = min(left, max(1, _BLOCK // count))
        often = rng.multinomial(count, np.full(count, 1.0 / count), size=some)
        drawn = {n: np.tensordot(often.astype(float), x, 1) for n, x in sums.items()}
        parts.append(function(drawn))
        left -= some
    return {n: np.concatenate([part[n] for part in parts]) for n in parts[0]}


def unit_numbers(size: int, groups: np.ndarray | None, most: int = 1000) -> np.ndarray:
    """Which unit each row belongs to.

    Args:
        size: Rows.
        groups: Of rows that are independent only between groups; None: rows are.
        most: Units at most, of independent rows.

    Returns:
        Numbers from 0 on, shape (size,).
    """
    if groups is not None:
        return np.unique(groups, return_inverse=True)[1]
    return np.arange(size) * min(size, most) // size


def sum_by_unit(rows: np.ndarray, units: np.ndarray) -> np.ndarray:
    """Sums over the rows of each unit, shape (G, ...)."""
    summed = np.zeros((int(units.max()) + 1, *rows.shape[1:]))
    np.add.at(summed, units, rows)
    return summed
