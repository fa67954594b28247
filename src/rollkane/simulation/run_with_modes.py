"""Runs that change between rolling, slipping and flight."""

import functools
from typing import Any, NamedTuple

import diffrax as dfx
import jax
import numpy as np
from jaxtyping import Array

from ..codegen.compile_effort import Known, around_a_loop, taken_apart
from ..dynamics.clearance import is_apart
from ..dynamics.events import Event
from ..dynamics.rolling_problem import corners
from ..dynamics.scene import Scene
from ..hybrid.hybrid_run import integrate_modes
from ..hybrid.modes import HybridScene, Modes
from ..hybrid.outcome import HybridOutcome
from ..integration.backends import without_native_modes
from ..integration.held_numbers import held
from ..integration.integrate import (
    check_steps,
    checked_times,
    default_solver,
    tolerances,
    warn_single_precision,
)
from ..integration.prepared import Prepared, scalar
from ..integration.step_control import Stops, stops_of
from ..kinematics.coordinates import State
from ..validation.checks import FieldError, is_traced
from .event_record import events_in_modes, record_of
from .known_calls import ReadyCall
from .precision import in_precision
from .run_checks import check_modes, check_span
from .trajectory import Trajectory


def ready_with_modes(
    scene: Scene,
    start: Any,
    times: Any,
    modes: Modes,
    solver: dfx.AbstractSolver[Any] | None,
    looks: bool,
    events: Any,
    stop: Any,
    *,
    rtol: float | None,
    atol: float | None,
    max_steps: int | None,
) -> ReadyCall:
    """A checked call with modes; see :func:`rollkane.simulate`.

    Args:
        scene: As the user has it.
        start: Rolling, slipping or flying.
        times: Output times [s].
        modes: How the contact may change.
        solver: diffrax solver, an explicit Runge-Kutta method, or None.
        looks: Whether second contacts are looked for.
        events: What is looked for.
        stop: What ends the run.
        rtol: Relative tolerance of a step [1], or None.
        atol: Absolute tolerance of a step, or None.
        max_steps: Most steps, or None.

    Raises:
        FieldError: modes, a start or times that do not fit.
    """
    check_modes(scene, start, modes)
    dtype = start.angular_velocity.dtype
    modes = in_precision(dtype, modes)
    warn_single_precision(dtype)
    times = checked_times(times, dtype)
    if not is_traced(times) and times[-1] < times[0]:
        raise FieldError(
            "simulate.times", times, "run backwards", "let them increase with modes"
        )
    check_span(scene, times)
    by_size = atol is None
    rtol, atol = tolerances(rtol, atol, dtype)
    check_steps(max_steps)
    changing = HybridScene(scene, modes)
    stops = stops_of(times, 100.0 * float(np.finfo(times.dtype).eps))
    watched = events_in_modes(events, stop, changing, times[0], start)
    times = held(times)
    plan = _Plan(
        default_solver(rtol) if solver is None else solver,
        max_steps,
        looks,
        None,
    )
    numbers = scalar(rtol, dtype), scalar(atol, dtype), np.asarray(by_size)
    others = (times, stops, *numbers), watched
    run = Prepared.of((_by_xla, _around_loop), plan, changing, (), others)
    shown = functools.partial(_trajectory, *taken_apart(changing), times, watched)
    return ReadyCall(run, without_native_modes(), ("modes", looks), watched, shown)


class _Plan(NamedTuple):
    """What does not change from call to call.

    Attributes:
        solver: diffrax solver, an explicit Runge-Kutta method.
        max_steps: Most tried steps, or None.
        looks: Whether second contacts are looked for.
        zeros: For the loop in C, which numbers of the scene are zero; None: by XLA.
    """

    solver: dfx.AbstractSolver[Any]
    max_steps: int | None
    looks: bool
    zeros: tuple[bytes, ...] | None


def _through_changes(
    plan: Known,
    structure: Known,
    leaves: list[Array],
    start: State,
    given: tuple[Array, Stops, Array, Array, Array],
    events: tuple[Event, ...],
) -> HybridOutcome:
    how: _Plan = plan.value
    scene = jax.tree.unflatten(structure.value, leaves)
    return integrate_modes(
        *(scene, start, *given, how.solver, how.max_steps, corners),
        allowed=is_apart if how.looks else None,
        zeros=how.zeros,
        events=events,
    )


# plain jit: eqx.filter_jit costs some 0.2 ms a call more
_jit = functools.partial(jax.jit, static_argnums=(0, 1))
_by_xla = _jit(_through_changes)
_around_loop = around_a_loop(_through_changes, _jit)


def _trajectory(
    structure: Known,
    leaves: list[Array],
    times: Array,
    events: tuple[Event, ...],
    scene: Scene,
    outcome: HybridOutcome,
    method: str,
    why: str,
) -> Trajectory:
    del scene  # that with modes, in a quarter of the time that it takes to be made
    parts: dict[str, Any] = dict(vars(outcome))
    found = parts.pop("happened")
    del parts["kept"]
    return Trajectory(
        time=times,
        scene=jax.tree.unflatten(structure.value, leaves),
        event_record=None if found is None else record_of(events, found),
        method=method,
        why=why,
        **parts,
    )
