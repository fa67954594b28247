"""Constraints that follow from others, and whether they still do.

Which of a system's constraints follow from others is found at one place. A motion obeys
the others alone: where one that was left out does not follow any more, it ends.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..validation.checks import FieldError
from .system import KaneState, KaneSystem

# of coordinates and speeds, and of units of both: what rank decides by at the start. Of
# rows that follow from others, roundings are left: below 1e-12 after 100 s
_HOLDS = 1e-9
_ROUNDINGS = 1e3  # where these are more, in single precision
# times the square of what a projection closed, and a unit: what it leaves on surfaces
# with radii down to a thousandth of one
_CURVED = 1e3
# starts may be off by this many relative tolerances, see configuration
_KEPT = 100.0


class Followed(NamedTuple):
    """What becomes of the rows along a motion.

    Attributes:
        values: Of the rows, zero where they follow from others, shape (k,).
        rates: Shape (k,).
        sizes: Of coordinates and speeds and of their rates, each the largest and a
            unit, shape (2,).
    """

    values: Float[Array, " k"]
    rates: Float[Array, " k"]
    sizes: Float[Array, "2"]


def _size(*arrays: Array) -> Array:
    return sum((jnp.max(jnp.abs(x)) for x in arrays), jnp.ones(()))


def followed_along(
    system: KaneSystem, t: Array, q: Array, u: Array, q_dot: Array, u_dot: Array
) -> Followed | None:
    """What becomes of the rows along a motion; None without any.

    Args:
        system: The system.
        t: Time [s].
        q: Coordinates.
        u: All speeds.
        q_dot: Their rates.
        u_dot: Likewise.
    """
    rows = system.implied
    if rows is None:
        return None

    def values(t: Array, q: Array, u: Array) -> Array:
        return system.at(rows, t, q, u)

    moved = jnp.ones_like(t), q_dot, u_dot
    sizes = jnp.stack([_size(q, u), _size(q_dot, u_dot)])
    found, rates = jax.jvp(values, (t, q, u), moved)
    return Followed(found, rates, sizes)


def refuse_lost(
    system: KaneSystem,
    found: Followed | None,
    rtol: float,
    where: str,
) -> None:
    """Refuse a start at which rows follow from others by chance, or not at all.

    Args:
        system: The system.
        found: What becomes of the rows along a motion.
        rtol: Relative tolerance of the motion [1].
        where: State and time, for the error.

    Raises:
        FieldError: rows are not zero along that motion.
    """
    if found is None:
        return
    values, rates, (size, quick) = (np.asarray(x) for x in found)
    allowed = max(_HOLDS, _KEPT * rtol) * size
    # a rate has products of two speeds
    lost = (np.abs(values) > allowed) | (np.abs(rates) > allowed * quick)
    if lost.any():
        names = [name for k, name in enumerate(system.implied_names) if lost[k]]
        raise FieldError(
            "start.q",
            names,
            "is where constraints that were left out do not follow from the others, or "
            f"only by chance, not beside it{where}: see these",
            "make the system by kane.rolling_contacts from another start, a little "
            "farther on, where all constraints count, or leave out a contact",
        )


def lost(
    system: KaneSystem, t: Array, q: Array, u: Array, moved: Array
) -> Float[Array, " k"]:
    """How far each row is from zero, of what may be left where it follows [1].

    Args:
        system: One with rows that follow from others.
        t: Time [s].
        q: Coordinates, projected.
        u: All speeds, as the other constraints allow them.
        moved: How far the projection moved the coordinates.
    """
    assert system.implied is not None
    values = system.at(system.implied, t, q, u)
    rounding = float(np.finfo(np.dtype(values.dtype)).eps)
    least = max(_HOLDS, _ROUNDINGS * rounding)
    off = jnp.max(jnp.abs(moved))
    return jnp.abs(values) / ((least + _CURVED * off * off) * _size(q, u))


def while_they_follow(
    system: KaneSystem, t: Array, q: Array, u: Array, moved: Array, rates: KaneState
) -> KaneState:
    """Rates of a motion, NaN where rows do not follow any more: no step goes there.

    Args:
        system: One with rows that follow from others.
        t: Time [s].
        q: Coordinates, projected.
        u: All speeds, as the other constraints allow them.
        moved: How far the projection moved the coordinates.
        rates: Of the state.
    """
    follow = jnp.all(lost(system, t, q, u, moved) < 1.0)

    def ended(x: Array) -> Array:
        return jnp.where(follow, x, jnp.nan)

    return jax.tree.map(ended, rates)
