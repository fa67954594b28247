"""Lookups and writes by known indices, in C and in a walk: what XLA gives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from rollkane.codegen.evaluation import evaluated

from ..forced_particles import assert_native_is_diffrax, both

X = jnp.array([[0.3, -0.5, 0.9], [1.7, 0.2, -1.1], [0.6, 2.3, -0.4]])
ROWS, COLUMNS, TWICE = np.array([0, 2]), np.array([1, 2]), np.array([0, 2, 2])


def written(x, mode):
    """Two windows of an array's size and form, of which one begins too late."""
    axes = jax.lax.ScatterDimensionNumbers((1, 2), (), (0, 1))
    at = np.array([[0, 1], [2, 1]])
    return jax.lax.scatter(
        x, at, x[None, 1:, 1:] * jnp.array([[[2.0]], [[3.0]]]), axes, mode=mode
    )


FUNCTIONS = {
    "an entry": lambda x: x.at[1, 2].set(x[0, 0]),
    "a row": lambda x: x.at[-1].set(2.0 * x[0]),
    "a column": lambda x: x.at[:, 1].set(x[0]),
    "a block": lambda x: x.at[:2, 1:].set(x[1:, :2]),
    "every other": lambda x: x[0].at[::2].set(x[1, 1]),
    "backwards": lambda x: x[0].at[::-1].set(x[1]),
    "places": lambda x: x.at[ROWS, COLUMNS].set(x[0, 1:]),
    "a diagonal": lambda x: jnp.fill_diagonal(x, x[0, 0], inplace=False),
    "outside": lambda x: x.at[7].set(9.0),
    "added to": lambda x: x.at[1].add(x[0, 0]),
    "added twice": lambda x: x[0].at[TWICE].add(x[1]),
    "added outside": lambda x: x.at[np.array([1, 5])].add(x[:2]),
    "multiplied": lambda x: x.at[ROWS].multiply(x[0]),
    "largest": lambda x: x.at[1].max(x[0]),
    "least": lambda x: x.at[:, 0].min(x[:, 1]),
    "sums of parts": lambda x: jax.ops.segment_sum(x[0], jnp.array([0, 0, 1]), 2),
    "rows": lambda x: x[ROWS],
    "pairs": lambda x: x[ROWS, COLUMNS],
    "columns of rows": lambda x: x[1:, ROWS],
    "taken": lambda x: jnp.take(x, COLUMNS, axis=1),
    "taken outside": lambda x: jnp.take(x, np.array([1, 9]), axis=0),
    "clipped": lambda x: x.at[np.array([1, 9])].get(mode="clip"),
    "filled": lambda x: x.at[np.array([1, 9])].get(mode="fill", fill_value=4.0),
    "a triangle": lambda x: x[np.tril_indices(3)],
    "whole numbers": lambda x: jnp.arange(4).at[2].set(7).at[ROWS].add(1),
    "of each row": lambda x: jax.vmap(lambda row, i: row[i])(x, TWICE),
    "to each row": lambda x: jax.vmap(lambda row, i: row.at[i].add(row[0]))(x, TWICE),
    "along an axis": lambda x: jnp.take_along_axis(x, TWICE[None], axis=0),
    "a window half outside": lambda x: written(x, "fill"),
    "a window moved inside": lambda x: written(x, "clip"),
    "windows": lambda x: jax.vmap(
        lambda i: jax.lax.dynamic_slice(x, (i, i), (2, 3)), out_axes=1
    )(TWICE),
    "of no axes": lambda x: x[0, 0].at[()].add(x[1, 1]),
    "one": lambda x: jnp.ones(3).at[1].max(x[0, 0])[1],
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_it_is_what_xla_gives(name):
    """Nothing is computed but one sum or product a number: the same to the last bit."""
    function = FUNCTIONS[name]
    wanted = jax.jit(function)(X)
    for found in both(function, X):
        assert (found.shape, found.dtype) == (wanted.shape, wanted.dtype)
        np.testing.assert_array_equal(found, wanted)


def test_an_index_that_is_computed_of_known_numbers_is_known():
    by_value = lambda x: x.at[jnp.asarray(x[0, 0] > 0.0, int)].set(x[1])
    assert "scatter" in str(jax.make_jaxpr(by_value)(X))
    np.testing.assert_array_equal(evaluated(by_value, X), by_value(X))


def force(q, stiffness):
    """On three coordinates, by all that is written with ``.at`` and by indices."""
    matrix = jnp.zeros((3, 3)).at[:2, :2].set(stiffness).at[2, 2].add(3.0)
    matrix = matrix.at[np.arange(3), np.arange(3)].add(jnp.array([2.0, 1.0, 0.5]))
    bent = q.at[1].multiply(1.0 + q[0] ** 2).at[np.array([0, 2])].add(q[ROWS] ** 3)
    return -(matrix @ bent)[np.array([2, 0, 1])][np.array([1, 2, 0])]


def test_functions_of_the_user_s_that_use_them_run_in_c():
    """Values and derivatives are those by diffrax."""
    stiffness = jnp.array([[4.0, 0.3], [0.3, 5.0]])
    assert_native_is_diffrax(force, stiffness, 1.0)
