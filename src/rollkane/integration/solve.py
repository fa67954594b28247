"""One solve: by diffrax, or by the loop in C; adaptive, or along recorded steps."""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any, cast

import diffrax as dfx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ..codegen import Course, Looked, RunLoop, in_one_program_or_not, least_product
from ..codegen.tableau import is_plain, weights_of
from ..geometry.small_linear import dot
from ..kinematics.coordinates import unpack
from ..validation.codes import Code
from .diffrax_checks import checked_before
from .event_search import Happened, layout_of, values_of
from .longest_step import longest_step
from .plans import (
    RECORDED_STEPS,
    UNRECORDED_STEPS,
    Inputs,
    Plan,
    Rates,
    Record,
    Solution,
    Vectors,
)
from .refused_steps import Holds, refusing
from .replay import STEPS_BETWEEN
from .step_control import (
    AboveRounding,
    Landings,
    LandOn,
    Number,
    ReplaySteps,
    coarse,
    first_step,
)
from .watched_steps import (
    Watched,
    Watching,
    in_order,
    past_the_end,
    shown_again,
    with_events,
)


def solve(
    plan: Plan,
    rates: Rates,
    like: Any,
    inputs: Inputs,
    replay: Record | None,
    adjoint: dfx.AbstractAdjoint | None,
) -> tuple[Solution, Record | None]:
    """One solve; see :func:`rollkane.integration.differentiate.differentiable`.

    Args:
        plan: How.
        rates: ``rates(t, y, model)`` -> those of the packed state, shape (n,).
        like: Shapes of a state.
        inputs: Model, first packed state, times [s], where steps have to end,
            tolerances, first step [s] or None.
        replay: Record of steps to take; None: adaptive ones.
        adjoint: diffrax adjoint; None: it is not differentiated.

    Returns:
        What came out, and the record: where steps began, and the last one ended [s],
        how many there are, and for plain runs the states where every 16th began.
    """
    if plan.zeros is None:
        return _by_diffrax(plan, rates, like, inputs, replay, adjoint)
    return _natively(plan, rates, like, inputs, adjoint is not None)


def _by_diffrax(
    plan: Plan,
    rates: Rates,
    like: Any,
    inputs: Inputs,
    replay: Record | None,
    adjoint: dfx.AbstractAdjoint | None,
) -> tuple[Solution, Record | None]:
    model, y0, times, where, rtol, atol, _, events, *_ = inputs
    t0, t1 = times[0], times[-1]
    recording = replay is None and adjoint is not None and plan.adjoint is None
    if replay is not None:
        controller = ReplaySteps(times=replay[0], landings=where, rtol=rtol, atol=atol)
    else:
        controller = _chooser(plan, rates, like, inputs, recording)
    # they have their own first step, and refuse another
    stepped = isinstance(controller, (dfx.StepTo, ReplaySteps))
    dt0 = (
        None
        if stepped
        else jnp.where(t1 < t0, -1.0, 1.0) * _first_step(plan, like, inputs)
    )
    watches = bool(events) and replay is None
    max_steps = plan.max_steps
    if max_steps is None:
        custom = plan.saveat is not None or plan.controller is not None
        bounded = recording or replay is not None or custom
        max_steps = RECORDED_STEPS if bounded else UNRECORDED_STEPS
    solve = functools.partial(
        dfx.diffeqsolve, dfx.ODETerm(cast(Any, rates)), plan.solver
    )
    with checked_before(plan.saveat):
        solution = solve(
            *(t0, past_the_end(times) if watches else t1, dt0, y0, model),
            saveat=dfx.SaveAt(
                subs=_saved(plan, times, recording, replay, events),
                controller_state=watches,
            ),
            stepsize_controller=controller,
            adjoint=dfx.ForwardMode() if adjoint is None else adjoint,
            max_steps=max_steps,
            throw=False,
            progress_meter=plan.progress_meter,
        )
    time, final_time, *_ = cast("list[Array]", solution.ts)
    y, final_y, *recorded = cast("list[Array]", solution.ys)
    y = jnp.where(jnp.isfinite(y), y, jnp.nan)
    outcome = Solution(
        time=time,
        # diffrax leaves the start out where no step could be taken
        y=y.at[0].set(y0) if plan.saveat is None else y,
        final_time=final_time[-1],
        final_y=final_y[-1],
        code=_code(solution.result, final_time[-1] == t0),
        steps=solution.stats["num_accepted_steps"],
        rejected_steps=solution.stats["num_rejected_steps"],
    )
    if watches:
        outcome = with_events(outcome, cast(Watched, solution.controller_state), times)
    elif events and replay is not None:
        outcome = shown_again(outcome, events, replay[-1], recorded[-1], times)
    if not recording:
        return outcome, None
    # begins of steps, how many there are, what states were kept of them, and events
    record = recorded[0], outcome.steps, *recorded[1:]
    found = outcome.happened
    return outcome, record if found is None else (*record, found.time)


