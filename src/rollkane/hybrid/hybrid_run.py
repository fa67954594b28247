"""Runs that change between rolling, slipping and flight, as the contact demands.

One loop of steps for all modes: an accepted step after which an event function is
negative is taken back and shortened until it ends on the zero, by a bracketing secant;
there the mode changes. Derivatives are those of the recorded steps, replayed.
"""

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ..codegen import in_one_program, in_one_program_or_not
from ..codegen.tableau import tableau_of
from ..dynamics.clearance import code_of_touch, reach_of
from ..dynamics.consistency import consistent
from ..dynamics.rolling import LEAST_MARGIN, painleve_margin
from ..dynamics.rolling_problem import at_an_edge, has_edges
from ..dynamics.scene import Scene
from ..integration.differentiate import differentiable
from ..integration.event_search import Happened, layout_of
from ..integration.integrate import in_order
from ..integration.plans import without_derivative
from ..integration.step_control import Stops, landings
from ..kinematics.coordinates import State
from ..validation.checks import FieldError, cleared
from ..validation.codes import NO_FAULT, Code, first_fault, is_stuck
from .mode_adjoint import Cotangents, Make, pulled_back
from .mode_loop import Loop
from .mode_replay import Path, Place, Record, replayed
from .modes import HybridScene, HybridState, Mode, ModedState, Switches, of, slipping
from .step_trial import Allowed, Run, as_it_is
from .transitions import Motion
from .user_events import Kept, at_their_zeros, with_places

# Scene, start, output times [s], tolerances, NaN if the start is spoilt, and events.
_Inputs: TypeAlias = tuple[HybridScene, HybridState, Array, Array, Array, Array, Any]
# Times at which a scene's rates have a corner [s], and whether they may jump there.
_Corners: TypeAlias = Callable[[HybridScene], tuple[Array | None, bool]]


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
    kept: Kept | None = None  # events, as the loop left them
    happened: Happened | None = None  # with states

    @property
    def unknown(self) -> "HybridOutcome":
        """What of it has no derivative."""
        return without_derivative(self, ("final_time", "final_state"))


def integrate_modes(
    scene: HybridScene,
    start: State,
    times: Float[Array, " T"],
    stops: Stops,
    rtol: Array,
    atol: Array,
    solver: dfx.AbstractSolver[Any],
    max_steps: int,
    corners: _Corners,
    allowed: Allowed | None = None,
    native: bool = False,
    events: Any = (),
) -> HybridOutcome:
    """Integrate through all changes of the mode, to the asked times.

    Args:
        scene: With the modes of its contact.
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
        native: Whether the loop is compiled as C, and its derivatives where they can
            be; else all by XLA.
        events: Of the user's own; differentiable.
    """
    mode = Mode.SLIPPING if start.slips else Mode.ROLLING
    mode = mode if start.touches else Mode.FLYING
    runs = _Runs(mode, solver, max_steps, corners, allowed, native)
    increasing = in_order(times) & ~(times[0] > times[-1])
    fault, code_of_fault = first_fault(scene, of(start), increasing)
    good = fault == NO_FAULT
    rolling = scene.in_modes.rolling
    start = of(consistent(rolling, jax.lax.stop_gradient(times[0]), start))
    # NaN would keep the step controller going for ever; zero stops it at the start
    clear: Callable[[Array], Array] = lambda x: cleared(x, good)
    start = jax.tree.map(clear, start)
    spoilt = jnp.where(good, 0.0, jnp.nan).astype(times.dtype)
    fixed = jax.lax.stop_gradient(events)
    inputs = scene, start, stops.time, rtol, atol, spoilt, fixed
    unknown: Callable[[HybridOutcome], HybridOutcome] = lambda s: s.unknown
    found: HybridOutcome = differentiable(
        runs.solve,
        inputs,
        push=runs.push if native else None,
        pull=runs.pull,
        twice=_refuse_twice,
        unknown=unknown,
    )
    if events:
        found = _with_events(found, runs, scene, times, events, good)
    state = found.state
    if stops.last is not None:
        shown: Callable[[Array], Array] = lambda x: x[stops.last]
        state = jax.tree.map(shown, state)
    code = jnp.where(good, found.code, code_of_fault)
    return dataclasses.replace(found, state=state, code=code, fault=fault)


