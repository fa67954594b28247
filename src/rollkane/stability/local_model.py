"""A problem around one state: residual, slopes, group directions, held quantities.

One compiled program gives all that Newton's method, continuation and eigenvalues need.
"""

import functools
from collections.abc import Sequence
from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..codegen.compile_effort import Fixed, for_one_call, joined, parted
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


def _local(
    fixed: Fixed,
    arrays: Sequence[Any],
    start: Any,
    step: Float[Array, " n"],
    xi: Float[Array, " K"],
    p: Float[Array, ""],
) -> tuple[Any, Array]:
    """The state; as images residual, slope by x and p, rates, generators; basis."""
    problem, keys = joined(fixed, arrays)
    state = with_parameter(problem, keys, p).moved(start, step)
    n, K = step.shape[0], xi.shape[0]

    def at(z: Array) -> tuple[Array, tuple[Array, Array]]:
        x, p_there = z[:n], z[n]
        there = with_parameter(problem, keys, p_there)
        y = there.moved(state, x)

        def image(y: Any) -> Array:
            return there.image(state, y)

        place, along = cast(tuple[Array, Any], jax.linearize(image, y))

        def generated(velocities: Array) -> Array:
            return cast(Array, along(there.generator(y, velocities)))

        own, moved = cast(Array, along(there.rates(y))), generated(xi)
        groups = own[:, None][:, :0]
        if K:
            groups = jax.vmap(generated)(jnp.eye(K, dtype=xi.dtype)).T
        return jnp.concatenate([place, own - moved]), (own, groups)

    z = jnp.concatenate([jnp.zeros_like(step), p[None]])
    value, along, (own, groups) = cast(
        tuple[Array, Any, tuple[Array, Array]], jax.linearize(at, z, has_aux=True)
    )
    slopes = cast(Array, jax.vmap(along)(jnp.eye(n + 1, dtype=step.dtype))).T
    m = value.shape[0] // 2
    basis = slopes[:m, :n]
    columns = [value[m:, None], slopes[m:], own[:, None], groups]
    return state, jnp.concatenate([*columns, basis], axis=1)


_local_model = for_one_call(
    _local, functools.partial(jax.jit, static_argnames=("fixed",))
)


def _held(
    fixed: Fixed,
    quantities: tuple[Quantity, ...],
    arrays: Sequence[Any],
    state: Any,
    still: Float[Array, " n"],
    xi: Float[Array, " K"],
    p: Float[Array, ""],
) -> Float[Array, "q n+K+2"]:
    """Quantities, a row each: value, slopes by x, p and xi.

    A program of its own, since few last long.
    """
    problem, keys = joined(fixed, arrays)
    n = still.shape[0]

    def at(z: Array) -> Array:
        there = with_parameter(problem, keys, z[n])
        y = there.moved(state, z[:n])
        return jnp.stack([q(there, y, z[n + 1 :]) for q in quantities])

    z = jnp.concatenate([still, p[None], xi])
    value, along = cast(tuple[Array, Any], jax.linearize(at, z))
    slopes = cast(Array, jax.vmap(along)(jnp.eye(z.shape[0], dtype=z.dtype))).T
    return jnp.concatenate([value[:, None], slopes], axis=1)


_held_values = for_one_call(
    _held, functools.partial(jax.jit, static_argnames=("fixed", "quantities"))
)


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


def _reduced(
    basis: Float[np.ndarray, "m n"], columns: Float[np.ndarray, "m k"]
) -> Float[np.ndarray, "n k"]:
    """Coordinates of changes of the image: on the host, where XLA takes longer."""
    size = np.sqrt(np.sum(basis * basis, axis=0))
    if not np.isfinite(size).all():
        return np.full((size.size, columns.shape[1]), np.nan)
    size[size == 0.0] = 1.0
    scaled = basis / size
    try:
        x = cast(np.ndarray, np.linalg.solve(scaled.T @ scaled, scaled.T @ columns))
    except np.linalg.LinAlgError:  # no coordinates there: the rank tells
        x = cast(np.ndarray, np.linalg.pinv(scaled)) @ columns
    return x / size[:, None]


class LocalProgram(NamedTuple):
    """What gives the local models of one problem, for many states.

    Attributes:
        fixed: What of the problem, and of the keys of its parameter, is no array.
        arrays: Theirs.
        quantities: Of which values and slopes are wanted.
    """

    fixed: Fixed
    arrays: list[Any]
    quantities: tuple[Quantity, ...]

    def __call__(
        self, start: Any, step: np.ndarray, xi: np.ndarray, p: float
    ) -> tuple[Any, LocalModel]:
        """The state at a step from a start, and the problem around it.

        Args:
            start: A state.
            step: In its independent coordinates, shape (n,).
            xi: Group velocities, shape (K,).
            p: Value of the parameter.
        """
        dtype = jax.tree.leaves(start)[0].dtype
        step, xi, at = (np.asarray(x, dtype) for x in (step, xi, p))
        n, fixed, arrays = step.size, self.fixed, self.arrays
        found = _local_model(fixed, arrays, start, step, xi, at)
        state, held = found[0], np.zeros((0, n + xi.size + 2))
        if self.quantities:
            still = np.zeros_like(step)
            more = fixed, self.quantities, arrays, state, still, xi, at
            held = _held_values(*more)
        parts, held = (np.asarray(x, float) for x in (found[1], held))
        basis = parts[:, -n:]
        parts = _reduced(basis, parts[:, :-n])
        return state, LocalModel(
            residual=parts[:, 0],
            slope=parts[:, 1 : n + 1],
            rates=parts[:, n + 2],
            groups=parts[:, n + 3 :],
            held=held[:, 0],
            held_by_x=held[:, 1 : n + 1],
            held_by_group=held[:, n + 2 :],
            by_parameter=parts[:, n + 1],
            held_by_parameter=held[:, n + 1],
            basis=basis,
        )


def local_program(
    problem: AbstractProblem,
    keys: paths.Keys | None,
    quantities: tuple[Quantity, ...],
) -> LocalProgram:
    """What gives the local models of a problem.

    Args:
        problem: What is asked.
        keys: Of the parameter in the model; None: there is none.
        quantities: Of which values and slopes are wanted.
    """
    return LocalProgram(*parted((problem, keys)), quantities)
