"""How a run moves with its output times: derivatives that no recorded step has."""

import dataclasses
import functools
from collections.abc import Sequence
from typing import Any, cast

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array, Float

from ..validation.checks import FieldError
from ..validation.codes import Code
from .plans import Rates, Solution
from .step_control import Stops


def in_time(
    solution: Solution,
    rates: Rates,
    times: Float[Array, " T"],
    stops: Stops,
    model: Any,
) -> Solution:
    """The outputs at their stops, and how everything moves with the times."""
    y, final_y, code = solution.y, solution.final_y, solution.code
    if stops.last is not None:
        # a span below the clock's steps is no motion
        instant = stops.last[-1] == 0
        y = jnp.where(instant, y[:1], y[stops.last])
        final_y = jnp.where(instant, y[0], final_y)
        code = jnp.where(instant, Code.COMPLETED, code)

    def moved(y: Array, t: Array) -> Array:
        return cast(Array, moved_in_time(rates, y, t, model, 1.0))

    ended = code == Code.COMPLETED
    # where a run stops of itself does not follow the last time
    return dataclasses.replace(
        solution,
        y=jax.vmap(moved)(y, times),
        final_time=jnp.where(ended, times[-1], solution.final_time),
        final_y=moved(final_y, times[-1]),
        code=code,
    )


@eqx.filter_custom_jvp
def moved_in_time(
    rates: Rates, y: Float[Array, " y"], t: Float[Array, ""], model: Any, sign: float
) -> Float[Array, " y"]:
    """``y``, with the derivative that a change of its time ``t`` brings.

    Output times are not part of the replayed solve; a later output has moved on by
    the rates (sign +1), a later start stands for an earlier state (sign -1).
    """
    del rates, t, model, sign
    return y


@moved_in_time.def_jvp
def _moved_in_time_jvp(
    primals: Sequence[Any], tangents: Sequence[Any]
) -> tuple[Array, Array]:
    rates, y, t, model, sign = primals
    _, y_dot, t_dot, _, _ = tangents
    y_dot = jnp.zeros_like(y) if y_dot is None else y_dot
    if t_dot is not None:
        y_dot = y_dot + sign * rates(t, y, model) * t_dot
    return y, y_dot


@jax.custom_jvp
def not_by_times(x: Array, times: Array) -> Array:
    """A number, of which derivatives by the times are refused."""
    del times
    return x


@functools.partial(not_by_times.defjvp, symbolic_zeros=True)
def _not_by_times_jvp(
    primals: Sequence[Any], tangents: Sequence[Any]
) -> tuple[Array, Array]:
    x_dot, by_times = tangents
    if not isinstance(by_times, SymbolicZero):
        raise FieldError(
            "simulate.saveat",
            "...",
            "cannot be differentiated by the times",
            "leave saveat out: outputs at times are",
        )
    x = primals[0]
    return x, jnp.zeros_like(x) if isinstance(x_dot, SymbolicZero) else x_dot
