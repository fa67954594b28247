"""The way of a run in modes: what it leaves, and the steps that it took.

The accepted steps are recorded; derivatives follow them, forwards by ``mode_tangents``,
back by ``mode_adjoint``.
"""

from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias, TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ..geometry.small_linear import dot
from ..kinematics.coordinates import pack, unpack
from .mode_rates import Cond, Seen, not_zero, picked, plain_cond
from .modes import HybridState, ModedState, Switches
from .transitions import Begun, Motion

_Tree = TypeVar("_Tree")


class Path(NamedTuple):
    """Saved states and switches.

    Attributes:
        saved: At the output times; NaN where not reached.
        reached: How many outputs were.
        switches: Changes of the mode.
    """

    saved: ModedState
    reached: Array
    switches: Switches

    @staticmethod
    def empty(begun: ModedState, times: Array, switches: int) -> "Path":
        """The start, and room for outputs and switches.

        Of outputs at one time only the last is saved; those at the first time are it.
        """
        y, outputs = begun.parts, times.shape[0]

        def many(n: int) -> HybridState:
            rows: Callable[[Array], Array] = lambda x: jnp.full(
                (n, *x.shape), jnp.nan, x.dtype
            )
            return jax.tree.map(rows, y)

        dtype = y.angular_velocity.dtype
        nowhere = jnp.full((outputs, 3), jnp.nan, dtype)
        unset = ModedState(many(outputs), jnp.full(outputs, -1), nowhere)
        first: Callable[[Array, Array], Array] = lambda a, x: a.at[0].set(x)
        saved = jax.tree.map(first, unset, begun)
        none, blank = jnp.full(switches, jnp.nan, dtype), jnp.full(switches, -1)
        return Path(
            saved,
            jnp.searchsorted(times, times[0], side="right").astype(int),
            Switches(none, blank, blank, many(switches), jnp.asarray(0)),
        )

    def after(
        self,
        output: Int[Array, ""],
        event: Bool[Array, ""],
        before: Int[Array, ""],
        t: Float[Array, ""],
        y: HybridState,
        mode: Int[Array, ""],
        direction: Float[Array, "3"],
    ) -> "Path":
        """With a step that ended on an output (0: on none), and on an event or not."""
        saves = output > 0
        now = ModedState(y, mode, direction)
        old = self.switches
        changes = old.time, old.before, old.after, old.state
        put = stored(changes, old.count, event, (t, before, mode, y))
        return Path(
            stored(self.saved, output, saves, now),
            jnp.where(saves, output + 1, self.reached),
            Switches(*put, old.count + jnp.where(event, 1, 0)),
        )


def stored(arrays: _Tree, i: Int[Array, ""], where: Bool[Array, ""], x: Any) -> _Tree:
    """With ``x`` in place i, if it is to be and there is one; nothing is copied.

    Args:
        arrays: A tree of them, equally long.
        i: Which place, from 0.
        where: Whether it is to be.
        x: The same tree, of what belongs in one place.
    """
    last = jax.tree.leaves(arrays)[0].shape[0] - 1
    at, fits = jnp.minimum(i, last), where & (i <= last)
    put: Callable[[Array, Array, Array], Array]
    put = lambda array, x, there: jax.lax.dynamic_update_index_in_dim(
        array, jnp.where(fits, x, there), at, 0
    )
    return jax.tree.map(put, arrays, x, _there(arrays, at))


def _there(arrays: _Tree, i: Int[Array, ""]) -> _Tree:
    """What is in place i of each."""
    # JAX traces this once for all arrays of a shape, and arrays[i] every time
    one: Callable[[Array], Array]
    one = lambda x: jax.lax.dynamic_index_in_dim(x, i, keepdims=False)
    return jax.tree.map(one, arrays)


# [s], about zero: of a shorter step, right behind an output, the length does not say
# whether its event only grazes its zero. The normal force may even jump there, by the
# friction of a slip that begins: 3e-9 N, 3e-11 s of it, have been seen
_NEAR = 1e-6

# Columns of a record's steps.
_END, _BEGIN, KIND, _VALUE, OUTPUT = range(5)


class Place(NamedTuple):
    """Where a run is between two steps."""

    t: Array
    y: HybridState
    mode: Array
    direction: Array

    @property
    def moded(self) -> ModedState:
        """Its state."""
        return ModedState(self.y, self.mode, self.direction)


