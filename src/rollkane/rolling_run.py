"""What integrating a rolling scene asks of it, whichever loop does it."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from .rolling import LEAST_MARGIN, painleve_margin
from .scene import Scene, Slipping
from .small_linear import norm
from .trajectory import Code


def corners(scene: Scene) -> tuple[Any, bool]:
    """Kinks of the base's motion [s], and whether its acceleration may jump there."""
    motion = scene.base.motion
    return (None, False) if motion is None else (motion.kinks, motion.jumps)


def error_sizes(state: Any) -> Any:
    """Sizes of a state's numbers, for the default absolute tolerance.

    Those of the angular velocity are its length: of a body that spins fast no component
    is known better than the rounding of the largest.
    """
    w = state.angular_velocity
    fast = jnp.maximum(norm(w), 1.0)
    fast = jnp.where(jnp.isfinite(fast), fast, 1.0)  # a bad start is refused elsewhere
    ones = jax.tree.map(jnp.ones_like, state)
    return eqx.tree_at(lambda s: s.angular_velocity, ones, jnp.full_like(w, fast))


def has_margin(scene: Scene) -> bool:
    """Whether something is proportional to the normal force."""
    law = scene.contact
    slips = isinstance(law, Slipping) and law.friction.needs_normal_force
    return slips or any(load.needs_normal_force for load in scene.loads)


@jax.jit
def code_by_margin(code: Array, scene: Scene, t: Array, state) -> Array:
    """The code, PAINLEVE where a step was too small for want of a normal force."""
    margin = painleve_margin(scene, t, state)
    stopped = (code == Code.STEP_TOO_SMALL) | (code == Code.BAD_START)
    return jnp.where(stopped & (margin < LEAST_MARGIN), Code.PAINLEVE, code)
