"""The equations of motion as matrices: ``M u' = f + q``."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..geometry.small_linear import components
from ..validation.checks import FieldError
from .abstract_supported import rolling_parts
from .mass_matrix import assemble
from .rolling import contact_of
from .scene import Rolling, Scene, require_scene


class Equations(NamedTuple):
    """Equations of motion at one instant, ``M u' = f + q``.

    Attributes:
        mass_matrix: M, symmetric positive definite, shape (m, m): kg m^2 for angular
            velocities, kg m and kg for coordinates that are lengths.
        force: f, shape (m,): inertial and applied forces, springs included.
        velocities: u, shape (m,).
        names: Of the quasi-velocities: ``"w x"`` (body axes), ``"alpha'[0]"``,
            ``"rolling[0] u x"`` (its own axes); ``"rolling[0] u 1"`` and ``"u 2"`` of
            one that does not spin about the normal, along two directions at right
            angles to it that jump where the normal's third component, on its own axes,
            changes its sign.
    """

    mass_matrix: Float[Array, "m m"]
    force: Float[Array, " m"]
    velocities: Float[Array, " m"]
    names: tuple[str, ...]


def equations_of_motion(scene: Scene, t: Any, state: Any) -> Equations:
    """Mass matrix and forces of a scene that rolls, for controllers of your own.

    A generalized force q, such as :func:`rollkane.with_feedback` adds, is a torque on
    the body, body axes, then a force for each coordinate, then torques of carriers on
    rolling bodies, along the axes of their quasi-velocities. Solving M u' = f + q for
    u' gives rates of the components on body axes.

    Args:
        scene: What rolls on what, by ``Rolling()`` and without dry resistance.
        t: Time [s].
        state: In pole-free coordinates.

    Raises:
        FieldError: a contact law that has multipliers.

    Source: docs/theory.md, (4.3), (4.9).
    """
    require_scene("equations_of_motion.scene", scene)
    dry = any(load.needs_normal_force for load in scene.loads)
    if type(scene.contact) is not Rolling or dry:
        raise FieldError(
            "equations_of_motion.scene",
            type(scene.contact).__name__,
            "has multipliers: a spin torque, friction or dry resistance",
            "give a scene with contact=Rolling(), or use rolling_derivative",
        )
    t = jnp.asarray(t, state.angular_velocity.dtype)
    system = assemble(scene, t, state, contact_of(scene, t, state))
    rows = system.rows
    count = range(len(rows))
    matrix = [jnp.stack([rows[max(i, j)][min(i, j)] for j in count]) for i in count]
    names = "w x", "w y", "w z"
    return Equations(
        jnp.stack(matrix),
        jnp.stack(system.rhs),
        jnp.stack(quasi_velocities(scene, t, state)),
        (*names, *_names(scene, "")),
    )


def quasi_velocities(scene: Scene, t: Float[Array, ""], state: Any) -> list[Array]:
    """The quasi-velocities of the system (4.3), in its order.

    Args:
        scene: What rolls on what.
        t: Time [s].
        state: In contact.
    """
    w = contact_of(scene, t, state).angular_velocity
    found = [*components(w), *components(state.alpha_dot)]
    for part, own in zip(rolling_parts(scene.supported), state.supported, strict=True):
        found += part.velocities(t, own)
    return found


def _names(scene: Scene, before: str) -> Iterator[str]:
    for k in range(scene.coordinate_count):
        yield f"{before}alpha'[{k}]"
    for k, part in enumerate(rolling_parts(scene.supported)):
        own = f"{before}rolling[{k}] "
        axes = ("1", "2") if part.scene.contact.without_spin else ("x", "y", "z")
        yield from (f"{own}u {axis}" for axis in axes)
        yield from _names(part.scene, own)


def refuse_feedback(field: str, scene: Scene) -> None:
    """Refuse a scene with feedback, where its generalized forces have no place.

    Args:
        field: Name used in the error.
        scene: What rolls on what.

    Raises:
        FieldError: a load of it needs the state.
    """
    if any(load.needs_state for load in scene.loads):
        raise FieldError(
            field,
            "a scene with feedback",
            "has no place for generalized forces by the state",
            "use the equations of rolling in pole-free coordinates",
        )
