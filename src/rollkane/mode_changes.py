"""What the contact does in every mode: rates, events, and what an event changes."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .consistency import spin_stopped
from .coordinates import pack, unpack
from .modes import (
    SMALLEST_SLIP,
    HybridState,
    Mode,
    Modes,
    Scenes,
    of,
    slipping,
)
from .rolling import press_and_pull, rates_and_force, rolling_derivative
from .scene import RubberRolling
from .separation import impact, in_flight, nearest
from .small_linear import dot, matvec
from .tableau import Tableau


class Step(NamedTuple):
    """A step: where it led, and what was seen there.

    Attributes:
        y: State; in flight, with its contact coordinates at the nearest points.
        error: Of the state, an estimate.
        rates: At the end.
        values: Of the events at the end: two numbers, positive while the mode lasts.
    """

    y: HybridState
    error: Float[Array, " n"]
    rates: Float[Array, " n"]
    values: Float[Array, "2"]


class Motion(eqx.Module):
    """Rates, events and changes of a scene in all its modes.

    Attributes:
        scenes: The scene in every mode.
        modes: How it may change.
        tableau: Of an explicit Runge-Kutta method whose last stage is at its end.
    """

    scenes: Scenes
    modes: Modes
    tableau: Tableau

    def stepped(self, mode, direction, t, t1, y: HybridState) -> Step:
        """A step from t to t1.

        One loop over the stages, the last of which is the end: so rates and events of
        all modes stand in the program once.
        """
        start, h = pack(y), t1 - t
        count = self.tableau.nodes.shape[0]

        def stage(carry, row):
            weights, node, last = row
            known, *_ = carry
            at = unpack(start + h * matvec(known.T, weights), y)
            time = jnp.where(last, t1, t + node * h)
            rates, values, seen = self.at(mode, direction, time, at, last)
            known = jnp.roll(known, -1, axis=0).at[-1].set(pack(rates))
            return (known, values, pack(seen)), None

        known = jnp.zeros((count, start.shape[0]), start.dtype)
        carry = known, jnp.ones(2, start.dtype), start
        rows = self.tableau.rows, self.tableau.nodes, jnp.arange(count) == count - 1
        (known, values, end), _ = jax.lax.scan(stage, carry, rows)
        error = h * matvec(known.T, self.tableau.error)
        return Step(unpack(end, y), error, known[-1], values)

    def at(self, mode, direction, t, y: HybridState, look):
        """Rates of what the mode moves, the events' values, and the state.

        In flight, where it is asked to look, the state's contact coordinates are
        brought to the nearest points.
        """
        modes, endless = self.modes, jnp.ones_like(t)

        def rolls():
            rates, press, pull = rates_and_force(self.scenes.rolling, t, y.rolling())
            grip = endless
            if modes.static_friction is not None:
                grip = modes.static_friction * press - _size(pull)
            return of(rates), jnp.stack([grip, press if modes.lifts else endless]), y

        def slips():
            if modes.friction is None:
                return jax.tree.map(jnp.zeros_like, y), jnp.stack([endless] * 2), y
            scene = slipping(self.scenes.rolling, modes.friction, direction, y)
            rates, press, _ = rates_and_force(scene, t, y.sliding())
            on = dot(y.slip, direction)
            return of(rates), jnp.stack([on, press if modes.lifts else endless]), y

        def flies():
            rates = of(rolling_derivative(self.scenes.flying, t, y.flying()))
            if modes.restitution is None:
                return rates, jnp.stack([endless] * 2), y
            nothing = lambda: (endless, y)
            gap, seen = jax.lax.cond(look, lambda: self._gap(t, y), nothing)
            return rates, jnp.stack([gap, endless]), seen

        return jax.lax.switch(mode, [rolls, slips, flies])

    def _gap(self, t, y: HybridState):
        gap, state = nearest(self.scenes.flying, t, y.flying())
        return gap, of(state)

    def slopes(self, mode, direction, t, step: Step):
        """Rates of the events' values and of the state, at the end of a step.

        In flight the nearest points move, too, though nothing integrates them.
        """
        rates = unpack(step.rates, step.y)
        seen = lambda t, y: self.at(mode, direction, t, y, jnp.asarray(True))[1:]
        return jax.jvp(seen, (t, step.y), (jnp.ones_like(t), rates))[1]

    def along(self, mode, direction, y: HybridState):
        """Direction of the slip, where the slip is far above the law's smallest."""
        fast = dot(y.slip, y.slip)
        known = (mode == Mode.SLIPPING) & (fast > (1e3 * SMALLEST_SLIP) ** 2)
        return jnp.where(
            known, y.slip / jnp.sqrt(jnp.where(known, fast, 1.0)), direction
        )

    def begun(self, mode, t, y: HybridState):
        """Mode, direction and state at the start: what is without slip may grip."""
        speed = _size(y.slip)
        direction = y.slip / jnp.where(speed > 0.0, speed, 1.0)
        settled, way, gripped = self.settled(t, y)
        rests = (mode == Mode.ROLLING) | ((mode == Mode.SLIPPING) & ~(speed > 0.0))
        grips = rests & (settled == Mode.ROLLING)
        return (
            jnp.where(rests, settled, mode),
            jnp.where(rests, way, direction),
            _picked(grips, gripped, y),
        )

    def changed(self, mode, kind, direction, t, y: HybridState):
        """Mode, direction and state after an event."""
        rolls, flies = mode == Mode.ROLLING, mode == Mode.FLYING
        still = eqx.tree_at(lambda y: y.slip, y, jnp.zeros_like(y.slip))
        y = _picked(rolls, still, y)
        touching, flying, up = still, y, jnp.asarray(False)
        if self.modes.restitution is not None:
            hit, slid, rebound = self._hit(t, y)
            touching, up = _picked(flies, slid, still), rebound > 0.0
            flying = hit
        if self.modes.lifts:
            flying = _picked(flies, flying, self._lifted(direction, t, y))
        speed = _size(touching.slip)
        slips = speed > 0.0
        stays, way, gripped = self.settled(t, touching)
        way = jnp.where(slips, touching.slip / jnp.where(slips, speed, 1.0), way)
        stays = jnp.where(slips, Mode.SLIPPING, stays)
        stays = jnp.where(rolls, Mode.SLIPPING, stays)  # what ended was the grip
        touching = _picked(stays == Mode.ROLLING, gripped, touching)
        leaves = jnp.where(flies, up, kind == 1)
        return (
            jnp.where(leaves, Mode.FLYING, stays),
            jnp.where(leaves, direction, way),
            _picked(leaves, flying, touching),
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
        """Mode and direction of a contact without slip, and its state if it rolls.

        It rolls if it is held; on rubber an impulse ends its spin about the normal.
        """
        scene = self.scenes.rolling
        if isinstance(scene.contact, RubberRolling):
            held = spin_stopped(scene, t, y.rolling())
            parts = held.angular_velocity, held.alpha_dot
            y = eqx.tree_at(lambda s: (s.angular_velocity, s.alpha_dot), y, parts)
        press, pull = press_and_pull(scene, t, y.rolling())
        mode = jnp.asarray(Mode.ROLLING)
        if self.modes.static_friction is not None:
            held = dot(pull, pull) <= (self.modes.static_friction * press) ** 2
            mode = jnp.where(held, Mode.ROLLING, Mode.SLIPPING)
        return mode, -pull / jnp.where(_size(pull) > 0.0, _size(pull), 1.0), y


def _picked(where, new: HybridState, old: HybridState) -> HybridState:
    return jax.tree.map(lambda a, b: jnp.where(where, a, b), new, old)


def _size(vector: Float[Array, "3"]) -> Float[Array, ""]:
    """Length of a vector that may be zero, where its derivative is taken as zero."""
    squared = dot(vector, vector)
    return jnp.where(
        squared > 0.0, jnp.sqrt(jnp.where(squared > 0.0, squared, 1.0)), 0.0
    )
