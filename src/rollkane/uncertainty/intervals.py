"""Confidence intervals: of means, probabilities and quantiles, from counts alone.

NumPy and the standard library only: Student's distribution by its finite sums, the
binomial one by the ratios of its terms.
"""

import functools
import math
from statistics import NormalDist
from typing import Any, cast

import numpy as np

from ..validation.checks import FieldError, real

# Student's quantiles of more degrees of freedom come from the expansion in 1 / freedom:
# what is left out is below 1e-10 of the quantile there up to a level of 1 - 1e-6.
_FINITE_SUMS = 500
# Of so few hits or misses Wilson's interval is too short.
_FEW = 20


def checked_level(level: Any) -> float:
    """A level of confidence, between 0 and 1 [1].

    Raises:
        FieldError: it is not.
    """
    meaning = "a level of confidence, as 0.95"
    return open_share("level", level, meaning, "give 0.95 for 95 %")


def open_share(field: str, value: Any, meaning: str, remedy: str) -> float:
    """A number between 0 and 1 [1], neither of them.

    Args:
        field: Name used in the error.
        value: What was given.
        meaning: What it is.
        remedy: What to do where it is out of range.

    Raises:
        FieldError: it is not.
    """
    real(field, value, (), meaning)
    share = float(value)  # in double precision, whatever JAX computes in
    if not 0.0 < share < 1.0:
        raise FieldError(field, value, "must lie between 0 and 1", remedy)
    return share


def normal_quantile(level: float) -> float:
    """Half width of the standard normal distribution's central interval [1]."""
    return NormalDist().inv_cdf(0.5 + 0.5 * level)


@functools.lru_cache(maxsize=256)
def student_quantile(level: float, freedom: int) -> float:
    """Half width of Student's distribution's central interval [1].

    Args:
        level: Probability of the interval [1].
        freedom: Degrees of freedom, at least 1.

    Source: Abramowitz and Stegun, Handbook of Mathematical Functions, 26.7.3 to 26.7.5.
    """
    if freedom > _FINITE_SUMS:
        return _student_expansion(normal_quantile(level), freedom)
    low, high = 0.0, 0.5 * math.pi
    for _ in range(60):  # of halvings: below the rounding of the angle
        middle = 0.5 * (low + high)
        if _student_probability(middle, freedom) < level:
            low = middle
        else:
            high = middle
    return math.sqrt(freedom) * math.tan(0.5 * (low + high))


def _student_probability(angle: float, freedom: int) -> float:
    """Of |t| < sqrt(freedom) tan(angle)."""
    cosine, odd = math.cos(angle), freedom % 2
    total = 0.0
    term = cosine if odd else 1.0
    for power in range(1 + odd, freedom, 2):
        total += term
        term *= power / (power + 1.0) * cosine**2
    total *= math.sin(angle)
    return (angle + total) * 2.0 / math.pi if odd else total


def _student_expansion(z: float, freedom: int) -> float:
    """By powers of 1 / freedom, from the normal quantile."""
    terms = (
        (z**3 + z) / 4.0,
        (5 * z**5 + 16 * z**3 + 3 * z) / 96.0,
        (3 * z**7 + 19 * z**5 + 17 * z**3 - 15 * z) / 384.0,
        (79 * z**9 + 776 * z**7 + 1482 * z**5 - 1920 * z**3 - 945 * z) / 92160.0,
    )
    return z + sum(term / freedom ** (k + 1) for k, term in enumerate(terms))


def few_hits(hits: Any) -> np.ndarray:
    """Whether so many hits are few: sums of them are far from normal.

    Args:
        hits: How many, any shape.
    """
    return np.asarray(hits) <= _FEW


def probability_interval(
    hits: Any, count: Any, level: float
) -> tuple[np.ndarray, np.ndarray]:
    """Interval of a probability: Wilson's, drawn out where hits or misses are few.

    Wilson's, because its coverage is the level's on average over probabilities, where
    Clopper's and Pearson's promises at least the level and is up to twice as wide as
    needed for rare events. With up to 20 hits (or misses) Wilson's lower end would miss
    too often, so both ends are drawn out to those of the mid-P interval where they lie
    inside of it. The coverage at 95 % is 93 % at least then, for 30 members and more,
    whatever the probability. With no hit at all the interval is [0, 3.84 / n] at
    95 %, where seeing none had a probability of 2.1 %.

    Args:
        hits: How many members were, any shape.
        count: Out of how many, of the same shape or a number.
        level: Of confidence [1].

    Returns:
        Both ends [1], of the shape of ``hits``; 0 and 1 where the count is zero.

    Source: Brown, Cai and DasGupta, Interval estimation for a binomial proportion,
    Statistical Science 16 (2001), section 3.1.1; mid-P: Berry and Armitage, Mid-P
    confidence intervals: a brief review, The Statistician 44 (1995).
    """
    k, n = np.broadcast_arrays(np.asarray(hits), np.asarray(count))
    z2 = normal_quantile(level) ** 2
    share = k * ((n - k) / np.maximum(n, 1))
    half = math.sqrt(z2) * np.sqrt(share + 0.25 * z2)
    low, high = (k + 0.5 * z2 - half) / (n + z2), (k + 0.5 * z2 + half) / (n + z2)
    for few in np.unique(
        np.stack([k, n, n - k])[:, np.minimum(k, n - k) <= _FEW].T, axis=0
    ):
        hit, members, missed = few.tolist()
        ends = _few_hits(min(hit, missed), members, level)
        if hit > missed:
            ends = 1.0 - ends[1], 1.0 - ends[0]
        here = (k == hit) & (n == members)
        low = np.where(here, np.minimum(low, ends[0]), low)
        high = np.where(here, np.maximum(high, ends[1]), high)
    low = np.where(k == 0, 0.0, np.clip(low, 0.0, 1.0))
    high = np.where(k == n, 1.0, np.clip(high, 0.0, 1.0))
    return low, high


