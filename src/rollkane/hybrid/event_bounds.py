"""What can hide inside of a step: bounds on an event's value between its ends.

A value that is positive at both ends of a step may still dip below zero between them.
Here it is bounded from below by the cubic through its values at the ends and beside
them, less the largest deviation that is seen inside; where the bound is negative the
step is cut at its lowest place, and is then looked at again, in halves whose bound is
sixteen times closer. Equations: docs/theory.md, (8.1) to (8.3).
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ..codegen.member_lanes import DipTables

_T = TypeVar("_T", bound=Any)
# Places inside of an interval on which a cubic is looked at: between two of them it
# falls by 1/8 of its curvature over 32^2 at most, a 10^-4 of what it changes by
_GRID = np.arange(1, 32) / 32.0
# Deviations are of order h^4, and so are those of a method's stages: seen ones, twice
_SAFETY = 2.0
# Roundings of the largest value seen that are no dip: the cubic's weights add up to 20
_ROUNDING = 1e3
BESIDE = (1.0 / 16.0, 15.0 / 16.0)  # so near that the cubic has the slopes at the ends
RANGES = 2.0  # a value that stays above so many of its own ranges is not near zero


class Doubt(NamedTuple):
    """Whether an event may hide in a step.

    Attributes:
        hides: Whether.
        share: Of the step, where the bound is lowest [1].
        next: The longest next step that is worth trying [s].
    """

    hides: Bool[Array, ""]
    share: Float[Array, ""]
    next: Float[Array, ""]


def cubic(theta: np.ndarray) -> np.ndarray:
    """Weights of (g0, h g0', g1, h g1') at shares of a step, shape (n, 4)."""
    x = theta
    parts = (2 * x**3 - 3 * x**2 + 1, x**3 - 2 * x**2 + x)
    return np.stack([*parts, 3 * x**2 - 2 * x**3, x**3 - x**2], axis=1)


def largest_defect(
    nodes: Float[Array, " s"], ends: Float[Array, "4 n"], rates: Float[Array, "s n"]
) -> Float[Array, " n"]:
    """By how much the rates of a step's cubic miss those of its method, over the step.

    Args:
        nodes: Shares of the step at which the method knows rates.
        ends: State, rates times the step at its start; both at its end.
        rates: At the nodes, times the step.
    """
    x = nodes
    rise = 6.0 * x * (1.0 - x)
    first, last = (1.0 - x) * (1.0 - 3.0 * x), x * (3.0 * x - 2.0)
    weights = jnp.stack([-rise, first, rise, last], axis=1)
    inner = (_bulge(nodes) > 0.25)[:, None]
    return jnp.max(jnp.where(inner, jnp.abs(weights @ ends - rates), 0.0), axis=0)


def _bulge(theta: _T) -> _T:
    """``16 x^2 (1 - x)^2``: how a cubic's deviation is spread over its interval."""
    return 16.0 * (theta * (1.0 - theta)) ** 2


def stays_positive(
    low: Float[Array, " k"], high: Float[Array, " k"]
) -> Bool[Array, ""]:
    """Whether values between these bounds, seen in a step, are far above zero.

    Args:
        low: The lowest seen.
        high: The highest.
    """
    return jnp.all(low > RANGES * (high - low))


def between(nodes: Float[Array, " s"], seen: Float[Array, "s k"], end: int) -> Doubt:
    """Whether a value may dip below zero between the ends of a step.

    Args:
        nodes: Shares of the step at which it was seen: stages of a method, the first
            at the start, then ``BESIDE`` both ends.
        seen: Values there.
        end: Number of the stage at the end.
    """
    known = jnp.stack([seen[0], seen[-2], seen[-1], seen[end]])
    weight = _bulge(nodes)[:, None]
    inner = weight > 0.25  # nearer to an end a deviation says little
    off = jnp.abs(seen - _through(nodes) @ known) / jnp.where(inner, weight, 1.0)
    spread = _SAFETY * jnp.max(jnp.where(inner, off, 0.0), axis=0)
    theta = jnp.asarray(_GRID, seen.dtype)
    largest = jnp.max(jnp.abs(seen), axis=0)
    slack = _ROUNDING * np.finfo(seen.dtype).eps * largest
    bound = _through(theta) @ known - _bulge(theta)[:, None] * spread[None]
    bound = bound + slack[None]
    # what one value lacks is measured by what it was
    lowest = jnp.min(bound / jnp.where(largest > 0.0, largest, 1.0)[None], axis=1)
    hides = ~jnp.all(bound > 0.0)
    return Doubt(hides, theta[jnp.argmin(lowest)], jnp.full_like(theta[0], jnp.inf))


