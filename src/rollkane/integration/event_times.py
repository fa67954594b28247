"""How events move with what they depend on, by the implicit function theorem.

Along recorded steps a state at an event is one at a fixed time. The event's time moves
by one Newton step, of value zero, and takes the state along.
"""

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeAlias, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array, Float, Int

from ..codegen.event_layout import Layout
from ..codegen.linear_call import Linear, linear_call, shapes_of
from ..kinematics.coordinates import unpack
from ..validation.checks import FieldError
from ..validation.codes import Code
from .event_search import Events, Happened, layout_of
from .plans import Rates, Solution

_Flat: TypeAlias = tuple[list[Any], Any]  # leaves of a tree, and its structure


class Moments(NamedTuple):
    """Outputs and events of a run as one list of times.

    Attributes:
        time: All of them in the order of the run [s], shape (T + R,); infinite where an
            event did not happen.
        outputs: Which of them the outputs are, shape (T,).
        events: Which of them the events are, shape (R,).
    """

    time: Float[Array, " n"]
    outputs: Int[Array, " T"]
    events: Int[Array, " R"]

    @staticmethod
    def of(times: Float[Array, " T"], moments: Float[Array, " R"]) -> "Moments":
        """Of output times and times of events; NaN where none happened [s]."""
        sense = jnp.where(times[-1] < times[0], -1.0, 1.0).astype(times.dtype)
        known = jnp.where(jnp.isnan(moments), jnp.inf, sense * moments)
        both = jnp.concatenate([sense * times, known])
        time = jnp.sort(both)
        # of those at one time the last is shown; at the first time the first
        place = jnp.searchsorted(time, both, side="right") - 1
        place = jnp.where(both == time[0], 0, place)
        count = times.shape[0]
        return Moments(sense * time, place[:count], place[count:])

    def together(self, y: Array, of_events: Array) -> Array:
        """Cotangents of states at all times, of those at outputs and at events."""
        room = jnp.zeros((self.time.shape[0], *y.shape[1:]), y.dtype)
        return room.at[self.outputs].add(y).at[self.events].add(of_events)


def at_their_zeros(
    run: Solution,
    rates: Rates,
    events: Events,
    model: Any,
    like: Any,
    times: Float[Array, " T"],
) -> Solution:
    """A run whose events move with all that they depend on; its end, if one ended it.

    Args:
        run: With its events.
        rates: Of the packed state.
        events: That were looked for; differentiable.
        model: What moves; differentiable.
        like: Shapes of a state.
        times: Of the outputs [s].
    """
    found = run.happened
    assert found is not None
    layout = layout_of(events)
    span = jax.lax.stop_gradient(jnp.abs(times[-1] - times[0]))
    parts: list[tuple[Array, Array]] = []
    for event, first, most in zip(events, layout.firsts, layout.mosts, strict=True):
        own = slice(first, first + most)
        field: Callable[..., Array] = functools.partial(_value, like)

        parts.append(_each_followed(rates, field, found, own, model, event, span))
    time = jnp.concatenate([t for t, _ in parts])
    y = jnp.concatenate([y for _, y in parts])
    ended = run.code == Code.STOPPED
    at = _place_of_end(layout, found.by)
    return dataclasses.replace(
        run,
        happened=found._replace(time=time, y=y),
        final_time=jnp.where(ended, time[at], run.final_time),
        final_y=jnp.where(ended, y[at], run.final_y),
    )


def _each_followed(
    rates: Rates,
    field: Callable[..., Array],
    found: Happened,
    own: slice,
    model: Any,
    event: Any,
    span: Float[Array, ""],
) -> tuple[Array, Array]:
    def moved(t: Array, y: Array) -> tuple[Array, Array]:
        return cast(Any, followed(rates, field, t, y, model, event, span))

    return jax.vmap(moved)(found.time[own], found.y[own])


def _place_of_end(layout: Layout, by: Int[Array, ""]) -> Int[Array, ""]:
    """Where the event that ended a run is kept: it happened once."""
    return jnp.asarray(layout.firsts)[jnp.maximum(by, 0)]


def _value(like: Any, event: Any, model: Any, t: Array, y: Array) -> Array:
    return event(model, t, unpack(y, like))


