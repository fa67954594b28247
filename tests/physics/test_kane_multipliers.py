"""Constraints that act by multipliers: reactions and forces by Newton and by KKT."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk
from rollkane import kane
from rollkane.geometry.rotations import quaternion_rates, rotation_matrix

G = 9.81
# a hundred roundings of some hundred operations on terms of order one to thirty
EXACT = 1e-11


@pytest.mark.parametrize("dependent", [(1,), None])
def test_a_rod_holds_a_pendulum(dependent):
    """In Cartesian coordinates: the rod's pull T = m (g cos a + L w^2), of which x."""
    m, L, a, w = 2.0, 0.8, 0.5, 1.5
    velocity = lambda t, q, u: [u[0] + u[2], 0.0, u[1]]
    system = kane.KaneSystem(
        2,
        2,
        lambda t, q, u: u[:2],
        [kane.Particle(m, velocity)],
        [kane.Load(velocity, lambda t, q, u: [0.0, 0.0, -m * G])],
        constraints=lambda t, q, u: [q[0] * u[0] + q[1] * u[1]],
        dependent=dependent,
        auxiliary=1,
    )
    q, u = (
        L * np.array([np.sin(a), -np.cos(a)]),
        w * L * np.array([np.cos(a), np.sin(a)]),
    )
    speeds = jnp.asarray(u if dependent is None else u[:1])
    found = kane.reactions(system, 0.0, kane.KaneState(jnp.asarray(q), speeds))
    pull = m * (G * np.cos(a) + L * w * w)
    np.testing.assert_allclose(found, [-pull * np.sin(a)], rtol=0, atol=EXACT)


class Particles(NamedTuple):
    """Particles with constraints, as functions of (t, q, u), auxiliary speeds last.

    ``slopes`` of the constraints by the speeds, ``named`` by the auxiliary ones.
    """

    mass: Any
    velocities: Any
    forces: Any
    q_dot: Any
    constraints: Any
    slopes: Any
    named: Any


def random_particles(seed, given):
    """Three, whose places are functions of time and four coordinates.

    Two constraints and two auxiliary speeds, which move the particles; ``given`` times
    as much of them stands in the constraints.
    """
    rng = np.random.default_rng(seed)
    mass = rng.uniform(0.5, 2.0, 3)
    A, B = rng.standard_normal((3, 3, 4)), 0.4 * rng.standard_normal((3, 3, 4))
    lifts, C0 = rng.standard_normal((3, 3, 2)), rng.standard_normal((2, 4))
    named = given * rng.standard_normal((2, 2))
    mixed = np.eye(4) + 0.2 * rng.standard_normal((4, 4))

    def q_dot(t, q, u):
        return mixed @ u[:4] + 0.2 * jnp.sin(q) * u[0]

    def velocity(t, q, u, k):
        place = lambda t, q: A[k] @ q + jnp.sin(B[k] @ q + t)
        _, v = jax.jvp(place, (t, q), (jnp.ones_like(t), q_dot(t, q, u)))
        return v + lifts[k] @ u[4:]

    def force(t, q, u, k):
        return mass[k] * jnp.stack([q[0] + jnp.sin(t), 0.3 * u[1], -G + 0.0 * t])

    def slopes(t, q):
        return C0 + 0.3 * jnp.sin(q[0] + t) * C0[:, ::-1]

    def constraints(t, q, u):
        return slopes(t, q) @ u[:4] + 0.4 * jnp.cos(q[:2] + 2.0 * t) + named @ u[4:]

    each = lambda of: [lambda t, q, u, k=k: of(t, q, u, k) for k in range(3)]
    functions = q_dot, constraints, slopes
    return Particles(mass, each(velocity), each(force), *functions, named)


def by_kkt(given, t, q, u):
    """Rates of the speeds, and both reactions, by Newton's law of each particle."""
    whole = jnp.concatenate([u, jnp.zeros(2)])

    def along(function, u_dot):
        rates = given.q_dot(t, q, whole), jnp.concatenate([u_dot, jnp.zeros(2)])
        return jax.jvp(function, (t, q, whole), (jnp.ones_like(t), *rates))[1]

    def lacking(u_dot):
        """Of each speed's power, what the loads do not give."""
        total = jnp.zeros(6)
        for m, v, force in zip(given.mass, given.velocities, given.forces, strict=True):
            J = jax.jacfwd(v, argnums=2)(t, q, whole)
            total += J.T @ (m * along(v, u_dot) - force(t, q, whole))
        return total

    at_rest, C = lacking(jnp.zeros(4)), given.slopes(t, q)
    M = jax.jacfwd(lacking)(jnp.zeros(4))[:4]
    drift = along(given.constraints, jnp.zeros(4))
    matrix = jnp.block([[M, -C.T], [C, jnp.zeros((2, 2))]])
    found = jnp.linalg.solve(matrix, -jnp.concatenate([at_rest[:4], drift]))
    return found[:4], lacking(found[:4])[4:] - given.named.T @ found[4:]


