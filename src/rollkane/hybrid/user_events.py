"""Events of the user's own in runs that roll, slip and fly.

A step that stands for the contact is looked at once more: one with an event behind it
is tried again, shorter. A step that ends on events shows its state as on an output: on
one of the places behind those of the outputs, or on the output's that it ends on.
"""

from collections.abc import Callable
from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ..codegen.event_layout import Layout
from ..dynamics.nearest_anywhere import at_nearest
from ..dynamics.observables import normal_force
from ..integration.event_search import (
    Events,
    Happened,
    Search,
    judged,
    layout_of,
    values_of,
)
from ..integration.event_times import followed
from ..kinematics.coordinates import pack, unpack
from .mode_replay import Place
from .modes import Mode, ModedState, slipping
from .transitions import Motion

# Of the largest that was seen: the contact's own events are found four times as closely
_NOTHING = 4e-12


class Watched(NamedTuple):
    """What the loop carries of them.

    Attributes:
        search: What is known of their values.
        trial: Length of the next try, while one is looked for [s].
        changes: Whether the step in which one is looked for ends on a change.
        size: The largest of each that was seen, shape (E,).
        passed: Which were found, and have been no more than rounding since, shape (E,).
        time: Of those that are kept [s], shape (R,).
        row: Where their states are shown, shape (R,).
        number: How often each happened, shape (E,).
        by: Which one ended the run; -1: none.
        shown: How many places behind the outputs are taken.
    """

    search: Search
    trial: Array
    changes: Array
    size: Array
    passed: Array
    time: Array
    row: Array
    number: Array
    by: Array
    shown: Array

    @staticmethod
    def begun(events: Events, motion: Motion, at: Place) -> "Watched":
        """At the start of a run."""
        layout = layout_of(events)
        values = values_in_mode(events, motion, at)
        search = Search.begun(at.t, values)
        none = jnp.full(layout.capacity, jnp.nan, at.t.dtype)
        counts = jnp.zeros(len(layout.ways), int)
        whole = jnp.asarray(0)
        rows = jnp.zeros(layout.capacity, int)
        zero = jnp.zeros_like(at.t)
        still, never = jnp.zeros_like(values), jnp.zeros(values.shape, bool)
        begun = search, zero, jnp.asarray(False), still, never
        begun = Watched(*begun, none, rows, counts, whole - 1, whole)
        return begun._replace(size=begun.size_with(values))

    def ends_on_change(
        self, taken: Float[Array, ""], tiny: Float[Array, ""]
    ) -> Bool[Array, ""]:
        """Whether a try ends where the whole step met a change.

        Args:
            taken: Its length [s].
            tiny: No shorter step can be made [s].
        """
        looks = self.search.active & self.changes
        return looks & (taken >= self.search.whole - tiny)

    def looked(self, look: "Look", changes: Bool[Array, ""]) -> "Watched":
        """With what a tried step has of them.

        Args:
            look: What that is.
            changes: Whether it ends on a change of the contact.
        """
        changes = jnp.where(self.search.active, self.changes, changes)
        size = jnp.where(look.stands, self.size_with(look.values), self.size)
        small = jnp.abs(look.search.values) <= self.least(look.values)
        passed = jnp.where(look.stands, small & (self.passed | look.fires), self.passed)
        parts = {"search": look.search, "trial": look.trial, "passed": passed}
        return self._replace(changes=changes, size=size, **parts)

    def size_with(self, values: Float[Array, " E"]) -> Float[Array, " E"]:
        """The largest of each, with those of one more moment."""
        known = jnp.where(jnp.isfinite(values), jnp.abs(values), 0.0)
        return jnp.maximum(self.size, known)

    def least(self, values: Float[Array, " E"]) -> Float[Array, " E"]:
        """Of each value at such a moment, what is more than rounding."""
        # in single precision a few roundings of what the value is made of
        share = max(_NOTHING, 16.0 * float(np.finfo(values.dtype).eps))
        return share * self.size_with(values)

    @property
    def left(self) -> "Kept":
        """What is left of it at the end."""
        return Kept(self.time, self.row, self.number, self.by)

    def kept(
        self,
        layout: Layout,
        fires: Bool[Array, " E"],
        t: Float[Array, ""],
        output: Int[Array, ""],
        outputs: int,
    ) -> tuple["Watched", Int[Array, ""]]:
        """With events that a step ends on, and the place that shows its state.

        Args:
            layout: Of the events.
            fires: Which they are; none where the step does not stand.
            t: Its end [s].
            output: On which it ends; 0: on none.
            outputs: How many there are.
        """
        fits = fires & (self.number < jnp.asarray(layout.mosts))
        own = jnp.any(fits) & (output == 0)
        row = jnp.where(own, outputs + self.shown, output)
        time, rows, by = self.time, self.row, self.by
        for i, first in enumerate(layout.firsts):
            at = first + jnp.minimum(self.number[i], layout.mosts[i] - 1)
            time = time.at[at].set(jnp.where(fits[i], t, time[at]))
            rows = rows.at[at].set(jnp.where(fits[i], row, rows[at]))
            if layout.stops[i]:
                by = jnp.where(fires[i] & (by < 0), i, by)
        number = self.number + jnp.where(fires, 1, 0)
        shown = self.shown + jnp.where(own, 1, 0)
        parts = {"time": time, "row": rows, "number": number, "by": by, "shown": shown}
        return self._replace(**parts), row


