"""Whether two surfaces determine how their contact moves, or fit each other."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..geometry.local_geometry import LocalGeometry
from ..geometry.small_linear import (
    components,
    determinant_4x4,
    dot,
    matmul,
    norm,
)
from ..validation.checks import FieldError, is_traced

# of a determinant whose rows and columns are of order one: a thousand roundings; two
# spheres that fit to 1e-6 of their radius are still told apart
_ROUNDINGS = 1000.0


def fit_of(
    shell: LocalGeometry, ground: LocalGeometry, to_base: Float[Array, "3 3"]
) -> Float[Array, ""]:
    """Determinant of (3.5), without units [1]: zero where the surfaces fit.

    Args:
        shell: Of the surface that rolls.
        ground: Of the other.
        to_base: Rotation from the first's axes to the second's.

    Source: docs/theory.md, (3.5): smooth surfaces have det Delta det L det L_c.
    """
    mixing = matmul(shell.frame[:, :2].T, matmul(to_base.T, ground.frame[:, :2]))
    above = [-shell.frame_rates, -matmul(mixing, ground.frame_rates)]
    below = [-shell.lengths, matmul(mixing, ground.lengths)]
    rows = [jnp.concatenate(pair, axis=1) for pair in (above, below)]
    rows = [row / _least(jnp.sqrt(jnp.sum(row * row))) for row in rows]
    whole = jnp.concatenate(rows)
    whole = whole / _least(jnp.sqrt(jnp.sum(whole * whole, axis=0)))[None]
    return jnp.abs(determinant_4x4(whole))


def _least(size: Array) -> Array:
    return jnp.where(size > 0.0, size, 1.0)


def refuse_fit(field: str, fit: Float[Array, ""], value: Any) -> Float[Array, ""]:
    """The determinant; refused where it is zero, NaN where it is traced and zero.

    Args:
        field: Name used in the error.
        fit: What :func:`fit_of` gives.
        value: The surface, for the error.

    Raises:
        FieldError: the surfaces fit each other.
    """
    least = _ROUNDINGS * float(np.finfo(fit.dtype).eps)
    if is_traced(fit):
        return jnp.where(jax.lax.stop_gradient(fit) > least, fit, jnp.nan)
    if not float(fit) > least:
        raise FieldError(
            field,
            value,
            "fits the other surface at the contact (their relative curvature is "
            "singular), so that rolling does not determine where the contact goes",
            "give one of them another curvature; a line of contact rolls as a sphere "
            "or a torus of the same radius",
        )
    return fit


def opening_of(
    shell: LocalGeometry, ground: LocalGeometry, mixing: Float[Array, "2 2"]
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """How two touching surfaces part: least opening, and relative curvature.

    The columns of ``[[K_b, T K_c], [-L_b, T L_c]]``, (3.5), lengths in radii of
    the sharper surface, are scaled to unit length, so that edges and planes, large and
    small bodies count alike; the determinant vanishes exactly where the surfaces fit.
    The opening of a motion with equal travels ``L_b x_b = T L_c x_c`` is
    ``(L_b x_b) . (K_b x_b + T K_c x_c)``.
    """
    K_b, L_b = -shell.frame_rates, shell.lengths
    K_c, L_c = -mixing @ ground.frame_rates, mixing @ ground.lengths
    radius = jnp.minimum(*(_size(L) / _size(K) for L, K in ((L_b, K_b), (L_c, K_c))))
    radius = jnp.where(jnp.isfinite(radius), radius, 1.0)  # two planes: they fit
    turns = jnp.concatenate([K_b, K_c], axis=1)
    travels = jnp.concatenate([-L_b, L_c], axis=1) / radius
    unit = 1.0 / norm(jnp.concatenate([turns, travels]))[None]
    turns, travels = turns * unit, travels * unit
    free = _orthogonal_to(travels)
    opening = (-travels[:, :2] @ free[:2]).T @ (turns @ free)
    largest = jnp.max(jnp.abs(opening))
    (a, b), (c, d) = map(components, components(opening))
    apart = jnp.sqrt((0.5 * (a - d)) ** 2 + (0.5 * (b + c)) ** 2)
    least = 0.5 * (a + d) - apart  # of both eigenvalues of its symmetric part
    opening = least / jnp.where(largest > 0, largest, 1.0)
    return opening, determinant_4x4(jnp.concatenate([turns, travels]))


def _orthogonal_to(rows: Float[Array, "2 4"]) -> Float[Array, "4 2"]:
    """Two unit vectors across two others and one another, whatever these are.

    By Householder's reflections, which take both into the plane of the first two axes:
    the last two of the orthogonal matrix.
    """
    across: list[Array] = []
    index = jnp.arange(4)
    for k in range(2):
        x = jnp.where(index >= k, rows[k], 0.0)
        length = jnp.where(x[k] < 0.0, -norm(x), norm(x))
        v = x + jnp.where(index == k, length, 0.0)
        squared = dot(v, v)
        v = v * jnp.sqrt(2.0 / jnp.where(squared > 0.0, squared, 1.0))
        rows = rows - (rows @ v)[:, None] * v[None]
        across.append(v)
    last = jnp.eye(4, dtype=rows.dtype)[:, 2:]
    for v in reversed(across):
        last = last - v[:, None] * (v @ last)[None]
    return last


def _size(matrix: Array) -> Array:
    return jnp.sqrt(jnp.sum(matrix * matrix))
