"""Runs that change between rolling, slipping and flight, as the contact demands.

One loop of steps for all modes: an accepted step after which an event function is
negative is taken back and shortened until it ends on the zero, by a bracketing secant;
there the mode changes. Derivatives are those of the recorded steps, replayed.
"""

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from .checks import FieldError, cleared
from .clearance import code_of_touch
from .codes import NO_FAULT, Code, first_fault, is_stuck
from .consistency import consistent
from .coordinates import FlyingState, SlidingState, State, pack
from .differentiate import differentiable
from .integration import in_order
from .mode_changes import Motion, Step
from .mode_replay import Path, Place, Record, pulled_back, replayed, turning
from .modes import HybridState, Mode, ModedState, Switches, in_modes, of, slipping
from .rolling import LEAST_MARGIN, headings, painleve_margin, watches_headings
from .rolling_run import at_an_edge, has_edges
from .root_search import Bracket
from .scene import Scene
from .small_linear import dot
from .steps import Landings, Stops, first_step, landings
from .tableau import tableau_of

# Accepted steps that a derivative can follow: about 0.3 kB each.
_RECORDED_STEPS = 2**14
_ROOT = 1e-12  # of the event's value at the step's start
_TOGETHER = 1e-9  # of the normal force at the step's start: no friction to speak of


class _Run(NamedTuple):
    """What the loop carries."""

    place: Place
    step: Array
    values: Array  # of the events at t; NaN behind a change, where they may be zero
    searching: Array
    bracket: Bracket
    landing: Array  # next of the times on which a step must end
    path: Path
    record: Record | None
    accepted: Array
    tried: Array
    code: Array


class HybridOutcome(eqx.Module):
    """What came out of a run in modes."""

    state: ModedState
    switches: Switches
    code: Array
    final_time: Array
    final_state: ModedState
    steps: Array
    rejected_steps: Array
    fault: Array  # number of the field that cannot be used

    @property
    def unknown(self) -> "HybridOutcome":
        """What of it has no derivative: what was not reached, or where it stopped."""
        lost = jax.tree.map(lambda x: x != x, self)
        stopped = self.code != Code.COMPLETED
        where = lambda s: (s.final_time, s.final_state)
        return eqx.tree_at(
            where,
            lost,
            replace_fn=lambda part: jax.tree.map(lambda x: x | stopped, part),
        )


class _Tried(NamedTuple):
    """A tried step: where it ended, how good it was, and what it saw of the events."""

    t: Array
    end: Step
    size: Array  # of its error, over what is allowed
    lands: Array  # on a time that it must end on


class _Verdict(NamedTuple):
    """What becomes of a tried step."""

    accept: Array
    event: Array
    kind: Array
    searching: Array
    bracket: Bracket
    step: Array
    stuck: Array


