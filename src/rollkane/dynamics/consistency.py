"""Consistent states: those that obey the constraints of their contact.

A state has more numbers than the constrained motion. The rates keep the constraints, so
that a motion obeys them if its start does: it is made consistent once, there.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.typing import DTypeLike
from jaxtyping import Array, Float

from ..geometry.rotations import rotation_matrix
from ..geometry.small_linear import (
    components,
    dot,
    matvec,
    matvec_transposed,
    norm,
    solve_spd,
)
from ..geometry.surfaces import AbstractPointSurface
from ..kinematics.contact import body_to_base
from ..kinematics.coordinates import State
from ..kinematics.voronets import VoronetsState
from ..validation.checks import spoilt
from .abstract_supported import rolling_parts
from .mass_matrix import assemble
from .rolling import contact_of
from .scene import Scene


def consistent(scene: Scene, t: Float[Array, ""], state: Any) -> Any:
    """The state without what its contact does not allow.

    Where the body has explicit contact coordinates, it is turned by the smallest
    rotation that brings its normal onto the base's; of a slip the part along the normal
    is left out, and under ``RubberRolling`` the spin about the normal, relative to the
    base. The same of the bodies that roll on it.

    Args:
        scene: What rolls on what.
        t: Time [s].
        state: Any; one in flight or in Voronets coordinates has no spare numbers.
    """
    if isinstance(state, VoronetsState):
        return state
    state = _of_inner(consistent, scene, t, state)
    if not state.touches:
        return state
    slides = state.slips
    rubber = scene.contact.without_spin and not slides
    if not (scene.has_contact_coordinates or rubber or slides):
        return state
    contact = contact_of(scene, t, state)
    if scene.has_contact_coordinates:
        body = scene.body.surface
        aligned = contact.orientation
        assert aligned is not None
        aligned = aligned * (norm(state.orientation) / norm(aligned))
        parts = aligned, body.settled(state.contact_on_body)
        state = eqx.tree_at(lambda s: (s.orientation, s.contact_on_body), state, parts)
    if rubber:
        turned = contact.angular_velocity
        state = eqx.tree_at(lambda s: s.angular_velocity, state, turned)
    if slides:
        assert contact.slip is not None
        slip = matvec(contact.rotation, contact.slip)
        state = eqx.tree_at(lambda s: s.slip, state, slip)
    return state


def with_contact_found(scene: Scene, t: Float[Array, ""], state: Any) -> Any:
    """The state whose contact on the body is where its orientation has it.

    As ``place`` finds it, next to where the state has it: the orientation and the
    contact on the base stay, where :func:`consistent` keeps the contacts and turns the
    body. The same of the bodies that roll on it. NaN where the body has no such normal.

    Args:
        scene: What rolls on what.
        t: Time [s].
        state: Any; one in flight or in Voronets coordinates stays as it is.
    """
    if isinstance(state, VoronetsState):
        return state
    state = _of_inner(with_contact_found, scene, t, state)
    body, motion = scene.body.surface, scene.base.motion
    if not (state.touches and scene.has_contact_coordinates):
        return state
    assert isinstance(body, AbstractPointSurface)
    moving = None if motion is None else motion.at(t)
    to_base = body_to_base(rotation_matrix(state.orientation), moving)
    out = scene.base.surface.geometry(state.contact_on_base).normal
    normal = -matvec_transposed(to_base, out)
    found = body.find_normal_from(normal, state.contact_on_body)
    apart = jax.lax.stop_gradient(norm(body.geometry(found).normal - normal))
    found = spoilt(found, ~(apart <= looseness(normal.dtype)))
    return eqx.tree_at(lambda s: s.contact_on_body, state, found)


def _of_inner(
    function: Callable[[Scene, Array, Any], Any], scene: Scene, t: Array, state: Any
) -> Any:
    """A state with the same done to those of bodies that roll on its body."""
    if not state.supported:
        return state
    pairs = zip(rolling_parts(scene.supported), state.supported, strict=True)
    inner = tuple(function(part.scene, t, own) for part, own in pairs)
    return eqx.tree_at(lambda s: s.supported, state, inner)


def looseness(dtype: DTypeLike) -> float:
    """How far a user's rounded numbers may be off, relative [1]: half the digits."""
    return 1e-6 if dtype == jnp.float64 else 1e-3


class StoppedSpin(NamedTuple):
    """A body on rubber behind the end of its spin.

    Attributes:
        state: Without a spin.
        torque: Impulse that ended it [N m s], BODY axes, along the normal.
    """

    state: State
    torque: Float[Array, "3"]


def spin_stopped(scene: Scene, t: Float[Array, ""], state: State) -> StoppedSpin:
    """What is behind an impulsive torque about the normal that ends the spin.

    As where a body that slips grips on rubber: the impulse ``lambda N`` changes all
    velocities by ``A^-1 N lambda``, with the mass matrix A, so that
    ``(w - w_c) . N = 0``. Kinetic energy relative to the base is lost, never gained.

    Args:
        scene: With ``RubberRolling``.
        t: Time [s].
        state: Rolling, with any spin about the normal.
    """
    contact = contact_of(scene, t, state)
    spin = contact.spare_spin
    assert spin is not None
    rows = assemble(scene, t, state, contact).rows
    normal = components(contact.normal)
    others = [jnp.zeros_like(normal[0])] * (len(rows) - 3)
    change = jnp.stack(solve_spd(rows, [*normal, *others]))
    size = -spin / dot(contact.normal, change[:3])
    change = change * size
    parts = state.angular_velocity + change[:3], state.alpha_dot + change[3:]
    state = eqx.tree_at(lambda s: (s.angular_velocity, s.alpha_dot), state, parts)
    return StoppedSpin(state, size * contact.normal)
