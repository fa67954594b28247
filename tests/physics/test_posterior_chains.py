"""Chains of posteriors: whether they agree, and where there is no distribution.

A ball of inertia k m r^2 that rolls down a slope is at ``g sin(a) t^2 / (2 (1 + k))``:
its density by k is a function of one number, which quadrature integrates.
"""

import warnings

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

import rollkane as rk
from rollkane.identification import chain_diagnostics, posterior_draws

RADIUS, SLOPE, GRAVITY = 0.1, 0.3, 9.81
TIMES = np.linspace(0.0, 0.5, 12)
INERTIA = 0.004


def _place(k):
    return 0.5 * GRAVITY * np.sin(SLOPE) * TIMES**2 / (1.0 + np.asarray(k)[..., None])


def _samples(sigma):
    return _place(0.5) + sigma * np.random.default_rng(5).standard_normal(TIMES.size)


def _fit(sigma, **given):
    down = GRAVITY * np.array([np.sin(SLOPE), 0.0, -np.cos(SLOPE)])
    body = rk.Body(1.0, INERTIA * np.eye(3), rk.Sphere(RADIUS))
    scene = rk.Scene(body, loads=(rk.Gravity(down),))
    still = (0.0, 0.0, 0.0)
    start = rk.place(scene, (1.0, 0.0, 0.0, 0.0), still, still)
    place = rk.Observed(
        lambda scene, t, state: rk.contact_of(scene, t, state).position[:1],
        jnp.asarray(_samples(sigma))[:, None],
        sigma=sigma,
    )
    free = rk.Free("body.inertia", form="scale", **given)
    return rk.fit(scene, start, rk.Record(TIMES, {"place": place}), free)


def _chi2(k, sigma):
    return np.sum((_samples(sigma) - _place(k)) ** 2, axis=-1) / sigma**2


# Of ArviZ 0.21.0: R-hat, bulk and tail ESS of these chains, and of them with ties.
BY_ARVIZ = {
    (0.0, False): (1.0021155950341127, 88.93308060539043, 419.13903460922825),
    (0.0, True): (1.0016414440873358, 90.40378530200184, 208.5523261518197),
    (0.5, False): (1.0215319084935703, 75.67988817868807, 230.5993498231865),
    (0.5, True): (1.0210455685278093, 77.44804677347268, 179.0603132645032),
}


@pytest.mark.parametrize(("shift", "ties"), BY_ARVIZ)
def test_diagnostics_are_those_of_arviz(shift, ties):
    n, c = np.arange(300), np.arange(4)[:, None]
    x = np.sin(0.7 * n * n + c) + 0.8 * np.cos(0.05 * n + 2.0 * c)
    x = x + 0.3 * np.sin(1.3 * n + c)
    x[1] += shift
    x = np.round(2.0 * x) if ties else x
    r_hat, bulk, tail = BY_ARVIZ[shift, ties]
    # ranks' quantiles are good to some roundings
    assert abs(chain_diagnostics.split_r_hat(x) - r_hat) < 1e-12
    # whose sum ends a lag later: some 1 / N of a chain's halves
    np.testing.assert_allclose(chain_diagnostics.bulk_size(x), bulk, rtol=0.01)
    np.testing.assert_allclose(chain_diagnostics.tail_size(x), tail, rtol=0.01)


def test_doubts_name_the_entry():
    """Of two numbers one has a chain elsewhere; of what does not vary nothing."""
    x = np.random.default_rng(0).standard_normal((4, 500, 3))
    x[:, :, 2] = 1.0
    well = posterior_draws.PosteriorDraws({"start.spin": x.reshape(-1, 3)}, 4, 0)
    assert well.doubts() == []
    assert np.isnan(well.r_hat["start.spin"][2])
    assert well.by_chain()["start.spin"].shape == (4, 500, 3)
    np.testing.assert_array_equal(well.by_chain()["start.spin"], x)
    away = x.copy()
    away[3, :, 1] += 1.0
    apart = posterior_draws.PosteriorDraws({"spin": away.reshape(-1, 3)}, 4, 0)
    (doubt,) = apart.doubts()
    assert "spin[1] has R-hat" in doubt
    assert "spin[0]" not in doubt
    (doubt,) = posterior_draws.PosteriorDraws(well, 4, 3).doubts()
    assert "3 draws diverged" in doubt


