"""Integrate a scene in time: from a state to a trajectory."""

import functools
import warnings
from typing import Any, cast

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .checks import FieldError, is_traced, real
from .coordinates import State, pack, unpack
from .differentiate import differentiable
from .euler_lagrange import euler_lagrange_derivative
from .rolling import contact_of, rolling_derivative
from .scene import Scene
from .state_conversion import to_pole_free, to_voronets
from .steps import Landings, LandOn, ReplaySteps, first_step, landings
from .trajectory import Code, Trajectory
from .voronets import CHART_EDGE, AnyState, ChartContact, VoronetsState

_DERIVATIVES = {
    "rolling": rolling_derivative,
    "euler_lagrange": euler_lagrange_derivative,
}
_COORDINATES = ("pole-free", "voronets")

# Reverse mode keeps this many states (about 0.3 kB each) before it recomputes parts.
_CHECKPOINTS = 4096
# Steps that a derivative can follow: the record takes 8 bytes a step.
_RECORDED_STEPS = 2**16
# A run that creeps towards a singular place must end: a minute at the slowest.
_UNRECORDED_STEPS = 2**22


def simulate(
    scene: Scene,
    start: AnyState,
    times: Any,
    *,
    rtol: float | None = None,
    atol: float | None = None,
    formulation: str = "rolling",
    coordinates: str = "pole-free",
    solver: dfx.AbstractSolver | None = None,
    stepsize_controller: dfx.AbstractStepSizeController | None = None,
    adjoint: dfx.AbstractAdjoint | None = None,
    saveat: dfx.SaveAt | None = None,
    dt0: float | None = None,
    max_steps: int | None = None,
    progress_meter: dfx.AbstractProgressMeter | None = None,
) -> Trajectory:
    """Motion of a scene from a start, at the asked times.

    Differentiable in forward and in reverse mode with respect to every float of the
    scene and the start, and with respect to the times; can be jitted and vmapped. A
    run that cannot go on does not raise: the result's ``code`` says why it stopped,
    and what was not reached is NaN.

    Args:
        scene: What rolls on what, under which loads.
        start: State at ``times[0]``, from :func:`rollkane.place`.
        times: Output times [s], shape (T,), T >= 2, strictly increasing (or
            decreasing: the motion backwards). The integrator lands on every one.
        rtol: Relative tolerance of a step [1]; 1e-9 by default (1e-5 in float32).
        atol: Absolute tolerance of a step [unit of the state]; 0.01 rtol by default.
        formulation: ``"rolling"``, or its twin ``"euler_lagrange"``, the equations of
            the paper.
        coordinates: ``"pole-free"`` or ``"voronets"``: those of the paper, which end
            at the edges of the surfaces' charts.
        solver: diffrax solver; by default Dopri8 below rtol 1e-6, else Tsit5.
        stepsize_controller: diffrax controller; replaces ``rtol`` and ``atol``.
        adjoint: diffrax adjoint; replaces the derivative along recorded steps.
        saveat: diffrax ``SaveAt``; replaces ``times``, of which only the first and
            last are then used.
        dt0: First step [s]; chosen by the solver by default.
        max_steps: Most steps taken; by default 4194304, of which derivatives can
            follow 65536 (and are NaN beyond, never quietly wrong).
        progress_meter: diffrax progress meter.

    Returns:
        The trajectory.

    Raises:
        FieldError: times that are not increasing, tolerances out of range, unknown
            names, a start that does not belong to the scene.
    """
    _check_names(formulation, coordinates)
    _check_start(scene, start)
    dtype = start.angular_velocity.dtype
    _warn_single_precision(dtype)
    times = _checked_times(times, dtype)
    _check_span(scene, times)
    start = _in_coordinates(coordinates, scene, start, times[0])
    rtol, atol = _tolerances(rtol, atol, dtype)
    if solver is None:
        solver = _default_solver(rtol)
    plan = _Plan(
        formulation=formulation,
        solver=solver,
        controller=stepsize_controller,
        adjoint=adjoint,
        saveat=saveat,
        max_steps=max_steps,
        progress_meter=dfx.NoProgressMeter()
        if progress_meter is None
        else progress_meter,
    )
    numbers = [_scalar(rtol, dtype), _scalar(atol, dtype)]
    dt0 = None if dt0 is None else _scalar(dt0, dtype)
    if stepsize_controller is None and saveat is None:
        return _simulate(plan, None, scene, start, times, numbers, dt0)
    arrays, plan = eqx.partition(plan, eqx.is_array)
    return _simulate(plan, arrays, scene, start, times, numbers, dt0)


