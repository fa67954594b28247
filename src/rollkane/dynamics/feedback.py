"""Feedback: generalized forces as functions of the time and of the whole state."""

from collections.abc import Callable
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..validation.checks import FieldError
from ..validation.user_functions import GivenFunction, as_floats
from .loads import AbstractLoad
from .rolling_bodies import example_state
from .scene import Scene


class Feedback(AbstractLoad):
    """Generalized forces by a function of the time and the state.

    Attributes:
        force: The user's function.
        parameters: Numbers that it depends on.
    """

    needs_state: ClassVar[bool] = True
    force: Any
    parameters: Any

    @property
    def does_work(self) -> bool:
        """True."""
        return True

    def generalized(self, t: Float[Array, ""], state: Any) -> Float[Array, " m"]:
        """One for each quasi-velocity, in the order of the system (4.3)."""
        return self.force(t, state, self.parameters)


def with_feedback(
    scene: Scene, force: Callable[..., Any], parameters: Any = None
) -> Scene:
    """A scene that a control law drives: ``M u' = f + force(t, state)``.

    Args:
        scene: What rolls on what.
        force: ``force(t, state)`` or ``force(t, state, parameters)`` of the time [s]
            and the ``State``, that returns a generalized force for each of the
            quasi-velocities of ``equations_of_motion``, shape (m,): a torque on the
            body [N m], BODY axes, three components; then [J per unit of alpha] for
            each coordinate; then the torque of each rolling body's carrier on it
            [N m], its own axes, and the forces on what it carries. Nothing else acts on
            the other side of these than the carrier.
        parameters: Tree of numbers for the function, such as gains; differentiable.

    Returns:
        The scene with one load more; energy and power count it.

    Raises:
        FieldError: no function, or one of another shape or signature.

    Source: docs/theory.md, (4.9).
    """
    if not isinstance(scene, Scene):  # pyright: ignore[reportUnnecessaryIsInstance]
        remedy = "give a Scene, then the function"
        raise FieldError("with_feedback.scene", scene, "must be a Scene", remedy)
    count = 3 + sum(part.count for part in scene.supported)
    parameters = as_floats(parameters)
    example = jnp.zeros(()), example_state(scene)
    field, meaning = "with_feedback.force", "(t, state)"
    law = GivenFunction(field, force, (count,), example, parameters, meaning)
    loads = (*scene.loads, Feedback(law, parameters))
    return eqx.tree_at(lambda s: s.loads, scene, loads, is_leaf=_is_loads(scene))


def _is_loads(scene: Scene) -> Callable[[object], bool]:
    return lambda x: x is scene.loads
