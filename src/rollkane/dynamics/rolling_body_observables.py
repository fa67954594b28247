"""What the motion of a body that rolls on or in the rolling body is measured by.

Poses and velocities follow from the contacts, from the ground up; the force of each
contact from the accelerations of all that moves with the body.
"""

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import equinox as eqx
from jaxtyping import Array, Float

from ..geometry.rotations import multiply, quaternion_of
from ..geometry.small_linear import (
    components,
    cross,
    dot,
    matmul,
    matvec,
    norm,
    safe_norm,
)
from ..kinematics.contact import Contact
from .abstract_supported import rolling_parts
from .carried import Pairing
from .contact_laws import accelerations
from .mass_matrix import Masses, assemble
from .observables import velocity_of_origin
from .rolling import contact_of
from .scene import Scene
from .supported import total


class RollingBodyMotion(NamedTuple):
    """Motion of a body that rolls on its carrier, at one instant.

    Attributes:
        position: Its origin [m], FIXED axes, shape (3,).
        velocity: Of its origin [m/s], FIXED axes, shape (3,).
        orientation: Unit quaternion, scalar first, its own to FIXED axes [1], (4,).
        angular_velocity: Absolute [rad/s], FIXED axes, shape (3,).
        contact_place: Where it touches its carrier [m], FIXED axes, shape (3,).
        contact_on_body: The same from its origin [m], its OWN axes, shape (3,).
        contact_on_carrier: The same, on the axes of the carrier's surface [m], (3,).
        outward: Unit normal out of the body there [1], FIXED axes, shape (3,).
        body_outward: The same on its OWN axes [1], shape (3,).
        carrier_outward: Unit normal out of the carrier there [1], axes of its surface.
    """

    position: Float[Array, "3"]
    velocity: Float[Array, "3"]
    orientation: Float[Array, "4"]
    angular_velocity: Float[Array, "3"]
    contact_place: Float[Array, "3"]
    contact_on_body: Float[Array, "3"]
    contact_on_carrier: Float[Array, "3"]
    outward: Float[Array, "3"]
    body_outward: Float[Array, "3"]
    carrier_outward: Float[Array, "3"]


def paths_of_rolling(scene: Scene) -> Iterator[tuple[int, ...]]:
    """Paths, as of :func:`motion_of`, of all bodies that roll in a scene."""
    for k, part in enumerate(rolling_parts(scene.supported)):
        yield (k,)
        for path in paths_of_rolling(part.scene):
            yield (k, *path)


class _Pose(NamedTuple):
    """Where a body is and how it moves, on FIXED axes."""

    rotation: Float[Array, "3 3"]
    orientation: Float[Array, "4"]
    position: Float[Array, "3"]
    velocity: Float[Array, "3"]
    angular_velocity: Float[Array, "3"]


def motion_of(
    scene: Scene, t: Float[Array, ""], state: Any, path: Sequence[int]
) -> RollingBodyMotion:
    """Pose, velocities and contact of a rolling body, from the ground up.

    Args:
        scene: What rolls on what.
        t: Time [s].
        state: In contact.
        path: Which: index among the bodies that roll on the rolling body; then among
            those that roll on that one, and so on.

    Source: docs/theory.md, (4.6), with ``v = v_carrier + w_carrier x r + r*``.
    """
    contact = contact_of(scene, t, state)
    pose = _outer_pose(contact)
    pairing = None
    for pairing in _pairings(scene, t, state, path):
        place = pose.position + matvec(pose.rotation, pairing.place)
        pose = _carried_pose(pose, pairing, place)
    assert pairing is not None
    return RollingBodyMotion(
        position=pose.position,
        velocity=pose.velocity,
        orientation=pose.orientation,
        angular_velocity=pose.angular_velocity,
        contact_place=pose.position + matvec(pose.rotation, pairing.contact.body_point),
        contact_on_body=pairing.contact.body_point,
        contact_on_carrier=pairing.contact.base_point,
        outward=matvec(pose.rotation, pairing.contact.normal),
        body_outward=pairing.contact.normal,
        carrier_outward=-matvec(pairing.contact.rotation, pairing.contact.normal),
    )


