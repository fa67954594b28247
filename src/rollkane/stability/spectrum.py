"""Eigenvalues of a linear model, less those that symmetry and families make zero."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from .local_model import LocalModel
from .newton import Directions

# Of the norm of a linear model: what is less is zero. Solved to rounding, a model of
# some 1e3 operations is known to 1e-13 of it.
_ZERO = 1e-11
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
    """

    eigenvalues: np.ndarray
    modes: np.ndarray
    errors: np.ndarray
    zeros: dict[str, complex]
    family: np.ndarray
    determinant: float
    counts: tuple[int, ...]

    @property
    def unstable(self) -> int:
        """How many grow, beyond what rounding explains."""
        return int(np.sum(np.real(self.eigenvalues) > self.errors))


def spectrum(
    local: LocalModel,
    size: np.ndarray,
    group: Directions,
    names: Sequence[str],
    labels: Sequence[tuple[str, np.ndarray]],
    dimensions: tuple[int, ...] | None = None,
) -> Spectrum:
    """Eigenvalues of the linear model around a steady motion.

    Args:
        local: The problem there.
        size: What coordinates are measured by, shape (n,).
        group: Directions of the group.
        names: Of the generators.
        labels: Quantities by which a family is told: names and derivatives by x.
        dimensions: The counts, where they are known; None: by rank.

    Source: docs/theory.md, (10.4): the group's directions S and the family's N are
    invariant, ``A S`` in S and ``A N`` in S + N, so that A acts on what is left.
    """
    A = local.slope / size[:, None] * size[None]
    n = size.size
    S = group.moved
    norm = float(np.linalg.norm(A))
    left, Q, family, slow, counts = _deflated(A, _complement(S), norm, dimensions)
    values, vectors = _eigen(left)
    errors = _errors(left, values, vectors, norm)
    modes = size[:, None] * (Q @ vectors)
    modes = modes / np.maximum(np.linalg.norm(modes, axis=0), 1e-300)
    family, first = size[:, None] * family, counts[0]
    zeros = _of_group(local, S, A, size, names)
    told = [f"family: {name}" for name in _labelled(family[:, :first], labels)]
    told += [f"drift {k + 1} along the family" for k in range(family.shape[1] - first)]
    zeros |= {name: complex(v) for name, v in zip(told, slow, strict=True)}
    assert len(zeros) + values.size == n
    product = float(np.linalg.det(left))
    own = family[:, :first]
    return Spectrum(values, modes, errors, zeros, own, product, counts)


def _deflated(
    A: np.ndarray,
    basis: np.ndarray,
    norm: float,
    dimensions: tuple[int, ...] | None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, tuple[int, ...]]:
    """What a matrix is on a basis, without what it takes to zero, again and again.

    Returns:
        The matrix that is left and its basis; the directions that went and their
        eigenvalues, as computed; how many went each time, to none.
    """
    inner: np.ndarray = basis.T @ A @ basis
    gone, slow, counts = basis[:, :0], np.zeros(0, complex), (0,) * 0
    while not counts or counts[-1]:
        known = None if dimensions is None else dimensions[len(counts)]
        N = _null(inner, norm, known)
        counts = (*counts, N.shape[1])
        gone = np.concatenate([gone, basis @ N], axis=1)
        slow = np.concatenate([slow, _eigen(N.T @ inner @ N)[0]])
        rest = _complement(N)
        basis, inner = basis @ rest, rest.T @ inner @ rest
    return inner, basis, gone, slow, counts


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


def _null(matrix: np.ndarray, norm: float, dimensions: int | None) -> np.ndarray:
    """Orthonormal directions that a matrix leaves at zero, by rank or by number."""
    if not matrix.size:
        return np.zeros((matrix.shape[0], 0))
    _, values, across = np.linalg.svd(matrix)
    if dimensions is not None:
        return across[values.size - dimensions :].T
    return across[values <= _ZERO * norm].T


def _errors(
    matrix: np.ndarray, values: np.ndarray, vectors: np.ndarray, norm: float
) -> np.ndarray:
    """First-order bounds of rounding: that of the matrix, by each condition number."""
    if not values.size:
        return np.zeros(0)
    rounding = 1e3 * np.finfo(float).eps * norm  # of a matrix from some 1e3 operations
    try:
        dual = np.linalg.inv(vectors)
    except np.linalg.LinAlgError:
        return np.full(values.size, np.sqrt(rounding * norm))
    condition = np.linalg.norm(dual, axis=1) * np.linalg.norm(vectors, axis=0)
    # of a multiple eigenvalue the root of the rounding is all that can be said
    return np.minimum(rounding * condition, 10.0 * np.sqrt(rounding * norm))


def _of_group(
    local: LocalModel,
    S: np.ndarray,
    A: np.ndarray,
    size: np.ndarray,
    names: Sequence[str],
) -> dict[str, complex]:
    """Eigenvalues along the group, each by a generator that has most of it."""
    if not S.shape[1]:
        return {}
    values, vectors = np.linalg.eig(S.T @ A @ S)
    parts = S.T @ (local.groups / size[:, None])
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
    return chosen[:r]


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
