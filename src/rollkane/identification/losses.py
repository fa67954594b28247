"""Losses of misfits, and what outliers do with them to variances and scales."""

from collections.abc import Callable
from typing import NamedTuple, TypeAlias

import numpy as np

from ..validation.checks import FieldError

_LEAST_SCORE = 1e-6  # of a mean slope, beside 1 of least squares
# Samples of a column that coordinates leave, at least, to tell its noise by: of so few
# the variance has a deviation of twice itself (the root of 2 over them).
LEAST_LEFT = 0.5
# Mean of the lesser of r^2 and 1 for a standard normal r: 1 - 2 phi(1).
_CUT_SQUARE = 1.0 - (2.0 / (np.pi * np.e)) ** 0.5

# Of squared misfits, element by element.
_OfSquares: TypeAlias = Callable[[np.ndarray], np.ndarray]


class Loss(NamedTuple):
    """A loss rho(s) of s = r^2, and its first derivative.

    Attributes:
        value: rho(s), with rho(s) = s for small s.
        weight: rho'(s).
    """

    value: _OfSquares
    weight: _OfSquares


_same: _OfSquares = lambda s: s
_huber: _OfSquares = lambda s: np.where(
    s <= 1.0, s, 2.0 * np.sqrt(np.maximum(s, 1.0)) - 1.0
)
_huber_weight: _OfSquares = lambda s: 1.0 / np.sqrt(np.maximum(s, 1.0))
_soft: _OfSquares = lambda s: 2.0 * (np.sqrt(1.0 + s) - 1.0)
_soft_weight: _OfSquares = lambda s: 1.0 / np.sqrt(1.0 + s)
_cauchy_weight: _OfSquares = lambda s: 1.0 / (1.0 + s)
LOSSES = {
    "linear": Loss(_same, np.ones_like),
    "huber": Loss(_huber, _huber_weight),
    "soft_l1": Loss(_soft, _soft_weight),
    "cauchy": Loss(np.log1p, _cauchy_weight),
}
SQUARES = LOSSES["linear"]


def loss_of(name: str) -> Loss:
    """A loss by its name.

    Raises:
        FieldError: an unknown one.
    """
    if name not in LOSSES:
        remedy = f"use one of {tuple(LOSSES)}"
        raise FieldError("fit.loss", name, "is not known", remedy)
    return LOSSES[name]


def score_moments(
    residual: np.ndarray, loss: Loss, taken: float = 0.0
) -> tuple[float, float]:
    """Means of psi' and of psi^2 over the samples, with psi(r) = r rho'(r^2).

    Huber's: the loss changes the variance of the estimates by the second over the
    square of the first.

    Args:
        residual: Over their deviations, shape (N,); zeros are no samples.
        loss: Of their squares.
        taken: How many of the samples coordinates take out: psi^2 of what is left is
            the less by it, and the more uneven psi' is, the less is known of its mean,
            which Huber's factor ``K = 1 + taken / N var(psi') / mean(psi')^2`` allows
            for.

    Source: Huber, Robust Statistics (1981), section 7.6.
    """
    known = residual[residual != 0.0]
    if not known.size:
        return 1.0, 1.0

    def psi(r: np.ndarray) -> np.ndarray:
        return r * loss.weight(r * r)

    step = 1e-4  # by differences: 1e-8 of the slope of numbers of about one
    slopes = (psi(known + step) - psi(known - step)) / (2.0 * step)
    # a loss that falls off over most samples tells next to nothing by them
    slope = max(float(np.mean(slopes)), _LEAST_SCORE)
    uneven = 1.0 + taken / known.size * float(np.var(slopes)) / slope**2
    square = np.sum(psi(known) ** 2) / max(known.size - taken, LEAST_LEFT)
    return slope, uneven**2 * float(square)


def scale_of(residual: np.ndarray, left: float, loss: Loss) -> float:
    """Scale of residuals, consistent where they are normal.

    With squares the root of their mean. With any other loss that of Huber's proposal
    2: at which the lesser of ``(r / scale)^2`` and 1 has the mean that it has for
    normal noise. An outlier counts as 1, however far it is; nearly half of the samples
    may be some. A tenth of them makes it 14 % larger.

    Args:
        residual: Of samples, shape (N,).
        left: How many of them are left by what was fitted to them, above zero.
        loss: Of their squares.

    Returns:
        In the unit of the residuals; 0 where so many are zero.

    Source: Huber, Robust Statistics (1981), section 6.4, with the constant 1 at which
    the losses here begin to bend.
    """
    squares = np.sort(residual**2)
    if loss is SQUARES:
        return float(np.sqrt(squares.sum() / left))
    # with the k least inside of the scale: sum of k squares / scale^2 + N - k
    inside = np.arange(1, squares.size + 1)
    rest = _CUT_SQUARE * left - (squares.size - inside)
    known = np.where(rest > 0.0, np.cumsum(squares) / np.maximum(rest, 1e-300), np.inf)
    fits = known <= np.append(squares[1:], np.inf)
    return float(np.sqrt(known[np.argmax(fits)]))
