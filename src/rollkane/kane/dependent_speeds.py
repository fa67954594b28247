"""Whether the constraints go on determining the speeds that were chosen as dependent.

Where the determinant of their part of the constraints passes zero, no equations of the
independent speeds are left: next to it they grow as one over its square, and a step
that jumps across has an error that its estimate does not see. No step may.
"""

from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..geometry.small_linear import components
from ..integration.plans import Vectors
from .closure import kept
from .linear_solves import UNROLLED
from .system import KaneState, KaneSystem

# of its rows: runs end nearer to zero, as a skate does for whose tolerance of 1e-12
# rounding is too much at 8e-9, and for looser ones at the clock's steps, 1e-14
NEAR = 1e-6


def sides(system: KaneSystem, like: Any) -> Vectors | None:
    """What no step of a motion may reverse; None: no speeds are dependent.

    Args:
        system: The system.
        like: Of a state; not looked at.
    """
    del like
    if not system.dependent:
        return None

    def vectors(system: KaneSystem, t: Array, state: KaneState) -> list[Array]:
        C = _by_speeds(system, t, state)
        side = jnp.sign(_determinant(C @ _bound(system, C.dtype)))
        return [jnp.stack([side, jnp.zeros_like(side)])]

    return vectors


def undetermined(system: KaneSystem, t: Array, state: KaneState) -> Array:
    """Whether a run that got stuck did so as its dependent speeds are not determined.

    Args:
        system: The system.
        t: Time that was reached [s].
        state: State that was reached.
    """
    if not system.dependent:
        return jnp.asarray(False)
    C = _by_speeds(system, t, state)
    alike = C / jnp.sqrt(jnp.sum(C * C, axis=1))[:, None]
    return ~(jnp.abs(_determinant(alike @ _bound(system, C.dtype))) > NEAR)


def _by_speeds(system: KaneSystem, t: Array, state: KaneState) -> Float[Array, "k m"]:
    """Derivatives of the constraints by all speeds."""
    assert system.constraints is not None
    constraints, q = system.constraints, kept(system, t, state.q)

    def violated(u: Array) -> Array:
        return system.at(constraints, t, q, u)

    rest = jnp.zeros(system.speeds + system.auxiliary, q.dtype)
    return cast(Array, jax.jacfwd(violated)(rest))


def _bound(system: KaneSystem, dtype: Any) -> Float[Array, "m k"]:
    """Takes the dependent ones of all speeds."""
    size = system.speeds + system.auxiliary
    return jnp.asarray(np.eye(size)[:, list(system.dependent)], dtype)


def _determinant(C: Float[Array, "k k"]) -> Float[Array, ""]:
    """By elimination, the largest of each column first; unrolled where it is small."""
    size = C.shape[0]
    if size > UNROLLED:
        return cast(Array, jnp.linalg.det(C))
    rows = [components(row) for row in C]
    found = jnp.ones((), C.dtype)
    for j in range(size):
        for i in range(j + 1, size):
            larger = jnp.abs(rows[i][j]) > jnp.abs(rows[j][j])
            pairs = list(zip(rows[j], rows[i], strict=True))
            rows[j] = [jnp.where(larger, b, a) for a, b in pairs]
            rows[i] = [jnp.where(larger, -a, b) for a, b in pairs]
        pivot = rows[j][j]
        found = found * pivot
        safe = jnp.where(pivot == 0.0, 1.0, pivot)
        for i in range(j + 1, size):
            share = rows[i][j] / safe
            rows[i] = [b - share * a for a, b in zip(rows[j], rows[i], strict=True)]
    return found
