"""Rotations by NumPy are those by JAX, which the mechanics is tested with."""

import numpy as np

from rollkane.geometry.numpy_rotations import product, rotated
from rollkane.geometry.rotations import multiply, rotation_matrix

QUATERNIONS = np.random.default_rng(0).standard_normal((2, 7, 4))
VECTORS = np.random.default_rng(1).standard_normal((7, 3))
# some ten roundings of numbers below ten
ROUNDING = 1e-14


def test_product():
    p, q = QUATERNIONS
    wanted = np.asarray(multiply(p.T, q.T)).T
    np.testing.assert_allclose(product(p, q), wanted, rtol=0, atol=ROUNDING)


def test_rotated_by_quaternions_of_any_length():
    matrices = np.asarray(rotation_matrix(QUATERNIONS[0].T))
    wanted = np.einsum("ijk,kj->ki", matrices, VECTORS)
    np.testing.assert_allclose(
        rotated(QUATERNIONS[0], VECTORS), wanted, rtol=0, atol=ROUNDING
    )
    # every vector by every quaternion
    every = rotated(QUATERNIONS[0][:, None], VECTORS)
    assert every.shape == (7, 7, 3)
    np.testing.assert_array_equal(every[3, 5], rotated(QUATERNIONS[0][3], VECTORS[5]))
