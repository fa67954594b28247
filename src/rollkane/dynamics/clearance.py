"""The least distance of body and base anywhere: second contacts, bodies that overlap.

Local conditions at a contact say nothing of the other end of a long body. Here each
surface is sampled as a whole, and the lowest places are searched further; features much
narrower than the distance of the samples (about a fifteenth of a body's size) may be
missed. Two convex surfaces touch at one place only: for them there is nothing to do.
"""

from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias, cast

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from numpy.typing import NDArray

from ..codegen.compile_effort import for_one_call
from ..geometry.rotations import rotation_matrix
from ..geometry.small_linear import matvec, matvec_transposed, norm
from ..geometry.surfaces import AbstractSurface, Ball
from ..kinematics.base_motion import BaseKinematics
from ..kinematics.contact import body_to_base
from ..kinematics.coordinates import FlyingState
from ..kinematics.voronets import AnyState
from ..validation.codes import Code, is_stuck
from ..validation.remembered import of_numbers
from .precision import at_precision
from .rolling import contact_of
from .scene import Scene

_LOWEST = 8  # local minima of the samples that are searched further
# The lowest of the others that are: where surfaces nearly fit each other a second place
# lies in the valley of the first, and no sample of it is lower than all around. Without
# them 4 of 40 places in waves were missed, with one 2, with two none; three times that
_IN_VALLEYS = 6
_NEAREST = 4  # of those of a body in flight, which Newton's method improves
_NEAR = 8  # neighbours of a sample
_ROUNDS, _SHRINK = 12, 0.4  # to 2e-5 of the samples' distance: 1e-10 of its gap

_Map: TypeAlias = Callable[[Float[Array, "3"]], Float[Array, "3"]]
_Lowest: TypeAlias = Callable[[Float[Array, " k"]], tuple[Array, Array]]
# Signed distance of a point [m]; None: a surface without an inside.
_Level: TypeAlias = Callable[[Float[Array, "3"]], Float[Array, ""] | None]


class _Side(NamedTuple):
    """A surface to look along.

    Attributes:
        surface: Whose samples are looked at.
        level: Of the other [m].
        on_base: From axes of the surface to those of the base.
        searched: Whether the level takes a search over samples of its own.
        dtype: Of places.
    """

    surface: AbstractSurface
    level: _Level
    on_base: _Map
    searched: bool
    dtype: Any

    def value(self, u: Float[Array, " k"]) -> Float[Array, ""]:
        """The level at coordinates [m]."""
        return _known(self.level(self.surface.point(u)))


class Pose(NamedTuple):
    """Where a body is.

    Attributes:
        to_base: Rotation from body to base axes.
        origin: Of the body [m], base axes.
    """

    to_base: Float[Array, "3 3"]
    origin: Float[Array, "3"]


class Clearance(NamedTuple):
    """The least distance of two surfaces.

    Attributes:
        gap: [m]; less than zero where the body is in the base.
        place: Where [m], base axes, shape (3,).
        size: Of the body, from its origin [m].
    """

    gap: Float[Array, ""]
    place: Float[Array, "3"]
    size: Float[Array, ""]


def may_touch_twice(scene: Scene) -> bool:
    """Whether a second contact is possible, and could be told."""
    body, base = scene.body.surface, scene.base.surface
    if _are_as_convex(scene) or not body.is_bounded:
        return False
    dtype = scene.body.mass.dtype
    return _has_inside(body, dtype) or _has_inside(base, dtype)


def nearest_is_found(scene: Scene) -> bool:
    """Whether the nearest of all places of body and base can be told."""
    return _are_as_convex(scene) or may_touch_twice(scene)


def _are_as_convex(scene: Scene) -> bool:
    body, base = scene.body.surface, scene.base.surface
    of_body = body.is_convex_on_plane if base.is_flat else body.is_convex
    return of_body and base.is_convex


