"""States of a system on its constraints: the nearest to given ones.

The same on the manifold as nothing at all, so that order and derivatives of a motion
are untouched.
"""

from collections.abc import Callable
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..codegen.compile_effort import for_one_call
from ..codegen.tracing import running_once
from ..validation.checks import is_traced
from ..validation.user_functions import GivenFunction
from .linear_solves import inverse_of
from .system import KaneState, KaneSystem

_NEWTON = 8  # steps to the configuration: from a tenth away to roundings in five
_ORDERS = 3  # of derivatives that are right: a step with a fixed slope gains one
# Of known numbers, what is refused (see .configuration): a hundred relative tolerances
# of the terms, and as many roundings of what units of the coordinates give
_KEPT = 100.0


def kept(
    system: KaneSystem, t: Float[Array, ""], q: Float[Array, " n"]
) -> Float[Array, " n"]:
    """Coordinates on the configuration, of a system that has a projection.

    Args:
        system: The system; one without gets its coordinates back.
        t: Time [s].
        q: Coordinates.

    Source: docs/theory.md, (11.6).
    """
    if system.projection is None:
        return q
    rest = jnp.zeros(system.speeds + system.auxiliary, q.dtype)
    return system.at(system.projection, t, q, rest)


def kept_state(system: KaneSystem, t: Float[Array, ""], state: KaneState) -> KaneState:
    """A state with its coordinates on the configuration.

    Args:
        system: The system.
        t: Time [s].
        state: Coordinates and independent speeds.
    """
    if system.projection is None:
        return state
    return KaneState(kept(system, t, state.q), state.u)


def kept_well(system: KaneSystem, t: Float[Array, ""], state: KaneState) -> KaneState:
    """A state on the configuration to rounding, after a loose run, too.

    Args:
        system: The system.
        t: Time [s].
        state: Coordinates and independent speeds.
    """

    def again(state: KaneState, _: None) -> tuple[KaneState, None]:
        return kept_state(system, t, state), None

    return jax.lax.scan(again, state, None, length=3)[0]


def bound_start(
    system: KaneSystem, t: Float[Array, ""], state: KaneState, rtol: Any
) -> KaneState:
    """A start whose dependent coordinates are those of its independent ones.

    Of traced numbers nothing can be refused, and a start that does not change with them
    would leave the configuration. Values that would not be refused stay as they are, to
    the last bit; derivatives follow always. Where the configuration does not determine
    the dependent coordinates, nothing changes.

    Args:
        system: The system; one that has a projection is left to it.
        t: Time [s].
        state: Coordinates and independent speeds.
        rtol: Relative tolerance of the motion [1].
    """
    if system.configuration is None or system.projection is not None:
        return state
    if not is_traced(system, t, state):
        return state
    loose = jnp.asarray(rtol, state.q.dtype)
    return KaneState(_bound(system, system.configuration, t, state.q, loose), state.u)


@for_one_call
@running_once()
def _bound(
    system: KaneSystem,
    configuration: GivenFunction,
    t: Float[Array, ""],
    q: Float[Array, " n"],
    rtol: Float[Array, ""],
) -> Float[Array, " n"]:
    bound = np.asarray(system.dependent_coordinates, int)
    rest = jnp.zeros(system.speeds + system.auxiliary, q.dtype)
    still: Callable[[Array], Array] = jax.lax.stop_gradient

    def held(q: Array) -> Array:
        return system.at(configuration, t, q, rest)

    def slopes(q: Array) -> Array:
        return cast(Array, jax.jacfwd(held)(q))

    def back(q: Array) -> Array:
        X = inverse_of(slopes(q)[:, bound])
        return still(jnp.where(jnp.isfinite(X), X, 0.0))

    def advance(q: Array, _: None) -> tuple[Array, None]:
        return q.at[bound].add(-still(back(q) @ held(q))), None

    near, _ = jax.lax.scan(advance, still(q), None, length=_NEWTON)
    size = jnp.abs(still(slopes(q)))
    eps = float(np.finfo(q.dtype).eps)
    allowed = _KEPT * (rtol * (size @ jnp.abs(q)) + eps * jnp.sum(size, axis=1))
    moves = jnp.any(jnp.abs(held(q)) > allowed)
    moves = moves & jnp.all(jnp.abs(held(near)) <= allowed)
    q = q + still(jnp.where(moves, near - q, 0.0))
    X = back(q)
    for _ in range(_ORDERS):
        F = held(q)
        opened = jnp.where(jnp.isfinite(F), F - still(F), 0.0)  # zero, with derivatives
        q = q.at[bound].add(-(X @ opened))
    return q