class _Loop(eqx.Module):
    """The steps of a run in modes."""

    motion: Motion
    times: Array
    landings: Landings
    rtol: Array
    atol: Array
    order: int
    allowed: Callable | None = eqx.field(static=True)

    def tried(self, c: _Run) -> _Tried:
        """One step: to the next landing, to where an event may be, or as proposed."""
        at = c.place
        goal = self.landings.ends[c.landing]
        lands = ~c.searching & (goal - at.t <= c.step * (1.0 + 1e-9))
        length = jnp.where(c.searching, c.bracket.trial, c.step)
        t1 = jnp.where(lands, goal, at.t + length)
        end = self.motion.stepped(at.mode, at.direction, at.t, t1, at.y)
        a, b = pack(at.y), pack(end.y)
        allowed = self.atol + self.rtol * jnp.maximum(jnp.abs(a), jnp.abs(b))
        size = jnp.sqrt(jnp.mean((end.error / allowed) ** 2))
        return _Tried(t1, end, size, lands)

    def judged(self, c: _Run, tried: _Tried) -> _Verdict:
        """Whether the step stands, and whether it ends on an event."""
        size, taken = tried.size, tried.t - c.place.t
        # a few numbers of the clock: no shorter step can be made
        tiny = 4.0 * jnp.finfo(self.times.dtype).eps * (1.0 + jnp.abs(c.place.t))
        share = tried.end.values / jnp.where(c.values > 0.0, c.values, 1.0)
        least = jnp.min(share)
        stands = self.stands(c.place, tried)
        size = jnp.where(stands, size, jnp.inf)
        # where the contact ends, so does its grip: what counts is that it ends
        kind = jnp.where(share[1] <= _TOGETHER, 1, jnp.argmin(share))
        known, negative = jnp.isfinite(least), ~(least >= 0.0)
        # right behind a change the values may be zero: a step that ends on a negative
        # one was too long, unless it stays so: then the mode cannot even begin
        behind = jnp.isnan(c.values[0]) & negative & known
        at_once = behind & (size <= 1.0) & (0.2 * taken <= tiny)
        early = behind & ~at_once
        good = (size <= 1.0) & known & ~behind
        begins = good & negative & ~c.searching
        bracket = c.bracket.after(c.searching, begins, taken, least)
        closed = bracket.high - bracket.low <= tiny
        found = c.searching & known & ((jnp.abs(least) <= _ROOT) | closed)
        event = found | at_once
        accept = (good & ~negative & ~c.searching) | event
        # an integral controller with diffrax's margin and lower limit; it grows by five
        # at most, because behind a change the step before it says little
        factor = 0.9 * jnp.maximum(size, 1e-10) ** (-1.0 / self.order)
        factor = jnp.clip(factor, 0.2, 5.0)
        factor = jnp.where(jnp.isnan(size) | early | ~known, 0.2, factor)
        step = jnp.where(c.searching | begins, c.step, taken * factor)
        step = jnp.where(at_once, 1e6 * tiny, step)
        step = jnp.where(tried.lands & accept, jnp.maximum(step, c.step), step)
        stuck = ~accept & jnp.where(c.searching, closed, ~(step > tiny))
        searching = (begins | c.searching) & ~event
        return _Verdict(accept, event, kind, searching, bracket, step, stuck)

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
        return stands & _at_end(self.allowed, scene, tried.t, at.mode, y)

    def step(self, c: _Run) -> _Run:
        """One turn of the loop."""
        tried = self.tried(c)
        verdict = self.judged(c, tried)
        event, at = verdict.event, c.place
        mode, direction, y = jax.lax.cond(
            event,
            lambda: self.motion.changed(
                at.mode, verdict.kind, at.direction, tried.t, tried.end.y
            ),
            lambda: (at.mode, at.direction, tried.end.y),
        )
        after = Place(tried.t, y, mode, self.motion.along(mode, direction, y))
        full = event & (c.path.switches.count >= self.motion.modes.switches)
        lost = event & ~jnp.all(jnp.isfinite(pack(y)))
        accept = verdict.accept & ~full & ~lost
        lands = tried.lands & accept
        # a step ends one number before a jump, even if that is an output
        saves = lands & (jnp.nextafter(tried.t, jnp.inf) >= self.times[c.path.index])
        output = jnp.where(saves, _last_at(self.times, c.path.index), 0)
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
        return _Run(
            place=keep(following, at),
            step=verdict.step,
            values=keep(jnp.where(event, jnp.nan, tried.end.values), c.values),
            searching=verdict.searching,
            bracket=verdict.bracket,
            landing=jnp.where(lands, self.next_landing(tried.t), c.landing),
            path=c.path.after(output, event & accept, at.mode, *after),
            record=record,
            accepted=c.accepted + jnp.where(accept, 1, 0),
            tried=c.tried + 1,
            code=jnp.where(lost, Code.STEP_TOO_SMALL, code),
        )

    def _recorded(
        self, c: _Run, tried: _Tried, verdict: _Verdict, accept, output, next
    ):
        """The record with a step that was accepted."""
        at, event, kind = c.place, verdict.event & accept, verdict.kind
        assert c.record is not None
        turns = c.record.turns
        turn = jax.lax.cond(
            event,
            lambda: turning(
                self.motion, at.mode, at.direction, at.t, tried.t, tried.end, kind
            ),
            lambda: jnp.zeros_like(turns[0]),
        )
        row = tried.t, next, jnp.where(event, kind, -1), output
        count = c.path.switches.count
        return c.record.after(c.accepted, accept, at, row, count, event, turn)

    def run(self, mode, y: HybridState, max_steps: int, recording: bool) -> _Run:
        """From the start to the last time, or to where it cannot go on."""

        def going(c: _Run):
            more = c.path.index < self.times.shape[0]
            return more & (c.code == 0) & (c.tried < max_steps)

        begun = self._begun(mode, y, _RECORDED_STEPS if recording else 0)
        if recording:
            max_steps = min(max_steps, _RECORDED_STEPS)
        return jax.lax.while_loop(going, lambda c: self.step(c), begun)

    def next_landing(self, t) -> Array:
        """Number of the first landing behind a time."""
        ends = self.landings.ends
        behind = jnp.searchsorted(ends, t, side="right")
        return jnp.minimum(behind, ends.shape[0] - 1).astype(int)

    def _begun(self, mode, y: HybridState, recorded: int) -> _Run:
        """The loop's first value."""
        t, whole = self.times[0], jnp.asarray(0)
        mode, direction, y = self.motion.begun(mode, t, y)
        begun, switches = Place(t, y, mode, direction), self.motion.modes.switches
        span = jnp.abs(self.times[-1] - t)
        zero = jnp.zeros_like(t)
        return _Run(
            place=begun,
            step=first_step(y.angular_velocity, span),
            values=jnp.full(2, jnp.nan, t.dtype),
            searching=jnp.asarray(False),
            bracket=Bracket(zero, zero, zero, zero),
            landing=self.next_landing(t),
            path=Path.empty(begun.moded, self.times, switches),
            record=Record.empty(recorded, begun, switches) if recorded else None,
            accepted=whole,
            tried=whole,
            code=whole,
        )


