"""A scene file's scene, and its start as it is placed: at other numbers and times."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..dynamics.placement import place
from ..dynamics.rolling import contact_of
from ..dynamics.scene import Scene, Slipping, under
from ..files.scene_files.loading import SceneFile
from ..files.scene_files.start_reading import start_table
from ..hybrid.modes import Modes


class SceneModel(eqx.Module):
    """A scene, its start as it is placed, and how its contact may change.

    Attributes:
        scene: What rolls on what.
        start: Arguments of ``place``, by name.
        rolling: Starts of bodies that roll on the body.
        modes: Of its contact, or None.
    """

    scene: Scene
    start: dict[str, Any]
    rolling: Any
    modes: Modes | None

    @staticmethod
    def of(file: SceneFile) -> "SceneModel":
        """Of a scene file, whose start is read back."""
        scene, state = file.scene, file.start
        time = jnp.asarray(file.times[0], state.angular_velocity.dtype)
        start = start_table(scene, time, state)
        # also those that a scene file has in [[supported]]
        start |= {"alpha": state.alpha, "alpha_dot": state.alpha_dot}
        start.pop("near_on_body", None)  # which moves with the others
        return SceneModel(scene, start, state.supported, file.modes)

    def placed(self, near: Any, time: Any) -> Any:
        """The start, where the body touches next to where it did [m, body axes]."""
        scene, start = self.scene, dict(self.start)
        if "slip" in start and not scene.contact.slips:
            scene = under(scene, Slipping())  # until it grips
        known = {"near_on_body": near} if scene.has_contact_coordinates else {}
        return place(scene, **start, **known, supported=self.rolling, time=time)


def touched_at(file: SceneFile) -> Float[Array, "3"]:
    """Where the body of a file touches [m], body axes: of several places the one."""
    first = jnp.asarray(float(file.times[0]))
    return contact_of(file.scene, first, file.start).body_point


def started_at(file: SceneFile, time: float) -> Any:
    """The start of a file, as it is where the base is at a time [s].

    A body whose contact has coordinates of its own touches a base that has moved since
    at another of its points: with the old one it would be turned.
    """
    rests = file.scene.base.motion is None or time == float(file.times[0])
    follows = file.start.touches and file.scene.has_contact_coordinates
    if rests or not follows:
        return file.start
    return SceneModel.of(file).placed(touched_at(file), time)
