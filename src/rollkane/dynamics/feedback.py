"""Feedback: generalized forces as functions of the time and of the whole state."""

import itertools
from collections.abc import Callable, Iterator
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..geometry.small_linear import components, dot
from ..validation.user_functions import GivenFunction, as_floats
from .abstract_supported import rolling_parts
from .loads import AbstractLoad
from .nearest_anywhere import at_nearest
from .rolling import contact_of
from .rolling_bodies import example_state
from .scene import Scene, require_scene


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

    def generalized(self, scene: Scene, t: Float[Array, ""], state: Any) -> list[Array]:
        """One for each quasi-velocity, in the order of the system (4.3)."""
        law: Callable[[Any], Array] = lambda y: self.force(t, y, self.parameters)
        given = iter(components(at_nearest(scene, t, state, law)))
        return [*itertools.islice(given, 3), *_on_supported(scene, t, state, given)]


def _on_supported(
    scene: Scene, t: Float[Array, ""], state: Any, given: Iterator[Array]
) -> Iterator[Array]:
    """Generalized forces on what a body carries, of what a law gives for it.

    A torque on a body that does not spin about the normal acts by its other components:
    axes of these, which are chosen by the normal, are not asked of the user.
    """
    yield from itertools.islice(given, scene.coordinate_count)
    for part, own in zip(rolling_parts(scene.supported), state.supported, strict=True):
        torque = list(itertools.islice(given, 3))
        if part.scene.contact.without_spin:
            axes = part.axes(contact_of(part.scene, t, own))
            torque = [dot(axis, jnp.stack(torque)) for axis in axes]
        yield from torque
        yield from _on_supported(part.scene, t, own, given)


def _count(scene: Scene) -> int:
    """How many numbers a law gives: a torque, and what acts on what is carried."""
    inner = (_count(part.scene) for part in rolling_parts(scene.supported))
    return 3 + scene.coordinate_count + sum(inner)


def with_feedback(
    scene: Scene, force: Callable[..., Any], parameters: Any = None
) -> Scene:
    """A scene that a control law drives: ``M u' = f + force(t, state)``.

    Args:
        scene: What rolls on what.
        force: ``force(t, state)`` or ``force(t, state, parameters)`` of the time [s]
            and the ``State``, that returns shape (m,): a torque on the body [N m], BODY
            axes, three components; then [J per unit of alpha] for each coordinate; then
            the torque of each rolling body's carrier on it [N m], its own axes, three
            components, and the forces on what it carries. Nothing else acts on the
            other side of these than the carrier. In a pair by ``RubberRolling()`` the
            part of the torque along the normal does nothing.
        parameters: Tree of numbers for the function, such as gains; differentiable.

    Returns:
        The scene with one load more; energy and power count it.

    Raises:
        FieldError: no function, or one of another shape or signature.

    Source: docs/theory.md, (4.9).
    """
    require_scene("with_feedback.scene", scene, "give a Scene, then the function")
    parameters = as_floats(parameters)
    example = jnp.zeros(()), example_state(scene)
    field, meaning = "with_feedback.force", "(t, state)"
    law = GivenFunction(field, force, (_count(scene),), example, parameters, meaning)
    loads = (*scene.loads, Feedback(law, parameters))
    return eqx.tree_at(lambda s: s.loads, scene, loads, is_leaf=_is_loads(scene))


def _is_loads(scene: Scene) -> Callable[[object], bool]:
    return lambda x: x is scene.loads