# At the end of a step: the events' values, its state, and that without what friction
# has ended.
EndOf: TypeAlias = tuple[Float[Array, "2"], HybridState, HybridState]
# A state along the direction of its slip, or as it is.
_Turned: TypeAlias = Callable[[Motion, Array, HybridState, Array, Array], HybridState]
# What an event changes, or nothing.
_Changed: TypeAlias = Callable[[Motion, "_Before", Array], Begun]


class _Before(NamedTuple):
    """What an event changes, as ``Motion.changed`` takes it."""

    mode: Array
    kind: Array
    direction: Array
    t: Array
    y: HybridState


class Record(NamedTuple):
    """Accepted steps; whole numbers are kept as floats, as programs in C leave them.

    Attributes:
        steps: A row for each: where it ended [s], where the next one began [s], which
            event it ended on, or -1, and its value there (infinite: it happened at once
            behind the change before it; negative: a landing that stays), which output
            it ended on, or 0, shape (N, 5).
        changed: States that events changed, each in one array, shape (S, n).
        kept: Where the run was at its start, and behind each step, N + 1 of them.
        counted: How many steps there are, and how many of them ended on an event.
    """

    steps: Float[Array, "N 5"]
    changed: Float[Array, "S n"]
    kept: Place
    counted: Float[Array, "2"]

    @staticmethod
    def empty(steps: int, begun: Place, switches: int) -> "Record":
        """The start, and room for steps and switches."""
        size, dtype = pack(begun.y).shape[0], begun.t.dtype

        def many(x: Array) -> Array:
            return jnp.zeros((steps + 1, *x.shape), dtype).at[0].set(x)

        return Record(
            jnp.zeros((steps, 5), dtype),
            jnp.zeros((switches, size), dtype),
            jax.tree.map(many, begun),
            jnp.zeros(2, dtype),
        )

    def after(
        self,
        accept: Bool[Array, ""],
        step: tuple[Array, ...],
        following: Place,
        event: Bool[Array, ""],
        y: HybridState,
    ) -> "Record":
        """With an accepted step, what follows it, and what its event changed."""
        float_of: Callable[[Array], Array] = lambda x: x.astype(self.steps.dtype)
        following = following._replace(mode=float_of(following.mode))
        return Record(
            stored(self.steps, self.length, accept, jnp.stack([*map(float_of, step)])),
            stored(self.changed, self.events, event, pack(y)),
            stored(self.kept, self.length + 1, accept, following),
            self.counted + float_of(jnp.stack([accept, event])),
        )

    @property
    def length(self) -> Int[Array, ""]:
        """How many steps there are."""
        return self.counted[0].astype(int)

    @property
    def events(self) -> Int[Array, ""]:
        """How many of them ended on an event."""
        return self.counted[1].astype(int)

    def step(self, i: Int[Array, ""], count: Int[Array, ""]) -> "Taken":
        """A step, before which there were so many events."""
        begun, after = _there(self.kept, i), _there(self.kept.y, i + 1)
        begun = begun._replace(mode=begun.mode.astype(int))
        row = _there(self.steps, i)
        changed = unpack(_there(self.changed, count), after)
        return Taken(row, begun, picked(row[KIND] >= 0, changed, after))


