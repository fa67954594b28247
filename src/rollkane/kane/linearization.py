"""Small motions about a state: dense matrices by automatic differentiation."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .equations import as_float, kane_derivative
from .system import KaneState, KaneSystem


class Linearization(NamedTuple):
    """``x' = f + A (x - x0)``; x holds independent coordinates, then speeds.

    Attributes:
        A: Shape (n + m, n + m).
        f: Rates at the state itself, shape (n + m,): zero at an equilibrium.
    """

    A: Float[Array, "x x"]
    f: Float[Array, " x"]


def linearize(system: KaneSystem, t, state: KaneState, q_ind=None) -> Linearization:
    """Linearize a system about a state.

    Dependent speeds are eliminated by the velocity constraints; dependent coordinates
    by the configuration constraints, whose solution ``state`` has to be.

    Args:
        system: The system.
        t: Time [s].
        state: Coordinates and independent speeds.
        q_ind: Numbers of the coordinates whose rows and columns are wanted; left out,
            all independent ones.

    Source: theory of implicit functions: dependent coordinates follow with
    ``dq_d = -(dF/dq_d)^-1 dF/dq_i dq_i``.
    """
    t = as_float(t)
    chosen = system.independent_coordinates if q_ind is None else tuple(q_ind)
    free = jnp.asarray(chosen, int)
    every = jnp.asarray(system.independent_coordinates, int)

    def rates(x):
        moved = x[: free.shape[0]], x[free.shape[0] :]
        shift = jnp.zeros_like(state.q).at[free].set(moved[0])
        q = state.q + _followed(system, t, state.q, shift, every)
        dot = kane_derivative(system, t, KaneState(q, state.u + moved[1]))
        return jnp.concatenate([dot.q[free], dot.u])

    origin = jnp.zeros(free.shape[0] + state.u.shape[0], state.q.dtype)
    return Linearization(jax.jacfwd(rates)(origin), rates(origin))


def _followed(system, t, q, shift, free) -> Float[Array, " n"]:
    """A shift of the independent coordinates, and of the dependent ones with it."""
    if system.configuration is None:
        return shift
    bound = jnp.asarray(system.dependent_coordinates, int)
    rest = jnp.zeros(system.speeds + system.auxiliary, q.dtype)
    F = jax.jacfwd(lambda q: system.configuration(t, q, rest))(q)
    step = -jnp.linalg.solve(F[:, bound], F[:, free] @ shift[free])
    return shift.at[bound].set(step)
