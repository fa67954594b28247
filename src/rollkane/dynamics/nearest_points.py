"""The nearest points of body and base, by Newton's method.

From points close to them; those of whole surfaces: :mod:`.nearest_anywhere`.
"""

from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ..geometry.local_geometry import LocalGeometry, from_normal
from ..geometry.small_linear import (
    components,
    dot,
    matmul,
    matvec,
    matvec_transposed,
    norm,
    solve_2x2,
    solve_4x4,
)
from ..geometry.surfaces import AbstractSurface, NormalHeading
from ..kinematics.coordinates import FlyingState
from .clearance import flying_pose
from .nearest_on_face import (
    has_face,
    is_nearest,
    is_on_face,
    nearer_to_face,
    rim_over,
    starts_on_rim,
)
from .precision import at_precision
from .scene import Scene

# Newton steps to the nearest points, most: their error squares each time
NEWTON = 16
# Of the size of what is compared, where the search has ended: it ends no closer where
# rounding does not let it
_CLOSE = 64

# Coordinates of the nearest points on base and body.
Places: TypeAlias = tuple[Array, Array]
# Steps taken, the points, and what was left before the last step and the gap there [m].
_Search: TypeAlias = tuple[Int[Array, ""], Places, Float[Array, ""], Float[Array, ""]]
# A step of a search; see :func:`_improved`.
_Improved: TypeAlias = Callable[
    [Scene, Array, FlyingState], tuple[Places, Float[Array, ""], Float[Array, ""]]
]


def nearest(
    scene: Scene, t: Float[Array, ""], state: FlyingState, steps: int = NEWTON
) -> tuple[Float[Array, ""], FlyingState]:
    """Gap between the surfaces [m], and the state with their nearest points.

    Args:
        scene: What flies over what.
        t: Time [s].
        state: Its contact coordinates are where the search begins.
        steps: Of the search, at most.

    The gap is the distance along the base's normal, less than zero in the base; NaN
    where the search did not converge. Where there are several nearest points, the ones
    next to the start are followed.
    """
    found = searched(*jax.lax.stop_gradient((scene, t, state)), steps)
    gap, state = nearest_from(scene, t, state, found)
    return jnp.where(jnp.isnan(found.gap), jnp.nan, gap), state


class Found(NamedTuple):
    """What a search found.

    Attributes:
        places: The nearest points.
        gap: Between them [m]; NaN if the search did not converge.
        on_face: Whether the body's is on its face; None where it has none.
    """

    places: Places
    gap: Float[Array, ""]
    on_face: Bool[Array, ""] | None


def searched(
    scene: Scene, t: Float[Array, ""], state: FlyingState, steps: Any = NEWTON
) -> Found:
    """The nearest points, on the body's face where they are there."""
    if not has_face(scene):
        return Found(*_by_newton(_improved, scene, t, state, steps), None)
    (below, _), of_face = _by_newton(nearer_to_face, scene, t, state, steps)
    holds = is_on_face(scene, t, state, below, of_face)
    near = jnp.where(jnp.isnan(of_face), state.contact_on_base, below)
    rim = rim_over(scene)
    starts = starts_on_rim(rim, t, state, near)
    places, gap = _on_rim(rim, starts, t, state, steps)
    on_face = holds & ~(gap <= of_face)
    on_base = jnp.where(on_face, below, places[0])
    return Found((on_base, places[1]), jnp.where(on_face, of_face, gap), on_face)


def _on_rim(
    rim: Scene,
    starts: Float[Array, "n k"],
    t: Float[Array, ""],
    state: FlyingState,
    steps: Any,
) -> tuple[Places, Float[Array, ""]]:
    """The first point of a rim that is the nearest one, and its gap."""

    def tried(
        best: tuple[Places, Float[Array, ""]], start: Float[Array, " k"]
    ) -> tuple[tuple[Places, Float[Array, ""]], None]:
        begun = eqx.tree_at(lambda s: s.contact_on_body, state, start)
        known = jnp.isfinite(best[1])
        places, gap = _by_newton(_improved, rim, t, begun, jnp.where(known, 0, steps))
        gap = jnp.where(is_nearest(rim, t, state, places, gap), gap, jnp.nan)
        chosen: Callable[[Array, Array], Array] = lambda a, b: jnp.where(known, a, b)
        return jax.tree.map(chosen, best, (places, gap)), None

    none = (state.contact_on_base, starts[0]), jnp.full_like(t, jnp.nan)
    return cast(Any, jax.lax.scan(tried, none, starts)[0])


