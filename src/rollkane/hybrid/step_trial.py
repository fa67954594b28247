"""One step of a run in modes: tried, and judged.

A step is accepted when its error is small and no event can hide in it. One that ends
behind an event is shortened until it ends on it, by a bracketing secant.
"""

from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ..codegen import least_product
from ..dynamics.directed_friction import begins
from ..dynamics.gap import closing
from ..dynamics.precision import at_precision
from ..dynamics.rolling import headings, watches_headings
from ..dynamics.scene import Scene
from ..geometry.small_linear import dot
from ..integration.step_control import AboveRounding, Landings
from ..kinematics.coordinates import pack, unpack
from .event_bounds import Doubt, between, rate_at_end, stays_positive
from .event_location import STAYS, Bracket
from .flight_bounds import closes_as_it_may, doubt_in_flight, rounding
from .mode_rates import Step
from .mode_replay import Path, Place, Record
from .modes import HybridState, Mode, as_it_is
from .slip_bounds import has_turned, is_as_it_began, longest_step
from .transitions import Motion
from .user_events import Watched

_ROOT = 1e-12  # of the event's value at the step's start
_TOGETHER = 1e-9  # of the normal force at the step's start: no friction to speak of
# [m/s^2], v^2 over the height's rounding of a flight that rises by one: 2 a h, of twice
# the height, as it is seen to have landed within two of them. With a = 100 m/s^2, as of
# a base that is shaken by ten times gravity; what comes faster rebounds as any other
_FALLS = 4.0 * 100.0
# Cuts of one step, most, each to 0.9 of it or less: what is in doubt still then is no
# more than rounding (an event's value that stays zero)
_CUTS = 24

# Whether a step may end at a state, of a scene, a time and the state.
Allowed: TypeAlias = Callable[[Scene, Array, Any], Array]


class Run(NamedTuple):
    """What the loop carries."""

    place: Place
    step: Array
    values: Array  # of the events at t; NaN behind a change, where they may be zero
    kind: Array  # of the event that the last try was on the way to
    searching: Array
    bracket: Bracket
    cuts: Array  # of this step, because an event could hide in it
    landing: Array  # next of the times on which a step must end
    path: Path
    record: Record | None
    accepted: Array
    tried: Array
    code: Array
    watched: Watched | None = None  # events of the user's own

    @property
    def looks(self) -> Array:
        """Whether such an event is looked for in this step."""
        watched = self.watched
        return jnp.asarray(False) if watched is None else watched.search.active


class Tried(NamedTuple):
    """A tried step: where it ended, how good it was, and what it saw of the events."""

    t: Array
    end: Step
    size: Array  # of its error, over what is allowed
    lands: Array  # on a time that it must end on
    doubt: Doubt


class Verdict(NamedTuple):
    """What becomes of a tried step."""

    accept: Array
    event: Array
    since: Array  # the change before it: it happened there, not by a zero of its own
    rests: Array  # and was a landing behind a flight that was rounding
    turned: Array  # a slip, until it stands across its old direction
    kind: Array
    searching: Array
    bracket: Bracket
    step: Array
    cuts: Array
    stuck: Array
    blinks: Array  # to an output so near that nothing can have happened since