class Kept(NamedTuple):
    """What a run leaves of them.

    Attributes:
        time: As in ``Watched``.
        row: Likewise.
        number: Likewise.
        by: Likewise.
    """

    time: Float[Array, " R"]
    row: Int[Array, " R"]
    number: Int[Array, " E"]
    by: Int[Array, ""]


class Look(NamedTuple):
    """What a step that stands for the contact has of events.

    Attributes:
        stands: Whether it still does.
        again: Whether it is tried again, shorter.
        blind: Whether an event is not a number at its end, or was not at its start.
        fires: Which events it ends on.
        values: At its end.
        search: What is known then.
        trial: Length of the next try [s].
    """

    stands: Array
    again: Array
    blind: Array
    fires: Array
    values: Array
    search: Search
    trial: Array


def looked_at(
    events: Events,
    motion: Motion,
    known: Watched,
    begin: Float[Array, ""],
    end: Place,
    good: Bool[Array, ""],
    changes: Bool[Array, ""],
) -> Look:
    """A tried step, by what the events are at its end.

    Args:
        events: What is looked for.
        motion: Rates in all modes.
        known: What was known before.
        begin: Where the step begins [s].
        end: Where it ends, before anything changes.
        good: Whether it stands for the contact.
        changes: Whether it ends on a change.
    """
    layout = layout_of(events)
    values = values_in_mode(events, motion, end)
    # a value that is no more than rounding has no sign: behind a change, until it is
    # more, nor where a step ends on one, which then is where it reaches zero
    side, least = known.search.side, known.least(values)
    none = (jnp.abs(values) <= least) & ((side == 0.0) | changes)
    values = jnp.where(none, side * least, values)
    unseen = jnp.any(jnp.isnan(known.search.values))
    lost = jnp.any(jnp.isnan(values)) | unseen
    fine = good & ~lost
    found = judged(layout, known.search, begin, end.t, values, fine)
    return Look(
        stands=found.stands,
        again=fine & ~found.stands,
        blind=(good & lost) | unseen,
        fires=found.fires,
        values=values,
        search=found.search,
        trial=found.trial,
    )


def first_lost(look: Look, known: Watched) -> Int[Array, ""]:
    """Which event is not a number."""
    lost = jnp.isnan(look.values) | jnp.isnan(known.search.values)
    count = lost.shape[0]
    return jnp.min(jnp.where(lost, jnp.arange(count), count - 1))


def behind(
    events: Events,
    motion: Motion,
    look: Look,
    known: Watched,
    changed: Bool[Array, ""],
    after: Place,
) -> Look:
    """A step that stands with what its end changed: values that jump there, too.

    A change is found to a share of what it was seen by, so that a value that reaches
    zero with it may not be quite there: it has reached it, if it is that small. Behind
    the change such a value begins at zero.

    Args:
        events: What is looked for.
        motion: Rates in all modes.
        look: What the step has of them.
        known: What was known before it.
        changed: Whether its end changes the mode.
        after: What follows.
    """
    s, layout = look.search, layout_of(events)
    anew = lambda: values_in_mode(events, motion, after)
    values = cast(Array, jax.lax.cond(changed, anew, lambda: s.values))
    ways = jnp.asarray(layout.ways, values.dtype)
    least = known.least(look.values)
    small = changed & (jnp.abs(values) <= least)
    values = jnp.where(small, 0.0, values)
    # found on the way here, and no more than rounding since
    once = small & known.passed & (jnp.abs(look.values) <= least)
    side = jnp.where(once, 0.0, s.side)
    jumps = changed & (side != 0.0) & (jnp.sign(values) != side) & (ways != side)
    jumps = jumps & (look.values != 0.0)  # from zero: it was there before
    fires = look.fires | jumps
    search = s._replace(
        values=values,
        side=jnp.where(changed, jnp.sign(values), s.side),
        zero=jnp.where(fires, after.t, s.zero),
    )
    return look._replace(fires=fires, search=search)