def _by_newton(
    improved: _Improved,
    scene: Scene,
    t: Float[Array, ""],
    state: FlyingState,
    steps: Any,
) -> tuple[Places, Float[Array, ""]]:
    """Points where no step is left, and their gap, NaN if that is nowhere."""
    size = 1.0 + norm(state.position)
    close: Float[Array, ""] = _CLOSE * np.finfo(size.dtype).eps * size

    def going(carry: _Search) -> Bool[Array, ""]:
        count, _, left, _ = carry
        return (count < steps) & (left > close)

    def improve(carry: _Search) -> _Search:
        count, places, _, _ = carry
        return count + 1, *improved(scene, t, eqx.tree_at(places_of, state, places))

    far = jnp.full_like(close, jnp.inf)
    carry = jnp.asarray(0), places_of(state), far, far
    _, found, left, gap = jax.lax.while_loop(going, improve, carry)
    converged = left <= at_precision(1e-9, size) * size
    return found, jnp.where(converged, gap, jnp.nan)


def nearest_from(
    scene: Scene, t: Float[Array, ""], state: FlyingState, found: Found
) -> tuple[Float[Array, ""], FlyingState]:
    """:func:`nearest` from points that are it, to which it gives their derivative.

    One step more of the search has it, by the implicit function; the gap is stationary
    there, and does not move with the points.
    """
    at = t, eqx.tree_at(places_of, state, found.places)
    base, body = scene.base.surface, scene.body.surface
    if found.on_face is None:
        (on_base, on_body), _, gap = _improved(scene, *at)
        if scene.has_contact_coordinates:
            on_body = _at_unit(body, on_body)
        places = _at_unit(base, on_base), on_body
        return gap, eqx.tree_at(places_of, state, places)
    rim = rim_over(scene)
    either = lambda: nearer_to_face(scene, *at), lambda: _improved(rim, *at)
    (on_base, _), _, gap = cast(Any, jax.lax.cond(found.on_face, *either))
    on_base = _at_unit(base, on_base)
    return gap, eqx.tree_at(lambda s: s.contact_on_base, state, on_base)


def _at_unit(surface: AbstractSurface, u: Float[Array, " k"]) -> Float[Array, " k"]:
    """Coordinates whose directions, of any length, have the length one.

    Searches that begin at other samples end at other lengths, and which of two that
    come to the same point is the nearest rounding tells: a derivative that goes along
    recorded states would be that of another length than theirs.
    """
    for first, last in surface.directions:
        way = u[first:last] / norm(u[first:last])
        u = jnp.concatenate([u[:first], way, u[last:]])
    return u


def begun_at(
    scene: Scene, t: Float[Array, ""], state: FlyingState, place: Float[Array, "3"]
) -> FlyingState:
    """A state whose points are about the nearest to a place on base axes [m].

    An edge has many normals at a point, there towards the other surface.
    """
    base, body = scene.base.surface, scene.body.surface
    on_base, on_body = base.locate(place), state.contact_on_body
    if not (base.is_edge or scene.has_contact_coordinates):
        return eqx.tree_at(places_of, state, (on_base, on_body))
    _, origin, to_base = flying_pose(scene, t, state)
    on_body = body.locate(matvec_transposed(to_base, place - origin))
    if base.is_edge or body.is_edge:
        ground, shell = base.geometry(on_base), body.geometry(on_body)
        if not base.is_edge:
            out = ground.normal
        elif not body.is_edge:
            out = -matvec(to_base, shell.normal)
        else:
            out = origin + matvec(to_base, shell.position) - ground.position
        on_base = base.at_edge(ground.position, out)
        inwards = -matvec_transposed(to_base, out)
        on_body = body.at_edge(shell.position, inwards) if body.is_edge else on_body
    if not scene.has_contact_coordinates:
        on_body = state.contact_on_body
    return eqx.tree_at(places_of, state, (on_base, on_body))


def heading_on_plane(scene: Scene) -> NormalHeading | None:
    """Of the body's normal, where its base is a plane and a circle can lie on it.

    Args:
        scene: What flies over what.
    """
    body, base = scene.body.surface, scene.base.surface
    return body.normal_heading(True) if base.is_flat else None


def places_of(state: FlyingState) -> Places:
    """Coordinates of a state's nearest points, on base and body."""
    return state.contact_on_base, state.contact_on_body


