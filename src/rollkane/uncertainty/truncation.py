"""Truncated distributions: what is left of one in an interval, right in far tails."""

from typing import Any, TypeAlias, cast

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from ..validation.checks import FieldError, is_traced, refuse
from .distribution_checks import described, numbers, ordered
from .distributions import AbstractContinuous

# log F and log (1 - F)
_Tails: TypeAlias = tuple[Array, Array]


class Truncated(AbstractContinuous):
    """A distribution given that its numbers lie in an interval.

    By the quantile at ``F(low) + u (F(high) - F(low))``, in logarithms of whichever
    tail is smaller: a normal distribution may be cut at 40 standard deviations.

    Attributes:
        distribution: What is truncated.
        low: Lower ends [unit of what it draws], of its shape; -inf: none.
        high: Upper ends [likewise]; inf: none.
    """

    distribution: AbstractContinuous
    low: Float[Array, "*shape"]
    high: Float[Array, "*shape"]

    def __init__(
        self,
        distribution: AbstractContinuous,
        low: ArrayLike | None = None,
        high: ArrayLike | None = None,
    ):
        """Truncate a distribution.

        Args:
            distribution: Normal, LogNormal, Uniform, or one of these truncated.
            low: Lower end, of all numbers or of each [unit of what it draws]; None or
                -inf: none.
            high: Upper end [likewise]; None or inf: none.

        Raises:
            FieldError: something that cannot be truncated, a lower end that is not
                below the upper one, an interval without any probability.
        """
        field = "Truncated.distribution"
        if not isinstance(cast(object, distribution), AbstractContinuous):
            remedy = "give Normal, LogNormal or Uniform"
            raise FieldError(field, distribution, "has no known tails", remedy)
        self.distribution = distribution
        shape = distribution.shape
        self.low = _limit("Truncated.low", low, -jnp.inf, shape)
        self.high = _limit("Truncated.high", high, jnp.inf, shape)
        self.low = ordered("Truncated.low", self.low, self.high)
        mass = cast(Array, log_mass(distribution, self.low, self.high))
        known = not is_traced(mass)
        if known and np.isnan(np.asarray(mass)).any():
            problem = "has a number that does not vary"
            raise FieldError(field, distribution, problem, "give it a deviation")
        self.low = refuse(
            self.low,
            ~(np.asarray(mass) > -np.inf) if known else ~(mass > -jnp.inf),
            "Truncated.low",
            "begins an interval without any probability",
            "move the interval to where the distribution is",
        )

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of a draw."""
        return self.distribution.shape

    def _ends(self, dtype: Any) -> tuple[_Tails, _Tails]:
        """Logarithms of both tails at both ends."""
        return _ends_of(
            self.distribution, self.low.astype(dtype), self.high.astype(dtype)
        )

    def quantile(
        self, log_cdf: Float[Array, "*n"], log_survival: Float[Array, "*n"]
    ) -> Float[Array, "*n"]:
        """The whole distribution's, at the probability in the interval."""
        low, high = (x.astype(log_cdf.dtype) for x in (self.low, self.high))
        return quantile_between(self.distribution, low, high, log_cdf, log_survival)

    def log_tails(self, x: Float[Array, "*n"]) -> tuple[Array, Array]:
        """Of the shares of the interval below and above."""
        dtype = x.dtype
        low, high = self._ends(dtype)
        mass = _log_between(low, high)
        limits = self.low.astype(dtype), self.high.astype(dtype)
        here = self.distribution.log_tails(jnp.clip(x, *limits))
        return _log_between(low, here) - mass, _log_between(here, high) - mass

    def spec(self) -> dict[str, Any]:
        """Kind, ends, and what is truncated."""
        of = {"distribution": self.distribution.spec()}
        return described(self, "low", "high") | of


def quantile_between(
    distribution: AbstractContinuous,
    low: Float[Array, "*n"],
    high: Float[Array, "*n"],
    log_cdf: Float[Array, "*n"],
    log_survival: Float[Array, "*n"],
) -> Float[Array, "*n"]:
    """Quantiles of a distribution given that its numbers lie in an interval.

    Args:
        distribution: As it is without the interval.
        low: Lower ends [unit of what it draws], -inf for none, of its shape.
        high: Upper ends [likewise], inf for none.
        log_cdf: Logarithm of the probability below, within the interval.
        log_survival: Of the one above.
    """
    least, most = _ends_of(distribution, low, high)
    mass = _log_between(least, most)
    below = jnp.logaddexp(least[0], log_cdf + mass)
    above = jnp.logaddexp(most[1], log_survival + mass)
    # rounding must not carry a number out of the interval
    return jnp.clip(distribution.quantile(below, above), low, high)


def _limit(
    field: str, value: ArrayLike | None, none: float, shape: tuple[int, ...]
) -> Array:
    """An end of the distribution's shape; infinite where there is none."""
    if value is None:
        return jnp.full(shape, none)
    if is_traced(value):
        found = numbers(field, value)
    else:
        infinite = np.asarray(value) == none
        known = numbers(field, np.where(infinite, 0.0, np.asarray(value)))
        found = jnp.where(jnp.asarray(infinite), none, known)
    if np.broadcast_shapes(found.shape, shape) != shape:
        problem = f"must have the distribution's shape {shape}, not {found.shape}"
        raise FieldError(field, value, problem, "give one number, or one for each")
    return jnp.broadcast_to(found, shape)


def _ends_of(
    distribution: AbstractContinuous, low: Array, high: Array
) -> tuple[_Tails, _Tails]:
    """Logarithms of both tails at ends, which may be infinite."""
    half = jnp.full(distribution.shape, jnp.log(0.5), low.dtype)
    middle = distribution.quantile(half, half)
    nothing, whole = jnp.full_like(half, -jnp.inf), jnp.zeros_like(half)

    def tails(limit: Array, below_none: Array, above_none: Array) -> _Tails:
        some = jnp.isfinite(limit)
        below, above = distribution.log_tails(jnp.where(some, limit, middle))
        return jnp.where(some, below, below_none), jnp.where(some, above, above_none)

    return tails(low, nothing, whole), tails(high, whole, nothing)


@jax.jit  # one program, not one for each operation
def log_mass(distribution: AbstractContinuous, low: Array, high: Array) -> Array:
    """Logarithm of an interval's probability; ends may be infinite."""
    return _log_between(*_ends_of(distribution, low, high))


def _log_between(low: _Tails, high: _Tails) -> Array:
    """``log (F(b) - F(a))`` from logarithms of both tails at a and b."""
    (low_below, low_above), (high_below, high_above) = low, high
    # from the tail in which the interval lies
    upper = low_above < low_below
    large = jnp.where(upper, low_above, high_below)
    small = jnp.where(upper, high_above, low_below)
    some = large > small  # fails where there is nothing, and of NaN
    apart = jnp.where(some, small - jnp.where(some, large, 0.0), -1.0)
    # log(1 - exp(d)), d < 0, either way without loss (Maechler 2012)
    near = apart > -0.6931
    share = jnp.where(
        near,
        jnp.log(-jnp.expm1(jnp.where(near, apart, -1.0))),
        jnp.log1p(-jnp.exp(jnp.where(near, -1.0, apart))),
    )
    nothing = jnp.where(jnp.isnan(large + jnp.exp(small)), jnp.nan, -jnp.inf)
    return jnp.where(some, large + share, nothing)
