"""A rolling scene as a system of Kane's: the twin that checks the rolling core.

Nothing of the core's dynamics is used, only where things are (the contact) and how they
are carried: velocities of mass centres are written down, Kane's method does the rest.
"""

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias, cast

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..dynamics.abstract_supported import refuse_rolling_parts
from ..dynamics.equations import refuse_feedback
from ..dynamics.loads import AbstractLoad
from ..dynamics.mass_matrix import field_of
from ..dynamics.rolling import contact_of
from ..dynamics.scene import Rolling, Scene
from ..dynamics.supported import Carried
from ..geometry.small_linear import cross
from ..kinematics.contact import Contact
from ..kinematics.coordinates import State, pack, unpack
from ..validation.checks import FieldError
from .parts import Load, Particle, RigidBody
from .system import KaneState, KaneSystem

_Time: TypeAlias = Float[Array, ""]
_Q: TypeAlias = Float[Array, " n"]
_U: TypeAlias = Float[Array, " m"]
_Vector: TypeAlias = Float[Array, "3"]


def rolling_system(scene: Scene, like: State, reactions: bool = False) -> KaneSystem:
    """A scene in pole-free coordinates, written down for Kane's method.

    q: orientation, contact coordinates and alpha of a ``State``; u: angular velocity
    [rad/s], BODY axes, then alpha' (``kane_state``).

    Args:
        scene: What rolls on what, carrying what; the system's parameters.
        like: A state of the scene, for the sizes of its coordinates.
        reactions: Whether the contact point gets three auxiliary velocities along the
            FIXED axes, whose reactions are the contact force [N].

    Raises:
        FieldError: a contact that slips, or does not spin: its law is not written down.

    Source: docs/theory.md, sections 4 and 9.
    """
    if type(scene.contact) is not Rolling:  # RubberRolling is one of its kinds
        raise FieldError(
            "rolling_system.scene",
            type(scene.contact).__name__,
            "has another law of the contact than Rolling",
            "give a scene with contact=Rolling(), or write its system down",
        )
    refuse_rolling_parts("rolling_system.scene", scene.supported)
    refuse_feedback("rolling_system.scene", scene)
    count = scene.coordinate_count
    shared = _Shared(_places(like), reactions)
    parts: list[Any] = [RigidBody(_mass, _inertia, _of_body, _spin)]
    carried = _carried(scene, jnp.zeros((), like.alpha.dtype), like)
    for k, part in enumerate(carried):
        parts += _carried_parts(k, part, like)
    return KaneSystem(
        pack(shared.places).shape[0],
        3 + count,
        _kinematics,
        parts,
        _loads(scene, parts),
        auxiliary=3 * reactions,
        generalized_forces=_springs if count else None,
        parameters=scene,
        shared=shared,
    )


def kane_state(state: State) -> KaneState:
    """A state of a rolling body as one of its Kane system.

    Args:
        state: In pole-free coordinates; angular velocity on BODY axes [rad/s].
    """
    u = jnp.concatenate([state.angular_velocity, state.alpha_dot])
    return KaneState(pack(_places(state)), u)


def _places(state: State) -> State:
    """A state without its speeds."""
    none = jnp.zeros(0, state.angular_velocity.dtype)
    return dataclasses.replace(state, angular_velocity=none, alpha_dot=none)


def _carried(scene: Scene, t: _Time, state: State) -> list[Carried]:
    """Every carried part."""
    return [part.carried(t, *moved) for part, *moved in scene.shares(state)]


class _Instant(NamedTuple):
    """What the functions of a rolling scene share.

    ``at_contact``: velocity of the material points at the contact [m/s], FIXED axes.
    """

    scene: Scene
    state: State
    contact: Contact
    at_contact: Array
    carried: list[Carried]


class _Shared(eqx.Module):
    """The contact and what is carried, from (t, q, u).

    Modules, not closures: systems of the same kind of scene share one compilation.
    """

    places: State
    reactions: bool = eqx.field(static=True)

    def __call__(self, t: _Time, q: _Q, u: _U, scene: Scene) -> _Instant:
        end = 3 + scene.coordinate_count
        state = dataclasses.replace(
            unpack(q, self.places), angular_velocity=u[:3], alpha_dot=u[3:end]
        )
        contact = contact_of(scene, t, state)
        v = jnp.zeros(3, q.dtype)
        if contact.base_velocity is not None:
            v = contact.rotation @ contact.base_velocity
        if self.reactions:
            v = v + u[end:]
        return _Instant(scene, state, contact, v, _carried(scene, t, state))


def _kinematics(t: _Time, q: _Q, u: _U, now: _Instant) -> _Q:
    rest = jnp.zeros_like(now.state.angular_velocity)
    rates = now.state.rates(now.contact, rest, jnp.zeros_like(now.state.alpha_dot))
    return pack(_places(rates))


def _spin(t: _Time, q: _Q, u: _U, now: _Instant) -> _Vector:
    return u[:3]


def _of_contact(t: _Time, q: _Q, u: _U, now: _Instant) -> _Vector:
    return now.at_contact


