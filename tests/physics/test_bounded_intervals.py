"""Intervals where a bound holds an estimate, of a model that is linear.

A ball that rolls on by itself is at ``x + r w t``; chi2 with either number held has
its least in closed form, within a bound of the other, too.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import optimize, stats

import rollkane as rk

RADIUS, SIGMA, LEAST = 0.1, 0.01, 1.0
TIMES = np.linspace(0.0, 1.0, 12)
SLOPES = np.stack([np.ones(TIMES.size), RADIUS * TIMES], axis=1) / SIGMA


def _samples(below):
    """Places of a ball, as from so many deviations below the bound."""
    noise = SIGMA * np.random.default_rng(0).standard_normal(TIMES.size)
    error = np.sqrt(np.linalg.inv(SLOPES.T @ SLOPES)[0, 0])
    free = np.linalg.lstsq(SLOPES, noise / SIGMA, rcond=None)[0]
    wanted = np.array([LEAST - below * error, 1.0])
    return SIGMA * SLOPES @ (wanted - free) + noise


def _fit(samples, loss="linear", speed=None):
    scene = rk.Scene(rk.Body(1.0, 0.004 * np.eye(3), rk.Sphere(RADIUS)))
    turn = (0.0, 0.8 if speed is None else speed[0] + 0.1, 0.0)
    start = rk.place(scene, (1.0, 0.0, 0.0, 0.0), turn, (1.02, 0.0, 0.0))
    place = rk.Observed(
        lambda scene, t, state: rk.contact_of(scene, t, state).position[:1],
        jnp.asarray(samples)[:, None],
        sigma=SIGMA,
    )
    free = [
        rk.Free("start.contact_on_base[0]", bounds=(LEAST, None)),
        rk.Free("start.angular_velocity[1]", bounds=speed),
    ]
    return rk.fit(scene, start, rk.Record(TIMES, {"place": place}), free, loss=loss)


def _ends(samples, held, level):
    """Of one number, where the least chi2 within the other's bound has risen."""
    other = 1 - held
    box = (LEAST, -np.inf)

    def least(x):
        left = samples / SIGMA - SLOPES[:, held] * x
        best = SLOPES[:, other] @ left / (SLOPES[:, other] @ SLOPES[:, other])
        best = max(best, box[other])
        return np.sum((left - SLOPES[:, other] * best) ** 2)

    lowest, wide = box[held], 20.0 * SIGMA / RADIUS
    first = max(lowest, (LEAST, 1.0)[held] - wide)
    found = optimize.minimize_scalar(
        least, bounds=(first, first + 2.0 * wide), options={"xatol": 1e-12}
    )
    best = first if least(first) < found.fun else found.x
    rise = stats.norm.ppf(0.5 + 0.5 * level) ** 2
    over = lambda x: least(x) - least(best) - rise
    low = lowest if over(first) < 0.0 else optimize.brentq(over, first, best)
    return low, optimize.brentq(over, best, best + 2.0 * wide)


@pytest.mark.parametrize("below", [0.2, 1.5])
def test_what_a_bound_holds_is_not_known_the_better(below):
    """Of a number on its bound the interval has a width, of the other both sides."""
    samples = _samples(below)
    found = _fit(samples)
    assert found.estimates["start.contact_on_base[0]"] == LEAST
    for held, path in enumerate(found.estimates):
        known = _ends(samples, held, 0.9)
        # the closed form's minimum is good to 1e-7 of an error, as runs are
        width = known[1] - known[0]
        np.testing.assert_allclose(
            found.interval(path, level=0.9), known, rtol=0.0, atol=1e-5 * width
        )


def test_without_a_bound_that_holds_intervals_are_those_of_standard_errors():
    found = _fit(_samples(-4.0))
    for path, error in found.standard_errors.items():
        low, high = found.interval(path)
        assert abs((high - low) / (2.0 * stats.norm.ppf(0.975) * error) - 1.0) < 1e-12


def test_a_robust_loss_widens_them():
    """As it does its standard errors where no bound holds."""
    inside, held = _fit(_samples(-4.0), "huber"), _fit(_samples(0.0), "huber")
    path = "start.contact_on_base[0]"
    low, high = held.interval(path)
    known = stats.norm.ppf(0.975) * float(inside.standard_errors[path])
    assert low == LEAST
    # on the bound by next to nothing: half of the interval without it
    assert abs((high - low) / known - 1.0) < 0.05


