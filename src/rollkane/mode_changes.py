"""What the contact does in every mode: rates, events, and what an event changes."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .consistency import spin_stopped
from .contact_laws import impulse_response
from .coordinates import pack, unpack
from .hidden_events import BESIDE, cubic, stays_positive
from .impacts import Rebound, impact
from .mass_matrix import assemble
from .modes import (
    SMALLEST_SLIP,
    HybridState,
    Mode,
    Modes,
    Scenes,
    last_way,
    of,
    slipping,
)
from .rolling import (
    contact_of,
    press_and_pull,
    rates_and_force,
    rolling_derivative,
)
from .scene import RubberRolling
from .separation import in_flight, nearest_anywhere
from .small_linear import cross, dot, matvec, matvec_transposed
from .tableau import Tableau


class Step(NamedTuple):
    """A step: where it led, and what was seen on the way.

    Attributes:
        y: State; in flight, with its contact coordinates at the nearest points.
        error: Of the state, an estimate.
        rates: Of the state at every stage, the last at the end.
        values: Of the events at the end: two numbers, positive while the mode lasts.
        seen: Of the events at ``Motion.nodes``; in flight they are not looked at.
    """

    y: HybridState
    error: Float[Array, " n"]
    rates: Float[Array, "s n"]
    values: Float[Array, "2"]
    seen: Float[Array, "m 2"]


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

    @property
    def nodes(self) -> Float[Array, " m"]:
        """Shares of a step at which events are seen: the stages, and beside both ends.

        The latter on the cubic through states and rates at the ends.
        """
        nodes = self.tableau.nodes
        return jnp.concatenate([nodes, jnp.asarray(BESIDE, nodes.dtype)])

    def stepped(self, mode, direction, t, t1, y: HybridState, watched=False) -> Step:
        """A step from t to t1.

        One loop over the stages, the last of which is the end, and over the places
        beside both ends where events may be near, if the step is watched: so rates and
        events of all modes stand in the program once.
        """
        start, h = pack(y), t1 - t
        tableau = self.tableau
        count = tableau.nodes.shape[0]
        weights = jnp.concatenate([tableau.rows, _beside_ends(tableau)])
        nodes = self.nodes

        def look(carry):
            number, known, end, seen = carry
            at = start + h * matvec(known.T, weights[number])
            time = jnp.where(number == count - 1, t1, t + nodes[number] * h)
            rates, values = self.at(mode, direction, time, unpack(at, y))
            pushed = jnp.roll(known, -1, axis=0).at[-1].set(pack(rates))
            is_stage = number < count
            known = jnp.where(is_stage, pushed, known)
            end = jnp.where(is_stage, at, end)
            return number + 1, known, end, seen.at[number].set(values)

        known = jnp.zeros((count, start.shape[0]), start.dtype)
        unseen = jnp.zeros((nodes.shape[0], 2), start.dtype)
        carry = jnp.asarray(0), known, start, unseen
        if watched:

            def going(carry):
                number, *_, seen = carry
                stages = seen[:count]
                far = stays_positive(jnp.min(stages, axis=0), jnp.max(stages, axis=0))
                return (number < count) | ((number < nodes.shape[0]) & ~far)

            _, known, end, seen = jax.lax.while_loop(going, look, carry)
        else:
            step = lambda carry, _: (look(carry), None)
            (_, known, end, seen), _ = jax.lax.scan(step, carry, length=count)
        error = h * matvec(known.T, tableau.error)
        end = unpack(end, y)
        values, end = self.with_gap(mode, t1, end, seen[count - 1])
        return Step(end, error, known, values, seen)

    def at(self, mode, direction, t, y: HybridState):
        """Rates of what the mode moves, and the events' values but for the gap."""
        modes, endless = self.modes, jnp.ones_like(t)

        def rolls():
            rates, press, pull = rates_and_force(self.scenes.rolling, t, y.rolling())
            grip = endless
            if modes.static_friction is not None:
                grip = self._grip(press, pull)
            return of(rates), jnp.stack([grip, press if modes.lifts else endless])

        def slips():
            if modes.friction is None:
                return jax.tree.map(jnp.zeros_like, y), jnp.stack([endless] * 2)
            scene = slipping(self.scenes.rolling, modes.friction, direction, y)
            rates, press, _ = rates_and_force(scene, t, y.sliding())
            # without friction nothing ends a slip
            on = jnp.where(modes.friction > 0.0, dot(y.slip, direction), endless)
            return of(rates), jnp.stack([on, press if modes.lifts else endless])

        def flies():
            rates = of(rolling_derivative(self.scenes.flying, t, y.flying()))
            return rates, jnp.stack([endless] * 2)

        return jax.lax.switch(mode, [rolls, slips, flies])

    def _grip(self, press, pull):
        """What friction spares [N], (7.1): ``(m^2 - |T|^2) / sqrt(m^2 + |T|^2)``.

        With ``m = mu_s N``. Smooth where nothing pulls along the surface, unlike
        ``mu_s N - |T|``. A contact that may pull is held by friction as one that
        presses.
        """
        assert self.modes.static_friction is not None
        held, needed = self.modes.static_friction * press, dot(pull, pull)
        both = held * jnp.abs(held) if self.modes.lifts else held * held
        squared = held * held + needed
        size = jnp.sqrt(jnp.where(squared > 0.0, squared, 1.0))
        return (both - needed) / size

    def ends_slip(self, mode, kind):
        """Whether an event is the end of a slip."""
        return (mode == Mode.SLIPPING) & (kind == 0)

    @property
    def lands(self) -> bool:
        """Whether a flight may end."""
        return self.modes.restitution is not None

    def with_gap(self, mode, t, y: HybridState, values):
        """The events' values, and the state with the nearest points of a flight."""
        if not self.lands:
            return values, y

        def flies():
            gap, state = nearest_anywhere(self.scenes.flying, t, y.flying())
            return jnp.stack([gap, jnp.ones_like(gap)]), of(state)

        return jax.lax.cond(mode == Mode.FLYING, flies, lambda: (values, y))

    def slopes(self, mode, direction, t, step: Step):
        """Rates of the events' values and of the state, at the end of a step.

        In flight the nearest points move, too, though nothing integrates them.
        """

        def seen(t, y):
            return self.with_gap(mode, t, y, self.at(mode, direction, t, y)[1])

        rates = unpack(step.rates[-1], step.y)
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

    def changed(self, mode, kind, direction, t, y: HybridState, happens: Any = True):
        """Mode, direction and state after an event, if one happens.

        Where the contact is lost (kind 1) nothing else counts.
        """
        rolls, flies = mode == Mode.ROLLING, mode == Mode.FLYING
        still = eqx.tree_at(lambda y: y.slip, y, jnp.zeros_like(y.slip))
        y = _picked(rolls, still, y)
        touching, flying, up = still, y, jnp.asarray(False)
        if self.lands:
            hit = self._hit(t, y, flies & happens)
            touching, up = _picked(flies, of(hit.touching), still), hit.speed > 0.0
            flying = of(hit.flying)
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

    def _hit(self, t, y: HybridState, happens) -> Rebound:
        """After an impact; without one, what costs least."""
        modes, scene = self.modes, self.scenes.rolling
        e = modes.restitution
        assert e is not None
        numbers = e, modes.friction, modes.rest_speed
        return impact(scene, t, y.flying(), *numbers, modes.impact, happens)

    def last_of_slip(self, direction, t, y: HybridState):
        """Direction at which a slip ends, on fixed axes, and the rates of the state.

        There the slip's rate is along the slip: its turn vanishes. That is linear in
        the small angle that is left, and two rates give it (a secant).
        """
        scene = self.scenes.rolling
        out = contact_of(scene, t, y.sliding())
        normal = matvec(out.rotation, out.normal)
        s = last_way(y.slip, direction)
        across = cross(normal, s)
        ended = eqx.tree_at(lambda y: y.slip, y, jnp.zeros_like(y.slip))
        slides = jnp.full((), Mode.SLIPPING)

        def turned(carry, _):
            before, was, angle = carry
            way = s * jnp.cos(angle) + across * jnp.sin(angle)
            rates, _ = self.at(slides, way, t, ended)
            off = jnp.arctan2(-dot(rates.slip, across), -dot(rates.slip, s)) - angle
            change = off - was
            flat = change == 0.0
            step = -off * (angle - before) / jnp.where(flat, 1.0, change)
            # the first: away from the turn that is left, by about as much
            first = before == angle
            step = jnp.where(first, off, jnp.where(flat, 0.0, step))
            return (angle, off, angle + step), (way, rates)

        zero = jnp.zeros_like(t)
        _, (ways, rates) = jax.lax.scan(turned, (zero, zero, zero), length=4)
        return jax.tree.map(lambda x: x[-1], (ways, rates))

    def straightened(self, s, t, y: HybridState) -> HybridState:
        """The end of a slip, of whose tangent friction has ended the part across.

        The value is that of ``y``. Of a slip U = r s that ends, r -> 0, a variation
        across s ends with it, by friction that turns and the normal force that goes
        along: ``J = P (n - mu s) - q s'``, so that neither the normal velocity nor a
        part along s' = N x s is left (docs/theory.md, (7.4)).

        Args:
            s: Its last direction, fixed axes [1].
            t: Time [s].
            y: State.
        """
        if self.modes.friction is None:
            return y
        scene, sliding = self.scenes.rolling, y.sliding()
        contact = contact_of(scene, t, sliding)
        system = assemble(scene, t, sliding, contact)
        G, others = impulse_response(scene, contact, system)
        on_body = lambda v: matvec_transposed(contact.rotation, v)
        s, n = jax.lax.stop_gradient((on_body(s), -contact.normal))
        limit, across = n - self.modes.friction * s, cross(n, s)
        by_limit, by_across = matvec(G, limit), matvec(G, across)
        share = dot(n, by_across) / _not_zero(dot(n, by_limit))
        left = dot(on_body(y.slip), across)
        left = left - jax.lax.stop_gradient(left)
        q = left / _not_zero(dot(across, by_across) - share * dot(across, by_limit))
        J = q * (share * limit - across)
        jump = matvec(others, J)
        return eqx.tree_at(
            lambda y: (y.angular_velocity, y.alpha_dot, y.slip),
            y,
            (
                y.angular_velocity + jump[:3],
                y.alpha_dot + jump[3:],
                y.slip + matvec(contact.rotation, matvec(G, J)),
            ),
        )

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


def _beside_ends(tableau: Tableau) -> Float[Array, "2 s"]:
    """Weights of a step's rates in its cubic, beside both of its ends."""
    whole = jnp.roll(tableau.rows[-1], -1).at[-1].set(0.0)  # of the end, among all
    rows = []
    for share in BESIDE:
        _, first, rise, last = cubic(np.array([share]))[0]
        rows.append((rise * whole).at[0].add(first).at[-1].add(last))
    return jnp.stack(rows)


def _not_zero(x):
    """A divisor, which is nothing where there is nothing to divide."""
    return jnp.where(x == 0.0, 1.0, x)


def _picked(where, new: HybridState, old: HybridState) -> HybridState:
    return jax.tree.map(lambda a, b: jnp.where(where, a, b), new, old)


def _size(vector: Float[Array, "3"]) -> Float[Array, ""]:
    """Length of a vector that may be zero, where its derivative is taken as zero."""
    squared = dot(vector, vector)
    return jnp.where(
        squared > 0.0, jnp.sqrt(jnp.where(squared > 0.0, squared, 1.0)), 0.0
    )
