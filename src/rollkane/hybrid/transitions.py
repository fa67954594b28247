"""What the contact does in every mode: rates, events, and what an event changes."""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..codegen.tableau import Tableau
from ..dynamics.consistency import spin_stopped
from ..dynamics.contact_laws import impulse_response
from ..dynamics.directed_friction import ONSET, SMALLEST_SLIP, begins
from ..dynamics.gap import in_flight, nearest_anywhere
from ..dynamics.impacts import Rebound, impact
from ..dynamics.mass_matrix import assemble
from ..dynamics.rolling import (
    contact_of,
    press_and_pull,
    rates_and_force,
    rolling_derivative,
    slipping_rates,
)
from ..geometry.small_linear import cross, dot, matvec, matvec_transposed
from ..kinematics.coordinates import pack, unpack
from .event_bounds import BESIDE, cubic, stays_positive
from .modes import HybridState, Mode, Modes, Scenes, of, slipping


class Seen(NamedTuple):
    """What is seen of the contact at one moment.

    Attributes:
        values: Of the events but for the gap: two numbers, positive while the mode
            lasts.
        way: Direction of a slip that begins, against its friction, fixed axes [1].
        turn: Slip times the rate at which friction turns it [m/s^2].
    """

    values: Float[Array, "2"]
    way: Float[Array, "3"]
    turn: Float[Array, ""]


class Step(NamedTuple):
    """A step: where it led, and what was seen on the way.

    Attributes:
        y: State; in flight, with its contact coordinates at the nearest points.
        error: Of the state, an estimate.
        rates: Of the state at every stage, the last at the end.
        values: Of the events at the end: two numbers, positive while the mode lasts.
        seen: Of the events at ``Motion.nodes``; in flight they are not looked at.
        way: As in ``Seen``, at the end.
        turn: As in ``Seen``, at the end.
    """

    y: HybridState
    error: Float[Array, " n"]
    rates: Float[Array, "s n"]
    values: Float[Array, "2"]
    seen: Float[Array, "m 2"]
    way: Float[Array, "3"]
    turn: Float[Array, ""]