class Trials(eqx.Module):
    """How a step of a run in modes is tried, and what becomes of it.

    Attributes:
        motion: Rates, events and changes.
        times: Output times [s].
        landings: Where steps have to end.
        reach: Of the body, from its origin [m]; None where nothing lands.
        rtol: Relative tolerance of a step [1].
        atol: Absolute tolerance [unit of the state].
        order: That the error estimate counts on.
        allowed: ``allowed(scene, t, state)`` -> whether a step may end there.
        events: Of the user's own.
    """

    motion: Motion
    times: Array
    landings: Landings
    reach: Array | None
    rtol: Array
    atol: Array
    order: int
    allowed: Allowed | None = eqx.field(static=True)
    events: Any = ()

    def tried(self, c: Run) -> Tried:
        """One step: to the next landing, to where an event may be, or as proposed."""
        at = c.place
        goal = self.landings.ends[c.landing]
        lands = goal - at.t <= c.step * (1.0 + 1e-9)
        length = c.step
        if c.watched is not None:
            # what it looks for may be on the landing itself: no step begins there again
            trial = c.watched.trial
            lands = jnp.where(c.looks, at.t + trial >= goal, lands)
            length = jnp.where(c.looks, trial, length)
        lands &= ~c.searching
        length = jnp.where(c.searching, c.bracket.trial, length)
        t1 = jnp.where(lands, goal, at.t + length)
        end = self.motion.stepped(at.mode, at.direction, at.t, t1, at.y, True)
        size = AboveRounding(self.rtol)(end.error / self.tolerated(at.y, end.y))
        doubt = self.looked_at(c, t1, end, size <= 1.0)
        return Tried(t1, end, size, lands, doubt)

    def tolerated(self, a: HybridState, b: HybridState) -> Array:
        """Error that a step may have [unit of the state].

        Of a slip no more than its share, so that its direction is known until it ends:
        derivatives by it would otherwise miss what friction does across it, last.
        """
        known = unpack(self.atol, a)
        of_slip = jnp.minimum(known.slip, np.finfo(known.slip.dtype).eps)
        atol = eqx.tree_at(lambda y: y.slip, known, of_slip)
        larger: Callable[[Array, Array], Array] = lambda x, y: jnp.maximum(
            jnp.abs(x), jnp.abs(y)
        )
        size = jax.tree.map(larger, a, b)
        whole = jnp.full_like(size.slip, jnp.max(size.slip))
        size = eqx.tree_at(lambda y: y.slip, size, whole)
        return pack(atol) + self.rtol * pack(size)

    def looked_at(
        self, c: Run, t1: Float[Array, ""], end: Step, good: Bool[Array, ""]
    ) -> Doubt:
        """Whether an event may hide in a step."""
        motion, at = self.motion, c.place
        flies = at.mode == Mode.FLYING
        least = jnp.min(end.values / _scale(c.values))
        quiet = good & (least >= -at_precision(_ROOT, least)) & (c.cuts < _CUTS)
        last = motion.tableau.nodes.shape[0] - 1
        one = jnp.ones_like(t1)
        clear = Doubt(jnp.asarray(False), one, jnp.inf * one)
        stages = end.seen[: last + 1]
        near = ~stays_positive(jnp.min(stages, axis=0), jnp.max(stages, axis=0))
        closer = lambda: between(motion.nodes, end.seen, last)
        doubt = cast(Doubt, jax.lax.cond(quiet & ~flies & near, closer, lambda: clear))
        if not motion.lands:
            return doubt
        nodes, scene = motion.tableau.nodes, motion.scenes.flying
        gap, reach = c.values[0], self.reach
        assert reach is not None
        fly = lambda: doubt_in_flight(scene, nodes, at, t1, end, gap, reach)
        return cast(Doubt, jax.lax.cond(quiet & flies, fly, lambda: doubt))

    def least_value(self, c: Run) -> Array:
        """The least of the events' values that is not behind an event.

        A gap opens as the third power of time where the normal force has vanished: for
        as long as it is rounding it may have either sign.
        """
        zero = jnp.zeros_like(c.place.t)
        if self.reach is None:
            return zero
        opens = (c.place.mode == Mode.FLYING) & jnp.isnan(c.values[0])
        return jnp.where(opens, -rounding(c.place.y, self.reach), zero)

    def falls_back(
        self, c: Run, tried: Tried, rate: Float[Array, ""]
    ) -> tuple[Array, Array, Array]:
        """Whether a flight ends where it begins, or has come to its landing at once.

        Where it begins: its body comes back, or never left. Its gap is rounding then,
        but as it would be from how fast it closes: that of a force that vanished would
        be a third power, and opens. If it closes faster it has been higher.

        And whether the body stays if it does so behind a change: it has risen by a
        rounding, as it comes no faster than by an acceleration of 100 m/s^2. What
        touches at the start of a run, or elsewhere, has a speed of its own.
        """
        if self.reach is None:
            never = jnp.asarray(False)
            return never, never, never
        gap, slack = tried.end.values[0], rounding(c.place.y, self.reach)
        fresh = (c.place.mode == Mode.FLYING) & jnp.isnan(c.values[0])
        closes = rate * (tried.t - c.place.t)
        high = closes < -8.0 * slack  # a fall from rest: 2 to 3 gaps, 6 at most
        # by one rounding of the 64 at least
        falls = (jnp.abs(gap + slack) <= slack) & ~high
        falls &= closes <= jnp.minimum(gap, -slack / 64.0)
        slow = jnp.abs(rate) <= jnp.sqrt(_FALLS * slack)
        stays = fresh & slow & (c.path.switches.count > 0)
        return fresh & falls, fresh & high & (gap <= slack), stays

    def rate_of(self, at: Place, tried: Tried, kind: Int[Array, ""]) -> Array:
        """About how fast an event's value changes at the end of a step."""
        motion, end = self.motion, tried.end
        last = motion.tableau.nodes.shape[0] - 1
        rate = rate_at_end(end.seen, last)[kind] / (tried.t - at.t)
        if not motion.lands:
            return rate
        opens = closing(motion.scenes.flying, tried.t, end.y.flying())[0]
        return jnp.where(at.mode == Mode.FLYING, opens, rate)

    def judged(self, c: Run, tried: Tried) -> Verdict:
        """Whether the step stands, and whether it ends on an event."""
        size, taken = tried.size, tried.t - c.place.t
        # a few numbers of the clock: no shorter step can be made
        tiny = 4.0 * np.finfo(self.times.dtype).eps * (1.0 + jnp.abs(c.place.t))
        share = self.shares(c, tried.end.values)
        least = jnp.min(share)
        size = jnp.where(self.stands(c, tried), size, jnp.inf)
        known = jnp.isfinite(least)
        # an output right behind an event: nothing can happen, or be seen, between
        fresh, looks = jnp.isnan(c.values[0]), c.looks
        short = at_precision(STAYS, taken) * (1.0 + jnp.abs(c.place.t))
        brief = taken <= jnp.where(fresh, short, tiny)
        blinks = (tried.lands | looks) & brief & (size <= 1.0)
        kind = self.first_of(c, tried.end.values, share)
        watched = c.watched
        ends = False if watched is None else watched.ends_on_change(taken, tiny)
        value, rate = tried.end.values[kind], self.rate_of(c.place, tried, kind)
        falls, landed, stays = self.falls_back(c, tried, rate)
        # one search at a time: a try within a step that stood has no change to look for
        below = ~(least >= self.least_value(c)) & ~blinks
        negative = (below | falls | landed) & ~looks
        # right behind a change the values may be zero: a step that ends on a negative
        # one was too long, unless it stays so: then the mode cannot even begin
        behind = fresh & negative & known
        at_once = behind & (size <= 1.0) & (falls | (0.2 * taken <= tiny))
        early = behind & ~at_once
        # not for a value that comes to its zero only now
        since = at_once & (falls | (jnp.abs(value) >= jnp.abs(rate) * short))
        hides = tried.doubt.hides & known & ~brief & ~looks
        good = (size <= 1.0) & (known | blinks) & ~behind & ~hides
        begins = good & negative & ~c.searching
        flies = c.place.mode == Mode.FLYING
        bracket = c.bracket.after(begins, taken, value, rate, flies)
        exact, closed = self.located(c, tried, least, begins, bracket, tiny)
        found = known & ~hides & exact
        turned = found & self.motion.ends_slip(c.place.mode, kind)
        turned &= has_turned(c.place, tried.end)
        event = (found & ~turned) | at_once | (good & ends)
        accept = (good & ~negative & ~c.searching) | event | turned
        step = self.next_step(tried, taken, size, early | ~known)
        step = jnp.where(c.searching | begins, c.step, step)
        # what hides in a step is looked for in a shorter one
        cut = jnp.clip(tried.doubt.share, 0.1, 0.9) * taken
        step = jnp.where(hides, cut, step)
        step = jnp.where(accept, self.behind(c, tried, step, event, tiny), step)
        stuck = ~accept & ~hides & jnp.where(c.searching, closed, ~(step > tiny))
        searching = (begins | c.searching) & ~event & ~turned & ~hides
        cuts = jnp.where(accept | ~hides, 0, c.cuts + 1)
        ended = accept, event, since, since & stays, turned, kind
        return Verdict(*ended, searching, bracket, step, cuts, stuck, blinks)

    def located(
        self,
        c: Run,
        tried: Tried,
        least: Float[Array, ""],
        begins: Bool[Array, ""],
        bracket: Bracket,
        tiny: Float[Array, ""],
    ) -> tuple[Array, Array]:
        """Whether a step ends on what is looked for, and whether no try is left."""
        closed = bracket.high - bracket.low <= tiny
        off = jnp.abs(bracket.off)
        # no closer: rounding is what is left of the value
        stays = jnp.abs(bracket.value) >= jnp.abs(c.bracket.value)
        stays &= off <= at_precision(STAYS, off) * (1.0 + jnp.abs(tried.t))
        root = jnp.abs(least) <= at_precision(_ROOT, least)
        exact = root | (off <= tiny) | closed | stays
        # what is left until a change may be too short for the clock from the start
        return jnp.where(c.searching, exact, begins & closed), closed

    def shares(self, c: Run, values: Float[Array, "2"]) -> Array:
        """The events' values over what they were.

        A slip that begins has the direction of its friction, which is rounding where
        the contact ends: that it ends there is not said of it.
        """
        share = values / _scale(c.values)
        blind = (c.place.mode == Mode.SLIPPING) & begins(c.place.direction)
        blind &= jnp.abs(share[1]) <= at_precision(_TOGETHER, share)
        return share.at[0].set(jnp.where(blind, 1.0, share[0]))

    def first_of(
        self, c: Run, values: Float[Array, "2"], share: Float[Array, "2"]
    ) -> Array:
        """Which event comes first, of those that a step ends behind: the worst.

        Where the contact ends, so does its grip: what counts is that it ends, if no
        friction is left there. Else the grip was lost before, and is looked for. Of
        values that are rounding no share is known: it is the one that was looked for.
        """
        worst, hold = jnp.argmin(share), self.motion.modes.sticking
        together = at_precision(_TOGETHER, values)
        least = -together * _scale(c.values)[0]
        if hold is not None:
            # grip behind the normal force's zero, where friction goes to zero with it:
            # -sqrt(m^2 + |T|^2) of |T| < |m|, 1.4 |m| at most (ModeRates._grip)
            spent = 2.0 * hold * jnp.abs(values[1]) + together * _scale(c.values)[1]
            least = jnp.where(c.place.mode == Mode.ROLLING, -spent, least)
        kind = jnp.where((share[1] <= together) & (values[0] >= least), 1, worst)
        lasts = c.looks | (c.searching & (share[kind] > together))
        return jnp.where(lasts, c.kind, kind)

    def next_step(
        self,
        tried: Tried,
        taken: Float[Array, ""],
        size: Float[Array, ""],
        early: Bool[Array, ""],
    ) -> Array:
        """An integral controller with diffrax's margin and lower limit.

        It grows by five at most: behind a change the step before it says little. And
        no longer than is worth trying, as an event would hide in it.
        """
        factor = 0.9 * jnp.maximum(size, 1e-10) ** (-1.0 / self.order)
        factor = jnp.clip(factor, 0.2, 5.0)
        factor = jnp.where(jnp.isnan(size) | early, 0.2, factor)
        return jnp.minimum(taken * factor, tried.doubt.next)

    def behind(
        self,
        c: Run,
        tried: Tried,
        step: Float[Array, ""],
        event: Bool[Array, ""],
        tiny: Float[Array, ""],
    ) -> Array:
        """How long the step behind one that stands is tried."""
        # behind a change shorter ones would see rounding, and take it for another: of
        # this one six digits are above that of the clock (in double precision)
        digits = 1.0 / at_precision(1e-6, tiny)
        step = jnp.where(event, jnp.maximum(step, digits * tiny), step)
        step = jnp.where(tried.lands, jnp.maximum(step, c.step), step)
        before = c.place, c.values[0], tried.t, tried.end
        settles = longest_step(*before, self.motion.onset)
        return jnp.where(event, step, jnp.minimum(step, settles))

    def stands(self, c: Run, tried: Tried) -> Array:
        """Whether no normal passed where its contact jumps, nor the body its base.

        Nor a slip that begins what it begins as.
        """
        at, reach = c.place, self.reach
        scene = self.motion.scenes.rolling
        stands = is_as_it_began(at, tried.t, tried.end, self.motion.onset)
        y = tried.end.y
        if watches_headings(scene):
            ends = headings(scene, at.t, at.y), headings(scene, tried.t, y)
            for a, b in zip(*ends, strict=True):
                stands &= dot(a, b) > least_product(self.rtol)
            stands |= at.mode == Mode.FLYING
        if reach is not None and scene.base.surface.has_face:
            flight = at, tried.t, tried.end, c.values[0], reach
            near = closes_as_it_may(self.motion.scenes.flying, *flight)
            stands &= near | (at.mode != Mode.FLYING)
        if self.allowed is None:
            return stands
        return stands & as_it_is(self.allowed, scene, tried.t, at.mode, y)


def _scale(values: Array) -> Array:
    """What the events' values are measured by: what they were, if that is known."""
    return jnp.where(values > 0.0, values, 1.0)
