"""Fits with a number that no record sees: it stays, and others are as without it."""

import jax
import numpy as np
import pytest

import rollkane as rk

TIMES = np.linspace(0.0, 1.2, 121)
SLOPE = 0.2  # [rad]
PULL = 9.81 * np.sin(SLOPE), 0.0, -9.81 * np.cos(SLOPE)
BALL = rk.Body(1.0, 4e-3 * np.eye(3), rk.Sphere(0.1))
SCENE = rk.Scene(BALL, loads=(rk.Gravity(PULL),))
GUESS = (0.02, 0.02, 0.04)
ARM, SPIN = rk.Free("acc.at"), rk.Free("start.angular_velocity")


def rolling(spin):
    """Down a slope of the x-axis, with the angular velocity given."""
    return rk.place(SCENE, (1.0, 0.0, 0.0, 0.0), spin, (0.0, 0.0, 0.0))


def record(spin=(0.0, 1.5, 0.0), seed=0):
    """A gyro, and an accelerometer at (0.03, 0.02, 0.05) m."""
    run = rk.simulate(SCENE, rolling(spin), TIMES, rtol=1e-11)
    truth = rk.Accelerometer(np.zeros((121, 3)), sigma=0.05, at=(0.03, 0.02, 0.05))
    observed = jax.vmap(lambda t, y: truth.observed(SCENE, t, y))(run.time, run.state)
    random = np.random.default_rng(seed)
    rates = np.asarray(run.state.angular_velocity)
    rates = rates + 0.01 * random.standard_normal((121, 3))
    pulls = np.asarray(observed) + 0.05 * random.standard_normal((121, 3))
    channels = {
        "gyro": rk.Gyro(rates, sigma=0.01),
        "acc": rk.Accelerometer(pulls, sigma=0.05, at=GUESS),
    }
    return rk.Record(TIMES, channels)


def fitted(free, **options):
    return rk.fit(SCENE, rolling((0.0, 1.3, 0.0)), record(), free, **options)


@pytest.mark.parametrize("bias", [False, True])
@pytest.mark.parametrize("strategy", ["single", "progressive"])
def test_an_arm_along_the_axis_of_a_straight_roll(bias, strategy):
    """It is where the guess has it, and the errors of the others are those without it.

    A firm prior of the arm along the axis holds it; the others' are of 1 km.
    """
    more = [rk.Free("acc.bias")] if bias else []
    found = fitted([ARM, SPIN, *more], strategy=strategy)
    prior = rk.Free("acc.at", prior=(GUESS, (1e3, 1e-9, 1e3)))
    held = fitted([prior, SPIN, *more], strategy=strategy)
    assert found.converged
    assert found.unseen == ("acc.at[1] is not seen",)
    # a pull to the guess over short horizons, by what noise tells of it: 1e-5 of it
    assert found.estimates["acc.at"][1] == pytest.approx(0.02, rel=1e-4)
    for path, errors in held.standard_errors.items():
        own = found.standard_errors[path]
        seen = np.array([True, path != "acc.at", True])
        assert np.isinf(own[~seen]).all()
        # roundings of runs, and minima good to 1e-3 of a deviation
        np.testing.assert_allclose(own[seen], errors[seen], rtol=2e-3)
        apart = found.estimates[path] - held.estimates[path]
        assert (np.abs(apart[seen]) < 0.02 * errors[seen]).all()
    place = found.names.index("acc.at[1]")
    others = np.delete(found.correlation[place], place)
    np.testing.assert_array_equal(others, 0.0)


def test_profiles_are_those_without_it():
    found = fitted([ARM, SPIN])
    low, high = found.interval("start.angular_velocity", method="profile")
    linear = found.interval("start.angular_velocity")
    width = linear[1] - linear[0]
    # the problem is nearly linear in the spin
    assert (np.abs(low - linear[0]) < 0.01 * width).all()
    assert (np.abs(high - linear[1]) < 0.01 * width).all()


def test_another_record_that_shows_it():
    """A roll that also spins about x: the arm along y is at 0.02 m."""
    starts = [rolling((0.0, 1.3, 0.0)), rolling((0.8, 1.3, 0.0))]
    records = [record(), record((1.0, 1.5, 0.0), seed=1)]
    guess = rk.Free("acc.at", prior=((0.02, 0.2, 0.04), 10.0))
    for arm in (ARM, guess):
        found = rk.fit(SCENE, starts, records, [arm, SPIN])
        assert found.unseen == ()
        error = found.standard_errors["acc.at"][1]
        assert error < 1e-3
        assert abs(found.estimates["acc.at"][1] - 0.02) < 4.0 * error


def test_a_spin_that_the_guess_has_not():
    """One of 1 rad/s about x shows the arm after all."""
    start = rolling((0.0, 1.3, 0.0))
    found = rk.fit(SCENE, start, record((1.0, 1.5, 0.0), seed=1), [ARM, SPIN])
    assert found.converged
    assert found.unseen == ()
    error = found.standard_errors["acc.at"]
    assert error[1] < 0.01
    assert (np.abs(found.estimates["acc.at"] - [0.03, 0.02, 0.05]) < 4 * error).all()
