"""The loop of steps of a run in modes: try a step, judge it, change the mode.

A step is accepted when its error is small and no event can hide in it. One that ends
behind an event is shortened until it ends on it, by a bracketing secant; there the mode
changes. The results do not depend on which outputs are asked for.
"""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from ..dynamics.directed_friction import ONSET, SMALLEST_SLIP, begins
from ..dynamics.gap import closing
from ..dynamics.rolling import headings, watches_headings
from ..dynamics.scene import Scene
from ..geometry.small_linear import dot
from ..integration.step_control import Landings, first_step
from ..kinematics.coordinates import pack, unpack
from ..validation.codes import Code
from .event_bounds import Doubt, between, rate_at_end, stays_positive
from .event_location import Bracket
from .flight_bounds import doubt_in_flight
from .mode_replay import Path, Place, Record, turning
from .modes import HybridState, Mode
from .transitions import Motion, Step

# Accepted steps that a derivative can follow: about 0.3 kB each.
RECORDED_STEPS = 2**14
_ROOT = 1e-12  # of the event's value at the step's start
_STAYS = 1e-11  # [s]: so near an event its value falls with each try, or is rounding
_TOGETHER = 1e-9  # of the normal force at the step's start: no friction to speak of
# A slip is regular down to SMALLEST_SLIP; one that is larger where it stands across its
# old direction has turned, not ended
_ENDED_SLIP = 30.0 * SMALLEST_SLIP
# Rate times step: methods of orders 3 and 5 are stable to 2.5 and 3.3 at least
_SETTLES = 2.0
# Cuts of one step, most, each to 0.9 of it or less: what is in doubt still then is no
# more than rounding (an event's value that stays zero)
_CUTS = 24


class Run(NamedTuple):
    """What the loop carries."""

    place: Place
    step: Array
    values: Array  # of the events at t; NaN behind a change, where they may be zero
    searching: Array
    bracket: Bracket
    cuts: Array  # of this step, because an event could hide in it
    landing: Array  # next of the times on which a step must end
    path: Path
    record: Record | None
    accepted: Array
    tried: Array
    code: Array


class _Tried(NamedTuple):
    """A tried step: where it ended, how good it was, and what it saw of the events."""

    t: Array
    end: Step
    size: Array  # of its error, over what is allowed
    lands: Array  # on a time that it must end on
    doubt: Doubt


class _Verdict(NamedTuple):
    """What becomes of a tried step."""

    accept: Array
    event: Array
    kind: Array
    searching: Array
    bracket: Bracket
    step: Array
    cuts: Array
    stuck: Array