class _Plan(eqx.Module):
    """How to integrate: everything that does not change from call to call."""

    formulation: str
    solver: dfx.AbstractSolver
    controller: dfx.AbstractStepSizeController | None
    adjoint: dfx.AbstractAdjoint | None
    saveat: dfx.SaveAt | None
    max_steps: int | None
    progress_meter: dfx.AbstractProgressMeter


# plain jit: a scene is a tree of arrays, and eqx.filter_jit costs 0.1 ms a call more
@functools.partial(jax.jit, static_argnums=0)
def _simulate(plan, plan_arrays, scene, start, times, tolerances, dt0) -> Trajectory:
    plan = plan if plan_arrays is None else eqx.combine(plan, plan_arrays)
    like = jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape, x.dtype), start)

    @jax.jit  # traced once, however often the integrator evaluates it
    def rates(t, y, scene):
        derivative = _DERIVATIVES[plan.formulation]
        return pack(derivative(scene, t, unpack(y, like)))

    def solve(inputs, replay, adjoint):
        return _solve(plan, rates, like, inputs, replay, adjoint)

    y0 = pack(start)
    # NaN would keep the step controller going for ever; zero stops it at the start
    y0 = jnp.where(jnp.all(jnp.isfinite(y0)), y0, 0.0)
    y0 = _moved_in_time(rates, y0, times[0], scene, -1.0)
    fixed_times = jax.lax.stop_gradient(times)
    inputs = (scene, y0, fixed_times, *tolerances, dt0)
    if plan.adjoint is None:
        solution = differentiable(solve, inputs, _CHECKPOINTS)
    else:
        solution = solve(inputs, None, plan.adjoint)[0]
    y = solution.y
    if plan.saveat is None:
        move = jax.vmap(lambda y, t: _moved_in_time(rates, y, t, scene, 1.0))
        y = move(y, times)
    final_state = unpack(solution.final_y, like)
    return Trajectory(
        time=times if plan.saveat is None else solution.time,
        state=unpack(y, like),
        scene=scene,
        code=_code_at(solution, scene, final_state),
        final_time=solution.final_time,
        final_state=final_state,
        steps=solution.steps,
        rejected_steps=solution.rejected_steps,
    )


class _Solution(eqx.Module):
    time: Array
    y: Array
    final_time: Array
    final_y: Array
    code: Array
    steps: Array
    rejected_steps: Array


def _solve(plan: _Plan, rates, like, inputs, replay, adjoint):
    """One diffrax solve: adaptive, or along the steps of ``replay``."""
    scene, y0, times, rtol, atol, dt0 = inputs
    t0, t1 = times[0], times[-1]
    if dt0 is None:
        dt0 = first_step(unpack(y0, like).angular_velocity, t1 - t0)
        dt0 = jnp.where(jnp.isfinite(dt0), dt0, 1.0)  # a NaN would never end the loop
    dt0 = jnp.where(t1 < t0, -dt0, dt0)
    if replay is not None:
        controller = ReplaySteps(replay, _landings(scene, times, plan).jumps)
        dt0 = None
    else:
        controller = plan.controller or _landing(scene, times, rtol, atol, plan)
        if isinstance(controller, dfx.StepTo):
            dt0 = None  # it has its own first step, and refuses another
    wanted = dfx.SubSaveAt(ts=times) if plan.saveat is None else plan.saveat.subs
    subs = [wanted, dfx.SubSaveAt(t1=True)]
    recording = replay is None and adjoint is not None and plan.adjoint is None
    if recording:
        subs.append(dfx.SubSaveAt(t0=True, steps=True, fn=lambda t, y, args: None))
    max_steps = plan.max_steps
    if max_steps is None:
        custom = plan.saveat is not None or plan.controller is not None
        bounded = recording or replay is not None or custom
        max_steps = _RECORDED_STEPS if bounded else _UNRECORDED_STEPS
    solution = dfx.diffeqsolve(
        dfx.ODETerm(rates),
        plan.solver,
        t0,
        t1,
        dt0,
        y0,
        scene,
        saveat=dfx.SaveAt(subs=subs),
        stepsize_controller=controller,
        adjoint=dfx.ForwardMode() if adjoint is None else adjoint,
        max_steps=max_steps,
        throw=False,
        progress_meter=plan.progress_meter,
    )
    time, final_time, *record = cast(list, solution.ts)
    y, final_y, *_ = cast(list, solution.ys)
    y = jnp.where(jnp.isfinite(y), y, jnp.nan)
    outcome = _Solution(
        time=time,
        y=y,
        final_time=final_time[-1],
        final_y=final_y[-1],
        code=_code(solution.result, final_time[-1] == t0),
        steps=solution.stats["num_accepted_steps"],
        rejected_steps=solution.stats["num_rejected_steps"],
    )
    return outcome, record[0] if recording else None


