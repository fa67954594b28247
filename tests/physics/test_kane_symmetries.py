"""Symmetries of Kane systems: none made up, whatever the sizes, and true ones found."""

import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk
from rollkane import kane
from rollkane.stability.kane_problem import kane_problem

G = 9.81
# Of eigenvalues of motions that are solved to rounding: some 1e3 operations
CLOSE = 1e-10


def at_rest(n):
    return kane.KaneState(jnp.zeros(n), jnp.zeros(n))


def on_a_line(force, **parameters):
    def along(t, q, u):
        return [u[0], 0.0, 0.0]

    return kane.KaneSystem(
        *(1, 1, lambda t, q, u: u, [kane.Particle(1.0, along)]),
        generalized_forces=force,
        parameters=parameters,
    )


def bead(radius, weight):
    """On a circle, ``z = R - sqrt(R^2 - x^2)``, which ends at R."""

    def swing(t, q, u, p):
        return [u[0], 0.0, u[0] * q[0] / jnp.sqrt(p["R"] ** 2 - q[0] ** 2)]

    return kane.KaneSystem(
        *(1, 1, lambda t, q, u: u, [kane.Particle(1.0, swing)]),
        loads=[kane.Load(swing, lambda t, q, u: [0.0, 0.0, weight])],
        parameters={"R": radius},
    )


def rolling_ball(radius, carrier, place, speeds=(0.0,) * 6):
    ball = kane.free_bodies([1.0], [0.4 * radius**2 * np.eye(3)])
    near = {} if isinstance(carrier, rk.Plane) else {"near": place[1]}
    contact = kane.RollingContact(
        ball.frames[0], rk.Sphere(radius), kane.ground, carrier, **near
    )
    q = [*place[0], 1.0, 0.0, 0.0, 0.0][:7]
    return kane.rolling_contacts(ball.system, [contact], q=q, u=list(speeds))


@pytest.mark.parametrize("radius", [5.0, 0.05, 0.005])
def test_a_bead_on_top_of_a_wire_falls_whatever_its_size(radius):
    motion = rk.steady_motion(bead(radius, G), at_rest(1))
    assert not motion.stable
    assert motion.growth == pytest.approx(np.sqrt(G / radius), rel=CLOSE)
    hangs = rk.steady_motion(bead(radius, -G), at_rest(1))
    assert hangs.stable
    assert hangs.eigenvalues[0].imag == pytest.approx(np.sqrt(G / radius), rel=CLOSE)


@pytest.mark.parametrize("width", [1.0, 1e-3, 1e-9])
def test_a_force_that_saturates_close_to_the_guess_is_seen(width):
    system = on_a_line(lambda t, q, u, p: [jnp.tanh(q[0] / p["d"])], d=width)
    motion = rk.steady_motion(system, at_rest(1))
    assert not motion.zeros
    assert motion.growth == pytest.approx(np.sqrt(1.0 / width), rel=CLOSE)


def test_what_breaks_a_symmetry_at_the_solution_alone_is_seen():
    """The search comes from 0.5 m away to where the other coordinate is repelled."""

    def along(k):
        return lambda t, q, u: [u[k], 0.0, 0.0]

    def forces(t, q, u):
        near = jnp.exp(-((q[0] / 1e-3) ** 2))
        return jnp.array([-q[0], 4.0 * q[1] * near])

    system = kane.KaneSystem(
        *(2, 2, lambda t, q, u: u, [kane.Particle(1.0, along(k)) for k in range(2)]),
        generalized_forces=forces,
    )
    guess = kane.KaneState(jnp.array([0.5, 0.0]), jnp.zeros(2))
    motion = rk.steady_motion(system, guess)
    assert not motion.problem.group
    assert motion.growth == pytest.approx(2.0, rel=CLOSE)


@pytest.mark.parametrize("soft", [1e-4, 1e-8])
def test_a_soft_coordinate_is_no_symmetry_beside_a_stiff_one(soft):
    """Both in one equation: a stiff spring between two masses, one soft to the ground.

    In terms of the stiff one's, 1, the soft one is 1e-8 at least: the limit of what is
    told as none is 1e-11.
    """

    def along(k):
        return lambda t, q, u: [u[k], 0.0, 0.0]

    def forces(t, q, u):
        pull = q[1] - q[0]
        return jnp.array([pull + soft * q[0], -pull])

    system = kane.KaneSystem(
        *(2, 2, lambda t, q, u: u, [kane.Particle(1.0, along(k)) for k in range(2)]),
        generalized_forces=forces,
    )
    motion = rk.steady_motion(system, at_rest(2))
    square = np.max(np.linalg.eigvals(np.array([[-1 + soft, 1], [1, -1]])).real)
    assert not motion.stable
    # a rounding of the stiff terms, 1e-16, beside the soft one
    rel = 1e-15 / soft + CLOSE
    assert motion.growth == pytest.approx(np.sqrt(square), rel=rel)