def _with_events(
    run: HybridOutcome,
    runs: "_Runs",
    scene: HybridScene,
    times: Float[Array, " T"],
    events: Any,
    good: Array,
) -> HybridOutcome:
    """With events by themselves, as they move, and the end that one made."""
    kept = run.kept
    assert kept is not None
    row = kept.row
    used = ~jnp.isnan(kept.time)

    def shown(x: Array) -> Array:
        blank = jnp.asarray(-1 if x.dtype.kind == "i" else jnp.nan, x.dtype)
        some = used.reshape(-1, *[1] * (x.ndim - 1))
        return jnp.where(some, x[row], blank)

    # an output's time moves the end of its step
    asked = with_places(times, row.shape[0])[row]
    moved = jnp.where(used, asked - jax.lax.stop_gradient(asked), 0.0)
    found = Happened(
        kept.time + moved,
        jax.tree.map(shown, run.state),
        jnp.where(good, kept.number, 0),
        jnp.where(good, kept.by, -1),
    )
    make: Callable[[HybridScene], Motion] = lambda scene: runs.motion(scene, times)
    span = jax.lax.stop_gradient(jnp.abs(times[-1] - times[0]))
    found = at_their_zeros(events, make, scene, found, span)
    ended = run.code == Code.STOPPED
    first = jnp.asarray(layout_of(events).firsts)[jnp.maximum(found.by, 0)]
    last: Callable[[Array, Array], Array] = lambda own, kept: jnp.where(
        ended, kept[first], own
    )
    outputs: Callable[[Array], Array] = lambda x: x[: times.shape[0]]
    return dataclasses.replace(
        run,
        state=jax.tree.map(outputs, run.state),
        final_time=last(run.final_time, found.time),
        final_state=jax.tree.map(last, run.final_state, found.y),
        happened=found,
        kept=None,
    )


class _Runs(NamedTuple):
    """Runs from one kind of start, of inputs: scene, state, times and tolerances."""

    mode: int
    solver: dfx.AbstractSolver[Any]
    max_steps: int
    corners: _Corners
    allowed: Allowed | None
    native: bool

    def made(self, inputs: _Inputs) -> tuple[Motion, HybridState, Float[Array, " T"]]:
        """Motion, state and times, those of places for events behind them."""
        scene, y, times, *_, events = inputs
        if events:
            times = with_places(times, layout_of(events).capacity)
        return self.motion(scene, times), y, times

    def motion(self, scene: HybridScene, times: Float[Array, " T"]) -> Motion:
        """Rates, events and changes."""
        tableau = tableau_of(self.solver, times.dtype)
        return Motion(scene.in_modes, scene.modes, tableau)

    def stepped(
        self, inputs: _Inputs, recording: bool
    ) -> tuple[HybridOutcome, Record | None]:
        """A run by adaptive steps, and its record."""
        motion, y, _ = self.made(inputs)
        scene, _, times, rtol, atol, spoilt, events = inputs
        order = self.solver.order(dfx.ODETerm(lambda t, y, args: y))
        where = landings(times, *self.corners(scene))
        reach = reach_of(scene.body.surface, times.dtype) if motion.lands else None
        assert order is not None
        how = rtol, atol, order, self.allowed, events
        loop = Loop(motion, times, where, reach, *how)
        c = loop.run(jnp.asarray(self.mode), y, self.max_steps, recording)
        return _ended(motion, c, times.shape[0], self.allowed, spoilt), c.record

    def repeated(self, inputs: _Inputs, record: Record) -> HybridOutcome:
        """The same by recorded steps."""
        motion, y, times = self.made(inputs)
        path, t, last = replayed(motion, jnp.asarray(self.mode), y, times, record)
        found = _outcome(path, t, last, None, None, None)
        events = inputs[-1]
        if not events:
            return found
        # where steps ended on events does not move along them
        fixed = jnp.zeros(layout_of(events).capacity, times.dtype)
        none = jnp.zeros(0, int)
        return dataclasses.replace(found, kept=Kept(fixed, none, none, none))

    def solve(
        self, inputs: _Inputs, replay: Record | None, adjoint: object
    ) -> tuple[HybridOutcome, Record | None]:
        """One of the functions of ``integration.differentiate.differentiable``."""
        if replay is not None:
            return self.repeated(inputs, replay), None
        call = in_one_program if self.native else _called
        return call(self.stepped, inputs, adjoint is not None)

    def push(
        self,
        inputs_of: Callable[[Any], _Inputs],
        varied: Any,
        record: Record,
        tangents: Any,
        once: object,
    ) -> list[Array]:
        """Tangents, of recorded steps."""
        del once

        def pushed(varied: Any, record: Record, tangents: Any) -> list[Array]:
            outputs: Callable[[Any], list[Array]] = lambda varied: _floats(
                self.repeated(inputs_of(varied), record)
            )
            return jax.jvp(outputs, (varied,), (tangents,))[1]

        one: Callable[[Any], list[Array]] = lambda tangents: in_one_program_or_not(
            pushed, varied, record, tangents
        )
        return jax.vmap(one)(tangents)

    def pull(
        self,
        inputs_of: Callable[[Any], _Inputs],
        varied: Any,
        record: Record,
        cotangents: HybridOutcome,
        once: object,
    ) -> list[Array]:
        """Cotangents, of recorded steps."""
        del once

        def pulled(varied: Any, record: Record, cotangents: Cotangents) -> Any:
            make: Make = lambda varied: self.made(inputs_of(varied))
            return pulled_back(make, varied, jnp.asarray(self.mode), record, cotangents)

        of_path = cotangents.state, None, cotangents.switches
        parts = of_path, cotangents.final_time, cotangents.final_state
        call = in_one_program_or_not if self.native else _called
        return call(pulled, varied, record, parts)


