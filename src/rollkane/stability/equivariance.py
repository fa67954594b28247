"""Whether equations keep their form under a group: Lie brackets at drawn states."""

from collections.abc import Callable
from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..codegen.compile_effort import for_one_call
from ..dynamics.rolling import rolling_derivative
from ..dynamics.scene import Scene
from ..geometry.small_linear import norm
from ..kinematics.coordinates import SlidingState, State, pack, unpack
from .group_actions import Action, base_turn, carried_by, carrying_with, tangent
from .state_draws import ROWS, Draws, drawn, rows_of
from .surface_motions import null_space

_FEW = 4  # of them, where the same is compared at many times


class Tested(NamedTuple):
    """Brackets at draws.

    Attributes:
        brackets: Of the right-hand side with every candidate, that of time last, shape
            (N, numbers of a state, K + 1).
        sizes: What they are small beside, shape (N, numbers of a state).
        near: Whether a draw is near a given state, shape (N,).
        fast: Whether velocities in it are of one in any case, shape (N,).
    """

    brackets: np.ndarray
    sizes: np.ndarray
    near: np.ndarray
    fast: np.ndarray

    @property
    def good(self) -> np.ndarray:
        """Draws at which all of it is finite, shape (N,)."""
        finite = np.all(np.isfinite(self.sizes), axis=1)
        return finite & np.all(np.isfinite(self.brackets), axis=(1, 2))

    def with_more(self, more: "Tested") -> "Tested":
        """Both."""
        return Tested(*(np.concatenate(both) for both in zip(self, more, strict=True)))


def tested(scene: Scene, action: Action, draws: Draws) -> Tested:
    """Brackets at draws, by one program for all."""
    found: list[Any] = []
    for first in range(0, draws.times.size, ROWS):
        some = rows_of(draws, slice(first, first + ROWS))
        found.append(_brackets(scene, action, some._replace(near=(), fast=())))
    brackets, sizes = (
        np.concatenate([np.asarray(x) for x in parts])
        for parts in zip(*found, strict=True)
    )
    return Tested(brackets, sizes, draws.near, draws.fast)


@for_one_call
def _brackets(scene: Scene, action: Action, draws: Any) -> tuple[Array, Array]:
    """Lie brackets of the right-hand side with every candidate, and their sizes."""
    count = action.turn.shape[0]
    axes = jnp.eye(count, dtype=draws.times.dtype)

    def at(draw: Draws) -> tuple[Array, Array]:
        t, y = jnp.asarray(draw.times), drawn(scene, jnp.asarray(draw.times), draw)
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

    return jax.vmap(at)(draws)


def carried_rates(
    scene: Scene, drift: Action, times: np.ndarray, draws: Draws
) -> np.ndarray:
    """Rates of states that time carries along, by what turns leave alone.

    Args:
        scene: What rolls on what.
        drift: What time does beside carrying states along with the base.
        times: [s], shape (T,).
        draws: Of the states, at the time zero.

    Returns:
        Those, and sizes that they are told beside, shape (T, states, 2, y).
    """
    few = rows_of(draws, np.linspace(0, draws.times.size - 1, _FEW).astype(int))
    some = few._replace(near=(), fast=())
    return np.asarray(_carried_rates(scene, drift, jnp.asarray(times), some), float)


@for_one_call
def _carried_rates(scene: Scene, drift: Action, times: Array, draws: Any) -> Array:
    def at(t: Array, draw: Draws) -> Array:
        zero = jnp.zeros_like(t)
        y = drawn(scene, zero, draw)
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
    return jax.vmap(over, (0, None))(times, draws)


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


def equivariant(found: Tested, loose: float) -> np.ndarray:
    """Combinations of all candidates whose brackets vanish, shape (J, K + 1)."""
    count = found.brackets.shape[2]
    rows = [np.zeros((0, count))]
    for near in (False, True):
        some = found.good & (found.near == near)
        if not some.any():
            continue
        sizes = found.sizes[some]
        # of all states together, so that what vanishes at one does not count as
        # rounding; near given ones of most that move, so that none hides the others
        scale = np.max(sizes, axis=0)[None]
        if near:
            moving = found.fast[some] if found.fast[some].any() else slice(None)
            scale = np.maximum(sizes, np.median(sizes[moving], axis=0))
        scale = np.where(scale > 0.0, scale, 1.0)
        rows.append((found.brackets[some] / scale[:, :, None]).reshape(-1, count))
    return null_space(np.concatenate(rows).astype(float), 10.0 * loose)
