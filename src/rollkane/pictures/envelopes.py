"""Curves over time, with an envelope where their ripples are finer than can be seen.

Needs matplotlib, which is imported inside the functions.
"""

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_BINS = 200  # over the width of a panel: each some five pixels wide
_TURNS = 2  # in a bin and its neighbours each: a ripple there is a block of ink
_LEAST = 0.01  # of the range of the curve: smaller ripples are no wider than a line
_WORDS = "shaded: from the least to the greatest of ripples"


class Envelope(NamedTuple):
    """Least, mean and greatest value of a curve in bins of time.

    Attributes:
        time: Middles of the bins [s], shape (B,).
        low: Shape (B,); NaN where a bin holds nothing.
        mean: Shape (B,).
        high: Shape (B,).
        rippled: Where ripples are finer than can be seen, shape (B,).
        hidden: Samples between the middles of two such bins, shape (T,).
    """

    time: Float[np.ndarray, " B"]
    low: Float[np.ndarray, " B"]
    mean: Float[np.ndarray, " B"]
    high: Float[np.ndarray, " B"]
    rippled: Bool[np.ndarray, " B"]
    hidden: Bool[np.ndarray, " T"]


def envelope(time: np.ndarray, values: np.ndarray) -> Envelope:
    """Where a curve ripples too finely to be drawn, and between which bounds.

    Args:
        time: Strictly monotonic [s], shape (T,).
        values: Shape (T,); NaN where there are none.
    """
    begin, end = float(time[0]), float(time[-1])
    share = (time - begin) / (end - begin)
    bins = np.clip((_BINS * share).astype(int), 0, _BINS - 1)
    known = np.isfinite(values)
    low, high = np.full(_BINS, np.inf), np.full(_BINS, -np.inf)
    np.minimum.at(low, bins[known], values[known])
    np.maximum.at(high, bins[known], values[known])
    count = np.bincount(bins[known], minlength=_BINS)
    total = np.bincount(bins[known], values[known], minlength=_BINS)
    empty = count == 0
    low, high = np.where(empty, np.nan, low), np.where(empty, np.nan, high)
    mean = np.where(empty, np.nan, total / np.maximum(count, 1))
    slopes = np.sign(np.diff(np.where(known, values, 0.0)))
    turns = np.flatnonzero(slopes[1:] * slopes[:-1] < 0) + 1
    often = np.bincount(bins[turns], minlength=_BINS) >= _TURNS
    around = np.convolve(often, np.ones(3), mode="same") >= 2
    whole = np.ptp(values[known]) if known.any() else 0.0
    wide = np.where(empty, 0.0, high - low) > _LEAST * whole
    middles = begin + (end - begin) * (np.arange(_BINS) + 0.5) / _BINS
    rippled = often & around & wide
    below = np.clip(np.floor(_BINS * share - 0.5).astype(int), 0, _BINS - 1)
    above = np.clip(below + 1, 0, _BINS - 1)
    hidden = rippled[below] & rippled[above]
    return Envelope(middles, low, mean, high, rippled, hidden)


def draw_curve(
    panel: "Axes",
    time: np.ndarray,
    values: np.ndarray,
    color: str,
    label: str = "",
    dashes: Any = "-",
) -> None:
    """A line, and in the place of ripples that run together their envelope and mean.

    Args:
        panel: Axes of matplotlib.
        time: [s], shape (T,).
        values: Shape (T,); NaN where there are none.
        color: Of the line.
        label: For a legend; none where it is empty.
        dashes: Line style.
    """
    how: Any = {"color": color, "linestyle": dashes, "lw": 1.2}
    found = envelope(time, values) if len(time) > 2 * _BINS else None
    if found is None or not found.rippled.any():
        panel.plot(time, values, label=label or None, **how)
        return
    line = np.where(found.hidden, np.nan, values)
    panel.plot(time, line, label=label or None, **how)
    shown = np.where(found.rippled, 1.0, np.nan)
    bounds = found.low * shown, found.high * shown
    panel.fill_between(found.time, *bounds, color=color, alpha=0.3, lw=0.4)
    panel.plot(found.time, found.mean * shown, color=color, lw=0.9)
    others = panel.figure.axes
    if not any(text.get_text() == _WORDS for one in others for text in one.texts):
        panel.text(
            *(0.0, 1.01, _WORDS),
            transform=panel.transAxes,
            fontsize=7,
            color="#66707e",
            va="bottom",
        )