def _called(function: Callable[..., Any], *arguments: Any) -> Any:
    """What a function gives, as a part of XLA's program."""
    return function(*arguments)


def _floats(outputs: Any) -> list[Array]:
    return jax.tree.leaves(eqx.filter(outputs, eqx.is_inexact_array))


def _ended(
    motion: Motion,
    c: Run,
    outputs: int,
    allowed: Allowed | None,
    spoilt: Float[Array, ""],
) -> HybridOutcome:
    """What came out of the loop, and why it ended."""
    code = jnp.where((c.code == 0) & (c.path.reached < outputs), Code.MAX_STEPS, c.code)
    stuck = (code == Code.STEP_TOO_SMALL) & (c.accepted == 0)
    code = jnp.where(stuck, Code.BAD_START, code)
    code = _explained(motion, allowed, code, c.place)
    t, last, rejected = c.place.t, c.place.moded, c.tried - c.accepted
    found = _outcome(c.path, t, last, code, c.accepted, rejected)
    states: Callable[[HybridOutcome], Any] = lambda s: (
        s.state,
        s.switches.state,
        s.final_state,
    )
    spoil: Callable[[Array], Array] = lambda x: (
        x + spoilt if eqx.is_inexact_array(x) else x
    )
    found = eqx.tree_at(states, found, jax.tree.map(spoil, states(found)))
    left = None if c.watched is None else c.watched.left
    return dataclasses.replace(found, kept=left)


def _refuse_twice(*arguments: object) -> None:
    """An event's time has its first derivative only: one Newton step of value zero."""
    del arguments
    problem = "has no second derivatives"
    remedy = "leave modes out, or take differences of first derivatives"
    raise FieldError("simulate.modes", "...", problem, remedy)


def _explained(
    motion: Motion, allowed: Allowed | None, code: Int[Array, ""], place: Place
) -> Array:
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
    touched: Callable[[Scene, Array, Any], Array] = lambda scene, t, y: code_of_touch(
        code, scene, t, y
    )
    return as_it_is(touched, scene, place.t, place.mode, place.y)


def _outcome(
    path: Path,
    t: Float[Array, ""],
    last: ModedState,
    code: Any,
    steps: Any,
    rejected: Any,
) -> HybridOutcome:
    none = jnp.asarray(NO_FAULT)
    parts = path.saved, path.switches, code, t, last, steps, rejected, none
    return HybridOutcome(*parts)