def rate_at_end(seen: Float[Array, "s k"], end: int) -> Float[Array, " k"]:
    """Rate of a value at the end of a step, times the step, by the same cubic."""
    known = jnp.stack([seen[0], seen[-2], seen[-1], seen[end]])
    one = jnp.ones(1, seen.dtype)
    return jax.jvp(_through, (one,), (one,))[1][0] @ known


def dip_tables(nodes: np.ndarray) -> DipTables:
    """What :func:`between` is made of, for values that are seen at these shares.

    Args:
        nodes: Stages of a method, then ``BESIDE`` both ends.
    """
    rows: Callable[[np.ndarray], np.ndarray]
    rows = lambda x: np.stack(_columns(x), axis=1)
    seen, places = (rows(nodes), _bulge(nodes)), (rows(_GRID), _bulge(_GRID))
    return DipTables(*seen, *places, _SAFETY, _ROUNDING)


def _through(x: Float[Array, " n"]) -> Float[Array, "n 4"]:
    """Weights of values at 0, beside it, beside 1, at 1 in the cubic through them."""
    return jnp.stack(_columns(x), axis=1)


def _columns(x: _T) -> list[_T]:
    """The same by columns."""
    places = (0.0, *BESIDE, 1.0)
    columns: list[_T] = []
    for i, own in enumerate(places):
        others = [p for k, p in enumerate(places) if k != i]
        scale = math.prod(own - p for p in others)
        a, b, c = others
        columns.append((x - a) * (x - b) * (x - c) / scale)
    return columns


def in_flight(
    gaps: Float[Array, " n"],
    rates: Float[Array, " n"],
    apart: Float[Array, ""],
    rounding: Float[Array, ""],
) -> Doubt:
    """Whether a gap may close inside of a step, from values at equal distances.

    Args:
        gaps: Gap at an odd number of places from the start to the end [m].
        rates: Its rates there, times the step [m].
        apart: By how much a gap inside may be wrong, in the middle [m].
        rounding: Of a gap [m]: no dip.

    A gap that only opens since the start of the step is one that the body leaves.
    """
    count = gaps.shape[0] - 1
    rates = rates / count  # for one interval
    theta = jnp.asarray(_GRID, gaps.dtype)
    weights = jnp.asarray(cubic(_GRID), gaps.dtype)
    ends = jnp.stack([gaps[:-1], rates[:-1], gaps[1:], rates[1:]])
    # each second value against the cubic over both of its intervals: 16 times the
    # deviation over one
    middle = 0.5 * (gaps[:-2:2] + gaps[2::2]) + 0.25 * (rates[:-2:2] - rates[2::2])
    off = jnp.repeat(jnp.abs(gaps[1::2] - middle), 2) * (_SAFETY * _SAFETY / 16.0)
    share = (jnp.arange(count, dtype=gaps.dtype)[:, None] + theta[None]) / count
    wrong = off[:, None] * _bulge(theta)[None] + apart * _bulge(share)
    bound = (weights @ ends).T - wrong
    leaves = jnp.cumprod((rates[:-1] >= 0.0) & (rates[1:] > 0.0)).astype(bool)
    known = jnp.max(wrong, axis=1) <= 0.5 * gaps[1:]
    clear = jnp.all(bound > -rounding, axis=1) | (leaves & known)
    worst = jnp.where(clear[:, None], jnp.inf, bound)
    place = jnp.argmin(jnp.where(jnp.isnan(worst), -jnp.inf, worst))
    where = share.reshape(-1)[place]
    return Doubt(~jnp.all(clear), where, jnp.full_like(where, jnp.inf))
