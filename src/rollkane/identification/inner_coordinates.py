"""Coordinates without ends, of coordinates within bounds: for samplers.

A number above a bound grows as its coordinate where it is more than its deviation away,
and with the exponential of it nearer by: ``lower + size log(1 + exp(y))``. A number
between two does so from both. Densities have the slope as a factor, so that flat ones
of the numbers stay flat in the numbers.
"""

from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy import stats  # pyright: ignore[reportMissingTypeStubs]

_OUTSIDE = 5.0  # deviations of an estimate beyond a bound: farther, densities are alike


class InnerCoordinates(NamedTuple):
    """Numbers z between bounds by y, which has none.

    Attributes:
        lower: Bounds of z, infinite for none, shape (P,).
        upper: Likewise.
        size: Distance from a bound from which on y is linear, no more than that of two
            bounds, shape (P,).
    """

    lower: Float[np.ndarray, " P"]
    upper: Float[np.ndarray, " P"]
    size: Float[np.ndarray, " P"]

    @classmethod
    def of(
        cls,
        lower: Float[np.ndarray, " P"],
        upper: Float[np.ndarray, " P"],
        deviation: Float[np.ndarray, " P"],
    ) -> "InnerCoordinates":
        """Of bounds, and deviations of z as they are without these."""
        return cls(lower, upper, np.minimum(deviation, upper - lower))

    @property
    def _ends(self) -> tuple[np.ndarray, np.ndarray]:
        """Which have a lower, and an upper bound."""
        return np.isfinite(self.lower), np.isfinite(self.upper)

    @property
    def _apart(self) -> np.ndarray:
        """Of two bounds, over the size; 0 where there are not two."""
        low, high = self._ends
        width = np.where(low, self.upper, 0.0) - np.where(high, self.lower, 0.0)
        return np.where(low & high, width, 0.0) / self.size

    def numbers(self, y: Float[Array, " P"]) -> Float[Array, " P"]:
        """The numbers z."""
        low, high = self._ends
        lower, upper = np.where(low, self.lower, 0.0), np.where(high, self.upper, 0.0)
        plus, apart = jax.nn.softplus, self._apart
        # each from the bound that is nearer: no rounding leads beyond it
        above = plus(y) - np.where(low & high, 1.0, 0.0) * plus(y - apart)
        below = plus(apart - y) - np.where(low & high, 1.0, 0.0) * plus(-y)
        from_low = low & (~high | (y < 0.5 * apart))
        z = jnp.where(high, upper - self.size * below, y)
        return jnp.where(from_low, lower + self.size * above, z)

    def log_slope(self, y: Float[Array, " P"]) -> Float[Array, ""]:
        """Logarithm of the product of all slopes of z by y, without a constant."""
        low, high = self._ends
        rising = jnp.where(low, jax.nn.log_sigmoid(y), 0.0)
        return jnp.sum(
            rising + jnp.where(high, jax.nn.log_sigmoid(self._apart - y), 0.0)
        )

    def inverse(self, z: Float[np.ndarray, " P"]) -> np.ndarray:
        """Coordinates y of numbers inside, none of them on a bound."""
        low, high = self._ends
        away = np.where(low, z - self.lower, self.size) / self.size
        left = np.where(high, self.upper - z, self.size) / self.size
        above, below = (np.log(-np.expm1(-x)) for x in (away, left))
        inside = np.where(low, away + above, -left) - np.where(high, below, 0.0)
        return np.where(low | high, inside, z)

    def about(
        self, z: Float[np.ndarray, " P"], covariance: Float[np.ndarray, "P P"]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Middle and a root of a covariance in y, of a normal distribution cut off.

        Each number by itself has the middle and the deviation of what bounds leave of
        it; numbers go with each other as they would without bounds. A sampler finds
        from there how the density really bends.

        Args:
            z: Means without bounds, which may lie beyond them.
            covariance: Likewise.

        Returns:
            Of y, shape (P,), and its covariance's root, shape (P, P).
        """
        root = np.linalg.cholesky(covariance)
        has_end = np.logical_or(*self._ends)
        if not has_end.any():
            return z, root
        deviation = np.sqrt(np.diag(covariance))
        reach = _OUTSIDE * deviation
        near = np.clip(z, self.lower - reach, self.upper + reach)
        ends = ((x - near) / deviation for x in (self.lower, self.upper))
        of_cut = cast(Any, stats).truncnorm.stats
        mean, variance = cast("tuple[Any, Any]", of_cut(*ends, moments="mv"))
        middle = np.where(has_end, near + deviation * mean, z)
        y = np.where(has_end, self.inverse(middle), z)
        slope = np.asarray(jax.jvp(self.numbers, (y,), (np.ones_like(y),))[1])
        spread = np.where(has_end, np.sqrt(variance) / slope, 1.0)
        return y, spread[:, None] * root
