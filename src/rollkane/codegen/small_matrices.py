"""Decompositions and orders of a few numbers, as arithmetic that can be written in C.

XLA calls LAPACK for them. Of a small matrix the same is some dozens of operations,
whose derivatives of any order are those of what stands here.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend import core
from jaxtyping import Array, Bool, Float, Int

from .jaxpr_types import ClosedJaxpr, Equation, Params

# Rows of a matrix, and numbers that are sorted. The wait for a first result grows with
# them: 0.4, 1.0 and 2.3 s of a system of 4, 8 and 12 rows, 0.1, 0.2 and 0.7 s of 6, 12
# and 24 numbers (one run each, on a 2.5 GHz core).
_MOST_ROWS, _MOST_SORTED = 8, 12


def arithmetic_of(equation: Equation) -> Callable[..., Any] | None:
    """The function that an equation is, by its parameters; None: none that is here."""
    name = equation.primitive.name
    function = _FUNCTIONS.get(name)
    if name in _ALONE or (function is None and name != "custom_linear_solve"):
        return function
    shapes = [v.aval.shape for v in equation.invars]
    if function is None:
        return _linear_solve(equation.params, shapes)
    if name == "sort":
        dimension: int = equation.params["dimension"]
        return function if shapes[0][dimension] <= _MOST_SORTED else None
    if any(n > _MOST_ROWS for n in shapes[0][-2:]):
        return None
    return _of_each(function, shapes)


def _of_each(
    function: Callable[..., Any], shapes: list[tuple[int, ...]]
) -> Callable[..., Any]:
    """Of a batch of matrices, one by one."""

    def call(*arguments: Array, **params: Any) -> Any:
        one: Callable[..., Any] = functools.partial(function, **params)
        for _ in shapes[0][:-2]:
            one = jax.vmap(one)
        return one(*arguments)

    return call


def _lu(a: Float[Array, "n m"], **_: Any) -> tuple[Array, Array, Array]:
    """Both factors in one matrix, pivots, and where each row came from."""
    count = a.shape[0]
    rows, came = jnp.arange(count), jnp.arange(count, dtype=np.int32)
    pivots: list[Array] = []
    for k in range(min(a.shape)):
        best = jnp.argmax(jnp.abs(a[k:, k])).astype(np.int32) + np.int32(k)
        pivots.append(best)
        here = rows == best.astype(rows.dtype)
        a = _swapped(a, k, here[:, None])
        came = _swapped(came, k, here)
        if k + 1 < count:
            factors = a[k + 1 :, k] / a[k, k]
            rest = a[k + 1 :, k + 1 :] - factors[:, None] * a[k, k + 1 :][None]
            below = jnp.concatenate([a[k + 1 :, :k], factors[:, None], rest], axis=1)
            a = jnp.concatenate([a[: k + 1], below])
    return a, jnp.stack(pivots), came


def _swapped(x: Array, k: int, here: Bool[Array, "..."]) -> Array:
    """Rows, of which one that is chosen and the k-th change places."""
    chosen = jnp.sum(jnp.where(here, x, jnp.zeros_like(x)), axis=0, dtype=x.dtype)
    moved = jnp.where(here, x[k][None], x)
    return jnp.concatenate([moved[:k], chosen[None], moved[k + 1 :]])


def _substituted(
    a: Float[Array, "n n"], b: Float[Array, "n m"], lower: bool, unit: bool
) -> Float[Array, "n m"]:
    """Solution of a triangular system."""
    count = a.shape[0]
    order = range(count) if lower else reversed(range(count))
    found: dict[int, Array] = {}
    for i in order:
        row = b[i]
        for j, x in found.items():
            row = row - a[i, j] * x
        found[i] = row if unit else row / a[i, i]
    return jnp.stack([found[i] for i in range(count)])


def _triangular_solve(
    a: Float[Array, "n n"],
    b: Float[Array, "n m"],
    *,
    left_side: bool,
    lower: bool,
    transpose_a: bool,
    unit_diagonal: bool,
    **_: Any,
) -> Array:
    a, lower = (a.T, not lower) if transpose_a else (a, lower)
    if left_side:
        return _substituted(a, b, lower, unit_diagonal)
    return _substituted(a.T, b.T, not lower, unit_diagonal).T


def _cholesky(a: Float[Array, "n n"], **_: Any) -> Float[Array, "n n"]:
    """Lower factor; NaN of what is not positive definite."""
    count = a.shape[0]
    zero = jnp.zeros_like(a[0, 0])
    rows: list[list[Array]] = []
    for i in range(count):
        row: list[Array] = []
        for j in range(i):
            rest = a[i, j] - sum((row[k] * rows[j][k] for k in range(j)), zero)
            row.append(rest / rows[j][j])
        rest = a[i, i] - sum((x * x for x in row), zero)
        row.append(jnp.where(rest > 0.0, jnp.sqrt(rest), jnp.nan))
        rows.append(row)
    full = [jnp.stack(row + [zero] * (count - 1 - i)) for i, row in enumerate(rows)]
    found = jnp.stack(full)
    return jnp.where(jnp.isnan(found[-1, -1]), jnp.nan, found)


def _linear_solve(
    params: Params, shapes: list[tuple[int, ...]]
) -> Callable[..., Any] | None:
    """Solution of a system of one square matrix, by which its derivatives are exact.

    JAX's own has a decomposition besides, of which it takes no derivatives.
    """
    counts, matvec = params["const_lengths"], params["jaxprs"].matvec
    if not _has_factors(params["jaxprs"].solve.jaxpr):
        return None  # by iteration: what that gives is no solution
    square = len(shapes[0]) == 2 and len(set(shapes[0])) == 1
    if counts.matvec != 1 or not square or len(shapes) != sum(counts) + 1:
        return None
    if max(shapes[0][0] ** 2, np.prod(shapes[-1])) > _MOST_ROWS**2:
        return None
    form = _form_of(matvec)
    if form is None:
        return None

    def solved(*arguments: Array, **named: Any) -> list[Array]:
        del named
        a = arguments[0].T if form.transposed else arguments[0]
        b = jnp.moveaxis(arguments[-1], form.axis, 0)
        factors, _, came = _lu(a)
        columns = b.reshape(b.shape[0], -1)
        chosen = came[:, None] == jnp.arange(a.shape[0], dtype=came.dtype)[None]
        none = jnp.zeros_like(columns)[None]
        columns = jnp.sum(jnp.where(chosen[:, :, None], columns[None], none), axis=1)
        columns = _substituted(factors, columns, True, True)
        columns = _substituted(factors, columns, False, False)
        return [jnp.moveaxis(columns.reshape(b.shape), 0, form.axis)]

    return solved


def _has_factors(jaxpr: Any) -> bool:
    """Whether a program, or one that it calls, solves triangular systems."""
    for equation in jaxpr.eqns:
        inner = equation.params.get("jaxpr")
        if equation.primitive.name == "triangular_solve":
            return True
        if inner is not None and _has_factors(getattr(inner, "jaxpr", inner)):
            return True
    return False


class _Form(NamedTuple):
    """How a matrix acts: itself or transposed, and along which axis."""

    transposed: bool
    axis: int


def _form_of(matvec: ClosedJaxpr) -> _Form | None:
    """How a linear map of a matrix and an array acts; None: in another way."""
    random = np.random.default_rng(0)
    a, b = (random.normal(size=v.shape) for v in matvec.in_avals)
    with jax.ensure_compile_time_eval():
        kinds = [v.dtype for v in matvec.in_avals]
        given = [jnp.asarray(x, kind) for x, kind in zip((a, b), kinds, strict=True)]
        run = cast(Callable[..., list[Array]], core.jaxpr_as_fun(cast(Any, matvec)))
        found = np.asarray(run(*given)[0])
    for axis in range(b.ndim):
        for transposed in (False, True):
            if b.shape[axis] != a.shape[0]:
                continue
            made = np.tensordot(a.T if transposed else a, b, axes=(1, axis))
            # in single precision, too; what is another map differs by all digits
            if np.allclose(np.moveaxis(made, 0, axis), found, rtol=1e-3, atol=1e-3):
                return _Form(transposed, axis)
    return None


def _permutation(pivots: Int[Array, " n"], permutation_size: int) -> Int[Array, " m"]:
    """Where each row came from, by the rows that it changed places with."""
    came = jnp.arange(permutation_size, dtype=pivots.dtype)
    for k in range(pivots.shape[0]):
        here = jnp.arange(permutation_size, dtype=pivots.dtype) == pivots[k]
        came = _swapped(came, k, here)
    return came


def _platform(platforms: Any) -> Array:
    """Which of a program's forms it is: that for processors, else that for all."""
    known = [k for k, own in enumerate(platforms) if own is None or "cpu" in own]
    return jnp.asarray(known[0], np.int32)


