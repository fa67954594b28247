"""Distributions of numbers of a scene or a start, drawn from uniform numbers.

A draw is a function of ``u`` in (0, 1): quantiles, or a map under which the image of
uniform numbers has the distribution. Plain, Latin hypercube and Sobol samples, standard
normal numbers ``z`` by ``u = Phi(z)``, and derivatives all go through it.
"""

import abc
import math
from typing import Any, TypeAlias

import equinox as eqx
import jax.numpy as jnp
from jax.scipy.special import ndtri
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from ..identification.transforms import entries
from ..validation.checks import positive
from .distribution_checks import (
    alike,
    described,
    inside,
    log_share,
    ordered,
    refuse_negative,
)
from .normal_tails import log_normal_cdf, normal_quantile

Drawn: TypeAlias = Any  # an array, or a dict of them


class AbstractDistribution(eqx.Module):
    """What one name of a study is drawn from.

    Attributes:
        shape: Of one draw; of one that draws several numbers, by their names.
    """

    @property
    @abc.abstractmethod
    def shape(self) -> Any:
        """Shape of one draw; by name where it draws several."""

    @property
    @abc.abstractmethod
    def size(self) -> int:
        """How many uniform numbers a draw takes."""

    @abc.abstractmethod
    def draw(self, u: Float[Array, " size"]) -> Drawn:
        """The draw of uniform numbers.

        Args:
            u: In (0, 1) [1]; its dtype is that of the draw.
        """

    @abc.abstractmethod
    def spec(self) -> dict[str, Any]:
        """Its kind and its numbers, as JSON has them: what identifies it."""

    @property
    def factors(self) -> tuple[tuple[str, int], ...]:
        """Independent parts of a draw: a label, and how many of ``u`` in order."""
        return (("", self.size),)


class AbstractUnivariate(AbstractDistribution):
    """Independent numbers, each the quantile of its own uniform number."""

    @property
    def size(self) -> int:
        """One uniform number for each entry."""
        return math.prod(self.shape)

    @property
    def factors(self) -> tuple[tuple[str, int], ...]:
        """The entries."""
        return tuple((label, 1) for label in entries(self.shape))

    @abc.abstractmethod
    def quantile(
        self, log_cdf: Float[Array, "*n"], log_survival: Float[Array, "*n"]
    ) -> Float[Array, "*n"]:
        """Quantiles, from the logarithms of both tails, so that either may be far.

        Args:
            log_cdf: ``log p``, in the shape of a draw.
            log_survival: ``log (1 - p)``.
        """

    def draw(self, u: Float[Array, " size"]) -> Float[Array, "*shape"]:
        """The quantiles of u, in the shape of a draw."""
        u = inside(u).reshape(self.shape)
        return self.quantile(jnp.log(u), jnp.log1p(-u))


class AbstractContinuous(AbstractUnivariate):
    """Independent numbers with known tails, which can be truncated."""

    @abc.abstractmethod
    def log_tails(self, x: Float[Array, "*n"]) -> tuple[Array, Array]:
        """``log F(x)`` and ``log (1 - F(x))``, for finite x."""


