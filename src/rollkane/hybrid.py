"""Runs that change between rolling, slipping and flight, as the contact demands.

One loop of steps for all modes: an accepted step after which an event function is
negative is taken back and shortened until it ends on the zero, by a bracketing secant;
there the mode changes. Steps are constants to differentiation; an event's time moves
with its zero, by one Newton step of value zero.
"""

from typing import NamedTuple, cast

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from .coordinates import FlyingState, SlidingState, State, pack
from .modes import (
    SMALLEST_SLIP,
    HybridState,
    Mode,
    ModedState,
    Modes,
    Scenes,
    Switches,
    in_modes,
    of,
    slipping,
)
from .rolling import press_and_pull, rolling_derivative
from .scene import Scene
from .separation import impact, in_flight, nearest
from .small_linear import dot, norm
from .steps import first_step
from .trajectory import Code


class Motion(eqx.Module):
    """Rates, events and changes of a scene in all its modes."""

    scenes: Scenes
    modes: Modes

    def rates(self, mode, direction, t, y: HybridState) -> HybridState:
        """Of everything that the mode moves; zero for the rest."""

        def rolls():
            return of(rolling_derivative(self.scenes.rolling, t, y.rolling()))

        def slips():
            if self.modes.friction is None:
                return jax.tree.map(jnp.zeros_like, y)
            scene = slipping(self.scenes.rolling, self.modes.friction, direction, y)
            return of(rolling_derivative(scene, t, y.sliding()))

        def flies():
            return of(rolling_derivative(self.scenes.flying, t, y.flying()))

        return jax.lax.switch(mode, [rolls, slips, flies])

    def events(self, mode, direction, t, y: HybridState):
        """Two numbers that are positive while the mode lasts, and the state.

        In flight its contact coordinates are brought to the nearest points.
        """
        endless = jnp.ones_like(t)

        def rolls():
            press, pull = press_and_pull(self.scenes.rolling, t, y.rolling())
            grip = endless
            if self.modes.static_friction is not None:
                grip = self.modes.static_friction * press - norm(pull)
            return jnp.stack([grip, press if self.modes.lifts else endless]), y

        def slips():
            if self.modes.friction is None:
                return jnp.stack([endless, endless]), y
            scene = slipping(self.scenes.rolling, self.modes.friction, direction, y)
            press, _ = press_and_pull(scene, t, y.sliding())
            on = dot(y.slip, direction)
            return jnp.stack([on, press if self.modes.lifts else endless]), y

        def flies():
            if self.modes.restitution is None:
                return jnp.stack([endless, endless]), y
            gap, state = nearest(self.scenes.flying, t, y.flying())
            return jnp.stack([gap, endless]), of(state)

        return jax.lax.switch(mode, [rolls, slips, flies])

    def changed(self, mode, kind, direction, t, y: HybridState):
        """Mode, direction and state after an event."""
        rolls, flies = mode == Mode.ROLLING, mode == Mode.FLYING
        pick = lambda c, a, b: jax.tree.map(lambda x, z: jnp.where(c, x, z), a, b)
        still = eqx.tree_at(lambda y: y.slip, y, jnp.zeros_like(y.slip))
        y = pick(rolls, still, y)
        touching, flying, up = still, y, jnp.asarray(False)
        if self.modes.restitution is not None:
            hit, slid, rebound = self._hit(t, y)
            touching, up = pick(flies, slid, still), rebound > 0.0
            flying = hit
        if self.modes.lifts:
            flying = pick(flies, flying, self._lifted(direction, t, y))
        fast = dot(touching.slip, touching.slip)
        slips = fast > 0.0
        stays, way = self.settled(t, touching)
        way = jnp.where(
            slips, touching.slip / jnp.sqrt(jnp.where(slips, fast, 1.0)), way
        )
        stays = jnp.where(slips, Mode.SLIPPING, stays)
        stays = jnp.where(rolls, Mode.SLIPPING, stays)  # what ended was the grip
        leaves = jnp.where(flies, up, kind == 1)
        return (
            jnp.where(leaves, Mode.FLYING, stays),
            jnp.where(leaves, direction, way),
            pick(leaves, flying, touching),
        )

    def _lifted(self, direction, t, y: HybridState) -> HybridState:
        """In flight, as the contact left it."""
        return of(in_flight(y.sliding(), self.scenes.rolling, t))

    def _hit(self, t, y: HybridState):
        """After an impact: in flight, in contact, and the speed of the rebound."""
        mu, e = self.modes.friction, self.modes.restitution
        assert e is not None
        mu = jnp.full_like(t, jnp.inf) if mu is None else mu
        slow = self.modes.rest_speed
        flying, slid, rebound = impact(self.scenes.rolling, t, y.flying(), e, mu, slow)
        return of(flying), of(slid), rebound

    def settled(self, t, y: HybridState):
        """Mode and direction of a contact without slip: it rolls if it is held."""
        press, pull = press_and_pull(self.scenes.rolling, t, y.rolling())
        size = norm(jnp.where(dot(pull, pull) > 0.0, pull, jnp.ones_like(pull)))
        mode = jnp.asarray(Mode.ROLLING)
        if self.modes.static_friction is not None:
            held = dot(pull, pull) <= (self.modes.static_friction * press) ** 2
            mode = jnp.where(held, Mode.ROLLING, Mode.SLIPPING)
        return mode, -pull / size


