"""Linear algebra of how two surfaces fit, against NumPy's."""

import jax.numpy as jnp
import numpy as np
import pytest

from rollkane.geometry.small_linear import determinant_4x4
from rollkane.kinematics.surface_fit import _orthogonal_to

DRAW = np.random.default_rng(3)
ROWS = {
    "any": DRAW.normal(size=(2, 4)),
    "parallel": np.outer([1.0, -2.0], DRAW.normal(size=4)),
    "one of them": np.stack([np.zeros(4), DRAW.normal(size=4)]),
    "none": np.zeros((2, 4)),
    "along axes": np.eye(4)[[3, 0]],
}


@pytest.mark.parametrize("name", ROWS)
def test_two_unit_vectors_are_across_rows_of_any_rank(name):
    rows = ROWS[name]
    free = np.asarray(_orthogonal_to(jnp.asarray(rows)))
    # some roundings of numbers of order one
    np.testing.assert_allclose(free.T @ free, np.eye(2), atol=2e-15)
    np.testing.assert_allclose(rows @ free, np.zeros((2, 2)), atol=1e-14)


def test_determinant():
    for matrix in DRAW.normal(size=(20, 4, 4)):
        # 24 products of four numbers of order one
        expected = np.linalg.det(matrix)
        found = determinant_4x4(jnp.asarray(matrix))
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-13)
