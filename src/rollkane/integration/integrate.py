"""Integrate any right-hand side in time, with derivatives along the recorded steps.

What moves is a tree of numbers (a model: a scene, a system) and a state; the rest of
the library only says which function gives the rates.
"""

import functools
import inspect
import warnings
from collections.abc import Callable
from dataclasses import replace
from typing import Any, cast

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import DTypeLike

from ..codegen.compile_effort import Known, around_a_loop
from ..codegen.tracing import running_once
from ..kinematics.coordinates import pack, unpack
from ..validation.checks import (
    FieldError,
    cleared,
    is_traced,
    real,
    real_numbers,
    refuse,
    whole,
)
from ..validation.codes import NO_FAULT, first_fault
from ..validation.remembered import of_numbers
from .along_steps import by_steps_of
from .differentiate import differentiable
from .event_search import Events, Happened
from .event_times import at_their_zeros
from .output_times import in_time, moved_in_time, not_by_times
from .plans import Inputs, Plan, Record, Solution
from .projection import Projected
from .solve import plain, solve
from .step_control import Landings, Stops, coarse

# Relative tolerance above which a step may be as wrong as it is long.
LOOSEST = 0.1
# Reverse mode of what is not a plain run keeps this many states (about 0.3 kB each).
_CHECKPOINTS = 4096


class Outcome(eqx.Module):
    """What came out of an integration.

    Attributes:
        time: Of the outputs [s], shape (T,).
        state: At the outputs, every array with a leading T; NaN where not reached.
        code: Why the run ended, one of :class:`Code`.
        final_time: Time that was reached [s].
        final_state: State at that time.
        steps: Accepted steps.
        rejected_steps: Rejected steps.
        fault: Which number of model, start or times cannot be used; see
            :class:`rollkane.validation.codes.Fields`.
        happened: Events that were found, with states for ``y``; None where none were
            looked for.
    """

    time: Float[Array, " T"]
    state: Any
    code: Array
    final_time: Array
    final_state: Any
    steps: Array
    rejected_steps: Array
    fault: Array
    happened: Happened | None = None


def _shape_of(x: Array) -> jax.ShapeDtypeStruct:
    return jax.ShapeDtypeStruct(x.shape, x.dtype)


def _integrated(
    known_plan: Known,
    structure: Known,
    plan_arrays: Plan | None,
    leaves: list[Array],
    start: Any,
    times: Float[Array, " T"],
    stops: Stops,
    where: Landings | None,
    tolerances: list[Array],
    dt0: Float[Array, ""] | None,
    events: Events,
) -> Outcome:
    plan: Plan = known_plan.value
    plan = plan if plan_arrays is None else eqx.combine(plan, plan_arrays)
    model = jax.tree.unflatten(structure.value, leaves)

    like = jax.tree.map(_shape_of, start)
    if isinstance(plan.solver, Projected):
        plan = eqx.tree_at(lambda p: p.solver, plan, plan.solver.of(like))

    @jax.jit  # traced once, however often the integrator evaluates it
    def rates(t: Array, y: Array, model: Any) -> Array:
        return pack(plan.problem.derivative(model, t, unpack(y, like)))

    def one(
        inputs: Inputs, replay: Record | None, adjoint: dfx.AbstractAdjoint | None
    ) -> tuple[Solution, Record | None]:
        *others, spoilt = inputs
        found, record = solve(plan, rates, like, tuple(others), replay, adjoint)
        numbers: Callable[[Solution], Any] = lambda s: s.states
        return eqx.tree_at(numbers, found, replace_fn=lambda x: x + spoilt), record

    rtol, atol, by_size = tolerances
    asked = (rtol, atol) if dt0 is None else (rtol, atol, dt0)
    fault, code_of_fault = first_fault(model, start, in_order(times), asked)
    fixed_stops, fixed_events = jax.lax.stop_gradient((stops.time, events))
    with running_once():
        start = plan.problem.consistent(model, times[0], start)
    y0 = pack(start)
    good = (fault == NO_FAULT) & jnp.all(jnp.isfinite(y0))
    # NaN would keep the step controller going for ever; zero stops it at the start
    y0 = cleared(y0, good)
    y0 = cast(Array, moved_in_time(rates, y0, times[0], model, -1.0))
    # likewise of tolerances and first step; what they give is not used. Each by itself:
    # a batch of starts must have no tolerances of its members' own, which lanes share
    rtol, atol = (jnp.where(jnp.isfinite(x), x, LOOSEST) for x in (rtol, atol))
    dt0 = None if dt0 is None else jnp.where(jnp.isfinite(dt0), dt0, 1.0)
    sizes = jax.lax.stop_gradient(coarse(pack(plan.problem.sizes(start))))
    atol = atol * jnp.where(by_size, sizes, 1.0)
    spoilt = jnp.where(good, 0.0, jnp.nan).astype(y0.dtype)
    where = where or plan.landings(model, fixed_stops)
    inputs = (model, y0, fixed_stops, where, rtol, atol, dt0, fixed_events, spoilt)
    if plan.adjoint is None:
        by_steps = by_steps_of(plan, rates) if plain(plan, times) else (None, None)
        solution = differentiable(
            one, inputs, _CHECKPOINTS, *by_steps, unknown=lambda s: s.unknown
        )
    else:
        solution = one(inputs, None, plan.adjoint)[0]
    if plan.saveat is None:
        solution = in_time(solution, rates, times, stops, model)
    else:
        refused = not_by_times(jnp.zeros_like(times[0]), times)
        numbers: Callable[[Solution], Any] = lambda s: (s.y, s.final_y, s.final_time)
        solution = eqx.tree_at(numbers, solution, replace_fn=lambda x: x + refused)
    if events:
        solution = at_their_zeros(solution, rates, events, model, like, times)
    time = times if plan.saveat is None else solution.time
    code = jnp.where(good, solution.code, code_of_fault)
    told = replace(solution, time=time, code=code)
    return _outcome(told, like, fault, good, times[0])


