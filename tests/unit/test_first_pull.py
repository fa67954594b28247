"""When a contact would first have to pull, and how that moves."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk
from rollkane.files.scene_files import load_scene
from rollkane.simulation.first_pull import first_pull
from rollkane.simulation.samples import Axis

LEVEL, ORIGIN = (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
TIMES = jnp.linspace(0.0, 2.0, 6)


def press(scene, t, state):
    """``m - t^2``, and nothing of a state that is one: falls at ``sqrt(m)``."""
    return scene.body.mass - t * t + 0.0 * state.angular_velocity[0]


@pytest.mark.parametrize("derivative", [jax.jacfwd, jax.jacrev])
@pytest.mark.parametrize(
    ("mass", "expected"), [(1.3, 0.5 / np.sqrt(1.3)), (9.0, 0.0)], ids=["falls", "not"]
)
def test_it_moves_with_the_force(derivative, mass, expected):
    """Also where a run did not reach its last output."""

    def first(m):
        scene = rk.Scene(rk.Body(m, 0.004 * m * np.eye(3), rk.Sphere(0.1)))
        start = rk.place(scene, LEVEL, ORIGIN, ORIGIN)
        many = lambda x: jnp.broadcast_to(x, (6, *x.shape)).at[5:].set(jnp.nan)
        states, along = jax.tree.map(many, start), Axis(None, 0, of_times=True)
        return first_pull(press, scene, TIMES, states, (along,))

    m = jnp.asarray(mass)
    found = first(m)
    # the run ends on the zero to roundings of its clock, of 2 s
    falls = expected > 0.0
    np.testing.assert_allclose(found, np.sqrt(mass) if falls else np.nan, rtol=1e-14)
    np.testing.assert_allclose(derivative(first)(m), expected, rtol=1e-13)


@pytest.mark.parametrize("count", [2, 3, 8, 60])
def test_a_force_that_falls_and_rises_between_two_outputs(count):
    """A swinging plate presses a ball by ``m (g + z'')``, whatever the outputs."""
    size, rate, g = 0.08, 14.0, 9.81
    lifted = lambda t: jnp.stack([0 * t, 0 * t, size * jnp.cos(rate * t)])
    scene = rk.Scene(
        rk.Body(1.0, 0.004 * np.eye(3), rk.Sphere(0.1)),
        rk.Base(rk.Plane(), rk.BaseMotion(lifted)),
    )
    begins = np.pi / rate
    start = rk.place(scene, LEVEL, (0.0, 5.0, 0.0), ORIGIN, time=begins)
    times = begins + np.linspace(0.0, 2.0 * np.pi / rate, count)
    run = rk.simulate(scene, start, times)
    expected = (2.0 * np.pi - np.arccos(g / (size * rate**2))) / rate
    # N falls at 170 N/s, and rounds to 1e-14 N; its zero to four numbers of the clock
    np.testing.assert_allclose(run.first_pull, expected, rtol=1e-13)


@pytest.mark.parametrize("count", [2, 3, 11, 51])
def test_a_force_that_stays_positive_has_no_first_pull(count):
    """However coarse the outputs: a rattleback rocks eight times a second."""
    built_in = load_scene("rattleback")
    run = rk.simulate(built_in.scene, built_in.start, np.linspace(0.0, 5.0, count))
    assert np.isnan(run.first_pull)


def pushed(begins, ends, size=15.0):
    """A ball of 9.81 N on a plane, pulled up by 15 N for some time."""
    push = lambda t, point: (
        jnp.array([0.0, 0.0, size]) * jnp.where((t > begins) & (t < ends), 1.0, 0.0)
    )
    scene = rk.Scene(
        rk.Body(1.0, 0.004 * np.eye(3), rk.Sphere(0.1)),
        loads=(rk.Gravity(), rk.Force(push)),
        kinks=np.array([begins, ends]),
    )
    return scene, rk.place(scene, LEVEL, (0.0, 1.0, 0.0), ORIGIN)


@pytest.mark.parametrize(
    "times",
    [[0.0, 0.8], [0.0, 0.4, 0.8], [0.0, 0.43, 0.8], [0.4, 0.8], [0.0, 0.4, 0.43, 0.5]],
)
def test_a_force_that_jumps_on_an_output(times):
    """It pulls behind the jump alone, and for 0.03 s."""
    scene, start = pushed(0.4, 0.43)
    run = rk.simulate(scene, start, times)
    # a run ends on a kink, and begins behind it: four numbers of the clock
    np.testing.assert_allclose(run.first_pull, 0.4, rtol=1e-14)


def test_a_jump_on_an_output_backwards():
    scene, start = pushed(0.4, 0.43)
    run = rk.simulate(scene, start, [0.8, 0.43, 0.0])
    np.testing.assert_allclose(run.first_pull, 0.43, rtol=1e-14)


@pytest.mark.parametrize(
    "times", [(0.0, 0.8), pytest.param((0.0, 0.4, 0.8), marks=pytest.mark.slow)]
)
@pytest.mark.parametrize(
    "derivative", [jax.jacfwd, pytest.param(jax.jacrev, marks=pytest.mark.slow)]
)
def test_a_jump_has_no_derivative(derivative, times):
    """Of a body whose normal force moves with its spin."""
    scene, _ = pushed(0.4, 0.8, 60.0)
    egg = rk.Body(1.0, 0.004 * np.eye(3), rk.Ellipsoid((0.1, 0.12, 0.15)), (0.01, 0, 0))
    scene = rk.Scene(egg, loads=scene.loads, kinks=scene.kinks)
    start = rk.place(scene, LEVEL, (0.0, 1.0, 0.0), ORIGIN)

    def first(spin):
        moved = eqx.tree_at(lambda s: s.angular_velocity, start, spin)
        return rk.simulate(scene, moved, jnp.array(times)).first_pull

    spin = start.angular_velocity
    np.testing.assert_allclose(first(spin), 0.4, rtol=1e-14)
    assert np.all(np.isnan(derivative(first)(spin)))


@pytest.mark.parametrize("derivative", [jax.jacfwd, jax.jacrev])
def test_what_pulls_from_the_start_does_not_move(derivative):
    scene, start = pushed(-1.0, 0.5)

    def first(spin):
        moved = eqx.tree_at(lambda s: s.angular_velocity, start, spin)
        return rk.simulate(scene, moved, jnp.array([0.1, 0.8])).first_pull

    spin = start.angular_velocity
    np.testing.assert_array_equal(first(spin), 0.1)
    np.testing.assert_array_equal(derivative(first)(spin), 0.0)