class _Run(NamedTuple):
    """What the loop carries."""

    t: Array
    y: HybridState
    mode: Array
    direction: Array
    step: Array
    values: Array  # of the events at t; NaN behind a change, where they may be zero
    searching: Array
    low: Array  # a step that ends before the event, and one behind it [s]
    high: Array
    at_low: Array  # the event's value there, over that at t
    at_high: Array
    index: Array
    saved: ModedState
    switches: Switches
    accepted: Array
    tried: Array
    code: Array


class HybridOutcome(NamedTuple):
    """What came out of a run in modes."""

    state: ModedState
    switches: Switches
    code: Array
    final_time: Array
    final_state: ModedState
    steps: Array
    rejected_steps: Array


_fixed = jax.lax.stop_gradient
_ROOT = 1e-12  # of the event's value at the step's start


class _Tried(NamedTuple):
    """A tried step: where it ended, how good it was, and what it saw of the events."""

    t: Array
    y: HybridState
    rates: HybridState
    size: Array  # of its error, over what is allowed
    values: Array
    changes: Array  # rates of the events
    lands: Array  # on an output


class _Verdict(NamedTuple):
    """What becomes of a tried step."""

    accept: Array
    event: Array
    kind: Array
    searching: Array
    bracket: tuple[Array, Array, Array, Array]
    step: Array
    stuck: Array