def _saved(
    plan: Plan,
    times: Float[Array, " T"],
    recording: bool,
    replay: Record | None,
    events: Any,
) -> list[dfx.SubSaveAt]:
    """What diffrax is to keep: outputs, the end, steps to record, known events."""
    given: Any = plan.saveat
    wanted = dfx.SubSaveAt(ts=times) if given is None else given.subs
    subs = [wanted, dfx.SubSaveAt(t1=True)]
    if recording:
        # kept as if they were states: diffrax works on all the times that it returns
        subs.append(dfx.SubSaveAt(t0=True, steps=True, fn=lambda t, y, args: t))
        if plain(plan, times):
            subs.append(dfx.SubSaveAt(t0=True, steps=STEPS_BETWEEN))
    if events and replay is not None:
        subs.append(dfx.SubSaveAt(ts=in_order(replay[-1], times)[0]))
    return subs


def _chooser(
    plan: Plan, rates: Rates, like: Any, inputs: Inputs, recording: bool
) -> dfx.AbstractStepSizeController[Any, Any]:
    """What chooses the steps, refuses some, and ends some on events."""
    model, _, times, where, rtol, atol, _, events, *_ = inputs
    controller = plan.controller
    if controller is None:
        options = rtol, atol, _longest(plan, rates, like, inputs, recording)
        controller = _landing(times, where, options, bool(events))
    holds = _holds(plan, model, like)
    if holds is not None:
        controller = refusing(controller, holds)
    if not events:
        return controller

    def values(events: Any, model: Any, t: Array, y: Array) -> Array:
        return values_of(events, model, t, unpack(y, like))

    return Watching(controller, events, _least_step(times), times[-1], values)  # pyright: ignore[reportCallIssue]


def _holds(plan: Plan, model: Any, like: Any) -> Holds | None:
    """Whether a step may stand, from its ends; None: every one may."""
    vectors, allowed = plan.problem.unbroken(model, like), plan.allowed
    if vectors is None and allowed is None:
        return None

    def holds(
        model: Any, t0: Number, y0: Array, t1: Number, y1: Array, rtol: Number
    ) -> Array:
        first, last = unpack(y0, like), unpack(y1, like)
        stands = jnp.asarray(True)
        if vectors is not None:
            ends = vectors(model, t0, first), vectors(model, t1, last)
            for a, b in zip(*ends, strict=True):
                stands &= dot(a, b) > least_product(rtol)
        if allowed is not None:
            stands &= allowed(model, t1, last)
        return stands

    return holds


def _first_step(plan: Plan, like: Any, inputs: Inputs) -> Float[Array, ""]:
    """Length of the first step [s]."""
    _, y0, times, _, _, _, dt0, *_ = inputs
    if dt0 is not None:
        return dt0
    span = times[-1] - times[0]
    dt0 = coarse(first_step(plan.problem.quickness(unpack(y0, like)), span))
    return jnp.where(jnp.isfinite(dt0), dt0, 1.0)  # a NaN would never end the loop


def _longest(
    plan: Plan, rates: Rates, like: Any, inputs: Inputs, recording: bool
) -> Float[Array, ""] | None:
    """Longest step of a run that is differentiated [s]; None: of any other."""
    if not recording or plan.controller is not None:
        return None
    model, y0, times, _, rtol, *_ = inputs
    order = plan.solver.order(dfx.ODETerm(cast(Any, rates)))
    span = times[-1] - times[0]
    ahead = jnp.sign(span) * _first_step(plan, like, inputs)
    longest = functools.partial(longest_step, rates, order or 1)
    given = model, times[0], y0, span, rtol, ahead
    if plan.zeros is None:
        return longest(*given)
    return in_one_program_or_not(longest, *given, briefly=True)


def _natively(
    plan: Plan, rates: Rates, like: Any, inputs: Inputs, recording: bool
) -> tuple[Solution, Record | None]:
    model, y0, times, _, _, _, _, events, *_ = inputs
    leaves, tree = cast("tuple[list[Array], Any]", jax.tree.flatten((model, events)))

    def derivative(t: Array, y: Array, *leaves: Array) -> Array:
        return rates(t, y, jax.tree.unflatten(tree, leaves)[0])

    def values(t: Array, y: Array, *leaves: Array) -> Array:
        model, events = jax.tree.unflatten(tree, leaves)
        return values_of(events, model, t, unpack(y, like))

    def ends(t: Array, y: Array, *leaves: Array) -> Array:
        assert plan.allowed is not None
        return plan.allowed(jax.tree.unflatten(tree, leaves)[0], t, unpack(y, like))

    assert plan.zeros is not None
    loop = RunLoop(
        derivative,
        y0,
        leaves,
        weights_of(plan.solver, "the loop in C"),
        [*plan.zeros, *[b""] * (len(leaves) - len(plan.zeros))],
        STEPS_BETWEEN if recording else 0,
        unbroken_numbers(plan.problem.unbroken, model, like),
        Looked(values, layout_of(events)) if events else None,
        None if plan.allowed is None else ends,
    )
    course = _course(plan, rates, like, inputs, recording)
    most = plan.max_steps
    if most is None:
        most = RECORDED_STEPS if recording else UNRECORDED_STEPS
    ended = loop(y0, course, most)
    outcome = Solution(
        time=times,
        y=jnp.concatenate([y0[None], ended.y]),
        final_time=ended.final_time,
        final_y=ended.final_y,
        code=ended.code,
        steps=ended.steps,
        rejected_steps=ended.rejected_steps,
    )
    if ended.happened is not None:
        moments, *counts = ended.happened
        happened = Happened(moments[:, 0], moments[:, 1:], *counts)
        outcome = dataclasses.replace(outcome, happened=happened)
    if ended.record is None:
        return outcome, None
    begun, kept = ended.record
    record = begun, outcome.steps, kept
    found = outcome.happened
    return outcome, record if found is None else (*record, found.time)


