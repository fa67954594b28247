"""Laws of rolling with closed forms, and symmetries that need none."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk

from .. import problems
from ..quick import slow_but

LEVEL = (1.0, 0.0, 0.0, 0.0)
ORIGIN = (0.0, 0.0, 0.0)
BALL = 0.05  # m
BOWL = 0.6  # m


def ball(radius=BALL, mass=0.3):
    inertia = 0.4 * mass * radius**2 * np.eye(3)
    return rk.Body(mass, inertia, rk.Sphere(radius))


@pytest.mark.parametrize("angle", [0.1, 0.6])
def test_ball_on_an_incline(angle):
    """5/7 g sin(angle) down the slope: gravity is turned, the plane is not."""
    pull = 9.81 * np.array([np.sin(angle), 0.0, -np.cos(angle)])
    scene = rk.Scene(ball(), loads=(rk.Gravity(pull),))
    start = rk.place(scene, LEVEL, (0.0, 2.0, 3.0), ORIGIN)
    times = np.linspace(0.0, 2.0, 5)
    x = np.asarray(rk.simulate(scene, start, times, rtol=1e-11).position)[:, 0]
    exact = 2.0 * BALL * times + 0.5 * (5 / 7) * 9.81 * np.sin(angle) * times**2
    # a solution that is quadratic in time has no truncation error: rounding only
    np.testing.assert_allclose(x, exact, atol=1e-12 * max(exact))


BOWLS = {
    "cavity": (rk.Sphere(BOWL, inside=True), -BOWL),
    "ellipsoid": (rk.Ellipsoid((BOWL, BOWL, BOWL), inside=True), -BOWL),
    "graph": (rk.Graph(lambda x, y: BOWL - jnp.sqrt(BOWL**2 - x * x - y * y)), 0.0),
    "meridian": (
        rk.Revolution(
            lambda s: (BOWL * jnp.sin(s), -BOWL * jnp.cos(s)),
            domain=(0.0, 1.5),
            inside=True,
        ),
        -BOWL,
    ),
    "level set": (
        rk.Implicit(lambda p: BOWL**2 - jnp.sum(p * p), size=2.0),
        -BOWL,
    ),
}


@pytest.mark.parametrize("name", slow_but(["ellipsoid", "graph"], BOWLS))
def test_ball_swings_in_a_bowl(name):
    """w^2 = 5/7 g / (R - r), corrected for the finite angle like a pendulum."""
    surface, bottom = BOWLS[name]
    scene = rk.Scene(ball(), rk.Base(surface))
    swing = 0.02
    contact = (BOWL * np.sin(swing), 0.0, bottom + BOWL * (1 - np.cos(swing)))
    start = rk.place(scene, LEVEL, ORIGIN, contact)
    rate = np.sqrt(5 / 7 * 9.81 / (BOWL - BALL))
    period = 2 * np.pi / rate * (1 + swing**2 / 16 + 11 * swing**4 / 3072)
    times = np.linspace(0.0, period, 3)
    result = rk.simulate(scene, start, times, rtol=1e-11)
    x = np.asarray(result.position)[:, 0]
    # the next term of the period is swing^6/1e3: 1e-13 of it; steps of 1e-11 dominate
    assert abs(x[2] - x[0]) < 1e-9
    assert abs(x[1] + x[0]) < 1e-9
    assert float(result.normal_force.min()) > 0


def test_ball_in_a_standing_pipe_goes_up_and_down():
    """Height swings with sqrt(2/7) of the rate round the axis (Neimark, Fufaev)."""
    pipe = 0.4
    scene = rk.Scene(ball(), rk.Base(rk.Cylinder(pipe, inside=True)))
    around = 9.0  # rad/s of the centre about the axis
    orbit = pipe - BALL
    # no slip at (pipe, 0, 0): velocity (0, around orbit, 0) = -w x (BALL, 0, 0)
    spin_z = -around * orbit / BALL
    start = rk.place(scene, LEVEL, (0.0, 0.0, spin_z), (pipe, 0.0, 0.0))
    rate = np.sqrt(2 / 7) * around
    times = np.linspace(0.0, 2 * np.pi / rate, 9)
    result = rk.simulate(scene, start, times, rtol=1e-11)
    z = np.asarray(result.position)[:, 2]
    depth = -(5 / 7) * 9.81 / rate**2
    exact = depth * (1 - np.cos(rate * times))
    np.testing.assert_allclose(z, exact, atol=1e-9 * abs(depth) * 10)
    angle = np.unwrap(np.arctan2(*np.asarray(result.position)[:, 1::-1].T))
    np.testing.assert_allclose(angle, around * times, atol=1e-8)


def scene_and_start(shift=0.0, turn=0.0, length=1.0, origin=(0.0, 0.0, 0.0)):
    """An ellipsoid in a bowl, moved, turned, scaled, and with another body origin."""
    axes, com = np.array([0.2, 0.15, 0.1]) * length, np.array([0.01, 0.02, -0.01])
    origin = np.asarray(origin)
    z, spin = problems.turn(2, turn), np.array([1.0, -2.0, 4.0])
    Q = problems.matrix(z)
    scene = rk.Scene(
        rk.Body(
            2.0,
            np.diag([0.01, 0.014, 0.018]) * length**2,
            rk.Ellipsoid(axes, center=-origin),
            com * length - origin,
        ),
        loads=(rk.Gravity((0.0, 0.0, -9.81 * length)),),
    )
    q = problems.product(z, problems.turn(0, 33.0))
    start = rk.place(scene, q, Q @ spin, (shift, 0.0, 0.0))
    return scene, start, Q


TIMES = np.linspace(0.0, 1.0, 4)


@pytest.fixture(scope="module")
def plain():
    scene, start, _ = scene_and_start()
    return rk.simulate(scene, start, TIMES, rtol=1e-11)


def test_moving_and_turning_the_scene(plain):
    """Every horizontal place and direction is alike."""
    scene, start, Q = scene_and_start(shift=3.0, turn=77.0)
    moved = rk.simulate(scene, start, TIMES, rtol=1e-11)
    exact = np.asarray(plain.position) @ Q.T + [3.0, 0.0, 0.0]
    np.testing.assert_allclose(moved.position, exact, atol=1e-8)
    np.testing.assert_allclose(moved.normal_force, plain.normal_force, rtol=1e-7)


def test_units_of_length_do_not_matter(plain):
    scene, start, _ = scene_and_start(length=10.0)
    large = rk.simulate(scene, start, TIMES, rtol=1e-11)
    np.testing.assert_allclose(large.position, 10 * plain.position, atol=1e-7)
    np.testing.assert_allclose(large.energy, 100 * plain.energy, rtol=1e-9)


def test_the_body_origin_does_not_matter(plain):
    """Another origin of the body axes moves `position` and nothing else."""
    offset = np.array([0.03, -0.02, 0.05])
    scene, start, _ = scene_and_start(origin=offset)
    other = rk.simulate(scene, start, TIMES, rtol=1e-11)
    np.testing.assert_allclose(other.contact_on_base, plain.contact_on_base, atol=1e-9)
    R = np.stack([problems.matrix(q) for q in np.asarray(plain.orientation)])
    np.testing.assert_allclose(other.position, plain.position + R @ offset, atol=1e-9)
    np.testing.assert_allclose(other.energy, plain.energy, rtol=1e-9)


def test_power_of_the_loads_is_the_rate_of_kinetic_energy():
    """The contact does no work: dE/dt = 0 along the right-hand side, exactly."""
    from rollkane.dynamics.observables import energy

    scene, start, _ = scene_and_start()
    rates = rk.rolling_derivative(scene, jnp.zeros(()), start)
    value, rate = jax.jvp(lambda s: energy(scene, jnp.zeros(()), s), (start,), (rates,))
    # sums of terms of about 2 |w| |E|
    assert abs(float(rate)) < 1e-13 * 2 * 5 * float(value) * 10


def test_mass_scales_forces_only(plain):
    scene, start, _ = scene_and_start()
    body = scene.body
    heavy = rk.Scene(
        rk.Body(5 * body.mass, 5 * body.inertia, body.surface, body.center_of_mass),
        loads=scene.loads,
    )
    result = rk.simulate(heavy, start, TIMES, rtol=1e-11)
    np.testing.assert_allclose(result.position, plain.position, atol=1e-12)
    np.testing.assert_allclose(
        result.contact_force, 5 * plain.contact_force, rtol=1e-9, atol=1e-9
    )
