"""Normal numbers that vary together, each within an interval: their joint distribution.

One after the other, each within its own interval given those before it, they have
another one: what is left to those behind is not counted. So a draw is made in turn
about tilted means, and is kept with the probability that makes up for it.

Source: Botev, J. R. Stat. Soc. B 79 (2017), 125 (minimax tilting).
"""

from collections.abc import Callable
from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy import optimize, special  # pyright: ignore[reportMissingTypeStubs]

from .distribution_checks import inside
from .distributions import Normal
from .truncation import log_mass, quantile_between

_MOST = 10_000  # tries: beyond, a draw is NaN
_STATIONARY = 1e-8  # slope of a weight's logarithm, and so the error of the largest


class Box(NamedTuple):
    """Normal numbers and their intervals.

    Attributes:
        center: As without intervals, shape (n,).
        root: Of their covariance, as without intervals, lower triangular, shape (n, n).
        lower: Ends, shape (n,); -inf: none.
        upper: Likewise; inf: none.
    """

    center: Array
    root: Array
    lower: Array
    upper: Array


class Tilt(NamedTuple):
    """How draws are made.

    Attributes:
        means: That standard normal numbers are drawn about, shape (n,).
        most: Logarithm of the largest weight of a draw, or more.
    """

    means: Array
    most: Array


def tilt_of(box: Box) -> Tilt:
    """The means that keep the most draws, where they are found.

    For any means the largest weight is where its derivatives by the draw vanish, as its
    logarithm is concave. Without any tilt it is one, at most.
    """
    center, root, lower, upper = (np.asarray(part, float) for part in box)
    size, spreads = center.size, np.diag(root)
    if size < 2 or not (spreads > 0.0).all():
        return Tilt(jnp.zeros(size), jnp.zeros(()))
    slopes = np.tril(root, -1) / spreads[:, None]
    ends = (lower - center) / spreads, (upper - center) / spreads

    def at(point: np.ndarray) -> tuple[float, np.ndarray]:
        """Logarithm of a draw's weight, and its derivatives by the draw and means."""
        # the last number is not tilted, and nothing depends on it
        x, means = (np.append(part, 0.0) for part in np.split(point, 2))
        low, high = (end - slopes @ x - means for end in ends)
        mass = _log_between(low, high)
        rise = np.exp(_log_density(low) - mass) - np.exp(_log_density(high) - mass)
        by_x, by_means = rise @ slopes - means, means - x + rise
        value = float(np.sum(0.5 * means**2 - x * means + mass))
        return value, np.concatenate([by_x[:-1], by_means[:-1]])

    solve = cast(Any, optimize).root
    slope_at: Callable[[np.ndarray], np.ndarray] = lambda point: at(point)[1]
    found = solve(slope_at, np.zeros(2 * size - 2), options={"xtol": 1e-12})
    value, slope = at(found.x)
    if not (np.abs(slope) < _STATIONARY).all():
        return Tilt(jnp.zeros(size), jnp.zeros(()))
    means = np.append(found.x[size - 1 :], 0.0)
    return Tilt(jnp.asarray(means), jnp.asarray(value))


def _log_density(x: np.ndarray) -> np.ndarray:
    return -0.5 * x * x - 0.5 * np.log(2.0 * np.pi)


def _log_between(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Logarithm of the normal probability between ends."""
    # of the tail in which the middle lies
    upper = low + high > 0.0
    low, high = np.where(upper, -high, low), np.where(upper, -low, high)
    tail: Callable[[np.ndarray], np.ndarray] = cast(Any, special).log_ndtr
    return tail(high) + np.log1p(-np.exp(tail(low) - tail(high)))


def drawn_within(box: Box, tilt: Tilt, u: Float[Array, " n"]) -> Float[Array, " n"]:
    """Standard normal numbers z for which ``center + root z`` is within the intervals.

    A first try is by the uniform numbers, others by what follows from their bits: the
    same of the same numbers. Only the first has derivatives by them.
    """
    if u.shape[0] == 1:  # every weight is the same
        return _in_turn(box, tilt.means, u)[0]
    own, fixed, level = jax.lax.stop_gradient((u, box, tilt))
    words = jax.lax.bitcast_convert_type(own, jnp.uint32).ravel()
    first = jax.random.key(0, impl="threefry2x32")
    key, _ = jax.lax.scan(lambda k, w: (jax.random.fold_in(k, w), None), first, words)

    def again(known: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        number = known[0] + 1
        more = jax.random.uniform(
            jax.random.fold_in(key, number), (u.shape[0] + 1,), u.dtype
        )
        more = inside(more)
        v = jnp.where(number == 0, own, more[1:])
        _, weight = _in_turn(fixed, level.means, v)
        return number, v, jnp.log(more[0]) <= weight - level.most

    number, v, kept = jax.lax.while_loop(
        lambda known: ~known[2] & (known[0] < _MOST),
        again,
        (jnp.int32(-1), own, jnp.zeros((), bool)),
    )
    z, _ = _in_turn(box, tilt.means, jnp.where(number == 0, u, v))
    return jnp.where(kept, z, jnp.nan)


def _in_turn(box: Box, means: Array, u: Array) -> tuple[Array, Array]:
    """Each about its mean, within its interval given those before it.

    Returns:
        Standard normal numbers, and the logarithm of their joint density over that of
        drawing them so.
    """
    normal = Normal(0.0, 1.0)

    def with_next(z: Array, known: tuple[Array, ...]) -> tuple[Array, Array]:
        k, own, row, mean, center, lower, upper = known
        spread = row[k]
        varies = spread > 0.0
        some = jnp.where(varies, spread, 1.0)
        middle = center + row @ z + mean * some  # none yet of itself and those behind
        ends = (lower - middle) / some, (upper - middle) / some
        within = quantile_between(normal, *ends, jnp.log(own), jnp.log1p(-own))
        found = jnp.where(varies, mean + within, 0.0)
        mass = jnp.where(varies, cast(Array, log_mass(normal, *ends)), 0.0)
        return z.at[k].set(found), mass + mean * (0.5 * mean - found)

    each = jnp.arange(u.shape[0]), u, box.root, means, box.center, box.lower, box.upper
    z, weights = jax.lax.scan(with_next, jnp.zeros_like(u), each)
    return z, jnp.sum(weights)
