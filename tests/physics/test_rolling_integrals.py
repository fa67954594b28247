"""What bodies that roll on one another keep: momenta, energy, their contacts."""

import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk
from rollkane import kane
from rollkane.geometry.rotations import rotation_matrix

from ..outputs_alone import FIRST
from ..pairs_by_kane import Place
from ..quick import slow_but

G = np.array([0.0, 0.0, -9.81])
UP = np.array([0.0, 0.0, 1.0])
LEVEL = (1.0, 0.0, 0.0, 0.0)


def turned(quaternions):
    """Rotation matrices, shape (T, 3, 3)."""
    along = jnp.moveaxis(jnp.asarray(quaternions), -1, 0)
    return np.moveaxis(np.asarray(rotation_matrix(along)), -1, 0)


def derivative(values, step):
    """First derivative in the middle of nine samples."""
    return np.tensordot(FIRST / step, np.asarray(values), axes=1)


def momenta(mass, inertia, r, v, R, w):
    """Momentum, and angular momentum about the fixed origin, at each time."""
    spin = np.einsum("tij,jk,tlk,tl->ti", R, inertia, R, w)
    return mass * v, mass * np.cross(r, v) + spin


def of_free(run, k):
    """Centre, velocity, rotation and angular velocity of a free body."""
    q, u = (np.asarray(x) for x in (run.q, run.u))
    at = q[:, 7 * k : 7 * k + 7]
    moves = u[:, 6 * k : 6 * k + 3], u[:, 6 * k + 3 : 6 * k + 6]
    return at[:, :3], moves[0], turned(at[:, 3:]), moves[1]


@pytest.mark.slow
def test_a_ball_in_a_free_sphere():
    """Nothing holds them: momentum by gravity alone, the angular one by nothing."""
    masses = 1.0, 0.7
    inertias = 0.05 * np.diag([1.0, 0.9, 1.1]), 2.8e-3 * np.eye(3)
    bodies = kane.free_bodies(masses, inertias, G)
    outer, ball = bodies.frames
    # the shell's mass centre lies beside the middle of its cavity
    hollow = kane.Frame(Place(outer, np.array([0.02, -0.03, 0.01])), outer.rotation)
    cavity = rk.Sphere(0.28, inside=True)
    contact = kane.RollingContact(ball, rk.Sphere(0.1), hollow, cavity)
    q = [0.1, 0.2, 0.3, *LEVEL, 0.15, 0.1, 0.2, *LEVEL]
    u = [0.3, -0.5, 2.0, 0.4, 1.0, -0.3, -0.5, 0.5, 1.5, 3.0, -2.0, 1.0]
    rolling = kane.rolling_contacts(bodies.system, [contact], q, u)
    times = np.linspace(0.0, 3.0, 31)
    run = kane.simulate(rolling.system, rolling.start, times, rtol=1e-12)
    assert run.succeeded, run.reason
    seen = [of_free(run, k) for k in range(2)]
    parts = [momenta(masses[k], inertias[k], *seen[k]) for k in range(2)]
    P, L = (sum(part[k] for part in parts) for k in range(2))
    middle = sum(m * motion[0] for m, motion in zip(masses, seen, strict=True))
    middle = middle / sum(masses)
    # sums of the steps' errors, some hundred of 1e-12 of momenta below 30 N s
    fallen = P[0] + sum(masses) * times[:, None] * G
    np.testing.assert_allclose(P, fallen, rtol=0, atol=1e-10)
    about = L - np.cross(middle, P)
    np.testing.assert_allclose(about, about[:1] + 0.0 * about, rtol=0, atol=1e-10)
    # it is a sum of parts that change: of the ball alone by more than what it is
    assert np.ptp(parts[1][1][:, 0]) > np.abs(about).max()
    energy = np.asarray(run.kinetic_energy) - sum(masses) * middle @ G
    np.testing.assert_allclose(energy, energy[0], rtol=0, atol=1e-10)
    # and the force between them is not small
    force = rolling.forces(run.time, run.state).force
    assert np.abs(force).max() > 1.0


MASSES, RADII, SHARES = (1.0, 0.7, 0.5), (0.3, 0.2, 0.15), (0.4, 0.5, 0.3)
MOMENTS = tuple(k * m * r * r for k, m, r in zip(SHARES, MASSES, RADII, strict=True))
STEP = 1e-3  # s, of nine-point stencils
BEFORE = 0.1 * np.arange(6)
TIMES = np.concatenate([BEFORE, 0.6 + STEP * np.arange(-4, 5)])


