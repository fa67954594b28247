"""Orientations from what other programs give: matrices, Euler angles, other orders.

What comes out is what :func:`rollkane.place` takes: a unit quaternion, scalar first,
that turns components on body axes into components on fixed axes.
"""

from collections.abc import Callable
from typing import Any, cast

import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from ..validation.checks import FieldError, dimension, real, refuse
from .rotations import multiply, quaternion_of

_AXES = "xyz"
_ROUGH = 1e-6  # of a matrix or a length: what five or six written digits leave


def orientation_from_matrix(matrix: Any) -> Float[Array, "4"]:
    """Orientation of a rotation matrix.

    Args:
        matrix: Body to fixed axes: its columns are the body axes in fixed components
            [1], shape (3, 3). (The rows, where it turns fixed into body components:
            give its transpose then.)

    Returns:
        Unit quaternion, scalar first [1], shape (4,); of either sign.

    Raises:
        FieldError: a matrix that is no rotation.
    """
    field = "orientation_from_matrix.matrix"
    matrix = real(field, matrix, (3, 3), "a 3 x 3 rotation matrix, body to fixed axes")

    def bad(x: Any) -> Any:
        (a, b, c), (d, e, f), (g, h, i) = x
        miss = abs(x.T @ x - np.eye(3)).max()
        volume = a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)
        return ~((miss < _ROUGH) & (volume > 0))

    remedy = "give orthonormal columns, right-handed: of determinant +1"
    checked = refuse(matrix, bad, field, "is no rotation matrix", remedy)
    return quaternion_of(jnp.asarray(checked))


def orientation_from_xyzw(quaternion: Any) -> Float[Array, "4"]:
    """Orientation of a quaternion whose scalar comes last (SciPy, ROS, glTF, Unity).

    Args:
        quaternion: (x, y, z, w) of unit length [1], shape (4,), body to fixed axes.

    Returns:
        (w, x, y, z) [1], shape (4,).

    Raises:
        FieldError: another length.
    """
    field, meaning = "orientation_from_xyzw.quaternion", "four numbers (x, y, z, w)"
    given = real(field, quaternion, (4,), meaning)
    wrong: Callable[[Any], Any] = lambda x: ~(abs((x * x).sum() - 1.0) < _ROUGH)
    remedy = "divide it by its length"
    given = refuse(given, wrong, field, "must be a quaternion of unit length", remedy)
    x, y, z, w = jnp.asarray(given)
    return jnp.stack([w, x, y, z])


def orientation_from_scipy(rotation: Any) -> Float[Array, "4"]:
    """Orientation of a ``scipy.spatial.transform.Rotation``.

    Args:
        rotation: One rotation, that turns components on body axes into components on
            fixed axes.

    Returns:
        Unit quaternion, scalar first [1], shape (4,).

    Raises:
        FieldError: several rotations, or something else.
    """
    field = "orientation_from_scipy.rotation"
    if not hasattr(rotation, "as_quat"):
        remedy = "give a scipy.spatial.transform.Rotation"
        raise FieldError(field, rotation, "is no rotation of SciPy", remedy)
    quaternion = np.asarray(rotation.as_quat())
    if quaternion.ndim != 1:
        remedy = "give one of them: rotations[i]"
        raise FieldError(field, quaternion.shape, "are several rotations", remedy)
    return orientation_from_xyzw(quaternion)


def orientation_from_euler(
    sequence: str, angles: Any, *, degrees: bool = False
) -> Float[Array, "4"]:
    """Orientation of Euler or Tait-Bryan angles, the convention named as SciPy does.

    Args:
        sequence: One to three axes, in the order of the turns. Upper case, ``"ZXZ"``:
            each about the axis of the body as the turns before have left it
            (intrinsic). Lower case, ``"zxz"``: each about a fixed axis (extrinsic).
            Precession, nutation and spin are ``"ZXZ"``; yaw, pitch and roll ``"ZYX"``.
        angles: One for each axis [rad].
        degrees: Whether the angles are in degrees.

    Returns:
        Unit quaternion, scalar first [1], shape (4,).

    Raises:
        FieldError: an unknown sequence, or another number of angles.
    """
    field = "orientation_from_euler.sequence"
    letters = sequence.lower() if isinstance(cast(object, sequence), str) else ""
    cased = sequence in (letters, letters.upper())
    if not (1 <= len(letters) <= 3 and set(letters) <= set(_AXES) and cased):
        remedy = 'give such as "ZYX" (about body axes) or "zyx" (about fixed axes)'
        raise FieldError(field, sequence, "is no sequence of axes", remedy)
    count = len(letters)
    meaning = f"{count} angles in {'degrees' if degrees else 'radians'}"
    field = "orientation_from_euler.angles"
    alone = count == 1 and dimension(angles) == 0
    given = real(field, [angles] if alone else angles, (count,), meaning)
    half = jnp.asarray(given) * (0.5 * (np.pi / 180.0 if degrees else 1.0))
    found: Array = jnp.zeros(4, half.dtype).at[0].set(1.0)
    for letter, angle in zip(letters, half, strict=True):
        turn = _turn(letter, angle)
        own = sequence != letters  # about axes that have been turned before
        found = multiply(found, turn) if own else multiply(turn, found)
    return found


def _turn(axis: str, half: ArrayLike) -> Float[Array, "4"]:
    """A turn about an axis, by half of its angle [rad]."""
    sine = jnp.sin(jnp.asarray(half))
    parts = [sine if axis == other else jnp.zeros_like(sine) for other in _AXES]
    return jnp.stack([jnp.cos(jnp.asarray(half)), *parts])