def integrate_modes(
    scene: Scene,
    start: State,
    times,
    stops: Stops,
    rtol,
    atol,
    solver: Any,
    max_steps: int,
    corners: Callable,
    allowed: Callable | None = None,
) -> HybridOutcome:
    """Integrate through all changes of the mode, to the asked times.

    Args:
        scene: With ``Modes`` for its contact.
        start: A state that rolls, slips or flies.
        times: Output times [s], increasing.
        stops: Where the run stops on them.
        rtol: Relative tolerance of a step [1].
        atol: Absolute tolerance of a step [unit of the state].
        solver: diffrax solver, an explicit Runge-Kutta method.
        max_steps: Most tried steps.
        corners: ``corners(scene)`` -> times at which the rates have a corner [s], or
            None, and whether they may jump there.
        allowed: ``allowed(scene, t, state)`` -> whether a step may end there; None:
            anywhere.
    """
    mode = Mode.FLYING if isinstance(start, FlyingState) else Mode.ROLLING
    mode = Mode.SLIPPING if isinstance(start, SlidingState) else mode

    def made(inputs):
        scene, y, times, *_ = inputs
        tableau = tableau_of(solver, times.dtype)
        return Motion(in_modes(scene), scene.contact, tableau), y, times

    def solve(inputs, replay, adjoint):
        motion, y, times = made(inputs)
        if replay is not None:
            path, t, last = replayed(motion, jnp.asarray(mode), y, times, replay)
            return _outcome(path, t, last, None, None, None), None
        scene, *_, rtol, atol, spoilt = inputs
        order = solver.order(dfx.ODETerm(lambda t, y, args: y))
        where = landings(times, *corners(scene))
        loop = _Loop(motion, times, where, rtol, atol, order, allowed)
        c = loop.run(jnp.asarray(mode), y, max_steps, adjoint is not None)
        return _ended(motion, c, times.shape[0], allowed, spoilt), c.record

    def pull(inputs_of, varied, record, asked, once):
        del once
        make = lambda varied: made(inputs_of(varied))
        asked = (asked.state, None, asked.switches), asked.final_time, asked.final_state
        return pulled_back(make, varied, jnp.asarray(mode), record, asked)

    increasing = in_order(times) & ~(times[0] > times[-1])
    fault, code_of_fault = first_fault(scene, of(start), increasing)
    good = fault == NO_FAULT
    rolling = in_modes(scene).rolling
    start = of(consistent(rolling, jax.lax.stop_gradient(times[0]), start))
    # NaN would keep the step controller going for ever; zero stops it at the start
    start = jax.tree.map(lambda x: cleared(x, good), start)
    spoilt = jnp.where(good, 0.0, jnp.nan).astype(times.dtype)
    inputs = scene, start, stops.time, rtol, atol, spoilt
    found = differentiable(
        solve, inputs, pull=pull, twice=_refuse_twice, unknown=lambda s: s.unknown
    )
    state = found.state
    if stops.last is not None:
        state = jax.tree.map(lambda x: x[stops.last], state)
    code = jnp.where(good, found.code, code_of_fault)
    return dataclasses.replace(found, state=state, code=code, fault=fault)


