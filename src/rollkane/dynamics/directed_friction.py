"""Coulomb friction of a slip that may vanish: as it begins, while it lasts, as it ends.

A slip U = r s that begins is turned by friction, at a rate of mu N / r, to where it
does not turn. So its friction acts along the direction at which the slip's rate is
along the slip, but for its lag, until it is fast enough to be followed. Equations:
docs/theory.md, (8.4) and (8.5).
"""

from collections.abc import Callable
from typing import NamedTuple, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ..geometry.small_linear import dot, matvec
from .friction import AbstractFriction
from .precision import at_precision

# Speeds are those of double precision; of another, see at_precision.
# [m/s]: below what a run at rtol 1e-12 resolves of slips of 1e-3 m/s and more
SMALLEST_SLIP = 1e-9
# [m/s]: until then a slip begins, and is turned back to its way as if of that size:
# with mu N / m = 3 m/s^2 it settles in 3e-6 s, in steps of twice that. Of a scene
# whose own speed is 1 m/s; see slip_onset
ONSET = 1e-5
# [m/s]: of any scene, a hundred times what the law is smooth by
LEAST_ONSET = 100.0 * SMALLEST_SLIP
# The search for that direction: at most so far at once [rad], until so near that one
# step more is rounding (its error is squared), at most so often: half a turn and ten
_FARTHEST, _CLOSE, _TURNS = 0.3, 1e-7, 40


# Direction, the last angle turned, how often.
_Search: TypeAlias = tuple[Float[Array, "2"], Float[Array, ""], Int[Array, ""]]


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
        direction: d, BODY axes [1], shape (3,); of length 1/2: the slip only begins.
        lifts: Whether the run ends the contact where it would pull.
        follows: Whether the slip is known not to begin: it has its direction.
        turns: Whether it is asked how fast it turns.
        onset: Speed until which a slip only begins [m/s].
    """

    coefficient: Float[Array, ""]
    direction: Float[Array, "3"]
    onset: Float[Array, ""]
    lifts: bool = eqx.field(static=True)
    follows: bool = eqx.field(static=True, default=False)
    turns: bool = eqx.field(static=True, default=True)

    @property
    def one_sided(self) -> bool:
        """Whether it goes with the sign of the normal force."""
        return self.lifts

    @property
    def begins(self) -> Array:
        """Whether the slip only begins."""
        return begins(self.direction)

    @property
    def decides(self) -> bool:
        """Whether more is asked than the force."""
        return self.turns or not self.follows

    def ratio(self, slip: Float[Array, "3"]) -> Float[Array, "3"]:
        """``-mu V / |V|`` [1]."""
        return -self.coefficient * last_way(slip, self.direction)


def begins(direction: Float[Array, "3"]) -> Array:
    """Whether a slip only begins, by the direction that a run keeps of it.

    It is of length 1/2 then, and where the slip began to look for its own.
    """
    return ~(dot(direction, direction) > 0.5)


def last_way(slip: Float[Array, "3"], direction: Float[Array, "3"]) -> Array:
    """Direction of a slip that may vanish [1]; ``direction``: what it was."""
    smallest = at_precision(SMALLEST_SLIP, slip)
    fast = dot(slip, slip) / smallest**2
    moved = slip + smallest / (1.0 + fast) * direction
    squared = dot(moved, moved)  # zero in a lane that does not slip
    return moved / jnp.sqrt(jnp.where(squared > 0.0, squared, 1.0))


def first_way(balance: Balance, start: Float[Array, "2"]) -> Float[Array, "2"]:
    """Direction s of a slip that begins: its rate is along itself, (8.5).

    Friction turns the slip at a rate of the sign of ``s' . (B - M s)``, s' = N x s,
    and so the search does from where the slip began, by Newton where that leads the
    same way: to the direction that the slip itself would find, of several. Derivatives
    are those of its last step. NaN where none is found: a slip that would turn for
    ever.
    """
    fixed = jax.lax.stop_gradient(balance)

    def turned(carry: _Search) -> _Search:
        s, _, count = carry
        turn, slope = _turn(fixed, s)
        steepest = jnp.where(slope == 0.0, 1.0, jnp.abs(slope))
        angle = jnp.clip(turn / steepest, -_FARTHEST, _FARTHEST)
        return _by_angle(s, angle), jnp.abs(angle), count + 1

    squared = dot(start, start)  # zero in a lane that does not slip
    begun = start / jnp.sqrt(jnp.where(squared > 0.0, squared, 1.0))
    carry = jax.lax.stop_gradient(begun), jnp.ones_like(start[0]), jnp.asarray(0)
    close = at_precision(_CLOSE, start)
    going: Callable[[_Search], Array] = lambda carry: (
        (carry[1] > close) & (carry[2] < _TURNS)
    )
    s, angle, _ = jax.lax.while_loop(going, turned, carry)
    turn, slope = _turn(balance, s)
    s = _by_angle(s, -turn / jnp.where(slope == 0.0, 1.0, slope))
    # a slip stays where it does not turn, and turns back to: elsewhere it cannot begin
    found = (angle <= close) & (slope < 0.0)
    return jnp.where(found, s, jnp.nan)


def settling_way(
    s: Float[Array, "2"], slip: Float[Array, "2"], onset: Float[Array, ""]
) -> Array:
    """Way of the friction of a slip U that begins along s, which may itself turn [1].

    Friction turns a slip r s back onto s at a rate of sigma / r, so that it lags by
    ``r / sigma`` times the turn of s. One that is turned back at ``sigma / R``, from
    ``U . s' / R`` across s, lags by as much: with R = ``onset`` slow enough for
    steps to follow, and as it will be followed from there on. Without, U would sum its
    rates along each s that there was.
    """
    across = jnp.stack([-s[1], s[0]])
    lag = dot(slip, across) / onset
    return (s + lag * across) / jnp.sqrt(1.0 + lag * lag)


def _turn(balance: Balance, s: Float[Array, "2"]) -> tuple[Array, Array]:
    """``s' . (B - M s)``, and its derivative by the angle of s."""
    across = jnp.stack([-s[1], s[0]])
    rate = balance.B - matvec(balance.M, s)
    return dot(across, rate), -dot(s, rate) - dot(across, matvec(balance.M, across))


def _by_angle(s: Float[Array, "2"], angle: Float[Array, ""]) -> Float[Array, "2"]:
    """A direction, turned."""
    across = jnp.stack([-s[1], s[0]])
    return s * jnp.cos(angle) + across * jnp.sin(angle)
