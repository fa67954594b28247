"""Derivatives through changes of the contact: eccentric bodies on moving bases.

Forward against reverse mode, and both against central differences of steps h and h / 2,
extrapolated: of order h^4, 1e-12 of a number for h = 1e-3, over a rounding of the runs
of 1e-11 / 1e-3 at rtol 1e-11.
"""

import functools
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk

UP, STILL = (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
INERTIA = 0.01 * np.array([[1.0, 0.1, 0.05], [0.1, 1.4, -0.08], [0.05, -0.08, 1.2]])
STEP = 1e-3
DIFFERS, PROMISED = 1e-6, 1e-9


def sideways(t, p):
    return jnp.stack([jnp.sin(p * t), 0.6 * jnp.sin(p * t + 1.0), 0.0 * t]) * 0.02


def beside(t, p):
    """Along x, and as much across as the second number says."""
    return jnp.stack([jnp.sin(p[0] * t), p[1] * jnp.cos(p[0] * t), 0.0 * t]) * 0.02


def upwards(t, p):
    return jnp.stack([0.3 * jnp.sin(p * t + 0.5), 0.0 * t, jnp.sin(p * t)]) * 0.02


def scene_of(radius, frequency, motion, law=None):
    body = rk.Body(2.0, INERTIA, rk.Sphere(radius, (0.02, -0.01, 0.03)))
    moving = rk.BaseMotion(motion, parameters=frequency)
    return rk.Scene(body, rk.Base(rk.Plane(), moving), contact=law)


def seen(run):
    """Times and states of the first two changes, and the end."""
    s = run.switches
    changes = s.time[:2], s.state.angular_velocity[:2].ravel()
    ends = run.angular_velocity[-1], run.position[-1]
    kept = jnp.where(jnp.isnan(s.time[:2]), 0.0, changes[0])
    return jnp.concatenate([kept, jnp.nan_to_num(changes[1]), *ends])


def grips(x):
    """A slip that curves until it ends: by mu, frequency, slip, radius."""
    mu, frequency, first, second, radius = x
    law = rk.Slipping(rk.CoulombFriction(mu))
    slips = scene_of(radius, frequency, sideways, law)
    slip = jnp.stack([first, second, 0.0 * first])
    start = rk.place(slips, UP, (1.0, -2.0, 3.0), STILL, slip=slip)
    scene = scene_of(radius, frequency, sideways)
    modes = rk.Modes(friction=mu, switches=4)
    return rk.simulate(scene, start, [0.0, 0.8], modes=modes, rtol=1e-11)


def slips(x):
    """Rolling that begins to slip, and grips again: by mu, frequency, spin, radius.

    The slip turns until it has ended, ever faster: by 20 degrees in its last 1e-5 s.
    """
    mu, frequency, spin, radius = x
    scene = scene_of(radius, frequency, sideways)
    turning = jnp.stack([0.5 * spin, spin, 2.0 + 0.0 * spin])
    start = rk.place(scene, UP, turning, STILL)
    modes = rk.Modes(friction=mu, switches=16)
    return rk.simulate(scene, start, [0.0, 0.45], modes=modes, rtol=1e-11)


def slips_straight(x):
    """In a plane, seen from beside: by mu, frequency, spin, and what is across."""
    mu, frequency, spin, across = x
    body = rk.Body(2.0, np.diag(np.diag(INERTIA)), rk.Sphere(0.12, (0.02, 0.0, 0.03)))
    numbers = jnp.stack([frequency, across - 1.0])
    scene = rk.Scene(
        body, rk.Base(rk.Plane(), rk.BaseMotion(beside, parameters=numbers))
    )
    turning = jnp.stack([0.0 * spin, spin, 0.0 * spin])
    start = rk.place(scene, UP, turning, STILL)
    modes = rk.Modes(friction=mu, switches=16)
    return rk.simulate(scene, start, [0.0, 0.45], modes=modes, rtol=1e-11)


def lifts_and_lands(x, rubs=True):
    """A plate that throws the body up, and is hit: by all that has a part in it."""
    mu, e, frequency, spin, radius = x
    scene = scene_of(radius, frequency, upwards)
    start = rk.place(scene, UP, jnp.stack([0.5 * spin, spin, 0.0 * spin]), STILL)
    modes = rk.Modes(friction=mu if rubs else None, restitution=e, switches=16)
    return rk.simulate(scene, start, [0.0, 0.32], modes=modes, rtol=1e-11)


def bounces(x):
    """An ellipsoid let go in a bowl: of three impacts the last one grips, slowly."""
    mu, e, spin, height, across = x
    body = rk.Body(
        1.2, np.diag([0.004, 0.005, 0.003]), rk.Ellipsoid((0.1, 0.08, across))
    )
    bowl = rk.Graph(lambda x, y: 0.35 * x * x + 0.45 * y * y)
    scene = rk.Scene(body, rk.Base(bowl))
    turn = np.array([0.9, 0.3, 0.2, 0.1]) / np.sqrt(0.95)
    turning = jnp.stack([spin, 1.0 + 0.0 * spin, 2.0 + 0.0 * spin])
    place = jnp.stack([0.1 + 0.0 * height, 0.05 + 0.0 * height, height])
    start = rk.release(scene, turn, turning, place, (0.3, 0.1, -0.5))
    modes = rk.Modes(friction=mu, restitution=e, switches=8)
    return rk.simulate(scene, start, [0.0, 0.55], modes=modes, rtol=1e-11)


class Case(NamedTuple):
    """A run by some numbers, those numbers, and what changes first."""

    run: Callable
    at: tuple[float, ...]
    changes: tuple[tuple[int, int], ...]


ROLL, SLIP, FLY = rk.Mode.ROLLING, rk.Mode.SLIPPING, rk.Mode.FLYING
CASES = {
    "a grip that curves": Case(grips, (0.25, 14.0, 0.8, -0.5, 0.12), ((SLIP, ROLL),)),
    "a slip and a grip": Case(
        slips, (0.2, 14.0, 3.0, 0.12), ((ROLL, SLIP), (SLIP, ROLL))
    ),
    "a slip in a plane": Case(
        slips_straight, (0.2, 14.0, 3.0, 1.0), ((ROLL, SLIP), (SLIP, ROLL))
    ),
    "lift-off and landing": Case(
        lifts_and_lands, (0.3, 0.6, 32.0, 2.0, 0.12), ((FLY, FLY),)
    ),
    "bounces in a bowl": Case(bounces, (0.3, 0.6, 2.0, 0.35, 0.06), ((FLY, FLY),)),
    "landing without slip": Case(
        functools.partial(lifts_and_lands, rubs=False),
        (0.3, 0.6, 32.0, 2.0, 0.12),
        ((ROLL, FLY), (FLY, FLY)),
    ),
}


def test_the_end_of_a_slip_that_curves():
    """By the friction alone, forwards: the others, and reverse, take minutes."""
    at = jnp.array(CASES["a grip that curves"].at)
    value = jax.jit(lambda mu: seen(grips(at.at[0].set(mu))))
    mu, one = at[0], jnp.ones_like(at[0])
    found = np.asarray(jax.jit(lambda m: jax.jvp(value, (m,), (one,))[1])(mu))
    difference = lambda h: (value(mu + h) - value(mu - h)) / (2.0 * h)
    h = STEP * float(mu)
    expected = np.asarray((4.0 * difference(0.5 * h) - difference(h)) / 3.0)
    assert np.abs(expected).max() > 1.0
    largest = np.abs(expected[2:]).max()  # of velocities and places; behind it the time
    assert np.abs(found - expected)[0] < DIFFERS * np.abs(expected[0])
    assert (np.abs(found - expected) < DIFFERS * largest).all()


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_derivatives_through_changes(name):
    run, at, changes = CASES[name]
    at = jnp.array(at)
    found = run(at)
    s = found.switches
    pairs = list(zip(s.before.tolist(), s.after.tolist(), strict=True))
    assert found.succeeded
    assert set(changes) <= set(pairs[: int(s.count)])
    whole = lambda x: seen(run(x))
    value = jax.jit(whole)
    forward = np.asarray(jax.jit(jax.jacfwd(whole))(at))
    expected = []
    for way in jnp.eye(at.shape[0]) * at[:, None]:
        difference = lambda h, way=way: (
            (value(at + h * way) - value(at - h * way)) / (2.0 * h)
        )
        fine = (4.0 * difference(0.5 * STEP) - difference(STEP)) / 3.0
        expected.append(np.asarray(fine))
    expected = np.stack(expected, axis=1)
    forward = forward * np.asarray(at)
    size = np.abs(expected).max(axis=1, keepdims=True)
    size[size == 0.0] = 1.0
    assert (np.abs(forward - expected) < DIFFERS * size).all()
    pull = jax.jit(lambda ct: jax.vjp(whole, at)[1](ct)[0])
    reverse = np.stack([pull(row) for row in jnp.eye(forward.shape[0])])
    assert (np.abs(reverse * np.asarray(at) - forward) < PROMISED * size).all()


@pytest.mark.slow
def test_a_landing_that_lifts_off_at_once():
    """Without a rebound, on a plate that falls faster than the body: by height, time.

    It takes the plate's velocity, and flies on. Both changes are at one time, which the
    second has from the first: its own value, the normal force, has no zero there.
    """
    A, w, g, first, last = 0.1, 20.0, 9.81, 3.0, 0.15
    ball = rk.Body(1.0, 0.004 * np.eye(3), rk.Sphere(0.1))

    def plate(t):
        return A * jnp.sin(w * (t - first))

    moves = lambda t: jnp.stack([0.0 * t, 0.0 * t, plate(t)])
    scene = rk.Scene(ball, rk.Base(rk.Plane(), rk.BaseMotion(moves)))
    modes = rk.Modes(friction=0.3, restitution=0.0)

    def run(x):
        """By the height of the gap, and how much later the body is let go."""
        height, late = x
        begin = first + late
        start = rk.release(
            scene, UP, STILL, jnp.stack([0.0, 0.0, 0.1 + height]), STILL, time=begin
        )
        times = jnp.stack([begin, first + last])
        return rk.simulate(scene, start, times, modes=modes, rtol=1e-11)

    def found(x):
        it = run(x)
        ends = it.position[-1, 2], it.velocity[-1, 2]
        return jnp.stack([*it.switches.time[:2], *ends])

    at = jnp.array([0.131, 0.0])
    it = run(at)
    assert it.succeeded
    changes = it.switches.before[:2].tolist(), it.switches.after[:2].tolist()
    assert int(it.switches.count) == 2
    assert changes == ([FLY, ROLL], [ROLL, FLY])

    lands = float(it.switches.time[0])
    pace, push = A * w * np.cos(w * (lands - first)), -w * w * float(plate(lands))
    fallen, left = g * (lands - first), first + last - lands
    # the gap h - g (t - late)^2 / 2 - z(t) = 0, and z(t) + v left - g left^2 / 2
    of_lands = np.array([1.0, fallen]) / (fallen + pace)
    of_ends = np.array([(push + g) * left, push + g])
    expected = np.stack([of_lands, of_lands, *np.outer(of_ends, of_lands)])
    forward = jax.jacfwd(found)(at)
    # numbers up to 41 of runs at rtol 1e-11: 4e-10 (3e-13 measured: flights are exact)
    np.testing.assert_allclose(forward, expected, rtol=0.0, atol=PROMISED)
    reverse = jax.jacrev(found)(at)
    np.testing.assert_allclose(reverse, expected, rtol=0.0, atol=PROMISED)


def test_a_start_that_lifts_off_at_once():
    """On a plate that falls faster than the body: by the times of start and end.

    It flies from the start on, with the plate's velocity; the change's time is that.
    """
    A, w, g = 0.1, 20.0, 9.81
    plate = lambda t: A * jnp.sin(w * t)
    moves = lambda t: jnp.stack([0.0 * t, 0.0 * t, plate(t)])
    ball = rk.Body(1.0, 0.004 * np.eye(3), rk.Sphere(0.1))
    scene = rk.Scene(ball, rk.Base(rk.Plane(), rk.BaseMotion(moves)))
    modes = rk.Modes(friction=0.3)

    def found(times):
        start = rk.place(scene, UP, STILL, STILL, time=times[0])
        run = rk.simulate(scene, start, times, modes=modes, rtol=1e-11)
        ends = run.position[-1, 2], run.velocity[-1, 2]
        return jnp.stack([run.switches.time[0], *ends])

    def known(times):
        begin, left = times[0], times[1] - times[0]
        pace = jax.grad(plate)(begin)
        rise = pace * left - 0.5 * g * left**2
        return jnp.stack([begin, 0.1 + plate(begin) + rise, pace - g * left])

    times = jnp.array([0.07, 0.12])
    expected = jax.jacfwd(known)(times)
    # numbers up to 30 of runs at rtol 1e-11: 3e-10
    np.testing.assert_allclose(found(times), known(times), rtol=0.0, atol=PROMISED)
    for derivative in (jax.jacfwd, jax.jacrev):
        slope = derivative(found)(times)
        np.testing.assert_allclose(slope, expected, rtol=0.0, atol=PROMISED)


@pytest.mark.slow
def test_the_direction_of_a_slip_that_has_just_begun():
    """A plate whose acceleration a turns: F = mu m g a / |a|, but for a lag.

    It slips from 2/7 |a| > mu g. The second output is the end of the step behind which
    the slip has its own direction (it is faster than 1e-5 m/s, and was not before).
    """
    mu, g, A, p = 0.2, 9.81, 10.0, 60.0
    ball = rk.Body(1.0, 0.004 * np.eye(3), rk.Sphere(0.1))
    moves = lambda t, p: jnp.stack([A * t**3 / 6.0, p * t**4 / 24.0, 0.0 * t])
    pushes = lambda t, p: jnp.stack([A * t, p * t**2 / 2.0])
    half = 2.0 * A**2 / p**2
    onset = np.sqrt(np.sqrt(half**2 + (2.0 * 3.5 * mu * g / p) ** 2) - half)
    times = np.array([0.0, onset + 5e-4, onset + 9.9e-4])

    def scene(p):
        return rk.Scene(ball, rk.Base(rk.Plane(), rk.BaseMotion(moves, parameters=p)))

    start = rk.place(scene(p), UP, STILL, STILL)

    def force(p):
        modes = rk.Modes(friction=mu)
        run = rk.simulate(scene(p), start, times, modes=modes, rtol=1e-12)
        return run.contact_force[1:, :2], run.state.parts.slip[1:]

    def known(p):
        along = jax.vmap(lambda t: pushes(t, p))(times[1:])
        return mu * g * along / jnp.linalg.norm(along, axis=1, keepdims=True)

    found, slip = force(p)
    speed = np.linalg.norm(slip, axis=1)
    assert speed[0] < 1e-5 < speed[1] < 2e-5
    # a slip r lags by r / (3.5 mu g + r') of how its way turns, 1.2 rad/s: 2e-6 rad of
    # 1.2e-5 m/s; that settles in R / (3.5 mu g) = 1.5e-6 s, to 0.6 %, and r' is 0.6 %
    angles = lambda force: np.arctan2(force[:, 1], force[:, 0])
    turn = p / (2.0 * A) / (1.0 + (p * times[1:] / (2.0 * A)) ** 2)
    lag = angles(known(p)) - angles(found)
    np.testing.assert_allclose(lag, speed * turn / (3.5 * mu * g), rtol=0.02)
    np.testing.assert_allclose(found, known(p), atol=5e-6)
    # their derivatives: r moves with the onset, in 1e-3 of p to 1e-10 m/s of 6e-8
    fast = lambda p: np.linalg.norm(force(p)[1], axis=1)
    faster = (fast(p + 1e-3) - fast(p - 1e-3)) / 2e-3 * turn / (3.5 * mu * g)
    across = np.stack([-found[:, 1], found[:, 0]], axis=1)
    expected = jax.jacfwd(known)(p) - faster[:, None] * across
    for mode in (jax.jacfwd, jax.jacrev):
        by_p = mode(lambda p: force(p)[0])(p)
        off = np.abs(by_p - expected)
        assert np.max(off) < 0.1 * mu * g * np.min(np.abs(faster))