@pytest.mark.parametrize("below", [-0.5, 0.2, 30.0])
def test_draws_of_a_number_with_a_bound_are_within_it(below):
    """Of the normal distribution without the bound what lies inside, exactly."""
    samples = _samples(below)
    joint = rk.FitCovariance(_fit(samples))
    free = np.linalg.lstsq(SLOPES, samples / SIGMA, rcond=None)[0]
    known = np.linalg.inv(SLOPES.T @ SLOPES)
    error, slope = np.sqrt(known[0, 0]), known[1, 0] / known[0, 0]
    rest = np.sqrt(known[1, 1] - slope * known[1, 0])
    u = np.array([[0.1, 0.7], [0.5, 0.5], [0.999, 0.02]])
    drawn = jax.jit(jax.vmap(joint.draw))(jnp.asarray(u))
    first = (LEAST - free[0]) / error
    place = stats.truncnorm(first, np.inf, free[0], error).ppf(u[:, 0])
    speed = free[1] + slope * (place - free[0]) + rest * stats.norm.ppf(u[:, 1])
    # runs, and so misfits of deviations, are good to 1e-7 of an error; a search ends
    # within 1e-3 of one
    share = 1e-3 if below < 0.0 else 1e-5
    found = drawn["start.contact_on_base[0]"] - LEAST
    np.testing.assert_allclose(found, place - LEAST, rtol=0.0, atol=share * error)
    found = drawn["start.angular_velocity[1]"]
    error = np.sqrt(known[1, 1])
    np.testing.assert_allclose(found, speed, rtol=0.0, atol=share * error)
    assert (np.asarray(drawn["start.contact_on_base[0]"]) >= LEAST).all()


@pytest.mark.parametrize(
    ("below", "up"),
    # errors below the one's bound, and of the other's bound above its estimate
    [
        (0.5, 0.5),
        pytest.param(-1.0, -1.0, marks=pytest.mark.slow),
        pytest.param(8.0, 6.0, marks=pytest.mark.slow),
    ],
)
def test_draws_of_two_numbers_with_bounds_are_of_their_joint_distribution(below, up):
    """What is left to the second counts for the first: by quadrature of its density."""
    samples = _samples(below)
    free = np.linalg.lstsq(SLOPES, samples / SIGMA, rcond=None)[0]
    known = np.linalg.inv(SLOPES.T @ SLOPES)
    errors, slope = np.sqrt(np.diag(known)), known[1, 0] / known[0, 0]
    rest = np.sqrt(known[1, 1] - slope * known[1, 0])
    least = free[1] + up * errors[1]
    joint = rk.FitCovariance(_fit(samples, speed=(least, None)))
    count = 4096
    u = jnp.asarray(np.random.default_rng(0).random((count, 2)))
    draw = jax.jit(jax.vmap(joint.draw))
    drawn = {path: np.asarray(x) for path, x in draw(u).items()}
    first = max(LEAST, free[0] - 8.0 * errors[0])
    place = np.linspace(first, first + 16.0 * errors[0], 40001)
    middle = free[1] + slope * (place - free[0])
    log = stats.norm.logpdf(place, free[0], errors[0])
    log += stats.norm.logsf(least, middle, rest)
    density = np.exp(log - log.max())
    cdf = lambda x: np.interp(x, place, np.cumsum(density) / density.sum())
    x, speed = drawn["start.contact_on_base[0]"], drawn["start.angular_velocity[1]"]
    assert (x >= LEAST).all()
    assert (speed >= least).all()
    assert stats.kstest(x, cdf).pvalue > 1e-3
    # given the first, the second is normal within its bound, by itself
    middle = free[1] + slope * (x - free[0])
    given = stats.truncnorm((least - middle) / rest, np.inf, middle, rest).cdf(speed)
    assert stats.kstest(given, "uniform").pvalue > 1e-3
    # one after the other they were something else, as far as the second's bound bears
    alone = stats.truncnorm((LEAST - free[0]) / errors[0], np.inf, free[0], errors[0])
    assert stats.kstest(x, alone.cdf).pvalue < 1e-6
    # the same of the same numbers, whoever draws beside them: to roundings, as programs
    # of other shapes have others
    again = draw(u[100:104])
    for path, known in drawn.items():
        np.testing.assert_allclose(again[path], known[100:104], rtol=1e-14)
    assert "tilt" in joint.spec()
