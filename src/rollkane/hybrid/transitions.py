"""What an event changes in the contact: the mode, and the state behind it."""

from collections.abc import Callable
from typing import TypeAlias, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ..dynamics.consistency import spin_stopped
from ..dynamics.contact_laws import impulse_response
from ..dynamics.directed_friction import SMALLEST_SLIP, begins
from ..dynamics.gap import in_flight
from ..dynamics.impacts import Rebound, impact
from ..dynamics.mass_matrix import assemble
from ..dynamics.precision import at_precision
from ..dynamics.rolling import at_contact, contact_of, rolling_derivative
from ..geometry.small_linear import (
    components,
    cross,
    dot,
    matvec,
    matvec_transposed,
    safe_norm,
    sign,
    solve_spd,
)
from ..validation.codes import Code
from .mode_rates import ModeRates, not_zero, picked
from .modes import HybridState, Mode, of, slipping

FOLLOWED = 1e3 * SMALLEST_SLIP  # [m/s]: a faster slip has its own direction
# Mode, direction of the slip, and state.
Begun: TypeAlias = tuple[Int[Array, ""], Float[Array, "3"], HybridState]


class Motion(ModeRates):
    """Rates, events and changes of a scene in all its modes.

    Attributes:
        scenes: The scene in every mode.
        modes: How it may change.
        tableau: Of an explicit Runge-Kutta method whose last stage is at its end.
    """

    def along(
        self,
        mode: Int[Array, ""],
        direction: Float[Array, "3"],
        y: HybridState,
        turned: Bool[Array, ""] | bool = False,
    ) -> Float[Array, "3"]:
        """Direction of the slip, where it is far above the law's smallest.

        Of one that begins where it no longer does. One that has ``turned`` until it
        stands across its old direction has its own, too: it would be found there again.
        """
        fast = dot(y.slip, y.slip)
        followed = at_precision(FOLLOWED, fast)
        least = jnp.where(begins(direction), self.onset, followed)
        known = (mode == Mode.SLIPPING) & ((fast > least**2) | turned)
        return jnp.where(
            known, y.slip / jnp.sqrt(jnp.where(known, fast, 1.0)), direction
        )

    def begun(self, mode: Int[Array, ""], t: Float[Array, ""], y: HybridState) -> Begun:
        """Mode, direction and state at the start: what is without slip may grip."""
        speed = safe_norm(y.slip)
        rests = (mode == Mode.ROLLING) | ((mode == Mode.SLIPPING) & ~(speed > 0.0))

        def settled() -> Begun:
            settled, way, gripped = self.settled(t, y)
            return settled, way, picked(settled == Mode.ROLLING, gripped, y)

        # a flight may begin where no contact could be, without a derivative there
        as_it_is: Callable[[], Begun] = lambda: (mode, y.slip / not_zero(speed), y)
        return cast(Begun, jax.lax.cond(rests, settled, as_it_is))

    def changed(
        self,
        mode: Int[Array, ""],
        kind: Int[Array, ""],
        direction: Float[Array, "3"],
        t: Float[Array, ""],
        y: HybridState,
        happens: Bool[Array, ""] | bool = True,
        rests: Bool[Array, ""] | bool = False,
    ) -> Begun:
        """Mode, direction and state after an event, if one happens.

        A landing that ``rests`` has no rebound: the flight before it was rounding.
        Where the contact is lost (kind 1) nothing else counts. Of a body that never
        slips, where it can neither roll nor leave, and of one that cannot grip on
        rubber (:meth:`jams`) the slip is NaN.
        """
        rolls, flies = mode == Mode.ROLLING, mode == Mode.FLYING
        still = eqx.tree_at(lambda y: y.slip, y, jnp.zeros_like(y.slip))
        y = picked(rolls, still, y)
        touching, flying, up = still, y, jnp.asarray(False)
        impulse = None
        if self.lands:
            hit = self._hit(t, y, flies & happens, rests)
            if self.scenes.rolling.contact.without_spin:
                impulse = jnp.where(flies, hit.impulse, 0.0)
            touching, up = picked(flies, of(hit.touching), still), hit.speed > 0.0
            flying = of(hit.flying)
        if self.modes.lifts:
            flying = picked(flies, flying, self._lifted(t, y))
        if self.modes.friction is None:
            touching = self._without_slip(t, touching, y)
        speed = safe_norm(touching.slip)
        slips = speed > 0.0
        stays, way, gripped = self.settled(t, touching, impulse)
        way = jnp.where(slips, touching.slip / not_zero(speed), way)
        stays = jnp.where(slips, Mode.SLIPPING, stays)
        stays = jnp.where(rolls, Mode.SLIPPING, stays)  # what ended was the grip
        touching = picked(stays == Mode.ROLLING, gripped, touching)
        leaves = jnp.where(flies, up, kind == 1)
        return (
            jnp.where(leaves, Mode.FLYING, stays),
            jnp.where(leaves, direction, way),
            picked(leaves, flying, touching),
        )

    def _lifted(self, t: Float[Array, ""], y: HybridState) -> HybridState:
        """In flight, as the contact left it.

        A body that never slips is still held along its base where its normal force
        vanishes. Let go of, it may turn into its base: then it does not leave it.
        """
        flying = of(in_flight(y.sliding(), self.scenes.rolling, t))
        if self.modes.friction is not None:
            return flying
        scene = self.scenes.rolling
        now = at_contact(scene, t, y.rolling())
        free = slipping(scene, jnp.zeros_like(t), now.out, y, follows=True, turns=False)
        needed = at_contact(free, t, y.sliding()).press  # to stay without friction
        falls = of(rolling_derivative(self.scenes.flying, t, flying.flying())).velocity
        known = jnp.abs(now.press) + safe_norm(now.pull)
        known = known + scene.body.mass * safe_norm(falls)
        return _jammed(flying, needed > _half_the_digits(t) * known)

    def _without_slip(
        self, t: Float[Array, ""], touching: HybridState, y: HybridState
    ) -> HybridState:
        """What never slips touches without slip, but for rounding; else it is lost.

        A landing may end while it slips, however much friction there is: that throws
        the body off where it is eccentric.
        """
        rounding = _half_the_digits(t) * safe_norm(y.velocity)
        slips = safe_norm(touching.slip) > rounding
        still = eqx.tree_at(lambda y: y.slip, touching, jnp.zeros_like(touching.slip))
        return _jammed(still, slips)

    def jams(self, y: HybridState) -> Bool[Array, ""] | bool:
        """Whether a contact has no motion where it came: of its state the slip is NaN.

        That of a body that never slips, and one that grips on rubber.
        """
        rubber = self.scenes.rolling.contact.without_spin
        if self.modes.friction is not None and not rubber:
            return False
        known = jnp.all(jnp.isfinite(y.angular_velocity))
        return known & jnp.any(jnp.isnan(y.slip))

    @property
    def code_of_jam(self) -> int:
        """What a run is told that ends there."""
        never = self.modes.friction is None
        return int(Code.PAINLEVE if never else Code.NEITHER_GRIPS_NOR_SLIPS)

    def _hit(
        self,
        t: Float[Array, ""],
        y: HybridState,
        happens: Bool[Array, ""],
        rests: Bool[Array, ""] | bool,
    ) -> Rebound:
        """After an impact; without one, what costs least."""
        modes, scene = self.modes, self.scenes.rolling
        e = modes.restitution
        assert e is not None
        slowest = jnp.where(rests, jnp.inf, modes.rest_speed)
        numbers = e, modes.friction, slowest
        return impact(scene, t, y.flying(), *numbers, modes.impact, happens)

    def has_begun(
        self,
        mode: Int[Array, ""],
        direction: Float[Array, "3"],
        y: HybridState,
        ends: Bool[Array, ""],
    ) -> Bool[Array, ""]:
        """Whether a slip that began is fast enough to be followed, or ends before."""
        fast = dot(y.slip, y.slip) > self.onset**2
        return (mode == Mode.SLIPPING) & begins(direction) & (fast | ends)

    def straightened(
        self,
        s: Float[Array, "3"],
        t: Float[Array, ""],
        y: HybridState,
        begun: Bool[Array, ""],
    ) -> HybridState:
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
        on_body: Callable[[Array], Array] = lambda v: matvec_transposed(
            contact.rotation, v
        )
        mu = self.modes.friction
        if not self.modes.lifts:  # friction goes with the size of the normal force
            slips = slipping(scene, mu, s, y, follows=True, turns=False)
            mu = mu * sign(at_contact(slips, t, sliding).press)
        s, n = on_body(s), -contact.normal
        limit, across = n - mu * s, cross(n, s)
        by_limit, by_across = matvec(G, limit), matvec(G, across)
        share = dot(n, by_across) / not_zero(dot(n, by_limit))
        left = dot(on_body(y.slip), across)  # which without friction stays
        left = jnp.where(self.friction_ends_slips, left, 0.0)
        left = left - jnp.where(begun, 0.0, jax.lax.stop_gradient(left))
        q = left / not_zero(dot(across, by_across) - share * dot(across, by_limit))
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

    def settled(
        self,
        t: Float[Array, ""],
        y: HybridState,
        impulse: Float[Array, "3"] | None = None,
    ) -> Begun:
        """Mode of a contact without slip, where its slip begins, and how it rolls.

        It rolls if it is held, which without friction it is not even at rest; on rubber
        an impulse ends its spin about the normal. Where the contact cannot give that,
        the slip is NaN.

        Args:
            t: Time [s].
            y: State without slip.
            impulse: Of a landing that it comes from [N s], FIXED axes.
        """
        scene, fails = self.scenes.rolling, None
        if scene.contact.without_spin:
            still, torque = spin_stopped(scene, t, y.rolling())
            fails = ~self._holds(t, y, torque, impulse)
            parts = still.angular_velocity, still.alpha_dot
            y = eqx.tree_at(lambda s: (s.angular_velocity, s.alpha_dot), y, parts)
        now = at_contact(scene, t, y.rolling())
        press, pull = now.press, now.pull
        mode = jnp.asarray(Mode.ROLLING)
        # against the friction that would be needed, of the length that says it begins
        way = -0.5 * pull / not_zero(safe_norm(pull))
        if self.modes.sticking is not None:
            sticks = self.modes.sticking > 0.0
            held = dot(pull, pull) <= (self.modes.sticking * press) ** 2
            mode = jnp.where(sticks & held, Mode.ROLLING, Mode.SLIPPING)
            # no friction looks for a way: a slip has its own at once, and rest has none
            way = jnp.where(sticks, way, now.out)
        return mode, way, y if fails is None else _jammed(y, fails)

    def _holds(
        self,
        t: Float[Array, ""],
        y: HybridState,
        torque: Float[Array, "3"],
        landing: Float[Array, "3"] | None,
    ) -> Bool[Array, ""]:
        """Whether a contact can give the impulse that the end of a spin takes.

        A torque ``K`` about the normal turns the body about its mass centre, and with
        it the point that touches, by ``O^T K`` for one whose angular velocity an
        impulse J changes by ``O J`` (the response is symmetric): to hold it takes
        ``J = -G^-1 O^T K``, which has to push, and to lie in the friction cone.
        """
        scene, sliding = self.scenes.rolling, y.sliding()
        contact = contact_of(scene, t, sliding)
        system = assemble(scene, t, sliding, contact)
        G, others = impulse_response(scene, contact, system)
        moved = matvec_transposed(others[:3], torque)
        rows = [components(row) for row in components(G)]
        holds = -jnp.stack(solve_spd(rows, components(moved)))
        arm = not_zero(safe_norm(contact.body_point))
        known = safe_norm(torque) / arm  # of a centred body the whole is rounding
        if landing is not None:
            known = known + safe_norm(landing)
            holds = holds + matvec_transposed(contact.rotation, landing)
        slack = _half_the_digits(t) * known
        press = -dot(contact.normal, holds)
        along = safe_norm(holds + press * contact.normal)
        if not self.modes.lifts:
            press = jnp.abs(press)
        if self.modes.sticking is None:
            return press >= -slack
        return along <= self.modes.sticking * jnp.maximum(press, 0.0) + slack


def _half_the_digits(x: Array) -> float:
    """Less than this share of a force or of a speed is rounding."""
    return float(np.finfo(x.dtype).eps) ** 0.5


def _jammed(y: HybridState, jams: Bool[Array, ""]) -> HybridState:
    """A state whose slip is NaN, if it jams."""
    slip = jnp.where(jams, jnp.nan, y.slip)
    return eqx.tree_at(lambda y: y.slip, y, slip)
