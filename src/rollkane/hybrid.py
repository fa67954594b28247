"""Runs that change between rolling, slipping and flight, as the contact demands.

One loop of steps for all modes: an accepted step after which an event function is
negative is taken back and shortened until it ends on the zero, by a bracketing secant;
there the mode changes. Derivatives are those of the recorded steps, replayed.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from .checks import FieldError
from .coordinates import FlyingState, SlidingState, State, pack
from .differentiate import differentiable
from .integration import in_order
from .mode_changes import Motion, Step
from .mode_replay import Path, Place, Record, pulled_back, replayed, turning
from .modes import HybridState, Mode, ModedState, Switches, in_modes, of, slipping
from .rolling import LEAST_MARGIN, painleve_margin
from .scene import Scene
from .steps import Landings, first_step, landings
from .tableau import tableau_of
from .trajectory import Code

# Accepted steps that a derivative can follow: about 0.3 kB each.
_RECORDED_STEPS = 2**14
_ROOT = 1e-12  # of the event's value at the step's start
_TOGETHER = 1e-9  # of the normal force at the step's start: no friction to speak of


class _Bracket(NamedTuple):
    """Steps on both sides of an event.

    Attributes:
        low: One that ends before it [s].
        high: One that ends behind it [s].
        at_low: The event's value there, over that at the beginning.
        at_high: The same.
    """

    low: Array
    high: Array
    at_low: Array
    at_high: Array


class _Run(NamedTuple):
    """What the loop carries."""

    place: Place
    step: Array
    values: Array  # of the events at t; NaN behind a change, where they may be zero
    searching: Array
    bracket: _Bracket
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
    bracket: _Bracket
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

    def tried(self, c: _Run) -> _Tried:
        """One step: to the next landing, to where an event may be, or as proposed."""
        at = c.place
        goal = self.landings.ends[c.landing]
        lands = ~c.searching & (goal - at.t <= c.step * (1.0 + 1e-9))
        length = jnp.where(c.searching, _trial(c.bracket), c.step)
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
        bracket = _bracket(c, begins, taken, least)
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
        following = after
        if self.landings.jumps is not None:
            begin = jnp.where(lands, self.landings.starts[c.landing], tried.t)
            following = after._replace(t=begin)
        record = c.record
        if record is not None:
            record = self._recorded(c, tried, verdict, accept, saves, following.t)
        keep = lambda a, b: jax.tree.map(lambda x, z: jnp.where(accept, x, z), a, b)
        code = jnp.where(verdict.stuck, Code.STEP_TOO_SMALL, c.code)
        code = jnp.where(full, Code.TOO_MANY_SWITCHES, code)
        return _Run(
            place=keep(following, at),
            step=verdict.step,
            values=keep(jnp.where(event, jnp.nan, tried.end.values), c.values),
            searching=verdict.searching,
            bracket=verdict.bracket,
            landing=c.landing + jnp.where(lands, 1, 0),
            path=c.path.after(saves, event & accept, at.mode, *after),
            record=record,
            accepted=c.accepted + jnp.where(accept, 1, 0),
            tried=c.tried + 1,
            code=jnp.where(lost, Code.STEP_TOO_SMALL, code),
        )

    def _recorded(self, c: _Run, tried: _Tried, verdict: _Verdict, accept, saves, next):
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
        output = jnp.where(saves, c.path.index, 0)
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

    def _begun(self, mode, y: HybridState, recorded: int) -> _Run:
        """The loop's first value."""
        t, whole = self.times[0], jnp.asarray(0)
        mode, direction = self.motion.begun(mode, t, y)
        begun, switches = Place(t, y, mode, direction), self.motion.modes.switches
        span = jnp.abs(self.times[-1] - t)
        zero = jnp.zeros_like(t)
        return _Run(
            place=begun,
            step=first_step(y.angular_velocity, span),
            values=jnp.full(2, jnp.nan, t.dtype),
            searching=jnp.asarray(False),
            bracket=_Bracket(zero, zero, zero, zero),
            landing=whole,
            path=Path.empty(begun.moded, self.times.shape[0], switches),
            record=Record.empty(recorded, begun, switches) if recorded else None,
            accepted=whole,
            tried=whole,
            code=whole,
        )


