"""Runs that change between rolling, slipping and flight, as the contact demands.

One loop of steps for all modes: an accepted step after which an event function is
negative is taken back and shortened until it ends on the zero, by a bracketing secant;
there the mode changes. Derivatives follow the recorded steps.
"""

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias, cast

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ..codegen import (
    in_one_program,
    in_one_program_or_not,
    with_known_zeros,
)
from ..codegen.linear_call import is_asked_for
from ..codegen.tableau import Weights, tableau_of, weights_of
from ..codegen.tracing import shared_in_c
from ..dynamics.clearance import reach_of
from ..dynamics.consistency import consistent
from ..dynamics.rolling_problem import error_sizes
from ..integration.differentiate import differentiable
from ..integration.event_search import Happened, layout_of
from ..integration.integrate import in_order
from ..integration.step_control import Stops, landings
from ..kinematics.coordinates import State, pack
from ..validation.checks import FieldError, cleared
from ..validation.codes import NO_FAULT, Code, first_fault
from .mode_adjoint import Cotangents, pulled_back
from .mode_lanes import one_or_many
from .mode_loop import Loop, most_steps
from .mode_replay import Record
from .mode_tangents import Make, pushed_on
from .modes import HybridScene, HybridState, Mode, of
from .outcome import HybridOutcome, ended, outcome_of
from .step_trial import Allowed, Run
from .transitions import Motion
from .user_events import Kept, at_their_zeros, of_normal_force, with_places

# Times at which rates of a scene have a corner [s]; how many numbers steps stay away.
_Corners: TypeAlias = Callable[[HybridScene], tuple[Array | None, int]]


class _Inputs(NamedTuple):
    """All that a run depends on.

    Attributes:
        scene: With the modes of its contact.
        start: As it is given.
        asked: Output times [s]; of no derivative.
        times: Those as the run stops on them [s].
        rtol: Relative tolerance [1].
        atol: Absolute tolerance.
        by_size: Whether that is of the numbers' sizes.
        events: Of no derivative.
    """

    scene: HybridScene
    start: State
    asked: Float[Array, " T"]
    times: Float[Array, " T"]
    rtol: Float[Array, ""]
    atol: Float[Array, ""]
    by_size: Bool[Array, ""]
    events: Any


