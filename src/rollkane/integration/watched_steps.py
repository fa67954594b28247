"""A step controller that ends steps on events."""

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple, cast

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ..validation.codes import Code, is_stuck
from .controller_interface import (
    AbstractAround,
    Adapted,
    Number,
    RunStart,
    Sense,
    TriedStep,
)
from .event_search import Events, Happened, Search, judged, layout_of
from .plans import Solution
from .step_control import clock_step

# A refused step is shortened to this at least
_SHORTEST = 0.2


class Watched(NamedTuple):
    """What the controller carries.

    Attributes:
        inner: State of the controller that chooses the steps.
        search: What is known of the events.
        happened: What was found; time runs forwards.
        blind: Which event was not a number in the last try; -1: none.
    """

    inner: Any
    search: Search
    happened: Happened
    blind: Int[Array, ""]


class Watching(AbstractAround):
    """Steps of another controller, of which some end on events.

    A step after which an event is not a number is refused: so the run goes as far as
    its events are known.

    Attributes:
        controller: Chooses the steps; it has no least one.
        events: What is looked for.
        dtmin: Least step [s].
        last: Where the run ends [s]; for diffrax it would go on (``past_the_end``).
        values: ``values(events, model, t, y)`` of the packed state, shape (E,).
        sense: Direction of time in which diffrax works.
    """

    controller: Any
    events: Any
    dtmin: Any
    last: Any
    values: Callable[..., Array] = eqx.field(static=True)
    sense: Any = 1.0

    def wrap(self, direction: Sense) -> Any:
        """The controller for the direction of time in which diffrax works."""
        parts = self.controller.wrap(direction), self.last * direction, direction
        return eqx.tree_at(lambda c: (c.controller, c.last, c.sense), self, parts)

    def first_step(self, start: RunStart) -> tuple[Number, Watched]:
        """As the controller, with the events' values at the start."""
        first, inner = self.controller.init(*start)
        t0, y0 = cast(Array, start.t0), start.y0
        values = self.values(self.events, start.args, t0 * self.sense, y0)
        none = Happened.none(layout_of(self.events), y0)
        begun = Search.begun(t0, values)
        return first, Watched(inner, begun, none, jnp.asarray(-1))

    def adapted(self, step: TriedStep) -> Adapted:
        """As the controller, where no event is behind the step; else the next try."""
        inner, search, happened, _ = cast(Watched, step.controller_state)
        t0, t1 = cast("tuple[Array, Array]", (step.t0, step.t1))
        layout = layout_of(self.events)
        end = step.y1_candidate
        values = self.values(self.events, step.args, t1 * self.sense, end)
        lost = jnp.isnan(values)
        unseen = jnp.isnan(search.values)
        blind = jnp.any(lost | unseen)
        error = jnp.where(blind, jnp.asarray(jnp.inf, step.y_error.dtype), step.y_error)
        good, next_t0, next_t1, jump, after, _ = self.controller.adapt_step_size(
            *step._replace(y_error=error, controller_state=inner)
        )
        found = judged(layout, search, t0, t1, values, good & ~blind)
        looks = good & ~found.stands
        keep = good & ~looks
        stops = found.fires & jnp.asarray(layout.stops)
        # nothing is left to try: too short for the clock, or not known from the start
        stuck = ~good & (_SHORTEST * (t1 - t0) < self.dtmin) | jnp.any(unseen)
        result = dfx.RESULTS.where(
            stuck, dfx.RESULTS.dt_min_reached, dfx.RESULTS.successful
        )
        ends = jnp.any(stops) | (keep & (t1 >= self.last))
        result = dfx.RESULTS.where(ends, dfx.RESULTS.event_occurred, result)
        memory = Watched(
            _chosen(looks, inner, after),
            found.search,
            happened.after(layout, found.fires, t1, end),
            jnp.where(blind, jnp.argmax(lost | unseen), -1),
        )
        next_t0 = jnp.where(keep, next_t0, t0)
        # a length from t0 to the end may lead past it, by rounding
        trial = jnp.minimum(t0 + found.trial, self.last)
        next_t1 = jnp.where(looks, trial, next_t1)
        return keep, next_t0, next_t1, jump & keep, memory, result


def past_the_end(times: Float[Array, " T"]) -> Float[Array, ""]:
    """A last time for diffrax behind a watched run's own [s].

    Tries of a step that would end within a hundred roundings of diffrax's last time
    are made half as long as the way to it: an event there would never be reached.

    Args:
        times: Of the outputs [s].
    """
    sense = jnp.where(times[-1] < times[0], -1.0, 1.0).astype(times.dtype)
    return times[-1] + sense * 4.0 * clock_step(times)


def _chosen(flag: Array, new: Any, old: Any) -> Any:
    pick: Callable[[Any, Any], Any] = lambda a, b: jnp.where(flag, a, b)
    return jax.tree.map(pick, new, old)


def with_events(run: Solution, watched: Watched, times: Float[Array, " T"]) -> Solution:
    """A run with the events that its controller found, and why it ended."""
    sense = jnp.where(times[-1] < times[0], -1.0, 1.0).astype(times.dtype)
    found, blind = watched.happened, watched.blind
    # where nothing is left to try, by what was not known in the last try
    lost = is_stuck(run.code) & (blind >= 0)
    by = jnp.where(lost, blind, found.by)
    found = found._replace(time=sense * found.time, by=by)
    code = jnp.where(lost, Code.EVENT_NOT_FINITE, run.code)
    # what ended without an event was told to at its last time
    code = jnp.where((code == Code.STOPPED) & (by < 0), Code.COMPLETED, code)
    return dataclasses.replace(run, happened=found, code=code)


def in_order(
    moments: Float[Array, " R"], times: Float[Array, " T"]
) -> tuple[Float[Array, " R"], Int[Array, " R"]]:
    """Times of events in the order of a run [s], and which of them each event has.

    What did not happen is put at the end.
    """
    sense = jnp.where(times[-1] < times[0], -1.0, 1.0).astype(times.dtype)
    known = sense * jnp.where(jnp.isnan(moments), times[-1], moments)
    order = jnp.argsort(known)
    return sense * known[order], jnp.argsort(order)


def shown_again(
    run: Solution,
    events: Events,
    moments: Float[Array, " R"],
    shown: Float[Array, "R n"],
    times: Float[Array, " T"],
) -> Solution:
    """A run along recorded steps, with the states at its events.

    Args:
        run: Without them.
        events: That were looked for.
        moments: When they happened [s], shape (R,).
        shown: States there, in the order of ``in_order``, shape (R, n).
        times: Of the outputs [s].
    """
    none = Happened.none(layout_of(events), shown[0])
    place = in_order(moments, times)[1]
    return dataclasses.replace(
        run, happened=none._replace(time=moments, y=shown[place])
    )
