"""The scenes of ``random_pairs`` by Kane's method, with contacts between free bodies.

A third way to the same motions: every body has its mass centre and a quaternion as
coordinates, every particle its place; nothing knows who carries whom, or that bodies
roll inside of others, but for the contacts.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from rollkane import kane
from rollkane.geometry.rotations import quaternion_of, rotation_matrix
from rollkane.geometry.small_linear import cross


class OfBodies(eqx.Module):
    """A function of the bodies' system, whose coordinates come first."""

    function: object
    bodies: int = eqx.field(static=True)

    def __call__(self, t, q, u):
        return self.function(t, q[: 7 * self.bodies], u[: 6 * self.bodies], None)


class WithParticles(eqx.Module):
    """Rates of all coordinates: a particle's are its velocity."""

    own: OfBodies

    def __call__(self, t, q, u):
        return jnp.concatenate([self.own(t, q, u), u[6 * self.own.bodies :]])


class Stretch(eqx.Module):
    """A spring from the origin of a body: how its ends part, and what it pulls."""

    body: int = eqx.field(static=True)
    at: tuple[int, int] = eqx.field(static=True)  # of the particle, in q and in u
    center: np.ndarray
    stiffness: float

    def velocity(self, t, q, u):
        k, at = self.body, self.at[1]
        turn = rotation_matrix(q[7 * k + 3 : 7 * k + 7])
        w = u[6 * k + 3 : 6 * k + 6]
        return u[at : at + 3] - u[6 * k : 6 * k + 3] + cross(w, turn @ self.center)

    def pull(self, t, q, u):
        k, at = self.body, self.at[0]
        turn = rotation_matrix(q[7 * k + 3 : 7 * k + 7])
        origin = q[7 * k : 7 * k + 3] - turn @ self.center
        return -self.stiffness * (q[at : at + 3] - origin)


class Part(eqx.Module):
    """Some speeds, or a force that does not change."""

    at: int = eqx.field(static=True)

    def __call__(self, t, q, u):
        return u[self.at : self.at + 3]


class Steady(eqx.Module):
    force: np.ndarray

    def __call__(self, t, q, u):
        return jnp.asarray(self.force)


class Place(eqx.Module):
    """Of a point of a body, from its mass centre; by the body's own axes."""

    frame: kane.Frame
    arm: np.ndarray

    def __call__(self, t, q, u):
        turn = self.frame.rotation(t, q, u)
        return self.frame.position(t, q, u) + turn @ self.arm


class Turn(eqx.Module):
    """Of axes fixed in a body."""

    frame: kane.Frame
    turn: np.ndarray

    def __call__(self, t, q, u):
        return self.frame.rotation(t, q, u) @ self.turn


class BasePlace(eqx.Module):
    motion: object

    def __call__(self, t, q, u):
        place = self.motion.at(t).position
        return jnp.zeros(3) if place is None else place


class BaseTurn(eqx.Module):
    motion: object

    def __call__(self, t, q, u):
        return self.motion.at(t).rotation


def system_of(pairs):
    """Bodies and particles that nothing holds: the system, and the bodies' frames."""
    gravity = pairs.model.gravity
    numbers = [(b.mass, b.inertia) for b in pairs.bodies]
    bodies = kane.free_bodies(*zip(*numbers, strict=True), gravity)
    if not pairs.hung:
        return bodies.system, bodies.frames
    n, h = len(pairs.bodies), len(pairs.hung)
    of = lambda function: OfBodies(function, n)
    parts = [
        kane.RigidBody(p.mass, p.inertia, of(p.velocity), of(p.angular_velocity))
        for p in bodies.system.parts
    ]
    loads = [kane.Load(of(x.velocity), of(x.load)) for x in bodies.system.loads]
    for k, hung in enumerate(pairs.hung):
        at = 7 * n + 3 * k, 6 * n + 3 * k
        parts.append(kane.Particle(hung.mass, Part(at[1])))
        loads.append(kane.Load(Part(at[1]), Steady(hung.mass * gravity)))
        center = pairs.bodies[hung.body].center
        spring = Stretch(hung.body, at, center, hung.stiffness)
        loads.append(kane.Load(spring.velocity, spring.pull))
    kinematics = WithParticles(of(bodies.system.kinematics))
    system = kane.KaneSystem(7 * n + 3 * h, 6 * n + 3 * h, kinematics, parts, loads)
    return system, bodies.frames


def contacts_of(pairs, frames, places):
    """Contacts by the surfaces of the scene.

    Args:
        pairs: Of ``random_pairs``.
        frames: Of the bodies.
        places: Of the contacts at the start [m], fixed axes.
    """
    base = kane.ground
    if pairs.scene.base.motion is not None:
        motion = pairs.scene.base.motion
        base = kane.Frame(BasePlace(motion), BaseTurn(motion))
    contacts = []
    listed = zip(pairs.touches, pairs.surfaces, places, strict=True)
    for touch, (own, on), near in listed:
        k, c = touch.body, touch.carrier
        on_body = frames[k]
        a = kane.Frame(Place(on_body, -pairs.bodies[k].center), on_body.rotation)
        b = base
        if c >= 0:
            arm = touch.base.place - pairs.bodies[c].center
            b = kane.Frame(Place(frames[c], arm), Turn(frames[c], touch.base.turn))
        name = f"{k} on {c}"
        contacts.append(kane.RollingContact(a, own, b, on, touch.rubber, near, name))
    return contacts


def by_kane(pairs, result):
    """The system of a scene, started where a run of the scene starts.

    Args:
        pairs: Of ``random_pairs``.
        result: The run.
    """
    y = pairs.model.split(pairs.twin_start(result))
    r, R, v, w, _, on_body, x, vx = y
    turns = [np.asarray(quaternion_of(jnp.asarray(turn))) for turn in R]
    q = np.concatenate([*(np.append(a, b) for a, b in zip(r, turns, strict=True)), *x])
    u = np.concatenate([*(np.append(a, b) for a, b in zip(v, w, strict=True)), *vx])
    near = [
        r[t.body] + R[t.body] @ (on_body[k] - pairs.bodies[t.body].center)
        for k, t in enumerate(pairs.touches)
    ]
    system, frames = system_of(pairs)
    rolling = kane.rolling_contacts(system, contacts_of(pairs, frames, near), q, u)
    # what it was given closes already, to rounding: twice what a result's sums leave
    moved = np.abs(rolling.start.q[: q.size] - q).max()
    quicker = np.abs(rolling.start.u - u).max()
    assert moved < 1e-13, moved
    assert quicker < 1e-12, quicker
    return rolling


def origins(pairs, run):
    """Of every body [m], fixed axes, shape (bodies, T, 3)."""
    found = []
    for k, body in enumerate(pairs.bodies):
        at = run.q[:, 7 * k : 7 * k + 7]
        turn = np.asarray(rotation_matrix(at[:, 3:].T))  # (3, 3, T)
        found.append(at[:, :3] - np.einsum("ijt,j->ti", turn, body.center))
    return np.array(found)