def _sort(
    *operands: Array, dimension: int, is_stable: bool, num_keys: int
) -> list[Array]:
    """By insertion: each goes before what is larger, so that equal ones stay.

    Long ones are sorted in memory, which programs of single numbers do not have.
    """
    del is_stable
    moved = [jnp.moveaxis(x, dimension, 0) for x in operands]
    count = moved[0].shape[0]
    rows = [[x[i] for x in moved] for i in range(count)]
    for last in range(1, count):
        for i in reversed(range(last)):
            a, b = rows[i], rows[i + 1]
            swaps = _before(b[:num_keys], a[:num_keys])
            rows[i] = [jnp.where(swaps, y, x) for x, y in zip(a, b, strict=True)]
            rows[i + 1] = [jnp.where(swaps, x, y) for x, y in zip(a, b, strict=True)]
    every = range(len(operands))
    return [jnp.stack([row[k] for row in rows], axis=dimension) for k in every]


def _before(a: list[Array], b: list[Array]) -> Bool[Array, ""]:
    """Whether keys come before others; what is not a number comes last."""
    found: Any = jnp.zeros(a[0].shape, bool)
    for x, y in reversed([*zip(a, b, strict=True)]):
        less, same = x < y, x == y
        if jnp.issubdtype(x.dtype, jnp.floating):
            less |= (x == x) & (y != y)
            same |= (x != x) & (y != y)
        found = less | (same & found)
    return found


_FUNCTIONS: dict[str, Callable[..., Any]] = {
    "lu": _lu,
    "triangular_solve": _triangular_solve,
    "cholesky": _cholesky,
    "sort": _sort,
    "lu_pivots_to_permutation": _permutation,
    "platform_index": _platform,
}
_ALONE = "lu_pivots_to_permutation", "platform_index"
