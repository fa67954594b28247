"""Eigenvalues of a linear model, less those that symmetry and families make zero."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from .newton import Point

# What rounding of some 1e3 operations leaves open of a column of a linear model, beside
# what the column's own terms are of: its length, or what the motion alone gives.
_ROUNDING = 1e3 * np.finfo(float).eps
# Of columns of unit length by that: what is less is zero. One that is left with more
# than _CLEAR may as well be slow: solved to rounding, zeros are 1e-14 or less.
_ZERO, _CLEAR = 1e-11, 1e-12
# Of columns and rows of unit length: less than that apart they are one direction. Those
# of the group and of a family are known to 1e-8 (the rank that they were found by), and
# what tells a family's members apart does so by 1e-4 or more.
_APART = 1e-6


class Spectrum(NamedTuple):
    """Eigenvalues of ``dx' = A x`` around a steady motion.

    Attributes:
        eigenvalues: Those that decide: neither of the group nor of the family, by
            falling growth [1/s], shape (k,).
        modes: Their directions in the independent coordinates, up to motions along
            group and family, shape (n, k).
        errors: How far rounding may move each [1/s], shape (k,).
        zeros: By name: of each group direction that moves the state (zero, or plus and
            minus i times the turn that turns the direction), and of each dimension of
            the family.
        family: Directions of the family, orthogonal to the group's, shape (n, d).
        determinant: Product of the eigenvalues.
        counts: Dimensions of the family, then of steady drifts along it, and so on to
            zero.
        clear: Whether what counts as zero is so to rounding, and not only slow.
    """

    eigenvalues: np.ndarray
    modes: np.ndarray
    errors: np.ndarray
    zeros: dict[str, complex]
    family: np.ndarray
    determinant: float
    counts: tuple[int, ...]
    clear: bool

    @property
    def unstable(self) -> int:
        """How many grow, beyond what rounding explains."""
        return int(np.sum(np.real(self.eigenvalues) > self.errors))


def spectrum(
    point: Point,
    names: Sequence[str],
    labels: Sequence[tuple[str, np.ndarray]],
    dimensions: tuple[int, ...] | None = None,
) -> Spectrum:
    """Eigenvalues of the linear model around a steady motion.

    Args:
        point: The solution.
        names: Of the generators.
        labels: Quantities by which a family is told: names and derivatives by x.
        dimensions: The counts, where they are known; None: by rank.

    Source: docs/theory.md, (10.4): the group's directions S and the family's N are
    invariant, ``A S`` in S and ``A N`` in S + N, so that A acts on what is left.
    """
    local, size, S = point.local, point.size, point.group.moved
    A = local.slope / size[:, None] * size[None]
    n = size.size
    deflated = _deflated(A, _complement(S), point.least, dimensions)
    left, Q, family, slow, counts, clear = deflated
    values, vectors = _eigen(left)
    rounding = _ROUNDING * _column_sizes(A, point.least)
    errors = _errors(left, Q, values, vectors, rounding)
    modes = size[:, None] * (Q @ vectors)
    modes = modes / np.maximum(np.linalg.norm(modes, axis=0), 1e-300)
    family, first = size[:, None] * family, counts[0]
    zeros = _of_group(point, A, names)
    told = [f"family: {name}" for name in _labelled(family[:, :first], labels)]
    told += [f"drift {k + 1} along the family" for k in range(family.shape[1] - first)]
    zeros |= {name: complex(v) for name, v in zip(told, slow, strict=True)}
    assert len(zeros) + values.size == n
    product = float(np.linalg.det(left))
    own = family[:, :first]
    return Spectrum(values, modes, errors, zeros, own, product, counts, clear)


def strays(point: Point) -> np.ndarray:
    """Of the rates beside each group direction, what lies in no group direction.

    Nothing does where the group is one of symmetries: as a share of the column or of
    what the motion gives, shape (K,).
    """
    A = point.local.slope / point.size[:, None] * point.size[None]
    ways = point.local.groups / point.size[:, None]
    length = np.linalg.norm(ways, axis=0)
    ways = ways / np.where(length > 0.0, length, 1.0)
    across = _complement(point.group.moved)
    own = _column_sizes(A, point.least).max(initial=point.least)
    return np.linalg.norm(across.T @ A @ ways, axis=0) / own


def _deflated(
    A: np.ndarray,
    basis: np.ndarray,
    least: float,
    dimensions: tuple[int, ...] | None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, tuple[int, ...], bool]:
    """What a matrix is on a basis, without what it takes to zero, again and again.

    Returns:
        The matrix that is left and its basis; the directions that went and their
        eigenvalues, as computed; how many went each time, to none; whether they are
        zero to rounding.
    """
    inner: np.ndarray = basis.T @ A @ basis
    gone, slow, counts, clear = basis[:, :0], np.zeros(0, complex), (0,) * 0, True
    while not counts or counts[-1]:
        known = None if dimensions is None else dimensions[len(counts)]
        N, left = _null(inner, least, known)
        clear = clear and left <= _CLEAR
        counts = (*counts, N.shape[1])
        gone = np.concatenate([gone, basis @ N], axis=1)
        slow = np.concatenate([slow, _eigen(N.T @ inner @ N)[0]])
        rest = _complement(N)
        basis, inner = basis @ rest, rest.T @ inner @ rest
    return inner, basis, gone, slow, counts, clear


def _column_sizes(matrix: np.ndarray, least: float) -> np.ndarray:
    """What rounding of the columns of a linear model is to be told beside [1/s].

    Their own lengths, not that of the whole: a stiff spring makes no other force less
    exact. Terms of a column that cancel are of the motion's or the weight's size.
    """
    return np.maximum(np.linalg.norm(matrix, axis=0), least)


def _eigen(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Eigenvalues by falling growth, and their directions."""
    if not matrix.size:
        return np.zeros(0, complex), np.zeros((matrix.shape[0], 0), complex)
    found = np.linalg.eig(matrix)
    values = np.asarray(found[0], complex)
    order = np.lexsort((-np.imag(values), -np.real(values)))
    return values[order], np.asarray(found[1], complex)[:, order]


