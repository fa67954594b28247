"""Whether a chart covers its surface more than once."""

from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np

from ..codegen.compile_effort import for_one_call
from ..geometry.surfaces import AbstractSurface

_ALONG = 48  # samples along each parameter
# Places that are looked at, as shares of the domain: away from poles and from seams,
# and at no simple fraction, where a surface might happen to cross itself.
_PLACES = ((0.3819, 0.4142), (0.7321, 0.6180), (0.1459, 0.5773))
_AT_ONCE = 256  # places, by one compiled program
_STEPS = 12  # of Newton's method, from a cell away: it doubles digits from about 1
_APART = 1e-3  # of the domain: parameters nearer than that are of one place
# Of the surface's size: roundings of a chart are 1e-16 of it, in single precision 1e-7.
_ONE_POINT = {"float64": 1e-9, "float32": 1e-5}


def covers_again(surface: AbstractSurface) -> bool:
    """Whether generic points of a surface have several parameters of its chart.

    Samples of the chart that are nearer to a point than their own spacing, from other
    parameters, lead there by Newton's method, or do not: the other face of a thin body.

    Args:
        surface: With a chart over a finite domain; its numbers are known.
    """
    low, high = np.array(surface.chart_domain, float).T
    shares = (np.arange(_ALONG) + 0.5) / _ALONG
    grid = np.stack(np.meshgrid(shares, shares, indexing="ij"), -1).reshape(-1, 2)
    x, slopes = _at(surface, low + (high - low) * grid)
    size = float(np.max(np.ptp(x, axis=0)))
    spacing = np.linalg.norm(slopes * ((high - low) / _ALONG), axis=1).sum(axis=1)
    for place in np.array(_PLACES):
        q = low + (high - low) * place
        point = _at(surface, q[None])[0][0]
        near = np.linalg.norm(x - point, axis=1) < spacing
        far = np.abs(grid - place).max(axis=1) > 2.0 / _ALONG
        if not _leads_there(surface, low + (high - low) * grid[near & far], q, size):
            return False
    return True


def _leads_there(
    surface: AbstractSurface, tried: np.ndarray, q: np.ndarray, size: float
) -> bool:
    """Whether other parameters than q, near to some that are tried, have its point."""
    low, high = np.array(surface.chart_domain, float).T
    point = _at(surface, q[None])[0][0]
    for _ in range(_STEPS if len(tried) else 0):
        x, slopes = _at(surface, tried)
        # not by more than a cell: beyond, nothing is known of the chart
        steps = (np.linalg.pinv(slopes) @ (point - x)[:, :, None])[:, :, 0]
        cell = 2.0 * (high - low) / _ALONG
        tried = np.clip(tried + np.clip(steps, -cell, cell), low, high)
    if not len(tried):
        return False
    x, _ = _at(surface, tried)
    close = _ONE_POINT[jnp.result_type(float).name] * size
    there = np.linalg.norm(x - point, axis=1) < close
    apart = (np.abs(tried - q) > _APART * (high - low)).any(axis=1)
    return bool((there & apart).any())


def _at(surface: AbstractSurface, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points and their derivatives, shapes (n, 3) and (n, 3, 2)."""
    lacking = -len(q) % _AT_ONCE
    blocks = np.concatenate([q, np.tile(q[:1], (lacking, 1))]).reshape(-1, _AT_ONCE, 2)
    dtype = jnp.result_type(float)
    found = [_of_block(surface, jnp.asarray(block, dtype)) for block in blocks]
    x, slopes = (np.concatenate(part)[: len(q)] for part in zip(*found, strict=True))
    return np.asarray(x, float), np.asarray(slopes, float)


@for_one_call
def _of_block(surface: AbstractSurface, q: jax.Array) -> tuple[jax.Array, jax.Array]:
    slopes = cast(jax.Array, jax.vmap(cast(Any, jax.jacfwd(surface.chart)))(q))
    return jax.vmap(surface.chart)(q), slopes