def _ended(motion: Motion, c: _Run, outputs: int, allowed, spoilt) -> HybridOutcome:
    """What came out of the loop, and why it ended."""
    code = jnp.where((c.code == 0) & (c.path.index < outputs), Code.MAX_STEPS, c.code)
    stuck = (code == Code.STEP_TOO_SMALL) & (c.accepted == 0)
    code = jnp.where(stuck, Code.BAD_START, code)
    code = _explained(motion, allowed, code, c.place)
    t, last, rejected = c.place.t, c.place.moded, c.tried - c.accepted
    found = _outcome(c.path, t, last, code, c.accepted, rejected)
    states = lambda s: (s.state, s.switches.state, s.final_state)
    spoil = lambda x: x + spoilt if eqx.is_inexact_array(x) else x
    return eqx.tree_at(states, found, jax.tree.map(spoil, states(found)))


def _refuse_twice(*arguments):
    """An event's time has its first derivative only: one Newton step of value zero."""
    del arguments
    problem = "has no second derivatives"
    remedy = "leave modes out, or take differences of first derivatives"
    raise FieldError("simulate.modes", "...", problem, remedy)


def _explained(motion: Motion, allowed, code, place: Place) -> Array:
    """The code of a run, where it got stuck by what stopped it."""
    stuck = is_stuck(code)
    scene, mu = motion.scenes.rolling, motion.modes.friction
    touches = place.mode != Mode.FLYING
    if has_edges(scene):
        at_end = at_an_edge(scene, place.t, place.y.rolling())
        code = jnp.where(stuck & touches & at_end, Code.SURFACE_EDGE, code)
    if mu is not None:
        slides = slipping(scene, mu, place.direction, place.y)
        margin = painleve_margin(slides, place.t, place.y.sliding())
        jams = (place.mode == Mode.SLIPPING) & (margin < LEAST_MARGIN)
        code = jnp.where(stuck & jams, Code.PAINLEVE, code)
    if allowed is None:
        return code
    touched = lambda scene, t, y: code_of_touch(code, scene, t, y)
    return _at_end(touched, scene, place.t, place.mode, place.y)


def _at_end(function: Callable, scene: Scene, t, mode, y: HybridState) -> Any:
    """``function(scene, t, state)`` of the state as it flies, or as it touches."""
    return jax.lax.cond(
        mode == Mode.FLYING,
        lambda: function(scene, t, y.flying()),
        lambda: function(scene, t, y.rolling()),
    )


def _last_at(times, index) -> Array:
    """Number of the last output at the time of one."""
    time = times[jnp.minimum(index, times.shape[0] - 1)]
    return jnp.searchsorted(times, time, side="right").astype(int) - 1


def _outcome(path: Path, t, last, code, steps, rejected) -> HybridOutcome:
    none = jnp.asarray(NO_FAULT)
    parts = path.saved, path.switches, code, t, last, steps, rejected, none
    return HybridOutcome(*parts)