class Loop(eqx.Module):
    """The steps of a run in modes.

    Attributes:
        motion: Rates, events and changes.
        times: Output times [s].
        landings: Where steps have to end.
        reach: Of the body, from its origin [m]; None where nothing lands.
        rtol: Relative tolerance of a step [1].
        atol: Absolute tolerance [unit of the state].
        order: That the error estimate counts on.
        allowed: ``allowed(scene, t, state)`` -> whether a step may end there.
    """

    motion: Motion
    times: Array
    landings: Landings
    reach: Array | None
    rtol: Array
    atol: Array
    order: int
    allowed: Callable | None = eqx.field(static=True)

    def tried(self, c: Run) -> _Tried:
        """One step: to the next landing, to where an event may be, or as proposed."""
        at = c.place
        goal = self.landings.ends[c.landing]
        lands = ~c.searching & (goal - at.t <= c.step * (1.0 + 1e-9))
        length = jnp.where(c.searching, c.bracket.trial, c.step)
        t1 = jnp.where(lands, goal, at.t + length)
        end = self.motion.stepped(at.mode, at.direction, at.t, t1, at.y, True)
        size = jnp.sqrt(jnp.mean((end.error / self.tolerated(at.y, end.y)) ** 2))
        doubt = self.looked_at(c, t1, end, size <= 1.0)
        return _Tried(t1, end, size, lands, doubt)

    def tolerated(self, a: HybridState, b: HybridState) -> Array:
        """Error that a step may have [unit of the state].

        Of a slip no more than its share, so that its direction is known until it ends:
        derivatives by it would otherwise miss what friction does across it, last.
        """
        known = unpack(self.atol, a)
        of_slip = jnp.minimum(known.slip, jnp.finfo(known.slip.dtype).eps)
        atol = eqx.tree_at(lambda y: y.slip, known, of_slip)
        size = jax.tree.map(lambda x, y: jnp.maximum(jnp.abs(x), jnp.abs(y)), a, b)
        whole = jnp.full_like(size.slip, jnp.max(size.slip))
        size = eqx.tree_at(lambda y: y.slip, size, whole)
        return pack(atol) + self.rtol * pack(size)

    def looked_at(self, c: Run, t1, end: Step, good) -> Doubt:
        """Whether an event may hide in a step."""
        motion, at = self.motion, c.place
        flies = at.mode == Mode.FLYING
        least = jnp.min(end.values / _scale(c.values))
        quiet = good & (least >= -_ROOT) & (c.cuts < _CUTS)
        last = motion.tableau.nodes.shape[0] - 1
        one = jnp.ones_like(t1)
        clear = Doubt(jnp.asarray(False), one, jnp.inf * one)
        stages = end.seen[: last + 1]
        near = ~stays_positive(jnp.min(stages, axis=0), jnp.max(stages, axis=0))
        doubt = jax.lax.cond(
            quiet & ~flies & near,
            lambda: between(motion.nodes, end.seen, last),
            lambda: clear,
        )
        if not motion.lands:
            return doubt
        nodes, scene = motion.tableau.nodes, motion.scenes.flying
        gap, reach = c.values[0], self.reach
        assert reach is not None
        fly = lambda: doubt_in_flight(scene, nodes, at, t1, end, gap, reach)
        return jax.lax.cond(quiet & flies, fly, lambda: doubt)

    def rate_of(self, at: Place, tried: _Tried, kind) -> Array:
        """About how fast an event's value changes at the end of a step."""
        motion, end = self.motion, tried.end
        last = motion.tableau.nodes.shape[0] - 1
        rate = rate_at_end(end.seen, last)[kind] / (tried.t - at.t)
        if not motion.lands:
            return rate
        opens = closing(motion.scenes.flying, tried.t, end.y.flying())[0]
        return jnp.where(at.mode == Mode.FLYING, opens, rate)

    def judged(self, c: Run, tried: _Tried) -> _Verdict:
        """Whether the step stands, and whether it ends on an event."""
        size, taken = tried.size, tried.t - c.place.t
        # a few numbers of the clock: no shorter step can be made
        tiny = 4.0 * jnp.finfo(self.times.dtype).eps * (1.0 + jnp.abs(c.place.t))
        share = tried.end.values / _scale(c.values)
        least = jnp.min(share)
        stands = self.stands(c.place, tried) & self.follows(c.place, tried.end)
        size = jnp.where(stands, size, jnp.inf)
        known = jnp.isfinite(least)
        # an output right behind an event: too close for anything to happen between
        blinks = tried.lands & (taken <= tiny) & (size <= 1.0)
        negative = ~(least >= 0.0) & ~blinks
        # where the contact ends, so does its grip: what counts is that it ends
        kind = jnp.where(share[1] <= _TOGETHER, 1, jnp.argmin(share))
        # right behind a change the values may be zero: a step that ends on a negative
        # one was too long, unless it stays so: then the mode cannot even begin
        behind = jnp.isnan(c.values[0]) & negative & known
        at_once = behind & (size <= 1.0) & (0.2 * taken <= tiny)
        early = behind & ~at_once
        hides = tried.doubt.hides & ~blinks & known
        good = (size <= 1.0) & (known | blinks) & ~behind & ~hides
        begins = good & negative & ~c.searching
        flies = c.place.mode == Mode.FLYING
        value, rate = tried.end.values[kind], self.rate_of(c.place, tried, kind)
        bracket = c.bracket.after(begins, taken, value, rate, flies)
        closed = bracket.high - bracket.low <= tiny
        off = jnp.abs(bracket.off)
        # no closer: rounding is what is left of the value
        stays = jnp.abs(value) >= jnp.abs(c.bracket.value)
        stays &= off <= _STAYS * (1.0 + jnp.abs(tried.t))
        exact = (jnp.abs(least) <= _ROOT) | (off <= tiny) | closed | stays
        found = c.searching & known & ~hides & exact
        turned = found & self.has_turned(c.place, tried.end, kind)
        event = (found & ~turned) | at_once
        accept = (good & ~negative & ~c.searching) | event | turned
        step = self.next_step(c, tried, size, early | ~known)
        step = jnp.minimum(step, tried.doubt.next * taken)
        step = jnp.where(c.searching | begins, c.step, step)
        # what hides in a step is looked for in a shorter one
        cut = jnp.clip(tried.doubt.share, 0.1, 0.9) * taken
        step = jnp.where(hides, cut, step)
        step = jnp.where(at_once, 1e6 * tiny, step)
        step = jnp.where(tried.lands & accept, jnp.maximum(step, c.step), step)
        settles = self.while_it_turns(c.place, tried.end)
        step = jnp.where(accept & ~event, jnp.minimum(step, settles), step)
        stuck = ~accept & ~hides & jnp.where(c.searching, closed, ~(step > tiny))
        searching = (begins | c.searching) & ~event & ~turned & ~hides
        cuts = jnp.where(accept | ~hides, 0, c.cuts + 1)
        return _Verdict(accept, event, kind, searching, bracket, step, cuts, stuck)

    def next_step(self, c: Run, tried: _Tried, size, early) -> Array:
        """An integral controller with diffrax's margin and lower limit.

        It grows by five at most: behind a change the step before it says little.
        """
        factor = 0.9 * jnp.maximum(size, 1e-10) ** (-1.0 / self.order)
        factor = jnp.clip(factor, 0.2, 5.0)
        factor = jnp.where(jnp.isnan(size) | early, 0.2, factor)
        return (tried.t - c.place.t) * factor

    def has_turned(self, at: Place, end: Step, kind) -> Array:
        """Whether a slip stands across its old direction without having ended."""
        squared = dot(end.y.slip, end.y.slip)
        turned = (squared > _ENDED_SLIP**2) & ~begins(at.direction)
        return self.motion.ends_slip(at.mode, kind) & turned

    def while_it_turns(self, at: Place, end: Step) -> Array:
        """The longest step in which a slip's direction settles, and does not swing.

        Friction turns it at a rate mu N / r, stiff where r is small. A straight slip
        does not show it; what differs from it, its tangents, would grow with each step.
        """
        slip = jnp.sqrt(dot(end.y.slip, end.y.slip)) + SMALLEST_SLIP
        turns = (at.mode == Mode.SLIPPING) & (end.turn > 0.0)
        turns &= (slip > ONSET) | ~begins(at.direction)
        turn = jnp.where(turns, end.turn, 1.0)
        return jnp.where(turns, _SETTLES * slip / turn, jnp.inf)

    def follows(self, at: Place, end: Step) -> Array:
        """Whether a slip that begins is not yet far too fast to be one."""
        fast = dot(end.y.slip, end.y.slip) > (2.0 * ONSET) ** 2
        return (at.mode != Mode.SLIPPING) | ~begins(at.direction) | ~fast

    def stands(self, at: Place, tried: _Tried) -> Array:
        """Whether no normal passed where its contact jumps, nor the body its base."""
        scene, stands = self.motion.scenes.rolling, jnp.asarray(True)
        y = tried.end.y
        if watches_headings(scene):
            ends = headings(scene, at.t, at.y), headings(scene, tried.t, y)
            for a, b in zip(*ends, strict=True):
                stands &= dot(a, b) > 0.0
            stands |= at.mode == Mode.FLYING
        if self.allowed is None:
            return stands
        return stands & as_it_is(self.allowed, scene, tried.t, at.mode, y)

    def step(self, c: Run) -> Run:
        """One turn of the loop."""
        tried = self.tried(c)
        verdict = self.judged(c, tried)
        event, at = verdict.event, c.place
        kind, end, motion = verdict.kind, tried.end, self.motion
        ends = event & motion.ends_slip(at.mode, kind)
        begun = motion.has_begun(at.mode, at.direction, end.y, ends)
        y = jax.lax.cond(
            begun,
            lambda: motion.straightened(end.way, tried.t, end.y, begun),
            lambda: end.y,
        )
        mode, direction, y = jax.lax.cond(
            event,
            lambda: motion.changed(at.mode, kind, at.direction, tried.t, y, event),
            lambda: (at.mode, at.direction, y),
        )
        after = Place(tried.t, y, mode, motion.along(mode, direction, y))
        full = event & (c.path.switches.count >= self.motion.modes.switches)
        lost = event & ~jnp.all(jnp.isfinite(pack(y)))
        accept = verdict.accept & ~full & ~lost
        lands = tried.lands & accept
        # a step ends one number before a jump, even if that is an output
        saves = lands & (jnp.nextafter(tried.t, jnp.inf) >= self.times[c.path.index])
        output = jnp.where(saves, last_at(self.times, c.path.index), 0)
        following = after
        if self.landings.jumps is not None:
            begin = jnp.where(lands, self.landings.starts[c.landing], tried.t)
            following = after._replace(t=begin)
        record = c.record
        if record is not None:
            record = self._recorded(c, tried, verdict, accept, output, following.t)
        keep = lambda a, b: jax.tree.map(lambda x, z: jnp.where(accept, x, z), a, b)
        code = jnp.where(verdict.stuck, Code.STEP_TOO_SMALL, c.code)
        code = jnp.where(full, Code.TOO_MANY_SWITCHES, code)
        code = jnp.where(lost, self.code_of_loss(at.mode), code)
        values = self.values_after(c, end.values, event, after)
        return Run(
            place=keep(following, at),
            step=verdict.step,
            values=keep(values, c.values),
            searching=verdict.searching,
            bracket=verdict.bracket,
            cuts=verdict.cuts,
            landing=jnp.where(lands, self.next_landing(tried.t), c.landing),
            path=c.path.after(output, event & accept, at.mode, *after),
            record=record,
            accepted=c.accepted + jnp.where(accept, 1, 0),
            tried=c.tried + 1,
            code=code,
        )

    def values_after(self, c: Run, values, event, after: Place) -> Array:
        """The events' values where the next step begins: of a slip, along its own way.

        They stay unknown through an output right behind a change.
        """
        slip = dot(after.y.slip, after.direction)
        slides = (after.mode == Mode.SLIPPING) & (slip > 0.0)
        slides &= ~begins(after.direction)
        values = jnp.where(slides, values.at[0].set(slip), values)
        behind = jnp.isnan(c.values[0]) & ~jnp.all(values >= 0.0)
        return jnp.where(event | behind, jnp.nan, values)

    def code_of_loss(self, mode) -> Array:
        """Why there is no state behind an event."""
        code = jnp.asarray(Code.STEP_TOO_SMALL)
        if self.motion.modes.impact != "newton":
            return code
        return jnp.where(mode == Mode.FLYING, Code.INCONSISTENT_IMPACT, code)

    def _recorded(self, c: Run, tried: _Tried, verdict: _Verdict, accept, output, next):
        """The record with a step that was accepted."""
        at, event, kind = c.place, verdict.event & accept, verdict.kind
        assert c.record is not None
        turns = c.record.turns
        turn = jax.lax.cond(
            event,
            lambda: turning(self.motion, at, tried.t, tried.end, kind),
            lambda: jnp.zeros_like(turns[0]),
        )
        row = tried.t, next, jnp.where(event, kind, -1), output
        count = c.path.switches.count
        return c.record.after(c.accepted, accept, at, row, count, event, turn)

    def run(self, mode, y: HybridState, max_steps: int, recording: bool) -> Run:
        """From the start to the last time, or to where it cannot go on."""

        def going(c: Run):
            more = c.path.index < self.times.shape[0]
            return more & (c.code == 0) & (c.tried < max_steps)

        begun = self._begun(mode, y, RECORDED_STEPS if recording else 0)
        if recording:
            max_steps = min(max_steps, RECORDED_STEPS)
        return jax.lax.while_loop(going, lambda c: self.step(c), begun)

    def next_landing(self, t) -> Array:
        """Number of the first landing behind a time."""
        ends = self.landings.ends
        behind = jnp.searchsorted(ends, t, side="right")
        return jnp.minimum(behind, ends.shape[0] - 1).astype(int)

    def _begun(self, mode, y: HybridState, recorded: int) -> Run:
        """The loop's first value."""
        t, whole = self.times[0], jnp.asarray(0)
        mode, direction, y = self.motion.begun(mode, t, y)
        begun, switches = Place(t, y, mode, direction), self.motion.modes.switches
        span = jnp.abs(self.times[-1] - t)
        zero = jnp.zeros_like(t)
        return Run(
            place=begun,
            step=first_step(y.angular_velocity, span),
            values=jnp.full(2, jnp.nan, t.dtype),
            searching=jnp.asarray(False),
            bracket=Bracket(*(zero for _ in Bracket._fields)),
            cuts=whole,
            landing=self.next_landing(t),
            path=Path.empty(begun.moded, self.times, switches),
            record=Record.empty(recorded, begun, switches) if recorded else None,
            accepted=whole,
            tried=whole,
            code=whole,
        )


def _scale(values: Array) -> Array:
    """What the events' values are measured by: what they were, if that is known."""
    return jnp.where(values > 0.0, values, 1.0)


def as_it_is(function: Callable, scene: Scene, t, mode, y: HybridState) -> Array:
    """``function(scene, t, state)`` of the state as it flies, or as it touches."""
    return jax.lax.cond(
        mode == Mode.FLYING,
        lambda: function(scene, t, y.flying()),
        lambda: function(scene, t, y.rolling()),
    )


def last_at(times, index) -> Array:
    """Number of the last output at the time of one."""
    time = times[jnp.minimum(index, times.shape[0] - 1)]
    return jnp.searchsorted(times, time, side="right").astype(int) - 1
