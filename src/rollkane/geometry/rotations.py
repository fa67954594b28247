"""Rotations by quaternions of any length, and tangent pairs of a direction.

Quaternions are scalar first and map body components to fixed ones. Every formula is
homogeneous (``s = 2/|q|^2``), so the length of a quaternion never matters and no
normalisation is part of the motion.
"""

from typing import cast

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..codegen.tracing import traced_once
from .small_linear import components, cross, dot, inverse_sqrt, sign


@traced_once
def rotation_matrix(quaternion: Float[Array, "4 *B"]) -> Float[Array, "3 3 *B"]:
    """Rotation matrix of a quaternion of any non-zero length.

    Args:
        quaternion: Scalar first, body to fixed [1].

    Returns:
        ``R_NB`` with ``v_fixed = R_NB v_body`` [1].

    Source: docs/theory.md, (1.4).
    """
    a, b, c, d = components(quaternion)
    s = 2.0 / (a * a + b * b + c * c + d * d)
    sb, sc, sd = s * b, s * c, s * d
    return jnp.stack(
        [
            jnp.stack([1.0 - (sc * c + sd * d), sb * c - sd * a, sb * d + sc * a]),
            jnp.stack([sb * c + sd * a, 1.0 - (sb * b + sd * d), sc * d - sb * a]),
            jnp.stack([sb * d - sc * a, sc * d + sb * a, 1.0 - (sb * b + sc * c)]),
        ]
    )


def about_axis(axis: int, angle: Float[Array, ""]) -> Float[Array, "3 3"]:
    """Turn about a coordinate axis [1].

    Args:
        axis: 0, 1 or 2 for x, y or z.
        angle: Positive by the right hand [rad].
    """
    c, s = jnp.cos(angle), jnp.sin(angle)
    o, e = jnp.zeros_like(c), jnp.ones_like(c)
    rows = {
        0: [[e, o, o], [o, c, -s], [o, s, c]],
        1: [[c, o, s], [o, e, o], [-s, o, c]],
        2: [[c, -s, o], [s, c, o], [o, o, e]],
    }
    return jnp.stack([jnp.stack(row) for row in rows[axis]])


@traced_once
def multiply(p: Float[Array, "4 *B"], q: Float[Array, "4 *B"]) -> Float[Array, "4 *B"]:
    """Quaternion product ``p q``: first the rotation ``q``, then ``p``."""
    a, b, c, d = components(p)
    e, f, g, h = components(q)
    return jnp.stack(
        [
            a * e - b * f - c * g - d * h,
            a * f + b * e + c * h - d * g,
            a * g - b * h + c * e + d * f,
            a * h + b * g - c * f + d * e,
        ]
    )


@traced_once
def quaternion_rates(
    quaternion: Float[Array, "4 *B"], angular_velocity: Float[Array, "3 *B"]
) -> Float[Array, "4 *B"]:
    """Rates of a body-to-fixed quaternion, linear in the quaternion.

    Args:
        quaternion: Scalar first, body to fixed [1].
        angular_velocity: On BODY axes [rad/s].

    Source: docs/theory.md, (4.5).
    """
    a, b, c, d = components(quaternion)
    x, y, z = components(0.5 * angular_velocity)
    return jnp.stack(
        [
            -(b * x + c * y + d * z),
            a * x + c * z - d * y,
            a * y - b * z + d * x,
            a * z + b * y - c * x,
        ]
    )


def quaternion_of(rotation: Float[Array, "3 3"]) -> Float[Array, "4"]:
    """Unit quaternion of a rotation matrix, scalar first; of either sign.

    Of the four equal formulas the one whose divisor is largest is taken.
    """
    (a, b, c), (d, e, f), (g, h, i) = (components(row) for row in components(rotation))
    rows = jnp.stack(
        [
            jnp.stack([1.0 + a + e + i, h - f, c - g, d - b]),
            jnp.stack([h - f, 1.0 + a - e - i, b + d, c + g]),
            jnp.stack([c - g, b + d, 1.0 - a + e - i, f + h]),
            jnp.stack([d - b, c + g, f + h, 1.0 - a - e + i]),
        ]
    )
    best = rows[jnp.argmax(cast(Array, jnp.diagonal(rows)))]
    return best * inverse_sqrt(dot(best, best))


def in_one_sense(quaternions: Float[Array, "T 4"]) -> Float[Array, "T 4"]:
    """Quaternions of successive times with signs that make them continuous."""
    along = jnp.sum(quaternions[1:] * quaternions[:-1], axis=1)
    flips = jnp.where(along < 0, -1.0, 1.0).astype(quaternions.dtype)
    signs = jnp.concatenate([jnp.ones(1, quaternions.dtype), jnp.cumprod(flips)])
    return quaternions * signs[:, None]


def shortest_turn(
    start: Float[Array, "3 *B"], end: Float[Array, "3 *B"]
) -> Float[Array, "4 *B"]:
    """Quaternion (any length) of the smallest rotation from ``start`` to ``end``.

    Both are unit vectors; opposite ones have no smallest rotation (zero quaternion).
    """
    return jnp.concatenate([(1.0 + dot(start, end))[None], cross(start, end)])


@traced_once
def tangent_pair(
    normal: Float[Array, "3 *B"],
) -> tuple[Float[Array, "3 *B"], Float[Array, "3 *B"]]:
    """Two unit vectors that make a right-handed frame with a unit vector.

    Free of trigonometry, square roots and singular directions; the pair jumps where
    the third component changes sign, which is harmless where any pair will do.

    Source: Duff et al., Building an orthonormal basis, revisited (2017).
    """
    x, y, z = components(normal)
    s = sign(z)
    a = -1.0 / (s + z)
    b = x * y * a
    first = jnp.stack([1.0 + s * x * x * a, s * b, -s * x])
    return first, jnp.stack([b, s + y * y * a, -y])
