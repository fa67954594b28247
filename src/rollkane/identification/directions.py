"""Directions of coordinates that misfits show, hardly show, and do not show.

A number that the first guess does not show may be shown by where others go. One whose
effect is a product with a number that is zero but for noise (an arm across a spin that
is none) is then seen by noise alone: it would go as far as noise sends it, and what it
is multiplied with would seem known the better for it. So it waits until holding it
would bias others, or samples speak for it beyond their noise.
"""

from typing import NamedTuple

import numpy as np

from .evaluation import Evaluation

# Singular values of the scaled Jacobian below this share of the largest are rounding:
# runs are good to 1e-9 of their size, and their derivatives to little worse.
UNSEEN = 1e-7
# A share of an unseen direction that it may lose: it turns by an angle of that, by
# which words for it are chosen, too.
_SMALL = 1e-2
_ALIKE = 10.0  # times what is unseen is as unseen: a matter of orders of magnitude
_ROUNDING = 1e-12  # of lengths of orthonormal rows: 1e4 operations
# What the first guess does not show moves once its size is worth this many deviations
# of all samples together: one held, and wrong by its size, biases no other by more (1,
# beside the 1 of a pull to the guess over short horizons: their root sum of squares) ..
_TOLD = 2.0**0.5
# .. or its step is beyond this many deviations, which noise does once in 370 times.
_SURE = 3.0


class Spectrum(NamedTuple):
    """Singular values of a Jacobian whose columns are relative to a scale.

    Attributes:
        values: Decreasing, shape (P,).
        directions: Rows: directions in scaled coordinates, shape (P, P).
        scale: Of the coordinates, shape (P,).
        rounding: Of the values.
    """

    values: np.ndarray
    directions: np.ndarray
    scale: np.ndarray
    rounding: float

    @property
    def seen(self) -> np.ndarray:
        """Which directions change the prediction, shape (P,)."""
        largest = self.values.max(initial=0.0)
        return self.values > max(UNSEEN * largest, self.rounding)

    @property
    def condition(self) -> float:
        """Largest over smallest singular value; infinite where one is not seen."""
        if not self.seen.all():
            return np.inf
        return float(self.values[0] / self.values[-1])


def spectrum(
    at: Evaluation, scale: np.ndarray, inside: np.ndarray | slice = slice(None)
) -> Spectrum:
    """Singular values of the Jacobian by coordinates relative to their scale.

    What samples say of a direction is known to a share of all that they say; what a
    prior says, exactly. So the row of a prior counts as no longer than the samples'
    largest singular value: one number that is known well hides no other. All are zero
    where the Jacobian is not finite.

    Args:
        at: Misfits and their derivatives.
        scale: Of the coordinates, shape (P,).
        inside: Which coordinates are looked at.
    """
    scale = scale[inside]
    columns = at.jacobian[:, inside] * scale
    if not np.isfinite(columns).all():
        return Spectrum(np.zeros(scale.size), np.eye(scale.size), scale, at.rounding)
    rows = _rows(at, columns)
    _, values, directions = np.linalg.svd(rows, full_matrices=False)
    found = Spectrum(values, directions, scale, at.rounding)
    return found if found.seen.all() else _plain(found, rows)


def _plain(found: Spectrum, rows: np.ndarray) -> Spectrum:
    """The same with unseen directions of as few coordinates as they can be of.

    One that is hardly seen has small shares of whatever can make up for the rest of it.
    Without them it is as unseen; with them, all of these would seem unseen.
    """
    seen, unseen = found.seen, found.directions[~found.seen]
    few = np.linalg.qr(np.where(np.abs(unseen) < _SMALL, 0.0, unseen).T)[0].T
    least = max(UNSEEN * found.values.max(initial=0.0), found.rounding)
    if np.linalg.norm(rows @ few.T, axis=0).max() > _ALIKE * least:
        return found
    left = without(rows, np.ones(found.scale.size), few)
    _, values, directions = np.linalg.svd(left, full_matrices=False)
    directions = np.where(_whole(few), 0.0, directions[: seen.sum()])
    values = np.append(values[: seen.sum()], found.values[~seen])
    return found._replace(values=values, directions=np.concatenate([directions, few]))