def nested_stack():
    """A ball on a ball on a ball on the ground, each a little beside the last."""
    bodies = [
        rk.Body(m, moment * np.eye(3), rk.Sphere(r))
        for m, moment, r in zip(MASSES, MOMENTS, RADII, strict=True)
    ]
    top = rk.RollingBody(bodies[2], rk.Sphere(RADII[1]))
    second = rk.RollingBody(bodies[1], rk.Sphere(RADII[0]), top)
    scene = rk.Scene(bodies[0], supported=second)
    ways = np.array([[0.1, -0.05, 1.0], [-0.08, 0.1, 1.0]])
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    third = top.place(LEVEL, (1.0, 2.0, -3.0), RADII[1] * ways[1])
    own = second.place(LEVEL, (0.5, -1.0, 4.0), RADII[0] * ways[0], supported=third)
    w = (0.4, -0.6, 5.0)
    return scene, rk.place(scene, LEVEL, w, (0.0, 0.0, 0.0), supported=own)


def stack_by_nest():
    """Motions of the three balls, forces in the middle, and the energy."""
    scene, start = nested_stack()
    run = rk.simulate(scene, start, TIMES, rtol=1e-13)
    assert run.code == rk.Code.COMPLETED
    inner = run.rolling_body(0), run.rolling_body(0, 0)
    motions = [
        (x.position, x.velocity, turned(x.orientation), x.angular_velocity)
        for x in (run, *inner)
    ]
    forces = [x.contact_force[-5] for x in (run, *inner)]
    energy = run.energy
    return [[np.asarray(x) for x in motion] for motion in motions], forces, energy


def stack_by_contacts():
    """The same of three free bodies, from where the nest starts."""
    scene, start = nested_stack()
    first = rk.simulate(scene, start, [0.0, 1e-9])
    seen = first, first.rolling_body(0), first.rolling_body(0, 0)
    names = "position", "orientation", "velocity", "angular_velocity"
    now = [[np.asarray(getattr(x, name))[0] for name in names] for x in seen]
    q = np.concatenate([y for x in now for y in x[:2]])
    u = np.concatenate([y for x in now for y in x[2:]])
    bodies = kane.free_bodies(MASSES, [k * np.eye(3) for k in MOMENTS], G)
    below = [(kane.ground, rk.Plane())]
    below += [(bodies.frames[k], rk.Sphere(RADII[k])) for k in range(2)]
    contacts = [
        kane.RollingContact(bodies.frames[k], rk.Sphere(RADII[k]), *below[k])
        for k in range(3)
    ]
    rolling = kane.rolling_contacts(bodies.system, contacts, q, u)
    run = kane.simulate(rolling.system, rolling.start, TIMES, rtol=1e-13)
    assert run.succeeded, run.reason
    motions = [of_free(run, k) for k in range(3)]
    forces = np.asarray(rolling.forces(run.time, run.state).force)[-5]
    high = sum(m * motion[0] for m, motion in zip(MASSES, motions, strict=True))
    return motions, forces, np.asarray(run.kinetic_energy) - high @ G


WAYS = {"nest": stack_by_nest, "contacts": stack_by_contacts}


@pytest.mark.parametrize("way", slow_but([], WAYS))
def test_three_balls_on_one_another(way):
    """Energy, three linear integrals, and both equations of each ball.

    With n_k up from ball k - 1 to ball k and F_k the force on ball k there, of a ball
    I_k w_k' / r_k = -n_k x F_k - n_(k+1) x F_(k+1), so that of
    B = sum (-1)^k I_k w_k / r_k all but the ground's force is gone: B' = -z x F_1. Its
    vertical part is kept, and as P' is F_1 and the weights, so is P - z x B along the
    ground.
    """
    motions, forces, energy = WAYS[way]()
    balls = range(3)
    signs = [(-1) ** k * MOMENTS[k] / RADII[k] for k in balls]
    B = sum(signs[k] * motions[k][3] for k in balls)
    P = sum(MASSES[k] * motions[k][1] for k in balls)
    along = (P - np.cross(UP, B))[:, :2]
    # sums of the steps' errors, some hundred of 1e-13 of momenta below 10 N s, energies
    # below 20 J
    for kept in (B[:, 2], along, energy):
        np.testing.assert_allclose(kept, kept[:1] + 0.0 * kept, rtol=0, atol=1e-10)
    for moved in (B[:, 0], P[:, 0], motions[2][3][:, 2]):  # what is not
        assert np.ptp(moved) > 1e-2
    now = [[x[-5] for x in motion] for motion in motions]
    size = max(np.linalg.norm(force) for force in forces)
    for k in balls:
        center, v, _, w = (x[-9:] for x in motions[k])
        spin = MOMENTS[k] * w
        up = now[k][0] - now[k - 1][0] if k else UP
        foot = -RADII[k] * up / np.linalg.norm(up)
        force, moment = forces[k] + MASSES[k] * G, np.cross(foot, forces[k])
        if k < 2:
            up = now[k + 1][0] - now[k][0]
            head = RADII[k] * up / np.linalg.norm(up)
            force = force - forces[k + 1]
            moment = moment - np.cross(head, forces[k + 1])
        # the integrator's 1e-13 of velocities of 1 m/s over a step of the stencil:
        # 1e-10 of a force, and (20 * 1e-3)^8 * 20^2 / 630 = 2e-14
        newton = MASSES[k] * derivative(v, STEP) - force
        euler = derivative(spin, STEP) - moment
        assert np.abs(newton).max() < 1e-9 * size
        assert np.abs(euler).max() < 1e-9 * size * RADII[k]
        assert np.abs(derivative(center, STEP) - v[4]).max() < 1e-9


