"""Robust losses: scales and errors that outliers do not make.

A ball that rolls on by itself is at ``x + r w t``, which is linear in both numbers:
Huber's joint equations for them and the scale are solved by SciPy.
"""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import integrate, optimize, stats

import rollkane as rk
from rollkane.identification.losses import LOSSES, scale_of

RADIUS, SIGMA = 0.1, 0.01
TIMES = np.linspace(0.0, 1.0, 40)
SLOPES = np.stack([np.ones(TIMES.size), RADIUS * TIMES], axis=1)
WEIGHTS = {
    "huber": lambda r: 1.0 / np.maximum(np.abs(r), 1.0),
    "soft_l1": lambda r: (1.0 + r**2) ** -0.5,
    "cauchy": lambda r: 1.0 / (1.0 + r**2),
}
FREE = [rk.Free("start.contact_on_base[0]"), rk.Free("start.angular_velocity[1]")]
# of normal noise, by quadrature
CUT = integrate.quad(
    lambda r: min(r * r, 1.0) * stats.norm.pdf(r), -9, 9, points=[-1, 1]
)[0]


def _noise(seed, share=0.1):
    """Normal, and a share of it fifteen times as large."""
    random = np.random.default_rng(seed)
    noise = SIGMA * random.standard_normal(TIMES.size)
    return np.where(random.random(TIMES.size) < share, 15.0 * noise, noise)


def _place(scene, t, state):
    return rk.contact_of(scene, t, state).position[:1]


def _fit(channels, free, loss):
    scene = rk.Scene(rk.Body(1.0, 0.004 * np.eye(3), rk.Sphere(RADIUS)))
    start = rk.place(scene, (1.0, 0.0, 0.0, 0.0), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0))
    return rk.fit(scene, start, rk.Record(TIMES, channels), free, loss=loss)


def _of_place(noise, loss, sigma=None):
    samples = jnp.asarray(SLOPES @ [1.0, 1.0] + noise)[:, None]
    return _fit({"place": rk.Observed(_place, samples, sigma)}, FREE, loss)


def _jointly(samples, loss):
    """Both numbers, the scale, and Huber's standard errors."""
    psi = lambda r: r * WEIGHTS[loss](r)
    left = TIMES.size - 2

    def equations(x):
        r = (samples - SLOPES @ x[:2]) / np.exp(x[2])
        cut = np.sum(np.minimum(r**2, 1.0)) - CUT * left
        return np.append(SLOPES.T @ psi(r), cut)

    begun = optimize.least_squares(
        equations, np.append([1.0, 1.0], np.log(SIGMA)), xtol=1e-14, ftol=1e-14
    )
    scale = np.exp(begun.x[2])
    r = (samples - SLOPES @ begun.x[:2]) / scale
    slopes = (psi(r + 1e-5) - psi(r - 1e-5)) / 2e-5
    slope = np.mean(slopes)
    uneven = 1.0 + 2.0 / TIMES.size * np.var(slopes) / slope**2  # Huber's K
    factor = (uneven * scale / slope) ** 2 * np.sum(psi(r) ** 2) / left
    errors = np.sqrt(factor * np.diag(np.linalg.inv(SLOPES.T @ SLOPES)))
    return begun.x[:2], scale, errors


@pytest.mark.parametrize("loss", WEIGHTS)
def test_outliers_do_not_make_the_scale(loss):
    """With a tenth of outliers a scale of their variance is 4.8 times the noise."""
    noise = _noise(3)
    found = _of_place(noise, loss)
    known, scale, errors = _jointly(SLOPES @ [1.0, 1.0] + noise, loss)
    assert scale < 1.5 * SIGMA
    # rounds end where a scale changes by a hundredth; the next would by less than that,
    # and so all that are left together by some hundredths at most
    np.testing.assert_allclose(found.sigma["place"], scale, rtol=0.03)
    told = np.array([found.standard_errors[one.path] for one in FREE])
    np.testing.assert_allclose(told, errors, rtol=0.03)
    estimates = np.array([found.estimates[one.path] for one in FREE])
    np.testing.assert_allclose(estimates, known, rtol=0.0, atol=0.05 * errors.min())