def _rows(at: Evaluation, columns: np.ndarray) -> np.ndarray:
    """Rows as long as they count, as many as there are columns, or more."""
    missing = np.zeros((max(columns.shape[1] - len(columns), 0), columns.shape[1]))
    return np.concatenate([columns / _longer(at, columns)[:, None], missing])


def _longer(at: Evaluation, columns: np.ndarray) -> np.ndarray:
    """By how much rows of priors are longer than they count, shape (N,); else 1."""
    samples, priors = np.split(columns, [at.of_samples.size])
    largest = np.linalg.svd(samples, compute_uv=False).max(initial=0.0)
    most = max(float(largest), at.rounding / UNSEEN) or np.inf
    length = np.linalg.norm(priors, axis=1)
    return np.append(np.ones(len(samples)), np.maximum(length / most, 1.0))


def not_seen(at: Evaluation, size: np.ndarray) -> np.ndarray:
    """Directions relative to sizes that change nothing, orthonormal rows (D, P)."""
    parts = spectrum(at, size)
    return parts.directions[~parts.seen]


def waiting(
    at: Evaluation, size: np.ndarray, first: np.ndarray, *, shown: bool = False
) -> np.ndarray:
    """Which of the directions that a first guess does not show still wait.

    Whatever the other directions do to the misfits is taken out before.

    Args:
        at: Misfits and their derivatives, weighted.
        size: Of the coordinates, shape (P,).
        first: Orthonormal rows, relative to the sizes, shape (D, P).
        shown: Without those that others make up for, by more than a small share: these
            are unseen in another direction by now, as the derivatives tell.

    Returns:
        Orthonormal rows, relative to the sizes.
    """
    columns = at.jacobian * size
    if not len(first) or not np.isfinite(columns).all():
        return first[:0]
    rows = _rows(at, columns)
    residual = np.append(
        at.residual / _longer(at, columns), np.zeros(len(rows) - len(columns))
    )
    others = np.linalg.svd(first)[2][len(first) :]
    along, values, _ = np.linalg.svd(rows @ others.T, full_matrices=False)
    least = max(UNSEEN * values.max(initial=0.0), at.rounding)
    along, values = along[:, values > least], values[values > least]
    _, strength, mixed = np.linalg.svd(rows @ first.T, full_matrices=False)
    directions = mixed @ first
    onto = along.T @ (rows @ directions.T)
    own = rows @ directions.T - along @ onto
    left = residual - along @ (along.T @ residual)
    seen = np.linalg.norm(own, axis=0)
    shares = own.T @ left / np.maximum(seen, np.finfo(seen.dtype).tiny)
    count = max(np.count_nonzero(residual) - along.shape[1] - len(first), 1)
    noise = max(left @ left / count, 1.0)
    waits = (strength < _TOLD) & (shares**2 <= _SURE**2 * noise)
    if shown:
        turned = np.linalg.norm(onto / values[:, None], axis=0)
        waits &= (seen > least) | (turned < _SMALL)
    return directions[waits]


def without(jacobian: np.ndarray, size: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Derivatives by what is left of coordinates without some directions.

    Args:
        jacobian: Shape (N, P).
        size: Of the coordinates, shape (P,).
        rows: Orthonormal directions, relative to the sizes, shape (D, P).
    """
    if not len(rows):
        return jacobian
    scaled = jacobian * size
    left = scaled - (scaled @ rows.T) @ rows
    return np.where(_whole(rows), 0.0, left) / size


def _whole(rows: np.ndarray) -> np.ndarray:
    """Coordinates that orthonormal rows have all of, but for rounding, shape (P,)."""
    return np.linalg.norm(rows, axis=0) > 1.0 - _ROUNDING
