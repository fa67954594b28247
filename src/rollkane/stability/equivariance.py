"""Whether equations keep their form under a group: Lie brackets at random states."""

from collections.abc import Callable
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..codegen.compile_effort import for_one_call
from ..dynamics.consistency import consistent
from ..dynamics.rolling import rolling_derivative
from ..dynamics.scene import Scene
from ..geometry.small_linear import norm
from ..kinematics.coordinates import SlidingState, State, pack, shared_parts, unpack
from .group_actions import Action, base_turn, carried_by, carrying_with, tangent
from .surface_motions import null_space, seeds

_STATES = 16  # random ones at which equations are compared
_FEW = 4  # of them, where the same is compared at many times


def random_draws(scene: Scene, dtype: np.dtype[Any]) -> tuple[Array, State]:
    """Times and states of any kind, not yet consistent."""
    draw = np.random.default_rng(1)

    def normal(*shape: int) -> Array:
        return jnp.asarray(draw.standard_normal(shape), dtype)

    def pick(u: np.ndarray) -> Array:
        return jnp.asarray(u[draw.integers(u.shape[0], size=_STATES)], dtype)

    on_body = jnp.zeros((_STATES, 0), dtype)
    if scene.has_contact_coordinates:
        on_body = pick(seeds(scene.body.surface))
    n = scene.coordinate_count
    state = State(
        orientation=normal(_STATES, 4),
        angular_velocity=normal(_STATES, 3),
        contact_on_base=pick(seeds(scene.base.surface)),
        contact_on_body=on_body,
        alpha=normal(_STATES, n),
        alpha_dot=normal(_STATES, n),
    )
    if scene.contact.slips:
        state = SlidingState(**shared_parts(state), slip=normal(_STATES, 3))
    return normal(_STATES), state


@for_one_call
def brackets_of(
    scene: Scene, action: Action, times: Array, states: State
) -> tuple[Array, Array]:
    """Lie brackets of the right-hand side with every candidate, and their sizes.

    Returns:
        Shapes (states, numbers of a state, K + 1), that of time last, and (states,
        numbers of a state).
    """
    count = action.turn.shape[0]
    axes = jnp.eye(count, dtype=times.dtype)

    def at(t: Array, state: State) -> tuple[Array, Array]:
        y = cast(State, consistent(scene, t, state))
        one = jnp.ones_like(t)

        def rates(t: Array, y: State) -> Any:
            return rolling_derivative(scene, t, y)

        f, along = cast(tuple[State, Any], jax.linearize(rates, t, y))

        def with_group(weights: Array) -> tuple[Array, Array]:
            def G(t: Array, y: State) -> State:
                return tangent(scene, t, y, action, weights)

            value, back = jax.jvp(G, (t, y), (one, f))
            return pack(along(0.0 * t, value)), pack(back)

        def with_time() -> tuple[Array, Array]:
            def T(t: Array, y: State) -> State:
                return base_turn(scene, t, y)

            value, back = jax.jvp(T, (t, y), (one, f))
            return pack(along(one, value)), pack(back)

        ahead, back = with_time()
        ahead, back = ahead[None], back[None]
        if count:
            others = jax.vmap(with_group)(axes)
            ahead = jnp.concatenate([others[0], ahead])
            back = jnp.concatenate([others[1], back])
        return (ahead - back).T, _sizes(y, f, jnp.abs(ahead) + jnp.abs(back))

    return jax.vmap(at)(times, states)


def carried_rates(
    scene: Scene, drift: Action, times: np.ndarray, states: State
) -> np.ndarray:
    """Rates of states that time carries along, by what turns leave alone.

    Args:
        scene: What rolls on what.
        drift: What time does beside carrying states along with the base.
        times: [s], shape (T,).
        states: Any, stacked.

    Returns:
        Those, and sizes that they are told beside, shape (T, states, 2, y).
    """
    some: Callable[[Array], Array] = lambda part: part[:_FEW]
    few = jax.tree.map(some, states)
    return np.asarray(_carried_rates(scene, drift, jnp.asarray(times), few), float)


@for_one_call
def _carried_rates(scene: Scene, drift: Action, times: Array, states: State) -> Array:
    def at(t: Array, state: State) -> Array:
        zero = jnp.zeros_like(t)
        y = cast(State, consistent(scene, zero, state))
        y = carried_by(scene, zero, t, y, drift)
        f = cast(State, rolling_derivative(scene, t, y))
        along = carrying_with(scene, t, y, drift)
        less: Callable[[Array, Array], Array] = lambda a, b: a - b
        own = cast(State, jax.tree.map(less, f, along))
        sizes = unpack(_sizes(y, own, jnp.zeros((1, pack(y).shape[0]))), y)
        both: list[Array] = []
        for one in (own, sizes):
            turned = [one.angular_velocity, one.contact_on_base, one.contact_on_body]
            if isinstance(one, SlidingState):
                turned.append(one.slip)
            # drifts turn these, and leave their lengths
            parts = [norm(part)[None] for part in turned if part.shape[0]]
            parts += [one.alpha, one.alpha_dot]
            both.append(jnp.concatenate(parts))
        return jnp.stack(both)

    over = jax.vmap(at, (None, 0))
    return jax.vmap(over, (0, None))(times, states)


def _sizes(state: State, rates: State, terms: Float[Array, "K y"]) -> Array:
    """What a bracket is small beside, one number for each part of a state.

    Its terms, the rates, and what a turn by the angular velocity would make of the
    part: of a homogeneous ball all others vanish.
    """
    fast = norm(state.angular_velocity)
    summed = unpack(jnp.sum(terms, axis=0), state)

    def largest(y: Array, f: Array, s: Array) -> Array:
        if not y.shape[0]:
            return y
        return jnp.full_like(y, jnp.max(s + jnp.abs(f) + fast * norm(y)))

    return pack(jax.tree.map(largest, state, rates, summed))


def equivariant(brackets: np.ndarray, sizes: np.ndarray, loose: float) -> np.ndarray:
    """Combinations of all candidates whose brackets vanish, shape (J, K + 1)."""
    good = np.all(np.isfinite(sizes), axis=1)
    good &= np.all(np.isfinite(brackets), axis=(1, 2))
    count = brackets.shape[2]
    if not good.any():
        return np.zeros((0, count))
    # of all states together, so that what vanishes at one does not count as rounding
    scale = np.max(sizes[good], axis=0)
    scale = np.where(scale > 0.0, scale, 1.0)
    rows = (brackets[good] / scale[None, :, None]).reshape(-1, count)
    return null_space(rows.astype(float), 10.0 * loose)
