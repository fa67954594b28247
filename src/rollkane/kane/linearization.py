"""Small motions about a state: dense matrices by automatic differentiation."""

from collections.abc import Callable, Iterable
from typing import Any, NamedTuple, TypeAlias, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from ..codegen.compile_effort import for_one_call
from ..codegen.tracing import running_once
from ..integration.integrate import tolerances
from ..validation.checks import FieldError, is_traced
from ..validation.user_functions import GivenFunction, as_time
from .closure import bound_start
from .equations import Reduced, reduced
from .given_states import checked_state, known_system, time_of
from .singular_states import Examined, examined, refuse
from .system import KaneState, KaneSystem
from .system_arguments import chosen_numbers, refuse_all

# By places and inputs; the rates themselves, and the equations that they come from.
_Derivatives: TypeAlias = tuple[tuple[Array, Array], tuple[Array, Reduced]]


class Linearization(NamedTuple):
    """``x' = f + A (x - x0) + B (r - r0)``; x holds coordinates, then speeds.

    Attributes:
        A: Shape (x, x), [1/s] between like quantities.
        B: By the inputs r, shape (x, r), [unit of x per s and unit of r]; empty where
            none were named.
        f: Rates at the state itself [unit of x / s], shape (x,): zero at an
            equilibrium.
    """

    A: Float[Array, "x x"]
    B: Float[Array, "x r"]
    f: Float[Array, " x"]


def linearize(
    system: KaneSystem,
    t: ArrayLike,
    state: KaneState,
    q_ind: Iterable[int] | None = None,
    u_ind: Iterable[int] | None = None,
    inputs: Callable[[Any], Any] | None = None,
) -> Linearization:
    """Linearize a system about a state.

    Dependent speeds are eliminated by the velocity constraints; dependent coordinates
    by the configuration constraints, whose solution ``state`` has to be, and whose
    rates the velocity constraints have to hold at zero. Both follow the inputs, too:
    these change at held independent coordinates and speeds.

    Args:
        system: The system.
        t: Time [s].
        state: Coordinates and independent speeds. Where numbers are traced, dependent
            coordinates are moved to the configuration.
        q_ind: Numbers of the coordinates whose rows and columns are wanted; left out,
            all independent ones. The others are held.
        u_ind: Numbers of the speeds, likewise.
        inputs: ``inputs(parameters)`` -> those that are inputs r, a tree of whole
            entries of the parameters (``lambda p: (p["k"], p["F"])``); left out, none.

    Raises:
        FieldError: a state of another shape, or not finite; several times; dependent
            ones among the chosen, or one twice; inputs without parameters or that are
            none of them; what ``simulate`` refuses of a start; dependent coordinates
            that the configuration does not determine; constraints by multipliers.
            Nothing is said of traced numbers.

    Source: theory of implicit functions: dependent coordinates follow with
    ``dq_d = -(dF/dq_d)^-1 (dF/dq_i dq_i + dF/dr dr)``.
    """
    system = known_system("linearize.system", system)
    if system.by_multipliers:
        raise FieldError(
            "linearize.system",
            system.speeds,
            "has constraints that act by multipliers, so that none of its speeds is "
            "chosen as dependent",
            "name dependent speeds (of rolling contacts: RollingSystem.eliminated)",
        )
    time_of("linearize.t", t)
    state = checked_state("linearize.state", system, state, float)
    known = not is_traced(system, t, state)
    if known and not all(np.isfinite(x).all() for x in (state.q, state.u)):
        problem, remedy = "must be finite", "give a state that the motion can have"
        raise FieldError("linearize.state", state, problem, remedy)
    refuse_all(system.dependent, system.speeds)
    if known and not np.isfinite(t):
        problem, remedy = "must be finite", "give the time in seconds"
        raise FieldError("linearize.t", t, problem, remedy)
    # by JAX a known time could be traced
    when = np.asarray(t, jnp.result_type(t, float)) if known else as_time(t)
    t = cast(Array, when)
    state = bound_start(system, t, state, tolerances(None, None, state.q.dtype)[0])
    places = system.coordinates, system.independent_coordinates
    free = _chosen("linearize.q_ind", q_ind, *places)
    moving = _chosen("linearize.u_ind", u_ind, system.speeds, system.independent)
    if inputs is not None and system.parameters is None:
        raise FieldError(
            "linearize.inputs",
            inputs,
            "has no parameters to choose from",
            "give KaneSystem(parameters=...) and let the loads depend on them",
        )
    if inputs is not None:
        _refuse_others(system, inputs)
    found, seen = _linearized(system, t, state, free, moving, inputs, known)
    if seen is not None:
        refuse(system, t, state, seen, eliminated=True)
    return found


