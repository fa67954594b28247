"""A problem around one state: residual, slopes, group directions, held quantities.

One compiled program gives all that Newton's method, continuation and eigenvalues need.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..codegen.compile_effort import for_one_call
from ..identification import paths
from .problem import AbstractProblem
from .quantities import Quantity


class LocalModel(NamedTuple):
    """A problem in independent coordinates x around a state, which is x = 0.

    Attributes:
        residual: Rates less the group's, ``f - sum xi G`` [unit of x / s], shape (n,).
        slope: Its derivative by x, the linear model in the frame that moves with the
            group [1/s between like quantities], shape (n, n).
        rates: ``f`` alone, shape (n,).
        groups: Generators at the state, shape (n, K).
        held: Values of the quantities, shape (q,).
        held_by_x: Their derivatives, shape (q, n).
        held_by_group: Likewise by the group velocities, shape (q, K).
        by_parameter: Derivative of the residual by the parameter, shape (n,).
        held_by_parameter: Likewise of the quantities, shape (q,).
        basis: Derivative of the image, shape (m, n): its rank is that of x.
    """

    residual: Any
    slope: Any
    rates: Any
    groups: Any
    held: Any
    held_by_x: Any
    held_by_group: Any
    by_parameter: Any
    held_by_parameter: Any
    basis: Any


def with_parameter(
    problem: AbstractProblem, keys: paths.Keys | None, value: Any
) -> AbstractProblem:
    """The problem with another value of a parameter; keys None: itself."""
    if keys is None:
        return problem
    return problem.with_model(paths.replaced(problem.model, keys, value))


@for_one_call
def _local(
    problem: AbstractProblem,
    keys: paths.Keys | None,
    start: Any,
    step: Float[Array, " n"],
    xi: Float[Array, " K"],
    p: Float[Array, ""],
) -> tuple[Any, dict[str, Array]]:
    state = with_parameter(problem, keys, p).moved(start, step)
    n, K = step.shape[0], xi.shape[0]

    def at(z: Array) -> tuple[Array, Array]:
        x, p_there = z[:n], z[n]
        there = with_parameter(problem, keys, p_there)
        y = there.moved(state, x)

        def image(y: Any) -> Array:
            return there.image(state, y)

        place, along = cast(tuple[Array, Any], jax.linearize(image, y))
        rates, group = there.rates(y), there.generator(y, xi)
        own, moved = cast(Array, along(rates)), cast(Array, along(group))
        return jnp.concatenate([place, own - moved]), own

    z = jnp.concatenate([jnp.zeros_like(step), p[None]])
    linear = cast(tuple[Array, Any, Array], jax.linearize(at, z, has_aux=True))
    value, along, own = linear
    slopes = cast(Array, jax.vmap(along)(jnp.eye(n + 1, dtype=step.dtype))).T
    here, m = with_parameter(problem, keys, p), value.shape[0] // 2
    basis = slopes[:m, :n]
    size = jnp.sqrt(jnp.sum(basis * basis, axis=0))
    scaled = basis / size[None]
    square = scaled.T @ scaled

    def reduced(columns: Array) -> Array:
        x = cast(Array, jnp.linalg.solve(square, scaled.T @ columns))
        return x / size[:, None]

    def generated(velocities: Array) -> Array:
        move = here.generator(state, velocities)
        image: Callable[[Any], Array] = lambda y: here.image(state, y)
        return jax.jvp(image, (state,), (move,))[1]

    groups = jax.vmap(generated)(jnp.eye(K, dtype=xi.dtype)).T if K else basis[:, :0]
    columns = [value[m:, None], slopes[m:], own[:, None], groups]
    parts = reduced(jnp.concatenate(columns, axis=1))
    return state, {
        "residual": parts[:, 0],
        "slope": parts[:, 1 : n + 1],
        "by_parameter": parts[:, n + 1],
        "rates": parts[:, n + 2],
        "groups": parts[:, n + 3 :],
        "basis": basis,
    }


@for_one_call
def _held(
    problem: AbstractProblem,
    keys: paths.Keys | None,
    quantities: tuple[Quantity, ...],
    state: Any,
    still: Float[Array, " n"],
    xi: Float[Array, " K"],
    p: Float[Array, ""],
) -> dict[str, Array]:
    """Values and slopes of quantities: a program of its own, since few last long."""
    n = still.shape[0]

    def at(z: Array) -> Array:
        there = with_parameter(problem, keys, z[n])
        y = there.moved(state, z[:n])
        return jnp.stack([q(there, y, z[n + 1 :]) for q in quantities])

    z = jnp.concatenate([still, p[None], xi])
    value, along = cast(tuple[Array, Any], jax.linearize(at, z))
    slopes = cast(Array, jax.vmap(along)(jnp.eye(z.shape[0], dtype=z.dtype))).T
    return {
        "held": value,
        "held_by_x": slopes[:, :n],
        "held_by_parameter": slopes[:, n],
        "held_by_group": slopes[:, n + 1 :],
    }


@for_one_call
def _values(
    problem: AbstractProblem,
    keys: paths.Keys | None,
    one: Quantity,
    states: Any,
    xis: Float[Array, "P K"],
    ps: Float[Array, " P"],
) -> Float[Array, " P"]:
    def at(state: Any, xi: Array, p: Array) -> Array:
        return one(with_parameter(problem, keys, p), state, xi)

    return jax.vmap(at)(states, xis, ps)


def values_along(
    problem: AbstractProblem,
    keys: paths.Keys | None,
    one: Quantity,
    states: Sequence[Any],
    xis: np.ndarray,
    ps: np.ndarray,
) -> np.ndarray:
    """A quantity at many points, shape (P,): see ``local_model``."""
    stacked = jax.tree.map(lambda *x: np.stack([np.asarray(y) for y in x]), *states)
    return np.asarray(_values(problem, keys, one, stacked, xis, ps))


def local_model(
    problem: AbstractProblem,
    keys: paths.Keys | None,
    quantities: tuple[Quantity, ...],
    start: Any,
    step: np.ndarray,
    xi: np.ndarray,
    p: float,
) -> tuple[Any, LocalModel]:
    """The state at a step from a start, and the problem around it, in NumPy's double.

    Args:
        problem: What is asked.
        keys: Of the parameter in the model; None: there is none.
        quantities: Of which values and slopes are wanted.
        start: A state.
        step: In its independent coordinates, shape (n,).
        xi: Group velocities, shape (K,).
        p: Value of the parameter.
    """
    dtype = jax.tree.leaves(start)[0].dtype
    step, xi, at = (np.asarray(x, dtype) for x in (step, xi, p))
    state, found = _local(problem, keys, start, step, xi, at)
    n, K = step.size, xi.size
    nothing = np.zeros((0, n + K + 1))
    held: dict[str, Any] = {
        "held": nothing[:, 0],
        "held_by_x": nothing[:, :n],
        "held_by_parameter": nothing[:, 0],
        "held_by_group": nothing[:, n + 1 :],
    }
    if quantities:
        held = _held(problem, keys, quantities, state, 0.0 * step, xi, at)
    known = {name: np.asarray(x, float) for name, x in (found | held).items()}
    return state, LocalModel(**known)