def _landing(
    scene: Scene, times, rtol, atol, plan: _Plan
) -> dfx.AbstractStepSizeController:
    """Adaptive steps that end on outputs and on kinks of the base's motion."""
    resolution = 10 * jnp.finfo(times.dtype).eps
    dtmin = resolution * jnp.maximum(jnp.abs(times[0]), jnp.abs(times[-1]))
    controller = dfx.PIDController(rtol=rtol, atol=atol, dtmin=dtmin, force_dtmin=False)
    where = _landings(scene, times, plan)
    return LandOn(controller, where) if where.ends.shape[0] > 1 else controller


def _landings(scene: Scene, times, plan: _Plan) -> Landings:
    motion = scene.base.motion
    outputs = times if plan.saveat is None else times[:: times.shape[0] - 1]
    if motion is None:
        return landings(outputs, None)
    return landings(outputs, motion.kinks, motion.jumps)


def _code(result, stuck) -> Array:
    code = jnp.asarray(Code.STOPPED)
    for known, meaning in (
        (dfx.RESULTS.successful, Code.COMPLETED),
        (dfx.RESULTS.max_steps_reached, Code.MAX_STEPS),
        (dfx.RESULTS.dt_min_reached, Code.STEP_TOO_SMALL),
    ):
        code = jnp.where(result == known, meaning, code)
    too_small = stuck & (code == Code.STEP_TOO_SMALL)
    return jnp.where(too_small, Code.BAD_START, code)


def _code_at(solution: _Solution, scene: Scene, state) -> Array:
    """The code, once it is seen whether a small step was the edge of a chart."""
    if not isinstance(state, VoronetsState):
        return solution.code
    contact = contact_of(scene, solution.final_time, state)
    assert isinstance(contact, ChartContact)
    stopped = (solution.code == Code.STEP_TOO_SMALL) | (solution.code == Code.BAD_START)
    at_edge = stopped & (contact.regularity < 2.0 * CHART_EDGE)
    return jnp.where(at_edge, Code.CHART_EDGE, solution.code)


@eqx.filter_custom_jvp
def _moved_in_time(rates, y, t, scene, sign):
    """``y``, with the derivative that a change of its time ``t`` brings.

    Output times are not part of the replayed solve; a later output has moved on by
    the rates (sign +1), a later start stands for an earlier state (sign -1).
    """
    del rates, t, scene, sign
    return y


@_moved_in_time.def_jvp
def _moved_in_time_jvp(primals, tangents):
    rates, y, t, scene, sign = primals
    _, y_dot, t_dot, _, _ = tangents
    y_dot = jnp.zeros_like(y) if y_dot is None else y_dot
    if t_dot is not None:
        y_dot = y_dot + sign * rates(t, y, scene) * t_dot
    return y, y_dot


def _check_names(formulation: str, coordinates: str) -> None:
    for field, value, known in (
        ("simulate.formulation", formulation, tuple(_DERIVATIVES)),
        ("simulate.coordinates", coordinates, _COORDINATES),
    ):
        if value not in known:
            raise FieldError(field, value, "is not known", f"use one of {known}")


_warned = False


def _warn_single_precision(dtype) -> None:
    """Say once what single precision costs, where the program has not chosen it."""
    global _warned
    if dtype == jnp.float32 and jnp.result_type(float) == dtype and not _warned:
        _warned = True
        warnings.warn(
            "rollkane runs in single precision: about 6 digits, and tolerances below "
            '1e-6 cannot be met. jax.config.update("jax_enable_x64", True) at the '
            "start of the program gives double precision.",
            stacklevel=3,
        )


