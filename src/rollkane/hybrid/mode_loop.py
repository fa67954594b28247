"""The loop of steps of a run in modes: try a step, judge it, change the mode.

Where a step ends on an event (``step_trial``) the mode changes. The results do not
depend on which outputs are asked for.
"""

from collections.abc import Callable
from typing import cast

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ..dynamics.clearance import depth_of_touch
from ..dynamics.directed_friction import begins
from ..dynamics.flight_ends import lies_level, off_an_end
from ..dynamics.nearest_on_face import faces, has_face
from ..geometry.small_linear import dot
from ..integration.event_search import layout_of
from ..integration.longest_step import LEAST_STEPS
from ..integration.plans import UNRECORDED_STEPS
from ..integration.step_control import first_step
from ..kinematics.coordinates import pack
from ..validation.codes import Code
from .event_location import Bracket
from .mode_rates import picked
from .mode_replay import Path, Place, Record
from .modes import HybridState, Mode
from .step_trial import Run, Trials, Tried, Verdict
from .transitions import Begun
from .user_events import (
    Look,
    Watched,
    behind,
    first_lost,
    looked_at,
    with_places,
)

# Steps that a derivative can follow where none are asked for: about 0.3 kB each.
RECORDED_STEPS = 2**14


class Loop(Trials):
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

    def step(self, c: Run) -> Run:
        """One turn of the loop."""
        tried = self.tried(c)
        verdict = self.judged(c, tried)
        kind, at, end = verdict.kind, c.place, tried.end
        slid, after = self._behind(at, tried, verdict)
        ends_off = verdict.event & self.lands_off_surfaces(at, tried)
        lost = verdict.event & ~ends_off & ~jnp.all(jnp.isfinite(pack(after.y)))
        jammed = lost & self.motion.jams(after.y)
        # where nothing follows the run ends on the event, as it came there
        ends = ends_off | lost
        event = verdict.event & ~ends
        after = picked(ends, Place(tried.t, end.y, at.mode, at.direction), after)
        full = event & (c.path.switches.count >= self.motion.modes.switches)
        accept = verdict.accept & ~full
        look = self.looks_for_events(c, tried, accept, event)
        accept = accept if look is None else look.stands
        happens = event & accept
        lands = tried.lands & accept
        # a step ends before a jump, even if that is an output
        begin = self.landings.starts[c.landing]
        saves = lands & (begin >= self.times[c.path.reached])
        output = jnp.where(saves, last_at(self.times, c.path.reached), 0)
        following = after
        if self.landings.behind is not None:
            following = after._replace(t=jnp.where(lands, begin, tried.t))
        watched, shown, record = c.watched, output, c.record
        if look is not None and watched is not None:
            look = behind(self.events, self.motion, look, watched, happens, after)
            layout, outputs = layout_of(self.events), self.times.shape[0]
            watched = watched.looked(look, event)
            watched, shown = watched.kept(layout, look.fires, tried.t, output, outputs)
        if record is not None:
            value = jnp.where(verdict.since, jnp.inf, end.values[kind])
            value = jnp.where(verdict.rests, -jnp.inf, value)
            row = tried.t, following.t, jnp.where(event, kind, -1), value, shown
            record = record.after(accept, row, following, happens, slid)
        code = jnp.where(full, Code.TOO_MANY_SWITCHES, c.code)
        code = self._code(c, tried, code, verdict.stuck, lost, ends_off)
        code = jnp.where(jammed, self.motion.code_of_jam, code)
        values = self.values_after(c, end.values, event, after, verdict.blinks)
        path = c.path.after(shown, happens, at.mode, *after)
        if look is not None:
            reached = jnp.where(output > 0, path.reached, c.path.reached)
            path = path._replace(reached=reached)
        run = Run(
            place=picked(accept, following, at),
            step=self._bounded(verdict.step, record),
            values=picked(accept, values, c.values),
            kind=kind,
            searching=verdict.searching,
            bracket=verdict.bracket,
            cuts=verdict.cuts,
            landing=jnp.where(lands, self.landings.following(tried.t), c.landing),
            path=path,
            record=record,
            accepted=c.accepted + jnp.where(accept, 1, 0),
            tried=c.tried + 1,
            code=code,
            watched=watched,
        )
        return run if look is None else self.judged_again(c, tried, look, run)

    def _behind(
        self, at: Place, tried: Tried, verdict: Verdict
    ) -> tuple[HybridState, Place]:
        """The end of a step: its state before it changes anything, and what follows."""
        motion, end = self.motion, tried.end
        event, kind = verdict.event, verdict.kind
        ends = event & motion.ends_slip(at.mode, kind)
        begun = motion.has_begun(at.mode, at.direction, end.y, ends)
        straight = lambda: motion.straightened(end.way, tried.t, end.y, begun)
        slid = cast(HybridState, jax.lax.cond(begun, straight, lambda: end.y))
        before = at.mode, kind, at.direction, tried.t, slid
        changed = lambda: motion.changed(*before, event, verdict.rests)
        # what begins is looked for from where it was last: its way may turn round
        first = (at.mode == Mode.SLIPPING) & begins(at.direction)
        way = jnp.where(first, 0.5 * end.way, at.direction)
        same = lambda: (at.mode, way, slid)
        mode, direction, y = cast(Begun, jax.lax.cond(event, changed, same))
        way = motion.along(mode, direction, y, verdict.turned)
        return slid, Place(tried.t, y, mode, way)

    def _bounded(
        self, step: Float[Array, ""], record: Record | None
    ) -> Float[Array, ""]:
        """A step of a run that is differentiated is a share of the whole at most."""
        if record is None:
            return step
        return jnp.minimum(step, jnp.abs(self.times[-1] - self.times[0]) / LEAST_STEPS)

    def looks_for_events(
        self,
        c: Run,
        tried: Tried,
        accept: Bool[Array, ""],
        event: Bool[Array, ""],
    ) -> Look | None:
        """What a step that is accepted has of the user's events; None without any."""
        if c.watched is None:
            return None
        at, y = c.place, tried.end.y
        way = self.motion.along(at.mode, at.direction, y)
        end = Place(tried.t, y, at.mode, way)
        judged = at.t, end, accept, event
        return looked_at(self.events, self.motion, c.watched, *judged)

    def judged_again(self, c: Run, tried: Tried, look: Look, run: Run) -> Run:
        """What follows a step behind which there was an event, or one on it."""
        assert run.watched is not None
        taken = tried.t - c.place.t
        shorter = 0.2 * taken
        step = jnp.where(c.looks & look.stands, jnp.maximum(run.step, c.step), run.step)
        step = jnp.where(look.again, c.step, jnp.where(look.blind, shorter, step))
        tiny = 4.0 * np.finfo(taken.dtype).eps * (1.0 + jnp.abs(c.place.t))
        unseen = jnp.any(jnp.isnan(run.watched.search.values))
        lost = look.blind & (unseen | (shorter <= tiny))
        by = jnp.where(lost, first_lost(look, run.watched), run.watched.by)
        stops = look.fires & jnp.asarray(layout_of(self.events).stops)
        code = jnp.where(jnp.any(stops), Code.STOPPED, run.code)
        code = jnp.where(look.again | look.blind, c.code, code)
        refused = look.again | look.blind
        return run._replace(
            step=step,
            searching=run.searching & ~refused,
            cuts=jnp.where(refused, 0, run.cuts),
            code=jnp.where(lost, Code.EVENT_NOT_FINITE, code),
            watched=run.watched._replace(by=by),
        )

    def values_after(
        self,
        c: Run,
        values: Float[Array, "2"],
        event: Bool[Array, ""],
        after: Place,
        blinks: Bool[Array, ""],
    ) -> Array:
        """The events' values where the next step begins: of a slip, along its own way.

        They stay unknown through an output right behind a change, and while what opens
        is rounding.
        """
        slip = dot(after.y.slip, after.direction)
        slides = (after.mode == Mode.SLIPPING) & (slip > 0.0)
        slides &= ~begins(after.direction) & self.motion.friction_ends_slips
        values = jnp.where(slides, values.at[0].set(slip), values)
        known = jnp.all(values >= -self.least_value(c)) & ~blinks
        behind = jnp.isnan(c.values[0]) & ~known
        return jnp.where(event | behind, jnp.nan, values)

    def lifts_into_its_base(self, c: Run, tried: Tried) -> Array | bool:
        """Whether a flight cannot begin, as the body is in its base elsewhere.

        It came there in contact, when only the contact is looked at.
        """
        if self.reach is None:
            return False
        begins = (c.path.switches.count > 0) & jnp.isnan(c.values[0])
        deep = tried.end.values[0] < -depth_of_touch(self.reach)
        return (c.place.mode == Mode.FLYING) & begins & deep

    def lands_off_surfaces(self, at: Place, tried: Tried) -> Array | bool:
        """Whether a flight ends where no surface is: on a face, or behind a rim.

        The face of the body would come to lie on the base, not its rim, or the whole
        circle of a ring; and behind the end of a meridian is only what would continue
        it.
        """
        scene = self.motion.scenes.flying
        if self.reach is None:
            return False
        state = tried.end.y.flying()
        off = off_an_end(scene, state) | lies_level(scene, tried.t, state)
        if has_face(scene):
            off = off | faces(scene, tried.t, state)
        return (at.mode == Mode.FLYING) & off

    def _code(
        self,
        c: Run,
        tried: Tried,
        code: Array,
        stuck: Bool[Array, ""],
        lost: Bool[Array, ""],
        ends_off: Bool[Array, ""],
    ) -> Array:
        """Why a run ends here: as it was, unless a step or what follows it fails."""
        code = jnp.where(stuck, Code.STEP_TOO_SMALL, code)
        code = jnp.where(lost, self.code_of_loss(c.place.mode), code)
        code = jnp.where(ends_off, Code.SURFACE_EDGE, code)
        deep = (stuck | lost) & self.lifts_into_its_base(c, tried)
        return jnp.where(deep, Code.SECOND_CONTACT, code)

    def code_of_loss(self, mode: Int[Array, ""]) -> Array:
        """Why there is no state behind an event."""
        code = jnp.asarray(Code.STEP_TOO_SMALL)
        if self.motion.modes.impact != "newton":
            return code
        return jnp.where(mode == Mode.FLYING, Code.INCONSISTENT_IMPACT, code)

    def run(
        self,
        mode: Int[Array, ""],
        y: HybridState,
        max_steps: int | None,
        recording: bool,
    ) -> Run:
        """From the start to the last time, or to where it cannot go on."""
        most = most_steps(max_steps, recording)
        begun = self.begun(mode, y, most if recording else 0)
        going: Callable[[Run], Array] = lambda c: self.going(c, most)
        return jax.lax.while_loop(going, lambda c: self.step(c), begun)

    def going(self, c: Run, max_steps: int) -> Bool[Array, ""]:
        """Whether a run goes on."""
        more = c.path.reached < self.times.shape[0]
        return more & (c.code == 0) & (c.tried < max_steps)

    def lane(self, c: Run) -> Int[Array, ""]:
        """1 or 2 where a plain step of a contact that rolls or slips may follow.

        The step itself says whether it is plain (``mode_lanes``); 0: it cannot be.
        """
        at = c.place
        idle = jnp.all(jnp.isfinite(c.values) & (c.values > 0.0))
        idle &= ~c.searching & (c.cuts == 0)
        slips = (at.mode == Mode.SLIPPING) & ~begins(at.direction)
        which = jnp.where(at.mode == Mode.ROLLING, 1, jnp.where(slips, 2, 0))
        return jnp.where(idle, which, 0)

    def begun(self, mode: Int[Array, ""], y: HybridState, recorded: int) -> Run:
        """The loop's first value."""
        t, whole = self.times[0], jnp.asarray(0)
        mode, direction, y = self.motion.begun(mode, t, y)
        begun, switches = Place(t, y, mode, direction), self.motion.modes.switches
        span = jnp.abs(self.times[-1] - t)
        watched, places = None, self.times
        if self.events:
            watched = Watched.begun(self.events, self.motion, begun)
            places = with_places(self.times, layout_of(self.events).capacity)
        zero = jnp.zeros_like(t)
        record = Record.empty(recorded, begun, switches) if recorded else None
        return Run(
            place=begun,
            step=self._bounded(first_step(y.angular_velocity, span), record),
            values=jnp.full(2, jnp.nan, t.dtype),
            kind=whole,
            searching=jnp.asarray(False),
            bracket=Bracket(*(zero for _ in Bracket._fields)),
            cuts=whole,
            landing=self.landings.following(t),
            path=Path.empty(begun.moded, places, switches),
            record=record,
            accepted=whole,
            tried=whole,
            code=whole,
            watched=watched,
        )


def most_steps(asked: int | None, recording: bool) -> int:
    """Steps that may be tried, and are recorded."""
    if asked is not None:
        return asked
    return RECORDED_STEPS if recording else UNRECORDED_STEPS


def last_at(times: Float[Array, " T"], index: Int[Array, ""]) -> Array:
    """Number of the last output at the time of one."""
    time = times[jnp.minimum(index, times.shape[0] - 1)]
    return jnp.searchsorted(times, time, side="right").astype(int) - 1
