"""Whether a landing may hide in a step of a flight.

Flight has no error to speak of, and does not feel the base: its steps grow beyond a
bounce. So the gap is looked at inside of each step, on the cubic through the states at
its ends, and by how far body and base could have come towards each other.
"""

from collections.abc import Callable
from typing import TypeAlias, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ..dynamics.clearance import may_touch_twice
from ..dynamics.gap import closing
from ..dynamics.nearest_anywhere import nearest_anywhere
from ..dynamics.scene import Scene
from ..geometry.small_linear import norm
from ..kinematics.coordinates import State, pack, unpack
from .event_bounds import Doubt, cubic, in_flight, largest_defect
from .mode_rates import Step
from .mode_replay import Place
from .modes import HybridState

_PLACES = np.linspace(0.0, 1.0, 9)
# Of the reach of a body: over a base with several nearest places it moves by so much
# in a step at least, an eighth of it from place to place. Two surfaces as round as the
# body that pass each other on such a way are (0.5 / 8)^2 / 8 = 5e-4 of it inside of
# each other at most
_LEAST_WAY = 0.5
_TRUST = 0.8  # of gaps between surfaces that are known to first order far away
_ROUNDINGS = 64.0  # of a gap: it is the difference of places
_SLACK = 1.1  # on speeds at the ends of a step, between which a fall is no faster

# Contact coordinates of the nearest points, on the base and on the body.
_Places: TypeAlias = tuple[Float[Array, " k"], Float[Array, " m"]]


def doubt_in_flight(
    scene: Scene,
    nodes: Float[Array, " s"],
    at: Place,
    t1: Float[Array, ""],
    end: Step,
    before: Float[Array, ""],
    reach: Float[Array, ""],
) -> Doubt:
    """Whether the body may have touched its base, or another place of it.

    Args:
        scene: What flies over what.
        nodes: Shares of the step at which its method knows rates.
        at: Where the step began.
        t1: Where it ends [s].
        end: The step.
        before: Gap where it began [m]; NaN right behind a contact.
        reach: Of the body, from its origin [m].
    """
    h = t1 - at.t
    gaps = jnp.stack([_at_start(before), end.values[0]])
    turns = may_touch_twice(scene)
    fastest = _fastest(scene, at, t1, end, reach)
    share = _TRUST if turns else 1.0
    apart = share * jnp.sum(gaps) > fastest * h
    inside = lambda: _inside(scene, nodes, at, h, end, gaps, reach)
    if scene.base.motion is None:
        one = jnp.ones_like(h)
        clear = Doubt(jnp.asarray(False), one, jnp.inf * one), fastest
        clearly = lambda: clear
        doubt, fastest = cast(tuple[Doubt, Array], jax.lax.cond(apart, clearly, inside))
    else:
        doubt, fastest = inside()
    if not turns:
        return doubt
    # other places than the nearest: what they can come closer by
    least = _LEAST_WAY * reach
    limit = jnp.maximum(share * jnp.sum(gaps), least) / (fastest * h)
    shorter = jnp.where(doubt.hides, jnp.minimum(doubt.share, limit), limit)
    following = jnp.maximum(gaps[1], least) / fastest
    return Doubt(doubt.hides | (limit < 0.99), shorter, following)


def closes_as_it_may(
    scene: Scene,
    at: Place,
    t1: Float[Array, ""],
    end: Step,
    before: Float[Array, ""],
    reach: Float[Array, ""],
) -> Bool[Array, ""]:
    """Whether the gap fell by no more than the body moved: else it is another's.

    Over the flat of a disc no point of its rim is the nearest, and the search ends at
    one on the far side, of a gap less than zero.

    Args:
        scene: What flies over what.
        at: Where the step began.
        t1: Where it ends [s].
        end: The step.
        before: Gap where it began [m]; NaN right behind a contact.
        reach: Of the body, from its origin [m].
    """
    moved = _fastest(scene, at, t1, end, reach) * (t1 - at.t)
    return ~(end.values[0] < _at_start(before) - moved - rounding(end.y, reach))


def _at_start(before: Float[Array, ""]) -> Float[Array, ""]:
    """The gap where a step begins [m]: none right behind a contact."""
    return jnp.where(before > 0.0, before, 0.0)


def _fastest(
    scene: Scene,
    at: Place,
    t1: Float[Array, ""],
    end: Step,
    reach: Float[Array, ""],
) -> Float[Array, ""]:
    """How fast a point of the body may move over its base in a step, by its ends."""

    def speed(t: Float[Array, ""], y: HybridState) -> Float[Array, ""]:
        _, v, spin = closing(scene, t, y.flying())
        return v + spin * reach

    return _SLACK * jnp.maximum(speed(at.t, at.y), speed(t1, end.y))


def rounding(y: HybridState, reach: Float[Array, ""]) -> Float[Array, ""]:
    """Of a gap [m].

    Args:
        y: Where the body flies.
        reach: Of it, from its origin [m].
    """
    size = norm(y.position) + reach
    return _ROUNDINGS * np.finfo(size.dtype).eps * size


def _inside(
    scene: Scene,
    nodes: Float[Array, " s"],
    at: Place,
    h: Float[Array, ""],
    end: Step,
    gaps: Float[Array, "2"],
    reach: Float[Array, ""],
) -> tuple[Doubt, Float[Array, ""]]:
    """Doubt about the nearest place by what is seen inside, and the fastest speed."""
    ends = jnp.stack([pack(at.y), h * end.rates[0], pack(end.y), h * end.rates[-1]])
    weights = jnp.asarray(cubic(_PLACES), h.dtype)
    places: Callable[[State], _Places] = lambda y: (
        y.contact_on_base,
        y.contact_on_body,
    )

    def look(
        closest: _Places, row: tuple[Float[Array, "4"], Float[Array, ""]]
    ) -> tuple[_Places, tuple[Float[Array, ""], Float[Array, ""], Float[Array, ""]]]:
        weight, share = row
        y = eqx.tree_at(places, unpack(weight @ ends, at.y).flying(), closest)
        t = at.t + share * h
        gap, y = nearest_anywhere(scene, t, y)
        rate, v, spin = closing(scene, t, y)
        return places(y), (gap, h * rate, v + spin * reach)

    rows = weights, jnp.asarray(_PLACES, h.dtype)
    _, (seen, rates, speeds) = jax.lax.scan(look, places(at.y), rows)
    first = jnp.where(gaps[0] > 0.0, gaps[0], jnp.where(seen[0] > 0.0, seen[0], 0.0))
    seen = seen.at[0].set(first).at[-1].set(gaps[1])
    off = unpack(largest_defect(nodes, ends, h * end.rates), at.y)
    turned = 2.0 * norm(off.orientation) / norm(at.y.orientation)
    wrong = norm(off.position) + turned * reach
    doubt = in_flight(seen, rates, wrong, rounding(at.y, reach))
    return doubt, _SLACK * jnp.max(speeds)
