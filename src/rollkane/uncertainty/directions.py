"""Random directions about one of them."""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from ..validation.checks import not_negative
from .distribution_checks import described, inside, unit
from .distributions import AbstractDistribution


class VonMisesFisher(AbstractDistribution):
    """Unit vectors about a direction, with density ``exp(k m . x)`` on the sphere.

    For large k the angle from m is about ``1 / sqrt(k)``; zero is the uniform
    distribution of directions.

    Attributes:
        direction: m, of unit length [1], shape (3,).
        concentration: k [1].

    Source: Fisher, Proc. R. Soc. A 217 (1953); its quantile is closed on this sphere
    (Ulrich, J. R. Stat. Soc. C 33, 1984).
    """

    direction: Float[Array, "3"]
    concentration: Float[Array, ""]

    def __init__(self, direction: Any, concentration: ArrayLike):
        """Make the distribution.

        Args:
            direction: Three components of any length but zero [1].
            concentration: k, zero or more [1].

        Raises:
            FieldError: no direction, a negative concentration.
        """
        self.direction = unit("VonMisesFisher.direction", direction)
        self.concentration = not_negative(
            "VonMisesFisher.concentration", concentration, "of zero or more"
        )

    @property
    def shape(self) -> tuple[int, ...]:
        """Three components."""
        return (3,)

    @property
    def size(self) -> int:
        """Two uniform numbers: of the angle from the direction, and about it."""
        return 2

    def draw(self, u: Float[Array, "2"]) -> Float[Array, "3"]:
        """The unit vector: its component along m grows with the first number."""
        u = inside(u)
        k = self.concentration.astype(u.dtype)
        fall = _fall(u[0], k)
        across = jnp.sqrt(fall * (2.0 - fall))
        angle = 2.0 * jnp.pi * u[1]
        m = self.direction.astype(u.dtype)
        first, second = _across(m)
        return (
            (1.0 - fall) * m
            + across * jnp.cos(angle) * first
            + across * jnp.sin(angle) * second
        )

    def spec(self) -> dict[str, Any]:
        """Kind and numbers."""
        return described(self, "direction", "concentration")


def _fall(u: Float[Array, ""], k: Float[Array, ""]) -> Float[Array, ""]:
    """``1 - w`` of ``w = 1 + log(u + (1 - u) exp(-2 k)) / k``, for any k from zero."""
    tiny: Array = k < float(np.finfo(np.dtype(k.dtype)).eps)
    safe = jnp.where(tiny, 1.0, k)
    # one form loses digits where k is small, the other where u is
    near = (safe < 1.0) | (u > 0.5)
    one = jnp.log1p((1.0 - u) * jnp.expm1(-2.0 * safe))
    other = jnp.logaddexp(jnp.log(u), jnp.log1p(-u) - 2.0 * safe)
    logarithm = jnp.where(near, jnp.where(near, one, 0.0), other)
    even = 2.0 * (1.0 - u) * (1.0 - k * u)  # its series in k
    return jnp.where(tiny, even, -logarithm / safe)


def _across(m: Float[Array, "3"]) -> tuple[Array, Array]:
    """Two unit vectors across a third (Duff et al., JCGT 6, 2017)."""
    sign = jnp.where(m[2] < 0.0, -1.0, 1.0).astype(m.dtype)
    a = -1.0 / (sign + m[2])
    b = m[0] * m[1] * a
    first = jnp.stack([1.0 + sign * m[0] * m[0] * a, sign * b, -sign * m[0]])
    return first, jnp.stack([b, sign + m[1] * m[1] * a, -m[1]])