def _improved(
    scene: Scene, t: Float[Array, ""], state: FlyingState
) -> tuple[Places, Float[Array, ""], Float[Array, ""]]:
    """Points after a Newton step; the largest of what was left before it, and the gap.

    Nearest are points whose join is across both tangents of the base, to which the
    body's normal is, too.
    """
    base, body = scene.base.surface, scene.body.surface
    _, origin, to_base = flying_pose(scene, t, state)
    ground = base.geometry(state.contact_on_base)
    shell = body_geometry(scene, state, ground, to_base)
    tangents = components(ground.frame.T[:2])
    join = origin + matvec(to_base, shell.position) - ground.position
    gap = dot(ground.normal, join)
    left = [dot(tangent, join) for tangent in tangents]
    normal = None
    if scene.has_contact_coordinates:
        normal = matvec(to_base, shell.normal)
        left += [dot(tangent, normal) for tangent in tangents]

    def moved(x: Float[Array, " m"]) -> Places:
        on_base, on_body = places_of(state)
        on_base = on_base + base.coordinate_rates(on_base, still[0], x[:2])
        if normal is not None:
            on_body = on_body + body.coordinate_rates(on_body, still[1], x[2:])
        return base.settled(on_base), body.settled(on_body)

    # at the nearest points nothing is left that a change of the slope could move
    still = jax.lax.stop_gradient((ground, shell, to_base, gap, normal))
    move = -_solved(*still, jnp.stack(left), base.is_edge)
    most = jnp.max(jnp.abs(jnp.stack(left)))
    if normal is not None:  # the same is true of the far side, of a wire close by
        most = jnp.where(dot(normal, ground.normal) < 0.0, most, jnp.inf)
    return moved(move), most, gap


def _solved(
    ground: LocalGeometry,
    shell: LocalGeometry,
    to_base: Float[Array, "3 3"],
    gap: Float[Array, ""],
    normal: Float[Array, "3"] | None,
    left: Float[Array, " m"],
    on_edge: bool,
) -> Float[Array, " m"]:
    """What is left, by its slope in the coordinates of both points.

    Tangents turn by ``d t_i = e3 W dx``, points move by ``t_i L dx``, (2.3). How the
    tangents turn about the normal does not matter where the points are nearest.
    """
    W, L = ground.frame_rates, ground.lengths
    by_base = gap * W - L
    if normal is None:  # the body's point moves with its normal, on the same tangents
        return solve_2x2(by_base + matmul(shell.lengths, W), left)
    mixing = matmul(ground.frame.T[:2], matmul(to_base, shell.frame[:, :2]))
    aligned = dot(normal, ground.normal) * W
    by_body = matmul(mixing, shell.lengths)
    by_turning = -matmul(mixing, shell.frame_rates)
    if on_edge:  # it turns there without moving: at the end of a gap of no length
        rows = [[by_base, by_body], [aligned, by_turning]]
        both = [jnp.concatenate(row, axis=1) for row in rows]
        return solve_4x4(jnp.concatenate(both), left)
    # the base's point, whose block is near its metric, eliminated
    own = solve_2x2(by_base, left[:2])
    of_body = solve_2x2(by_base, by_body)
    rest = by_turning - matmul(aligned, of_body)
    body = solve_2x2(rest, left[2:] - matvec(aligned, own))
    return jnp.concatenate([own - matvec(of_body, body), body])


def body_geometry(
    scene: Scene,
    state: FlyingState,
    ground: LocalGeometry,
    to_base: Float[Array, "3 3"],
) -> LocalGeometry:
    """The body there; on the base's tangents, where the point is that of a normal.

    Args:
        scene: What flies over what.
        state: With its nearest points.
        ground: The base there.
        to_base: Rotation from body to base axes.
    """
    body = scene.body.surface
    if scene.has_contact_coordinates:
        return body.geometry(state.contact_on_body)
    of_normal = body.normal_map(scene.base.surface.is_flat)
    assert of_normal is not None
    first, second, out = (
        matvec_transposed(to_base, axis) for axis in components(ground.frame.T)
    )
    return from_normal(of_normal, -_off_level(scene, out), (first, second))


def _off_level(scene: Scene, out: Float[Array, "3"]) -> Float[Array, "3"]:
    """A plane's normal on body axes; off level, where a whole circle of a body is it.

    All points of the circle are as near then, but for rounding: any of them will do.
    """
    heading = heading_on_plane(scene)
    if heading is None:
        return out
    # of a length of one: where it stands is off by so much of the circle's radius
    rounding = np.finfo(out.dtype).eps
    is_level = jnp.max(jnp.abs(heading(out))) < rounding
    return jnp.where(is_level, out + 2.0 * rounding, out)