def _outer_pose(contact: Contact) -> _Pose:
    if contact.orientation is None:
        orientation = quaternion_of(contact.rotation)
    else:
        orientation = contact.orientation / norm(contact.orientation)
    return _Pose(
        contact.rotation,
        orientation,
        contact.position,
        velocity_of_origin(contact),
        matvec(contact.rotation, contact.angular_velocity),
    )


def _carried_pose(carrier: _Pose, pairing: Pairing, place: Float[Array, "3"]) -> _Pose:
    """The pose of a body by that of its carrier, and their contact point."""
    own = pairing.contact
    rotation = matmul(carrier.rotation, pairing.rotation)
    w = carrier.angular_velocity + matvec(rotation, own.angular_velocity)
    position = place - matvec(rotation, own.body_point)
    at_contact = cross(carrier.angular_velocity, place - carrier.position)
    velocity = carrier.velocity + at_contact + cross(w, position - place)
    assert own.orientation is not None
    to_carrier = own.orientation
    if pairing.placement is not None:
        to_carrier = multiply(pairing.placement, to_carrier)
    orientation = multiply(carrier.orientation, to_carrier / norm(to_carrier))
    return _Pose(rotation, orientation, position, velocity, w)


def _pairings(
    scene: Scene, t: Float[Array, ""], state: Any, path: Sequence[int]
) -> Iterator[Pairing]:
    """The contacts from the rolling body to the one that is meant."""
    first, *others = path
    part, own = rolling_parts(scene.supported)[first], state.supported[first]
    pairing = part.carried(t, own, own.alpha_dot).pairing
    assert pairing is not None
    yield pairing
    for k in others:
        pairing = pairing.inner[k]
        yield pairing


def force_on(
    scene: Scene, t: Float[Array, ""], state: Any, path: Sequence[int]
) -> Float[Array, "3"]:
    """Force of its carrier on a rolling body [N], FIXED axes, shape (3,).

    Args:
        scene: What rolls on what.
        t: Time [s].
        state: In contact.
        path: As of :func:`motion_of`.

    Source: docs/theory.md, (6.2), of the body and of all that it carries.
    """
    contact = contact_of(scene, t, state)
    system = assemble(scene, t, state, contact)
    solution = accelerations(scene, t, contact, system)
    parts = [m for m in system.masses if m.part.pairing is not None]
    first, *others = path
    masses = parts[first]
    rates = components(solution.alpha_ddot)
    begin = _first_column(system.masses, masses)
    own = rates[begin : begin + len(masses.part.partials)]
    push = masses.inertial_force(
        solution.angular_acceleration, solution.slip_acceleration, own
    )
    pairing, start = masses.part.pairing, 0
    assert pairing is not None
    for k in others:
        start += pairing.first_of_inner[k]
        pairing = pairing.inner[k]
    return matvec(contact.rotation, total(push[:, start : start + pairing.masses]))


def _first_column(listed: Sequence[Masses], masses: Masses) -> int:
    """Which of the accelerations behind w' is the first of a part."""
    before = 0
    for other in listed:
        if other is masses:
            break
        before += len(other.part.partials)
    return before


class OfRollingBody(eqx.Module):
    """An observable of a body that rolls on or in the rolling body, by its name.

    Attributes:
        name: A field of :class:`RollingBodyMotion`, ``"contact_force"``,
            ``"normal_force"`` or ``"friction_ratio"``.
        path: As of :func:`motion_of`.
    """

    name: str = eqx.field(static=True)
    path: tuple[int, ...] = eqx.field(static=True)

    def __call__(self, scene: Scene, t: Float[Array, ""], state: Any) -> Any:
        """Its value."""
        if self.name in RollingBodyMotion._fields:
            return getattr(motion_of(scene, t, state, self.path), self.name)
        force = force_on(scene, t, state, self.path)
        if self.name == "contact_force":
            return force
        out = motion_of(scene, t, state, self.path).outward
        press = -dot(force, out)
        if self.name == "normal_force":
            return press
        return safe_norm(force + press * out) / press