class _Loop(eqx.Module):
    """The steps of a run in modes."""

    motion: Motion
    times: Array
    rtol: Array
    atol: Array
    solver: dfx.AbstractSolver

    def tried(self, c: _Run) -> _Tried:
        """One step: to the next output, to where an event may be, or as proposed."""
        goal = self.times[c.index]
        lands = ~c.searching & (goal - c.t <= c.step * (1.0 + 1e-9))
        length = jnp.where(c.searching, _trial(c), c.step)
        t1 = jnp.where(lands, goal, _fixed(c.t + length))
        rates = lambda t, y, args: self.motion.rates(c.mode, c.direction, t, y)
        term = dfx.ODETerm(rates)
        memory = self.solver.init(term, c.t, t1, c.y, None)
        stepped = self.solver.step(term, c.t, t1, c.y, None, memory, False)
        y1, error = stepped[0], cast(HybridState, stepped[1])
        e, a, b = _fixed(pack(error)), _fixed(pack(c.y)), _fixed(pack(y1))
        allowed = self.atol + self.rtol * jnp.maximum(jnp.abs(a), jnp.abs(b))
        size = jnp.sqrt(jnp.mean((e / allowed) ** 2))
        f = self.motion.rates(c.mode, c.direction, t1, y1)
        events = lambda t, y: self.motion.events(c.mode, c.direction, t, y)
        (values, y1), (changes, _) = jax.jvp(events, (t1, y1), (jnp.ones_like(t1), f))
        return _Tried(t1, y1, f, size, values, _fixed(changes), lands)

    def judged(self, c: _Run, tried: _Tried) -> _Verdict:
        """Whether the step stands, and whether it ends on an event."""
        size, taken = tried.size, _fixed(tried.t - c.t)
        # a few numbers of the clock: no shorter step can be made
        tiny = 4.0 * jnp.finfo(self.times.dtype).eps * (1.0 + jnp.abs(c.t))
        share = _fixed(tried.values / jnp.where(c.values > 0.0, c.values, 1.0))
        kind, least = jnp.argmin(share), jnp.min(share)
        negative = ~(least >= 0.0)
        # right behind a change nothing can have happened: the step was too long
        early = jnp.isnan(c.values[0]) & negative
        good = (size <= 1.0) & ~early
        begins = good & negative & ~c.searching
        bracket = _bracket(c, begins, taken, least)
        closed = bracket[1] - bracket[0] <= tiny
        event = c.searching & ((jnp.abs(least) <= _ROOT) | closed)
        accept = (good & ~negative & ~c.searching) | event
        order = self.solver.order(dfx.ODETerm(lambda t, y, args: y)) or 1
        # an integral controller with diffrax's margin and lower limit; it grows by five
        # at most, because behind a change the step before it says little
        factor = jnp.clip(0.9 * jnp.maximum(size, 1e-10) ** (-1.0 / order), 0.2, 5.0)
        factor = jnp.where(jnp.isnan(size) | early, 0.2, factor)
        step = jnp.where(c.searching | begins, c.step, _fixed(taken * factor))
        step = jnp.where(tried.lands & accept, jnp.maximum(step, c.step), step)
        stuck = ~accept & ~c.searching & (step <= tiny)
        searching = (begins | c.searching) & ~event
        return _Verdict(accept, event, kind, searching, bracket, step, stuck)

    def step(self, c: _Run) -> _Run:
        """One turn of the loop."""
        tried = self.tried(c)
        verdict = self.judged(c, tried)
        accept, event, kind = verdict.accept, verdict.event, verdict.kind
        # where the event is: one Newton step of value zero, for the derivatives
        shift = -tried.values[kind] / tried.changes[kind]
        close = jnp.abs(_fixed(shift)) <= tried.t - c.t  # not where it only grazes
        shift = jnp.where(event & close, shift, 0.0)
        t = tried.t + shift
        y = jax.tree.map(lambda a, b: a + shift * b, tried.y, tried.rates)
        mode, direction, y = jax.lax.cond(
            event,
            lambda: self.motion.changed(c.mode, kind, c.direction, t, y),
            lambda: (c.mode, c.direction, y),
        )
        fast = dot(y.slip, y.slip)
        # a direction is known where the slip is far above the law's smallest
        along = (mode == Mode.SLIPPING) & (fast > (1e3 * SMALLEST_SLIP) ** 2)
        speed = jnp.sqrt(jnp.where(along, fast, 1.0))
        direction = jnp.where(along, y.slip / speed, direction)
        values = jnp.where(event, jnp.nan, tried.values)
        keep = lambda a, b: jax.tree.map(lambda x, z: jnp.where(accept, x, z), a, b)
        saves = tried.lands & accept
        store = lambda array, x: jnp.where(saves, array.at[c.index].set(x), array)
        full = event & (c.switches.count >= self.motion.modes.switches)
        code = jnp.where(full, Code.TOO_MANY_SWITCHES, c.code)
        return _Run(
            keep(t, c.t),
            keep(y, c.y),
            keep(mode, c.mode),
            keep(direction, c.direction),
            verdict.step,
            keep(values, c.values),
            verdict.searching,
            *verdict.bracket,
            c.index + jnp.where(saves, 1, 0),
            jax.tree.map(store, c.saved, ModedState(y, mode, direction)),
            _logged(c, event, t, mode, y),
            c.accepted + jnp.where(accept, 1, 0),
            c.tried + 1,
            jnp.where(verdict.stuck, Code.STEP_TOO_SMALL, code),
        )


