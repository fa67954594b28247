"""Eigenvalues of a linear model, less those that symmetry and families make zero."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from .local_model import LocalModel
from .newton import SMALL, Directions


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
    """

    eigenvalues: np.ndarray
    modes: np.ndarray
    errors: np.ndarray
    zeros: dict[str, complex]
    family: np.ndarray
    determinant: float

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
    dimensions: int | None = None,
) -> Spectrum:
    """Eigenvalues of the linear model around a steady motion.

    Args:
        local: The problem there.
        size: What coordinates are measured by, shape (n,).
        group: Directions of the group.
        names: Of the generators.
        labels: Quantities by which a family is told: names and derivatives by x.
        dimensions: Of the family, where they are known; None: by rank.

    Source: docs/theory.md, (9.8): the group's directions S and the family's N are
    invariant, ``A S`` in S and ``A N`` in S + N, so that A acts on what is left.
    """
    A = local.slope / size[:, None] * size[None]
    n = size.size
    S = np.linalg.qr(group.moved / size[:, None])[0]
    Q = _complement(S)
    inner = Q.T @ A @ Q
    N = _null(inner, dimensions)
    rest = _complement(N)
    left = rest.T @ inner @ rest
    values, vectors = _eigen(left)
    errors = _errors(left, values, vectors, float(np.linalg.norm(A)))
    modes = size[:, None] * (Q @ rest @ vectors)
    modes = modes / np.maximum(np.linalg.norm(modes, axis=0), 1e-300)
    family = size[:, None] * (Q @ N)
    zeros = _of_group(local, S, A, size, names)
    slow, _ = _eigen(N.T @ inner @ N)
    told = _labelled(family, labels)
    zeros |= {f"family: {name}": complex(v) for name, v in zip(told, slow, strict=True)}
    assert len(zeros) + values.size == n
    product = float(np.linalg.det(left))
    return Spectrum(values, modes, errors, zeros, family, product)


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


def _null(matrix: np.ndarray, dimensions: int | None) -> np.ndarray:
    """Orthonormal directions that a matrix leaves at zero, by rank or by number."""
    if not matrix.size:
        return np.zeros((matrix.shape[0], 0))
    _, values, across = np.linalg.svd(matrix)
    if dimensions is not None:
        return across[values.size - dimensions :].T
    return across[values <= SMALL * max(float(values[0]), 1e-300)].T


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
    for j in range(columns.shape[1]):
        tried = np.linalg.svd(columns[:, [*chosen, j]], compute_uv=False)
        if tried[-1] > 1e-6:
            chosen.append(j)
    return chosen[: columns.shape[0]]


def _labelled(
    family: np.ndarray, labels: Sequence[tuple[str, np.ndarray]]
) -> list[str]:
    """A quantity for each dimension, which tells the members of the family apart."""
    d = family.shape[1]
    names: list[str] = []
    seen = np.zeros((0, d))
    for name, slope in labels:
        row = slope @ family
        length = float(np.linalg.norm(row))
        if len(names) == d or length <= 1e-6 * float(np.linalg.norm(slope)):
            continue
        tried = np.concatenate([seen, row[None] / length])
        if np.linalg.svd(tried, compute_uv=False)[-1] > 1e-6:
            names.append(name)
            seen = tried
    return names + [f"direction {k + 1}" for k in range(len(names), d)]