def _entries(
    inputs: Callable[[Any], Any] | None,
) -> Callable[[KaneSystem], list[Any]]:
    """Where the inputs stand in a system."""
    if inputs is None:
        return lambda system: []
    return lambda system: jax.tree.leaves(inputs(system.parameters))


def _refuse_others(system: KaneSystem, inputs: Callable[[Any], Any]) -> None:
    """Refuse inputs that are no entries of the parameters: they cannot be varied."""
    try:
        eqx.tree_at(_entries(inputs), system, replace_fn=lambda entry: entry)
    except Exception as error:
        raise FieldError(
            "linearize.inputs",
            inputs,
            "does not return entries of the parameters as they are "
            f"({type(error).__name__})",
            "return whole ones, such as p['k'] or (p['k'], p['F']), no component of an "
            "array and nothing that is computed from them",
        ) from error


@for_one_call
@running_once()
def _linearized(
    system: KaneSystem,
    t: Array,
    state: KaneState,
    free: tuple[int, ...],
    moving: tuple[int, ...],
    inputs: Callable[[Any], Any] | None,
    known: bool,
) -> tuple[Linearization, Examined | None]:
    n = len(free)
    columns = np.asarray(free, int)
    places = np.asarray([system.independent.index(k) for k in moving], int)

    where = _entries(inputs)
    own, unravel = ravel_pytree(where(system))
    own = own.astype(state.q.dtype)  # of nothing: single precision
    x = jnp.zeros(n + places.shape[0], own.dtype)

    def changed(r: Array) -> KaneSystem:
        return eqx.tree_at(where, system, unravel(r)) if inputs else system

    def rates(x: Array, r: Array) -> tuple[Array, tuple[Array, Reduced]]:
        shift = jnp.zeros_like(state.q).at[columns].set(x[:n])
        q = state.q + _followed(changed, t, (state.q, own), (shift, r - own))
        u = state.u.at[places].add(x[n:])
        equations = reduced(changed(r), t, KaneState(q, u))
        dot = equations.rates()
        value = jnp.concatenate([dot.q[columns], dot.u[places]])
        return value, (value, equations)

    derivatives = cast(
        _Derivatives, jax.jacfwd(rates, argnums=(0, 1), has_aux=True)(x, own)
    )
    (A, B), (f, equations) = derivatives
    seen = examined(system, t, state, equations) if known else None
    return Linearization(A, B, f), seen


def _chosen(
    field: str,
    numbers: Iterable[int] | None,
    count: int,
    independent: tuple[int, ...],
) -> tuple[int, ...]:
    if numbers is None:
        return independent
    chosen = chosen_numbers(field, numbers, count)
    if not set(chosen) <= set(independent):
        problem, remedy = "names dependent ones", f"choose among {independent}"
        raise FieldError(field, chosen, problem, remedy)
    return chosen


def _followed(
    system: Callable[[Array], KaneSystem],
    t: Array,
    at: tuple[Float[Array, " n"], Float[Array, " r"]],
    moved: tuple[Float[Array, " n"], Float[Array, " r"]],
) -> Float[Array, " n"]:
    """A shift of the independent coordinates, and of the dependent ones with it.

    ``at``: coordinates and inputs; ``moved``: by how much the independent ones and the
    inputs change.
    """
    (q, own), (shift, by) = at, moved
    given = system(own)
    if given.configuration is None:
        return shift
    bound = jnp.asarray(given.dependent_coordinates, int)
    rest = jnp.zeros(given.speeds + given.auxiliary, q.dtype)

    def held(q: Array, r: Array) -> Array:
        changed = system(r)
        return changed.at(cast(GivenFunction, changed.configuration), t, q, rest)

    slopes = cast("Callable[..., Any]", jax.jacfwd(held, argnums=(0, 1)))
    F_q, F_r = cast("tuple[Array, Array]", slopes(q, own))
    # F itself, of which a state has roundings, does not come in; solved once for each
    # linear model, not for each step
    opened = F_q @ shift + F_r @ by
    return shift.at[bound].set(-jnp.linalg.solve(F_q[:, bound], opened))
