"""Derivatives where a motion is simpler than its neighbours: at rest, and steady."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk

LEVEL, STILL = (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
BALL = rk.Body(1.0, 0.004 * np.eye(3), rk.Sphere(0.1))
METHODS = "native", "diffrax"


def at_the_bottom(w, times, method):
    """Place of a ball that starts at the bottom of a bowl of radius 1 m."""
    scene = rk.Scene(BALL, rk.Base(rk.Sphere(1.0, inside=True)))
    start = rk.place(scene, LEVEL, jnp.stack([w, 0.0 * w, 0.0 * w]), (0.0, 0.0, -1.0))
    return rk.simulate(scene, start, times, rtol=1e-10, method=method).position[-1, 1]


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("span", [10.0, 60.0])
def test_a_ball_at_rest_in_a_bowl(method, span):
    times = np.array([0.0, span])
    w = np.sqrt(5 / 7 * 9.81 / 0.9)  # of small oscillations
    slope = jax.grad(at_the_bottom)(jnp.asarray(0.0), times, method)
    # y'(0) = -0.1 m; ten tolerances a step, some steps a radian, of an amplitude of
    # 0.1 / w
    exact = -0.1 * np.sin(w * span) / w
    assert abs(slope - exact) < 1e-9 * 10 * (1.0 + w * span) * 0.1 / w
    _, forward = jax.jvp(
        lambda w: at_the_bottom(w, times, method), (jnp.asarray(0.0),), (jnp.ones(()),)
    )
    # the same steps, both ways: roundings of some thousand operations of 0.1 m s / rad
    assert abs(forward - slope) < 1e-12


def test_a_disc_that_rolls_straight_on():
    """Its lean, an unstable one: the closed form of the linear equations."""
    radius, speed, g = 0.1, 0.3, 9.81
    disc = rk.Body(
        1.0, 1.0 * radius**2 * np.diag([0.25, 0.25, 0.5]), rk.DiscEdge(radius)
    )
    scene = rk.Scene(disc)
    upright = (np.sqrt(0.5), np.sqrt(0.5), 0.0, 0.0)
    spin = speed / radius

    def lean(w):
        along = jnp.stack([w, spin + 0.0 * w, 0.0 * w])
        start = rk.place(scene, upright, along, STILL)
        run = rk.simulate(scene, start, np.array([0.0, 0.4]), rtol=1e-10)
        return run.position[-1, 2]

    # z = radius cos(lean) is of second order: its first derivative is zero, its second
    # that of the lean's growth
    h = 1e-3
    second = (lean(h) - 2 * lean(0.0) + lean(-h)) / h**2
    rate = np.sqrt(g / radius * 0.8 - spin**2 * 2.4)
    grown = np.sinh(rate * 0.4) / rate
    # the fourth derivative times h^2 / 12, and roundings 1e-11 / h^2
    assert abs(second + radius * grown**2) < 1e-3 * radius * grown**2
    slope = jax.grad(lean)(jnp.asarray(0.05))
    # of the second order: 1.0e-6 of it at this h, a quarter of that at half of it
    off = (lean(0.05 + h) - lean(0.05 - h)) / (2 * h)
    assert abs(slope - off) < 1e-5 * abs(slope)


def pulse(t, size):
    """A push to one side, between 0.4 s and 0.6 s, in the middle of a rest."""
    share = (t - 0.4) / 0.2
    on = (share > 0.0) & (share < 1.0)
    inside = jnp.where(on, share, 0.5)
    height = jnp.where(on, (inside * (1.0 - inside)) ** 3, 0.0)
    return size * height * jnp.array([1.0, 0.0, 0.0])


@pytest.mark.parametrize("method", METHODS)
def test_a_push_that_is_not_there(method):
    """Of a force of no size, only the derivative tells that there could be one."""

    def pushed(size):
        push = lambda t, point, size: pulse(t, size)
        scene = rk.Scene(BALL, loads=(rk.Gravity(), rk.Force(push, parameters=size)))
        start = rk.place(scene, LEVEL, STILL, STILL)
        run = rk.simulate(scene, start, [0.0, 1.0], rtol=1e-10, method=method)
        return run.velocity[-1, 0]

    slope = jax.grad(pushed)(jnp.asarray(0.0))
    # a ball that is pushed at its centre: 5/7 of the impulse, of 0.2 s times the beta
    # function B(4, 4) = 1 / 140; steps of 1/32 s of the whole are seven a pulse, and
    # the eighth order leaves some 1e-4 of it
    exact = 5 / 7 * 0.2 / 140
    assert abs(slope - exact) < 1e-3 * exact