def _outcome(
    found: Solution, like: Any, fault: Array, good: Array, first: Array
) -> Outcome:
    """What came out, as states; of a start that was not ``good`` no steps, no events.

    ``first``: the first time [s].
    """
    happened = found.happened
    if happened is not None:
        happened = happened._replace(
            y=unpack(happened.y, like),
            number=jnp.where(good, happened.number, 0),
            by=jnp.where(good, happened.by, -1),
        )
    # a stand-in for a start that is not good may have gone on to the end
    tried: Callable[[Array], Array] = lambda count: jnp.where(good, count, 0)
    return Outcome(
        time=found.time,
        state=unpack(found.y, like),
        code=found.code,
        final_time=jnp.where(good, found.final_time, first),
        final_state=unpack(found.final_y, like),
        steps=tried(found.steps),
        rejected_steps=tried(found.rejected_steps),
        fault=fault,
        happened=happened,
    )


# plain jit: a model is a tree of arrays, and eqx.filter_jit costs 0.1 ms a call more
_jit = functools.partial(jax.jit, static_argnums=(0, 1))
by_xla: Callable[..., Outcome] = _jit(_integrated)
around_loop: Callable[..., Outcome] = around_a_loop(_integrated, _jit)


_warned: set[str] = set()


def _warn_once(kind: type[Warning], what: str, text: str) -> None:
    """Warn of something once, at the line that called into the library."""
    if what in _warned:
        return
    _warned.add(what)
    frame, level = inspect.currentframe(), 1
    while frame is not None and _is_own(frame.f_globals.get("__name__", "")):
        frame, level = frame.f_back, level + 1
    warnings.warn(text, kind, stacklevel=level)


def _is_own(module: str) -> bool:
    return module.partition(".")[0] == __name__.partition(".")[0]


def warn_single_precision(dtype: np.dtype[Any]) -> None:
    """Say once what single precision costs, where the program has not chosen it."""
    if dtype == jnp.float32 and jnp.result_type(float) == dtype:
        _warn_once(
            UserWarning,
            "precision",
            "rollkane runs in single precision: about 6 digits, and tolerances below "
            '1e-6 cannot be met. jax.config.update("jax_enable_x64", True) at the '
            "start of the program gives double precision.",
        )


def warn_without_compiler(why: str) -> None:
    """Say once why the loop in C is not used, where it would be."""
    _warn_once(
        RuntimeWarning,
        "compiler",
        f"the loop in C is not to be had here, and diffrax takes its place, some ten "
        f"times slower: {why}",
    )


def check_steps(max_steps: Any) -> None:
    """Refuse a number of steps that is none.

    Raises:
        FieldError: it is given and no such number.
    """
    if max_steps is not None:
        whole("simulate.max_steps", max_steps, 1, "give how many steps may be taken")