def _complement(S: np.ndarray) -> np.ndarray:
    """Orthonormal directions at right angles to some."""
    n, r = S.shape
    return np.linalg.qr(S, mode="complete")[0][:, r:] if r else np.eye(n)


def _null(
    matrix: np.ndarray, least: float, dimensions: int | None
) -> tuple[np.ndarray, float]:
    """Orthonormal directions that a matrix leaves at zero, by rank or by number.

    And the largest share of its columns that is left in them.
    """
    if not matrix.size:
        return np.zeros((matrix.shape[0], 0)), 0.0
    columns = _column_sizes(matrix, least)
    _, values, across = np.linalg.svd(matrix / columns)
    count = int(np.sum(values <= _ZERO)) if dimensions is None else dimensions
    kept = values.size - count
    found = across[kept:].T / columns[:, None]
    return np.linalg.qr(found)[0], float(values[kept:].max(initial=0.0))


def _errors(
    matrix: np.ndarray,
    basis: np.ndarray,
    values: np.ndarray,
    vectors: np.ndarray,
    rounding: np.ndarray,
) -> np.ndarray:
    """First-order bounds of rounding of the columns, by each eigenvalue's condition."""
    if not values.size:
        return np.zeros(0)
    # of a multiple eigenvalue the root of the rounding is all that can be said, beside
    # the fastest rate, also of what would grow but for what turns it
    fastest = np.sqrt(np.abs(matrix * matrix.T).max())
    most = 10.0 * np.sqrt(_ROUNDING) * max(float(np.abs(values).max()), float(fastest))
    try:
        dual = np.linalg.inv(vectors)
    except np.linalg.LinAlgError:
        return np.full(values.size, most)
    across = np.linalg.norm(rounding[:, None] * (basis @ vectors), axis=0)
    with np.errstate(over="ignore"):  # of vectors that are one to rounding
        dual_lengths = np.linalg.norm(dual, axis=1)
    return np.minimum(dual_lengths * across, most)


def _of_group(point: Point, A: np.ndarray, names: Sequence[str]) -> dict[str, complex]:
    """Eigenvalues along the group, each by a generator that has most of it."""
    S = point.group.moved
    if not S.shape[1]:
        return {}
    values, vectors = np.linalg.eig(S.T @ A @ S)
    parts = S.T @ (point.local.groups / point.size[:, None])
    length = np.linalg.norm(parts, axis=0)
    weights = np.abs(vectors.conj().T @ (parts / np.where(length > 0.0, length, 1.0)))
    chosen = _independent(parts / np.where(length > 0.0, length, 1.0))
    found: dict[str, complex] = {}
    for k in np.argsort(np.abs(values)):
        best = max(chosen, key=lambda j: weights[k, j])
        chosen.remove(best)
        found[names[best]] = complex(values[k])
    return {name: found[name] for name in names if name in found}


def _independent(columns: np.ndarray) -> list[int]:
    """As many columns as their rank, the first ones that will do."""
    chosen: list[int] = []
    r, count = columns.shape
    if count == r and np.linalg.svd(columns, compute_uv=False)[-1] > _APART:
        return list(range(count))  # of these the first ones are further apart still
    for j in range(count):
        tried = np.linalg.svd(columns[:, [*chosen, j]], compute_uv=False)
        if tried[-1] > _APART:
            chosen.append(j)
    # of generators that are nearly one, far from the axes of turns, any will do
    return [*chosen, *(j for j in range(count) if j not in chosen)][:r]


def _labelled(
    family: np.ndarray, labels: Sequence[tuple[str, np.ndarray]]
) -> list[str]:
    """A quantity for each dimension, which tells the members of the family apart."""
    d = family.shape[1]
    names: list[str] = []
    seen = np.zeros((0, d))
    for name, slope in labels:
        if len(names) == d:
            break
        row = slope @ family
        length = float(np.linalg.norm(row))
        if length <= _APART * float(np.linalg.norm(slope)):
            continue
        tried = np.concatenate([seen, row[None] / length])
        if np.linalg.svd(tried, compute_uv=False)[-1] > _APART:
            names.append(name)
            seen = tried
    return names + [f"direction {k + 1}" for k in range(len(names), d)]
