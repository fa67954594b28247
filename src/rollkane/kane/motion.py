"""Motion of a system in time: the same integrator as that of a rolling body."""

import functools
from os import PathLike
from typing import Any

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ..codegen.compile_effort import for_one_call
from ..codegen.tracing import running_once
from ..integration.backends import check_method, run_by, without_native
from ..integration.diffrax_checks import check_kinds, check_kinks
from ..integration.integrate import checked_times, tolerances, warn_single_precision
from ..integration.plans import Problem
from ..integration.prepared import prepared
from ..integration.projection import KeepingEnergy
from ..kinematics.base_motion import BESIDE_JUMPS
from ..validation.checks import FieldError, is_traced
from ..validation.codes import NO_FAULT, Code, Fields, is_stuck
from .closure import bound_start, kept_state, kept_well
from .dependent_speeds import (
    is_watched,
    on_its_side,
    undetermined,
    with_as_many_numbers,
)
from .equations import (
    all_speeds,
    allowed_state,
    kane_derivative,
    kinetic_energy,
    reactions,
)
from .given_states import checked_state, known_system
from .implied_rows import lost
from .singular_states import Examined, refuse_start
from .system import KaneState, KaneSystem
from .velocity_jumps import refuse_jumps

# in place of the sentence about speeds that were chosen
_PARTING = (
    "the constraints, which act by multipliers, come to follow from each other here, "
    "and motions part: an error of a step would decide which one is followed; the "
    "motion up to here is right; go on with a start behind this place, on the motion "
    "that you mean"
)


class KaneTrajectory(eqx.Module):
    """Motion of a system at T times.

    Attributes:
        time: [s], shape (T,).
        state: Coordinates and independent speeds, with a leading T; NaN where not
            reached.
        system: The system that moved.
        code: Why the run ended, one of :class:`rollkane.Code`; 0 is success.
        final_time: Time that was reached [s].
        final_state: State at that time.
        steps: Accepted steps.
        rejected_steps: Rejected steps.
        fault: Which number of the system, the start or the times cannot be used, as
            ``reason`` names it; -1: none.
        method: Which loop made it, ``"native"`` (C) or ``"diffrax"`` (XLA).
        why: Why it is not the loop in C, in a sentence; empty where it is.
    """

    time: Float[Array, " T"]
    state: KaneState
    system: KaneSystem
    code: Int[Array, ""]
    final_time: Float[Array, ""]
    final_state: KaneState
    steps: Int[Array, ""]
    rejected_steps: Int[Array, ""]
    fault: Int[Array, ""] | int = NO_FAULT
    method: str = eqx.field(static=True, default="diffrax")
    why: str = eqx.field(static=True, default="")

    @property
    def q(self) -> Float[Array, "T n"]:
        """Generalized coordinates, shape (T, n)."""
        return self.state.q

    @property
    def u(self) -> Float[Array, "T m"]:
        """All generalized speeds, dependent ones included, shape (T, m)."""
        return _each(all_speeds, self.system, self.time, self.state)

    @property
    def kinetic_energy(self) -> Float[Array, " T"]:
        """[J], shape (T,)."""
        return _each(kinetic_energy, self.system, self.time, self.state)

    @property
    def reactions(self) -> Float[Array, "T a"]:
        """Generalized reactions against the auxiliary speeds, shape (T, a)."""
        return _each(reactions, self.system, self.time, self.state)

    @property
    def succeeded(self) -> Array:
        """Whether the run reached its last time."""
        return self.code == Code.COMPLETED

    @property
    def reason(self) -> str:
        """Why a single run ended, and what to do about it."""
        moved = with_as_many_numbers(self.system)
        if int(self.code) == Code.DEPENDENT_SPEEDS and self.system.by_multipliers:
            return _PARTING
        fields = Fields.of(moved, self.final_state, "system")
        row = ""
        if int(self.code) == Code.NO_LONGER_REDUNDANT:
            found = _lost(self.system, self.final_time, self.final_state)
            row = self.system.implied_names[int(jnp.argmax(found))]
        return fields.reason(self.code, self.fault, row)

    def plot(self, path: str | PathLike[str] | None = None, title: str = "") -> Any:
        """Draw coordinates, speeds and kinetic energy (extra ``plot``).

        Args:
            path: File to write, .png, .svg or .pdf; None for none.
            title: Above the figure.

        Returns:
            The matplotlib figure, or None where a file was written.
        """
        from ..pictures.plot_kane import plot_kane

        return plot_kane(self, path, title)


