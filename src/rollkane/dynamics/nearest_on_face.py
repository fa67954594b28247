"""The flat face of a disc over its base, where that is nearer to it than its rim.

A base comes nearest to a face where its normal is the disc's axis, at one point of the
base; the point of the face below it is not that of a normal.
"""

from typing import cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ..geometry.small_linear import (
    components,
    dot,
    matvec,
    matvec_transposed,
    norm,
    solve_2x2,
)
from ..kinematics.coordinates import FlyingState
from .clearance import flying_pose
from .scene import Scene

# Radians that a normal turns in a step of Newton's method, most: the sine whose zero it
# looks for has one within a quarter turn, to which longer steps may not lead
_LONGEST = 0.5


def has_face(scene: Scene) -> bool:
    """Whether the body has a face that a base may touch within its rim.

    A plane touches all of a face at once, or its rim. Of an edge that comes through
    nothing is told, as everywhere of two edges.
    """
    body, base = scene.body.surface, scene.base.surface
    return body.has_face and not (base.is_flat or base.is_edge)


def rim_over(scene: Scene) -> Scene:
    """The rim over the base, instead of the body.

    By its own coordinates: the normal has no say where it is about that of the face.

    Args:
        scene: One of which :func:`has_face` is true.
    """
    rim = scene.body.surface.face_rim()
    assert rim is not None
    body = eqx.tree_at(lambda body: body.surface, scene.body, rim)
    return Scene(body, scene.base)


def starts_on_rim(
    scene: Scene, t: Float[Array, ""], state: FlyingState, below: Array
) -> Float[Array, "2 k"]:
    """Where on a rim to begin: over a point of the base, and by the normal.

    Args:
        scene: The rim over the base.
        t: Time [s].
        state: With a point of the base from which to go.
        below: Coordinates of the one that may be below the point of the rim.
    """
    rim, base = scene.body.surface, scene.base.surface
    _, origin, to_base = flying_pose(scene, t, state)
    foot = matvec_transposed(to_base, base.point(below) - origin)
    out = -matvec_transposed(to_base, base.geometry(state.contact_on_base).normal)
    return jnp.stack([rim.at_edge(foot, out), rim.at_edge(out, out)])


def is_nearest(
    scene: Scene,
    t: Float[Array, ""],
    state: FlyingState,
    places: tuple[Array, Array],
    gap: Float[Array, ""],
) -> Bool[Array, ""]:
    """Whether what was found on a rim is what of the body is nearest.

    The normal has to be one of the body, not into its face: then no other point of the
    face is nearer to a convex base.

    Args:
        scene: The rim over the base.
        t: Time [s].
        state: Where it flies.
        places: Coordinates that were found, on base and rim.
        gap: That was found [m].
    """
    shell = scene.body.surface.geometry(places[1])
    out = dot(shell.normal, shell.position)
    # where the face takes over both are nearest, to the square of this
    slack = cast(float, np.sqrt(np.finfo(out.dtype).eps)) * norm(shell.position)
    return (out > -slack) & _is_this_side(scene, t, state, shell.position, gap)


def _is_this_side(
    scene: Scene,
    t: Float[Array, ""],
    state: FlyingState,
    point: Float[Array, "3"],
    gap: Float[Array, ""],
) -> Bool[Array, ""] | bool:
    """Whether a point [m], body axes, is as far out of the base as a gap says.

    Through the base there is another place that is level where the point is.
    """
    _, origin, to_base = flying_pose(scene, t, state)
    level = scene.base.surface.signed_distance(origin + matvec(to_base, point))
    if level is None:
        return True
    # at a contact both signs are rounding: far more than that, far less than a base
    least = cast(float, np.sqrt(np.finfo(gap.dtype).eps)) * (1.0 + norm(origin))
    return (level * gap > 0.0) | (jnp.abs(gap) < least)


def nearer_to_face(
    scene: Scene, t: Float[Array, ""], state: FlyingState
) -> tuple[tuple[Array, Array], Float[Array, ""], Float[Array, ""]]:
    """Points after a Newton step to where the base is nearest to the face.

    Args:
        scene: One of which :func:`has_face` is true.
        t: Time [s].
        state: With a point of the base from which to go.

    Returns:
        Coordinates on base and body, these as they are; what was left before the step
        [m]; the gap [m].
    """
    base = scene.base.surface
    _, origin, to_base = flying_pose(scene, t, state)
    ground = base.geometry(state.contact_on_base)
    facing = dot(ground.normal, to_base[:, 2])
    axis = jnp.where(facing < 0.0, -to_base[:, 2], to_base[:, 2])
    left = jnp.stack([dot(x, axis) for x in components(ground.frame.T[:2])])
    # tangents turn by d t_i = e3 W dx, (2.3)
    W, share = jax.lax.stop_gradient((ground.frame_rates, jnp.abs(facing)))
    turn = left / share
    turn = turn * jnp.minimum(1.0, _LONGEST / jnp.maximum(norm(turn), _LONGEST))
    move = base.coordinate_rates(state.contact_on_base, ground, -solve_2x2(W, turn))
    found = base.settled(state.contact_on_base + move), state.contact_on_body
    apart = origin - ground.position
    return found, norm(left) * norm(apart), dot(axis, apart)


def is_on_face(
    scene: Scene,
    t: Float[Array, ""],
    state: FlyingState,
    below: Array,
    gap: Float[Array, ""],
) -> Bool[Array, ""]:
    """Whether what was found is on the disc, and the near side of the base.

    Args:
        scene: One of which :func:`has_face` is true.
        t: Time [s].
        state: Where it flies.
        below: Coordinates on the base that were found.
        gap: That was found [m].
    """
    _, origin, to_base = flying_pose(scene, t, state)
    in_plane = jnp.array([1.0, 1.0, 0.0], gap.dtype)
    ground = scene.base.surface.point(below)
    foot = in_plane * matvec_transposed(to_base, ground - origin)
    extent = scene.body.surface.face_extent(foot)
    assert extent is not None
    return (extent > 0.0) & _is_this_side(scene, t, state, foot, gap)


def faces(scene: Scene, t: Float[Array, ""], state: FlyingState) -> Bool[Array, ""]:
    """Whether it is the face that is nearest to the base, and not the rim.

    Args:
        scene: One of which :func:`has_face` is true.
        t: Time [s].
        state: With its nearest points.
    """
    _, _, to_base = flying_pose(scene, t, state)
    normal = scene.base.surface.geometry(state.contact_on_base).normal
    across = normal - to_base[:, 2] * dot(normal, to_base[:, 2])
    # known to a rounding there, over the reach of the disc: half its digits is far off
    return dot(across, across) < np.finfo(across.dtype).eps
