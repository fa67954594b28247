"""Runs in modes without friction: nothing along the surface holds or stops a slip."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk

UP, STILL = (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
R, HEIGHT = 0.1, 0.5
BALL = rk.Scene(rk.Body(1.0, 0.004 * np.eye(3), rk.Sphere(R)))
EGG = rk.Scene(
    rk.Body(1.0, np.diag([0.004, 0.005, 0.003]), rk.Ellipsoid((0.12, 0.1, R)))
)


@pytest.mark.parametrize(
    ("scene", "how"),
    [
        pytest.param(BALL, {"restitution": 0.8}, marks=pytest.mark.slow, id="ball"),
        pytest.param(
            BALL,
            {"restitution": 0.8, "impact": "newton"},
            marks=pytest.mark.slow,
            id="Newton's law",
        ),
        pytest.param(EGG, {"restitution": 0.8}, marks=pytest.mark.slow, id="ellipsoid"),
        pytest.param(BALL, {"restitution": 0.0}, id="plastic"),
    ],
)
def test_a_landing_without_a_slip_has_the_slopes_of_ice(scene, how):
    """Dropped straight down: no force acts along the level base.

    What turns an ellipsoid that lands a little tilted is known by differences of runs.
    """
    modes = rk.Modes(friction=0.0, **how)

    def end(v):
        zero = 0.0 * v[0]
        moves, turns = (
            jnp.stack([v[0], v[1], zero]),
            jnp.stack([zero, v[2], zero]),
        )
        start = rk.release(scene, UP, turns, (0.0, 0.0, HEIGHT), moves)
        run = rk.simulate(scene, start, [0.0, 0.5], modes=modes, rtol=1e-12)
        w, u = run.angular_velocity[-1], run.velocity[-1]
        return jnp.concatenate([u[:2], w[:2], run.position[-1, :2]])

    x = jnp.zeros(3)
    forward, backward = jax.jacfwd(end)(x), jax.jacrev(end)(x)
    np.testing.assert_allclose(backward, forward, atol=1e-9)
    h = 1e-4  # differences err by h^2: at 1e-5 by 3e-10, here by 3e-8
    steps = h * jnp.eye(3)
    slopes = [(end(dx) - end(-dx)) / (2.0 * h) for dx in steps]
    np.testing.assert_allclose(forward, jnp.stack(slopes, axis=1), atol=1e-6)
    # no force along the level base, ever: exact to rounding
    np.testing.assert_allclose(forward[:2, :2], np.eye(2), atol=1e-12)
    np.testing.assert_allclose(forward[4:, :2], 0.5 * np.eye(2), atol=1e-12)


@pytest.mark.parametrize("scene", [BALL, EGG], ids=["ball", "ellipsoid"])
def test_what_rests_without_friction_rests(scene):
    """Placed or dropped straight down, also where it spins about the normal."""
    times = [0.0, 1.5]
    placed = rk.place(scene, UP, STILL, STILL)
    rests = rk.simulate(scene, placed, times, modes=rk.Modes(friction=0.0))
    modes = rk.Modes(friction=0.0, restitution=0.5)
    for spin in (0.0, 3.0):
        dropped = rk.release(scene, UP, (0.0, 0.0, spin), (0.0, 0.0, HEIGHT), STILL)
        falls = rk.simulate(scene, dropped, times, modes=modes)
        for run in (rests, falls):
            assert run.succeeded
            # 4 to 124 are tried; with steps that shrink to nothing millions
            assert run.steps + run.rejected_steps < 1000
            assert int(run.mode[-1]) == rk.Mode.SLIPPING
            # nothing moves it along; height at atol of a step, 1e-10 and less
            np.testing.assert_allclose(run.position[-1], [0.0, 0.0, R], atol=1e-9)
            np.testing.assert_allclose(run.slip[-1], 0.0, atol=1e-12)


def test_on_a_slope_without_friction_what_rests_begins_to_slide():
    """With the acceleration g sin(angle), and without a spin."""
    slope = rk.Scene(BALL.body, rk.Base(rk.Graph(lambda x, y: 0.2 * x)))
    start = rk.place(slope, UP, STILL, STILL)
    run = rk.simulate(slope, start, [0.0, 1.0], modes=rk.Modes(friction=0.0), rtol=1e-9)
    assert run.succeeded
    sine = 0.2 / np.hypot(1.0, 0.2)
    # errors of some steps at 1e-9
    speed = np.linalg.norm(run.velocity[-1])
    np.testing.assert_allclose(speed, 9.81 * sine, rtol=1e-8)
    np.testing.assert_allclose(run.angular_velocity[-1], 0.0, atol=1e-8)


def test_what_sticks_without_sliding_friction_is_held():
    """Static friction alone holds what rests: friction of sliding may still be zero."""
    modes = rk.Modes(friction=0.0, static_friction=0.1)
    run = rk.simulate(BALL, rk.place(BALL, UP, STILL, STILL), [0.0, 1.0], modes=modes)
    assert run.succeeded
    assert int(run.mode[-1]) == rk.Mode.ROLLING


def test_a_batch_at_rest_without_friction():
    """Members that rest beside one that slides, as each of them alone."""
    v = jnp.array([0.0, 0.5, 0.0, 1e-7])

    def run(v):
        start = rk.release(
            BALL, UP, STILL, (0.0, 0.0, HEIGHT), jnp.stack([v, 0.0 * v, 0.0 * v])
        )
        modes = rk.Modes(friction=0.0, restitution=0.0)
        return rk.simulate(BALL, start, [0.0, 0.6], modes=modes)

    many = jax.vmap(run)(v)
    assert np.all(np.asarray(many.code) == rk.Code.COMPLETED)
    np.testing.assert_allclose(many.position[:, -1, 0], 0.6 * v, rtol=1e-12)
