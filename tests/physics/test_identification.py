"""Parameters from records of known motions, with noise of a known size.

Numbers of noise are drawn with fixed seeds, so that a test passes always or never; its
limits are those that a correct estimate would pass with nearly any seed. An estimate
within four standard errors: 6e-5 of normal numbers are beyond.
"""

import dataclasses

import numpy as np
import pytest

import rollkane as rk
from rollkane.identification.fitting import problem_of
from rollkane.simulation.run_options import RunOptions

EPS = np.finfo(float).eps
FOUR = 4.0
UP, STILL = (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
ASKEW = np.array([[4e-4, 2e-5, 1e-5], [2e-5, 6e-4, -3e-5], [1e-5, -3e-5, 7e-4]])
NOISE = 0.02
# 1.2 s with gaps of two lengths
TIMES = np.cumsum(np.tile([0.02, 0.04], 20)) - 0.02
INERTIA = rk.Free("body.inertia")


def pebble(inertia=ASKEW, mass=0.5, drag=0.0):
    body = rk.Body(mass, inertia, rk.Ellipsoid((0.06, 0.05, 0.04)))
    return rk.Scene(body, loads=(rk.Gravity(), rk.Drag(angular=drag)))


def started(scene, rates=(8.0, 3.0, 2.0)):
    return rk.place(scene, UP, rates, STILL)


def gyro_of(scene, start, times=TIMES):
    return np.asarray(rk.simulate(scene, start, times).state.angular_velocity)


TRUTH = pebble()
START = started(TRUTH)
GUESS = pebble(np.diag([5e-4, 5e-4, 5e-4]))


@pytest.fixture(scope="module")
def rates():
    return gyro_of(TRUTH, START)


def noisy(values, seed, sigma=NOISE):
    return values + sigma * np.random.default_rng(seed).standard_normal(values.shape)


def record_of(values, sigma=NOISE, times=TIMES):
    return rk.Record(times, {"gyro": rk.Gyro(values, sigma)})


def within_four(found, path, truth):
    away = np.abs(found.estimates[path] - truth)
    assert (away < FOUR * found.standard_errors[path]).all(), (path, away)


def physical(inertia):
    """Positive definite, and no moment larger than the others' sum, to rounding.

    Entries are sums of six terms, and eigenvalues good to some eps of the largest.
    """
    moments = np.linalg.eigvalsh(inertia)
    rounding = 16 * EPS * moments.sum()
    assert moments[0] > 0.0
    assert moments[0] + moments[1] - moments[2] > -rounding


# What is estimated, and how well


def test_errors_are_those_of_the_noise(rates):
    """Over twenty seeds: the 95 % region, and chi2.

    The distance in units of the covariance is chi2 of 6, whose mean over 20 is 6 with
    deviation sqrt(12 / 20) = 0.77; its 95 % quantile is 12.592, and fewer than 16 of 20
    are inside with probability 0.003. chi2 / N of 20 * 114 degrees has deviation
    sqrt(2 / 2280) = 0.030, within 5 % of one in 91 of 100 such sums, and always here.
    """
    rows, columns = np.array([0, 1, 2, 0, 0, 1]), np.array([0, 1, 2, 1, 2, 2])
    distances, chi2 = [], []
    for seed in range(20):
        found = rk.fit(GUESS, START, record_of(noisy(rates, seed)), INERTIA)
        assert found.converged
        assert found.unseen == ()
        away = (found.estimates["body.inertia"] - ASKEW)[rows, columns]
        distances.append(away @ np.linalg.solve(found.covariance, away))
        assert found.degrees_of_freedom == 3 * len(TIMES) - 6
        chi2.append(found.chi2 / found.degrees_of_freedom)
        for iterate in found.iterates:
            physical(iterate["body.inertia"])
    assert sum(d < 12.592 for d in distances) >= 16
    assert abs(np.mean(distances) - 6.0) < FOUR * 0.77
    assert abs(np.mean(chi2) - 1.0) < 0.05


def test_outliers(rates):
    """A tenth of the samples thrown off by 50 deviations."""
    values = noisy(rates, 1)
    random = np.random.default_rng(2)
    thrown = random.permutation(values.size)[: values.size // 10]
    values.ravel()[thrown] += 50.0 * NOISE * random.choice([-1.0, 1.0], thrown.size)
    record = record_of(values)
    straight = rk.fit(GUESS, START, record, INERTIA)
    robust = rk.fit(GUESS, START, record, INERTIA, loss="cauchy")
    within_four(robust, "body.inertia", ASKEW)
    away = np.abs(straight.estimates["body.inertia"] - ASKEW)
    assert (away > FOUR * straight.standard_errors["body.inertia"]).any()
    with pytest.raises(rk.FieldError, match="is of chi2"):
        robust.interval("body.inertia", method="profile")


def test_missing_samples(rates):
    """A third at random, and one column altogether."""
    values = noisy(rates, 3)
    values[np.random.default_rng(4).random(values.shape) < 0.33] = np.nan
    values[:, 1] = np.nan
    found = rk.fit(GUESS, START, record_of(values), INERTIA)
    sampled = np.isfinite(values)
    assert found.degrees_of_freedom == sampled.sum() - 6
    np.testing.assert_array_equal(np.isfinite(found.residuals["gyro"]), sampled)
    within_four(found, "body.inertia", ASKEW)


def test_noise_is_estimated():
    """Three columns of 2000 samples: each to 1 / sqrt(4000) = 1.6 %, 5 % is three."""
    times = np.linspace(0.0, 2.0, 2000)
    values = noisy(gyro_of(TRUTH, START, times), 5)
    found = rk.fit(GUESS, START, record_of(values, None, times), INERTIA)
    np.testing.assert_allclose(found.sigma["gyro"], NOISE, rtol=0.05)
    within_four(found, "body.inertia", ASKEW)
    # of 6000 numbers with the deviations that they have: to the hundredth of sigma
    assert abs(found.chi2 / 6000 - 1.0) < 0.025
    for iterate in found.iterates:
        physical(iterate["body.inertia"])
    assert len(found.iterates) > 3


def test_several_motions_of_one_body():
    """One inertia, own starts that are found with it."""
    scene = TRUTH
    motions = [started(scene), started(scene, (1.0, 9.0, -3.0))]
    records = [
        record_of(noisy(gyro_of(scene, s), 6 + k)) for k, s in enumerate(motions)
    ]
    free = [INERTIA, rk.Free("start.angular_velocity")]
    guesses = [started(GUESS, (7.9, 3.1, 2.1)), started(GUESS, (1.1, 8.9, -3.1))]
    found = rk.fit(GUESS, guesses, records, free)
    assert found.converged
    within_four(found, "body.inertia", ASKEW)
    known = np.stack([np.asarray(s.angular_velocity) for s in motions])
    within_four(found, "start.angular_velocity", known)
    assert found.estimates["start.angular_velocity"].shape == (2, 3)
    assert found.degrees_of_freedom == 6 * len(TIMES) - 12
    assert "gyro {1}" in found.report()
    assert "start.angular_velocity {1}[2]" in found.report()
    low, high = found.interval("start.angular_velocity")
    # the quantile of a normal number, 1.959964
    half = 1.959964 * found.standard_errors["start.angular_velocity"]
    np.testing.assert_allclose(0.5 * (high - low), half, rtol=1e-6)


# What cannot be seen


def test_mass_and_inertia_by_their_ratio(rates):
    force = np.asarray(rk.simulate(TRUTH, START, TIMES).normal_force)
    free = [INERTIA, rk.Free("body.mass")]
    record = record_of(noisy(rates, 8))
    found = rk.fit(GUESS, START, record, free)
    (sentence,) = found.unseen
    assert "body.inertia and body.mass only by their ratio" in sentence
    assert np.isinf(found.standard_errors["body.mass"])
    assert np.isinf(found.standard_errors["body.inertia"]).all()
    assert "not seen" in found.report()
    low, high = found.interval("body.mass", method="profile")
    assert (low, high) == (0.0, np.inf)  # no mass is negative
    ratio = found.estimates["body.inertia"] / found.estimates["body.mass"]
    np.testing.assert_allclose(ratio, ASKEW / 0.5, rtol=0, atol=0.05 * 1.4e-3)
    told = rk.identifiability(GUESS, START, record, free)
    assert told.unseen == found.unseen
    assert told.condition == np.inf
    # a prior of the mass makes it known: as well as the prior, which nothing adds to
    prior = rk.Free("body.mass", prior=(0.5, 0.01))
    held = rk.fit(GUESS, START, record, [INERTIA, prior])
    assert held.unseen == ()
    # a minimum to 1e-3 of a deviation
    np.testing.assert_allclose(held.standard_errors["body.mass"], 0.01, rtol=1e-6)
    assert abs(held.estimates["body.mass"] - 0.5) < 1e-3 * 0.01
    assert held.degrees_of_freedom == found.degrees_of_freedom
    # and so do forces
    channels = {**record.channels, "force": rk.NormalForce(noisy(force, 9, 0.05), 0.05)}
    weighed = rk.fit(GUESS, START, rk.Record(TIMES, channels), free)
    assert weighed.unseen == ()
    within_four(weighed, "body.mass", 0.5)
    within_four(weighed, "body.inertia", ASKEW)


def test_a_prior_of_an_inertia_counts_every_number_once():
    """Of a ball that rolls straight nothing else is known of products of inertia."""
    ball = rk.Scene(rk.Body(1.0, 4e-3 * np.eye(3), rk.Sphere(0.1)))
    start = rk.place(ball, UP, (0.0, 5.0, 2.0), STILL)
    record = record_of(noisy(gyro_of(ball, start), 10))
    seen = rk.identifiability(ball, start, record, INERTIA)
    # z'' and x'' = 0 by products with y and z alone: two directions of six are seen
    assert len(seen.unseen) == 4
    assert (seen.singular_values > 1e-6 * seen.singular_values[0]).sum() == 2
    prior = rk.Free("body.inertia", prior=(4e-3 * np.eye(3), 1e-4))
    known = rk.identifiability(ball, start, record, prior)
    assert known.unseen == ()
    errors = known.standard_errors["body.inertia"]
    # variances of six numbers: the prior's in the four directions that are not seen,
    # and below 1e-3 of it where the record tells 4e-7 of 1e-4
    every = np.sum(errors[np.triu_indices(3)] ** 2)
    np.testing.assert_allclose(every, 4.0 * 1e-4**2, rtol=1e-3)
    assert (errors < 1e-4 * (1.0 + 1e-6)).all()
    with pytest.raises(rk.FieldError, match="is not seen in the records") as caught:
        rk.fit(ball, start, record, rk.Free("body.mass"))
    assert caught.value.value == ("body.mass",)


# Bounds


@pytest.mark.parametrize("drag", [2e-4, 0.0])
def test_a_drag_from_its_bound(drag):
    """A start at zero does not stall; an optimum below zero is on the bound."""
    scene = pebble(drag=drag)
    values = gyro_of(scene, START)
    if not drag:  # a record that speeds up
        values = values * (1.0 + 0.02 * TIMES[:, None])
    free = [
        rk.Free("loads[1].angular"),
        rk.Free("body.surface.semi_axes", form="scale"),
    ]
    found = rk.fit(pebble(), START, record_of(noisy(values, 11)), free)
    assert found.converged
    estimate = found.estimates["loads[1].angular"]
    assert all(step["loads[1].angular"] >= 0.0 for step in found.iterates)
    assert ("on bound" in found.report()) == (drag == 0.0)
    if drag:
        assert estimate > 0.0
        within_four(found, "loads[1].angular", drag)
        low, high = found.interval("loads[1].angular", method="profile")
        assert low < estimate < high
    else:
        assert estimate == 0.0
    # the ratios of the axes stay, to the rounding of one product
    axes = found.estimates["body.surface.semi_axes"]
    np.testing.assert_allclose(axes / axes[0], np.array([6, 5, 4]) / 6, rtol=8 * EPS)


def test_bounds_hold_in_every_iterate(rates):
    free = rk.Free("body.mass", bounds=(0.4, 0.45))
    found = rk.fit(pebble(mass=0.42), START, record_of(noisy(rates, 12)), free)
    # exp(log(0.45)) to some eps
    assert abs(found.estimates["body.mass"] - 0.45) < 8 * EPS
    masses = [step["body.mass"] for step in found.iterates]
    assert min(masses) >= 0.4 * (1 - 8 * EPS)
    assert max(masses) <= 0.45 * (1 + 8 * EPS)
    assert "on bound" in found.report()
    assert found.standard_errors["body.mass"] == 0.0


# Runs that end early


def test_runs_that_end_early_are_misfits(rates):
    """Few steps allowed: some guesses need more; they are counted, and not taken."""
    record = record_of(noisy(rates, 13))
    found = rk.fit(GUESS, START, record, INERTIA, max_steps=12)
    assert found.failed > 0
    assert np.isfinite(found.chi2)
    assert not np.isnan(found.estimates["body.inertia"]).any()


def test_nothing_is_predicted_where_no_run_comes_to(rates):
    """What stands for its misfits there is for the search alone."""
    turns = np.asarray(rk.simulate(TRUTH, START, TIMES).state.orientation)
    both = {"gyro": rk.Gyro(noisy(rates, 15), NOISE)}
    both["mocap"] = rk.Orientation(turns, 0.01)
    few = {"max_steps": 5, "rtol": 1e-8}
    record = rk.Record(TIMES, both)
    found = rk.fit(TRUTH, START, record, rk.Free("body.mass"), **few)
    run = rk.simulate(found.scene, found.start, TIMES, **few)
    reached = np.asarray(run.final_time >= TIMES)
    assert 1 < reached.sum() < len(TIMES)
    predicted = found.predicted()
    way = np.asarray(run.state.orientation)
    unit = way / np.linalg.norm(way, axis=1, keepdims=True)
    pairs = {"gyro": np.asarray(run.state.angular_velocity), "mocap": unit}
    for name, values in pairs.items():
        is_one = np.isfinite(predicted[name])
        np.testing.assert_array_equal(is_one, np.isfinite(values), name)
    # samples less misfits over their deviations, times them: some roundings of a sample
    # and of a misfit; turns by the root of what their sines leave of 1, as good
    for name, values in pairs.items():
        size = np.max(np.abs(np.asarray(both[name].values)))
        apart = np.abs(predicted[name] - values)[reached]
        assert np.max(apart) < 32 * EPS * size, name
    assert np.isfinite(found.residuals["gyro"]).all()


def test_a_disc_that_falls_flat_is_a_misfit():
    disc = rk.Body(1.0, np.diag([1.0, 1.0, 2.0]) / 64.0, rk.DiscEdge(0.25))
    scene = rk.Scene(disc)
    turn = (np.cos(np.pi / 4 * 0.9), np.sin(np.pi / 4 * 0.9), 0.0, 0.0)
    rolls = rk.place(scene, turn, (0.0, 0.0, 0.0), STILL)
    spin = np.asarray([0.0, -4.0, 0.5])
    truth = dataclasses.replace(rolls, angular_velocity=rolls.angular_velocity + spin)
    assert rk.simulate(scene, truth, TIMES).succeeded
    falls = rk.simulate(scene, rolls, TIMES)
    assert not falls.succeeded
    record = record_of(noisy(gyro_of(scene, truth), 14))
    free = (rk.Free("start.angular_velocity"),)
    problem = problem_of(scene, [rolls], [record], free, None, RunOptions())
    at = problem.evaluate(problem.layout.start)
    assert at.usable
    assert at.failed == 1
    # each of the samples that are not reached counts as ten deviations, and more
    reached = np.isfinite(np.asarray(falls.state.angular_velocity)).sum()
    assert np.sum(at.residual**2) > 100.0 * (3 * len(TIMES) - reached)
    straight = rk.fit(scene, rolls, record, free, strategy="single")
    assert straight.failed > 0
    assert np.isfinite(straight.chi2)
    # over growing horizons it is found, without a run that fell
    found = rk.fit(scene, rolls, record, free)
    assert len(found.stages) > 1
    within_four(found, "start.angular_velocity", np.asarray(truth.angular_velocity))