def simulate(
    system: KaneSystem,
    start: KaneState,
    times: Any,
    *,
    rtol: float | None = None,
    atol: float | None = None,
    solver: dfx.AbstractSolver[Any] | None = None,
    stepsize_controller: dfx.AbstractStepSizeController[Any, Any] | None = None,
    adjoint: dfx.AbstractAdjoint | None = None,
    dt0: float | None = None,
    max_steps: int | None = None,
    progress_meter: dfx.AbstractProgressMeter[Any] | None = None,
    method: str = "auto",
) -> KaneTrajectory:
    """Motion of a system from a start, at the asked times.

    Differentiable in forward and reverse mode, can be jitted and vmapped, lands on
    every output: see ``rollkane.simulate``, whose arguments these are.

    Args:
        system: The system.
        start: Coordinates and independent speeds at ``times[0]``. Where numbers are
            traced, dependent coordinates are moved to the configuration, as derivatives
            by these numbers are.
        times: Output times [s], shape (T,), strictly monotonic.
        rtol: Relative tolerance of a step [1]; 1e-9 by default (1e-5 in float32).
        atol: Absolute tolerance of a step; 0.01 rtol by default.
        solver: diffrax solver; by default Dopri8 below rtol 1e-6, else Tsit5.
        stepsize_controller: diffrax controller; replaces ``rtol`` and ``atol``.
        adjoint: diffrax adjoint; replaces the derivative along recorded steps.
        dt0: First step [s].
        max_steps: Most steps taken.
        progress_meter: diffrax progress meter.
        method: ``"native"``, the loop in C; ``"diffrax"``; ``"auto"``: native where it
            can (``why`` of the result tells why not).

    Raises:
        FieldError: a start of another shape, times or tolerances out of range; of known
            numbers: velocities that are not affine in the speeds, a start that violates
            the configuration, constraints that do not keep it, and what else leaves the
            motion undetermined there.
    """
    if isinstance(solver, KeepingEnergy):
        problem = "keeps the energy of a rolling scene, not that of a system"
        remedy = "write the function for rollkane.Keeping yourself"
        raise FieldError("simulate.solver", solver, problem, remedy)
    check_method(method)
    check_kinds(
        "simulate",
        solver=solver,
        stepsize_controller=stepsize_controller,
        adjoint=adjoint,
        progress_meter=progress_meter,
    )
    check_kinks(known_system("simulate.system", system).kinks, stepsize_controller)
    given = {
        "stepsize_controller": stepsize_controller is not None,
        "adjoint": adjoint is not None,
        "progress_meter": progress_meter is not None,
    }
    refusal = without_native(solver, given)
    start = checked_state("simulate.start", system, start, float)
    dtype = start.q.dtype
    warn_single_precision(dtype)
    times = checked_times(times, dtype)
    rtol, atol = tolerances(rtol, atol, dtype)
    seen = _refused(system, times, start, rtol)
    start = bound_start(system, times[0], start, rtol)
    moving = on_its_side(system, times[0], start, rtol, seen and seen.by_speeds)
    ready = prepared(
        *(_PROBLEM, moving, times),
        rtol=rtol,
        atol=atol,
        solver=solver,
        stepsize_controller=stepsize_controller,
        adjoint=adjoint,
        saveat=None,
        dt0=dt0,
        max_steps=max_steps,
        progress_meter=progress_meter,
    )
    run, kind = functools.partial(ready, start), ("kane", type(solver))
    outcome, method, why = run_by(method, refusal, kind, (system, start), run)
    state, final, code = outcome.state, outcome.final_state, outcome.code
    if system.projection is not None or system.implied is not None:
        ended = outcome.final_time, final
        state, final, code = _on_constraints(system, outcome.time, state, *ended, code)
    if is_watched(system) and (is_traced(code) or is_stuck(code.item())):
        code = _explained(moving, outcome.final_time, final, code, outcome.fault)
    return KaneTrajectory(
        time=outcome.time,
        state=state,
        system=system,
        code=code,
        final_time=outcome.final_time,
        final_state=final,
        steps=outcome.steps,
        rejected_steps=outcome.rejected_steps,
        fault=outcome.fault,
        method=method,
        why=why,
    )


