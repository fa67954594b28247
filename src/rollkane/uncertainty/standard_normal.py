"""Standard normal numbers z of what is drawn: u = Phi(z), and slopes by z.

In these every study looks alike: independent, centred, of deviation one. Gradients have
directions in them, and rare events a distance.
"""

import numpy as np
from jaxtyping import Float
from scipy.special import (  # pyright: ignore[reportMissingTypeStubs]
    ndtr,
    ndtri,
)

from .draws import Draws

# u is a number in (0, 1): z beyond some 8.2 would be at 1
_LEAST, _MOST = np.finfo(float).tiny, 1.0 - 2.0**-53
_HALF_LOG_TAU = 0.5 * np.log(2.0 * np.pi)


def to_uniform(z: Float[np.ndarray, "n d"]) -> Float[np.ndarray, "n d"]:
    """Uniform numbers in (0, 1) [1] of standard normal ones [1]."""
    return np.clip(ndtr(z), _LEAST, _MOST)


def to_normal(u: Float[np.ndarray, "n d"]) -> Float[np.ndarray, "n d"]:
    """Standard normal numbers [1] of uniform ones in (0, 1) [1]."""
    return np.asarray(ndtri(u))


def log_density(z: Float[np.ndarray, "n d"]) -> Float[np.ndarray, " n"]:
    """Logarithm of the standard normal density [1]."""
    return -0.5 * (z * z).sum(axis=-1) - z.shape[-1] * _HALF_LOG_TAU


def slopes_by_normal(
    z: Float[np.ndarray, "n d"], gradients: Float[np.ndarray, "n d"]
) -> Float[np.ndarray, "n d"]:
    """Gradients by z, of those by u = Phi(z) [unit of the output].

    Args:
        z: Standard normal numbers [1].
        gradients: By u [unit of the output].
    """
    return gradients * np.exp(-0.5 * z * z - _HALF_LOG_TAU)


def column_names(draws: Draws) -> tuple[str, ...]:
    """A name for each of the numbers that a member takes, shape (d,)."""
    names: list[str] = []
    for label in draws.labels:
        part = draws.columns(label)
        count = part.stop - part.start
        many = [f"{label} z{i}" for i in range(count)]
        names += many if count > 1 else [label]
    return tuple(names)
