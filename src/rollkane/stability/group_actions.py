"""Lie algebras that act on the states of a scene: tangents, and their exact flows."""

from collections.abc import Callable
from typing import Any, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.scipy.linalg
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from ..dynamics.scene import Scene
from ..geometry.rotations import (
    multiply,
    quaternion_of,
    quaternion_rates,
    rotation_matrix,
)
from ..geometry.small_linear import cross
from ..kinematics.coordinates import SlidingState, State, shared_parts
from .independent_coordinates import rotation_of


class Action(eqx.Module):
    """Elements of a Lie algebra that acts on states, one row for each.

    Attributes:
        turn: Angular velocity with which the body is turned, BASE axes [1], (K, 3).
        on_base: ``[[M, b], [0, 0]]`` of the contact coordinates on the base,
            shape (K, k + 1, k + 1).
        spin: Angular velocity on BODY axes by which surface and mass are renamed [1],
            shape (K, 3).
        on_body: Likewise of the contact coordinates on the body.
        shift: Of alpha, shape (K, n).
    """

    turn: Float[Array, "K 3"]
    on_base: Float[Array, "K k k"]
    spin: Float[Array, "K 3"]
    on_body: Float[Array, "K m m"]
    shift: Float[Array, "K n"]

    def combined(self, weights: Any) -> "Action":
        """Linear combinations, one for each row of weights; by NumPy where known."""

        def summed(part: Any) -> Any:
            known = type(part) is np.ndarray and type(weights) is np.ndarray
            library: Any = np if known else jnp
            return library.tensordot(weights.astype(part.dtype), part, 1)

        return jax.tree.map(summed, self)


def tangent(
    scene: Scene,
    time: ArrayLike,
    state: State,
    action: Action,
    weights: Float[Array, " K"],
) -> State:
    """Tangent of a state under a combination of generators."""
    one = action.combined(weights[None])
    w, spin = _fixed(scene, time, state, one.turn[0]), one.spin[0]
    q = state.orientation
    left = multiply(jnp.concatenate([jnp.zeros_like(w[:1]), 0.5 * w]), q)
    parts: dict[str, Any] = {
        "orientation": left - quaternion_rates(q, spin),
        "angular_velocity": cross(spin, state.angular_velocity),
        "contact_on_base": _affine(one.on_base[0], state.contact_on_base),
        "contact_on_body": _affine(one.on_body[0], state.contact_on_body),
        "alpha": one.shift[0],
        "alpha_dot": jnp.zeros_like(state.alpha_dot),
    }
    if isinstance(state, SlidingState):
        return SlidingState(**parts, slip=cross(w, state.slip))
    return State(**parts)


def moved_by(
    scene: Scene,
    time: ArrayLike,
    state: State,
    action: Action,
    weights: Float[Array, " K"],
) -> State:
    """The state moved by a group element, by the exact flow."""
    one = action.combined(weights[None])
    turn = rotation_of(_fixed(scene, time, state, one.turn[0]))
    spin = rotation_of(-one.spin[0])
    state = turned(state, turn, rotation_matrix(turn))
    parts: dict[str, Any] = shared_parts(state) | {
        "orientation": multiply(state.orientation, spin),
        "angular_velocity": rotation_matrix(spin).T @ state.angular_velocity,
        "contact_on_base": _flowed(one.on_base[0], state.contact_on_base),
        "contact_on_body": _flowed(one.on_body[0], state.contact_on_body),
        "alpha": state.alpha + one.shift[0],
    }
    if isinstance(state, SlidingState):
        return SlidingState(**parts, slip=state.slip)
    return State(**parts)


def turned(state: State, turn: Float[Array, "4"], matrix: Float[Array, "3 3"]) -> State:
    """The state with all that is on fixed axes turned, the contact left where it is."""
    parts = shared_parts(state)
    parts["orientation"] = multiply(turn, state.orientation)
    if isinstance(state, SlidingState):
        return SlidingState(**parts, slip=matrix @ state.slip)
    return State(**parts)


def carried_by(
    scene: Scene, start: Array, time: Array, state: State, drift: Action
) -> State:
    """The state carried along by base and drift, from a start to a time [s]."""
    motion = scene.base.motion
    if motion is not None:
        first, last = motion.at(start).rotation, motion.at(time).rotation
        if first is not None and last is not None:
            turn = last @ first.T
            state = turned(state, quaternion_of(turn), turn)
    return moved_by(scene, time, state, drift, (time - start)[None])


def _affine(law: Float[Array, "k k"], u: Float[Array, " m"]) -> Float[Array, " m"]:
    m = u.shape[0]
    return law[:m, :m] @ u + law[:m, m]


def _flowed(law: Float[Array, "k k"], u: Float[Array, " m"]) -> Float[Array, " m"]:
    m = u.shape[0]
    if not m:
        return u
    flow = cast(Array, jax.scipy.linalg.expm(law))
    return flow[:m, :m] @ u + flow[:m, m]


def _fixed(
    scene: Scene, time: ArrayLike, state: State, vector: Float[Array, "3"]
) -> Float[Array, "3"]:
    """A vector on base axes, on fixed axes."""
    motion = scene.base.motion
    if motion is None:
        return vector
    return motion.at(jnp.asarray(time, state.orientation.dtype)).to_fixed(vector)


def base_turn(scene: Scene, time: ArrayLike, state: State) -> State:
    """Tangent of a state that is fixed to the base."""
    nothing: Callable[[Array], Array] = lambda x: 0.0 * x
    still = jax.tree.map(nothing, state)
    motion = scene.base.motion
    if motion is None:
        return still
    base = motion.at(jnp.asarray(time, state.orientation.dtype))
    if base.angular_velocity is None:
        return still
    w = base.to_fixed(base.angular_velocity)
    turned = jnp.concatenate([jnp.zeros_like(w[:1]), 0.5 * w])
    q = multiply(turned, state.orientation)
    moved = eqx.tree_at(lambda s: s.orientation, still, q)
    if isinstance(state, SlidingState):
        moved = eqx.tree_at(lambda s: s.slip, moved, cross(w, state.slip))
    return moved


def carrying_with(scene: Scene, time: ArrayLike, state: State, drift: Action) -> State:
    """Tangent of a state that base and drift carry along."""
    with_base = base_turn(scene, time, state)
    one = jnp.ones(1, state.orientation.dtype)
    own = tangent(scene, time, state, drift, one)
    total: Callable[[Array, Array], Array] = lambda a, b: a + b
    return jax.tree.map(total, with_base, own)
