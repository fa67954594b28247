"""Floquet multipliers of a relative periodic motion, modulo what is neutral.

Along the flow and along symmetries changes come back as they were, and so do those of
an energy: multipliers of modulus one, often in Jordan blocks, whose roots rounding
scatters by its square root. They are split off by the spaces that they belong to.
"""

from typing import NamedTuple, cast

import numpy as np

from .neutral import FLOW

FAMILY = "family"
# How much more than the errors that what is neutral shows, or than twice the tolerance,
# may be in what is not: 5 times the largest seen in 60 swings of a ball in a bowl.
_MORE, _TOLERANCES = 30.0, 2.0


class Floquet(NamedTuple):
    """Multipliers of a monodromy matrix.

    Attributes:
        multipliers: Those that tell stability, in falling modulus, shape (p,).
        uncertain: How far rounding may have moved each, shape (p,).
        expected: Names of the others, in order: the flow, symmetries, integrals, and
            ``"family"`` for each further direction in which there are periodic motions
            beside this one, by rank.
        expected_multipliers: Of the flow and the symmetries together, then ones.
        error: Of the monodromy, over its size: by how much directions and integrals
            are not neutral, with a margin.
    """

    multipliers: np.ndarray
    uncertain: np.ndarray
    expected: tuple[str, ...]
    expected_multipliers: np.ndarray
    error: float


def floquet(
    monodromy: np.ndarray,
    names: tuple[str, ...],
    directions: np.ndarray,
    integrals: tuple[str, ...],
    slopes: np.ndarray,
    rtol: float = 5e-14,
    families: int | None = None,
) -> Floquet:
    """Split a monodromy matrix.

    Args:
        monodromy: Shape (n, n), in coordinates of like size.
        names: Of directions, whose span it carries into itself.
        directions: Shape (r, n), independent.
        integrals: Names of integrals.
        slopes: Rows that it leaves as they are, shape (s, n).
        rtol: Relative tolerance of the runs that it comes from [1]; left out: rounding.
        families: How many directions of a family there are at most, where that is
            known: what comes near to one beside them passes it. None: by rank alone.
    """
    n = monodromy.shape[0]
    found = list(names)
    inside, outside = _parted(directions.T, n)
    on_span = np.linalg.eigvals(inside.T @ monodromy @ inside)
    size = float(np.linalg.norm(monodromy, 2))
    strays = [outside.T @ monodromy @ inside, np.zeros((1, 1))]
    strays += [_unit(row @ monodromy - row, row)[None] for row in slopes]
    if FLOW in names:
        flow = directions[names.index(FLOW)]
        strays.append(_unit(monodromy @ flow - flow, flow)[None])
    seen = max(float(np.abs(part).max(initial=0.0)) for part in strays)
    error = _MORE * max(seen / size, _TOLERANCES * rtol)
    rest = outside.T @ monodromy @ outside
    rows = slopes @ outside
    least = np.linalg.norm(slopes, axis=1) * np.sqrt(error)
    steep = [k for k in range(len(integrals)) if np.linalg.norm(rows[k]) > least[k]]
    along = _parted(rows[steep].T, rest.shape[0])[1]
    rest = along.T @ rest @ along
    found += [integrals[k] for k in steep]
    while rest.shape[0]:
        _, values, right = cast(
            tuple[np.ndarray, np.ndarray, np.ndarray],
            np.linalg.svd(rest - np.eye(rest.shape[0])),
        )
        small = values <= error * size
        if families is not None:  # the smallest are the last ones
            left = families - found.count(FAMILY)
            small[: max(small.size - left, 0)] = False
        if not small.any():
            break
        found += [FAMILY] * int(small.sum())
        kept = right[~small]
        rest = kept @ rest @ kept.T
    multipliers, uncertain = _eigenvalues(rest, error * size)
    ones = np.ones(len(found) - on_span.size)
    expected = np.concatenate([on_span.astype(complex), ones])
    return Floquet(multipliers, uncertain, tuple(found), expected, error)


def _unit(vector: np.ndarray, like: np.ndarray) -> np.ndarray:
    return vector / np.linalg.norm(like)


def _parted(columns: np.ndarray, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Orthonormal bases of a span and of what is orthogonal to it."""
    count = columns.shape[1]
    if not count:
        return np.zeros((n, 0)), np.eye(n)
    columns = columns / np.linalg.norm(columns, axis=0)
    whole = np.linalg.qr(columns, mode="complete")[0]
    return whole[:, :count], whole[:, count:]


def _eigenvalues(matrix: np.ndarray, error: float) -> tuple[np.ndarray, np.ndarray]:
    """Eigenvalues in falling modulus, and how far an error of the matrix moves them."""
    if not matrix.shape[0]:
        return np.zeros(0, complex), np.zeros(0)
    values, right = np.linalg.eig(matrix)
    # rows of the inverse are left eigenvectors; |x| |y| / |y x| is an eigenvalue's
    # condition, which near a defective one says less than the root of the error
    try:
        left = np.linalg.inv(right)
        condition = np.linalg.norm(left, axis=1) * np.linalg.norm(right, axis=0)
    except np.linalg.LinAlgError:
        condition = np.full(values.size, np.inf)
    size = float(np.linalg.norm(matrix, 2))
    moved = np.minimum(condition * error, np.sqrt(size * error))
    order = np.argsort(-np.abs(values), kind="stable")
    return values[order].astype(complex), moved[order]
