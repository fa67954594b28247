"""What the contact does in every mode: rates, and events that are seen on the way."""

from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias, TypeVar, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ..codegen.tableau import Tableau, stage_sum
from ..dynamics.directed_friction import begins
from ..dynamics.nearest_anywhere import nearest_anywhere
from ..dynamics.rolling import (
    at_contact,
    rolling_derivative,
)
from ..dynamics.slip_onset import onset_of
from ..geometry.small_linear import dot, safe_norm, sign
from ..kinematics.coordinates import pack, unpack
from .event_bounds import BESIDE, cubic, stays_positive
from .modes import HybridState, Mode, Modes, Scenes, of, slipping

_T = TypeVar("_T")
_Numbers = TypeVar("_Numbers", bound=Any)
# Like plain_cond.
Cond: TypeAlias = Callable[
    [tuple[Any, ...], Array, Callable[..., Any], Callable[..., Any]], Any
]


class Seen(NamedTuple):
    """What is seen of the contact at one moment.

    Attributes:
        values: Of the events but for the gap: two numbers, positive while the mode
            lasts.
        way: Direction of a slip that begins, against its friction, fixed axes [1].
        turn: Slip times the rate at which friction turns it [m/s^2].
        out: Of a slip, the surface's normal, fixed axes [1]; else zero.
    """

    values: Float[Array, "2"]
    way: Float[Array, "3"]
    turn: Float[Array, ""]
    out: Float[Array, "3"]