def values_in_mode(events: Events, motion: Motion, at: Place) -> Float[Array, " E"]:
    """Values of all events, of the scene and the state of the mode."""
    scenes, mu = motion.scenes, motion.modes.friction
    t, y, mode, direction = at

    def slips() -> Array:
        if mu is None:
            return jnp.full(len(events), jnp.nan, t.dtype)
        scene = slipping(scenes.rolling, mu, direction, y)
        return values_of(events, scene, t, y.sliding())

    def flies() -> Array:
        scene = scenes.flying
        values: Callable[[Any], Array] = lambda y: values_of(events, scene, t, y)
        return at_nearest(scene, t, y.flying(), values)

    by_mode = {
        Mode.ROLLING: lambda: values_of(events, scenes.rolling, t, y.rolling()),
        Mode.SLIPPING: slips,
        Mode.FLYING: flies,
    }
    branches = [by_mode[mode] for mode in Mode]
    return cast(Array, jax.lax.switch(mode, branches))


def at_their_zeros(
    events: Events,
    make: Callable[[Any], Motion],
    scene: Any,
    happened: Happened,
    spans: Float[Array, " R"],
) -> Happened:
    """Events that move with all that they depend on, (8.13).

    Args:
        events: That were looked for; differentiable.
        make: ``make(scene)`` -> rates in all modes.
        scene: Differentiable.
        happened: What was found; ``y`` has states.
        spans: Of the run [s]; NaN where an event has no derivative.
    """
    layout = layout_of(events)
    like = happened.y.parts

    def rates(t: Array, y: Array, model: Any) -> Array:
        scene, mode, direction = model
        state = unpack(y, one)
        return pack(make(scene).at(mode, direction, t, state)[0])

    def value(event: Any, model: Any, t: Array, y: Array) -> Array:
        scene, mode, direction = model
        at = Place(t, unpack(y, one), mode, direction)
        return values_in_mode((event,), make(scene), at)[0]

    size: Callable[[Array], Any] = lambda x: jax.ShapeDtypeStruct(x.shape[1:], x.dtype)
    one = jax.tree.map(size, like)

    def moved(
        event: Any, t: Array, state: ModedState, span: Array
    ) -> tuple[Array, Array]:
        mode = jnp.maximum(state.mode, 0)
        model = scene, mode, jax.lax.stop_gradient(state.direction)
        y = pack(state.parts)
        return cast(Any, followed(rates, value, t, y, model, event, span))

    found: list[tuple[Array, Array]] = []
    for event, first, most in zip(events, layout.firsts, layout.mosts, strict=True):
        part: Callable[[Array], Array] = lambda x, a=first, b=most: x[a : a + b]
        each = jax.vmap(moved, in_axes=(None, 0, 0, 0))
        at = part(happened.time), jax.tree.map(part, happened.y), part(spans)
        found.append(each(event, *at))
    time = jnp.concatenate([t for t, _ in found])
    parts = unpack(jnp.concatenate([y for _, y in found]), one)
    return happened._replace(
        time=time, y=ModedState(parts, happened.y.mode, happened.y.direction)
    )


def of_normal_force(events: Events) -> np.ndarray:
    """Places of the events of the normal force itself, shape (R,)."""
    alike = [getattr(e, "function", None) is normal_force for e in events]
    return np.repeat(alike, layout_of(events).mosts)


def with_places(times: Float[Array, " T"], count: int) -> Float[Array, " n"]:
    """Output times [s], and behind them constants for the states at events."""
    last = jax.lax.stop_gradient(times[-1:])
    return jnp.concatenate([times, jnp.broadcast_to(last, count)])
