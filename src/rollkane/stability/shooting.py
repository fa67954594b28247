"""Shooting: runs from nodes to nodes, closed by a symmetry, and their derivatives.

A relative periodic motion has ``Phi_T(y) = g(xi) y``. Where nothing depends on time but
a base that turns or glides steadily, states are carried back to the start's time, so
that every segment begins there.
"""

from collections.abc import Callable
from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..codegen.compile_effort import around_a_loop, for_one_call
from ..dynamics.rolling import rolling_derivative
from ..dynamics.scene import Scene
from ..kinematics.coordinates import State
from ..simulation.run_options import RunOptions
from .independent_coordinates import IndependentCoordinates
from .symmetries import Symmetries
from .variational import carried

# ``quantity(scene, t, state)`` -> a number.
Quantity = Callable[[Scene, Array, Any], Array]


class Shooting(NamedTuple):
    """What is shot, and how.

    Attributes:
        scene: What rolls on what.
        group: Its symmetries.
        time: Of the start [s].
        driven: Whether the scene depends on time beyond a steady base.
        options: Of the runs.
    """

    scene: Scene
    group: Symmetries
    time: float
    driven: bool
    options: RunOptions

    @property
    def resting(self) -> bool:
        """Whether time itself carries no state along."""
        drift = self.group.drift
        if self.driven or drift is None:
            return True
        parts = cast(list[Array], jax.tree.leaves(drift))
        return self.scene.base.motion is None and not any(np.any(p) for p in parts)


class Nodes(NamedTuple):
    """Unknowns of a relative periodic motion.

    Attributes:
        states: At the beginnings of the segments.
        period: T [s].
        steps: ``xi``, of each symmetry [m] or [rad], shape (K,).
    """

    states: tuple[State, ...]
    period: float
    steps: np.ndarray


class Segment(NamedTuple):
    """Of one segment, in independent coordinates around its target.

    Attributes:
        miss: Where its end is, shape (n,).
        beside: What these coordinates, which are those of a linear projection, do not
            tell of where it is: of second order near the target, and not zero at other
            states that they cannot tell from it.
        by_start: Derivative by the coordinates around its start, shape (n, n).
        by_time: Rate of its end [1/s], shape (n,); less what time carries along.
        end: Its end, as at the time of the target.
        code: Why its run ended.
    """

    miss: Float[Array, " n"]
    beside: Float[Array, ""]
    by_start: Float[Array, "n n"]
    by_time: Float[Array, " n"]
    end: State
    code: Array


class Closing(NamedTuple):
    """The start moved by the symmetry.

    Attributes:
        target: ``g(xi) y``.
        by_start: Derivative of its coordinates by those of the start, shape (n, n).
        by_steps: By ``xi``, shape (n, K).
    """

    target: State
    by_start: Float[Array, "n n"]
    by_steps: Float[Array, "n K"]


def segment(shot: Shooting, nodes: Nodes, k: int, target: State) -> Segment:
    """Segment number k, towards its target."""
    count = len(nodes.states)
    dtype = nodes.states[0].orientation.dtype
    length = nodes.period / count
    begun = shot.time + (k * length if shot.driven else 0.0)
    return _segment(
        shot.scene,
        shot.group,
        jnp.asarray(begun, dtype),
        jnp.asarray(length, dtype),
        nodes.states[k],
        target,
        shot.driven,
        shot.resting,
        shot.options,
    )


def _shot(
    scene: Scene,
    group: Symmetries,
    t: Float[Array, ""],
    length: Float[Array, ""],
    start: State,
    target: State,
    driven: bool,
    resting: bool,
    options: RunOptions,
) -> Segment:
    here = IndependentCoordinates(scene, t, start)
    there = t + length if driven else t
    around = IndependentCoordinates(scene, there, target)

    def back(state: State) -> State:
        return state if resting else group.carried(state, t, t + length)

    def coordinates(state: State) -> Array:
        return around.coordinates(back(state))

    axes = jnp.eye(here.count, dtype=t.dtype)
    moved = carried(here, axes, length, options, coordinates)
    end = back(moved.state)
    rates: Any = rolling_derivative(scene, there, end)
    if not resting:
        less: Callable[[Array, Array], Array] = lambda a, b: a - b
        rates = jax.tree.map(less, rates, group.carrying(end, t))
    miss, rate = cast(
        tuple[Array, Array], jax.jvp(around.coordinates, (end,), (rates,))
    )
    short = around.image(end) - around.image(around.reference)
    beside = jnp.max(jnp.abs(short - around.basis() @ miss))
    return Segment(miss, beside, moved.changes, rate, end, moved.code)


_segment = around_a_loop(_shot)


def closing(shot: Shooting, nodes: Nodes) -> Closing:
    """The first node moved by the symmetry, and how it moves with both."""
    start = nodes.states[0]
    dtype = start.orientation.dtype
    last = shot.time + (nodes.period if shot.driven else 0.0)
    times = jnp.asarray(shot.time, dtype), jnp.asarray(last, dtype)
    return _closing(shot.group, *times, start, jnp.asarray(nodes.steps, dtype))


@for_one_call
def _closing(
    group: Symmetries,
    first: Float[Array, ""],
    last: Float[Array, ""],
    start: State,
    steps: Float[Array, " K"],
) -> Closing:
    scene = group.scene
    here = IndependentCoordinates(scene, first, start)
    target = group.moved(start, steps, last)
    around = IndependentCoordinates(scene, last, target)

    def moved(x: Array, steps: Array) -> Array:
        return around.coordinates(group.moved(here.state(x), steps, last))

    rest = jnp.zeros(here.count, steps.dtype)
    both = cast(tuple[Array, Array], jax.jacfwd(moved, argnums=(0, 1))(rest, steps))
    return Closing(target, *both)


@for_one_call
def measured(
    quantity: Quantity, scene: Scene, t: Float[Array, ""], state: State
) -> tuple[Float[Array, ""], Float[Array, " n"]]:
    """A quantity at a state, and its slope by independent coordinates.

    Args:
        quantity: ``quantity(scene, t, state)`` -> a number.
        scene: What rolls on what.
        t: Time [s].
        state: Of the motion.
    """
    around = IndependentCoordinates(scene, t, state)

    def at(x: Array) -> tuple[Array, Array]:
        value = quantity(scene, t, around.state(x))
        return value, value

    rest = jnp.zeros(around.count, t.dtype)
    slope, value = cast(tuple[Array, Array], jax.jacfwd(at, has_aux=True)(rest))
    return value, slope


@for_one_call
def stepped(scene: Scene, t: Float[Array, ""], state: State, x: Array) -> State:
    """The state at coordinates x around another."""
    return IndependentCoordinates(scene, t, state).state(x)


def offset(shot: Shooting, here: State, there: State) -> Float[Array, " n"]:
    """Coordinates around one state of another, as at the start's time."""
    t = jnp.asarray(shot.time, here.orientation.dtype)
    return _offset(IndependentCoordinates(shot.scene, t, here), there)


@for_one_call
def _offset(around: IndependentCoordinates, state: State) -> Float[Array, " n"]:
    return around.coordinates(state)