class Step(NamedTuple):
    """A step: where it led, and what was seen on the way.

    Attributes:
        y: State; in flight, with its contact coordinates at the nearest points; of a
            slip, without what the step's error left of it along the normal.
        error: Of the state, an estimate.
        rates: Of the state at every stage, the last at the end.
        values: Of the events at the end: two numbers, positive while the mode lasts.
        seen: Of the events at ``ModeRates.nodes``; in flight they are not looked at.
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


# Of a direction of the slip, a time and a state: rates, and what is seen.
_Rates: TypeAlias = Callable[[Array, Array, HybridState], tuple[HybridState, Seen]]
# Number of a stage or a place, rates at the stages, state at the end, what is seen of
# the events, and all that is seen last.
_Look: TypeAlias = tuple[
    Int[Array, ""],
    Float[Array, "s n"],
    Float[Array, " n"],
    Float[Array, "m 2"],
    Seen,
]


def plain_cond(
    operands: tuple[Any, ...],
    where: Bool[Array, ""],
    then: Callable[..., Any],
    other: Callable[..., Any],
) -> Any:
    """``jax.lax.cond``, with operands of any kind: all that the branches depend on."""
    first, second = lambda: then(*operands), lambda: other(*operands)
    return cast(Any, jax.lax.cond(where, first, second))


class ModeRates(eqx.Module):
    """Rates and events of a scene in all its modes.

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

    def stepped(
        self,
        mode: Int[Array, ""],
        direction: Float[Array, "3"],
        t: Float[Array, ""],
        t1: Float[Array, ""],
        y: HybridState,
        watched: bool = False,
    ) -> Step:
        """A step from t to t1; see :meth:`stages`."""
        known, end, seen, last = self.stages(mode, direction, t, t1, y, watched)
        error = (t1 - t) * stage_sum(self.tableau.error, known)
        y = unpack(end, y)
        # nothing of it ends along the normal: what steps leave there would outlast it
        y = eqx.tree_at(lambda y: y.slip, y, _along_surface(y.slip, last.out))
        values, end = self.with_gap(mode, t1, y, last.values)
        return Step(end, error, known, values, seen, last.way, last.turn)

    def stages(
        self,
        mode: Int[Array, ""],
        direction: Float[Array, "3"],
        t: Float[Array, ""],
        t1: Float[Array, ""],
        y: HybridState,
        watched: bool = False,
    ) -> tuple[Float[Array, "s n"], Float[Array, " n"], Float[Array, "m 2"], Seen]:
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

        def look(carry: _Look) -> _Look:
            number, known, end, seen, last = carry
            at = start + h * stage_sum(weights[number], known)
            time = jnp.where(number == count - 1, t1, t + nodes[number] * h)
            rates, now = self.at(mode, direction, time, unpack(at, y))
            is_stage = number < count
            own = jnp.minimum(number, count - 1)
            rates = jnp.where(is_stage, pack(rates), known[own])
            known = known.at[own].set(rates)
            end, last = picked(is_stage, (at, now), (end, last))
            return number + 1, known, end, seen.at[number].set(now.values), last

        known = jnp.zeros((count, start.shape[0]), start.dtype)
        unseen = jnp.zeros((nodes.shape[0], 2), start.dtype)
        last = Seen(unseen[0], *_nothing_seen(direction, h)[1:])
        carry = jnp.asarray(0), known, start, unseen, last
        if watched:

            def going(carry: _Look) -> Bool[Array, ""]:
                number, _, _, seen, _ = carry
                stages = seen[:count]
                far = stays_positive(jnp.min(stages, axis=0), jnp.max(stages, axis=0))
                return (number < count) | ((number < nodes.shape[0]) & ~far)

            carry = jax.lax.while_loop(going, look, carry)
        else:
            step: Callable[[_Look, None], tuple[_Look, None]] = lambda carry, _: (
                look(carry),
                None,
            )
            carry, _ = jax.lax.scan(step, carry, length=count)
        return carry[1:]

    def at(
        self,
        mode: Int[Array, ""],
        direction: Float[Array, "3"],
        t: Float[Array, ""],
        y: HybridState,
    ) -> tuple[HybridState, Seen]:
        """Rates of what the mode moves, and what is seen of its contact."""
        return cast(
            tuple[HybridState, Seen],
            jax.lax.switch(mode, self.by_mode, direction, t, y),
        )

    @property
    def by_mode(self) -> tuple[_Rates, ...]:
        """:meth:`at` in each mode, by its number."""
        # bound methods of a module hash their arrays, which JAX would ask them to
        return (
            lambda direction, t, y: self._rolls(direction, t, y),
            lambda direction, t, y: self._slips(direction, t, y),
            lambda direction, t, y: self._flies(direction, t, y),
        )

    def plain(
        self,
        mode: Mode,
        direction: Float[Array, "3"],
        t: Float[Array, ""],
        y: HybridState,
        turns: bool,
    ) -> tuple[HybridState, Seen]:
        """:meth:`at` of a contact that rolls, or of a slip that has its direction.

        ``turns``: with how fast it turns.
        """
        if mode == Mode.ROLLING:
            return self._rolls(direction, t, y)
        return self._slips(direction, t, y, True, turns)

    def _rolls(
        self, direction: Float[Array, "3"], t: Float[Array, ""], y: HybridState
    ) -> tuple[HybridState, Seen]:
        modes, endless = self.modes, jnp.ones_like(t)
        rates, press, pull, *_ = at_contact(self.scenes.rolling, t, y.rolling())
        grip = endless
        if modes.sticking is not None:
            grip = self._grip(press, pull)
        values = jnp.stack([grip, press if modes.lifts else endless])
        return of(rates), _nothing_seen(direction, t)._replace(values=values)

    def _slips(
        self,
        direction: Float[Array, "3"],
        t: Float[Array, ""],
        y: HybridState,
        follows: bool = False,
        turns: bool = True,
    ) -> tuple[HybridState, Seen]:
        modes, endless = self.modes, jnp.ones_like(t)
        if modes.friction is None:  # nothing slips
            still: Callable[[Array], Array] = lambda x: jnp.zeros_like(x)
            return jax.tree.map(still, y), _nothing_seen(direction, t)
        law = modes.friction, direction, y, follows, turns
        scene = slipping(self.scenes.rolling, *law)
        rates, press, pull, turn, _, out = at_contact(scene, t, y.sliding())
        # friction goes with the normal force if that ends at zero, else with its size
        against = -sign(press) * pull if modes.lifts else -pull
        against = against / not_zero(safe_norm(against))
        way = jnp.where(begins(direction), against, direction)
        slip = _along_surface(y.slip, out)
        on = jnp.where(self.friction_ends_slips, dot(slip, way), endless)
        values = jnp.stack([on, press if modes.lifts else endless])
        return of(rates), Seen(values, way, turn, out)

    def _flies(
        self, direction: Float[Array, "3"], t: Float[Array, ""], y: HybridState
    ) -> tuple[HybridState, Seen]:
        rates = rolling_derivative(self.scenes.flying, t, y.flying())
        return of(rates), _nothing_seen(direction, t)

    def _grip(
        self, press: Float[Array, ""], pull: Float[Array, "3"]
    ) -> Float[Array, ""]:
        """What friction spares [N], (8.1): ``(m^2 - |T|^2) / sqrt(m^2 + |T|^2)``.

        With ``m = mu_s N``. Smooth where nothing pulls along the surface, unlike
        ``mu_s N - |T|``. A contact that may pull is held by friction as one that
        presses.
        """
        assert self.modes.sticking is not None
        held, needed = self.modes.sticking * press, dot(pull, pull)
        both = held * jnp.abs(held) if self.modes.lifts else held * held
        squared = held * held + needed
        size = jnp.sqrt(jnp.where(squared > 0.0, squared, 1.0))
        return (both - needed) / size

    @property
    def onset(self) -> Float[Array, ""]:
        """Speed until which a slip only begins [m/s]."""
        return onset_of(self.scenes.rolling)

    @property
    def friction_ends_slips(self) -> Bool[Array, ""] | bool:
        """Whether there is friction to speak of: without it nothing ends a slip.

        Of less its direction is a rounding: it is known to eps / friction, 1.5e-7 at
        this bound, of an onset of 1e-5 m/s.
        """
        friction = self.modes.friction
        if friction is None:
            return False
        return friction > 0.1 * np.sqrt(np.finfo(friction.dtype).eps)

    def ends_slip(self, mode: Int[Array, ""], kind: Int[Array, ""]) -> Bool[Array, ""]:
        """Whether an event is the end of a slip."""
        return (mode == Mode.SLIPPING) & (kind == 0)

    @property
    def lands(self) -> bool:
        """Whether a flight may end."""
        return self.modes.restitution is not None

    def with_gap(
        self,
        mode: Int[Array, ""],
        t: Float[Array, ""],
        y: HybridState,
        values: Float[Array, "2"],
        cond: Cond = plain_cond,
    ) -> tuple[Float[Array, "2"], HybridState]:
        """The events' values, and the state with the nearest points of a flight."""
        if not self.lands:
            return values, y

        def nearest(
            motion: ModeRates,
            t: Float[Array, ""],
            y: HybridState,
            values: Float[Array, "2"],
        ) -> tuple[Float[Array, "2"], HybridState]:
            gap, state = nearest_anywhere(motion.scenes.flying, t, y.flying())
            return jnp.stack([gap, jnp.ones_like(gap)]), of(state)

        stays: Callable[[ModeRates, Array, HybridState, Array], Any] = (
            lambda motion, t, y, values: (values, y)
        )
        return cond((self, t, y, values), mode == Mode.FLYING, nearest, stays)