def integrate_modes(
    scene: Scene,
    start: State,
    times,
    rtol,
    atol,
    solver: Any,
    max_steps: int,
    corners: Callable,
) -> HybridOutcome:
    """Integrate through all changes of the mode, to the asked times.

    Args:
        scene: With ``Modes`` for its contact.
        start: A state that rolls, slips or flies.
        times: Output times [s], increasing.
        rtol: Relative tolerance of a step [1].
        atol: Absolute tolerance of a step [unit of the state].
        solver: diffrax solver, an explicit Runge-Kutta method.
        max_steps: Most tried steps.
        corners: ``corners(scene)`` -> times at which the rates have a corner [s], or
            None, and whether they may jump there.
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
        scene, *_, rtol, atol = inputs
        order = solver.order(dfx.ODETerm(lambda t, y, args: y))
        loop = _Loop(motion, times, landings(times, *corners(scene)), rtol, atol, order)
        c = loop.run(jnp.asarray(mode), y, max_steps, adjoint is not None)
        ended = c.path.index >= times.shape[0]
        code = jnp.where((c.code == 0) & ~ended, Code.MAX_STEPS, c.code)
        stuck = (code == Code.STEP_TOO_SMALL) & (c.accepted == 0)
        bad = stuck | ~in_order(times) | (times[0] > times[-1])
        code = jnp.where(bad, Code.BAD_START, code)
        code = jnp.where(_stuck_by_friction(motion, code, c.place), Code.PAINLEVE, code)
        t, last, rejected = c.place.t, c.place.moded, c.tried - c.accepted
        return _outcome(c.path, t, last, code, c.accepted, rejected), c.record

    def pull(inputs_of, varied, record, asked, once):
        del once
        make = lambda varied: made(inputs_of(varied))
        asked = (asked.state, None, asked.switches), asked.final_time, asked.final_state
        return pulled_back(make, varied, jnp.asarray(mode), record, asked)

    inputs = scene, of(start), times, rtol, atol
    return differentiable(solve, inputs, pull=pull, twice=_refuse_twice)


def _refuse_twice(*arguments):
    """An event's time has its first derivative only: one Newton step of value zero."""
    del arguments
    problem = "has no second derivatives"
    remedy = "leave modes out, or take differences of first derivatives"
    raise FieldError("simulate.modes", "...", problem, remedy)


def _stuck_by_friction(motion: Motion, code, place: Place) -> Array:
    """Whether a run ended because no normal force fits the friction of its slip."""
    mu = motion.modes.friction
    if mu is None:
        return jnp.asarray(False)
    scene = slipping(motion.scenes.rolling, mu, place.direction, place.y)
    margin = painleve_margin(scene, place.t, place.y.sliding())
    stopped = (code == Code.STEP_TOO_SMALL) | (code == Code.BAD_START)
    slips = place.mode == Mode.SLIPPING
    return stopped & slips & (margin < LEAST_MARGIN)


def _outcome(path: Path, t, last, code, steps, rejected) -> HybridOutcome:
    return HybridOutcome(path.saved, path.switches, code, t, last, steps, rejected)


def _trial(old: _Bracket):
    """Next try for an event: a bracketing secant, with a bisection as its guard."""
    rise = old.at_low / (old.at_low - old.at_high)
    secant = old.low + (old.high - old.low) * rise
    inside = (secant > old.low) & (secant < old.high)
    return jnp.where(inside, secant, 0.5 * (old.low + old.high))


def _bracket(c: _Run, begins, taken, least) -> _Bracket:
    """Steps before and behind an event; a side that stays is halved (Illinois)."""
    hit = c.searching & ~(least >= 0.0)  # what is not known lies behind
    miss = c.searching & (least >= 0.0)
    old = c.bracket
    low = jnp.where(miss, taken, jnp.where(begins, 0.0, old.low))
    high = jnp.where(hit | begins, taken, old.high)
    at_low = jnp.where(miss, least, jnp.where(begins, 1.0, old.at_low))
    at_high = jnp.where(hit | begins, least, old.at_high)
    return _Bracket(
        low,
        high,
        jnp.where(hit, 0.5 * at_low, at_low),
        jnp.where(miss, 0.5 * at_high, at_high),
    )