def integrate_modes(
    scene: HybridScene,
    start: State,
    times: Float[Array, " T"],
    stops: Stops,
    rtol: Float[Array, ""],
    atol: Float[Array, ""],
    by_size: Bool[Array, ""],
    solver: dfx.AbstractSolver[Any],
    max_steps: int | None,
    corners: _Corners,
    allowed: Allowed | None = None,
    zeros: tuple[bytes, ...] | None = None,
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
        by_size: Whether that is in units of the state's sizes.
        solver: diffrax solver, an explicit Runge-Kutta method.
        max_steps: Most tried steps, or None.
        corners: ``corners(scene)`` -> times at which the rates have a corner [s], or
            None, and how many numbers steps stay away from them.
        allowed: ``allowed(scene, t, state)`` -> whether a step may end there; None:
            anywhere.
        zeros: For a loop in C and its derivatives, which numbers of the scene are zero
            (``codegen.zeros_of``); None: all by XLA.
        events: Of the user's own; differentiable.
    """
    mode = Mode.SLIPPING if start.slips else Mode.ROLLING
    mode = mode if start.touches else Mode.FLYING
    runs = _Runs(mode, solver, max_steps, corners, allowed, zeros)
    fixed = jax.lax.stop_gradient(events)
    asked = jax.lax.stop_gradient(times)
    inputs = _Inputs(scene, start, asked, stops.time, rtol, atol, by_size, fixed)
    unknown: Callable[[HybridOutcome], HybridOutcome] = lambda s: s.unknown
    found: HybridOutcome = differentiable(
        runs.solve,
        inputs,
        push=runs.push,
        pull=runs.pull,
        twice=_refuse_twice,
        unknown=unknown,
    )
    if events:
        found = _with_events(found, runs, scene, times, events)
    state = found.state
    if stops.last is not None:
        shown: Callable[[Array], Array] = lambda x: x[stops.last]
        state = jax.tree.map(shown, state)
    return dataclasses.replace(found, state=state)


def _with_events(
    run: HybridOutcome,
    runs: "_Runs",
    scene: HybridScene,
    times: Float[Array, " T"],
    events: Any,
) -> HybridOutcome:
    """With events by themselves, as they move, and the end that one made."""
    kept = run.kept
    assert kept is not None
    row = kept.row
    used = ~jnp.isnan(kept.time)
    good = run.fault == NO_FAULT

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
    make: Callable[[HybridScene], Motion]
    make = lambda scene: runs.motion(scene, times.dtype)
    span = jax.lax.stop_gradient(jnp.abs(times[-1] - times[0]))
    # a state that a change of the contact shows moves with the change, not at its time:
    # of it nothing is known by one Newton step of the event, whose value may even jump
    changes = jax.lax.stop_gradient(run.switches.time)
    at = kept.time[:, None] == changes[None]
    spans = jnp.where(jnp.any(at, axis=1), jnp.nan, span)
    shows = found.y
    found = at_their_zeros(events, make, scene, found, spans)
    found = _with_lift_offs(events, run, at, shows, found)
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


def _with_lift_offs(
    events: Any,
    run: HybridOutcome,
    at: Bool[Array, "R S"],
    shows: Any,
    found: Happened,
) -> Happened:
    """With events of the normal force that are the run's own lift-offs, as these move.

    Args:
        events: That were looked for.
        run: With its changes.
        at: Which events are at which change.
        shows: States there, which move with the change.
        found: Events; of those at a change nothing is known.
    """
    same = at & (run.switches.after == Mode.FLYING)[None]
    lifts = jnp.any(same, axis=1) & jnp.asarray(of_normal_force(events))
    time = run.switches.time[jnp.argmax(same, axis=1)]

    def moved(own: Array, x: Array) -> Array:
        return jnp.where(lifts.reshape(-1, *[1] * (x.ndim - 1)), own, x)

    y = jax.tree.map(moved, shows, found.y)
    return found._replace(time=moved(time, found.time), y=y)


class _Runs(NamedTuple):
    """Runs from one kind of start, of inputs: scene, state, times and tolerances."""

    mode: int
    solver: dfx.AbstractSolver[Any]
    max_steps: int | None
    corners: _Corners
    allowed: Allowed | None
    zeros: tuple[bytes, ...] | None

    @property
    def native(self) -> bool:
        """Whether runs and their derivatives are programs in C."""
        return self.zeros is not None

    def start(self, inputs: _Inputs) -> HybridState:
        """What a run begins with: a state that obeys its contact.

        NaN would keep the step controller going for ever: of anything spoilt it is
        zero, and the run stops there.
        """
        t, start = inputs.times[0], inputs.start
        start = of(consistent(inputs.scene.in_modes.rolling, t, start))
        good = self.fault(inputs)[0] == NO_FAULT
        clear: Callable[[Array], Array] = lambda x: cleared(x, good)
        return jax.tree.map(clear, start)

    def fault(self, inputs: _Inputs) -> tuple[Array, Array]:
        """Number of the field that cannot be used, and the code of a run with it."""
        tolerances = inputs.rtol, inputs.atol
        return _fault(inputs.scene, inputs.start, inputs.asked, tolerances)

    def times(self, inputs: _Inputs) -> Float[Array, " T"]:
        """Of outputs, and of the places for events behind them."""
        if not inputs.events:
            return inputs.times
        return with_places(inputs.times, layout_of(inputs.events).capacity)

    @property
    def weights(self) -> Weights:
        """Of the method."""
        return weights_of(self.solver, "a run with modes")

    def motion(self, scene: HybridScene, dtype: np.dtype) -> Motion:
        """Rates, events and changes."""
        if self.zeros is not None:
            scene = with_known_zeros(scene, self.zeros)
        tableau = tableau_of(self.solver, dtype)
        return Motion(scene.in_modes, scene.modes, tableau)

    def motion_of(self, inputs: _Inputs) -> Motion:
        """The same of inputs."""
        return self.motion(inputs.scene, inputs.times.dtype)

    def make(self, inputs_of: Callable[[Any], _Inputs]) -> Make:
        """What a run is made of, by what its inputs are made of."""
        part: Callable[[Callable[[_Inputs], Any]], Callable[[Any], Any]]
        part = lambda of: lambda varied: of(inputs_of(varied))
        return Make(part(self.motion_of), part(self.start), part(self.times))

    def loop(self, inputs: _Inputs) -> tuple[Loop, Array, HybridState]:
        """The loop of steps of a run, its first mode and its start."""
        scene, start, _, times, rtol, atol, by_size, events = inputs
        motion = self.motion_of(inputs)
        order = self.solver.order(dfx.ODETerm(lambda t, y, args: y))
        where = landings(times, *self.corners(scene))
        reach = reach_of(scene.body.surface, times.dtype) if motion.lands else None
        sizes = jax.lax.stop_gradient(pack(error_sizes(of(start))))
        atol = atol * jnp.where(by_size, sizes, 1.0)
        assert order is not None
        how = rtol, atol, order, self.allowed, events
        loop = Loop(motion, times, where, reach, *how)
        return loop, jnp.asarray(self.mode), self.start(inputs)

    def ended(self, inputs: _Inputs, c: Run) -> HybridOutcome:
        """What came out of a run."""
        motion = self.motion_of(inputs)
        fault = self.fault(inputs)
        return ended(motion, c, inputs.times.shape[0], self.allowed, *fault)

    def stepped(
        self, inputs: _Inputs, recording: bool
    ) -> tuple[HybridOutcome, Record | None]:
        """A run by adaptive steps, and its record."""
        loop, mode, y = self.loop(inputs)
        c = loop.run(mode, y, self.max_steps, recording)
        return self.ended(inputs, c), c.record

    def solve(
        self, inputs: _Inputs, replay: object, adjoint: object
    ) -> tuple[HybridOutcome, Record | None]:
        """One of the functions of ``integration.differentiate.differentiable``.

        Its steps are taken again by the two others.
        """
        del replay
        if self.native and adjoint is None:
            most = most_steps(self.max_steps, recording=False)
            run = one_or_many(self, inputs, most)
            return cast(HybridOutcome, run), None
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
            inputs, made = inputs_of(varied), self.make(inputs_of)
            mode, count = jnp.asarray(self.mode), inputs.scene.modes.switches
            dots = pushed_on(made, varied, mode, record, tangents, count)
            found = outcome_of(*dots, None, None, None)
            if inputs.events:
                # where steps ended on events does not move along them
                capacity = layout_of(inputs.events).capacity
                fixed = jnp.zeros(capacity, inputs.times.dtype)
                none = jnp.zeros(0, int)
                found = dataclasses.replace(found, kept=Kept(fixed, none, none, none))
            return _floats(found)

        call = in_one_program_or_not if self.native else _called
        one: Callable[[Any], list[Array]]
        one = lambda tangents: call(pushed, varied, record, tangents)
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

        of_path = cotangents.state, None, cotangents.switches
        parts = of_path, cotangents.final_time, cotangents.final_state
        asked, zeros = cast(tuple[Any, Any], eqx.partition(parts, is_asked_for))

        def pulled(varied: Any, record: Record, asked: Any) -> Any:
            made, mode = self.make(inputs_of), jnp.asarray(self.mode)
            cotangents = cast(Cotangents, eqx.combine(asked, zeros))
            return pulled_back(made, varied, mode, record, cotangents)

        call = in_one_program_or_not if self.native else _called
        return call(pulled, varied, record, asked)


@shared_in_c  # asked for at the start and at the end of a run
def _fault(
    scene: HybridScene,
    start: State,
    asked: Float[Array, " T"],
    tolerances: tuple[Array, Array],
) -> tuple[Array, Array]:
    """Number of the field that cannot be used, and the code of a run with it."""
    increasing = in_order(asked) & ~(asked[0] > asked[-1])
    return first_fault(scene, of(start), increasing, tolerances)


def _called(function: Callable[..., Any], *arguments: Any) -> Any:
    """What a function gives, as a part of XLA's program."""
    return function(*arguments)


def _floats(outputs: Any) -> list[Array]:
    return jax.tree.leaves(eqx.filter(outputs, eqx.is_inexact_array))


def _refuse_twice(*arguments: object) -> None:
    """An event's time has its first derivative only: one Newton step of value zero."""
    del arguments
    problem = "has no second derivatives"
    remedy = "leave modes out, or take differences of first derivatives"
    raise FieldError("simulate.modes", "...", problem, remedy)