def test_a_number_that_records_do_not_keep_from_zero_has_no_posterior():
    """Its logarithm has infinitely much below: some chains went there, others not."""
    found = _fit(0.06)
    estimate, error = (
        x["body.inertia"][0, 0] / RADIUS**2
        for x in (found.estimates, found.standard_errors)
    )
    # known to 46 %: chi2 rises by 10 to zero, and by 46 to infinity
    assert 0.3 < error / estimate < 0.5
    with pytest.raises(rk.FieldError, match="prior") as caught:
        rk.posterior(found)
    assert caught.value.field == "posterior.fit"
    assert caught.value.value == ("body.inertia towards zero",)
    worse = _fit(0.3)
    with pytest.raises(rk.FieldError) as caught:
        rk.posterior(worse, draws=100)
    ends = tuple(f"body.inertia towards {end}" for end in ("infinity", "zero"))
    assert caught.value.value == ends


@pytest.mark.slow
@pytest.mark.parametrize("sigma", [0.03, 0.06])
def test_a_posterior_is_that_of_quadrature(sigma):
    """Flat in the logarithm where zero is far; else a wide prior of the number."""
    if sigma == 0.03:
        found, log = _fit(sigma), np.linspace(np.log(0.05), np.log(5.0), 20001)
        density = np.exp(-0.5 * (_chi2(np.exp(log), sigma) - found.chi2))
    else:
        wide = 5.0  # of the factor
        prior = (INERTIA * np.eye(3), wide * INERTIA / np.sqrt(3.0))
        found, log = _fit(sigma, prior=prior), np.linspace(-20.0, 3.0, 40001)
        k = np.exp(log)
        density = np.exp(-0.5 * (_chi2(k, sigma) - found.chi2)) * k
        density *= stats.norm.pdf(k / (INERTIA / RADIUS**2), 1.0, wide)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # some thousand draws are worth few of these
        drawn = rk.posterior(found, draws=3000, warmup=300)
    shares = np.cumsum(density) / np.sum(density)
    x = np.log(drawn["body.inertia"][:, 0, 0] / RADIUS**2)
    for share in (0.05, 0.5, 0.95):
        below = np.mean(x < np.interp(share, shares, log))
        # a quantile's share is that of independent draws, a seventh of all: R-hat and
        # sizes of one number's chains; four deviations
        error = np.sqrt(share * (1.0 - share) / (3000 / 7))
        assert abs(below - share) < 4.0 * error


def _of_spins(spins, counts, sigma, free):
    """A ball that rolls on a plane keeps its spin, which a gyro reads."""
    scene = rk.Scene(rk.Body(1.0, INERTIA * np.eye(3), rk.Sphere(RADIUS)))
    rng = np.random.default_rng(2)
    starts, records = [], []
    for spin, count in zip(spins, counts, strict=True):
        start = rk.place(scene, (1, 0, 0, 0), spin, (0, 0, 0))
        run = rk.simulate(scene, start, np.linspace(0.0, 0.5, count))
        seen = np.asarray(run.state.angular_velocity)
        seen = seen + sigma * rng.standard_normal(seen.shape)
        starts.append(start)
        records.append(rk.Record(run.time, {"gyro": rk.Gyro(seen, sigma=sigma)}))
    return rk.fit(scene, starts, records, free)


def test_draws_of_several_records_come_in_front_of_them():
    """Records stood in front: R-hat compared them as if they were chains."""
    sigma, counts = 0.1, (10, 40)
    free = rk.Free("start.angular_velocity")
    found = _of_spins([[1.0, 2.0, 3.0], [-2.0, 0.5, 1.0]], counts, sigma, free)
    drawn = rk.posterior(found, draws=1000, warmup=200)
    spin = drawn["start.angular_velocity"]
    assert spin.shape == (1000, 2, 3)
    assert drawn.r_hat["start.angular_velocity"].shape == (2, 3)
    for k, count in enumerate(counts):
        # on body axes the spin turns: its samples tell it as their mean does, of white
        # noise; 1000 draws, worth half as many independent ones, tell a mean to 0.05
        # deviations and a deviation to 3 %: five and six of these
        deviation = sigma / np.sqrt(count)
        wanted = found.estimates["start.angular_velocity"][k]
        off = np.abs(spin[:, k].mean(axis=0) - wanted)
        assert (off < 0.25 * deviation).all()
        np.testing.assert_allclose(spin[:, k].std(axis=0), deviation, rtol=0.2)
