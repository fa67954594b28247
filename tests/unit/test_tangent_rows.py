"""Changes along several tangents, number by number, against JAX's own."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from rollkane import tangent_rows
from rollkane.tangent_rows import pushed

MATRIX = jnp.asarray([[1.0, 2.0, 0.0], [0.5, -1.0, 3.0]])
VECTOR = jnp.asarray([0.3, -0.2, 0.9])


def arithmetic(matrix, vector):
    turned = jnp.where(vector > 0.0, jnp.sin(vector), vector**3)
    return matrix @ turned / (1.0 + jnp.sum(vector * vector)) + jnp.max(matrix)


def sought(matrix, vector):
    # more than arithmetic: a place found by searching
    return matrix[:, jnp.searchsorted(vector, 0.0)] * vector[0]


def moved(count):
    key = jax.random.key(1)
    return [jax.random.normal(key, (*x.shape, count)) for x in (MATRIX, VECTOR)]


@pytest.mark.parametrize("function", [arithmetic, sought])
@pytest.mark.parametrize("count", [1, 2, 5])
def test_equal_to_jax(function, count):
    tangents = moved(count)
    value, change = jax.jit(lambda x: pushed(function, [MATRIX, VECTOR], x))(tangents)
    exact = jax.jacfwd(function, (0, 1))(MATRIX, VECTOR)
    wanted = sum(
        jnp.tensordot(j, t, axes=t.ndim - 1)
        for j, t in zip(exact, tangents, strict=True)
    )
    # a few roundings of numbers of size one
    np.testing.assert_allclose(value, function(MATRIX, VECTOR), rtol=1e-14)
    np.testing.assert_allclose(change, wanted, rtol=1e-13, atol=1e-14)


def test_traced_numbers_that_are_closed_over():
    tangents = moved(3)

    def along(scale):
        return pushed(lambda m, v: scale * arithmetic(m, v), [MATRIX, VECTOR], tangents)

    once, twice = jax.jit(along)(1.0), jax.jit(along)(2.0)
    for a, b in zip(once, twice, strict=True):
        np.testing.assert_allclose(2.0 * a, b, rtol=1e-15)


@pytest.mark.parametrize("limit", [1, 20])  # 18 numbers are given
def test_too_much_goes_by_arrays(limit, monkeypatch):
    tangents = moved(4)
    number_by_number = pushed(arithmetic, [MATRIX, VECTOR], tangents)
    monkeypatch.setattr(tangent_rows, "_MOST_OPERATIONS", limit)
    by_arrays = pushed(arithmetic, [MATRIX, VECTOR], tangents)
    for a, b in zip(number_by_number, by_arrays, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-13, atol=1e-14)