@pytest.mark.parametrize(("seed", "given"), [(0, 0.0), (1, 1.0), (2, 1.0)])
def test_random_systems_by_kkt(seed, given):
    """Constraints that name the auxiliary speeds, and that do not."""
    made = random_particles(seed, given)
    loads = [
        kane.Load(v, force)
        for v, force in zip(made.velocities, made.forces, strict=True)
    ]
    parts = [
        kane.Particle(m, v) for m, v in zip(made.mass, made.velocities, strict=True)
    ]
    system = kane.KaneSystem(
        *(4, 4, made.q_dot, parts, loads),
        constraints=made.constraints,
        dependent=None,
        auxiliary=2,
    )
    q, u = 0.6 * np.random.default_rng(seed + 10).standard_normal((2, 4))

    @jax.jit
    def both(t, q, u):
        open_ = made.constraints(t, q, jnp.concatenate([u, jnp.zeros(2)]))
        u = u - jnp.linalg.pinv(made.slopes(t, q)) @ open_
        state = kane.KaneState(q, u)
        rates = kane.kane_derivative(system, t, state)
        found = rates.u, kane.reactions(system, t, state)
        return found, by_kkt(made, t, q, u)

    found, expected = both(jnp.asarray(0.37), jnp.asarray(q), jnp.asarray(u))
    for one, other in zip(found, expected, strict=True):
        # the condition of the matrices, below 1e3, times roundings
        scale = np.abs(other).max()
        np.testing.assert_allclose(one, other, rtol=0, atol=EXACT * (1.0 + scale))
    assert np.abs(expected[1]).min() > 0.1


def ball_centre(t, q, u):
    return u[:3] + jnp.array([1.0, 0.0, 0.0]) * u[6]


def ball_spin(t, q, u):
    return rotation_matrix(q[3:7]).T @ u[3:6]


BALL = kane.Frame(lambda t, q, u: q[:3], lambda t, q, u: rotation_matrix(q[3:7]))


def rolling_ball(mass, radius, acceleration):
    """A ball on a plane under a tilted gravity; its centre has an auxiliary speed."""
    inertia = 0.4 * mass * radius**2 * np.eye(3)
    system = kane.KaneSystem(
        7,
        6,
        lambda t, q, u: jnp.concatenate(
            [u[:3], quaternion_rates(q[3:7], ball_spin(t, q, u))]
        ),
        [kane.RigidBody(mass, inertia, ball_centre, ball_spin)],
        [kane.Load(ball_centre, lambda t, q, u: mass * jnp.asarray(acceleration))],
        auxiliary=1,
    )
    touching = kane.RollingContact(BALL, rk.Sphere(radius), kane.ground, rk.Plane())
    q = [0.0, 0.0, radius, 1.0, 0.0, 0.0, 0.0]
    return kane.rolling_contacts(system, [touching], q, np.zeros(6))


@pytest.mark.slow
def test_friction_of_a_rolling_ball_is_the_reaction_of_its_centre():
    """2/7 m g_x against the way, by multipliers and by dependent speeds."""
    rolling = rolling_ball(2.0, 0.3, [3.0, 0.0, -G])
    friction = [-2.0 / 7.0 * 2.0 * 3.0]
    start = rolling.start
    by_multipliers = kane.reactions(rolling.system, 0.0, start)
    np.testing.assert_allclose(by_multipliers, friction, rtol=0, atol=EXACT)
    eliminated = kane.reactions(
        rolling.eliminated, 0.0, rolling.eliminated_state(start)
    )
    np.testing.assert_allclose(eliminated, friction, rtol=0, atol=EXACT)
    force = rolling.forces(0.0, start).force
    np.testing.assert_allclose(force, [[*friction, 0.0, 2.0 * G]], rtol=0, atol=EXACT)


