"""Linear systems, decompositions and orders of a few numbers, in C and in a walk."""

import jax
import jax.numpy as jnp
import jax.scipy.linalg as jsl
import numpy as np
import pytest

from ..forced_particles import assert_native_is_diffrax, both

RANDOM = np.random.default_rng(5)


def matrix(size):
    """Of condition below 100: answers are known to 100 roundings of each row."""
    left, _, right = np.linalg.svd(RANDOM.normal(size=(size, size)))
    return jnp.asarray(left @ np.diag(np.geomspace(0.1, 3.0, size)) @ right)


X = {size: matrix(size) for size in (1, 2, 3, 5, 8)}
POSITIVE = {size: x @ x.T for size, x in X.items()}
SWAPS = jnp.array([[0.0, 1.0, 2.0], [3.0, 1.0, 1.0], [1.0, 2.0, 5.0]])  # zero at first
MIXED = jnp.array([[0.3, -0.5, 0.9], [1.7, 0.2, -1.1], [0.6, 2.3, -0.4]])
HALF = jnp.array([0.3, -0.5, 0.9, 0.3, -2.0])
FUNCTIONS = {
    **{
        f"solve {size}": (lambda x: jnp.linalg.solve(x, x[0] + 1.0), x)
        for size, x in X.items()
    },
    "solve with swapped rows": (lambda x: jnp.linalg.solve(x, x[1]), SWAPS),
    "solve for columns": (lambda x: jnp.linalg.solve(x, x[:, :2] ** 2), X[5]),
    "solve transposed": (lambda x: jnp.linalg.solve(x.T, x[0]), SWAPS),
    "inverse": (jnp.linalg.inv, SWAPS),
    "inverse of 5": (jnp.linalg.inv, X[5]),
    "determinant": (jnp.linalg.det, X[5]),
    "its logarithm": (lambda x: jnp.linalg.slogdet(x)[1], X[3]),
    "derivative of a solution": (
        jax.jacfwd(lambda x: jnp.linalg.solve(x, x[0] ** 2)), SWAPS,
    ),
    "factors": (lambda x: jsl.lu_factor(x)[0], SWAPS),
    "factors' rows": (lambda x: jsl.lu_factor(x)[1], SWAPS),
    "by factors": (lambda x: jsl.lu_solve(jsl.lu_factor(x), x[0]), SWAPS),
    "Cholesky": (jnp.linalg.cholesky, POSITIVE[5]),
    "by Cholesky": (lambda x: jsl.cho_solve(jsl.cho_factor(x), x[0] ** 2), POSITIVE[3]),
    "of a positive one": (
        lambda x: jsl.solve(x, x[0] ** 2, assume_a="pos"), POSITIVE[3],
    ),
    "triangular": (lambda x: jsl.solve_triangular(x, x[0], lower=True), X[3]),
    "triangular, upper": (lambda x: jsl.solve_triangular(x, x[0]), X[3]),
    "triangular, transposed": (lambda x: jsl.solve_triangular(x, x[0], trans=1), X[3]),
    "triangular of a batch": (
        lambda x: jax.vmap(lambda y: jnp.linalg.cholesky(x + y * jnp.eye(3)))(x[0]),
        POSITIVE[3],
    ),
}  # fmt: skip
ORDERS = {
    "sorted": (jnp.sort, HALF),
    "sorted columns": (lambda x: jnp.sort(x, axis=0), MIXED),
    "sorted rows": (jnp.sort, MIXED),
    "descending": (lambda x: jnp.sort(x, descending=True), HALF),
    "sorted with what is no number": (
        lambda x: jnp.sort(jnp.where(x < 0.0, jnp.nan, x)), HALF,
    ),
    "order": (jnp.argsort, HALF),
    "by two keys": (lambda x: jnp.lexsort((jnp.arange(5.0), jnp.round(x))), HALF),
    "median": (jnp.median, HALF),
    "a computed row": (lambda x: x[jnp.argmax(x[:, 0])], MIXED),
    "a computed column": (lambda x: x[:, jnp.argmax(x[0])], MIXED),
    "two computed rows": (lambda x: x[jnp.argsort(x[:, 0])[:2]], MIXED),
    "a computed row that is written": (
        lambda x: x.at[jnp.argmax(x[:, 0])].set(x[0] + 1.0), MIXED,
    ),
    "a computed place that is added to": (
        lambda x: x.at[jnp.argmin(x)].add(x[0]), HALF,
    ),
    "a computed place, written outside": (
        lambda x: x.at[jnp.int32(30.0 * x[0])].set(9.0), HALF,
    ),
    "a computed place, written clipped": (
        lambda x: x.at[jnp.int32(30.0 * x[0])].set(9.0, mode="clip"), HALF,
    ),
    "a place of many, written clipped": (
        lambda x: jnp.resize(x, 50).at[jnp.int32(300.0 * x[0])].set(9.0, mode="clip"),
        HALF,
    ),
    "a place of many, added outside": (
        lambda x: jnp.resize(x, 50).at[jnp.int32(300.0 * x[0])].add(9.0), HALF,
    ),
    "a computed place outside": (
        lambda x: x.at[jnp.int32(10.0 * x[0])].get(mode="fill", fill_value=7.0), HALF,
    ),
    "a computed place, clipped": (
        lambda x: x.at[jnp.int32(10.0 * x[0])].get(mode="clip"), HALF,
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", FUNCTIONS)
def test_a_solution_is_that_of_lapack(name):
    """To 100 roundings of a condition of 100: 8 rows in another order of sums."""
    function, x = FUNCTIONS[name]
    wanted = jax.jit(function)(x)
    for found in both(function, x):
        assert (found.shape, found.dtype) == (wanted.shape, wanted.dtype)
        scale = float(np.max(np.abs(wanted)))
        np.testing.assert_allclose(found, wanted, rtol=0, atol=1e4 * 2.3e-16 * scale)


@pytest.mark.parametrize("name", ORDERS)
def test_an_order_is_that_of_xla(name):
    """Nothing is computed: the same to the last bit."""
    function, x = ORDERS[name]
    wanted = jax.jit(function)(x)
    for found in both(function, x):
        assert (found.shape, found.dtype) == (wanted.shape, wanted.dtype)
        np.testing.assert_array_equal(found, wanted)


def test_what_is_not_positive_has_no_factor():
    flat = jnp.outer(jnp.arange(1.0, 4.0), jnp.arange(1.0, 4.0))  # a zero pivot
    for x in (X[3], flat):
        for found in both(jnp.linalg.cholesky, x):
            assert np.all(np.isnan(found[np.tril_indices(3)]))


def force(q, stiffness):
    """On three coordinates, by a linear system, an inverse and an order."""
    system = stiffness + jnp.outer(q, q)
    pulled = jnp.linalg.solve(system, q) + 0.1 * jnp.linalg.inv(system)[:, 1]
    return -5.0 * pulled - 0.1 * jnp.sort(q) * jnp.median(q)


def test_functions_of_the_user_s_that_solve_run_in_c():
    """Values and derivatives are those by diffrax."""
    assert_native_is_diffrax(force, SWAPS, 0.3)
