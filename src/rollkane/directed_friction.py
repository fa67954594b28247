"""Coulomb friction of a slip that may vanish: as it begins, while it lasts, as it ends.

A slip U = r s that begins does not turn: friction would turn it at a rate mu N / r. So
its friction acts along the direction at which the slip's rate is along the slip, until
it is fast enough to be followed. Equations: docs/theory.md, (7.4) and (7.5).
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .friction import AbstractFriction
from .small_linear import dot, solve_2x2

# [m/s]: below what a run at rtol 1e-12 resolves of slips of 1e-3 m/s and more
SMALLEST_SLIP = 1e-9
# [m/s]: until then a slip begins. With mu N / m = 3 m/s^2 and 10 rad/s of turn its
# direction is off by ONSET 10 / 3 = 3e-5, and its velocity by 3e-10 m/s
ONSET = 1e-5
_NEWTON = 5  # steps to the direction: none too few where the body's inertias are equal


class Balance(NamedTuple):
    """What makes a slip's rate: ``w U' = B - M s`` for friction along -s [1].

    On two directions along the surface; w > 0.
    """

    M: Float[Array, "2 2"]
    B: Float[Array, "2"]


class DirectedFriction(AbstractFriction):
    """Coulomb friction that passes smoothly through the end of a slip.

    ``-mu V / |V|, V = U + eps^3 d / (eps^2 + U^2)`` with the direction d that the slip
    had: at U = 0 the friction is that of the last moment, and the sign of ``U . d``
    says when. Of a faster slip d is none of friction's business: it falls with U^3.

    Attributes:
        coefficient: mu [1].
        direction: d, BODY axes [1], shape (3,); zero: the slip only begins.
        lifts: Whether the run ends the contact where it would pull.
    """

    coefficient: Array
    direction: Float[Array, "3"]
    lifts: bool = eqx.field(static=True)

    @property
    def one_sided(self) -> bool:
        """Whether it goes with the sign of the normal force."""
        return self.lifts

    @property
    def begins(self) -> Array:
        """Whether the slip only begins."""
        return begins(self.direction)

    def ratio(self, slip):
        """``-mu V / |V|`` [1]."""
        return -self.coefficient * last_way(slip, self.direction)


def begins(direction: Float[Array, "3"]) -> Array:
    """Whether a slip only begins, by the direction that a run keeps of it."""
    return ~(dot(direction, direction) > 0.25)


def last_way(slip: Float[Array, "3"], direction: Float[Array, "3"]) -> Array:
    """Direction of a slip that may vanish [1]; ``direction``: what it was."""
    fast = dot(slip, slip) / SMALLEST_SLIP**2
    moved = slip + SMALLEST_SLIP / (1.0 + fast) * direction
    squared = dot(moved, moved)  # zero in a lane that does not slip
    return moved / jnp.sqrt(jnp.where(squared > 0.0, squared, 1.0))


def first_way(balance: Balance) -> Float[Array, "2"]:
    """Direction s of a slip that begins: its rate is along itself, (7.5).

    ``(M + f) s = B, |s| = 1``: the largest f, by Newton on ``1 / |s| - 1``, which is
    nearly linear in f; derivatives by its last step.
    """
    M, B = jax.lax.stop_gradient(balance)
    f = jnp.maximum(jnp.sqrt(dot(B, B)) - 0.5 * (M[0, 0] + M[1, 1]), 0.0)
    for _ in range(_NEWTON):
        f = f + _newton(Balance(M, B), f)[1]
    f = f + _newton(balance, f)[1]
    return _newton(balance, f)[0]


def _newton(balance: Balance, f) -> tuple[Array, Array]:
    """``s = (M + f)^-1 B`` of unit length, and a Newton step of f."""
    M, B = balance
    shifted = M + f * jnp.eye(2, dtype=B.dtype)
    singular = shifted[0, 0] * shifted[1, 1] == shifted[0, 1] * shifted[1, 0]
    shifted = jnp.where(singular, jnp.eye(2, dtype=B.dtype), shifted)
    s = solve_2x2(shifted, B)
    squared = dot(s, s)
    squared = jnp.where(squared > 0.0, squared, 1.0)
    size, falls = jnp.sqrt(squared), dot(s, solve_2x2(shifted, s))
    step = (size - 1.0) * squared / jnp.where(falls == 0.0, 1.0, falls)
    return s / size, step
