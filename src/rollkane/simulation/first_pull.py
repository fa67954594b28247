"""When a contact would first have to pull."""

import functools
from collections.abc import Callable
from typing import Any, cast

import jax
import jax.numpy as jnp
from jaxtyping import Array

from ..codegen.compile_effort import for_one_call
from ..dynamics.rolling import rolling_derivative
from ..dynamics.scene import Scene
from .unreached_outputs import of_reached

_Press = Callable[[Scene, Array, Any], Array]


@for_one_call
def first_pull(press: _Press, time: Array, scene: Scene, state: Any) -> Array:
    """When a normal force is first not positive [s]; NaN where it never is.

    Found between outputs on the cubic through values and slopes of the force.

    Args:
        press: The force [N], of a scene, a time and a state.
        time: [s], shape (T,); a batch in front is allowed, of everything.
        scene: What moved.
        state: States at the times.
    """
    if time.ndim > 1:
        own = functools.partial(first_pull, press)
        return jax.vmap(own)(time, scene, state)

    def one(x: tuple[Array, Any]) -> tuple[Array, Array]:
        """The force [N], and its rate along the motion [N/s]."""
        t, state = x
        rates = rolling_derivative(scene, t, state)
        force: Callable[[Array, Any], Array] = lambda t, s: press(scene, t, s)
        return jax.jvp(force, (t, state), (jnp.ones_like(t), rates))

    # one state after the other: mapped over all, it takes four times as long to compile
    known = of_reached(lambda state: jax.lax.map(one, (time, state)), state)
    return _first_fall(time, *cast(tuple[Array, Array], known))


def _first_fall(time: Array, values: Array, slopes: Array) -> Array:
    """First time at which a sampled function with slopes is not positive; else NaN."""
    grid = jnp.linspace(0.0, 1.0, 17, dtype=time.dtype)

    def cubic(i: Array, x: Array) -> Array:
        span = time[i + 1] - time[i]
        v0, v1 = values[i], values[i + 1]
        d0, d1 = slopes[i] * span, slopes[i + 1] * span
        bend = (3.0 * (v1 - v0) - 2.0 * d0 - d1) + (d0 + d1 - 2.0 * (v1 - v0)) * x
        return v0 + x * (d0 + x * bend)

    intervals = jnp.arange(time.shape[0] - 1)

    def looked_at(i: Array) -> Array:
        at: Callable[[Array], Array] = lambda x: cubic(i, x)
        return jax.vmap(at)(grid)

    inside = jax.vmap(looked_at)(intervals)
    fallen = (inside <= 0).reshape(-1)
    first = jnp.argmax(fallen)
    i, k = first // 17, first % 17
    low, high = grid[jnp.maximum(k - 1, 0)], grid[k]

    def halve(_: Array, bounds: tuple[Array, Array]) -> tuple[Array, Array]:
        low, high = bounds
        mid = 0.5 * (low + high)
        below = cubic(i, mid) <= 0
        return jnp.where(below, low, mid), jnp.where(below, mid, high)

    _, x = cast(tuple[Array, Array], jax.lax.fori_loop(0, 60, halve, (low, high)))
    # it moves as one step of Newton's says, which is of value zero; where it never was
    # positive, not at all
    value, slope = jax.jvp(functools.partial(cubic, i), (x,), (jnp.ones_like(x),))
    falls = (first > 0) & (slope != 0.0)
    slope = jax.lax.stop_gradient(jnp.where(falls, slope, 1.0))
    x = x - jnp.where(falls, value - jax.lax.stop_gradient(value), 0.0) / slope
    found = time[i] + x * (time[i + 1] - time[i])
    return jnp.where(jnp.any(fallen), found, jnp.nan)
