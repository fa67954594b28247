"""Integrate a scene in time: from a state to a trajectory."""

import functools
from typing import Any, cast

import diffrax as dfx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..codegen import in_one_program_or_not
from ..dynamics.clearance import code_of_touch, is_apart, may_touch_twice
from ..dynamics.consistency import consistent
from ..dynamics.events import Event
from ..dynamics.rolling import rolling_derivative
from ..dynamics.rolling_problem import (
    corners,
    error_sizes,
    explained,
    explains_ends,
    unbroken,
)
from ..dynamics.scene import Scene
from ..hybrid.modes import Modes
from ..integration.backends import check_method, without_native
from ..integration.diffrax_checks import check_kinds, check_kinks
from ..integration.integrate import Outcome, checked_times, warn_single_precision
from ..integration.plans import Problem
from ..integration.prepared import prepared
from ..integration.projection import KeepingEnergy, check_keeps_energy
from ..kinematics.voronets import AnyState, VoronetsState
from ..paper.conversions import to_pole_free, to_voronets
from ..paper.euler_lagrange import euler_lagrange_derivative
from ..validation.checks import FieldError, flag, is_traced
from ..validation.codes import NO_FAULT, is_stuck
from .event_record import events_of, record_of
from .known_calls import ReadyCall, calls_of, keep_call, key_of_call
from .precision import in_one_precision
from .run_checks import check_law, check_scene, check_span, check_start
from .run_with_modes import ready_with_modes
from .trajectory import Trajectory

# what the loop in C does not have
_DIFFRAX_ALONE = "stepsize_controller", "adjoint", "saveat", "progress_meter"
_WITHOUT_EVENTS = "stepsize_controller", "adjoint", "saveat"
_COORDINATES = ("pole-free", "voronets")


def simulate(
    scene: Scene,
    start: AnyState,
    times: Any,
    *,
    rtol: float | None = None,
    atol: float | None = None,
    formulation: str = "rolling",
    coordinates: str = "pole-free",
    modes: Modes | None = None,
    solver: dfx.AbstractSolver[Any] | None = None,
    stepsize_controller: dfx.AbstractStepSizeController[Any, Any] | None = None,
    adjoint: dfx.AbstractAdjoint | None = None,
    saveat: dfx.SaveAt | None = None,
    dt0: float | None = None,
    max_steps: int | None = None,
    progress_meter: dfx.AbstractProgressMeter[Any] | None = None,
    method: str = "auto",
    second_contact: bool = False,
    events: Any = (),
    stop: Any = None,
) -> Trajectory:
    """Motion of a scene from a start, at the asked times.

    Differentiable in forward and in reverse mode with respect to every float of the
    scene and the start, and with respect to the times (and forwards once more, without
    ``modes``); can be jitted and vmapped. A run that cannot go on does not raise: the
    result's ``code`` says why it stopped, and what was not reached is NaN.

    Args:
        scene: What rolls on what, under which loads.
        start: State at ``times[0]``, from :func:`rollkane.place`.
        times: Output times [s], shape (T,), T >= 2, strictly increasing (or
            decreasing: the motion backwards). The integrator lands on every one.
        rtol: Relative tolerance of a step [1]; 1e-9 by default (1e-5 in float32).
        atol: Absolute tolerance of a step [unit of the state]; 0.01 rtol by default,
            for angular velocities times their length at the start if that is over 1.
        formulation: ``"rolling"``, or its twin ``"euler_lagrange"``, the equations of
            the paper.
        coordinates: ``"pole-free"`` or ``"voronets"``: those of the paper, which end
            at the edges of the surfaces' charts.
        modes: How the run may change between rolling, slipping and flight; None: the
            scene's contact law holds throughout. With it ``solver`` is an explicit
            Runge-Kutta method; time runs forwards; ``formulation``, ``coordinates``,
            ``stepsize_controller``, ``adjoint``, ``saveat``, ``dt0`` and
            ``progress_meter`` cannot be chosen.
        solver: diffrax solver; by default Dopri8 below rtol 1e-6, else Tsit5.
        stepsize_controller: diffrax controller; replaces ``rtol`` and ``atol``.
        adjoint: diffrax adjoint; replaces the derivative along recorded steps.
        saveat: diffrax ``SaveAt``; replaces ``times``, of which only the first and
            last are then used.
        dt0: First step [s]; chosen by the solver by default.
        max_steps: Most steps taken; by default 4194304, and 65536, with ``modes``
            16384, of what is differentiated (of more it is NaN, never quietly wrong).
            As many as are given have room in its record: each takes 13 bytes, with
            ``modes`` 0.3 kB.
        progress_meter: diffrax progress meter.
        method: ``"native"``: the compiled loop in C of :func:`rollkane.ensemble`, on
            a CPU: diffrax's steps in a tenth of the time and half of the wait for the
            first result. ``"diffrax"``: XLA's programs. ``"auto"``: native where it
            can; the result's ``method`` and ``why`` tell. Native it cannot with
            ``stepsize_controller``, ``adjoint``, ``saveat``, ``progress_meter``, a
            ``solver`` other than Bosh3, Tsit5, Dopri5 and Dopri8, or rates that are
            more than arithmetic. Where there is no C compiler, or it fails, diffrax
            takes its place, with a warning once.
        second_contact: Whether the run ends, with ``Code.SECOND_CONTACT``, where the
            body reaches its base at a second place. That is looked for after each step,
            on samples of both surfaces (:mod:`rollkane.dynamics.clearance`): a tenth to
            a few milliseconds a step, tens where both surfaces are searched.
        events: Events, or ready ones by their names (``"lift-off"``): steps end on
            them, and the result's ``events`` shows them. With them
            ``stepsize_controller``, ``adjoint`` and ``saveat`` cannot be chosen.
        stop: One or several of the like, at the first of which the run ends, with
            ``Code.STOPPED``.

    Returns:
        The trajectory.

    Warns:
        RuntimeWarning: there is no C compiler that works, once.

    Raises:
        FieldError: times that are not increasing, tolerances out of range, unknown
            names, a start that does not belong to the scene, ``modes`` in which an
            edge would land on an edge, or a body without ends on a base that is not
            convex.
    """
    check_scene("simulate", scene, start)
    parts: dict[str, Any] = {
        "stepsize_controller": stepsize_controller,
        "adjoint": adjoint,
        "saveat": saveat,
        "progress_meter": progress_meter,
    }
    options = rtol, atol, formulation, coordinates, solver, dt0, max_steps, method
    unusual = events, stop, *parts.values()
    key = key_of_call(start, times, modes, (*options, second_contact), unusual)
    if key is not None and (ready := calls_of(scene).get(key)) is not None:
        return ready(method, scene, start)
    given = scene, start
    scene, start = in_one_precision(scene, start)
    ready, start = _ready(
        *(scene, start, times),
        modes=modes,
        method=method,
        second_contact=second_contact,
        events=events,
        steps={"rtol": rtol, "atol": atol, "max_steps": max_steps},
        parts=parts,
        stop=stop,
        formulation=formulation,
        coordinates=coordinates,
        solver=solver,
        dt0=dt0,
    )
    if key is not None and scene is given[0] and start is given[1]:
        keep_call(scene, key, ready)
    return ready(method, scene, start)