def _course(
    plan: Plan, rates: Rates, like: Any, inputs: Inputs, recording: bool
) -> Course:
    """What the loop in C is told of a run."""
    _, _, times, where, rtol, atol, *_ = inputs
    sense = jnp.where(times[-1] < times[0], -1.0, 1.0).astype(times.dtype)
    longest = _longest(plan, rates, like, inputs, recording)
    return Course(
        time=times[0],
        sense=sense,
        rtol=rtol,
        atol=atol,
        dtmin=_least_step(times),
        longest=jnp.asarray(jnp.inf if longest is None else longest, times.dtype),
        first_step=_first_step(plan, like, inputs),
        ends=sense * where.ends,
        begins=sense * where.starts,
        outputs=sense * times[1:],
    )


def unbroken_numbers(
    unbroken: Callable[[Any, Any], Vectors | None], model: Any, like: Any
) -> Callable[..., Array] | None:
    """What no step may reverse, as numbers of packed states.

    Args:
        unbroken: As in :class:`Problem`.
        model: Or its shapes.
        like: Shapes of a state.

    Returns:
        ``numbers(t, y, *leaves)``: the vectors one behind the other; None: none.
    """
    vectors = unbroken(model, like)
    tree = cast(Any, jax.tree.structure(model))
    if vectors is None:
        return None

    def numbers(t: Array, y: Array, *leaves: Array) -> Array:
        own = leaves[: tree.num_leaves]  # behind them are those of events
        found = vectors(jax.tree.unflatten(tree, own), t, unpack(y, like))
        return jnp.concatenate(found)

    return numbers


def plain(plan: Plan, times: Float[Array, " T"]) -> bool:
    """Whether a run is nothing but its steps, and outputs at their ends."""
    ends = plan.controller is None or times.shape[0] == 2
    return is_plain(plan.solver) and plan.saveat is None and ends


def _landing(
    times: Float[Array, " T"],
    where: Landings,
    options: tuple[Array, Array, Array | None],
    watched: bool,
) -> dfx.AbstractStepSizeController[Any, Any]:
    """Adaptive steps that end on outputs and on corners of the right-hand side.

    ``options``: tolerances, and the longest step [s]; ``watched``: some are to end on
    events as well, however short they are then.
    """
    dtmin = None if watched else _least_step(times)
    rtol, atol, dtmax = options
    controller = dfx.PIDController(
        rtol=rtol,
        atol=atol,
        dtmin=dtmin,
        dtmax=dtmax,
        force_dtmin=False,
        norm=AboveRounding(rtol),
    )
    if where.ends.shape[0] == 1 and not watched:
        return controller
    # its tolerances are the controller's, which diffrax declares as fields
    return LandOn(controller=controller, landings=where)  # pyright: ignore[reportCallIssue]


def _least_step(times: Float[Array, " T"]) -> Float[Array, ""]:
    """What the times' rounding still tells apart [s]."""
    resolution = 10 * cast(Any, jnp.finfo(times.dtype).eps)
    return resolution * jnp.maximum(jnp.abs(times[0]), jnp.abs(times[-1]))


def _code(result: dfx.RESULTS, stuck: Bool[Array, ""]) -> Int[Array, ""]:
    code = jnp.asarray(Code.SOLVER_STOPPED)
    for known, meaning in (
        (dfx.RESULTS.event_occurred, Code.STOPPED),
        (dfx.RESULTS.successful, Code.COMPLETED),
        (dfx.RESULTS.max_steps_reached, Code.MAX_STEPS),
        (dfx.RESULTS.dt_min_reached, Code.STEP_TOO_SMALL),
    ):
        code = jnp.where(result == known, meaning, code)
    too_small = stuck & (code == Code.STEP_TOO_SMALL)
    return jnp.where(too_small, Code.BAD_START, code)