def plain_cond(operands: tuple, where, then: Callable, other: Callable) -> Any:
    """``jax.lax.cond``, with operands of any kind: all that the branches depend on."""
    return jax.lax.cond(where, lambda: then(*operands), lambda: other(*operands))


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
        """A step from t to t1; see :meth:`stages`."""
        known, end, seen, last = self.stages(mode, direction, t, t1, y, watched)
        error = (t1 - t) * matvec(known.T, self.tableau.error)
        values, end = self.with_gap(mode, t1, unpack(end, y), last.values)
        return Step(end, error, known, values, seen, last.way, last.turn)

    def stages(self, mode, direction, t, t1, y: HybridState, watched=False):
        """Rates at all stages of a step, its end, and what is seen on the way and last.

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
            number, known, end, seen, last = carry
            at = start + h * matvec(known.T, weights[number])
            time = jnp.where(number == count - 1, t1, t + nodes[number] * h)
            rates, now = self.at(mode, direction, time, unpack(at, y))
            is_stage = number < count
            own = jnp.minimum(number, count - 1)
            rates = jnp.where(is_stage, pack(rates), known[own])
            known = known.at[own].set(rates)
            end, last = jax.tree.map(
                lambda a, b: jnp.where(is_stage, a, b), (at, now), (end, last)
            )
            return number + 1, known, end, seen.at[number].set(now.values), last

        known = jnp.zeros((count, start.shape[0]), start.dtype)
        unseen = jnp.zeros((nodes.shape[0], 2), start.dtype)
        last = Seen(unseen[0], jnp.zeros_like(direction), jnp.zeros_like(h))
        carry = jnp.asarray(0), known, start, unseen, last
        if watched:

            def going(carry):
                number, _, _, seen, _ = carry
                stages = seen[:count]
                far = stays_positive(jnp.min(stages, axis=0), jnp.max(stages, axis=0))
                return (number < count) | ((number < nodes.shape[0]) & ~far)

            carry = jax.lax.while_loop(going, look, carry)
        else:
            step = lambda carry, _: (look(carry), None)
            carry, _ = jax.lax.scan(step, carry, length=count)
        return carry[1:]

    def at(self, mode, direction, t, y: HybridState):
        """Rates of what the mode moves, and what is seen of its contact."""
        return jax.lax.switch(mode, self.by_mode, direction, t, y)

    @property
    def by_mode(self) -> tuple[Callable, ...]:
        """:meth:`at` in each mode, by its number."""
        # bound methods of a module hash their arrays, which JAX would ask them to
        return (
            lambda *where: self._rolls(*where),
            lambda *where: self._slips(*where),
            lambda *where: self._flies(*where),
        )

    def _rolls(self, direction, t, y: HybridState) -> tuple[HybridState, Seen]:
        modes, endless = self.modes, jnp.ones_like(t)
        rates, press, pull = rates_and_force(self.scenes.rolling, t, y.rolling())
        grip = endless
        if modes.static_friction is not None:
            grip = self._grip(press, pull)
        values = jnp.stack([grip, press if modes.lifts else endless])
        return of(rates), Seen(values, jnp.zeros_like(direction), jnp.zeros_like(t))

    def _slips(self, direction, t, y: HybridState) -> tuple[HybridState, Seen]:
        modes, endless = self.modes, jnp.ones_like(t)
        if modes.friction is None:  # nothing slips
            return jax.tree.map(jnp.zeros_like, y), _nothing_seen(direction, t)
        scene = slipping(self.scenes.rolling, modes.friction, direction, y)
        rates, press, pull, turn = slipping_rates(scene, t, y.sliding())
        against = -jnp.where(press < 0.0, -1.0, 1.0) * pull
        against = against / _not_zero(_size(against))
        way = jnp.where(begins(direction), against, direction)
        # without friction nothing ends a slip
        on = jnp.where(modes.friction > 0.0, dot(y.slip, way), endless)
        values = jnp.stack([on, press if modes.lifts else endless])
        return of(rates), Seen(values, way, turn)

    def _flies(self, direction, t, y: HybridState) -> tuple[HybridState, Seen]:
        rates = rolling_derivative(self.scenes.flying, t, y.flying())
        return of(rates), _nothing_seen(direction, t)

    def _grip(self, press, pull):
        """What friction spares [N], (8.1): ``(m^2 - |T|^2) / sqrt(m^2 + |T|^2)``.

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

    def with_gap(self, mode, t, y: HybridState, values, cond: Callable = plain_cond):
        """The events' values, and the state with the nearest points of a flight."""
        if not self.lands:
            return values, y

        def nearest(motion, t, y, values):
            gap, state = nearest_anywhere(motion.scenes.flying, t, y.flying())
            return jnp.stack([gap, jnp.ones_like(gap)]), of(state)

        stays = lambda motion, t, y, values: (values, y)
        return cond((self, t, y, values), mode == Mode.FLYING, nearest, stays)

    def along(self, mode, direction, y: HybridState):
        """Direction of the slip, where it is far above the law's smallest.

        Of one that begins where it no longer does.
        """
        fast = dot(y.slip, y.slip)
        least = jnp.where(begins(direction), ONSET, 1e3 * SMALLEST_SLIP)
        known = (mode == Mode.SLIPPING) & (fast > least**2)
        return jnp.where(
            known, y.slip / jnp.sqrt(jnp.where(known, fast, 1.0)), direction
        )

    def begun(self, mode, t, y: HybridState):
        """Mode, direction and state at the start: what is without slip may grip."""
        speed = _size(y.slip)
        settled, way, gripped = self.settled(t, y)
        rests = (mode == Mode.ROLLING) | ((mode == Mode.SLIPPING) & ~(speed > 0.0))
        grips = rests & (settled == Mode.ROLLING)
        return (
            jnp.where(rests, settled, mode),
            jnp.where(rests, way, y.slip / _not_zero(speed)),
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
        way = jnp.where(slips, touching.slip / _not_zero(speed), way)
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

    def has_begun(self, mode, direction, y: HybridState, ends):
        """Whether a slip that began is fast enough to be followed, or ends before."""
        fast = dot(y.slip, y.slip) > ONSET**2
        return (mode == Mode.SLIPPING) & begins(direction) & (fast | ends)

    def straightened(self, s, t, y: HybridState, begun) -> HybridState:
        """A slip along s alone: friction has ended the part across it.

        Of a slip U = r s with r -> 0, what is across s ends by friction that turns and
        the normal force that goes along: ``J = P (n - mu s) - q s'``, so that neither
        the normal velocity nor a part along s' = N x s is left (docs/theory.md, (8.4)).

        Args:
            s: Its direction, fixed axes [1].
            t: Time [s].
            y: State.
            begun: Whether it is behind its onset; else it ends, and only the tangent
                has a part to lose: the value is that of ``y``.
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
        left = left - jnp.where(begun, 0.0, jax.lax.stop_gradient(left))
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
        """Mode of a contact without slip, where its slip begins, and how it rolls.

        It rolls if it is held; on rubber an impulse ends its spin about the normal.
        """
        scene = self.scenes.rolling
        if scene.contact.without_spin:
            held = spin_stopped(scene, t, y.rolling())
            parts = held.angular_velocity, held.alpha_dot
            y = eqx.tree_at(lambda s: (s.angular_velocity, s.alpha_dot), y, parts)
        press, pull = press_and_pull(scene, t, y.rolling())
        mode = jnp.asarray(Mode.ROLLING)
        if self.modes.static_friction is not None:
            held = dot(pull, pull) <= (self.modes.static_friction * press) ** 2
            mode = jnp.where(held, Mode.ROLLING, Mode.SLIPPING)
        # against the friction that would be needed, of the length that says it begins
        return mode, -0.5 * pull / _not_zero(_size(pull)), y


def _nothing_seen(direction, t) -> Seen:
    """Of a contact that is not there."""
    return Seen(jnp.ones(2, t.dtype), jnp.zeros_like(direction), jnp.zeros_like(t))


def _beside_ends(tableau: Tableau) -> Float[Array, "2 s"]:
    """Weights of a step's rates in its cubic, beside both of its ends."""
    whole, rows = tableau.rows[-1], []
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
