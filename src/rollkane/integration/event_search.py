"""Search for steps that end on events: by inverse interpolation within a bracket.

A step that would stand, and behind which an event has changed its sign, is taken back
and tried again, shorter, until it ends on the first of the zeros. The loop in C does
the same (``codegen/event_search.c``), step by step.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Protocol, TypeAlias

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ..codegen.event_layout import CLOSE, FLAT, HALVES_FROM, START, TRIES, Layout

_Put: TypeAlias = Callable[[Array, Array], Array]


class AnyEvent(Protocol):
    """What is looked for: ``event(scene, t, state)`` -> a number."""

    @property
    def direction(self) -> int:
        """1: where it rises, -1: where it falls, 0: both."""
        ...

    @property
    def stop(self) -> bool:
        """Whether the run ends there."""
        ...

    @property
    def most(self) -> int:
        """How often it is kept."""
        ...

    def __call__(self, scene: Any, t: Array, state: Any) -> Array:
        """Its value."""
        ...


Events: TypeAlias = Sequence[AnyEvent]


def layout_of(events: Events) -> Layout:
    """Directions, ends and places of some events."""
    parts = zip(*((e.direction, e.stop, e.most) for e in events), strict=True)
    return Layout(*map(tuple, parts))


def values_of(events: Events, model: Any, t: Array, state: Any) -> Float[Array, " e"]:
    """Values of all events at one moment."""
    return jnp.stack([event(model, t, state) for event in events])


class Happened(NamedTuple):
    """Events that were found; unused places are NaN.

    Attributes:
        time: [s], shape (R,): those of each event in order, one event behind the other.
        y: Packed states, shape (R, n), or states with a leading R.
        number: How often each was found, shape (E,).
        by: Which one ended the run; -1: none.
    """

    time: Float[Array, " R"]
    y: Any
    number: Int[Array, " E"]
    by: Int[Array, ""]

    @staticmethod
    def none(layout: Layout, y: Float[Array, " n"]) -> "Happened":
        """Room for events."""
        return Happened(
            jnp.full(layout.capacity, jnp.nan, y.dtype),
            jnp.full((layout.capacity, *y.shape), jnp.nan, y.dtype),
            jnp.zeros(len(layout.mosts), int),
            jnp.asarray(-1),
        )

    def after(
        self,
        layout: Layout,
        fires: Bool[Array, " E"],
        t: Float[Array, ""],
        y: Float[Array, " n"],
    ) -> "Happened":
        """With events that a step ends on."""
        first, mosts = jnp.asarray(layout.firsts), jnp.asarray(layout.mosts)
        kept = fires & (self.number < mosts)
        # what is not kept goes behind the last place, which drops it
        place = jnp.where(kept, first + self.number, layout.capacity)
        put: _Put = lambda array, x: array.at[place].set(x, mode="drop")
        ends = fires & jnp.asarray(layout.stops)
        by = jnp.where(jnp.any(ends), jnp.argmax(ends), self.by)
        number = self.number + fires.astype(self.number.dtype)
        return Happened(put(self.time, t), put(self.y, y[None]), number, by)


class Search(NamedTuple):
    """What is known of the events between two tries of a step.

    Attributes:
        side: Sign that each value had last, shape (E,); 0: none yet.
        zero: Time of its last zero, or of the start [s], shape (E,).
        values: Where the step begins, shape (E,).
        active: Whether a zero is looked for in this step.
        low: A length of the step with no event behind it [s].
        high: One with some [s].
        due: Which those are, shape (E,).
        lengths: Tried last, the newest first; the step's begin, 0, is the oldest [s],
            shape (K,).
        seen: Values at their ends, shape (K, E).
        mean: Rates of the values over the whole step, shape (E,).
        whole: Length with which the search began [s].
        tries: How many there were.
    """

    side: Float[Array, " E"]
    zero: Float[Array, " E"]
    values: Float[Array, " E"]
    active: Bool[Array, ""]
    low: Float[Array, ""]
    high: Float[Array, ""]
    due: Bool[Array, " E"]
    lengths: Float[Array, " K"]
    seen: Float[Array, "K E"]
    mean: Float[Array, " E"]
    whole: Float[Array, ""]
    tries: Int[Array, ""]

    @staticmethod
    def begun(t: Float[Array, ""], values: Float[Array, " E"]) -> "Search":
        """At the start of a run, or behind a jump of the state."""
        zero = jnp.zeros_like(t)
        return Search(
            side=jnp.sign(values),
            zero=jnp.broadcast_to(t, values.shape),
            values=values,
            active=jnp.asarray(False),
            low=zero,
            high=zero,
            due=jnp.zeros(values.shape, bool),
            lengths=jnp.zeros(TRIES, zero.dtype),
            seen=jnp.broadcast_to(values, (TRIES, *values.shape)),
            mean=values,
            whole=zero,
            tries=jnp.asarray(0),
        )


class Found(NamedTuple):
    """What becomes of a tried step.

    Attributes:
        stands: Whether it may.
        fires: Which events it ends on, shape (E,); none where it does not stand.
        trial: Length of the next try, where it does not stand [s].
        search: What is known then.
    """

    stands: Bool[Array, ""]
    fires: Bool[Array, " E"]
    trial: Float[Array, ""]
    search: Search


def judged(
    layout: Layout,
    s: Search,
    t0: Float[Array, ""],
    t1: Float[Array, ""],
    values: Float[Array, " E"],
    good: Bool[Array, ""],
) -> Found:
    """Whether a tried step stands, and on which events it ends.

    Args:
        layout: Of the events.
        s: What was known before.
        t0: Where the step begins; time runs forwards [s].
        t1: Where it ends [s].
        values: Of the events there.
        good: Whether the step would stand without events.
    """
    x = t1 - t0
    begins = ~s.active
    low, high = jnp.where(begins, 0.0, s.low), jnp.where(begins, x, s.high)
    last = jnp.where(begins, 0.0, s.lengths[0])
    seen = jnp.where(begins, s.values, s.seen[0])
    whole, tries = jnp.where(begins, x, s.whole), jnp.where(begins, 0, s.tries)
    ways = jnp.asarray(layout.ways, values.dtype)
    # a value that reaches zero has crossed it, and may stay there. A search for where
    # it left zero again goes back through zeros to the start of the step: no event
    rests = (s.values == 0.0) & (values == 0.0) & ~(s.active & s.due)
    crossed = (s.side != 0.0) & (jnp.sign(values) != s.side) & (ways != s.side) & ~rests
    hits = jnp.any(crossed)
    due = jnp.where(begins | hits, crossed, s.due)
    low, high = jnp.where(hits, low, x), jnp.where(hits, x, high)
    tiny = CLOSE * np.finfo(values.dtype).eps * (jnp.abs(t0) + whole)
    apart, rise = x - last, values - seen
    mean = jnp.where(begins, jnp.abs(rise) / x, s.mean)
    flat = (rise == 0.0) | (apart == 0.0) | ~jnp.isfinite(rise)
    off = values * apart / jnp.where(flat, 1.0, rise)
    known = ~flat & (jnp.abs(rise) >= FLAT * mean * jnp.abs(apart))
    # a value that is zero may have been so before
    near = known & (jnp.abs(off) <= tiny) & (values != 0.0)
    closed = high - low <= tiny
    # a closed bracket's end behind the zero is tried again, once: it may be rounded
    again = ~begins & (s.high - s.low <= tiny)
    shut = closed & (hits | again)
    before = jnp.any(near & due) & ~closed
    done = shut | jnp.where(hits, jnp.all(near | ~crossed), before)
    fires = (hits & crossed) | (due & (near | shut))
    searching = hits | s.active
    # a zero right behind the one before, or the start, is that one
    zero = jnp.where(s.values == 0.0, t0, s.zero)
    own = t1 - zero <= jnp.maximum(START * np.finfo(x.dtype).eps * whole, 4.0 * tiny)
    found = good & searching & done
    counted = fires & ~own & found
    stands = good & (~searching | done)
    side = jnp.where(values == 0.0, s.side, jnp.sign(values))
    side = jnp.where(stands, side, s.side)
    side = jnp.where(found & fires, -s.side, side)
    active = good & searching & ~done
    following = Search(
        side=side,
        zero=jnp.where(counted, t1, s.zero),
        values=jnp.where(stands, values, s.values),
        active=active,
        low=low,
        high=high,
        due=due,
        lengths=jnp.stack([x, last, *s.lengths[1:-1]]),
        seen=jnp.stack([values, seen, *s.seen[1:-1]]),
        mean=mean,
        whole=whole,
        tries=tries + 1,
    )
    # it jumped between two steps: its zero is where this one begins
    jumped = begins & (s.values * s.side <= 0.0)
    return Found(stands, counted, _next(following, jumped, flat, tiny), following)


def _next(
    s: Search, jumped: Bool[Array, " E"], flat: Bool[Array, " E"], tiny: Array
) -> Float[Array, ""]:
    """Length of the next try: where the first of the events has its zero."""
    low, high = s.low, s.high
    middle = 0.5 * (low + high)
    root = _zeros(s)
    inside = ~flat & (root >= low) & (root <= high)
    root = jnp.where(jumped, 0.0, jnp.where(inside, root, middle))
    trial = jnp.min(jnp.where(s.due, root, high))
    wide = high - low > 2.0 * tiny
    trial = jnp.where(wide, jnp.clip(trial, low + tiny, high - tiny), middle)
    halves = (s.tries > HALVES_FROM) & (s.tries % 2 == 0)
    trial = jnp.where(halves, middle, trial)
    return jnp.where(high - low <= tiny, high, trial)  # the step ends behind the zero


def _zeros(s: Search) -> Float[Array, " E"]:
    """Lengths at which the values are zero.

    Of each, the polynomial of the length in terms of the value through the last tries
    (Neville), of the order to which its corrections halve.
    """
    through: list[Array] = []
    found = jnp.broadcast_to(s.lengths[0], s.due.shape)
    change = jnp.full_like(found, jnp.inf)
    goes = jnp.ones_like(s.due)
    for m in range(TRIES):
        through.append(jnp.broadcast_to(s.lengths[m], s.due.shape))
        for j in reversed(range(m)):
            apart = s.seen[m] - s.seen[j]
            goes = goes & (apart != 0.0)
            step = s.seen[j] * (through[j + 1] - through[j])
            through[j] = through[j] - step / jnp.where(apart == 0.0, 1.0, apart)
        if m > 0:
            moved = jnp.abs(through[0] - found)
            goes = goes & (moved < 0.5 * change) & (m <= s.tries)
            change = jnp.where(goes, moved, change)
            found = jnp.where(goes, through[0], found)
    return found
