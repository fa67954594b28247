"""Where a flight cannot go on, or ends where no contact can be: ends of surfaces."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ..geometry.small_linear import matvec
from ..kinematics.coordinates import FlyingState
from .clearance import flying_pose
from .nearest_points import body_geometry, heading_on_plane
from .precision import at_precision
from .scene import Scene

# How near to an end a flight that cannot go on is stuck, of lengths of one: the steps
# of its clock are far shorter
_PAST = 1e-9


def may_pass_an_end(scene: Scene) -> bool:
    """Whether a body may fly where its base has an end, or a flat without normals."""
    base = scene.base.surface
    like = jax.ShapeDtypeStruct((base.coordinate_count,), float)
    return base.has_face or jax.eval_shape(base.extent, like) is not None


def passes_an_end(scene: Scene, t: Float[Array, ""], state: FlyingState) -> Array:
    """Whether the nearest points have come to an end of the base, or over its flat.

    Args:
        scene: One of which :func:`may_pass_an_end` is true.
        t: Time [s].
        state: With its nearest points.
    """
    base = scene.base.surface
    _, origin, to_base = flying_pose(scene, t, state)
    ground = base.geometry(state.contact_on_base)
    shell = body_geometry(scene, state, ground, to_base)
    left = base.extent(state.contact_on_base)
    if left is not None:
        return left <= at_precision(_PAST, left)
    over = base.face_extent(origin + matvec(to_base, shell.position))
    rim = base.face_extent(jnp.zeros_like(origin))
    assert over is not None
    assert rim is not None
    return over >= -at_precision(_PAST, over) * rim


def off_an_end(scene: Scene, state: FlyingState) -> Bool[Array, ""] | bool:
    """Whether a nearest point is on what continues its surface beyond an end.

    A meridian, for one, goes on behind the rim, where there is nothing to land on.

    Args:
        scene: What flies over what.
        state: With its nearest points.
    """
    off: Bool[Array, ""] | bool = False
    places = [(scene.base.surface, state.contact_on_base)]
    if scene.has_contact_coordinates:
        places.append((scene.body.surface, state.contact_on_body))
    for surface, place in places:
        left = surface.extent(place)
        if left is not None:
            off = off | (left < 0.0)
    return off


def lies_level(
    scene: Scene, t: Float[Array, ""], state: FlyingState
) -> Bool[Array, ""] | bool:
    """Whether a whole circle of the body is as near to a plane, but for rounding.

    Args:
        scene: What flies over what.
        t: Time [s].
        state: Where it flies.
    """
    heading = heading_on_plane(scene)
    if heading is None:
        return False
    _, _, to_base = flying_pose(scene, t, state)
    # what a turn in flight leaves of a level one, as for a Ring that is placed
    rounding = 100.0 * np.finfo(to_base.dtype).eps
    return jnp.max(jnp.abs(heading(to_base[2]))) < rounding
