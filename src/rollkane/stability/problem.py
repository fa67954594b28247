"""What steady motions are asked of: rates, independent coordinates, generators.

One face for a rolling scene and for a system of :mod:`rollkane.kane`. All of it is
traced by JAX and differentiable by every number that the problem holds.
"""

import abc
from typing import Any, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..dynamics.mass_matrix import field_of
from ..dynamics.rolling import rolling_derivative
from ..dynamics.scene import Scene
from ..kinematics.coordinates import State
from .group_actions import Action, carried_by, carrying_with, moved_by, tangent
from .independent_coordinates import (
    VELOCITIES,
    IndependentCoordinates,
    alike,
    body_length,
)
from .symmetries import Symmetries


class AbstractProblem(eqx.Module):
    """An autonomous system with a symmetry group.

    Attributes:
        group: Names of the generators.
    """

    group: eqx.AbstractVar[tuple[str, ...]]

    @abc.abstractmethod
    def coordinates(self, state: Any) -> tuple[tuple[str, ...], tuple[bool, ...]]:
        """Names of the n independent coordinates, and which of them are velocities."""

    @abc.abstractmethod
    def sizes(self, state: Any) -> tuple[np.ndarray, float]:
        """Changes of the coordinates that are alike, and a rate that goes with them.

        Returns:
            Shape (n,), of velocities in one second; and a rate of the system at rest
            [1/s], zero where none is known.
        """

    @abc.abstractmethod
    def moved(self, state: Any, x: Float[Array, " n"]) -> Any:
        """The state at coordinates x around another."""

    @abc.abstractmethod
    def image(self, reference: Any, state: Any) -> Float[Array, " m"]:
        """What tells states apart, near a reference."""

    @abc.abstractmethod
    def rates(self, state: Any) -> Any:
        """Rates of a state, without what time itself carries along."""

    @abc.abstractmethod
    def generator(self, state: Any, velocities: Float[Array, " K"]) -> Any:
        """Tangent of a state that moves with given group velocities."""

    @abc.abstractmethod
    def along_group(self, state: Any, steps: Float[Array, " K"]) -> Any:
        """The state moved by a group element."""

    @abc.abstractmethod
    def carried(self, state: Any, time: Float[Array, ""]) -> Any:
        """The state carried along by time itself, from the time zero."""

    @property
    @abc.abstractmethod
    def model(self) -> Any:
        """What parameters are named in: the scene, the system."""

    @abc.abstractmethod
    def with_model(self, model: Any) -> "AbstractProblem":
        """The same problem of a scene or a system with other numbers."""


class RollingProblem(AbstractProblem):
    """Steady motions of a rolling scene, at the time zero.

    Attributes:
        scene: What rolls on what.
        action: Its symmetries.
        drift: What time itself does beside carrying states along with the base.
        group: Names of the generators.
    """

    scene: Scene
    action: Action
    drift: Action
    group: tuple[str, ...] = eqx.field(static=True)

    def _around(self, state: Any) -> IndependentCoordinates:
        return IndependentCoordinates(self.scene, jnp.zeros_like(_one(state)), state)

    def coordinates(self, state: Any) -> tuple[tuple[str, ...], tuple[bool, ...]]:
        """Of ``IndependentCoordinates``; velocities: angular, alpha', slip."""
        # whatever the time, of which a zero of NumPy costs nothing
        names = IndependentCoordinates(self.scene, cast(Array, _ZERO), state).names
        return names, tuple(name.startswith(VELOCITIES) for name in names)

    def sizes(self, state: Any) -> tuple[np.ndarray, float]:
        """Of ``alike``; and the rate with which weight moves a body of its length."""
        field = field_of(self.scene.loads)
        weight = 0.0 if field is None else float(np.linalg.norm(np.asarray(field)))
        rate = float(np.sqrt(weight / body_length(self.scene)))
        return alike(self._around(state)), rate

    def moved(self, state: Any, x: Float[Array, " n"]) -> Any:
        """The state at coordinates x around another."""
        return self._around(state).state(x)

    def image(self, reference: Any, state: Any) -> Float[Array, " m"]:
        """What tells states apart, near a reference."""
        return self._around(reference).image(state)

    def rates(self, state: Any) -> Any:
        """Right-hand side of rolling, less what base and drift carry along."""
        t = jnp.zeros_like(_one(state))
        rates = rolling_derivative(self.scene, t, cast(State, state))
        along = carrying_with(self.scene, t, state, self.drift)
        return jax.tree.map(_less, rates, along)

    def generator(self, state: Any, velocities: Float[Array, " K"]) -> Any:
        """Tangent of a state that moves with given group velocities."""
        return tangent(self.scene, 0.0 * _one(state), state, self.action, velocities)

    def along_group(self, state: Any, steps: Float[Array, " K"]) -> Any:
        """The state moved by a group element."""
        return moved_by(self.scene, 0.0 * _one(state), state, self.action, steps)

    def carried(self, state: Any, time: Float[Array, ""]) -> Any:
        """The state carried along by base and drift, from the time zero."""
        return carried_by(self.scene, 0.0 * time, time, state, self.drift)

    @property
    def model(self) -> Scene:
        """The scene."""
        return self.scene

    def with_model(self, model: Any) -> "RollingProblem":
        """Of a scene with other numbers and the same symmetries."""
        return eqx.tree_at(lambda p: p.scene, self, model)


def rolling_problem(scene: Scene, found: Symmetries) -> RollingProblem:
    """The problem of a scene with its symmetries.

    Raises:
        FieldError: it depends on time in a way that no motion takes out.
    """
    return RollingProblem(
        group=found.names, scene=scene, action=found.action, drift=found.known_drift
    )


_ZERO = np.zeros(())


def _one(state: Any) -> Array:
    return state.orientation[0]


def _less(a: Array, b: Array) -> Array:
    return a - b