def _of_body(t: _Time, q: _Q, u: _U, now: _Instant) -> _Vector:
    return _of_point(u, now, now.scene.body.center_of_mass)


def _of_point(
    u: _U, now: _Instant, place: _Vector, velocity: _Vector | None = None
) -> _Vector:
    """Velocity of a point of the body, or one that moves in it, fixed axes."""
    v = cross(u[:3], place - now.contact.body_point)
    v = v if velocity is None else v + velocity
    return now.at_contact + now.contact.rotation @ v


def _mass(scene: Scene) -> Array:
    return scene.body.mass


def _inertia(scene: Scene) -> Float[Array, "3 3"]:
    return scene.body.inertia


def _carried_parts(k: int, carried: Carried, like: State) -> list[Particle | RigidBody]:
    """The masses of the k-th supported part."""
    count = carried.mass.shape[0]
    masses = [_CarriedMass(like, k, i) for i in range(count)]
    if not carried.turnings:
        return [Particle(mass, _OfCarried(k, i)) for i, mass in enumerate(masses)]
    inertia = _CarriedInertia(like, k)
    return [RigidBody(masses[0], inertia, _OfCarried(k, 0), _CarriedSpin(k))]


class _OfPart(eqx.Module):
    """What of the k-th part is the same in every state."""

    like: State
    k: int = eqx.field(static=True)

    def of(self, scene: Scene) -> Carried:
        """That part, in some state."""
        return _carried(scene, jnp.zeros((), self.like.alpha.dtype), self.like)[self.k]


class _CarriedMass(_OfPart):
    """Its i-th mass."""

    i: int = eqx.field(static=True)

    def __call__(self, scene: Scene) -> Array:
        return self.of(scene).mass[self.i]


class _CarriedInertia(_OfPart):
    """On its own axes."""

    def __call__(self, scene: Scene) -> Float[Array, "3 3"]:
        (turning,) = self.of(scene).turnings
        return turning.rotation.T @ turning.inertia @ turning.rotation


class _OfCarried(eqx.Module):
    """Velocity of the i-th mass of the k-th part."""

    k: int = eqx.field(static=True)
    i: int = eqx.field(static=True)

    def __call__(self, t: _Time, q: _Q, u: _U, now: _Instant) -> _Vector:
        carried = now.carried[self.k]
        return _of_point(u, now, carried.place[:, self.i], carried.velocity[:, self.i])


class _CarriedSpin(eqx.Module):
    """Angular velocity of the k-th part, on its own axes."""

    k: int = eqx.field(static=True)

    def __call__(self, t: _Time, q: _Q, u: _U, now: _Instant) -> _Vector:
        (turning,) = now.carried[self.k].turnings
        return turning.rotation.T @ (u[:3] + turning.velocity)


def _loads(scene: Scene, parts: list[Any]) -> list[Load]:
    """Fields on every part, wrenches on the body at the contact point."""
    found: list[Load] = []
    if field_of(scene.loads) is not None:
        found += [Load(part.velocity, _Weight(part.mass)) for part in parts]
    for k, load in enumerate(scene.loads):
        if type(load).wrench is not AbstractLoad.wrench:
            found += [Load(_of_contact, _Force(k)), Load(_spin, _Moment(k))]
    return found


class _Weight(eqx.Module):
    """Of a mass, fixed axes."""

    mass: Callable[[Scene], Array]

    def __call__(self, t: _Time, q: _Q, u: _U, now: _Instant) -> _Vector:
        field: Any = field_of(now.scene.loads)
        return self.mass(now.scene) * field


class _Force(eqx.Module):
    """Of the k-th load on the body, fixed axes."""

    k: int = eqx.field(static=True)

    def __call__(self, t: _Time, q: _Q, u: _U, now: _Instant) -> _Vector:
        return now.contact.rotation @ _wrench(t, now, self.k)[0]


class _Moment(eqx.Module):
    """Of the k-th load about the contact point, body axes."""

    k: int = eqx.field(static=True)

    def __call__(self, t: _Time, q: _Q, u: _U, now: _Instant) -> _Vector:
        return _wrench(t, now, self.k)[1]


def _wrench(t: _Time, now: _Instant, k: int) -> tuple[_Vector, _Vector]:
    # _loads asks for those that have one
    wrench = now.scene.loads[k].wrench(t, now.scene.body, now.contact)
    return cast("tuple[_Vector, _Vector]", wrench)


def _springs(t: _Time, q: _Q, u: _U, now: _Instant) -> _U:
    """``Q_s`` of the coordinates; nothing for the body and the reactions."""
    scene, state = now.scene, now.state
    forces = [jnp.zeros(3, q.dtype)]
    for part, alpha, rates in scene.shares(state):
        own = part.applied(t, alpha, rates)
        forces.append(jnp.zeros_like(alpha) if own is None else jnp.stack(own))
    others = u.shape[0] - 3 - state.alpha.shape[0]
    return jnp.concatenate([*forces, jnp.zeros(others, q.dtype)])