def _has_inside(surface: AbstractSurface, dtype: Any) -> bool:
    point = jax.ShapeDtypeStruct((3,), dtype)
    return jax.eval_shape(surface.signed_distance, point) is not None


def clearance(scene: Scene, t: Float[Array, ""], state: Any) -> Clearance:
    """The least distance of body and base anywhere.

    Args:
        scene: One of which :func:`may_touch_twice` is true.
        t: Time [s].
        state: In contact or in flight.
    """
    surfaces = scene.body.surface, scene.base.surface
    return clearance_at(*surfaces, _pose(scene, t, state))


@for_one_call  # known then, too, where only masses or speeds are traced
def clearance_at(body: AbstractSurface, base: AbstractSurface, pose: Pose) -> Clearance:
    """The same of two surfaces, of which the body's is at a pose; no derivative."""
    body, base, pose = jax.lax.stop_gradient((body, base, pose))
    found: list[tuple[Array, Array]] = []
    for side in _sides(body, base, pose):
        gap, place = _lowest(side)
        found.append((gap, side.on_base(place)))
        if side.surface is body and body.has_face:
            gaps, faces = _face_candidates(side, 1)
            found.append((gaps[0], side.on_base(faces[0])))
    gaps, places = (jnp.stack(x) for x in zip(*found, strict=True))
    least = jnp.argmin(gaps)
    return Clearance(gaps[least], places[least], reach_of(body, gaps.dtype))


def reach_of(body: AbstractSurface, dtype: Any) -> Float[Array, ""]:
    """How far a body reaches from its origin [m], by samples of its surface.

    Args:
        body: Its surface.
        dtype: Of the length.
    """
    points = body_points(body, dtype)
    return jnp.max(jax.vmap(norm)(jnp.where(jnp.isfinite(points), points, 0.0)))


def lowest_places(
    scene: Scene, t: Float[Array, ""], state: Any
) -> tuple[Float[Array, " m"], Float[Array, "m 3"]]:
    """Where samples of the surfaces are nearest to each other, not searched further.

    Args:
        scene: One of which :func:`may_touch_twice` is true.
        t: Time [s].
        state: In contact or in flight.

    Returns:
        Gaps [m], infinite where there are fewer places; the places [m], base axes.
    """
    body, base = scene.body.surface, scene.base.surface
    sides = _sides(body, base, _pose(scene, t, state))
    # those of a body are closer: the base's, of which each is a search, add nothing
    if len(sides) > 1 and body.searches_distance and not base.searches_distance:
        sides = sides[:1]
    found = [
        (gaps, jax.vmap(side.on_base)(jax.vmap(side.surface.point)(u)))
        for side in sides
        for gaps, u in [_candidates(side, _NEAREST)]
    ]
    for side in sides:
        if side.surface is body and body.has_face:
            gaps, faces = _face_candidates(side, _NEAREST)
            found.append((gaps, jax.vmap(side.on_base)(faces)))
    gaps, places = (jnp.concatenate(x) for x in zip(*found, strict=True))
    return gaps, places


def _sides(body: AbstractSurface, base: AbstractSurface, pose: Pose) -> list[_Side]:
    """Surfaces to look along: with the other's level, and a way to base axes."""
    to_base, origin = pose
    placed: _Map = lambda x: origin + matvec(to_base, x)
    back: _Map = lambda x: matvec_transposed(to_base, x - origin)
    sides: list[_Side] = []
    dtype = origin.dtype
    if _has_inside(base, dtype):
        of_base = base.distances(dtype, Ball(origin, reach_of(body, dtype)))
        level: _Level = lambda x: of_base(placed(x))
        sides.append(_Side(body, level, placed, base.searches_distance, dtype))
    if _has_inside(body, dtype) and not base.is_flat:
        of_body = body.distances(dtype)
        level = lambda x: of_body(back(x))
        as_it_is: _Map = lambda x: x
        sides.append(_Side(base, level, as_it_is, body.searches_distance, dtype))
    return sides


