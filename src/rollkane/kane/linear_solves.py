"""Linear systems of a few unknowns: accelerations, and dependent speeds."""

from typing import cast

import jax
import jax.numpy as jnp
import lineax as lx  # pyright: ignore[reportMissingTypeStubs]
import numpy as np
from jaxtyping import Array, Float

from ..codegen.tracing import runs_once
from ..geometry.small_linear import components, cross, matmul, solve_spd

# of the scale of a matrix: a thousand roundings of double precision
SINGULAR = 1e-12
# of 1 - C X: of a matrix that can be inverted, roundings; else of order one
_INVERTED = 1e-3
_UNROLLED = 12  # larger systems are solved by libraries
# and where it is done once: XLA takes seconds to compile twelve unknowns
_UNROLLED_ONCE = 3


def _is_small(size: int) -> bool:
    return size <= (_UNROLLED_ONCE if runs_once() else _UNROLLED)


def solved(M: Float[Array, "m m"], rhs: Float[Array, " m"]) -> Float[Array, " m"]:
    """A symmetric positive definite system, unrolled where it is small."""
    size = rhs.shape[0]
    if _is_small(size):
        rows = [components(M[i, : i + 1]) for i in range(size)]
        return jnp.stack(solve_spd(rows, components(rhs)))
    operator = lx.MatrixLinearOperator(M, lx.positive_semidefinite_tag)
    solution = lx.linear_solve(operator, rhs, lx.Cholesky(), throw=False)
    return cast(Array, solution.value)


def determinant(C: Float[Array, "k k"]) -> Float[Array, ""]:
    """By elimination, the largest of each column first; unrolled where it is small."""
    size = C.shape[0]
    if not _is_small(size):
        return cast(Array, jnp.linalg.det(C))
    rows = [components(row) for row in C]
    found = jnp.ones((), C.dtype)
    for j in range(size):
        for i in range(j + 1, size):
            larger = jnp.abs(rows[i][j]) > jnp.abs(rows[j][j])
            pairs = list(zip(rows[j], rows[i], strict=True))
            rows[j] = [jnp.where(larger, b, a) for a, b in pairs]
            rows[i] = [jnp.where(larger, -a, b) for a, b in pairs]
        pivot = rows[j][j]
        found = found * pivot
        safe = jnp.where(pivot == 0.0, 1.0, pivot)
        for i in range(j + 1, size):
            share = rows[i][j] / safe
            rows[i] = [b - share * a for a, b in zip(rows[j], rows[i], strict=True)]
    return found


def inverse_of(C: Float[Array, "k k"]) -> Float[Array, "k k"]:
    """Inverse; NaN where the constraints do not determine the dependent speeds."""
    size = C.shape[0]
    scale = jnp.prod(jnp.sqrt(jnp.sum(C * C, axis=1)))
    if size <= 3:  # by cofactors: 0.03 us, a call to LAPACK takes 1.7
        rest = np.diag([float(i >= size) for i in range(3)])
        a = jnp.pad(C, (0, 3 - size)) + jnp.asarray(rest, C.dtype)
        cofactors = jnp.stack([cross(a[1], a[2]), cross(a[2], a[0]), cross(a[0], a[1])])
        det = jnp.sum(a[0] * cofactors[0])
        inverse = cofactors.T[:size, :size] / det
    elif _is_small(size):
        return _by_squares(C)
    else:
        # needs row exchanges: 1.1 us for four, 1.4 us for six by LAPACK, one call
        LU, swaps = cast("tuple[Array, Array]", jax.scipy.linalg.lu_factor(C))
        pivots = cast(Array, jnp.diagonal(jax.lax.stop_gradient(LU)))
        det = jnp.prod(pivots)
        one = jnp.eye(size, dtype=C.dtype)
        inverse = cast(Array, jax.scipy.linalg.lu_solve((LU, swaps), one))
    return jnp.where(jnp.abs(det) > SINGULAR * scale, inverse, jnp.nan)


def _by_squares(C: Float[Array, "k k"]) -> Float[Array, "k k"]:
    """Inverse by ``C^-1 = (C^T C)^-1 C^T``, without row exchanges: arithmetic alone.

    What the square loses, C's condition squared, two steps ``X (2 - C X)`` bring back:
    each squares what is left.
    """
    size = C.shape[0]
    lengths = jnp.sqrt(jnp.sum(C * C, axis=1))
    rows_alike = C / lengths[:, None]
    square = matmul(rows_alike.T, rows_alike)
    rows = [components(square[i, : i + 1]) for i in range(size)]
    inverse = jnp.stack(solve_spd(rows, components(rows_alike.T)))
    one = jnp.eye(size, dtype=C.dtype)
    for _ in range(2):
        inverse = inverse + matmul(inverse, one - matmul(rows_alike, inverse))
    left = jnp.max(jnp.abs(one - matmul(rows_alike, inverse)))
    return jnp.where(left < _INVERTED, inverse / lengths[None], jnp.nan)


def followed(M: Float[Array, "m m"], C: Float[Array, "c m"]) -> Float[Array, "m c"]:
    """``M^-1 C^T (C M^-1 C^T)^-1``: least changes, by energy, that alter C u by one.

    Args:
        M: Mass matrix.
        C: Of constraints that do not follow from each other.
    """
    X = _solved_many(M, C.T)
    return _solved_many(matmul(C, X), X.T).T


def next_to(C: Float[Array, "c m"]) -> Float[Array, "m c"]:
    """``C^T (C C^T)^-1``: least changes, by squares, that alter C u by one.

    Args:
        C: Of constraints that do not follow from each other.
    """
    return _solved_many(matmul(C, C.T), C).T


def _solved_many(M: Float[Array, "m m"], rhs: Float[Array, "m k"]) -> Array:
    """``M^-1 rhs``, unrolled where it is small."""
    size = M.shape[0]
    if _is_small(size):
        rows = [components(M[i, : i + 1]) for i in range(size)]
        return jnp.stack(solve_spd(rows, components(rhs)))
    factor = jax.scipy.linalg.cho_factor(M)
    return jax.scipy.linalg.cho_solve(factor, rhs)
