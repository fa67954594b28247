"""The nearest points of whole surfaces, which may touch at several places.

Searches begin at the lowest samples of both (:mod:`.clearance`), and where a base goes
on beyond its samples at those about the place that was the nearest before.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeVar, cast

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ..codegen.jaxpr_types import Shaped
from ..codegen.tracing import shared_in_c
from ..kinematics.coordinates import FlyingState
from .clearance import lowest_places, may_touch_twice, reach_of
from .nearest_points import (
    NEWTON,
    Found,
    Places,
    begun_at,
    nearest,
    nearest_from,
    places_of,
    searched,
)
from .scene import Scene

_Value = TypeVar("_Value")


class _Lowest(NamedTuple):
    """The lowest of the places where a search over the whole surfaces began.

    Attributes:
        found: What was found from there; places of a sample where that strays.
        sampled: Gap of the sample [m].
        strays: Whether the search did not end near its sample.
    """

    found: Found
    sampled: Float[Array, ""]
    strays: Bool[Array, ""]

    @property
    def gap(self) -> Float[Array, ""]:
        """That counts [m]."""
        return jnp.where(self.strays, self.sampled, self.found.gap)


@shared_in_c
def nearest_anywhere(
    scene: Scene, t: Float[Array, ""], state: FlyingState
) -> tuple[Float[Array, ""], FlyingState]:
    """The same of the whole surfaces, where they may touch at several places.

    The search begins where samples of both surfaces are nearest
    (:func:`rollkane.dynamics.clearance.lowest_places`), wherever the state's
    coordinates are; over a base that goes on beyond its samples also where it goes on,
    about these.
    """
    if not may_touch_twice(scene):
        return nearest(scene, t, state)
    fixed = jax.lax.stop_gradient((scene, t, state))
    shift = scene.base.surface.beyond_samples(fixed[2].contact_on_base)
    if shift is None:
        lowest = _lowest_of_samples(*fixed)
    else:
        lowest = _with_what_is_beyond(*fixed, shift)
    gap, closest = nearest_from(scene, t, state, lowest.found)
    stays: Callable[[Array, Array], Array] = lambda a, b: jnp.where(lowest.strays, a, b)
    on_base, on_body = places_of(closest)
    on_base = stays(lowest.found.places[0], on_base)
    if lowest.found.on_face is None:
        on_body = stays(lowest.found.places[1], on_body)
    closest = eqx.tree_at(places_of, closest, (on_base, on_body))
    return jnp.where(lowest.strays, lowest.sampled, gap), closest


def _lowest_of_samples(
    scene: Scene, t: Float[Array, ""], state: FlyingState
) -> _Lowest:
    """What is found from the lowest samples."""
    gaps, starts = lowest_places(scene, t, state)
    size = reach_of(scene.body.surface, gaps.dtype)

    def near(low: tuple[Array, Float[Array, "3"]]) -> _Lowest:
        # no step, which finds nothing, from where there is no low sample
        gap, place = low
        steps = jnp.where(jnp.isfinite(gap), NEWTON, 0)
        begun = begun_at(scene, t, state, place)
        found = searched(scene, t, begun, steps)
        # far from an uneven base Newton's method may go astray: the samples will do
        strays = ~(jnp.abs(found.gap - gap) <= 0.1 * size + 0.2 * jnp.abs(gap))
        on_base, on_body = found.places
        on_base = jnp.where(strays, begun.contact_on_base, on_base)
        if found.on_face is None:  # else they are those of its rim
            on_body = jnp.where(strays, begun.contact_on_body, on_body)
        places = on_base, on_body
        return _Lowest(found._replace(places=places), gap, strays)

    # one after the other: a program of one is compiled in a fraction of the time
    return _best_of(cast(_Lowest, jax.lax.map(near, (gaps, starts))))


def _best_of(lowest: _Lowest) -> _Lowest:
    """Of several the lowest."""
    best = jnp.argmin(lowest.gap)
    at_best: Callable[[Array], Array] = lambda x: x[best]
    return jax.tree.map(at_best, lowest)


def _with_what_is_beyond(
    scene: Scene, t: Float[Array, ""], state: FlyingState, shift: Float[Array, " k"]
) -> _Lowest:
    """What is found from the samples of a base, or beyond them, where that is lower.

    Args:
        scene: What flies over what.
        t: Time [s].
        state: Where its base's coordinates are is where else is looked.
        shift: From the samples to there; zero where they are among them.
    """
    about: Callable[[Array], _Lowest] = lambda x: _lowest_about(scene, t, state, x)
    like = cast(_Lowest, jax.eval_shape(about, shift))
    zeros: Callable[[Shaped], Array] = lambda x: jnp.zeros(x.shape, x.dtype)
    nothing = jax.tree.map(zeros, like)
    infinite = jnp.full_like(nothing.sampled, jnp.inf)
    nothing = nothing._replace(sampled=infinite, strays=jnp.ones_like(nothing.strays))

    def look(place: tuple[Array, Bool[Array, ""]]) -> _Lowest:
        by, looks = place
        return cast(_Lowest, jax.lax.cond(looks, about, lambda _: nothing, by))

    # a loop, of which a program has one
    shifts = jnp.stack([jnp.zeros_like(shift), shift])
    is_beyond = jnp.any(shift != 0.0)
    looks = jnp.stack([jnp.ones_like(is_beyond), is_beyond])
    return _best_of(cast(_Lowest, jax.lax.map(look, (shifts, looks))))


def _lowest_about(
    scene: Scene, t: Float[Array, ""], state: FlyingState, shift: Float[Array, " k"]
) -> _Lowest:
    """What is found with the samples of the base elsewhere; places are the base's."""
    base = scene.base.surface.continued(shift)
    there = eqx.tree_at(lambda s: s.base.surface, scene, base)
    places = state.contact_on_base - shift
    moved = eqx.tree_at(lambda s: s.contact_on_base, state, places)
    found = _lowest_of_samples(there, t, moved)
    on_base, on_body = found.found.places
    of_base = found.found._replace(places=(on_base + shift, on_body))
    return found._replace(found=of_base)


def at_nearest(
    scene: Scene, t: Float[Array, ""], state: Any, function: Callable[[Any], _Value]
) -> _Value:
    """What a function of a state gives, in flight at the nearest points.

    A flight has them at the ends of its steps, if it may land; here they are looked for
    where the function looks at them, and nowhere else.
    """
    if state.touches or not _reads_places(function, state):
        return function(state)
    return function(nearest_anywhere(scene, t, state)[1])


def _reads_places(function: Callable[[Any], Any], state: FlyingState) -> bool:
    """Whether a function looks at the coordinates of the nearest points."""

    def of_places(places: Places) -> Any:
        return function(eqx.tree_at(places_of, state, places))

    program = jax.make_jaxpr(of_places)(places_of(state)).jaxpr
    return _reads(program, program.invars)


def _reads(program: Any, variables: Sequence[Any]) -> bool:
    """Whether a traced program does anything with some of its variables."""
    asked = {id(v) for v in variables}
    for equation in program.eqns:
        given = [id(v) in asked for v in equation.invars]
        if any(given) and equation.primitive.name not in ("jit", "pjit"):
            return True
        if any(given):
            inner = equation.params["jaxpr"].jaxpr
            taken = [v for v, own in zip(inner.invars, given, strict=True) if own]
            if _reads(inner, taken):
                return True
    return any(id(v) in asked for v in program.outvars)
