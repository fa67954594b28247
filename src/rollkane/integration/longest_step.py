"""The longest step of a run along which derivatives are taken.

A run's own error tells nothing of its neighbours: a body at rest, or in any steady
motion, is followed in steps of any length, and derivatives along these would be wrong.
So a run that is differentiated takes no step beyond what the linear model at its start
needs, nor beyond a share of its whole length, for what acts on its neighbours alone.
"""

import math
from collections.abc import Callable
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .plans import RECORDED_STEPS, Rates

# Iterations of the power method, of which the last ones are averaged: an even number,
# as sizes alternate where an oscillation goes from places to velocities. A radius that
# is wrong by a tenth is a step that is.
_TURNS, _COUNTED = 24, 16
# A push that lasts a fifth of the run is met by six steps, which leave less than 1e-3
# of it (tests/physics/test_gradients_at_rest.py).
LEAST_STEPS = 32


def longest_step(
    rates: Rates,
    order: int,
    model: Any,
    t: Float[Array, ""],
    y: Float[Array, " n"],
    span: Float[Array, ""],
    rtol: Float[Array, ""],
    ahead: Float[Array, ""],
) -> Float[Array, ""]:
    """Longest step [s].

    The spectral radius r of the linear model is found by the power method. A step of
    length h of an oscillation has an error of ``c (h r)^(p + 1) / (p + 1)!`` of it, by
    the method's stability function, with c = 1 for Bosh3, 0.3 for Dopri5, 0.2 for Tsit5
    and 0.01 for Dopri8; for c = 1 ten tolerances are allowed. The linear
    model is that of the place where a first step leads, as a start may be a pole of its
    surface, and the longest step no shorter than half of a record's steps reach over.

    Args:
        rates: ``rates(t, y, model)``.
        order: p, of the method.
        model: What they depend on.
        t: First time [s].
        y: First state.
        span: Of the run, of either sign [s].
        rtol: Relative tolerance of a step [1].
        ahead: Length of the first step [s], of the sign of the span.
    """
    t, y = t + ahead, y + ahead * rates(t, y, model)

    def turned(
        i: Array, carry: tuple[Float[Array, " n"], Float[Array, ""]]
    ) -> tuple[Float[Array, " n"], Float[Array, ""]]:
        v, total = carry
        own: Callable[[Array], Array] = lambda y: rates(t, y, model)
        _, w = cast("tuple[Array, Array]", jax.jvp(own, (y,), (v,)))
        size = jnp.sqrt(jnp.sum(w * w))
        grows = jnp.log(jnp.maximum(size, np.finfo(y.dtype).tiny))
        total = total + jnp.where(i >= _TURNS - _COUNTED, grows, 0.0)
        return jnp.where(size > 0.0, w / size, v), total

    # any direction that has a part along every other
    first: Array = jnp.cos(1.0 + jnp.arange(y.shape[0], dtype=y.dtype) ** 2)
    begun = first / jnp.sqrt(jnp.sum(first * first)), jnp.zeros((), y.dtype)
    _, total = cast(Any, jax.lax.fori_loop(0, _TURNS, turned, begun))
    radius = jnp.exp(total / _COUNTED)
    share = 10.0 * math.factorial(order + 1) * rtol
    within = share ** (1.0 / (order + 1)) / radius
    within = jnp.where(jnp.isfinite(within), within, jnp.inf)
    whole = jnp.abs(span)
    return jnp.clip(within, whole / (RECORDED_STEPS // 2), whole / LEAST_STEPS)