def test_without_a_robust_loss_it_is_the_root_mean_square():
    noise = _noise(3)
    found = _of_place(noise, "linear")
    left = noise - SLOPES @ np.linalg.lstsq(SLOPES, noise, rcond=None)[0]
    known = np.sqrt(left @ left / (TIMES.size - 2))
    np.testing.assert_allclose(found.sigma["place"], known, rtol=1e-5)


def test_a_channel_without_outliers_is_known_as_without_the_other():
    """Each of two channels tells a bias of its own; only one has outliers."""
    random = np.random.default_rng(1)
    clean = SLOPES @ [1.0, 1.0] + SIGMA * random.standard_normal(TIMES.size)
    spoiled = SLOPES @ [1.0, 1.0] + _noise(0, 0.3)
    alone = {"clean": rk.Observed(_place, clean[:, None], SIGMA)}
    both = alone | {"spoiled": rk.Observed(_place, spoiled[:, None], SIGMA)}
    one, other = rk.Free("clean.bias"), rk.Free("spoiled.bias")
    known = _fit(alone, [one], "huber").standard_errors["clean.bias"]
    found = _fit(both, [one, other], "huber").standard_errors
    # the same numbers, but for where the searches end: 1e-3 of a deviation, by which
    # moments of 40 samples hardly change
    np.testing.assert_allclose(found["clean.bias"], known, rtol=1e-3)
    assert found["spoiled.bias"] > 1.2 * known


@pytest.mark.slow
@pytest.mark.parametrize("loss", WEIGHTS)
def test_intervals_hold_the_truth_with_outliers(loss):
    """Of 150 records: 95 % with a deviation of 1.8 %; four of them, and 2 % of 40."""
    inside, away = [], []
    for seed in range(150):
        found = _of_place(_noise(seed), loss)
        error = [found.estimates[one.path] - 1.0 for one in FREE]
        told = np.array([found.standard_errors[one.path] for one in FREE])
        inside.append(np.abs(error) < 1.96 * told)
        away.append(np.array(error) / told)
    assert (np.mean(inside, axis=0) > 0.95 - 4.0 * 0.018 - 0.02).all()
    # a deviation of 150 is known to 6 %
    assert (np.abs(np.std(away, axis=0) - 1.0) < 4.0 * 0.06).all()


@pytest.mark.parametrize("name", WEIGHTS)
def test_the_scale_solves_hubers_equation(name):
    """Where the equation has a root, and where the half of the samples is zero."""
    random = np.random.default_rng(2)
    for count in (3, 5, 17, 40):
        residual = random.standard_cauchy(count)
        left = count - random.uniform(0.0, 0.3 * count)
        over = lambda s, r=residual, n=left: (
            np.sum(np.minimum((r / s) ** 2, 1.0)) - CUT * n
        )
        known = optimize.brentq(over, 1e-9, 1e9, xtol=1e-15, rtol=1e-14)
        # sums of 40 numbers, and a root to 1e-14
        found = scale_of(residual, left, LOSSES[name])
        np.testing.assert_allclose(found, known, rtol=1e-12)
    assert scale_of(np.array([0.0] * 7 + [5.0] * 3), 9.0, LOSSES[name]) == 0.0


def test_an_endless_outlier_does_not_move_the_scale():
    residual = np.random.default_rng(4).standard_normal(1000)
    for far in (1e2, 1e8):
        residual[:100] = far
        found = scale_of(residual, 1000.0, LOSSES["huber"])
        # a tenth of outliers: the mean of the rest's cut squares is (CUT - 0.1) / 0.9
        inner = lambda s: (
            integrate.quad(lambda r: min((r / s) ** 2, 1.0) * stats.norm.pdf(r), -9, 9)[
                0
            ]
            - (CUT - 0.1) / 0.9
        )
        known = optimize.brentq(inner, 1.0, 2.0)
        # of 900 numbers: a deviation of 1.1 / sqrt(900), four of them
        assert abs(found / known - 1.0) < 4.0 * 1.1 / 30.0
