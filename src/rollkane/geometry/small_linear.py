"""Unrolled linear algebra for vectors of three and matrices up to about eight.

The first axis holds the components, so that every function serves ``(3,)`` and
``(3, B)`` alike. Library calls (LAPACK, einsum) stop XLA from fusing: a step of a
rattleback cost nine times more with them, so nothing on the hot path uses them.
"""

from collections.abc import Callable, Sequence
from typing import TypeAlias

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from ..codegen.tracing import traced_once

# one operation instead of 2 n
_unstack: Callable[[Array], list[Array]] | None = getattr(lax, "unstack", None)
# systems beyond it are solved in loops: n^3 / 3 operations take too long to compile
_UNROLLED = 12


def components(a: Float[Array, "n *B"]) -> list[Float[Array, "*B"]]:
    """Split an array along its first axis; traces faster than ``a[i]``."""
    if _unstack is not None:
        return list(_unstack(a))
    return [lax.index_in_dim(a, i, 0, keepdims=False) for i in range(a.shape[0])]


@traced_once
def dot(a: Float[Array, "n *B"], b: Float[Array, "n *B"]) -> Float[Array, "*B"]:
    """Scalar product over the first axis."""
    total, *rest = components(a * b)
    for term in rest:
        total = total + term
    return total


def norm(a: Float[Array, "n *B"]) -> Float[Array, "*B"]:
    """Euclidean length over the first axis; not differentiable at zero."""
    return jnp.sqrt(dot(a, a))


@traced_once
def safe_norm(a: Float[Array, "n *B"]) -> Float[Array, "*B"]:
    """The same of a vector that may be zero, where its derivative is taken as zero."""
    squared = dot(a, a)
    where = squared > 0.0
    return jnp.where(where, jnp.sqrt(jnp.where(where, squared, 1.0)), 0.0)


@jax.custom_jvp
def inverse_sqrt(x: Float[Array, "*B"]) -> Float[Array, "*B"]:
    """``1 / sqrt(x)``, whose derivative divides by nothing.

    JAX's own rules spend three divisions (5 ns each) on the derivative of a
    normalised vector; this one reuses the value.
    """
    return 1.0 / jnp.sqrt(x)


@inverse_sqrt.defjvp
def _inverse_sqrt_jvp(
    primals: tuple[Array], tangents: tuple[Array]
) -> tuple[Array, Array]:
    value = inverse_sqrt(primals[0])
    return value, -0.5 * value * value * value * tangents[0]


def sign(x: Float[Array, "*B"]) -> Float[Array, "*B"]:
    """-1 below zero, else 1."""
    one = jnp.ones_like(x)  # two plain numbers would be of the default precision
    return jnp.where(x < 0.0, -one, one)


@traced_once
def cross(a: Float[Array, "3 *B"], b: Float[Array, "3 *B"]) -> Float[Array, "3 *B"]:
    """Vector product in right-handed axes."""
    a0, a1, a2 = components(a)
    b0, b1, b2 = components(b)
    return jnp.stack([a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0])


@traced_once
def matvec(
    matrix: Float[Array, "m n *B"], v: Float[Array, "n *B"]
) -> Float[Array, "m *B"]:
    """Matrix times vector."""
    return jnp.stack([dot(row, v) for row in components(matrix)])


@traced_once
def matvec_transposed(
    matrix: Float[Array, "m n *B"], v: Float[Array, "m *B"]
) -> Float[Array, "n *B"]:
    """Transposed matrix times vector, as a sum of rows."""
    rows = components(matrix)
    total = rows[0] * v[0]
    for row, x in zip(rows[1:], components(v)[1:], strict=True):
        total = total + row * x
    return total


@traced_once
def matmul(
    a: Float[Array, "l m *B"], b: Float[Array, "m n *B"]
) -> Float[Array, "l n *B"]:
    """Product of two small matrices."""
    return jnp.stack([matvec_transposed(b, row) for row in components(a)])


@traced_once
def solve_2x2(
    matrix: Float[Array, "2 2 *B"], rhs: Float[Array, "2 *B"]
) -> Float[Array, "2 *B"]:
    """Solve a general 2x2 system by Cramer's rule."""
    (a, b), (c, d) = (components(row) for row in components(matrix))
    x, y = components(rhs)
    scale = 1.0 / (a * d - b * c)
    return jnp.stack([(d * x - b * y) * scale, (a * y - c * x) * scale])


@traced_once
def solve_4x4(
    matrix: Float[Array, "4 4 *B"], rhs: Float[Array, "4 *B"]
) -> Float[Array, "4 *B"]:
    """Solve a general 4x4 system by minors: divided is by the determinant alone."""
    columns = [components(c) for c in components(jnp.swapaxes(matrix, 0, 1))]
    right = components(rhs)
    scale = 1.0 / _determinant(columns)
    others = ([*columns[:m], right, *columns[m + 1 :]] for m in range(4))
    return jnp.stack([_determinant(x) * scale for x in others])


