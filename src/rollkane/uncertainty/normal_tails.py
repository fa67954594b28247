"""The normal distribution by logarithms of its probabilities, right in far tails."""

import math
from typing import cast

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import ndtr, ndtri
from jaxtyping import Array, Float

_HALF_LOG_TAU = 0.5 * math.log(2.0 * math.pi)
# Beyond, the asymptotic series is used. Its seven terms leave out 15!!/x^14 times
# (15/x^2): 5e-18 at 36, 3e-8 at 12; the complementary error function is still a normal
# number of its precision at either.
_FAR = {8: -36.0, 4: -12.0}
_TERMS = 7
_NEWTON = 3  # steps, from a start that is right to 5 %


def _log_density(x: Array) -> Array:
    return -0.5 * x * x - _HALF_LOG_TAU


@jax.custom_jvp
def log_normal_cdf(x: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """``log Phi(x)``, to rounding of its size, for any x.

    Source: Abramowitz and Stegun, 26.2.12, where Phi has no floating number.
    """
    far = _FAR[x.dtype.itemsize]
    # of both sides the smaller probability, which has no digits cancelled
    small = ndtr(jnp.maximum(-jnp.abs(x), far))
    near = jnp.where(x > 0.0, jnp.log1p(-small), jnp.log(small))
    beyond = jnp.minimum(x, far)
    inverse = 1.0 / (beyond * beyond)
    term, series = jnp.ones_like(x), jnp.ones_like(x)
    for k in range(_TERMS):
        term = -(2 * k + 1) * inverse * term
        series = series + term
    tail = _log_density(beyond) - jnp.log(-beyond) + jnp.log(series)
    return jnp.where(x > far, near, tail)


@log_normal_cdf.defjvp
def _(primals: tuple[Array], tangents: tuple[Array]) -> tuple[Array, Array]:
    (x,), (dx,) = primals, tangents
    value = log_normal_cdf(x)
    return value, jnp.exp(_log_density(x) - value) * dx


@jax.custom_jvp
def lower_quantile(logarithm: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """The x with ``log Phi(x)`` as given, for probabilities up to a half.

    By Newton's method on ``log Phi``, which is concave, from the inverse of Phi, or
    from ``-sqrt(-2 log p)`` where p has no floating number.

    Args:
        logarithm: Of the probability; -inf gives -inf.
    """
    least = float(np.log(np.finfo(logarithm.dtype).tiny)) + 1.0
    known = jnp.isfinite(logarithm)
    goal = jnp.minimum(jnp.where(known, logarithm, -1.0), jnp.log(0.5))
    size = -2.0 * jnp.minimum(goal, least)
    far = -jnp.sqrt(size - jnp.log(2.0 * jnp.pi * size))
    x = jnp.where(goal > least, ndtri(jnp.exp(jnp.maximum(goal, least))), far)

    def step(_: int, x: Array) -> Array:
        value = log_normal_cdf(x)
        return x - (value - goal) * jnp.exp(value - _log_density(x))

    found = cast(Array, jax.lax.fori_loop(0, _NEWTON, step, x))
    return jnp.where(known, found, -jnp.inf)


@lower_quantile.defjvp
def _(primals: tuple[Array], tangents: tuple[Array]) -> tuple[Array, Array]:
    (logarithm,), (change,) = primals, tangents
    x = lower_quantile(logarithm)
    known = jnp.isfinite(x)
    at = jnp.where(known, x, 0.0)
    slope = jnp.exp(jnp.where(known, logarithm, 0.0) - _log_density(at))
    return x, jnp.where(known, slope * change, 0.0)


def normal_quantile(
    log_cdf: Float[Array, "*n"], log_survival: Float[Array, "*n"]
) -> Float[Array, "*n"]:
    """The standard normal's quantile from both of its tails, the smaller one deciding.

    Args:
        log_cdf: ``log p``.
        log_survival: ``log (1 - p)``.
    """
    small = jnp.minimum(log_cdf, log_survival)
    x = lower_quantile(small)
    return jnp.where(log_cdf <= log_survival, x, -x)