BOWL, SHELL, CAVITY, AXES = 1.0, 0.3, 0.28, np.array([0.1, 0.105, 0.11])
FINE = 1.5e-3  # s, of stencils after long times


def rocking_nest():
    """An ellipsoid in a shell in a bowl."""
    second = 0.2 * 0.7 * AXES**2
    inertia = np.diag(second.sum() - second)
    part = rk.RollingBody(
        rk.Body(0.7, inertia, rk.Ellipsoid(AXES)), rk.Sphere(CAVITY, inside=True)
    )
    shell = rk.Body(1.0, 0.045 * np.diag([1.0, 0.9, 1.1]), rk.Sphere(SHELL))
    scene = rk.Scene(shell, rk.Base(rk.Sphere(BOWL, inside=True)), part)
    ways = np.array([[0.2, 0.1, -1.0], [-0.1, 0.2, -1.0]])
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    own = part.place(LEVEL, (0.3, -0.2, 0.4), CAVITY * ways[1])
    return scene, rk.place(scene, LEVEL, (0.2, 0.1, 0.3), BOWL * ways[0], supported=own)


def farthest(to_center):
    """The ellipsoid's point farthest from a place, by its normal: both own axes.

    Shrinks errors by the ellipsoid's radius over the cavity's, 0.4, each time.
    """
    n = to_center / np.linalg.norm(to_center)
    for _ in range(60):
        point = AXES**2 * n / np.linalg.norm(AXES * n)
        out = to_center + point
        n = out / np.linalg.norm(out)
    return point, np.linalg.norm(out)


def rates_of(center, R):
    """Velocity and angular velocity, of nine poses."""
    turning = derivative(R, FINE) @ R[4].T
    w = [turning[2, 1] - turning[1, 2], turning[0, 2] - turning[2, 0]]
    w.append(turning[1, 0] - turning[0, 1])
    return derivative(center, FINE), 0.5 * np.array(w)


def test_contacts_hold_for_a_thousand_seconds():
    """Of poses alone: where surfaces are nearest, how far apart, and what moves there.

    Velocities are differences of the poses, so that nothing is taken from a contact.
    """
    scene, start = rocking_nest()
    ends = np.linspace(100.0, 1000.0, 10)
    times = [np.zeros(1), *(end + FINE * np.arange(-8, 1) for end in ends)]
    run = rk.simulate(scene, start, np.concatenate(times), rtol=1e-12)
    assert run.code == rk.Code.COMPLETED
    poses = []
    for x in (run, run.rolling_body(0)):
        center, R = np.asarray(x.position)[1:], turned(x.orientation)[1:]
        poses.append((center.reshape(-1, 9, 3), R.reshape(-1, 9, 3, 3)))
    for c1, R1, c2, R2 in zip(*poses[0], *poses[1], strict=True):
        v1, w1 = rates_of(c1, R1)
        v2, w2 = rates_of(c2, R2)
        c1, c2, R2 = c1[4], c2[4], R2[4]
        far = np.linalg.norm(c1)
        foot = SHELL * c1 / far
        point, out = farthest(R2.T @ (c2 - c1))
        point = R2 @ point
        # roundings of places of 1 m
        assert abs(far - (BOWL - SHELL)) < 1e-14
        assert abs(out - CAVITY) < 1e-14
        # roundings of places of 1 m over a stencil of 1.5e-3 s, 3e-13, and of rates of
        # 15 rad/s (15 * 1.5e-3)^8 * 15 / 630 = 2e-15 of 0.1 m
        at_contact = v1 + np.cross(w1, c2 + point - c1)
        slips = v1 + np.cross(w1, foot), v2 + np.cross(w2, point) - at_contact
        assert np.abs(slips).max() < 1e-12
    energy = np.asarray(run.energy)
    # 1e5 steps of 1e-12, whose errors add up as their square root if they are random
    assert np.ptp(energy) < 1e-10 * abs(energy[0])
    assert np.ptp(poses[1][0], axis=(0, 1))[:2].min() > 0.1  # it moves