@traced_once
def determinant_4x4(matrix: Float[Array, "4 4 *B"]) -> Float[Array, "*B"]:
    """Determinant, by minors."""
    return _determinant([components(row) for row in components(matrix)])


def _determinant(columns: list[list[Array]]) -> Array:
    """Of four columns, by Laplace's expansion along the first two."""
    places = [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]
    signs = [1.0, -1.0, 1.0, 1.0, -1.0, 1.0]

    def minors(a: list[Array], b: list[Array]) -> list[Array]:
        """Of two columns, by pairs of rows in order."""
        return [a[i] * b[j] - a[j] * b[i] for i, j in places]

    first, second = minors(*columns[:2]), reversed(minors(*columns[2:]))
    terms = [s * x * y for s, x, y in zip(signs, first, second, strict=True)]
    return sum(terms[1:], terms[0])


# Of a right-hand side; None is zero, for which nothing is done.
Entry: TypeAlias = Float[Array, "*B"] | None
# Solves a system for one right-hand side.
Solver: TypeAlias = Callable[[Sequence[Entry]], list[Float[Array, "*B"]]]


def solve_spd(
    matrix: list[list[Float[Array, "*B"]]], rhs: list[Float[Array, "*B"]]
) -> list[Float[Array, "*B"]]:
    """Solve a symmetric positive definite system by LDL^T, unrolled where it is small.

    Args:
        matrix: Entries by row; only the lower triangle is read, so row ``i`` needs
            ``i + 1`` entries.
        rhs: Right-hand side, by entries.

    Returns:
        The solution, by entries.
    """
    return factored_spd(matrix)(rhs)


def factored_spd(matrix: Sequence[Sequence[Entry]]) -> Solver:
    """The same for several right-hand sides, of one factorization.

    Args:
        matrix: Entries by row; only the lower triangle is read. None off the diagonal
            is zero, and costs nothing until others are subtracted from it.

    Returns:
        ``solve(rhs)``, of entries some of which may be None, which are zero.
    """
    n = len(matrix)
    if n > _UNROLLED:
        return lambda rhs: _solve_by_columns(matrix, rhs)
    # entries beyond the lower triangle are never read
    lower: list[list[Entry]] = [[None] * n for _ in range(n)]
    pivot: list[Array] = []
    inverse: list[Array] = []
    for j in range(n):
        # U = L D, kept so that every product is formed once
        scaled = [_times(lower[j][k], pivot[k]) for k in range(j)]
        found = _less(matrix[j][j], lower[j], scaled)
        assert found is not None
        pivot.append(found)
        inverse.append(1.0 / found)
        for i in range(j + 1, n):
            reduced = _less(matrix[i][j], lower[i], scaled)
            lower[i][j] = _times(reduced, inverse[j])

    def solve(rhs: Sequence[Entry]) -> list[Array]:
        below: list[Entry] = []
        for i, value in enumerate(rhs):
            below.append(_less(value, lower[i], below))
        zero = jnp.zeros_like(pivot[0])
        x: list[Array] = []  # from the last on
        for i in reversed(range(n)):
            value = _times(below[i], inverse[i])
            column = [lower[k][i] for k in range(n - 1, i, -1)]
            found = _less(value, column, x)
            x.append(zero if found is None else found)
        return x[::-1]

    return solve


def _times(a: Entry, b: Entry) -> Entry:
    return None if a is None or b is None else a * b


def _less(value: Entry, a: Sequence[Entry], b: Sequence[Entry]) -> Entry:
    """``value - sum a b``, over as many as there are of both; None is zero."""
    products = [_times(x, y) for x, y in zip(a, b, strict=False)]
    terms = [x for x in products if x is not None]
    if not terms:
        return value
    total = sum(terms[1:], terms[0])
    return -total if value is None else value - total


def _solve_by_columns(
    matrix: Sequence[Sequence[Entry]], rhs: Sequence[Entry]
) -> list[Array]:
    """The same in loops over columns; for numbers without lanes."""
    n = len(rhs)
    assert matrix[0][0] is not None
    zero = jnp.zeros_like(matrix[0][0])
    stacked: Callable[[Sequence[Entry]], Array] = lambda row: jnp.stack(
        [zero if x is None else x for x in row]
    )
    lower = jnp.stack([stacked([*row, *[None] * (n - len(row))]) for row in matrix])
    whole = jnp.concatenate(
        [lower + jnp.tril(lower, -1).T, stacked(rhs)[:, None]], axis=1
    )
    index = jnp.arange(n)

    def eliminate(whole: Array, j: Array) -> tuple[Array, None]:
        share = jnp.where(index > j, whole[:, j] / whole[j, j], 0.0)
        return whole - share[:, None] * whole[j][None], None

    def substitute(x: Array, j: Array) -> tuple[Array, None]:
        known = jnp.sum(jnp.where(index > j, reduced[j, :n] * x, 0.0))
        return jnp.where(index == j, (reduced[j, n] - known) / reduced[j, j], x), None

    reduced, _ = lax.scan(eliminate, whole, index)
    x, _ = lax.scan(substitute, jnp.zeros_like(reduced[:, n]), index, reverse=True)
    return components(x)