def is_apart(scene: Scene, t: Float[Array, ""], state: Any) -> Array:
    """Whether the body is nowhere in its base, but for a rounding of its size."""
    found = clearance(scene, t, state)
    return ~(found.gap < -depth_of_touch(found.size))


@for_one_call
def code_of_touch(code: Array, scene: Scene, t: Float[Array, ""], state: Any) -> Array:
    """The code of a run, SECOND_CONTACT where it got stuck because of one."""

    def touches() -> Array:
        found = clearance(scene, t, state)
        return found.gap < -0.5 * depth_of_touch(found.size)

    never: Callable[[], Array] = lambda: jnp.asarray(False)
    touched = cast(Array, jax.lax.cond(is_stuck(code), touches, never))
    return jnp.where(touched, Code.SECOND_CONTACT, code)


def depth_of_touch(size: Float[Array, ""]) -> Float[Array, ""]:
    """How deep a second contact may be before it counts [m].

    Args:
        size: Of the body, from its origin [m].
    """
    return at_precision(1e-9, size) * size


def body_points(body: AbstractSurface, dtype: Any) -> Float[Array, "n 3"]:
    """Points over the whole surface of a body [m], body axes; NaN where there is none.

    Args:
        body: Its surface.
        dtype: Of the points.
    """
    samples = jnp.asarray(body.samples(), dtype)
    return jax.vmap(body.point)(samples)


def _pose(scene: Scene, t: Float[Array, ""], state: AnyState) -> Pose:
    """Where the body of a state is."""
    if state.touches:
        contact = contact_of(scene, t, state)
        return pose_at(contact.to_base, contact.base_point, contact.body_point)
    _, place, to_base = flying_pose(scene, t, cast(FlyingState, state))
    return Pose(to_base, place)


def pose_at(
    to_base: Float[Array, "3 3"],
    base_point: Float[Array, "3"],
    body_point: Float[Array, "3"],
) -> Pose:
    """Where a body is whose point touches a point of the base.

    Args:
        to_base: Rotation from body to base axes.
        base_point: [m], base axes.
        body_point: [m], body axes.
    """
    return Pose(to_base, base_point - matvec(to_base, body_point))


def flying_pose(
    scene: Scene, t: Float[Array, ""], state: FlyingState
) -> tuple[BaseKinematics | None, Float[Array, "3"], Float[Array, "3 3"]]:
    """Motion of the base, origin of the body on its axes [m], and body to base axes."""
    motion = scene.base.motion
    moving = None if motion is None else motion.at(t)
    place = state.position if moving is None else moving.on_base(state.position)
    return moving, place, body_to_base(rotation_matrix(state.orientation), moving)


def _candidates(
    side: _Side, count: int, others: int = 0
) -> tuple[Float[Array, " m"], Float[Array, "m k"]]:
    """Levels and coordinates of the samples with the lowest levels around them.

    Args:
        side: Whose samples.
        count: How many, at most.
        others: How many of the lowest that are not lower than those around them.

    Returns:
        Levels, infinite where there are fewer; coordinates.
    """
    surface = side.surface
    samples = jnp.asarray(surface.samples(), side.dtype)
    near = surface.lattice()
    levels, chosen = _least_of(side.value, samples, near, count, side.searched, others)
    return levels, samples[chosen]


def _face_candidates(
    side: _Side, count: int
) -> tuple[Float[Array, " m"], Float[Array, "m 3"]]:
    """The same of samples of a body's flat: levels, and the points themselves."""
    body = side.surface
    lattice = body.face_samples()
    assert lattice is not None
    points = jax.vmap(body.face_point)(jnp.asarray(lattice, side.dtype))
    value: Callable[[Array], Array] = lambda x: _known(side.level(x))
    levels, chosen = _least_of(value, points, lattice, count, side.searched)
    return levels, points[chosen]


