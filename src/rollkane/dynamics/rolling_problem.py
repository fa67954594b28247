"""What integrating a rolling scene asks of it, whichever loop does it."""

from collections.abc import Callable
from typing import Any, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..geometry.small_linear import norm
from ..geometry.surfaces import AbstractSurface
from ..kinematics.base_motion import BESIDE_JUMPS
from ..kinematics.voronets import CHART_EDGE, ChartContact
from ..validation.checks import is_traced
from ..validation.codes import Code, is_stuck
from .abstract_supported import rolling_parts
from .rolling import (
    LEAST_MARGIN,
    contact_of,
    headings,
    painleve_margin,
    watches_headings,
)
from .scene import Scene

# A run that ends at the end of a surface is as close to it as the clock's steps tell
# [s], and the normal of a disc that lies down is this close to that of its face [rad]:
# twice what steps of loose runs come to (`codegen.least_product`).
_AT_AN_EDGE, _FLAT = 1e-9, 2e-2

_Extent: TypeAlias = Callable[[Array], Array | None]
# What no step may reverse, of a scene, a time [s] and a state.
Unbroken: TypeAlias = Callable[[Scene, Array, Any], list[Array]]


def corners(scene: Scene) -> tuple[Any, int]:
    """Kinks of all that is a function of time [s]; how many numbers steps stay away."""
    motion = scene.base.motion
    if motion is None or motion.kinks is None:
        return scene.kinks, BESIDE_JUMPS
    if scene.kinks is None:
        return motion.kinks, motion.kept_away
    times = motion.kinks, scene.kinks
    # known ones stay known inside of `jit`
    return (jnp if is_traced(times) else np).concatenate(times), BESIDE_JUMPS


def error_sizes(state: Any) -> Any:
    """Sizes of a state's numbers, for the default absolute tolerance.

    Those of the angular velocity are its length: of a body that spins fast no component
    is known better than the rounding of the largest.
    """
    w = state.angular_velocity
    fast = jnp.maximum(norm(w), 1.0)
    fast = jnp.where(jnp.isfinite(fast), fast, 1.0)  # a bad start is refused elsewhere
    one: Callable[[Array], Array] = lambda x: jnp.ones_like(x)
    sizes = jax.tree.map(one, state)
    sizes = eqx.tree_at(lambda s: s.angular_velocity, sizes, jnp.full_like(w, fast))
    if not state.supported:
        return sizes
    inner = tuple(error_sizes(own) for own in state.supported)
    return eqx.tree_at(lambda s: s.supported, sizes, inner)


def unbroken(scene: Scene, state: Any) -> Unbroken | None:
    """What no step may reverse; None: nothing. See ``dynamics.rolling.headings``."""
    del state
    return headings if watches_headings(scene) else None


def has_margin(scene: Scene) -> bool:
    """Whether something is proportional to the normal force."""
    loads = any(load.needs_normal_force for load in scene.loads)
    return scene.contact.needs_normal_force or loads


def explains_ends(scene: Scene, state: Any) -> bool:
    """Whether a run that got stuck may have a reason that the scene tells."""
    return state.in_charts or has_margin(scene) or has_edges(scene)


def has_edges(scene: Scene) -> bool:
    """Whether a contact may come to the end of a surface."""
    surfaces = scene.body.surface, scene.base.surface
    ends = any(_ends(surface) for surface in surfaces)
    inner = any(has_edges(part.scene) for part in rolling_parts(scene.supported))
    return ends or inner or watches_headings(scene)


def _ends(surface: Any) -> bool:
    like = jax.ShapeDtypeStruct((surface.coordinate_count,), float)
    return jax.eval_shape(surface.extent, like) is not None


@jax.jit
def explained(code: Array, scene: Scene, t: Array, state: Any) -> Array:
    """The code of a run, where it got stuck by what stopped it.

    Args:
        code: One of :class:`rollkane.Code`.
        scene: What rolls on what.
        t: Time that was reached [s].
        state: State that was reached.
    """
    stuck = is_stuck(code)
    contact = contact_of(scene, t, state)
    if isinstance(contact, ChartContact):
        at_chart = contact.regularity < 2.0 * CHART_EDGE
        code = jnp.where(stuck & at_chart, Code.CHART_EDGE, code)
    if has_edges(scene):
        at_end = stuck & at_an_edge(scene, t, state)
        code = jnp.where(at_end, Code.SURFACE_EDGE, code)
    if has_margin(scene):
        jams = painleve_margin(scene, t, state) < LEAST_MARGIN
        code = jnp.where(stuck & jams, Code.PAINLEVE, code)
    return code


def at_an_edge(scene: Scene, t: Array, state: Any) -> Array:
    """Whether a contact has come to the end of a surface."""
    body, base = scene.body.surface, scene.base.surface
    in_charts = state.in_charts
    of: Callable[[AbstractSurface], _Extent] = lambda surface: (
        surface.chart_extent if in_charts else surface.extent
    )
    contact = contact_of(scene, t, state)
    places: list[tuple[_Extent, Array, Array]] = [
        (of(base), state.contact_on_base, contact.base_rates)
    ]
    if scene.has_contact_coordinates or in_charts:
        places.append((of(body), state.contact_on_body, contact.body_rates))
    found = jnp.asarray(False)
    for extent, u, rates in places:
        if extent(u) is None:
            continue
        left, rate = jax.jvp(extent, (u,), (rates,))
        soon = left <= -rate * _AT_AN_EDGE * (1.0 + jnp.abs(t))
        found |= soon | (left <= 0.0)
    if watches_headings(scene):
        for vector in headings(scene, t, state):
            found |= norm(vector) < _FLAT
    for part, own in zip(rolling_parts(scene.supported), state.supported, strict=True):
        found |= at_an_edge(part.scene, t, own)
    return found