def _nothing_seen(direction: Float[Array, "3"], t: Float[Array, ""]) -> Seen:
    """Of a contact that is not there."""
    none = jnp.zeros_like(direction)
    return Seen(jnp.ones(2, t.dtype), none, jnp.zeros_like(t), none)


def _along_surface(slip: Float[Array, "3"], out: Float[Array, "3"]) -> Array:
    """A slip without its part along the normal."""
    return slip - dot(slip, out) * out


def _beside_ends(tableau: Tableau) -> Float[Array, "2 s"]:
    """Weights of a step's rates in its cubic, beside both of its ends."""
    return jnp.stack([weights for _, weights in beside_ends(tableau.rows[-1])])


def beside_ends(last: _Numbers) -> list[tuple[float, _Numbers]]:
    """Shares of a step beside its ends, each with the weights of the cubic there.

    Args:
        last: Weights of the step's end, of its last stage too.
    """
    count = last.shape[0]
    found: list[tuple[float, Any]] = []
    for share in BESIDE:
        _, first, rise, behind = cubic(np.array([share]))[0].tolist()
        ends = np.zeros(count)
        ends[0], ends[-1] = first, behind
        found.append((share, rise * last + ends.astype(last.dtype)))
    return found


def not_zero(x: Float[Array, ""]) -> Float[Array, ""]:
    """A divisor, which is nothing where there is nothing to divide."""
    return jnp.where(x == 0.0, 1.0, x)


def picked(where: Bool[Array, ""], new: _T, old: _T) -> _T:
    """One of two trees of arrays."""
    pick: Callable[[Array, Array], Array] = lambda a, b: jnp.where(where, a, b)
    return jax.tree.map(pick, new, old)