def test_a_guess_without_neighbours_is_refused():
    """An equation with rates at one state alone tells no symmetry."""
    system = on_a_line(lambda t, q, u: [jnp.where(q[0] == 0.0, 0.0, jnp.nan)])
    with pytest.raises(rk.FieldError, match="off singular places"):
        rk.steady_motion(system, at_rest(1))


@pytest.mark.parametrize(
    ("radius", "inside", "growth"),
    [
        (0.2, False, np.sqrt(5 / 7 * G / 0.24)),
        (0.05, True, 0.0),
    ],
)
@pytest.mark.slow
def test_a_ball_on_a_small_sphere_and_in_a_small_bowl(radius, inside, growth):
    """Balanced on a sphere it falls with sqrt(5 g / 7 (R + r)), in a bowl it swings."""
    own = radius / 5.0
    side = -1.0 if inside else 1.0
    place = side * radius + own
    where = [0.0, 0.0, place], (0.0, 0.0, side * radius)
    roll = rolling_ball(own, rk.Sphere(radius, inside=inside), where)
    state = roll.eliminated_state(roll.start)
    motion = rk.steady_motion(roll.eliminated, state)
    assert motion.growth == pytest.approx(growth, rel=CLOSE, abs=1e-9)
    assert motion.stable == inside
    swing = np.sqrt(5 / 7 * G / abs(place))
    moving = np.abs(motion.eigenvalues[np.abs(motion.eigenvalues) > 1e-3 * swing])
    np.testing.assert_allclose(moving, np.full(4, swing), rtol=CLOSE)
    assert len(set(motion.problem.group)) == len(motion.problem.group)


@pytest.mark.slow
def test_a_ball_on_a_plane_has_its_translations_and_none_that_moves_nothing():
    roll = rolling_ball(0.2, rk.Plane(), ([0.0, 0.0, 0.2], None))
    state = roll.eliminated_state(roll.start)
    problem, _ = kane_problem(roll.eliminated, state)
    assert problem.group[:2] == ("q[0] + q[7]", "q[1] + q[8]")
    assert len(set(problem.group)) == len(problem.group)
    names, _ = problem.coordinates(state)
    aside = np.where(np.char.startswith(names, "q"), 0.1, 0.0)
    q = np.asarray(problem.moved(state, jnp.asarray(aside)).q)
    laws = np.asarray(problem.laws)
    tangents = laws[:, :, :-1] @ q + laws[:, :, -1]
    assert (np.linalg.norm(tangents, axis=1) > 1e-3).all()
    assert rk.steady_motion(roll.eliminated, state).growth < 1e-12


def test_constraints_by_multipliers_are_refused():
    roll = rolling_ball(0.2, rk.Plane(), ([0.0, 0.0, 0.2], None))
    with pytest.raises(rk.FieldError, match="act by multipliers"):
        rk.steady_motion(roll.system, roll.start)


@pytest.mark.parametrize("radius", [1.0, 3.84e8])
def test_a_circular_orbit_keeps_its_turn(radius):
    """Of a force of the inverse fourth power, whose orbits grow with their own rate."""
    rate = 0.01

    def velocity(t, q, u):
        c, s = jnp.cos(q[1]), jnp.sin(q[1])
        return [u[0] * c - q[0] * u[1] * s, u[0] * s + q[0] * u[1] * c, 0.0]

    def pull(t, q, u):
        size = -(rate**2) * radius * (radius / q[0]) ** 4
        return [size * jnp.cos(q[1]), size * jnp.sin(q[1]), 0.0]

    system = kane.KaneSystem(
        *(2, 2, lambda t, q, u: u, [kane.Particle(1.0, velocity)]),
        loads=[kane.Load(velocity, pull)],
    )
    guess = kane.KaneState(jnp.array([radius, 0.0]), jnp.array([0.0, rate]))
    motion = rk.steady_motion(system, guess)
    assert tuple(motion.generator) == ("q[1]",)
    assert motion.growth == pytest.approx(rate, rel=1e-8)
    assert not motion.stable


def test_a_family_that_loses_a_symmetry_of_its_start_is_refused():
    """Of ``q'' = mu q``: at mu = 0 q can be shifted, and nowhere else."""
    system = on_a_line(lambda t, q, u, p: [p["mu"] * q[0]], mu=0.0)
    start = rk.steady_motion(system, at_rest(1), ("q[0]",))
    with pytest.raises(rk.FieldError, match="has no symmetry"):
        rk.steady_family(system, start, "parameters.mu", (-1.0, 1.0))
