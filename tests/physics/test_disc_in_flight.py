"""Discs in flight, whose face may be nearer to an uneven base than their rim."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import minimize_scalar

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