def hung_ball(dependent, masses, sizes, gravity):
    """A ball on a plane, and a particle on a rod at its centre; a base of contacts.

    The ball's centre has an auxiliary speed, which the contact names and the rod, that
    gives way, does not.
    """
    (m, m_p), (radius, rod) = masses, sizes
    inertia = 0.4 * m * radius**2 * np.eye(3)
    particle = lambda t, q, u: u[6:9]
    lifted = lambda t, q, u: u[:3] + jnp.array([1.0, 0.0, 0.0]) * u[9]
    return kane.KaneSystem(
        10,
        9,
        lambda t, q, u: jnp.concatenate(
            [
                lifted(t, q, u),
                quaternion_rates(q[3:7], ball_spin(t, q, u)),
                u[6:9],
            ]
        ),
        [
            kane.RigidBody(m, inertia, lifted, ball_spin),
            kane.Particle(m_p, particle),
        ],
        [
            kane.Load(lifted, lambda t, q, u: m * jnp.asarray(gravity)),
            kane.Load(particle, lambda t, q, u: m_p * jnp.asarray(gravity)),
        ],
        constraints=lambda t, q, u: [(q[7:] - q[:3]) @ (u[6:9] - u[:3])],
        dependent=dependent,
        configuration=lambda t, q, u: [0.5 * (jnp.sum((q[7:] - q[:3]) ** 2) - rod**2)],
        dependent_coordinates=(9,),
        auxiliary=1,
    )


@pytest.mark.parametrize(
    "dependent", [pytest.param((8,), marks=pytest.mark.slow), None]
)
def test_contacts_on_a_system_with_constraints(dependent):
    """The contact's force is what the weights do not accelerate with."""
    masses, sizes, gravity = (2.0, 0.5), (0.3, 0.8), np.array([0.7, 0.2, -G])
    system = hung_ball(dependent, masses, sizes, gravity)
    touching = kane.RollingContact(BALL, rk.Sphere(sizes[0]), kane.ground, rk.Plane())
    centre, down = np.array([0.0, 0.0, sizes[0]]), np.array([0.48, 0.64, 0.6])
    rolling = kane.rolling_contacts(
        system,
        [touching],
        [*centre, 1.0, 0.0, 0.0, 0.0, *(centre + sizes[1] * down)],
        [0.3, 0.1, 0.0, -0.1 / 0.3, 0.3 / 0.3, 0.5, 0.3, 0.1, 0.0],
    )
    assert not rolling.redundant
    assert not rolling.undetermined
    u_dot = kane.kane_derivative(rolling.system, 0.0, rolling.start).u
    (force,) = rolling.forces(0.0, rolling.start).force
    needed = masses[0] * (u_dot[:3] - gravity) + masses[1] * (u_dot[6:] - gravity)
    np.testing.assert_allclose(force, needed, rtol=0, atol=EXACT)
    # the ball's spin is by the contact alone: I w' = -r e_z x F
    turned = 0.4 * masses[0] * sizes[0] ** 2 * u_dot[3:6]
    arm = np.array([0.0, 0.0, -sizes[0]])
    np.testing.assert_allclose(turned, np.cross(arm, force), rtol=0, atol=EXACT)
    assert np.abs(force[:2]).min() > 0.01


def skate(turning=0.0):
    """A knife edge on a plane, whose direction turns at ``turning * t`` more."""
    moves = lambda t, q, u: [u[0], u[1], 0.0]
    turns = lambda t, q, u: [0.0, 0.0, u[2]]
    body = kane.RigidBody(2.0, 0.3 * np.eye(3), moves, turns)

    def across(t, q, u):
        angle = q[2] + turning * t * t
        return [-jnp.sin(angle) * u[0] + jnp.cos(angle) * u[1]]

    plain = lambda t, q, u: u
    return kane.KaneSystem(3, 3, plain, [body], constraints=across, dependent=None)


def test_a_motion_begins_with_the_nearest_speeds_that_are_allowed():
    """Was: what is not allowed stayed, and leaked in: 1.2 J became 5 J in 2 s."""
    speed, turn, times = 1.0, 1.2, jnp.array([0.0, 1.0, 2.0])

    def ends(across):
        start = kane.KaneState(jnp.zeros(3), jnp.stack([speed, across, turn]))
        run = kane.simulate(skate(), start, times, rtol=1e-12)
        return jnp.concatenate([run.q[:, :2], run.kinetic_energy[:, None]], axis=1)

    around = lambda t: np.array([np.sin(turn * t), 1.0 - np.cos(turn * t)]) / turn
    energy = 0.5 * 2.0 * speed**2 + 0.5 * 0.3 * turn**2
    circle = [[*(speed * around(t)), energy] for t in times]
    # a hundred steps, each to 1e-12
    np.testing.assert_allclose(ends(jnp.asarray(0.5)), circle, rtol=0, atol=1e-10)
    for derivative in (jax.jacfwd, jax.jacrev):
        moved = derivative(ends)(jnp.asarray(0.5))
        np.testing.assert_allclose(moved, 0.0, atol=1e-10)


