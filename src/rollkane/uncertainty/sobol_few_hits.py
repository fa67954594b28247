"""Intervals of Sobol indices of events that few rows of the design show.

An output of two values is whether something happened. Its total index is the
probability that one factor changes it over ``2 p (1 - p)``, p that of the rarer value;
its first-order index is ``(r - p^2) / (p (1 - p))``, r the probability that both of a
pair have that value. Where few rows did so, resampled sums do not tell how many might
have done: of none, they would say exactly none. The interval of a probability of a few
hits does; p is known by many more.
"""

import numpy as np

from .intervals import few_hits, probability_interval
from .sobol_estimates import Design


def with_few_hits(
    design: Design, intervals: dict[str, np.ndarray], level: float
) -> dict[str, np.ndarray]:
    """Intervals, drawn out where they rest on few rows.

    Args:
        design: Outputs without failed rows [any unit].
        intervals: Of first-order and total indices [1], by ``"first"`` and ``"total"``,
            shapes (2, k, E).
        level: Of the intervals [1].

    Returns:
        The same of outputs of more than two values, and of two that many rows show.
    """
    every = design.every()
    low, high = every.min(axis=(0, 1)), every.max(axis=(0, 1))
    two = (low < high) & ((every == low) | (every == high)).all(axis=(0, 1))
    # the rarer of the two; of more values it does not count
    event = (every == high) != ((every == high).mean(axis=(0, 1)) > 0.5)
    p = np.where(two, event.mean(axis=(0, 1)), np.nan)
    variance = p * (1.0 - p)
    a, b, c = event[:, :1], event[:, 1:2], event[:, 2:]
    changed, paired = (a != c).sum(axis=0), (b & c).sum(axis=0)
    ends = np.stack(probability_interval(changed, len(event), level))
    total = _drawn_out(intervals["total"], ends / (2.0 * variance), changed, two)
    ends = np.stack(probability_interval(paired, len(event), level))
    # no factor alone does more than it does at all
    known = np.minimum((ends - p * p) / variance, total[1])
    first = _drawn_out(intervals["first"], known, paired, two)
    return {"first": first, "total": total}


def _drawn_out(
    ends: np.ndarray, known: np.ndarray, hits: np.ndarray, two: np.ndarray
) -> np.ndarray:
    """The ends that lie farther out, where hits of outputs of two values are few.

    Those of resampled sums are NaN where some of these have no variance at all.
    """
    low, high = np.clip(known, 0.0, 1.0)
    wide = np.stack([np.fmin(ends[0], low), np.fmax(ends[1], high)])
    return np.where(two & few_hits(hits), wide, ends)