def check_run(
    scene: Scene,
    start: AnyState,
    times: Any,
    *,
    rtol: float | None = None,
    atol: float | None = None,
    modes: Modes | None = None,
    method: str = "auto",
    second_contact: bool = False,
    events: Any = (),
) -> None:
    """Refuse what :func:`simulate` refuses before it runs anything, and run nothing.

    Args:
        scene: As ``simulate`` takes it, as are all others.
        start: State at ``times[0]``.
        times: Output times [s].
        rtol: Relative tolerance of a step [1].
        atol: Absolute tolerance of a step.
        modes: How the contact may change.
        method: Which loop makes the run.
        second_contact: Whether the run ends at one.
        events: What is looked for.

    Raises:
        FieldError: as :func:`simulate`.
    """
    check_scene("simulate", scene, start)
    scene, start = in_one_precision(scene, start)
    _ready(
        *(scene, start, times),
        modes=modes,
        method=method,
        second_contact=second_contact,
        events=events,
        steps={"rtol": rtol, "atol": atol, "max_steps": None},
        parts=cast("dict[str, Any]", dict.fromkeys(_DIFFRAX_ALONE)),
    )


def _ready(
    scene: Scene,
    start: AnyState,
    times: Any,
    *,
    modes: Modes | None,
    method: str,
    second_contact: Any,
    events: Any,
    steps: dict[str, Any],
    parts: dict[str, Any],
    stop: Any = None,
    formulation: str = "rolling",
    coordinates: str = "pole-free",
    solver: dfx.AbstractSolver[Any] | None = None,
    dt0: Any = None,
) -> tuple[ReadyCall, AnyState]:
    """A checked call, see :func:`simulate`, and its start in the asked coordinates.

    Scene and start are in one precision. ``steps``: tolerances and the most steps, by
    name; ``parts``: those of diffrax that only its own loop has.
    """
    _check_names(formulation, coordinates)
    check_method(method)
    check_kinds("simulate", solver=solver, **parts)
    check_law(scene, formulation, coordinates)
    check_kinks(scene.kinks, parts["stepsize_controller"])
    if isinstance(solver, KeepingEnergy):
        check_keeps_energy("simulate.scene", scene)
    chosen = {
        "formulation": formulation != "rolling",
        "coordinates": coordinates != "pole-free",
        "dt0": dt0 is not None,
    }
    chosen |= {name: part is not None for name, part in parts.items()}
    looks = flag("simulate.second_contact", second_contact) and may_touch_twice(scene)
    if modes is not None:
        _refuse("modes", chosen)
        looked_for = looks, events, stop
        given = scene, start, times, modes, solver, *looked_for
        return ready_with_modes(*given, **steps), start
    foreign = _of(chosen, _DIFFRAX_ALONE)
    if method == "native":
        _refuse("method", foreign)
    start, times = _checked(scene, start, times, coordinates)
    watched = events_of(events, stop, scene, times[0], start)
    if watched:
        _refuse("events", _of(chosen, _WITHOUT_EVENTS))
    run = prepared(
        *(_PROBLEMS[formulation], scene, times),
        **(steps | parts),
        solver=solver,
        dt0=dt0,
        allowed=is_apart if looks else None,
        events=watched,
    )
    kind = formulation, coordinates, type(solver), looks
    shown = functools.partial(_trajectory, watched, looks)
    ready = ReadyCall(run, without_native(solver, foreign), kind, watched, shown)
    return ready, start


