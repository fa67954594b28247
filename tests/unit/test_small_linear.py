"""Small linear algebra against NumPy's."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from rollkane.geometry.small_linear import solve_spd


@pytest.mark.parametrize("n", [3, 13])
def test_symmetric_systems(n):
    """Unrolled and by columns; condition 100, so 1e-14 of the solution."""
    random = np.random.default_rng(n)
    turned = np.linalg.qr(random.normal(size=(n, n)))[0]
    matrix = turned @ np.diag(np.geomspace(1.0, 100.0, n)) @ turned.T
    rhs = random.normal(size=n)

    def solved(matrix):
        rows = [[matrix[i, j] for j in range(i + 1)] for i in range(n)]
        return jnp.stack(solve_spd(rows, list(jnp.asarray(rhs))))

    exact = np.linalg.solve(matrix, rhs)
    found = jax.jit(solved)(matrix)
    np.testing.assert_allclose(found, exact, rtol=0, atol=1e-14 * 100)
    # d x = -A^-1 dA x, in both modes
    change = matrix @ matrix
    push = jax.jit(lambda m, d: jax.jvp(solved, (m,), (d,))[1])
    moved = push(jnp.asarray(matrix), jnp.asarray(change))
    np.testing.assert_allclose(moved, -matrix @ exact, rtol=0, atol=1e-10)
    pull = jax.jit(jax.grad(lambda m: solved(m) @ jnp.asarray(rhs)))
    pulled = pull(jnp.asarray(matrix))
    along = float(jnp.sum(pulled * change))
    np.testing.assert_allclose(along, rhs @ moved, rtol=1e-9)
