"""The way of a run in modes: what it leaves, the steps that it took, and their replay.

The accepted steps are recorded and replayed, with tangents; see ``mode_adjoint`` for
the way back.
"""

from collections.abc import Callable
from typing import NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ..codegen.derivatives import jvp
from ..geometry.small_linear import dot
from ..kinematics.coordinates import pack, unpack
from .mode_rates import Cond, Seen, Step, plain_cond
from .modes import HybridState, ModedState, Switches
from .transitions import Motion

# An array, and what is put into it.
_Stored: TypeAlias = Callable[[Array, Array], Array]


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
        first: _Stored = lambda a, x: a.at[0].set(x)
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
        store: _Stored = lambda array, x: _put(array, output, saves, x)
        saved = jax.tree.map(store, self.saved, ModedState(y, mode, direction))
        old = self.switches
        put: _Stored = lambda array, x: _put(array, old.count, event, x)
        switches = Switches(
            put(old.time, t),
            put(old.before, before),
            put(old.after, mode),
            jax.tree.map(put, old.state, y),
            old.count + jnp.where(event, 1, 0),
        )
        return Path(saved, jnp.where(saves, output + 1, self.reached), switches)


def _put(array: Array, i: Int[Array, ""], where: Bool[Array, ""], x: Array) -> Array:
    """With ``x`` in place i, if it is to be and there is one; nothing is copied."""
    last = array.shape[0] - 1
    at = jnp.minimum(i, last)
    return array.at[at].set(jnp.where(where & (i <= last), x, array[at]))


# Columns of a record's steps.
_END, _BEGIN, KIND, OUTPUT = range(4)


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


# Number of a step, where it begins, and the path until there.
_Replay: TypeAlias = tuple[Array, Place, Path]
# Time, mode, direction of a slip and state behind an event.
_After: TypeAlias = tuple[Array, Array, Array, HybridState]


# A state along the direction of its slip, or as it is.
_Turned: TypeAlias = Callable[[Motion, Array, HybridState, Array, Array], HybridState]


class Record(NamedTuple):
    """Accepted steps.

    Attributes:
        steps: A row for each: where it ended [s], where the next one began [s], which
            event it ended on, or -1, which output it ended on, or 0; NaN where there
            was none, shape (N, 4).
        turns: A row for each event, from :func:`turning`, shape (S, 7 + n).
        kept: Where the run was before each step.
    """

    steps: Float[Array, "N 4"]
    turns: Float[Array, "S m"]
    kept: Place

    @staticmethod
    def empty(steps: int, begun: Place, switches: int) -> "Record":
        """Room for steps and switches."""
        size, dtype = pack(begun.y).shape[0], begun.t.dtype
        many: Callable[[Array], Array] = lambda x: jnp.zeros((steps, *x.shape), x.dtype)
        return Record(
            jnp.full((steps, 4), jnp.nan, dtype),
            jnp.zeros((switches, 7 + size), dtype),
            jax.tree.map(many, begun),
        )

    def after(
        self,
        row: Int[Array, ""],
        accept: Bool[Array, ""],
        begun: Place,
        step: tuple[Array, ...],
        count: Int[Array, ""],
        event: Bool[Array, ""],
        turn: Float[Array, " m"],
    ) -> "Record":
        """With an accepted step, where it began, and what its event recorded."""
        numbers = jnp.stack([x.astype(self.steps.dtype) for x in step])
        keep: _Stored = lambda array, x: _put(array, row, accept, x)
        return Record(
            _put(self.steps, row, accept, numbers),
            _put(self.turns, count, event, turn),
            jax.tree.map(keep, self.kept, begun),
        )

    def step(self, i: Int[Array, ""], number: Int[Array, ""]) -> tuple[Array, Array]:
        """A step, and what was recorded of its event, the one of that number."""
        return self.steps[i], self.turns[number]

    @property
    def length(self) -> Array:
        """How many steps there are."""
        return jnp.sum(~jnp.isnan(self.steps[:, _END]))


def turning(
    motion: Motion, at: Place, t: Float[Array, ""], end: Step, kind: Int[Array, ""]
) -> Array:
    """How an event's time follows what it depends on, then the rates there.

    Its value [s per unit]; of a slip that ends, the slip itself [s per m/s], shape
    (3,), and its last direction [1], shape (3,). With them the time moves by one Newton
    step, of value zero; not where the event only grazes its zero. They are constants to
    a first derivative.

    The rates are those by which the step itself follows its end: as a slip ends its
    direction may turn without end, ever more slowly, and its own rates would not fit
    its tangents.
    """
    mode, direction = at.mode, at.direction

    def ended(t: Float[Array, ""]) -> tuple[Float[Array, "2"], HybridState]:
        step = motion.stepped(mode, direction, at.t, t, at.y)
        return step.values, step.y

    of_values, rates = jvp(ended, (t,), (jnp.ones_like(t),))[1]
    slope = of_values[kind]
    inverse = 1.0 / jnp.where(slope == 0.0, 1.0, slope)
    grazes = (slope == 0.0) | (jnp.abs(end.values[kind] * inverse) > t - at.t)
    slides, a = motion.ends_slip(mode, kind), rates.slip
    squared = dot(a, a)
    squared = jnp.where(squared > 0.0, squared, 1.0)
    none = jnp.zeros_like(direction)
    inverse = jnp.where(grazes | slides, 0.0, inverse)
    way = jnp.where(slides, a / squared, none)
    s = jnp.where(slides, -a / jnp.sqrt(squared), none)
    return jnp.concatenate([inverse[None], way, s, pack(rates)])


