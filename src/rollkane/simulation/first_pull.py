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
from ..hybrid.modes import ModedState
from ..validation.checks import FieldError
from .samples import Axis, Samples, over_axes
from .unreached_outputs import of_reached

_Press = Callable[[Scene, Array, Any], Array]


def first_pull_of(samples: Samples, press: _Press) -> Any:
    """When a normal force would first have to pull [s], by motion; NaN: it never does.

    Args:
        samples: Of a motion or of many.
        press: The force [N], of a scene, a time and a state.

    Raises:
        FieldError: states at one time, or of runs with modes.
    """
    if not samples.axes[-1].of_times:
        problem, remedy = "asks for motions", "ask the ensemble itself"
        raise FieldError("first_pull", "ends alone", problem, remedy)
    if isinstance(samples.state, ModedState):
        problem = "asks for motions that go on where the contact would have to pull"
        remedy = "look at the runs' modes, or leave modes out"
        raise FieldError("first_pull", "runs with modes", problem, remedy)
    return samples.as_given(first_pull(press, *samples))


@for_one_call
def first_pull(
    press: _Press, scene: Scene, time: Array, state: Any, axes: tuple[Axis, ...]
) -> Array:
    """When a normal force is first not positive [s]; NaN where it never is.

    Found between outputs on the cubic through values and slopes of the force.

    Args:
        press: The force [N], of a scene, a time and a state.
        scene: What moved.
        time: [s].
        state: States at the times.
        axes: Of them, as of :class:`Samples`; the last is that of the times.
    """

    def of_one(scene: Scene, time: Array, state: Any) -> Array:
        def one(x: tuple[Array, Any]) -> tuple[Array, Array]:
            """The force [N], and its rate along the motion [N/s]."""
            t, state = x
            rates = rolling_derivative(scene, t, state)
            force: Callable[[Array, Any], Array] = lambda t, s: press(scene, t, s)
            return jax.jvp(force, (t, state), (jnp.ones_like(t), rates))

        # one state after the other: mapped over all, it compiles four times as long
        known = of_reached(lambda state: jax.lax.map(one, (time, state)), state)
        return _first_fall(time, *cast(tuple[Array, Array], known))

    axes, count = axes[:-1], state.angular_velocity.ndim - 2
    return over_axes(of_one, scene, axes, count)(scene, jnp.asarray(time), state)


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
