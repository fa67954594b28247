"""Observables of a contact that rolls, slips or flies, as its mode has them.

Under ``vmap`` all modes are evaluated, and one is picked. What the others make of a
state that is not theirs need not be a number, and in reverse mode it would come back: 0
times NaN is NaN. So a mode's scene, time and state move only where it is the mode.
"""

from collections.abc import Callable
from types import FunctionType
from typing import Any, TypeAlias, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from ..dynamics.scene import Scene
from ..kinematics.base_motion import AbstractBaseMotion, BaseKinematics
from .modes import HybridScene, Mode, ModedState, slipping

_T = TypeVar("_T")
# Of a scene, the time [s] and a state.
_Observable: TypeAlias = Callable[[Scene, Array, Any], Any]
# An array of more numbers is a table, of which each state would have a copy
_TABLE = 100


def by_mode(observable: _Observable) -> Callable[[HybridScene, Array, ModedState], Any]:
    """An observable of one mode's scene and state, as one of a state in modes.

    Args:
        observable: Function of a scene, the time [s] and a state.
    """

    def seen(scene: HybridScene, t: Array, state: ModedState) -> Any:
        friction = scene.modes.friction
        modes = [m for m in Mode if m != Mode.SLIPPING or friction is not None]
        which = [state.mode == mode for mode in modes]
        known = scene, t, state
        found = [
            _seen(observable, mode, own, *_moved(own, *known))
            for mode, own in zip(modes, which, strict=True)
        ]
        pick: Callable[..., Array] = lambda *values: jnp.select(which, values, jnp.nan)
        return jax.tree.map(pick, *found)

    return seen


def _seen(
    observable: _Observable,
    mode: Mode,
    own: Bool[Array, ""],
    scene: HybridScene,
    t: Array,
    state: ModedState,
) -> Any:
    """An observable in one mode, where it is the state's own."""
    scenes, y = scene.in_modes, state.parts
    if mode == Mode.ROLLING:
        known = scenes.rolling, t, y.rolling()
    elif mode == Mode.FLYING:
        known = scenes.flying, t, y.flying()
    else:
        assert scene.modes.friction is not None
        way = scene.modes.friction, state.direction
        known = slipping(scenes.rolling, *way, y), t, y.sliding()
    if not isinstance(observable, FunctionType) or observable.__closure__:
        # numbers that it holds move it, too
        opened = eqx.filter_closure_convert(observable, *known)
        observable = moved_where(own, opened)
    return observable(*known)


class _MovedWhere(AbstractBaseMotion):
    """A base's motion by tables, of which each state has only what it looks up.

    Attributes:
        motion: That.
        own: Whether it moves what is seen.
    """

    motion: AbstractBaseMotion
    own: Bool[Array, ""]

    def at(self, t: Array) -> BaseKinematics:
        """Pose, velocity and acceleration, with their derivatives where it moves."""
        return moved_where(self.own, self.motion.at(t))


def _moved(
    own: Bool[Array, ""], scene: HybridScene, t: Array, state: ModedState
) -> tuple[HybridScene, Array, ModedState]:
    """What moves where it is the mode's own, a base's tables by what they give."""
    moved = moved_where(own, (scene, t, state))
    motion = scene.base.motion
    large = [x.size > _TABLE for x in jax.tree.leaves(motion)]
    if motion is None or not any(large):
        return moved
    of_base: Callable[[Any], Any] = lambda known: known[0].base.motion
    return eqx.tree_at(of_base, moved, _MovedWhere(of_base(moved), own))


def moved_where(own: Bool[Array, ""], tree: _T) -> _T:
    """A tree whose numbers have their derivatives in one place, else none.

    Args:
        own: Whether it is that place.
        tree: With arrays; tables are left as they are.

    What comes back to another place is zero, even if it is not a number.
    """

    def moved(x: Any) -> Any:
        if not eqx.is_inexact_array(x) or x.size > _TABLE:
            return x
        return jnp.where(own, x, jax.lax.stop_gradient(x))

    return jax.tree.map(moved, tree)
