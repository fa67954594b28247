"""How well parameters are known: covariances from J^T J, and what is not seen."""

from typing import Any, cast

import numpy as np
from jax.scipy.special import gammainc
from scipy import linalg  # pyright: ignore[reportMissingTypeStubs]

from .directions import Spectrum, not_seen, spectrum
from .evaluation import Evaluation
from .layout import Layout
from .losses import SQUARES, Loss, score_moments

_MOVES = 1e-6  # of a number's largest slope: directions are known to 1e-7, as UNSEEN


def coordinate_covariance(
    at: Evaluation,
    layout: Layout,
    z: np.ndarray,
    loss: Loss = SQUARES,
    *,
    bounded: bool = True,
) -> np.ndarray:
    """Covariance of the coordinates, ``(J^T J)^-1`` of what is seen, shape (P, P).

    Coordinates on a bound that the descent leads out of are known: no variance, unless
    bounds are left out.

    Of another loss, with J of the samples, Q of the priors, and s and v the means of
    psi' and psi^2 over a channel's samples: estimates obey ``J^T psi + Q^T q = 0``. To
    first order this changes by ``A = J^T s J + Q^T Q`` times the coordinates, and it
    varies by ``B = J^T v J + Q^T Q``, as a prior has its own deviation: the covariance
    is ``A^-1 B A^-1``; of one channel without priors ``(v / s^2) (J^T J)^-1``, and of
    priors alone ``(Q^T Q)^-1``.
    """
    inside = ~(active(at, layout, z, loss) & bounded)
    found = np.zeros((z.size, z.size))
    parts = spectrum(at, layout.scale, inside)
    if not parts.seen.any():
        return found
    slope, square = row_moments(at, parts, inside, loss)
    rows = np.sqrt(slope)[:, None] * at.jacobian[:, inside]
    varies = square / slope
    root, along = _root_of_inverse(rows, parts)
    middle = along.T @ (varies[:, None] * along)
    found[np.ix_(inside, inside)] = root @ middle @ root.T
    return found


def row_moments(
    at: Evaluation, parts: Spectrum, inside: np.ndarray | slice, loss: Loss
) -> tuple[np.ndarray, np.ndarray]:
    """Means of psi' and of psi^2 of each row's channel, shape (N,); 1 of priors.

    Channels have their own, as one may have outliers and another none; of squares all
    are 1, as deviations are as they are told.

    Args:
        at: Misfits and their derivatives.
        parts: Spectrum of the coordinates inside.
        inside: Which coordinates no bound holds.
        loss: Of the samples.
    """
    slope, square = np.ones(at.residual.size), np.ones(at.residual.size)
    if loss is SQUARES or not parts.seen.any():
        return slope, square
    _, along = _root_of_inverse(at.jacobian[:, inside], parts)
    taken = np.sum(along**2, axis=1)
    everything = np.zeros(at.of_samples.size, int)
    channels = everything if at.channels is None else at.channels
    for one in np.unique(channels):
        own = np.flatnonzero(channels == one)
        known = at.of_samples[own], loss, float(np.sum(taken[own]))
        slope[own], square[own] = score_moments(*known)
    return slope, square


def _root_of_inverse(
    rows: np.ndarray, parts: Spectrum
) -> tuple[np.ndarray, np.ndarray]:
    """R and Q with ``R R^T = (rows^T rows)^-1`` of what is seen, and ``Q = rows R``.

    A firm prior's row may be 1e10 times as long as the others. Householder reflections
    of rows that are sorted by length, with pivoting, change each by roundings of its
    own length (Cox and Higham, 1998), singular values by roundings of the longest.
    """
    some = parts.directions[parts.seen].T
    seen = np.eye(parts.scale.size) if parts.seen.all() else some
    basis = parts.scale[:, None] * seen
    columns = rows @ basis
    lengths = np.linalg.norm(columns, axis=1)
    order = np.argsort(-lengths)
    numeric = cast(Any, linalg)
    sorted_along, upper, places = numeric.qr(
        columns[order], mode="economic", pivoting=True
    )
    root = numeric.solve_triangular(upper, basis[:, places].T, trans="T").T
    along = np.empty_like(sorted_along)
    along[order] = sorted_along
    return root, along


def active(
    at: Evaluation, layout: Layout, z: np.ndarray, loss: Loss = SQUARES
) -> np.ndarray:
    """Coordinates that only their bound keeps from going on, shape (P,)."""
    weights = at.by_kind(loss.weight(at.of_samples**2), 1.0)
    gradient = at.jacobian.T @ (weights * at.residual)
    low = (z <= layout.lower) & (gradient > 0.0)
    return low | ((z >= layout.upper) & (gradient < 0.0))


def unseen_directions(at: Evaluation, layout: Layout) -> np.ndarray:
    """Directions in coordinates that change nothing, rows, shape (D, P)."""
    return not_seen(at, layout.scale) * layout.scale


def hidden(slopes: np.ndarray, unseen: np.ndarray, where: slice) -> np.ndarray:
    """Which numbers unseen directions move.

    Args:
        slopes: Derivatives of the numbers by their own coordinates, shape (n, k).
        unseen: Directions of all coordinates, rows, shape (D, P).
        where: Which of them are the numbers' own.
    """
    if not unseen.size:
        return np.zeros(len(slopes), bool)
    away = np.abs(slopes @ unseen[:, where].T).max(axis=1)
    size = np.abs(slopes).max(initial=0.0) * np.abs(unseen).max()
    return away > _MOVES * size


def names_of(layout: Layout) -> tuple[str, ...]:
    """Names of the rows of a covariance."""
    return tuple(
        entry.name + label
        for entry in layout.entries
        for label in entry.transform.labels()
    )


def named_covariance(layout: Layout, z: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Covariance of the named numbers, from that of the coordinates."""
    rows = np.zeros((len(names_of(layout)), layout.size))
    first = 0
    for entry in layout.entries:
        own = entry.at(z).shown_slope
        rows[first : first + own.shape[0], entry.where] = own
        first += own.shape[0]
    return rows @ known @ rows.T


def rise_of(level: float, freedom: int) -> float:
    """Quantile of chi-square: what a joint region's chi2 rises by at most.

    By bisection of the incomplete gamma function, which grows in its argument.
    """
    low, high = 0.0, freedom + 10.0

    def below(x: float) -> bool:
        return float(gammainc(0.5 * freedom, 0.5 * x)) < level

    while below(high):
        low, high = high, 2.0 * high
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if below(middle) else (low, middle)
    return high