def _check_start(scene: Scene, start: AnyState) -> None:
    if not isinstance(start, (State, VoronetsState)):
        raise FieldError(
            "simulate.start", start, "must be a State", "make it with rollkane.place"
        )
    body, base = scene.body.surface, scene.base.surface
    shapes: dict[str, tuple] = {
        "angular_velocity": (3,),
        "alpha": (scene.coordinate_count,),
        "alpha_dot": (scene.coordinate_count,),
    }
    if isinstance(start, VoronetsState):
        shapes |= {"contact_on_base": (2,), "contact_on_body": (2,), "angle": ()}
    else:
        carried = body.coordinate_count if scene.carries_point else 0
        shapes |= {
            "orientation": (4,),
            "contact_on_base": (base.coordinate_count,),
            "contact_on_body": (carried,),
        }
    for field, wanted in shapes.items():
        shape = getattr(start, field).shape
        if shape != wanted:
            raise FieldError(
                f"simulate.start.{field}",
                shape,
                f"must have shape {wanted} in this scene",
                "place the body in this scene (a batch of starts needs jax.vmap)",
            )


def _check_span(scene: Scene, times: Any) -> None:
    """Refuse times at which the base's motion is not known."""
    motion = scene.base.motion
    span = None if motion is None else motion.span
    if span is None or is_traced(times, span):
        return
    first, last = float(span[0]), float(span[1])
    slack = 1e-9 * (last - first)
    least, most = float(np.min(times)), float(np.max(times))
    if least < first - slack or most > last + slack:
        raise FieldError(
            "simulate.times",
            (least, most),
            f"leave the record of Base.motion, which is known from {first:g} to "
            f"{last:g} s",
            "stay within it, or add samples (of zero, for a base that coasts on)",
        )


def _in_coordinates(coordinates: str, scene: Scene, start, time):
    """The start in the asked coordinates."""
    if coordinates == "pole-free":
        return to_pole_free(scene, start, time)
    sign = start.sign if isinstance(start, VoronetsState) else -1
    return to_voronets(scene, start, time, sign)


def _scalar(x, dtype):
    return x.astype(dtype) if is_traced(x) else np.asarray(x, dtype)


def _checked_times(times: Any, dtype) -> Float[Array, " T"]:
    field = "simulate.times"
    if is_traced(times):
        return real(field, times, (None,), "output times in seconds").astype(dtype)
    try:
        times = np.asarray(times, dtype)
    except (TypeError, ValueError) as error:
        raise FieldError(
            field, times, "must be made of numbers", "give output times in seconds"
        ) from error
    if times.ndim != 1 or times.shape[0] < 2:
        raise FieldError(
            field, times, "must hold a start and an end", "give two times or more"
        )
    steps = np.diff(times)
    if not (np.all(steps > 0) or np.all(steps < 0)):  # not so for NaN either
        raise FieldError(
            field,
            times,
            "must be finite and strictly increasing or strictly decreasing",
            "sort them and leave out repeated ones",
        )
    return times


def _tolerances(rtol, atol, dtype) -> tuple[Any, Any]:
    double = dtype == jnp.float64
    rtol = (1e-9 if double else 1e-5) if rtol is None else rtol
    atol = 0.01 * rtol if atol is None else atol
    least = 10 * float(jnp.finfo(dtype).eps)
    for field, value, floor in (("rtol", rtol, least), ("atol", atol, 0.0)):
        if is_traced(value):
            continue
        if not (np.ndim(value) == 0 and np.isfinite(value) and value > 0):
            raise FieldError(
                f"simulate.{field}", value, "must be a positive number", "give 1e-9"
            )
        if value < floor:
            raise FieldError(
                f"simulate.{field}",
                value,
                f"is below what {dtype} can hold",
                f"give {floor:.1g} or more"
                + ("" if double else ", or use double precision"),
            )
    return rtol, atol


def _default_solver(rtol) -> dfx.AbstractSolver:
    """Dopri8 where many digits are asked for, Tsit5 where few are."""
    if is_traced(rtol) or rtol < 1e-6:
        return dfx.Dopri8()
    return dfx.Tsit5()
