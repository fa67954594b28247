"""What a study looks at, of motions of one contact law and of those that change it."""

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp

from ..dynamics.rolling import rolling_derivative
from ..dynamics.scene import Scene
from ..hybrid.by_mode import by_mode
from ..hybrid.modes import HybridScene, ModedState, of

Shown = Callable[[Any, Any, Any], Any]


def value_of(function: Shown, scene: Scene, t: Any, state: Any) -> Any:
    """An observable as floating numbers, of a run with or without modes."""
    number: Shown = lambda scene, t, state: jnp.asarray(
        function(scene, t, state)
    ).astype(t.dtype)
    if isinstance(scene, HybridScene):
        return by_mode(number)(scene, t, state)
    return number(scene, t, state)


def state_at(scene: Scene, start: Any) -> Any:
    """A start as observables of a run see it."""
    if not isinstance(scene, HybridScene):
        return start
    zero = jnp.zeros_like(start.angular_velocity)
    return ModedState(of(start), jnp.zeros((), jnp.int32), zero)


def rolling_of(scene: Scene, start: Any) -> tuple[Scene, Any]:
    """Scene and start of one contact law: with modes, as they roll."""
    if not isinstance(scene, HybridScene):
        return scene, start
    return scene.in_modes.rolling, of(start).rolling()


def rates(scene: Scene, t: Any, start: Any) -> Any:
    """Rates of motions, in each mode that a start alone can be in."""
    rolling, state = rolling_of(scene, start)
    found = [rolling_derivative(rolling, t, state)]
    if isinstance(scene, HybridScene):
        flying = scene.in_modes.flying
        found.append(rolling_derivative(flying, t, of(start).flying()))
    return found
