"""What priors and channels of their own sizes leave of the others' errors."""

import numpy as np
import pytest

import rollkane as rk

UP, STILL = (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
TIMES = np.linspace(0.0, 0.6, 31)
SCENE = rk.Scene(rk.Body(1.0, np.diag([4e-3, 5e-3, 6e-3]), rk.Sphere(0.1)))
START = rk.place(SCENE, UP, (1.0, 2.0, 3.0), STILL)
SPIN = rk.Free("start.angular_velocity")


@pytest.fixture(scope="module")
def record():
    run = rk.simulate(SCENE, START, TIMES, rtol=1e-11)
    random = np.random.default_rng(5)
    noise = lambda: random.standard_normal((31, 3))
    rates = np.asarray(run.state.angular_velocity) + 0.02 * noise()
    places = np.asarray(run.position) + 1e-3 * noise()
    places[::7] += 0.02  # outliers, for the losses that weigh them less
    channels = {"gyro": rk.Gyro(rates, 0.02), "camera": rk.Position(places, 1e-3)}
    return rk.Record(TIMES, channels)


def errors_with(record, deviation, loss):
    prior = STILL, (0.5, 0.5, deviation)
    bias = rk.Free("camera.bias", prior=prior)
    found = rk.fit(SCENE, START, record, [SPIN, bias], loss=loss, rtol=1e-11)
    assert found.unseen == ()
    assert found.degrees_of_freedom == 2 * 31 * 3 + 3 - 6
    return found, np.concatenate(list(found.standard_errors.values()))


@pytest.mark.parametrize("loss", ["linear", "cauchy"])
def test_a_firm_prior_hides_nothing(record, loss):
    """Whether a number is known to 1e-6 or 1e-11 m is all one to the others.

    The record alone tells it to 2e-4 m, so that what is left of it moves their
    variances by its square over that one's, 2.5e-5; and minima are good to 1e-3 of a
    deviation.
    """
    _, loose = errors_with(record, 1e-6, loss)
    for deviation in (3e-9, 1e-11):
        found, firm = errors_with(record, deviation, loss)
        np.testing.assert_allclose(firm[:5], loose[:5], rtol=1e-3)
        np.testing.assert_allclose(firm[5], deviation, rtol=1e-3)
        # named numbers, and draws, have them from the same covariance
        assert np.linalg.eigvalsh(found.correlation)[0] > 0.0
        np.testing.assert_allclose(np.sqrt(np.diag(found.covariance)), firm, rtol=1e-9)


def test_firm_priors_of_six_numbers_hide_nothing(record):
    """An inertia that is known to 1e-13 kg m^2 is as good as given."""
    alone = rk.fit(SCENE, START, record, [SPIN], rtol=1e-11)
    inertia = rk.Free("body.inertia", prior=(np.diag([4e-3, 5e-3, 6e-3]), 1e-13))
    found = rk.fit(SCENE, START, record, [SPIN, inertia], rtol=1e-11)
    assert found.unseen == ()
    path = "start.angular_velocity"
    # the same search but for inertias of 1e-13 kg m^2: rates by 1e-10 of their size
    own, known = found.standard_errors[path], alone.standard_errors[path]
    np.testing.assert_allclose(own, known, rtol=1e-6)


def test_an_estimated_noise_is_without_what_was_fitted_to_it(record):
    """A mean taken out of n samples: their deviation with n - 1, beside any others."""
    random = np.random.default_rng(6)
    run = rk.simulate(SCENE, START, TIMES, rtol=1e-11)
    noise = np.array([1e-3, 2e-3, 4e-3]) * random.standard_normal((31, 3))
    noise[np.arange(31) % 5 != 0] = np.nan  # 7 samples
    noise[10, 1] = np.nan
    camera = rk.Position(np.asarray(run.position) + noise)
    channels = {"gyro": record.channels["gyro"], "camera": camera}
    both = rk.Record(TIMES, channels)
    found = rk.fit(SCENE, START, both, [rk.Free("camera.bias")], rtol=1e-11)
    own = np.nanstd(noise, axis=0, ddof=1)
    # a search ends where chi2, 5 of a column, is 1e-6 above its least at most: 1e-7
    np.testing.assert_allclose(found.sigma["camera"], own, rtol=1e-6)


def test_the_record_has_the_estimates(record):
    """So that it, the scene and the start have the likelihood that was found."""
    free = [SPIN, rk.Free("camera.bias"), rk.Free("gyro.gain")]
    found = rk.fit(SCENE, START, record, free, rtol=1e-11)
    camera, gyro = found.record.channels["camera"], found.record.channels["gyro"]
    np.testing.assert_array_equal(camera.bias, found.estimates["camera.bias"])
    np.testing.assert_array_equal(gyro.gain, found.estimates["gyro.gain"])
    again = rk.negative_log_likelihood(
        found.scene, found.start, found.record, rtol=1e-11
    )
    # 186 squares of one run and of another at 1e-11, over deviations of 1e-3 m
    np.testing.assert_allclose(again, 0.5 * found.chi2, rtol=1e-6)
    np.testing.assert_array_equal(record.channels["camera"].bias, np.zeros(3))