def _refused(
    system: KaneSystem, times: Array, start: KaneState, rtol: Any
) -> Examined | None:
    """What was looked at of a start; refused are those that determine no motion."""
    seen = refuse_start(system, times[0], start, rtol)
    refuse_jumps(system, times, start)
    return seen


@for_one_call
@running_once()
def _lost(system: KaneSystem, t: Array, state: KaneState) -> Float[Array, " k"]:
    """How far each row that followed from others is from zero, of what may be [1]."""
    kept, u = kept_state(system, t, state), all_speeds(system, t, state)
    u = jnp.concatenate([u, jnp.zeros(system.auxiliary, u.dtype)])
    return lost(system, t, kept.q, u, kept.q - state.q)


@for_one_call
@running_once()
def _explained(
    system: KaneSystem, t: Array, final: KaneState, code: Array, fault: Array
) -> Array:
    """The code of a run, where it got stuck by its choice of dependent speeds."""
    here = is_stuck(code) & (fault == NO_FAULT) & undetermined(system, t, final)
    return jnp.where(here, Code.DEPENDENT_SPEEDS, code)


# one program of them: what is in loops would be compiled anew at every call
@for_one_call
@running_once()
def _on_constraints(
    system: KaneSystem,
    time: Array,
    state: KaneState,
    final_time: Array,
    final: KaneState,
    code: Array,
) -> tuple[KaneState, KaneState, Array]:
    """Outputs, end and code of a run, projected, up to where rows still follow."""
    if system.projection is not None:
        state = jax.vmap(kept_well, in_axes=(None, 0, 0))(system, time, state)
        final = kept_well(system, final_time, final)
    if system.implied is not None:
        ended = _lost(system, final_time, final)
        state, code = _until_lost(system, time, state, code, ended)
    return state, final, code


def _until_lost(
    system: KaneSystem, time: Array, state: KaneState, code: Array, ended: Array
) -> tuple[KaneState, Array]:
    """Outputs and code of a run, up to where rows do not follow from others any more.

    Loose runs may step there, and no other does: it gets stuck a rounding of the clock
    before. ``ended``: how far the rows are from zero at its end.
    """
    nearly = 0.5  # of roundings a thousandth is left; a stuck run is next to 1
    worst = jnp.max(_each(_lost, system, time, state), axis=-1)
    gone = jnp.cumsum(worst > nearly) > 0

    def reached(x: Array) -> Array:  # NaN behind, and so are derivatives
        beyond = gone.reshape(-1, *[1] * (x.ndim - 1))
        return x * jnp.where(beyond, jnp.nan, 1.0)

    fails = jnp.any(gone) | jnp.any(ended > nearly)
    fails = fails & (is_stuck(code) | (code == Code.COMPLETED))
    code = jnp.where(fails, Code.NO_LONGER_REDUNDANT, code)
    return jax.tree.map(reached, state), code


def _sizes(state: KaneState) -> KaneState:
    def one(x: Array) -> Array:
        return jnp.ones_like(x)

    return jax.tree.map(one, state)


def _quickness(state: KaneState) -> Float[Array, " m"]:
    return state.u


def _corners(system: KaneSystem) -> tuple[Array | None, int]:
    return system.kinks, BESIDE_JUMPS


_PROBLEM = Problem(kane_derivative, _quickness, _sizes, _corners, allowed_state)


@for_one_call
@running_once()
def _each(observable: Any, system: KaneSystem, time: Array, state: KaneState) -> Any:
    mapped = jax.vmap(observable, in_axes=(None, 0, 0))
    for _ in range(state.q.ndim - 2):
        mapped = jax.vmap(mapped)
    return mapped(system, time, state)
