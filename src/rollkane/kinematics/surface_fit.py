"""Whether two surfaces determine how their contact moves, or fit each other."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..geometry.local_geometry import LocalGeometry
from ..geometry.small_linear import matmul
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
    return jnp.abs(_determinant(whole))


def _least(size: Array) -> Array:
    return jnp.where(size > 0.0, size, 1.0)


def _determinant(a: Float[Array, "4 4"]) -> Float[Array, ""]:
    """By Laplace's expansion along the first two rows."""
    places = [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]
    signs = [1.0, -1.0, 1.0, 1.0, -1.0, 1.0]

    def minors(first: Array, second: Array) -> list[Array]:
        return [first[i] * second[j] - first[j] * second[i] for i, j in places]

    above, below = minors(a[0], a[1]), reversed(minors(a[2], a[3]))
    total = jnp.zeros((), a.dtype)
    for s, x, y in zip(signs, above, below, strict=True):
        total = total + s * x * y
    return total


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