def _least_of(
    value: Callable[[Array], Array],
    samples: Float[Array, "n k"],
    lattice: NDArray[Any],
    count: int,
    searched: bool,
    others: int = 0,
) -> tuple[Float[Array, " m"], Int[Array, " m"]]:
    """The lowest of the samples that are lower than those around them, and which.

    Behind them the lowest of the ``others``, so many.
    """
    values = _each(value, samples, searched)
    near = of_numbers(_neighbours, lattice)
    local = values <= jnp.min(values[near], axis=1)
    lowest, chosen = jax.lax.top_k(-jnp.where(local, values, jnp.inf), count)
    if others == 0:
        return -lowest, chosen
    low, more = jax.lax.top_k(-jnp.where(local, jnp.inf, values), others)
    return -jnp.concatenate([lowest, low]), jnp.concatenate([chosen, more])


def _lowest(side: _Side) -> tuple[Float[Array, ""], Float[Array, "3"]]:
    """The least level of a surface's points, and the point that has it."""
    surface, dtype = side.surface, side.dtype
    levels, chosen = _candidates(side, _LOWEST, _IN_VALLEYS)
    spacing = jnp.stack([jnp.asarray(x, dtype) for x in surface.spacing])
    ticks = np.linspace(-1.0, 1.0, 5)
    star = np.stack(np.meshgrid(ticks, ticks), axis=-1).reshape(-1, 2)

    def lower(u: Float[Array, " k"]) -> tuple[Float[Array, ""], Float[Array, "3"]]:
        def narrow(
            carry: tuple[Float[Array, " k"], Float[Array, ""]], _: None
        ) -> tuple[tuple[Float[Array, " k"], Float[Array, ""]], None]:
            u, reach = carry
            moved: Callable[[Array], Array] = lambda x: surface.neighbour(u, x)
            tried = jax.vmap(moved)(jnp.asarray(star, dtype) * (reach * spacing)[None])
            best = jnp.argmin(_each(side.value, tried, side.searched))
            return (tried[best], reach * _SHRINK), None

        start = u, jnp.ones((), dtype)
        (u, _), _ = jax.lax.scan(narrow, start, length=_ROUNDS)
        return side.value(u), surface.point(u)

    def found(near: tuple[Array, Array]) -> tuple[Array, Array]:
        level, u = near
        as_it_is: _Lowest = lambda u: (level, surface.point(u))
        return cast(
            tuple[Array, Array], jax.lax.cond(jnp.isinf(level), as_it_is, lower, u)
        )

    # one after the other, too: few places are lower than all around them
    gaps, places = cast(tuple[Array, Array], jax.lax.map(found, (levels, chosen)))
    best = jnp.argmin(gaps)
    return gaps[best], places[best]


def _each(
    value: Callable[[Array], Array], samples: Float[Array, "n k"], searched: bool
) -> Float[Array, " n"]:
    """A value of each sample; one after the other where it takes a search.

    A program of one search is compiled in 0.3 to 0.5 of the time that one of many at
    once takes. In C it runs in 0.5 to 0.7 of the time, too; by XLA in 0.9 to 1.5 of it
    (an egg in a bowl, a peanut on a hump).
    """
    return cast(
        Array, jax.lax.map(value, samples) if searched else jax.vmap(value)(samples)
    )


def _known(level: Float[Array, ""] | None) -> Array:
    """A level; infinite where it is not known."""
    assert level is not None
    return jnp.where(jnp.isnan(level), jnp.inf, level)


def _neighbours(lattice: NDArray[Any]) -> NDArray[np.intp]:
    """For each sample the numbers of the samples next to it, shape (n, k)."""
    near: list[NDArray[np.intp]] = []
    for part in np.array_split(lattice, 8):
        squares = ((part[:, None] - lattice[None]) ** 2).sum(axis=-1)
        near.append(np.argpartition(squares, _NEAR + 1, axis=1)[:, : _NEAR + 1])
    return np.concatenate(near)