def _trajectory(
    events: tuple[Event, ...],
    looks: bool,
    scene: Scene,
    outcome: Outcome,
    method: str,
    why: str,
) -> Trajectory:
    # in a tenth of the time of as many attributes
    parts: dict[str, Any] = dict(vars(outcome))
    parts["code"] = _code_at(outcome, scene, looks, method == "native")
    found = parts.pop("happened")
    return Trajectory(
        scene=scene,
        event_record=None if found is None else record_of(events, found),
        method=method,
        why=why,
        **parts,
    )


def _checked(
    scene: Scene, start: AnyState, times: Any, coordinates: str
) -> tuple[AnyState, Float[Array, " T"]]:
    """A start of one law in the asked coordinates, and times, that fit the scene."""
    check_start(scene, start)
    dtype = start.angular_velocity.dtype
    warn_single_precision(dtype)
    times = checked_times(times, dtype)
    check_span(scene, times)
    return _in_coordinates(coordinates, scene, start, times[0]), times


def _of(given: dict[str, bool], names: tuple[str, ...]) -> dict[str, bool]:
    return {name: given[name] for name in names}


def _refuse(having: str, given: dict[str, bool]) -> None:
    for name, is_given in given.items():
        if is_given:
            remedy = f"leave {name} out, or {having}"
            problem = f"cannot be chosen with {having}"
            raise FieldError(f"simulate.{name}", "...", problem, remedy)


def _spin(state: AnyState) -> Float[Array, "3"]:
    return state.angular_velocity


_PROBLEMS = {
    name: Problem(derivative, _spin, error_sizes, corners, consistent, unbroken)
    for name, derivative in {
        "rolling": rolling_derivative,
        "euler_lagrange": euler_lagrange_derivative,
    }.items()
}


def _code_at(outcome: Outcome, scene: Scene, looks: bool, native: bool) -> Array:
    """The code, once it is seen what a small step was."""
    code = outcome.code
    if not is_traced(code) and not is_stuck(code.item()):
        return code  # nothing to explain, and nothing to compile
    t, state = outcome.final_time, outcome.final_state
    bad = outcome.fault != NO_FAULT
    if explains_ends(scene, state):
        found = cast(Array, explained(code, scene, t, state))
        code = jnp.where(bad, code, found)
    if looks:
        of_touch = code_of_touch
        if native and is_traced(code):  # of a batch in turn, and only where it is stuck
            of_touch = functools.partial(in_one_program_or_not, code_of_touch)
        code = jnp.where(bad, code, of_touch(code, scene, t, state))
    return code


def _check_names(formulation: str, coordinates: str) -> None:
    for field, value, known in (
        ("simulate.formulation", formulation, tuple(_PROBLEMS)),
        ("simulate.coordinates", coordinates, _COORDINATES),
    ):
        if value not in known:
            raise FieldError(field, value, "is not known", f"use one of {known}")


def _in_coordinates(
    coordinates: str, scene: Scene, start: AnyState, time: Float[Array, ""]
) -> AnyState:
    """The start in the asked coordinates."""
    if coordinates == "pole-free":
        return to_pole_free(scene, start, time)
    sign = start.sign if isinstance(start, VoronetsState) else -1
    return to_voronets(scene, start, time, sign)