class Taken(NamedTuple):
    """A recorded step.

    Attributes:
        row: Of the record.
        begun: Where it began.
        y: State at its end, before an event changes it.
    """

    row: Float[Array, "5"]
    begun: Place
    y: HybridState

    @property
    def kind(self) -> Int[Array, ""]:
        """Which event it ended on; -1: none."""
        return self.row[KIND].astype(int)

    @property
    def number(self) -> Int[Array, ""]:
        """Where its value is among all events'; anywhere, if there was none."""
        return jnp.maximum(self.kind, 0)

    @property
    def output(self) -> Int[Array, ""]:
        """Which output it ended on; 0: none."""
        return self.row[OUTPUT].astype(int)

    @property
    def at_once(self) -> Bool[Array, ""]:
        """Whether its event happened at once behind the change before it."""
        return jnp.isinf(self.row[_VALUE])

    @property
    def rests(self) -> Bool[Array, ""]:
        """Whether it was a landing behind a flight that was rounding."""
        return self.row[_VALUE] == -jnp.inf

    def ends(
        self, times: Float[Array, " T"], since: Float[Array, ""]
    ) -> Float[Array, ""]:
        """When it ends [s].

        An output's time moves the end of its step, which may be one number before it;
        that of a change moves one that follows at once.

        Args:
            times: Of outputs [s].
            since: When the last change was, or the run began [s].
        """
        asked = jnp.where(self.at_once, since, times[self.output])
        moved = asked - jax.lax.stop_gradient(asked)
        follows = self.at_once | (self.output > 0)
        return jnp.where(follows, self.row[_END] + moved, self.row[_END])

    def at_end(
        self,
        motion: Motion,
        direction: Float[Array, "3"],
        t: Float[Array, ""],
        end: Float[Array, " n"],
        last: Seen,
        way: Float[Array, "3"],
        cond: Cond = plain_cond,
    ) -> EndOf:
        """What the end of the step is, before an event changes it.

        Args:
            motion: Rates and events.
            direction: Of the slip, where the step began.
            t: When it ends [s].
            end: The state there, as the stages led to it, in one array.
            last: What is seen there.
            way: Last direction of a slip that ends.
            cond: As :func:`plain_cond`: branches that take all that they depend on.
        """
        mode, like = self.begun.mode, self.begun.y
        values, y = motion.with_gap(mode, t, unpack(end, like), last.values, cond)
        ends = motion.ends_slip(mode, self.kind)
        fast = motion.has_begun(mode, direction, y, ends)
        s = jnp.where(fast, last.way, way)
        straight: _Turned = lambda motion, t, y, s, fast: motion.straightened(
            s, t, y, fast
        )
        as_it_is: _Turned = lambda motion, t, y, s, fast: y
        both = straight, as_it_is
        return values, y, cond((motion, t, y, s, fast), fast | ends, *both)

    def behind(
        self,
        motion: Motion,
        direction: Float[Array, "3"],
        t: Float[Array, ""],
        y: HybridState,
        cond: Cond = plain_cond,
    ) -> tuple[Place, Place]:
        """Where the next step begins, and what this one shows.

        Args:
            motion: Rates and events.
            direction: Of the slip, where the step began.
            t: When it ends [s].
            y: State there, before an event changes it.
            cond: As :func:`plain_cond`: branches that take all that they depend on.
        """
        mode, kind = self.begun.mode, self.kind

        changed: _Changed = lambda motion, before, rests: motion.changed(
            *before, rests=rests
        )
        same: _Changed = lambda _motion, before, _rests: (
            before.mode,
            before.direction,
            before.y,
        )
        known = motion, _Before(mode, kind, direction, t, y), self.rests
        mode, direction, y = cond(known, kind >= 0, changed, same)
        shown = Place(t, y, mode, motion.along(mode, direction, y))
        end, begin = self.row[_END], self.row[_BEGIN]
        return shown._replace(t=jnp.where(begin == end, t, begin)), shown

    def moved(
        self, motion: Motion, slope: Float[Array, ""], slip: Float[Array, "3"]
    ) -> "Moved":
        """How an event's time follows what it depends on: by one Newton step.

        Its value is zero: not where the event only grazes its zero, nor where it has
        none (:meth:`ends`). Constants to a first derivative.

        Args:
            motion: Rates and events.
            slope: By which the event's value follows the step's end [1/s].
            slip: By which the slip does [m/s^2].
        """
        length, slides = self.row[_END] - self.begun.t, self.slides(motion)
        slides &= ~self.at_once
        inverse = 1.0 / not_zero(slope)
        longest = jnp.maximum(length, _NEAR * (1.0 + jnp.abs(self.row[_END])))
        grazes = (slope == 0.0) | (jnp.abs(self.row[_VALUE] * inverse) > longest)
        still = (self.kind < 0) | grazes | self.at_once
        inverse = jnp.where(still | slides, 0.0, inverse)
        squared = not_zero(dot(slip, slip))
        none = jnp.zeros_like(slip)
        return Moved(
            inverse,
            jnp.where(slides, slip / squared, none),
            jnp.where(slides, -slip / jnp.sqrt(squared), none),
        )

    def slides(self, motion: Motion) -> Bool[Array, ""]:
        """Whether its event is the end of a slip."""
        return motion.ends_slip(self.begun.mode, self.kind)


class Moved(NamedTuple):
    """How an event's time moves: against what.

    Attributes:
        value: Of its own value [s per unit].
        slip: Of a slip that ends, itself [s per m/s].
        way: Its last direction [1].
    """

    value: Float[Array, ""]
    slip: Float[Array, "3"]
    way: Float[Array, "3"]


def begun(
    motion: Motion, mode: Int[Array, ""], y: HybridState, times: Float[Array, " T"]
) -> Place:
    """Where a run is at its first time."""
    mode, direction, y = motion.begun(mode, times[0], y)
    return Place(times[0], y, mode, direction)
