"""A start as ``[start]`` of a scene file, and :func:`rollkane.place`, have it."""

from typing import Any

from jaxtyping import Array, Float

from ...dynamics.abstract_supported import rolling_parts
from ...dynamics.rolling import contact_of
from ...dynamics.scene import Scene
from ...geometry.rotations import quaternion_of
from ...geometry.small_linear import matvec


def start_table(
    scene: Scene, time: Float[Array, ""], start: Any
) -> dict[str, Float[Array, "..."]]:
    """A start by the names of ``place``, without bodies that roll on the body.

    Args:
        scene: It belongs to.
        time: When [s].
        start: A state, with the angular velocity along the body's axes.

    Returns:
        What ``[start]`` has: orientation [1], contact on the base [m]; angular velocity
        [rad/s] and slip [m/s] along fixed axes; coordinates of what is supported and
        their rates; where they tell something, the base normal [1] and a point of the
        body [m].
    """
    contact = contact_of(scene, time, start)
    turn = contact.rotation
    found = {
        "orientation": quaternion_of(turn),
        "angular_velocity": matvec(turn, contact.angular_velocity),
        "contact_on_base": contact.base_point,
    }
    if contact.slip is not None:
        found["slip"] = matvec(turn, contact.slip)
    if scene.base.surface.is_edge:
        found["base_normal"] = -matvec(contact.to_base, contact.normal)
    if scene.has_contact_coordinates:
        found["near_on_body"] = contact.body_point
    if scene.coordinate_count and not rolling_parts(scene.supported):
        found |= {"alpha": start.alpha, "alpha_dot": start.alpha_dot}
    return found