@eqx.filter_custom_jvp
def followed(
    rates: Rates,
    field: Callable[..., Array],
    t: Float[Array, ""],
    y: Float[Array, " n"],
    model: Any,
    event: Any,
    span: Float[Array, ""],
) -> tuple[Array, Array]:
    """Time and state of an event, with their derivatives, (8.13).

    Args:
        rates: ``rates(t, y, model)``.
        field: ``field(event, model, t, y)`` -> the event's value.
        t: Time [s]; it may move by itself, as an output's does that it is on.
        y: State there, whose derivative is that at this time.
        model: What moves.
        event: What was looked for.
        span: Of the run [s]; NaN where the event has no derivative.
    """
    del rates, field, model, event, span
    return t, y


@followed.def_jvp
def _followed_jvp(primals: Sequence[Any], tangents: Sequence[Any]) -> Any:
    rates, field, t, y, model, event, span = primals
    _, _, *dots, _ = tangents
    t, y = _known_once(t), _known_once(y)
    happened = t == t
    given, tree = cast(_Flat, jax.tree.flatten((t, y, model, event)))
    changes = cast("list[Any]", tree.flatten_up_to(tuple(dots)))
    moves = [i for i, dot in enumerate(changes) if dot is not None]

    def value(moving: Sequence[Array]) -> Array:
        every = list(given)
        for i, x in zip(moves, moving, strict=True):
            every[i] = x
        t, y, model, event = cast("list[Any]", jax.tree.unflatten(tree, every))
        return field(event, model, t, y)

    def at_rates(t: Array, y: Array) -> Array:
        return field(event, model, t, y)

    # unused places have no coefficients: no derivatives, in either mode
    known: Callable[[Array], Array] = lambda x: jnp.where(happened, x, 0.0)
    speed = rates(t, y, model)
    found, slope = jax.jvp(at_rates, (t, y), (jnp.ones_like(t), speed))
    by = cast("list[Array]", jax.grad(value)([given[i] for i in moves]))
    # a value that jumped through zero, or grazes it, has no derivative
    loose = np.sqrt(np.finfo(y.dtype).eps) * span * jnp.abs(slope)
    inverse = known(jnp.where(jnp.abs(found) <= loose, -1.0, jnp.nan) / slope)
    shift = jnp.zeros_like(t)
    for i, coefficients in zip(moves, by, strict=True):
        dot = jnp.asarray(changes[i], coefficients.dtype)  # it may be a Python float
        shift = shift + jnp.sum(_times(known(coefficients), dot))
    shift = _times(inverse, shift)
    given_dots = zip((t, y), dots[:2], strict=True)
    filled = [jnp.zeros_like(x) if dot is None else dot for x, dot in given_dots]
    return (t, y), (filled[0] + shift, filled[1] + known(speed) * shift)


def _times(coefficients: Float[Array, "*n"], dot: Float[Array, "*n"]) -> Array:
    """A linear map, whose transpose makes nothing of a cotangent of zero.

    An event of which nothing is asked so adds nothing backwards, even if it has no
    derivative; one of which something is asked is NaN there, as forwards.
    """
    return linear_call(_PRODUCT, (coefficients,), (dot,), shapes_of((dot,)))[0]


def _product(residuals: Sequence[Array], operands: Sequence[Array]) -> list[Array]:
    return [residuals[0] * operands[0]]


def _product_if_used(
    residuals: Sequence[Array], cotangents: Sequence[Array]
) -> list[Array]:
    c = cotangents[0]
    return [jnp.where(c == 0.0, jnp.zeros_like(c), residuals[0] * c)]


_PRODUCT = Linear(_product, _product_if_used)


@jax.custom_jvp
def _known_once(x: Array) -> Array:
    """A number of which no derivative is differentiated."""
    return x


@functools.partial(_known_once.defjvp, symbolic_zeros=True)
def _known_once_jvp(
    primals: Sequence[Any], tangents: Sequence[Any]
) -> tuple[Array, Array]:
    if not isinstance(tangents[0], SymbolicZero):
        problem = "has no second derivatives"
        remedy = "take differences of first derivatives"
        raise FieldError("simulate.events", "...", problem, remedy)
    return primals[0], jnp.zeros_like(primals[0])
