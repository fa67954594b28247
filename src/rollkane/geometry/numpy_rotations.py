"""Rotations of known numbers, by NumPy: of what is read, shown and compared.

Quaternions are scalar first, of any non-zero length, as in ``rotations``.
"""

import numpy as np
from numpy.typing import ArrayLike


def product(p: ArrayLike, q: ArrayLike) -> np.ndarray:
    """Quaternion product ``p q``, shape (..., 4): first ``q``, then ``p``."""
    p, q = np.asarray(p, float), np.asarray(q, float)
    a, v, b, w = p[..., :1], p[..., 1:], q[..., :1], q[..., 1:]
    scalar = a * b - np.sum(v * w, axis=-1, keepdims=True)
    return np.concatenate([scalar, a * w + b * v + np.cross(v, w)], axis=-1)


def rotated(quaternion: ArrayLike, vector: ArrayLike) -> np.ndarray:
    """Vectors turned by quaternions, of axes in front that fit, shape (..., 3).

    As they were for a quaternion of length zero, which is none.
    """
    q, x = np.asarray(quaternion, float), np.asarray(vector, float)
    a, v = q[..., :1], q[..., 1:]
    square = np.sum(q * q, axis=-1, keepdims=True)
    turn = 2.0 * np.cross(v, x) / np.maximum(square, 1e-300)
    return x + a * turn + np.cross(v, turn)
