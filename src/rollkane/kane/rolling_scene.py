"""A rolling scene as a system of Kane's: the twin that checks the rolling core.

Nothing of the core's dynamics is used, only where things are (the contact) and how they
are carried: velocities of mass centres are written down, Kane's method does the rest.
"""

import dataclasses
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array

from ..coordinates import State, pack, unpack
from ..loads import AbstractLoad
from ..rolling import contact_of, field_of, generalized_force, shares
from ..scene import Scene
from ..small_linear import cross
from ..supported import Prescribed
from .system import KaneState, KaneSystem, Load, Particle, RigidBody


def rolling_system(scene: Scene, like: State, reactions: bool = False) -> KaneSystem:
    """A scene in pole-free coordinates, written down for Kane's method.

    q: orientation, contact coordinates and alpha of a ``State``; u: angular velocity
    [rad/s], BODY axes, then alpha' (``kane_state``).

    Args:
        scene: What rolls on what, carrying what.
        like: A state of the scene, for the sizes of its coordinates.
        reactions: Whether the contact point gets three auxiliary velocities along the
            FIXED axes, whose reactions are the contact force [N].

    Source: theory, sections 4 and 8a.
    """
    view = _View(scene, _places(like), scene.coordinate_count, reactions)
    parts: list[Any] = [
        RigidBody(scene.body.mass, scene.body.inertia, view.of_body, view.spin)
    ]
    for k in range(len(scene.supported)):
        parts += view.carried_parts(k)
    springs = view.springs if scene.coordinate_count else None
    return KaneSystem(
        pack(view.places).shape[0],
        3 + view.n,
        view.kinematics,
        parts,
        view.loads(parts),
        auxiliary=3 * reactions,
        generalized_forces=springs,
    )


def kane_state(state: State) -> KaneState:
    """A state of a rolling body as one of its Kane system."""
    u = jnp.concatenate([state.angular_velocity, state.alpha_dot])
    return KaneState(pack(_places(state)), u)


def _places(state: State) -> State:
    """A state without its speeds."""
    none = jnp.zeros(0, state.angular_velocity.dtype)
    return dataclasses.replace(state, angular_velocity=none, alpha_dot=none)


class _View:
    """A scene's velocities as functions of (t, q, u)."""

    def __init__(self, scene: Scene, places: State, n: int, reactions: bool):
        self.scene, self.places, self.n, self.reactions = scene, places, n, reactions

    def state(self, q, u) -> State:
        spins, rates = u[:3], u[3 : 3 + self.n]
        places = unpack(q, self.places)
        return dataclasses.replace(places, angular_velocity=spins, alpha_dot=rates)

    def contact(self, t, q, u):
        return contact_of(self.scene, t, self.state(q, u))

    def kinematics(self, t, q, u):
        state = self.state(q, u)
        spins, rates = jnp.zeros(3, q.dtype), jnp.zeros(self.n, q.dtype)
        return pack(_places(state.rates(self.contact(t, q, u), spins, rates)))

    def spin(self, t, q, u):
        return u[:3]

    def at_contact(self, t, q, u):
        """Velocity of the material points at the contact [m/s], fixed axes."""
        contact = self.contact(t, q, u)
        v = jnp.zeros(3, q.dtype)
        if contact.base_velocity is not None:
            v = contact.rotation @ contact.base_velocity
        return v + u[3 + self.n :] if self.reactions else v

    def of_point(self, t, q, u, place, velocity=None):
        """Velocity of a point of the body, or one that moves in it, fixed axes."""
        contact = self.contact(t, q, u)
        v = cross(u[:3], place - contact.body_point)
        v = v if velocity is None else v + velocity
        return self.at_contact(t, q, u) + contact.rotation @ v

    def of_body(self, t, q, u):
        return self.of_point(t, q, u, self.scene.body.center_of_mass)

    def carried(self, k: int, t, q, u):
        state = self.state(q, u)
        listed = shares(self.scene.supported, state.alpha, state.alpha_dot)
        part, alpha, rates = list(listed)[k]
        return part.carried(t, alpha, rates)

    def carried_parts(self, k: int) -> list[Particle | RigidBody]:
        """The masses of one supported part."""
        supported = self.scene.supported[k]
        own: Any = (
            supported.supported if isinstance(supported, Prescribed) else supported
        )
        q = pack(self.places)
        rest = jnp.zeros(3 + self.n + 3 * self.reactions, q.dtype)
        now = self.carried(k, jnp.zeros((), q.dtype), q, rest)

        def velocity_of(i):
            def velocity(t, q, u):
                part = self.carried(k, t, q, u)
                return self.of_point(t, q, u, part.place[:, i], part.velocity[:, i])

            return velocity

        def turning(t, q, u):
            part = self.carried(k, t, q, u).turning
            assert part is not None
            return part.rotation.T @ (u[:3] + part.velocity)

        if now.turning is not None:
            return [RigidBody(now.mass[0], own.inertia, velocity_of(0), turning)]
        return [Particle(now.mass[i], velocity_of(i)) for i in range(now.mass.shape[0])]

    def loads(self, parts) -> list[Load]:
        """Fields on every part, wrenches on the body at the contact point."""
        found = []
        field = field_of(self.scene.loads)
        if field is not None:
            found += [Load(p.velocity, _constant(p.mass * field)) for p in parts]
        for load in self.scene.loads:
            if type(load).wrench is not AbstractLoad.wrench:
                found += [
                    Load(self.at_contact, self._wrench(load, 0)),
                    Load(self.spin, self._wrench(load, 1)),
                ]
        return found

    def _wrench(self, load, which: int):
        """Force on fixed axes, or moment about the contact point on body axes."""

        def value(t, q, u):
            contact = self.contact(t, q, u)
            wrench = load.wrench(t, self.scene.body, contact)[which]
            return wrench if which else contact.rotation @ wrench

        return value

    def springs(self, t, q, u) -> Array:
        """``Q_s`` of the coordinates; nothing for the body and the reactions."""
        state = self.state(q, u)
        forces = [jnp.zeros(3, q.dtype)]
        listed = shares(self.scene.supported, state.alpha, state.alpha_dot)
        for part, alpha, rates in listed:
            own = generalized_force(part, t, alpha, rates)
            still = jnp.zeros(part.count, q.dtype)
            forces.append(still if own is None else jnp.stack(own))
        return jnp.concatenate([*forces, jnp.zeros(3 * self.reactions, q.dtype)])


def _constant(vector):
    return lambda t, q, u: vector
