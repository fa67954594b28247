"""States at which equations are compared: of any kind, and near given ones."""

from collections.abc import Callable
from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..dynamics.consistency import consistent
from ..dynamics.scene import Scene
from ..geometry.surfaces import AbstractSurface
from ..kinematics.coordinates import SlidingState, State, shared_parts
from .independent_coordinates import IndependentCoordinates, alike
from .surface_motions import seeds

ROWS = 16  # draws that one compiled program looks at
# How far from a given state, beside a radian and the body's length: what is narrow is
# felt close by, what is wide at the size of body and base. The last of them is a place
# anywhere on the base, with all else near.
_SCALES = 1e-3, 1e-2, 0.1, 1.0, 0.1
_ANYWHERE = len(_SCALES) - 1
_NEAR = 2 * ROWS  # draws near given states: each state itself, and neighbours


class Draws(NamedTuple):
    """States, not yet consistent, each with steps of its contact points.

    Attributes:
        times: [s], shape (N,).
        states: Every array with a leading N.
        on_base: Steps from their contacts in local coordinates, shape (N, 2).
        on_body: Likewise on the body; not looked at where it has no coordinates.
        near: Whether they are given states and neighbours of these, shape (N,).
        fast: Whether velocities in them are of one in any case, shape (N,).
    """

    times: np.ndarray
    states: State
    on_base: np.ndarray
    on_body: np.ndarray
    near: np.ndarray
    fast: np.ndarray


def rows_of(draws: Draws, rows: Any) -> Draws:
    """Some of them."""
    some: Callable[[Any], Any] = lambda part: part[rows]
    return cast(Draws, jax.tree.map(some, draws))


def both_draws(first: Draws, more: Draws) -> Draws:
    """One after the other."""
    join: Callable[[Any, Any], Any] = lambda a, b: np.concatenate([a, b])
    return cast(Draws, jax.tree.map(join, first, more))


def any_draws(scene: Scene, dtype: np.dtype[Any]) -> Draws:
    """Draws of any kind, on surfaces where these have samples."""
    draw = np.random.default_rng(1)

    def normal(*shape: int) -> np.ndarray:
        return draw.standard_normal(shape).astype(dtype)

    def pick(u: np.ndarray) -> np.ndarray:
        return u[draw.integers(u.shape[0], size=ROWS)].astype(dtype)

    on_body = np.zeros((ROWS, 0), dtype)
    if scene.has_contact_coordinates:
        on_body = pick(seeds(scene.body.surface))
    n = scene.coordinate_count
    parts: dict[str, Any] = {
        "orientation": normal(ROWS, 4),
        "angular_velocity": normal(ROWS, 3),
        "contact_on_base": pick(seeds(scene.base.surface)),
        "contact_on_body": on_body,
        "alpha": normal(ROWS, n),
        "alpha_dot": normal(ROWS, n),
    }
    kind = State
    if scene.contact.slips:
        kind, parts["slip"] = SlidingState, normal(ROWS, 3)
    still, near = np.zeros((ROWS, 2), dtype), np.zeros(ROWS, bool)
    return Draws(normal(ROWS), kind(**parts), still, still, near, ~near)


def near_draws(scene: Scene, times: np.ndarray, places: State) -> Draws:
    """Given states and neighbours of them, at distances of several scales.

    Args:
        scene: What rolls on what.
        times: Of the states [s], shape (P,).
        places: Every array with a leading P.
    """
    known: Any = jax.tree.map(np.asarray, places)
    dtype, count = known.orientation.dtype, times.size
    each = max(2, -(-_NEAR // count))
    total = -(-count * each // ROWS) * ROWS
    place = np.minimum(np.arange(total) // each, count - 1)
    own = np.concatenate([[True], place[1:] != place[:-1]])
    turn = np.cumsum(~own) - 1
    kind = turn % len(_SCALES)
    far = np.where(own, 0.0, np.asarray(_SCALES)[kind])
    # every other time round with velocities of one, beside which rounding is small
    fast = ~own & (turn // len(_SCALES) % 2 == 1)
    pace = np.where(fast, 1.0, far)
    draw = np.random.default_rng(5)

    def beside(part: Any, size: Any) -> np.ndarray:
        step = draw.standard_normal((total, part.shape[1])) * np.asarray(size)[:, None]
        return (part[place] + step).astype(dtype)

    sizes = _contact_sizes(scene, times, known)
    whole = np.linalg.norm(known.orientation, axis=1)[place]
    on_base = known.contact_on_base[place]
    anywhere = ~own & (kind == _ANYWHERE)
    samples = seeds(scene.base.surface)
    on_base[anywhere] = samples[draw.integers(len(samples), size=anywhere.sum())]
    parts: dict[str, Any] = {
        "orientation": beside(known.orientation, far * whole),
        "angular_velocity": beside(known.angular_velocity, pace),
        "contact_on_base": on_base,
        "contact_on_body": known.contact_on_body[place],
        "alpha": beside(known.alpha, far),
        "alpha_dot": beside(known.alpha_dot, pace),
    }
    kind_of = State
    if isinstance(known, SlidingState):
        kind_of, slipping = SlidingState, pace * sizes["slip"][0]
        parts["slip"] = beside(known.slip, slipping)
    nothing = np.zeros((count, 2), dtype)
    return Draws(
        beside(times.astype(dtype)[:, None], far)[:, 0],
        kind_of(**parts),
        beside(nothing, far) * sizes["contact on base"].astype(dtype),
        beside(nothing, far) * sizes["contact on body"].astype(dtype),
        np.ones(total, bool),
        fast,
    )


def _contact_sizes(
    scene: Scene, times: np.ndarray, places: State
) -> dict[str, np.ndarray]:
    """Steps of contacts that are alike, as of the first place, and the length [m]."""
    one: Callable[[Any], Array] = lambda part: jnp.asarray(part[0])
    first = cast(State, jax.tree.map(one, places))
    t = jnp.asarray(times[0], first.orientation.dtype)
    around = IndependentCoordinates(scene, t, first)
    found = {"contact on body": np.ones(2), "slip": np.ones(1)}
    ends = np.cumsum(list(around.sizes.values()))
    parts = np.split(alike(around), ends[:-1])
    both = zip(around.sizes, parts, strict=True)
    return found | {name: part for name, part in both if part.size}


def drawn(scene: Scene, t: Float[Array, ""], draw: Any) -> State:
    """A draw's state, that the contact allows; no number where it finds no surface."""
    on_base = _beside(scene.base.surface, draw.states.contact_on_base, draw.on_base)
    parts: dict[str, Any] = shared_parts(draw.states) | {"contact_on_base": on_base}
    if scene.has_contact_coordinates:
        surface, u = scene.body.surface, draw.states.contact_on_body
        parts["contact_on_body"] = _beside(surface, u, draw.on_body)
    if isinstance(draw.states, SlidingState):
        moved: State = SlidingState(**parts, slip=draw.states.slip)
    else:
        moved = State(**parts)
    return cast(State, consistent(scene, t, moved))


def _beside(surface: AbstractSurface, u: Array, x: Array) -> Array:
    """Coordinates of a point beside, settled: far off that takes several times."""
    near = surface.neighbour(u, x)
    for _ in range(2):
        near = surface.settled(near)
    again = surface.settled(near)
    # settling squares a miss: of the rounding's root it leaves the rounding
    loose = float(np.sqrt(np.finfo(u.dtype).eps))
    misses = jnp.max(jnp.abs(again - near)) > loose * jnp.max(jnp.abs(near))
    return jnp.where(misses, jnp.nan, again)
