"""What is integrated, how, and what comes out: the values that a solve works with."""

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple, Protocol, TypeAlias, TypeVar

import diffrax as dfx
import equinox as eqx
import jax
from jaxtyping import Array

from ..validation.codes import Code
from .event_search import Happened
from .step_control import Landings, landings

# ``rates(t, y, model)`` of the packed state.
Rates: TypeAlias = Callable[[Array, Array, Any], Array]
# ``vectors(model, t, state)`` that no step may reverse.
Vectors: TypeAlias = Callable[[Any, Any, Any], list[Array]]
# ``allowed(model, t, state)`` -> whether a step may end there.
Allowed: TypeAlias = Callable[[Any, Any, Any], Array]
# Model, first packed state, times [s], where steps have to end, tolerances, first step
# [s] or None, events; any behind.
Inputs: TypeAlias = tuple[Any, ...]
# Where steps began, how many there are, and what states were kept of them.
Record: TypeAlias = tuple[Array, ...]

# Steps that a derivative can follow: the record takes 13 bytes a step.
RECORDED_STEPS = 2**16
# A run that creeps towards a singular place must end: a minute at the slowest.
UNRECORDED_STEPS = 2**22


class Problem(NamedTuple):
    """What is integrated; the same object for the same kind of motion.

    Attributes:
        derivative: ``derivative(model, t, state)`` -> rates, as a state.
        quickness: ``quickness(state)`` -> speeds [rad/s] that limit the first step.
        sizes: ``sizes(state)`` -> what the default absolute tolerance is multiplied by,
            as a state.
        corners: ``corners(model)`` -> times at which the right-hand side has a corner
            [s], or None, and how many numbers steps stay away from them.
        consistent: ``consistent(model, t, state)`` -> the state as the constraints
            allow it.
        unbroken: ``unbroken(model, like)`` -> ``vectors(model, t, state)``, a list of
            vectors none of which a step may reverse; None: every step may stand.
            ``like`` has the shapes of a state.
    """

    derivative: Callable[[Any, Array, Any], Any]
    quickness: Callable[[Any], Array]
    sizes: Callable[[Any], Any]
    corners: Callable[[Any], tuple[Array | None, int]]
    consistent: Callable[[Any, Array, Any], Any] = lambda model, t, state: state
    unbroken: Callable[[Any, Any], Vectors | None] = lambda model, like: None


class Plan(NamedTuple):
    """How to integrate: everything that does not change from call to call.

    Attributes:
        problem: What is integrated.
        solver: diffrax solver.
        controller: diffrax controller, or None for the default.
        adjoint: diffrax adjoint, or None for the derivative along recorded steps.
        saveat: diffrax ``SaveAt``, or None for the times.
        max_steps: Most steps, or None.
        progress_meter: diffrax progress meter.
        zeros: For the loop in C, which numbers of the model are zero; None: for
            diffrax.
        allowed: ``allowed(model, t, state)`` -> whether a step may end there; None:
            anywhere.
    """

    problem: Problem
    solver: dfx.AbstractSolver[Any]
    controller: dfx.AbstractStepSizeController[Any, Any] | None
    adjoint: dfx.AbstractAdjoint | None
    saveat: dfx.SaveAt | None
    max_steps: int | None
    progress_meter: dfx.AbstractProgressMeter[Any]
    zeros: tuple[bytes, ...] | None
    allowed: Allowed | None = None

    def landings(self, model: Any, times: Any) -> Landings:
        """Where steps have to end: on outputs, and on corners of a model's motion.

        Args:
            model: What the motion depends on.
            times: Of :class:`rollkane.integration.step_control.Stops` [s], shape (T,).
        """
        outputs = times if self.saveat is None else times[:: times.shape[0] - 1]
        return landings(outputs, *self.problem.corners(model))


class _Ended(Protocol):
    @property
    def code(self) -> Array: ...


_Run = TypeVar("_Run", bound=_Ended)


class Solution(eqx.Module):
    """What a solve gives; see :class:`rollkane.integration.integrate.Outcome`."""

    time: Array
    y: Array
    final_time: Array
    final_y: Array
    code: Array
    steps: Array
    rejected_steps: Array
    happened: Happened | None = None

    @property
    def states(self) -> tuple[Array, ...]:
        """All states of it, and times of events."""
        found = self.happened
        own = self.y, self.final_y
        return own if found is None else (*own, found.time, found.y)

    @property
    def unknown(self) -> "Solution":
        """What of it has no derivative."""
        return without_derivative(self, ("final_time", "final_y"))


def without_derivative(run: _Run, last: tuple[str, ...]) -> _Run:
    """What of a run's numbers has no derivative, as flags of their shapes.

    What was not reached; and where the run ended, if it stopped of itself: it does so
    at a time that depends on everything.

    Args:
        run: What came out of it, with its ``code``.
        last: Names of its fields that hold the time and the state of its end.
    """

    def is_nan(x: Array) -> Array:
        return x != x

    lost = jax.tree.map(is_nan, run)
    stopped = run.code != Code.COMPLETED

    def or_stopped(x: Array) -> Array:
        return x | stopped

    ends = {name: jax.tree.map(or_stopped, getattr(lost, name)) for name in last}
    return dataclasses.replace(lost, **ends)
