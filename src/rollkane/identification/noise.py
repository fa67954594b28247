"""Noise of channels whose deviation is not given."""

import numpy as np
from jaxtyping import Array

from .losses import LEAST_LEFT, Loss, scale_of

# Least noise of a channel without sigma, before a fit has seen its misfits [its size].
_LEAST_NOISE = 1e-3
# A record without noise: not below the runs' own accuracy [its size].
_LEAST_FOUND = 1e-9


def guessed_noise(values: Array) -> float:
    """Of samples, by their fourth differences, to which smooth motion gives little.

    Those of white noise have 70 times its variance (1 + 16 + 36 + 16 + 1).
    """
    least = _LEAST_NOISE * _size(values)
    wild = np.diff(np.asarray(values), n=4, axis=0)
    if not np.isfinite(wild).any():
        return 10.0 * least
    return max(least, float(np.sqrt(np.nanmean(wild**2) / 70.0)))


def found_noise(
    old: np.ndarray, misfit: np.ndarray, taken: np.ndarray, values: Array, loss: Loss
) -> np.ndarray:
    """Deviations by a fit's misfits, of a channel's columns.

    What the coordinates took out of a column's misfits is put back: the sum of its
    squares is expected to be ``sum(1 - h)``, with h the diagonal of
    ``J (J^T J)^-1 J^T``, priors in J. A column of which too little is left keeps its
    deviation. Of a robust loss the scale is robust, too
    (:func:`rollkane.identification.losses.scale_of`).

    Args:
        old: Deviations so far [unit of the samples], shape (k,).
        misfit: Over these, NaN where no sample is, shape (T, k).
        taken: Of each, h, shape (T, k).
        values: Samples, for their size.
        loss: Of the squared misfits.
    """
    left = np.sum(np.isfinite(misfit) - taken, axis=0)
    factors = [
        scale_of(column[np.isfinite(column)], float(rest), loss)
        if rest > LEAST_LEFT
        else 1.0
        for column, rest in zip(misfit.T, left, strict=True)
    ]
    return np.maximum(old * np.array(factors), _LEAST_FOUND * _size(values))


def _size(values: Array) -> float:
    """Root of the mean square of samples; 1 where all are zero."""
    size = float(np.sqrt(np.nanmean(np.asarray(values) ** 2)))
    return size if size > 0.0 else 1.0
