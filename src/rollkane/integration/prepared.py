"""A run that is ready for its start: checked, and as programs take it."""

from collections.abc import Callable
from typing import Any, NamedTuple, cast

import diffrax as dfx
import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from ..codegen import zeros_in
from ..codegen.compile_effort import Known, known, taken_apart
from ..kinematics.base_motion import ready_for_runs
from ..validation.checks import is_traced
from .event_search import Events
from .held_numbers import held
from .integrate import (
    around_loop,
    by_xla,
    check_steps,
    checked_step,
    default_solver,
    tolerances,
)
from .plans import Allowed, Plan, Problem
from .step_control import stops_of

_NO_METER = dfx.NoProgressMeter()


class Prepared(NamedTuple):
    """A run but for its start: checked, and as programs take it.

    Attributes:
        programs: By diffrax's loop, and around the one in C: functions of a plan, the
            structure and the arrays of a model, the start, and what else there is.
        plans: How to integrate, for each of them; static.
        structure: Of the model; static.
        arrays: Before the start: of the model, as runs take it.
        others: Behind it: times, tolerances.
    """

    programs: tuple[Callable[..., Any], Callable[..., Any]]
    plans: tuple[Known, Known]
    structure: Known
    arrays: tuple[Any, ...]
    others: tuple[Any, ...]

    @staticmethod
    def of(
        programs: tuple[Callable[..., Any], Callable[..., Any]],
        plan: Any,
        model: Any,
        before: tuple[Any, ...],
        others: tuple[Any, ...],
    ) -> "Prepared":
        """One of a model.

        Args:
            programs: As above.
            plan: A named tuple, of whose ``zeros`` the loop in C is told.
            model: What the motion depends on.
            before: Arrays before those of the model.
            others: What stands behind the start.
        """
        model = ready_for_runs(model)
        structure, leaves = taken_apart(model)
        plans = known(plan), known(plan._replace(zeros=zeros_in(model)))
        return Prepared(programs, plans, structure, (*before, leaves), held(others))

    def __call__(self, start: Any, native: bool = False) -> Any:
        """Integrate a start.

        Args:
            start: State at the first time; differentiable.
            native: Whether the loop is the one in C, which has diffrax's explicit
                methods and no controller, adjoint, ``saveat`` and progress meter of
                the user's.

        Raises:
            NotElementwiseError: the rates are more than arithmetic, and cannot be in C.
            NoCompilerError: there is no C compiler.
        """
        run, plan = self.programs[native], self.plans[native]
        return run(plan, self.structure, *self.arrays, start, *self.others)


def prepared(
    problem: Problem,
    model: Any,
    times: Float[Array, " T"],
    *,
    rtol: Any,
    atol: Any,
    solver: dfx.AbstractSolver[Any] | None,
    stepsize_controller: dfx.AbstractStepSizeController[Any, Any] | None,
    adjoint: dfx.AbstractAdjoint | None,
    saveat: dfx.SaveAt | None,
    dt0: Any,
    max_steps: int | None,
    progress_meter: dfx.AbstractProgressMeter[Any] | None,
    allowed: Allowed | None = None,
    events: Events = (),
) -> Prepared:
    """What integrates a start to the asked times; see ``rollkane.simulate``.

    Args:
        problem: Which function gives the rates.
        model: Tree of numbers that it depends on; differentiable.
        times: Checked output times [s].
        rtol: Relative tolerance of a step [1], or None.
        atol: Absolute tolerance of a step [unit of the state], or None.
        solver: diffrax solver, or None for the default.
        stepsize_controller: diffrax controller, or None.
        adjoint: diffrax adjoint, or None.
        saveat: diffrax ``SaveAt``, or None.
        dt0: First step [s], or None.
        max_steps: Most steps, or None.
        progress_meter: diffrax progress meter, or None.
        allowed: ``allowed(model, t, state)`` -> whether a step may end there; None:
            anywhere.
        events: What is looked for along the run; differentiable.

    Raises:
        FieldError: tolerances out of range.
    """
    dtype = times.dtype
    by_size = atol is None
    rtol, atol = tolerances(rtol, atol, dtype)
    check_steps(max_steps)
    plan = Plan(
        problem=problem,
        solver=default_solver(rtol) if solver is None else solver,
        controller=stepsize_controller,
        adjoint=adjoint,
        saveat=saveat,
        max_steps=max_steps,
        progress_meter=_NO_METER if progress_meter is None else progress_meter,
        zeros=None,
        allowed=allowed,
    )
    arrays = None
    if stepsize_controller is not None or saveat is not None:
        arrays, plan = cast("tuple[Plan, Plan]", eqx.partition(plan, eqx.is_array))
    numbers = [scalar(rtol, dtype), scalar(atol, dtype), np.asarray(by_size)]
    first = None if dt0 is None else scalar(checked_step(dt0, dtype), dtype)
    stops = stops_of(times)
    kinks, _ = problem.corners(model)
    known = kinks is not None and not is_traced((stops.time, kinks))
    where = plan.landings(model, stops.time) if known else None
    others = times, stops, where, numbers, first, events
    return Prepared.of((by_xla, around_loop), plan, model, (arrays,), others)


def scalar(x: Any, dtype: np.dtype[Any]) -> Any:
    """A number, known or traced, in a type."""
    return x.astype(dtype) if is_traced(x) else np.asarray(x, dtype)