def integrate_modes(
    scene: Scene, start: State, times, rtol, atol, solver, max_steps: int
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
    """
    modes, count = scene.contact, times.shape[0]
    assert isinstance(modes, Modes)
    motion = Motion(in_modes(scene), modes)
    mode = Mode.FLYING if isinstance(start, FlyingState) else Mode.ROLLING
    mode = Mode.SLIPPING if isinstance(start, SlidingState) else mode
    # the only scan of stages that has derivatives in forward mode
    unset = lambda x: x is None
    solver = eqx.tree_at(lambda s: s.scan_kind, solver, "lax", is_leaf=unset)
    loop = _Loop(motion, times, rtol, atol, solver)

    def going(c: _Run):
        return (c.index < count) & (c.code == 0) & (c.tried < max_steps)

    begun = _begun(motion, of(start), mode, times, modes.switches)
    c = jax.lax.while_loop(going, lambda c: loop.step(c), begun)
    ended = c.index >= count
    code = jnp.where((c.code == 0) & ~ended, Code.MAX_STEPS, c.code)
    last = ModedState(c.y, c.mode, c.direction)
    rejected = c.tried - c.accepted
    return HybridOutcome(c.saved, c.switches, code, c.t, last, c.accepted, rejected)


def _trial(c: _Run):
    """Next try for an event: a bracketing secant, with a bisection as its guard."""
    secant = c.low + (c.high - c.low) * c.at_low / (c.at_low - c.at_high)
    inside = (secant > c.low) & (secant < c.high)
    return jnp.where(inside, secant, 0.5 * (c.low + c.high))


def _bracket(c: _Run, begins, taken, least):
    """Steps before and behind an event; a side that stays is halved (Illinois)."""
    hit = c.searching & (least < 0.0)
    miss = c.searching & ~(least < 0.0)
    low = jnp.where(miss, taken, jnp.where(begins, 0.0, c.low))
    high = jnp.where(hit | begins, taken, c.high)
    at_low = jnp.where(miss, least, jnp.where(begins, 1.0, c.at_low))
    at_high = jnp.where(hit | begins, least, c.at_high)
    return (
        low,
        high,
        jnp.where(hit, 0.5 * at_low, at_low),
        jnp.where(miss, 0.5 * at_high, at_high),
    )


def _logged(c: _Run, event, t, mode, y) -> "Switches":
    k = jnp.minimum(c.switches.count, c.switches.time.shape[0] - 1)
    put = lambda array, x: jnp.where(event, array.at[k].set(x), array)
    old = c.switches
    return Switches(
        put(old.time, t),
        put(old.before, c.mode),
        put(old.after, mode),
        jax.tree.map(put, old.state, y),
        old.count + jnp.where(event, 1, 0),
    )


def _begun(motion: Motion, y: HybridState, mode, times, free: int) -> _Run:
    """The loop's first value."""
    t = times[0]
    mode, whole = jnp.asarray(mode), jnp.asarray(0)
    long = dot(y.slip, y.slip)
    direction = y.slip / jnp.sqrt(jnp.where(long > 0.0, long, 1.0))
    settled, way = motion.settled(t, y)
    rests = (mode == Mode.ROLLING) | ((mode == Mode.SLIPPING) & ~(long > 0.0))
    mode = jnp.where(rests, settled, mode)
    direction = jnp.where(rests, way, direction)
    values = jnp.full(2, jnp.nan, times.dtype)
    many = lambda n: jax.tree.map(
        lambda x: jnp.full((n, *x.shape), jnp.nan, x.dtype), y
    )
    begun = ModedState(y, mode, direction)
    count = times.shape[0]
    unset = ModedState(many(count), jnp.full(count, -1), jnp.full((count, 3), jnp.nan))
    saved = jax.tree.map(lambda a, x: a.at[0].set(x), unset, begun)
    none = jnp.full(free, jnp.nan, times.dtype)
    blank = jnp.full(free, -1)
    span = jnp.abs(times[-1] - t)
    step = first_step(_fixed(y.angular_velocity), _fixed(span))
    zero = jnp.zeros_like(t)
    return _Run(
        t, y, mode, direction, step, values,
        jnp.asarray(False), zero, zero, zero, zero, whole + 1, saved,
        Switches(none, blank, blank, many(free), whole), whole, whole, whole,
    )  # fmt: skip