class Normal(AbstractContinuous):
    """Normal numbers, independent of each other.

    Attributes:
        mean: [unit of what it draws].
        std: Standard deviation [likewise], of the mean's shape.
    """

    mean: Float[Array, "*shape"]
    std: Float[Array, "*shape"]

    def __init__(self, mean: ArrayLike, std: ArrayLike):
        """Make the distribution.

        Args:
            mean: A number or an array of any shape [unit of what it draws].
            std: Standard deviation [likewise]: of all, or of each. Zero holds a number.

        Raises:
            FieldError: numbers that are not finite, a negative deviation, shapes that
                do not fit.
        """
        self.mean, self.std = alike("Normal", mean=mean, std=std)
        self.std = refuse_negative("Normal.std", self.std)

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of a draw."""
        return self.mean.shape

    def draw(self, u: Float[Array, " size"]) -> Float[Array, "*shape"]:
        """``mean + std Phi^-1(u)``."""
        z = ndtri(inside(u).reshape(self.shape))
        return self.mean.astype(z.dtype) + self.std.astype(z.dtype) * z

    def quantile(
        self, log_cdf: Float[Array, "*n"], log_survival: Float[Array, "*n"]
    ) -> Float[Array, "*n"]:
        """``mean + std z``."""
        z = normal_quantile(log_cdf, log_survival)
        return self.mean.astype(z.dtype) + self.std.astype(z.dtype) * z

    def log_tails(self, x: Float[Array, "*n"]) -> tuple[Array, Array]:
        """Of the standard normal distribution, at ``(x - mean) / std``."""
        z = (x - self.mean.astype(x.dtype)) / self.std.astype(x.dtype)
        return log_normal_cdf(z), log_normal_cdf(-z)

    def spec(self) -> dict[str, Any]:
        """Kind and numbers."""
        return described(self, "mean", "std")


class LogNormal(AbstractContinuous):
    """Positive numbers whose logarithms are normal, independent of each other.

    Attributes:
        median: [unit of what it draws].
        sigma: Standard deviation of the logarithm [1], of the median's shape.
    """

    median: Float[Array, "*shape"]
    sigma: Float[Array, "*shape"]

    def __init__(self, median: ArrayLike, sigma: ArrayLike):
        """Make the distribution.

        Args:
            median: Positive, a number or an array of any shape [unit of what it draws].
            sigma: Standard deviation of the natural logarithm [1]: for small ones the
                relative deviation.

        Raises:
            FieldError: a median that is not positive, a negative deviation, numbers
                that are not finite, shapes that do not fit.
        """
        self.median, self.sigma = alike("LogNormal", median=median, sigma=sigma)
        shape = self.median.shape
        self.median = positive("LogNormal.median", self.median, shape, "a number")
        self.sigma = refuse_negative("LogNormal.sigma", self.sigma)

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of a draw."""
        return self.median.shape

    def draw(self, u: Float[Array, " size"]) -> Float[Array, "*shape"]:
        """``median exp(sigma Phi^-1(u))``."""
        return self._of(ndtri(inside(u).reshape(self.shape)))

    def quantile(
        self, log_cdf: Float[Array, "*n"], log_survival: Float[Array, "*n"]
    ) -> Float[Array, "*n"]:
        """``median exp(sigma z)``."""
        return self._of(normal_quantile(log_cdf, log_survival))

    def _of(self, z: Array) -> Array:
        return self.median.astype(z.dtype) * jnp.exp(self.sigma.astype(z.dtype) * z)

    def log_tails(self, x: Float[Array, "*n"]) -> tuple[Array, Array]:
        """Of the standard normal distribution, at ``log(x / median) / sigma``."""
        some = x > 0.0
        share = jnp.where(some, x, 1.0) / self.median.astype(x.dtype)
        z = jnp.log(share) / self.sigma.astype(x.dtype)
        below = jnp.where(some, log_normal_cdf(z), -jnp.inf)
        return below, jnp.where(some, log_normal_cdf(-z), 0.0)

    def spec(self) -> dict[str, Any]:
        """Kind and numbers."""
        return described(self, "median", "sigma")


class Uniform(AbstractContinuous):
    """Uniform numbers, independent of each other.

    Attributes:
        low: [unit of what it draws].
        high: [likewise], of the same shape.
    """

    low: Float[Array, "*shape"]
    high: Float[Array, "*shape"]

    def __init__(self, low: ArrayLike, high: ArrayLike):
        """Make the distribution.

        Args:
            low: Lower end, a number or an array of any shape [unit of what it draws].
            high: Upper end [likewise].

        Raises:
            FieldError: numbers that are not finite, a lower end that is not below the
                upper one, shapes that do not fit.
        """
        self.low, self.high = alike("Uniform", low=low, high=high)
        self.low = ordered("Uniform.low", self.low, self.high)

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of a draw."""
        return self.low.shape

    def draw(self, u: Float[Array, " size"]) -> Float[Array, "*shape"]:
        """``low + (high - low) u``."""
        u = inside(u).reshape(self.shape)
        low, high = self.low.astype(u.dtype), self.high.astype(u.dtype)
        return low * (1.0 - u) + high * u

    def quantile(
        self, log_cdf: Float[Array, "*n"], log_survival: Float[Array, "*n"]
    ) -> Float[Array, "*n"]:
        """Linear in the probability."""
        low, high = self.low.astype(log_cdf.dtype), self.high.astype(log_cdf.dtype)
        return low * jnp.exp(log_survival) + high * jnp.exp(log_cdf)

    def log_tails(self, x: Float[Array, "*n"]) -> tuple[Array, Array]:
        """Of the shares below and above."""
        low, high = self.low.astype(x.dtype), self.high.astype(x.dtype)
        width = high - low
        return log_share((x - low) / width), log_share((high - x) / width)

    def spec(self) -> dict[str, Any]:
        """Kind and numbers."""
        return described(self, "low", "high")


class UniformOrientation(AbstractDistribution):
    """Orientations of which none is likelier than another (Haar's measure).

    Draws unit quaternions, scalar first, body to fixed axes [1].

    Source: Muller, Comm. ACM 2 (1959): normal numbers have no direction of their own.
    """

    @property
    def shape(self) -> tuple[int, ...]:
        """Four numbers."""
        return (4,)

    @property
    def size(self) -> int:
        """Four uniform numbers."""
        return 4

    def draw(self, u: Float[Array, "4"]) -> Float[Array, "4"]:
        """The direction of four normal numbers, each the quantile of its own ``u``.

        Orientations near a given one are two round cones of these numbers, q and -q,
        which a search for rare events can follow; angles would cut them.
        """
        z = ndtri(inside(u))
        # the middle of all four has no direction: no turn
        z = jnp.where(jnp.all(z == 0.0), jnp.eye(4, dtype=z.dtype)[0], z)
        return z / jnp.sqrt(z @ z)

    def spec(self) -> dict[str, Any]:
        """Kind."""
        return described(self)