@functools.lru_cache(maxsize=4096)
def _few_hits(hits: int, count: int, level: float) -> tuple[float, float]:
    """The mid-P interval: half of the hits that were seen is counted in each tail."""
    tail = 0.5 * (1.0 - level)
    low, high = (_mid_p(hits, count, x) for x in (1.0 - tail, tail))
    return low, high


def _mid_p(hits: int, count: int, wanted: float) -> float:
    """The probability at which fewer hits, and half of as many, are so probable."""
    low, high = 0.0, min(1.0, (hits + 100.0) / max(count, 1))
    for _ in range(52):  # of halvings: 1 is not reached
        p = 0.5 * (low + high)
        odds = p / (1.0 - p)
        total, term = 0.0, math.exp(count * math.log1p(-p))
        for k in range(hits):
            total += term
            term *= (count - k) / (k + 1.0) * odds
        if total + 0.5 * term > wanted:
            low = p
        else:
            high = p
    return 0.5 * (low + high)


def quantile_ranks(q: float, count: int, level: float) -> tuple[int, int]:
    """Ranks of the order statistics that hold a quantile between them.

    The number of members at or below the quantile is binomial, whatever their
    distribution, so the interval has at least the level for every continuous one.

    Args:
        q: Of which quantile, between 0 and 1 [1].
        count: Of members.
        level: Of confidence [1].

    Returns:
        Ranks from 1; 0 and ``count + 1`` where no order statistic is sure enough.

    Source: David and Nagaraja, Order Statistics (3rd ed.), section 7.1.
    """
    deviation = math.sqrt(count * q * (1.0 - q))
    middle, reach = int(count * q), int(10.0 * deviation) + 60
    first, last = max(0, middle - reach), min(count, middle + reach)
    k = np.arange(first, last, dtype=float)
    # from each term to the next, in logarithms: no factorial of a large number
    ratios = np.log((count - k) / (k + 1.0)) + math.log(q / (1.0 - q))
    logarithms = np.concatenate([[0.0], np.cumsum(ratios)])
    terms = np.exp(logarithms - logarithms.max())
    below = np.cumsum(terms) / terms.sum()
    tail = 0.5 * (1.0 - level)
    low = first + int(np.searchsorted(below, tail, side="right"))
    high = first + int(np.searchsorted(below, 1.0 - tail, side="left")) + 1
    return low, min(high, count + 1)


def mean_half_width(deviation: Any, count: Any, level: float) -> np.ndarray:
    """Half width of Student's interval of a mean.

    Args:
        deviation: Standard deviation of the members [their unit], any shape.
        count: How many there are, of the same shape.
        level: Of confidence [1].

    Returns:
        NaN where there are fewer than two members.
    """
    s, n = np.broadcast_arrays(np.asarray(deviation, float), np.asarray(count))
    factor = np.full(n.shape, np.nan)
    for value in np.unique(n):
        if value >= 2:
            factor[n == value] = student_quantile(level, int(value) - 1)
    return cast(np.ndarray, factor * s / np.sqrt(np.maximum(n, 1)))


def of_replicates(means: Any, counts: Any) -> tuple[np.ndarray, np.ndarray]:
    """Mean of all members, and its standard error, from those of independent groups.

    Args:
        means: Of the groups [any unit], shape (G, ...).
        counts: Of their members, of the same shape; 0 for groups that are not looked
            at.

    Returns:
        The mean weighted by members, and its error: of groups of one size, their
        standard deviation over the root of their number. NaN for fewer than one, or
        two, groups.
    """
    counts = np.asarray(counts)
    means = np.where(counts > 0, means, 0.0)
    groups = (counts > 0).sum(axis=0)
    weights = counts / np.maximum(counts.sum(axis=0), 1)
    mean = (weights * means).sum(axis=0)
    apart = weights * (means - mean)
    # in a power of two, as squares may be too small or too large to be numbers
    _, power = np.frexp(abs(apart).max(axis=0, initial=0.0))
    squares = (np.ldexp(apart, -power) ** 2).sum(axis=0)
    error = np.sqrt(squares * groups / np.maximum(groups - 1, 1))
    error = np.ldexp(error, power)
    return np.where(groups > 0, mean, np.nan), np.where(groups > 1, error, np.nan)
