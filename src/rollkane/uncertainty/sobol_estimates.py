"""Sobol indices from the outputs of Saltelli's design, and their bounds.

With ``f_A``, ``f_B`` the outputs at two independent samples and ``f_C`` those at A with
the columns of one factor from B, twice ``1 - S`` and twice ``T`` are the mean squares
of ``f_B - f_C`` and of ``f_A - f_C`` over the variance (Jansen, Comput. Phys. Commun.
117, 1999). First-order indices divide by the variance of the pair itself, which no
estimator from such pairs beats (Janon, Klein, Lagnoux, Nodet and Prieur, ESAIM: P&S 18,
2014), and subtract a multiple of the covariance of ``f_A`` and ``f_B``, which is known
to be zero; a multiple of 1 is what makes Saltelli's estimator (Comput. Phys. Commun.
181, 2010) good for small indices and bad for large ones, and the multiple here is that
of least variance. Both are without their means, so that a factor that changes nothing
has the index 0, not what is left of means. Total indices divide by the variance of all
outputs of a row.
"""

from typing import NamedTuple

import numpy as np

from .resampling import Sums, sum_by_unit

_SWEEPS = 3  # after which an index and its control agree


class Design(NamedTuple):
    """Outputs of a design of n rows and k factors, E numbers each, NaN where failed.

    Attributes:
        a: At the first sample, shape (n, E).
        b: At the second, shape (n, E).
        c: At the first with one factor from the second, shape (n, k, E).
    """

    a: np.ndarray
    b: np.ndarray
    c: np.ndarray

    @property
    def complete(self) -> np.ndarray:
        """Rows in which nothing failed, shape (n,)."""
        rows = [np.isfinite(x).reshape(len(x), -1).all(axis=1) for x in self]
        return np.logical_and.reduce(rows)

    def every(self) -> np.ndarray:
        """All outputs of each row, shape (n, k + 2, E)."""
        return np.concatenate([self.a[:, None], self.b[:, None], self.c], axis=1)

    def standardized(self) -> "Design":
        """The same less the mean and over the deviation of what did not fail.

        Indices do not change by it, and sums of squares lose no digits. An output that
        does not vary becomes NaN, as are its indices.
        """
        every = self.every()
        known = np.isfinite(every)
        count = np.maximum(known.sum(axis=(0, 1)), 1)
        mean = np.where(known, every, 0.0).sum(axis=(0, 1)) / count
        square = np.where(known, (every - mean) ** 2, 0.0).sum(axis=(0, 1)) / count
        # beyond rounding of the mean
        varies = square > (8.0 * np.finfo(float).eps * np.abs(mean)) ** 2
        scale = np.sqrt(np.where(varies, square, np.nan))
        return Design(*((x - mean) / scale for x in self))

    def rows(self, which: np.ndarray) -> "Design":
        """Some of its rows."""
        return Design(*(x[which] for x in self))


def index_sums(design: Design, units: np.ndarray) -> dict[str, np.ndarray]:
    """Sums over the rows of each unit that :func:`indices` is a function of.

    Args:
        design: Without failed rows, standardized [1].
        units: Of each row, shape (n,).

    Returns:
        By name, shapes (G, ...).
    """
    a, b, c = design.a[:, None], design.b[:, None], design.c
    control, every = _control(design)[None], design.every()
    rows = {
        "count": np.ones((len(a), 1, 1)),
        "first": b * c - control * (a * b),
        "left": np.broadcast_to(1.0 - control, c.shape),
        "total": 0.5 * (a - c) ** 2,
        "apart": 0.5 * (a + b),
        "moved": 0.5 * (c - a),
        "pair_square": 0.5 * (b * b + c * c),
        "every": every.mean(axis=1, keepdims=True),
        "every_square": (every * every).mean(axis=1, keepdims=True),
    }
    return {name: sum_by_unit(x, units) for name, x in rows.items()}


def _control(design: Design) -> np.ndarray:
    """Multiple of ``f_A f_B`` of least variance, shape (k, E).

    By regression of what the first-order estimator is linearly, ``b c - S (b^2 +
    c^2)/2``, on the product. S is the index that the multiple itself gives, and within
    its range: with few events a product by itself would say more than it knows.
    """
    a, b, c = design.a[:, None], design.b[:, None], design.c
    square, both = 0.5 * (b * b + c * c), a * b
    product = both - both.mean(axis=0)
    control = np.zeros(c.shape[1:])
    for _ in range(_SWEEPS):
        index = (b * c - control * both).mean(axis=0) / square.mean(axis=0)
        # less the product, so that of a factor that changes nothing 0 is left
        linear = b * c - both - np.clip(index, 0.0, 1.0) * square
        slope = (linear * product).mean(axis=0) / (product**2).mean(axis=0)
        control = 1.0 + slope
    return control


