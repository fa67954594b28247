"""Coordinates of a Kane system on its configuration, at the time zero."""

from collections.abc import Callable
from typing import cast

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..kane.system import KaneSystem

_NEWTON = 8  # steps to the configuration, from beside it


def misses(system: KaneSystem, q: Float[Array, " n"]) -> Float[Array, " c"]:
    """By how much coordinates miss the configuration; shape (0,) without one."""
    if system.configuration is None:
        return q[:0]
    rest = jnp.zeros(system.speeds + system.auxiliary, q.dtype)
    return system.at(system.configuration, jnp.zeros_like(q[0]), q, rest)


def configured(system: KaneSystem, q: Float[Array, " n"]) -> Float[Array, " n"]:
    """Coordinates whose dependent ones fulfil the configuration, by Newton's method."""
    if system.configuration is None:
        return q
    bound = np.asarray(system.dependent_coordinates, int)

    def violated(q: Array) -> Array:
        return misses(system, q)

    def advance(q: Array) -> Array:
        slope = cast(Array, jax.jacfwd(violated)(q))[:, bound]
        return q.at[bound].add(-cast(Array, jnp.linalg.solve(slope, violated(q))))

    near = jax.lax.stop_gradient(q)
    step: Callable[[Array, Array], Array] = lambda _, q: advance(q)
    near = cast(Array, jax.lax.fori_loop(0, _NEWTON, step, near))
    near = jax.lax.stop_gradient(near)
    # with the derivative of what is given, and of the system's numbers
    return advance(advance(q.at[bound].set(near[bound])))