def checked_step(dt0: Any, dtype: np.dtype[Any]) -> Any:
    """A first step [s]: a traced one in a type, NaN where it has no length.

    Raises:
        FieldError: it is known, and no positive number.
    """
    problem = "must be a positive number, backwards in time, too"
    remedy = "give the length of the first step [s], or leave it out"
    return _positive("simulate.dt0", dt0, dtype, problem, remedy)


def checked_times(times: Any, dtype: np.dtype[Any]) -> Float[Array, " T"]:
    """Output times [s] of the state's dtype.

    Raises:
        FieldError: times that are no real numbers, not two or more, or not strictly
            monotonic.
    """
    field, meaning = "simulate.times", "output times in seconds"
    if is_traced(times):
        return real(field, times, (None,), meaning).astype(dtype)
    known = real_numbers(field, times, f"give {meaning}").astype(dtype, copy=False)
    if known.ndim != 1 or known.shape[0] < 2:
        raise FieldError(
            field, times, "must hold a start and an end", "give two times or more"
        )
    if not of_numbers(_one_way, known):
        raise FieldError(
            field,
            times,
            "must be finite and strictly increasing or strictly decreasing",
            "sort them and leave out repeated ones",
        )
    return cast(Array, known)  # NumPy's, being known


def _one_way(times: np.ndarray) -> bool:
    """Whether times are finite, and all later or all earlier than the one before."""
    steps = np.diff(times)
    one_way = np.all(steps > 0) or np.all(steps < 0)
    return bool(one_way and np.all(np.isfinite(times)))


def in_order(times: Float[Array, " T"]) -> Array:
    """Whether times are finite, and all later or all earlier than the one before."""
    steps = jnp.diff(times)
    one_way = jnp.all(steps > 0) | jnp.all(steps < 0)
    return one_way & jnp.all(jnp.isfinite(times))


def tolerances(rtol: Any, atol: Any, dtype: DTypeLike) -> tuple[Any, Any]:
    """Tolerances, with the defaults of a precision for those that are None."""
    plain = type(rtol) in _PLAIN and type(atol) in _PLAIN
    return (_plain_tolerances if plain else _tolerances)(rtol, atol, np.dtype(dtype))


def _tolerances(rtol: Any, atol: Any, dtype: np.dtype[Any]) -> tuple[Any, Any]:
    double = dtype == jnp.float64
    if rtol is None:
        rtol = 1e-9 if double else 1e-5
    least = 10 * float(np.finfo(dtype).eps)
    fine = f"give {least:.1g} or more" + ("" if double else ", or use double precision")
    rtol = _tolerance("rtol", rtol, dtype)
    rtol = _refused(rtol, lambda x: x < least, f"is below what {dtype} can hold", fine)
    loose = f"give {LOOSEST:g} or less, 1e-9 for instance"
    vague = "leaves no digit of the motion right"
    rtol = _refused(rtol, lambda x: x > LOOSEST, vague, loose)
    return rtol, 0.01 * rtol if atol is None else _tolerance("atol", atol, dtype)


def _tolerance(name: str, value: Any, dtype: np.dtype[Any]) -> Any:
    problem, remedy = "must be a positive number", "give 1e-9"
    return _positive(f"simulate.{name}", value, dtype, problem, remedy)


def _positive(
    field: str, value: Any, dtype: np.dtype[Any], problem: str, remedy: str
) -> Any:
    """A positive number; a traced one in a type, NaN where it is none."""
    if isinstance(value, (str, bytes, bool)) or np.ndim(value) != 0:
        raise FieldError(field, value, problem, remedy)
    value = real_numbers(field, value, remedy)
    value = jnp.asarray(value, dtype) if is_traced(value) else float(value)
    return refuse(value, lambda x: ~((x > 0.0) & (x < np.inf)), field, problem, remedy)


def _refused(rtol: Any, bad: Callable[[Any], Any], problem: str, remedy: str) -> Any:
    return refuse(rtol, bad, "simulate.rtol", problem, remedy)


_PLAIN = float, type(None)
_plain_tolerances = functools.lru_cache(64)(_tolerances)
_FINE, _COARSE = dfx.Dopri8(), dfx.Tsit5()


def default_solver(rtol: Any) -> dfx.AbstractSolver[Any]:
    """Dopri8 where many digits are asked for, Tsit5 where few are."""
    return _FINE if is_traced(rtol) or rtol < 1e-6 else _COARSE