def indices(sums: Sums) -> dict[str, np.ndarray]:
    """First-order and total indices [1], shape (..., k, E).

    Args:
        sums: Those of :func:`index_sums`, without the axis of units or with others.
    """
    count = sums["count"]
    apart, moved = sums["apart"] / count, sums["moved"] / count
    square = sums["pair_square"] / count
    # products less those of their means, so that equal outputs leave exactly nothing
    means = moved * (2.0 * apart + moved) + sums["left"] / count * apart**2
    pairs = square - (apart + moved) ** 2
    first = (sums["first"] / count - means) / _beyond_rounding(pairs, square)
    mean, square = sums["every"] / count, sums["every_square"] / count
    every = _beyond_rounding(square - mean * mean, square)
    return {"first": first, "total": sums["total"] / count / every}


def _beyond_rounding(variance: np.ndarray, square: np.ndarray) -> np.ndarray:
    """The variance; NaN where it is rounding of the mean square: nothing happened."""
    return np.where(variance > 8.0 * np.finfo(float).eps * square, variance, np.nan)


def bound_sums(
    design: Design, low: np.ndarray, high: np.ndarray, units: np.ndarray
) -> dict[str, np.ndarray]:
    """Sums over units that :func:`index_bounds` is a function of.

    Args:
        design: All rows, NaN where failed.
        low: Least that a failed output could have been, shape (E,).
        high: Most that it could have been, shape (E,).
        units: Of each row, shape (n,).

    Returns:
        By name, shapes (G, ...).
    """
    every = design.every()
    known = np.isfinite(every)
    filled = np.where(known, every, 0.0)
    wide = np.broadcast_to((high - low)[None, None], (len(every), 1, len(low)))
    first = _half_squares(design.b[:, None], design.c, low, high)
    total = _half_squares(design.a[:, None], design.c, low, high)
    rows = {
        "count": np.ones((len(every), 1, 1)),
        "known": known.mean(axis=1, keepdims=True),
        "every": filled.mean(axis=1, keepdims=True),
        "every_square": (filled**2).mean(axis=1, keepdims=True),
        "low": np.broadcast_to(low[None, None], wide.shape),
        "high": np.broadcast_to(high[None, None], wide.shape),
        "first_least": first[0],
        "first_most": first[1],
        "total_least": total[0],
        "total_most": total[1],
    }
    return {name: sum_by_unit(x, units) for name, x in rows.items()}


def _half_squares(
    x: np.ndarray, y: np.ndarray, low: np.ndarray, high: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Least and most of half a squared difference, of what could have been."""
    x, y = np.broadcast_arrays(x, y)
    x_known, y_known = np.isfinite(x), np.isfinite(y)
    exact = 0.5 * (x - y) ** 2
    one = np.where(x_known, x, y)  # the one that is known, if only one is
    farthest = 0.5 * np.maximum((one - low) ** 2, (one - high) ** 2)
    both, neither = x_known & y_known, ~(x_known | y_known)
    most = np.where(neither, 0.5 * (high - low) ** 2, farthest)
    return np.where(both, exact, 0.0), np.where(both, exact, most)


def index_bounds(sums: Sums) -> dict[str, np.ndarray]:
    """What indices could be, whatever failed outputs would have been within limits.

    Of the sample: every mean square lies between its least and its most, and so does
    the variance; the quotients of the farthest ends bound the indices (partial
    identification without assumptions: Manski, Partial Identification of Probability
    Distributions, 2003, ch. 1). Both ends need not be reached together.

    Args:
        sums: Those of :func:`bound_sums`, without the axis of units or with others.

    Returns:
        ``first_low``, ``first_high``, ``total_low``, ``total_high`` [1], (..., k, E).
    """
    count = sums["count"]
    known = sums["known"] / count
    low, high = sums["low"] / count, sums["high"] / count
    mean, square = sums["every"] / count, sums["every_square"] / count
    missing = 1.0 - known
    # the least variance has all that failed at the mean of what is known
    least = square - mean * mean / np.maximum(known, np.finfo(float).tiny)
    # the largest a share q of it at the upper end and the rest at the lower one
    wide = missing * (high - low)
    middle = 0.5 * (high + low) - mean - missing * low
    share = np.clip(middle / np.where(wide > 0.0, wide, 1.0), 0.0, 1.0)
    moved = mean + missing * low + share * wide
    largest = square + missing * (low**2 + share * (high**2 - low**2)) - moved**2
    ratio = {
        name: (sums[f"{name}_least"] / largest, sums[f"{name}_most"] / least)
        for name in ("first", "total")
    }
    bounds = {
        "first_low": 1.0 - ratio["first"][1] / count,
        "first_high": 1.0 - ratio["first"][0] / count,
        "total_low": ratio["total"][0] / count,
        "total_high": ratio["total"][1] / count,
    }
    return {name: np.clip(x, 0.0, 1.0) for name, x in bounds.items()}
