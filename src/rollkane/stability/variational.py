"""Variational equations of a scene: small changes of a start, carried along its run.

In independent coordinates around the states where a run begins and ends, so that
neither lengths that do not matter nor what the contact forbids is among the changes.
"""

from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias, cast

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ..dynamics.rolling import rolling_derivative
from ..dynamics.scene import Scene
from ..kinematics.coordinates import State
from ..simulation.run import simulate
from ..simulation.run_options import RunOptions
from .independent_coordinates import IndependentCoordinates

_Pushed: TypeAlias = tuple[tuple[State, Array], tuple[State, Any]]


class Carried(NamedTuple):
    """A run with small changes of its start.

    Attributes:
        state: At its end.
        changes: Of its coordinates, by column, shape (n, k).
        code: Why it ended, one of :class:`rollkane.Code`.
    """

    state: State
    changes: Float[Array, "n k"]
    code: Int[Array, ""]


def carried(
    start: IndependentCoordinates,
    changes: Float[Array, "n k"],
    duration: Float[Array, ""],
    options: RunOptions,
    coordinates: Callable[[State], Array] | None = None,
) -> Carried:
    """A run, and where changes of its start's coordinates lead.

    Args:
        start: Around the start.
        changes: Of its coordinates, by column, shape (n, k).
        duration: [s].
        options: Of the run.
        coordinates: ``coordinates(state)`` of the end; left out, independent ones
            around the end itself.
    """
    scene, t = start.scene, start.time

    def ended(x: Float[Array, " n"]) -> tuple[State, Array]:
        times = jnp.stack([t, t + duration])
        run = simulate(scene, start.state(x), times, **options._asdict())
        return cast(State, run.final_state), run.code

    rest = jnp.zeros_like(changes[:, 0])
    state, code = ended(rest)
    end = IndependentCoordinates(scene, t + duration, state)

    def pushed(change: Float[Array, " n"]) -> Float[Array, " n"]:
        moved = cast(_Pushed, jax.jvp(ended, (rest,), (change,)))[1][0]
        function = end.coordinates if coordinates is None else coordinates
        return cast(Array, jax.jvp(function, (state,), (moved,))[1])

    found = jax.vmap(pushed, in_axes=1, out_axes=1)(changes)
    return Carried(state, found, code)


def frame(coordinates: IndependentCoordinates) -> Float[Array, "n n"]:
    """``R`` of ``basis = Q R``: it makes coordinates orthonormal among the images."""
    return jnp.linalg.qr(coordinates.basis(), mode="r")


def divergence(scene: Scene, t: Float[Array, ""], state: State) -> Float[Array, ""]:
    """Divergence of the rates on the states that the contact allows [1/s].

    Rate at which the logarithm of a small volume of states grows: the trace of the
    derivative of the rates along an orthonormal basis of the tangent space. Volumes are
    those of the states' images (:mod:`rollkane.stability.independent_coordinates`).

    Args:
        scene: What rolls on what.
        t: Time [s].
        state: That the contact allows.
    """
    around = IndependentCoordinates(scene, t, state)

    def image_rates(x: Float[Array, " n"]) -> Float[Array, " m"]:
        here = around.state(x)
        rates = rolling_derivative(scene, t, here)
        return cast(Array, jax.jvp(around.image, (here,), (rates,))[1])

    rest = jnp.zeros(around.count, state.orientation.dtype)
    basis = around.basis()
    slopes = cast(Array, jax.jacfwd(image_rates)(rest))
    # trace of (B^T B)^-1 B^T F'
    square = basis.T @ basis
    return jnp.trace(cast(Array, jnp.linalg.solve(square, basis.T @ slopes)))
