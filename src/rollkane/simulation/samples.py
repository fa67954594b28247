"""States of a motion or of many, with what belongs to them."""

from collections.abc import Callable
from typing import Any, NamedTuple, cast

import jax
import numpy as np

from ..dynamics.scene import Scene


class Axis(NamedTuple):
    """One axis that states have in front: which else has it.

    Attributes:
        scene: For each array of the scene 0 or None (not); None: no array has it.
        time: 0 or None (not), of the times.
        of_times: Whether a motion goes on along it.
    """

    scene: tuple[int | None, ...] | None
    time: int | None
    of_times: bool = False


class Samples(NamedTuple):
    """States of a motion or of many, and what belongs to them.

    Attributes:
        scene: What moved.
        time: [s].
        state: States.
        axes: Those in front of the states, from the first; axes before these are a
            batch of all.
    """

    scene: Scene
    time: Any
    state: Any
    axes: tuple[Axis, ...]

    def as_given(self, values: Any) -> Any:
        """What follows from the states: NumPy arrays if they are."""
        known = all(isinstance(x, np.ndarray) for x in jax.tree.leaves(self.state))
        return jax.tree.map(np.asarray, values) if known else values


def of_members(scene_axes: tuple[int | None, ...]) -> tuple[Axis, ...]:
    """Axes of members, which differ in these arrays of the scene, and of times."""
    return Axis(scene_axes, None), Axis(None, 0, of_times=True)


def over_axes(
    function: Callable[..., Any], scene: Scene, axes: tuple[Axis, ...], count: int
) -> Callable[..., Any]:
    """A function of a scene, a time and a state, of all that stand on some axes.

    Args:
        function: Of one of them.
        scene: What moved.
        axes: The last of the axes in front of the states.
        count: Of all axes; those before are a batch of everything.
    """
    mapped: Any = function
    for axis in reversed(axes):
        own = None
        if axis.scene is not None:
            own = jax.tree.unflatten(cast(Any, jax.tree.structure(scene)), axis.scene)
        mapped = jax.vmap(mapped, in_axes=(own, axis.time, 0))
    for _ in range(count - len(axes)):
        mapped = jax.vmap(mapped)
    return mapped
