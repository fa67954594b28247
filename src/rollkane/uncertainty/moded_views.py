"""What a study looks at, of motions of one contact law and of those that change it."""

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp

from ..dynamics.rolling import rolling_derivative
from ..dynamics.scene import Scene
from ..hybrid.by_mode import by_mode
from ..hybrid.modes import HybridScene, ModedState, Modes, of

Shown = Callable[[Any, Any, Any], Any]


def value_of(
    function: Shown, modes: Modes | None, scene: Scene, t: Any, state: Any
) -> Any:
    """An observable as floating numbers, of a run with or without modes."""
    number: Shown = lambda scene, t, state: jnp.asarray(
        function(scene, t, state)
    ).astype(t.dtype)
    if modes is None:
        return number(scene, t, state)
    return by_mode(number)(HybridScene(scene, modes), t, state)


def state_at(start: Any, modes: Modes | None) -> Any:
    """A start as observables of a run see it."""
    if modes is None:
        return start
    zero = jnp.zeros_like(start.angular_velocity)
    return ModedState(of(start), jnp.zeros((), jnp.int32), zero)


def rolling_of(scene: Scene, start: Any, modes: Modes | None) -> tuple[Scene, Any]:
    """Scene and start of one contact law: with modes, as they roll."""
    if modes is None:
        return scene, start
    return HybridScene(scene, modes).in_modes.rolling, of(start).rolling()


def rates_of(modes: Modes | None) -> Shown:
    """Rates of motions, in each mode that a start alone can be in."""

    def rates(scene: Scene, t: Any, start: Any) -> Any:
        rolling, state = rolling_of(scene, start, modes)
        found = [rolling_derivative(rolling, t, state)]
        if modes is not None:
            flying = HybridScene(scene, modes).in_modes.flying
            found.append(rolling_derivative(flying, t, of(start).flying()))
        return found

    return rates
