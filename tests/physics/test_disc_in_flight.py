"""Discs in flight, whose face may be nearer to an uneven base than their rim."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import brentq, minimize_scalar

import rollkane as rk
from rollkane.geometry.rotations import rotation_matrix

from ..quick import slow_but

A, BALL, FROM = 0.4, 1.0, 0.4  # m: of the disc, of a base, its height
DISC = rk.Body(1.0, np.diag([0.04, 0.04, 0.08]), rk.DiscEdge(A))
STILL = (0.0, 0.0, 0.0)
LANDS = rk.Modes(friction=0.3, restitution=0.3)


def tilted(tilt):
    return (np.cos(tilt / 2), np.sin(tilt / 2), 0.0, 0.0)


def falls(base, tilt, height, method="auto"):
    scene = rk.Scene(DISC, rk.Base(base))
    start = rk.release(scene, tilted(tilt), STILL, (0.02, 0.01, height), STILL)
    times = np.linspace(0.0, 1.0, 11)
    return rk.simulate(scene, start, times, modes=LANDS, method=method)


def ended(run, drop):
    """It ends where the face comes to the base, and nothing changed before."""
    assert run.code == rk.Code.SURFACE_EDGE
    assert run.switches.count == 0
    assert run.final_state.mode == rk.Mode.FLYING
    # the gap is known to 64 roundings of about 1 m, at 2 m/s or faster
    wanted = np.sqrt(2.0 * drop / 9.81)
    np.testing.assert_allclose(run.final_time, wanted, rtol=0.0, atol=2e-14)
    assert np.isnan(run.position[run.time > wanted]).all()


@pytest.mark.parametrize("method", slow_but(["native"], ["native", "diffrax"]))
@pytest.mark.parametrize("tilt", [0.0, 0.1])
def test_a_disc_that_falls_on_a_ball_with_its_face_ends_there(tilt, method):
    """Where its plane is the radius away from the ball's centre."""
    ball = rk.Sphere(BALL, (0.0, 0.0, -BALL))
    run = falls(ball, tilt, FROM, method)
    touches = (BALL + 0.01 * np.sin(tilt)) / np.cos(tilt) - BALL
    ended(run, FROM - touches)


@pytest.mark.parametrize("tilt", [0.0, 0.05, 0.3])
def test_a_bump_does_not_come_through_a_disc(tilt):
    """The rim meets nothing until the bump is 12 cm through the face."""
    top, wide = 0.15, 0.12
    bump = rk.Graph(lambda x, y: top * jnp.exp(-(x * x + y * y) / (2.0 * wide**2)))
    run = falls(bump, tilt, 0.6)

    def above(y):  # of the bump over the disc's plane through the disc's centre
        return top * np.exp(-y * y / (2.0 * wide**2)) - np.tan(tilt) * (y - 0.01)

    peak = minimize_scalar(
        lambda y: -above(y),
        bounds=(-0.2, 0.2),
        method="bounded",
        options={"xatol": 1e-9},
    )
    ended(run, 0.6 - above(peak.x))


@pytest.mark.parametrize("seed", range(4))
def test_a_disc_that_shows_its_face_to_a_ball_flies_on(seed):
    """It took 40,000 steps, or failed, where the face becomes the nearest."""
    ball = rk.Scene(DISC, rk.Base(rk.Sphere(BALL)))
    angle = np.random.default_rng(seed).uniform(-np.pi, np.pi)
    spin = 12.0 * np.array([np.cos(angle), np.sin(angle), 0.2])
    start = rk.release(ball, tilted(0.0), spin, (0.1, 0.05, 1.7), (0.2, 0.1, 4.0))

    def flown(count, **lands):
        times = np.linspace(0.0, 0.8, count)
        modes = rk.Modes(friction=0.3, **lands)
        return rk.simulate(ball, start, times, modes=modes, rtol=1e-9)

    run = flown(81, restitution=0.3)
    matrices = jax.vmap(rotation_matrix)(run.orientation)
    centre = np.einsum("tji,tj->ti", matrices, run.position)  # of the ball, backwards
    across = np.hypot(centre[:, 0], centre[:, 1])
    passes = (across[1:] < A) != (across[:-1] < A)
    assert passes.sum() >= 2  # the nearest point comes over the rim
    assert run.code == rk.Code.COMPLETED
    assert run.switches.count == 0
    once, free = flown(2, restitution=0.3), flown(2)
    assert once.steps + once.rejected_steps < 3 * (free.steps + free.rejected_steps)
    # each within 1e-9 a step, of about 30, of a turn of 10 rad
    tolerance = 2.0 * 30.0 * 1e-9
    np.testing.assert_allclose(
        once.orientation, free.orientation, rtol=0.0, atol=tolerance
    )