def replayed(
    motion: Motion,
    mode: Int[Array, ""],
    y: HybridState,
    times: Float[Array, " T"],
    record: Record,
) -> tuple[Path, Float[Array, ""], ModedState]:
    """A recorded run once more, for its tangents.

    Args:
        motion: Rates and events; differentiable.
        mode: At the first time.
        y: State at the first time; differentiable.
        times: Output times [s]; differentiable.
        record: Of the accepted steps.

    Returns:
        Path, time and state.
    """
    start = begun(motion, mode, y, times)
    path = Path.empty(start.moded, times, motion.modes.switches)

    def one(carry: _Replay) -> _Replay:
        i, place, path = carry
        row, turn = record.step(i, path.switches.count)
        end, shown = _stepped(motion, times, place, row, turn)
        event = row[KIND] >= 0
        path = path.after(row[OUTPUT].astype(int), event, place.mode, *shown)
        return i + 1, end, path

    more: Callable[[_Replay], Array] = lambda carry: carry[0] < record.length
    carry = jnp.asarray(0), start, path
    _, place, path = jax.lax.while_loop(more, one, carry)
    return path, place.t, place.moded


def begun(
    motion: Motion, mode: Int[Array, ""], y: HybridState, times: Float[Array, " T"]
) -> Place:
    """Where a run is at its first time."""
    mode, direction, y = motion.begun(mode, times[0], y)
    return Place(times[0], y, mode, direction)


def landed(times: Float[Array, " T"], row: Float[Array, "4"]) -> Array:
    """When a recorded step ends.

    An output's time moves the end of its step, which may be one number before it.
    """
    end, output = row[_END], row[OUTPUT]
    asked = times[output.astype(int)]
    moved = asked - jax.lax.stop_gradient(asked)
    return jnp.where(output > 0, end + moved, end)


def _stepped(
    motion: Motion,
    times: Float[Array, " T"],
    place: Place,
    row: Float[Array, "4"],
    turn: Float[Array, " m"],
) -> tuple[Place, Place]:
    """Behind one step: where the next one begins, and what this one shows."""
    t, y, mode, direction = place
    ends = landed(times, row)
    _, end, _, last = motion.stages(mode, direction, t, ends, y)
    return behind(motion, place, row, turn, ends, end, last)


def behind(
    motion: Motion,
    place: Place,
    row: Float[Array, "4"],
    turn: Float[Array, " m"],
    t: Float[Array, ""],
    end: Float[Array, " n"],
    last: Seen,
    cond: Cond = plain_cond,
) -> tuple[Place, Place]:
    """The same of a step whose stages are done.

    Args:
        motion: Rates and events.
        place: Where the step began.
        row: Of the record.
        turn: What was recorded of its event.
        t: When it ends [s].
        end: Its state there, as the stages led to it, in one array.
        last: What is seen there.
        cond: As :func:`plain_cond`: branches that take all that they depend on.
    """
    _, y, mode, direction = place
    begin, kind = row[_BEGIN], row[KIND].astype(int)
    event = kind >= 0
    values, y = motion.with_gap(mode, t, unpack(end, y), last.values, cond)
    ends = event & motion.ends_slip(mode, kind)
    fast = motion.has_begun(mode, direction, y, ends)
    s = jnp.where(fast, last.way, turn[4:7])
    straight: _Turned = lambda motion, t, y, s, fast: motion.straightened(s, t, y, fast)
    as_it_is: _Turned = lambda motion, t, y, s, fast: y
    y = cond((motion, t, y, s, fast), fast | ends, straight, as_it_is)

    def passed(
        motion: Motion,
        t: Float[Array, ""],
        y: HybridState,
        values: Float[Array, "2"],
        direction: Float[Array, "3"],
        mode: Int[Array, ""],
        kind: Int[Array, ""],
        turn: Float[Array, " m"],
    ) -> _After:
        inverse, way, rates = turn[0], turn[1:4], turn[7:]
        value, slip = values[kind], y.slip
        shift = -(value - jax.lax.stop_gradient(value)) * inverse
        shift = shift - dot(slip - jax.lax.stop_gradient(slip), way)
        moved = unpack(pack(y) + shift * rates, y)
        t = t + shift
        after, direction, y = motion.changed(mode, kind, direction, t, moved)
        return t, after, direction, y

    def stays(
        motion: Motion,
        t: Float[Array, ""],
        y: HybridState,
        values: Float[Array, "2"],
        direction: Float[Array, "3"],
        mode: Int[Array, ""],
        kind: Int[Array, ""],
        turn: Float[Array, " m"],
    ) -> _After:
        return t, mode, direction, y

    known = motion, t, y, values, direction, mode, kind, turn
    t, mode, direction, y = cond(known, event, passed, stays)
    shown = Place(t, y, mode, motion.along(mode, direction, y))
    return shown._replace(t=jnp.where(begin == row[_END], t, begin)), shown