def test_the_speeds_that_are_allowed_move_with_the_first_time():
    system, u = skate(turning=1.0), jnp.array([1.0, 0.4, 1.2])

    @jax.jit
    def end(begins):
        times = jnp.stack([begins, jnp.ones_like(begins)])
        start = kane.KaneState(jnp.zeros(3), u)
        run = kane.simulate(system, start, times, rtol=1e-12)
        return jnp.concatenate([run.q[-1], run.u[-1]])

    begins, h = jnp.asarray(0.3), 1e-4
    difference = lambda h: (end(begins + h) - end(begins - h)) / (2.0 * h)
    right = (4.0 * difference(h) - difference(2.0 * h)) / 3.0
    # rounding of 1e-12 over h; h^4 is 1e-16
    for derivative in (jax.jacfwd, jax.jacrev):
        np.testing.assert_allclose(derivative(end)(begins), right, rtol=0, atol=1e-7)


def slider_crank(dependent):
    """A crank, a rod and a slider on one line, without loads."""
    r, b, inertia = 0.1, 0.25, 0.003 * np.eye(3)
    crank = kane.RigidBody(
        0.5, inertia, lambda t, q, u: [0.0, 0.0, 0.0], lambda t, q, u: [0.0, 0.0, u[0]]
    )
    rod = kane.RigidBody(
        0.4,
        inertia,
        lambda t, q, u: [
            -r * jnp.sin(q[0]) * u[0] - 0.5 * b * jnp.sin(q[1]) * u[1],
            r * jnp.cos(q[0]) * u[0] + 0.5 * b * jnp.cos(q[1]) * u[1],
            0.0,
        ],
        lambda t, q, u: [0.0, 0.0, u[1]],
    )
    slider = kane.Particle(0.7, lambda t, q, u: [u[2], 0.0, 0.0])
    constraints = lambda t, q, u: [
        -r * jnp.sin(q[0]) * u[0] - b * jnp.sin(q[1]) * u[1] - u[2],
        r * jnp.cos(q[0]) * u[0] + b * jnp.cos(q[1]) * u[1],
    ]
    parts = [crank, rod, slider]
    return kane.KaneSystem(
        3, 3, lambda t, q, u: u, parts, constraints=constraints, dependent=dependent
    )


def test_speeds_that_are_not_allowed_keep_their_length():
    """What errors of steps leave of them must not grow: here of order one."""
    system, draw = slider_crank(None), np.random.default_rng(2)

    @jax.jit
    def growth(q, u):
        now = kane.KaneState(q, u)
        rates = kane.kane_derivative(system, 0.0, now)

        def left(state):
            outside = state.u - kane.all_speeds(system, 0.0, state)
            return outside @ outside

        return jax.jvp(left, (now,), (rates,))

    for _ in range(5):
        q, u = draw.uniform(-1.0, 1.0, 3), draw.normal(size=3)
        length, rate = growth(q, u)
        assert length > 1e-3
        # a hundred roundings of terms of order one
        np.testing.assert_allclose(rate, 0.0, rtol=0, atol=1e-13)


def test_a_slider_crank_by_multipliers_runs_for_long():
    """45 turns without loads, by multipliers and by dependent speeds."""
    q, w = np.array([0.0, 0.0, 0.35]), 10.0
    u = np.array([w, -0.1 * w / 0.25, 0.0])
    times = [0.0, 20.0, 40.0]
    run = kane.simulate(slider_crank(None), kane.KaneState(q, u), times)
    chosen = kane.simulate(slider_crank((1, 2)), kane.KaneState(q, u[:1]), times)
    assert run.succeeded
    # 1e-9 for each of some 30 steps of a turn, where all errors have one sign
    bound = 45 * 30 * 1e-9
    energy = run.kinetic_energy
    np.testing.assert_allclose(energy, energy[0], rtol=bound, atol=0)
    # 280 rad, whose rate is off by up to as much, and half of it on the way
    np.testing.assert_allclose(run.q[:, 0], chosen.q[:, 0], rtol=bound, atol=0)
    np.testing.assert_allclose(run.u, run.state.u, rtol=0, atol=bound * w)
