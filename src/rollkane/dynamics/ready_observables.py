"""Observables by their names, for studies, events and their files."""

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..geometry.rotations import quaternion_of
from ..geometry.small_linear import matvec, safe_norm
from .observables import energy, friction_ratio, normal_force, outward
from .rolling import contact_of


def position(scene: Any, t: Any, state: Any) -> Float[Array, "3"]:
    """Body origin O [m], fixed axes."""
    return contact_of(scene, t, state).position


def orientation(scene: Any, t: Any, state: Any) -> Float[Array, "4"]:
    """Unit quaternion, scalar first, body to fixed axes [1]; either sign."""
    return quaternion_of(contact_of(scene, t, state).rotation)


def angular_velocity(scene: Any, t: Any, state: Any) -> Float[Array, "3"]:
    """[rad/s], fixed axes."""
    contact = contact_of(scene, t, state)
    return matvec(contact.rotation, contact.angular_velocity)


def spin(scene: Any, t: Any, state: Any) -> Float[Array, ""]:
    """Angular velocity about the vertical, the fixed z axis [rad/s]."""
    return angular_velocity(scene, t, state)[2]


def tilt(scene: Any, t: Any, state: Any) -> Float[Array, ""]:
    """Angle between the body's z axis and the vertical [rad], 0 to pi.

    Upright it has a corner, where its derivative is taken as zero.
    """
    axis = contact_of(scene, t, state).rotation[:, 2]
    return jnp.arctan2(safe_norm(axis[:2]), axis[2])


def contact_on_base(scene: Any, t: Any, state: Any) -> Float[Array, "3"]:
    """Contact point [m], base axes; NaN in flight."""
    point = contact_of(scene, t, state).base_point
    return point if state.touches else jnp.full_like(point, jnp.nan)


READY: dict[str, Callable[[Any, Any, Any], Array]] = {
    "position": position,
    "orientation": orientation,
    "angular_velocity": angular_velocity,
    "spin": spin,
    "tilt": tilt,
    "contact_on_base": contact_on_base,
    "energy": energy,
    "normal_force": normal_force,
    "friction_ratio": friction_ratio,
    "outward": outward,
}

# Those that are one number: what crosses a level.
SCALARS = ("spin", "tilt", "energy", "normal_force", "friction_ratio")
