"""How long a step of a slip may be, and when one is still what it began as."""

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ..dynamics.directed_friction import SMALLEST_SLIP, begins
from ..dynamics.precision import at_precision
from ..geometry.small_linear import dot
from .mode_rates import Step
from .mode_replay import Place
from .modes import Mode

# Rate times step: methods of orders 3 and 5 are stable to 2.5 and 3.3 at least
SETTLES = 2.0
# Of the time until a slip ends, in one step: tangents of an ellipsoid's end are then
# known to 5e-12 (Dopri8 at rtol 1e-9), to 5e-11 with a half
NEARER = 0.25
# [m/s]: a slip is regular down to SMALLEST_SLIP, and ends within it
_ENDED_SLIP = 30.0 * SMALLEST_SLIP


def longest_step(
    at: Place,
    known: Float[Array, ""],
    t: Float[Array, ""],
    end: Step,
    onset: Float[Array, ""],
) -> Float[Array, ""]:
    """The longest step that a slip allows behind one [s]; else infinite.

    Args:
        at: Where the step before it began.
        known: How fast the slip was there, along its way [m/s].
        t: When that step ended [s].
        end: What it ended as.
        onset: Speed until which a slip only begins [m/s].
    """
    before_its_end = _before_its_end(at, known, t, end)
    return jnp.minimum(_while_it_turns(at, end, onset), before_its_end)


def _while_it_turns(at: Place, end: Step, onset: Float[Array, ""]) -> Float[Array, ""]:
    """The longest step in which a slip's direction settles, and does not swing.

    Friction turns it at a rate mu N / r, stiff where r is small. A straight slip does
    not show it; what differs from it, its tangents, would grow with each step. One
    that begins settles as slowly as one of the onset.
    """
    slip = jnp.sqrt(dot(end.y.slip, end.y.slip))
    slip = slip + at_precision(SMALLEST_SLIP, slip)
    turns = (at.mode == Mode.SLIPPING) & (end.turn > 0.0)
    settling = jnp.maximum(slip, onset)
    slip = jnp.where(begins(at.direction), settling, slip)
    turn = jnp.where(turns, end.turn, 1.0)
    return jnp.where(turns, SETTLES * slip / turn, jnp.inf)


def _before_its_end(
    at: Place, known: Float[Array, ""], t: Float[Array, ""], end: Step
) -> Float[Array, ""]:
    """A share of the time until a slip ends at its present rate.

    Beyond its end friction turns round, and such a step is tried in vain. Across the
    slip rates vary as one over it: no error is known of tangents along them.
    """
    left = end.values[0]
    lost = known - left  # nothing, without friction
    ends = (at.mode == Mode.SLIPPING) & ~begins(at.direction)
    ends &= (lost > 0.0) & (left > 0.0)
    taken = t - at.t  # and what the law leaves of it: so it does end
    left = left + at_precision(SMALLEST_SLIP, left)
    until = left * taken / jnp.where(ends, lost, 1.0)
    return jnp.where(ends, NEARER * until, jnp.inf)


def is_as_it_began(
    at: Place, t: Float[Array, ""], end: Step, onset: Float[Array, ""]
) -> Bool[Array, ""]:
    """Whether a slip that begins is not yet far too fast to be one.

    Nor too fast to be one still where the contact ends: its friction, whose direction
    its tangents need, is rounding there. Nor swings, by a step that is still as long
    as those before it began.
    """
    squared, lifts = dot(end.y.slip, end.y.slip), end.values[1] < 0.0
    fast = (squared > (2.0 * onset) ** 2) | (lifts & (squared > onset**2))
    # a quarter more is 2.5, to which methods of order 3 are stable
    swings = t - at.t > 1.25 * _while_it_turns(at, end, onset)
    return (at.mode != Mode.SLIPPING) | ~begins(at.direction) | ~(fast | swings)


def has_turned(at: Place, end: Step) -> Bool[Array, ""]:
    """Whether a slip that stands across its old direction has turned, not ended."""
    squared = dot(end.y.slip, end.y.slip)
    ended = at_precision(_ENDED_SLIP, squared)
    return (squared > ended**2) & ~begins(at.direction)
