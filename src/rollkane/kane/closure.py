"""States of a system on its constraints: the nearest to given ones.

The same on the manifold as nothing at all, so that order and derivatives of a motion
are untouched.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .system import KaneState, KaneSystem


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