ROUND = {"disc": rk.DiscEdge(0.1), "ring": rk.Ring(0.1), "torus": rk.Torus(0.1, 0.02)}


def thrown(surface, q, w, v):
    """Above a plane, of which it is 0.3 m away."""
    body = rk.Body(1.0, np.diag([0.0025, 0.0025, 0.005]), surface)
    scene = rk.Scene(body)
    start = rk.release(scene, q, w, jnp.array([0.0, 0.0, 0.3]), v)
    modes = rk.Modes(friction=0.3, restitution=0.4)
    return rk.simulate(scene, start, (0.0, 0.28), modes=modes, rtol=1e-12, atol=1e-12)


def heights(q, w, v, thick):
    """Of the lowest point of a symmetric top, whose axis turns about its momentum."""
    q0, q1, q2, q3 = q
    n = np.array(
        [
            2 * (q1 * q3 + q0 * q2),
            2 * (q2 * q3 - q0 * q1),
            q0**2 - q1**2 - q2**2 + q3**2,
        ]
    )
    rate = w + n * (w @ n)  # momentum over the moment across: twice that along the axis
    size = np.linalg.norm(rate)
    way = rate / size
    along, across = way[2] * (way @ n), np.cross(way, n)[2]

    def height(t):
        c, s = np.cos(size * t), np.sin(size * t)
        up = n[2] * c + across * s + along * (1.0 - c)
        low = 0.1 * np.sqrt(np.maximum(1.0 - up * up, 0.0)) + thick
        return 0.3 + v[2] * t - 0.5 * 9.81 * t * t - low

    return height


@pytest.mark.parametrize("name", ROUND)
def test_tumbling_rings_land_when_their_lowest_point_does(name):
    """By the closed form of a free symmetric top, at up to 100 rad/s."""
    rng = np.random.default_rng(3)
    q = rng.normal(size=(40, 4))
    q /= np.linalg.norm(q, axis=1)[:, None]
    q[0] = 1.0, 0.0, 0.0, 0.0  # as level as it is thrown from a hand
    w = rng.normal(size=(40, 3)) * np.geomspace(1.0, 40.0, 40)[:, None]
    v = rng.normal(size=(40, 3)) * 0.3

    def first(q, w, v):
        run = thrown(ROUND[name], q, w, v)
        return run.code, run.switches.time[0]

    codes, times = jax.jit(jax.vmap(first))(q, w, v)
    assert (np.asarray(codes) == rk.Code.COMPLETED).all()
    fine = np.linspace(0.0, 0.28, 20001)  # a turn of 1e-3 rad at 100 rad/s
    for k in range(40):
        height = heights(q[k], w[k], v[k], 0.02 if name == "torus" else 0.0)
        below = height(fine) <= 0.0
        if not below.any():
            assert np.isnan(times[k]) or times[k] == 0.0
            continue
        i = int(np.argmax(below))
        wanted = brentq(height, fine[i - 1], fine[i], xtol=1e-15)
        # 1e-12 a step, of about 60, of a turn of 30 rad and 0.1 m, at 0.5 m/s or faster
        np.testing.assert_allclose(times[k], wanted, rtol=0.0, atol=4e-10)


@pytest.mark.parametrize("name", ROUND)
def test_a_ring_thrown_level_has_derivatives(name):
    """Where it starts a whole circle is the nearest; it was refused, or NaN."""

    def of(x):
        run = thrown(ROUND[name], tilted(0.0), x[:3], x[3:])
        return jnp.append(run.final_state.parts.angular_velocity, run.switches.time[0])

    x = jnp.array([1.0, 0.2, 0.5, 0.1, 0.0, 0.1])
    forward, reverse = jax.jacfwd(of)(x), jax.jacrev(of)(x)
    assert np.isfinite(forward).all()
    np.testing.assert_allclose(forward, reverse, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("name", ROUND)
def test_a_ring_that_comes_down_level_ends_there(name):
    """Nothing turns it: the whole circle touches at once."""
    run = thrown(ROUND[name], tilted(0.0), jnp.array([0.0, 0.0, 3.0]), jnp.zeros(3))
    assert run.code == rk.Code.SURFACE_EDGE
    thick = 0.02 if name == "torus" else 0.0
    wanted = np.sqrt(2.0 * (0.3 - thick) / 9.81)
    # the gap is known to 64 roundings of less than 1 m, at 2 m/s
    np.testing.assert_allclose(run.final_time, wanted, rtol=0.0, atol=1e-14)
