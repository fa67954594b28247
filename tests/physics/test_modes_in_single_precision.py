"""Runs that change their contact, in single precision: to about its own digits."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk

UP, STILL = (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
RADIUS, G = 0.1, 9.81
BALL = rk.Body(1.0, 0.4 * RADIUS**2 * np.eye(3), rk.Sphere(RADIUS))
ELLIPSOID = rk.Body(1.0, np.diag([5e-3, 4e-3, 3e-3]), rk.Ellipsoid((0.1, 0.12, 0.15)))
BOWL = rk.Base(rk.Graph(lambda x, y: 0.5 * (x * x + y * y)))
SHAKEN = rk.Base(
    rk.Plane(),
    rk.BaseMotion(lambda t: jnp.stack([0 * t, 0 * t, 0.02 * jnp.sin(25 * t)])),
)
RTOL = 1e-5  # the default in single precision


def single(tree):
    """The same numbers in single precision."""
    return jax.tree.map(lambda x: jnp.asarray(x, jnp.float32), tree)


def test_a_bowling_ball_grips():
    """A slip of 8 m/s ends at 2 v / (7 mu g), where the ball rolls at 5 v / 7."""
    lane = rk.Scene(BALL, contact=rk.Slipping(rk.CoulombFriction(0.2)))
    start = rk.place(lane, UP, STILL, STILL, velocity=(8.0, 0.0, 0.0))
    scene, start, modes = single((lane, start, rk.Modes(friction=0.2)))
    run = rk.simulate(scene, start, np.linspace(0, 3, 4, dtype=np.float32), modes=modes)
    assert run.position.dtype == jnp.float32
    assert int(run.code) == 0
    assert int(run.switches.count) == 1
    grips = 2.0 * 8.0 / (7.0 * 0.2 * G)
    np.testing.assert_allclose(run.switches.time[0], grips, rtol=RTOL)
    v = np.asarray(run.velocity)[-1, 0]
    np.testing.assert_allclose(v, 5.0 * 8.0 / 7.0, rtol=RTOL)


def test_a_ball_bounces_until_it_rests():
    """Bounces halve, as long as their height is more than rounding; then it rests."""
    scene = rk.Scene(BALL)
    start = rk.release(scene, UP, STILL, (0.0, 0.0, RADIUS + 0.5), STILL)
    modes = rk.Modes(friction=0.3, restitution=0.5, rest_speed=1e-6)
    run = rk.simulate(
        *single((scene, start)),
        np.linspace(0, 2, 3, dtype=np.float32),
        modes=single(modes),
    )
    assert int(run.code) == 0
    assert int(run.state.mode[-1]) == rk.Mode.ROLLING
    # a rounding of the clock, or a height that rounds at the place, for each bounce
    np.testing.assert_allclose(run.position[-1], (0, 0, RADIUS), atol=1e-6)
    first = np.sqrt(2.0 * 0.5 / G)
    speeds = G * first * 0.5 ** np.arange(1, 8)  # 0.02 m/s: rises 20 roundings
    lands = first + np.concatenate([[0.0], np.cumsum(2.0 * speeds / G)[:-1]])
    np.testing.assert_allclose(run.switches.time[:7], lands, rtol=RTOL)


def tosses(scene, modes, follow):
    """What ``follow`` makes of where six bodies end, in double and single precision."""
    rng = np.random.default_rng(3)
    turned = rng.normal(size=(6, 4))
    turned /= np.linalg.norm(turned, axis=1)[:, None]
    spins, heights = 3.0 * rng.normal(size=(6, 3)), 0.3 + 0.2 * rng.random(6)

    @jax.jit
    def ended(scene, modes, turned, spin, height):
        def ends(height):
            place = jnp.stack([0.05 + 0.0 * height, 0.02 + 0.0 * height, height])
            start = rk.release(scene, turned, spin, place, (0.5, 0.3, 0.0))
            times = np.linspace(0.0, 1.0, 3).astype(height.dtype)
            run = rk.simulate(scene, start, times, modes=modes)
            return run.position[-1], (run.code, run.switches.count)

        return follow(ends, height)

    rows = [
        (ended(*given), ended(*single(given)))
        for given in zip([scene] * 6, [modes] * 6, turned, spins, heights, strict=True)
    ]
    return jax.tree.map(lambda *x: np.stack(x), *rows)


def test_an_ellipsoid_tossed_into_a_bowl():
    """To what a hundred steps leave of rtol: of 1 m each, all alike, 1e-3 m."""
    scene = rk.Scene(ELLIPSOID, BOWL)
    modes = rk.Modes(friction=0.1, restitution=0.3)
    both = tosses(scene, modes, lambda ends, height: ends(height))
    (place, (code, count)), (place32, (code32, count32)) = both
    assert place32.dtype == np.float32
    assert not np.any(code)
    assert not np.any(code32)
    assert np.all(count > 0)
    assert np.all(count32 > 0)
    np.testing.assert_allclose(place32, place, atol=100 * RTOL)


@pytest.mark.slow
def test_tangents_of_a_ball_tossed_on_a_shaken_plate():
    """A derivative adds the rates of a hundred steps' errors: a hundredth of itself."""
    scene = rk.Scene(BALL, SHAKEN)
    modes = rk.Modes(friction=0.3, static_friction=0.4, restitution=0.0)
    along = lambda ends, height: jax.jvp(
        lambda h: ends(h)[0], (height,), (jnp.ones_like(height),)
    )
    (place, dot), (place32, dot32) = tosses(scene, modes, along)
    assert dot32.dtype == np.float32
    np.testing.assert_allclose(place32, place, atol=100 * RTOL)
    np.testing.assert_allclose(dot32, dot, atol=1e-2 * np.max(np.abs(dot)))
