"""Searches and errors where misfits show a direction by noise alone, or not at all."""

from types import SimpleNamespace

import numpy as np
import pytest

from rollkane.identification.directions import not_seen, spectrum, waiting
from rollkane.identification.least_squares import Evaluation, minimize
from rollkane.identification.losses import LOSSES
from rollkane.identification.uncertainty import coordinate_covariance

SIZE = np.array([1.0, 0.04])
START = np.array([0.0, 0.02])
OPEN = np.full(2, -np.inf), np.full(2, np.inf)
ACROSS = 1.5  # what an arm b and a spin w across it are multiplied with


def spun(spin, seed, prior=None):
    """Misfits of a spin w and of w b, known to 0.01 and 0.05 in each of 100 samples."""
    random = np.random.default_rng(seed)
    rates = spin + 0.01 * random.standard_normal(100)
    pulls = ACROSS * spin * 0.02 + 0.05 * random.standard_normal(100)

    def at(z):
        w, b = z
        one = np.ones(100)
        residual = [(w - rates) / 0.01, (ACROSS * w * b - pulls) / 0.05]
        slopes = [np.stack([one, 0.0 * one], axis=1) / 0.01]
        slopes.append(np.stack([b * one, w * one], axis=1) * ACROSS / 0.05)
        if prior is not None:
            residual.append([(b - 0.02) / prior])
            slopes.append([[0.0, 1.0 / prior]])
        known = np.concatenate(residual), np.concatenate(slopes)
        return Evaluation(*known, 0, priors=int(prior is not None))

    return at


def layout(lower=OPEN[0], upper=OPEN[1]):
    return SimpleNamespace(lower=lower, upper=upper, scale=SIZE)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("loss", ["linear", "huber", "cauchy"])
@pytest.mark.parametrize("half", [np.inf, 5.0])
def test_a_number_that_noise_alone_shows_stays_at_the_guess(seed, loss, half):
    """A spin of 0 +- 0.001 tells no arm: noise over noise is a number of any size."""
    lower, upper = np.array([-np.inf, -half]), np.array([np.inf, half])
    found = minimize(spun(0.0, seed), START, lower, upper, SIZE, LOSSES[loss])
    assert found.converged
    assert found.z[1] == 0.02
    assert found.evaluations < 12
    space = layout(lower, upper)
    # and it is not seen; the spin has its error by its own samples, with which those
    # of w b, 1.5 * 0.02 / 0.05 against 1 / 0.01, have 4e-5 to say
    np.testing.assert_array_equal(np.abs(not_seen(found.at, SIZE)), [[0.0, 1.0]])
    error = np.sqrt(coordinate_covariance(found.at, space, found.z)[0, 0])
    assert error == pytest.approx(1e-3, rel=1e-4)


def test_what_comes_to_be_seen_moves():
    """A spin of 2 that the first guess has as 0."""
    found = minimize(spun(2.0, 0), np.array([0.0, 0.9]), *OPEN, SIZE)
    assert found.converged
    assert not len(not_seen(found.at, SIZE))
    error = np.sqrt(coordinate_covariance(found.at, layout(), found.z)[1, 1])
    assert error == pytest.approx(0.005 / (ACROSS * 2.0), rel=0.01)
    assert abs(found.z[1] - 0.02) < 4.0 * error


def test_samples_that_speak_beyond_their_noise_move_what_is_hardly_seen():
    """A step by four of its deviations, though its size is worth a hundredth of one."""
    at = spun(0.0, 0)
    here = at(np.array([1e-3, 0.02]))
    slope = here.jacobian[:, 1]
    first = np.array([[0.0, 1.0]])
    size = np.linalg.norm(slope)
    assert size * SIZE[1] < 0.02
    noise = here.residual - (here.residual @ slope) / size**2 * slope
    for steps, count in ((2.0, 1), (4.0, 0)):
        moved = here._replace(residual=noise + steps * slope / size)
        assert len(waiting(moved, SIZE, first)) == count


def test_a_prior_makes_a_number_seen():
    found = minimize(spun(0.0, 0, prior=0.5), START, *OPEN, SIZE)
    assert found.converged
    assert not len(not_seen(found.at, SIZE))
    error = np.sqrt(coordinate_covariance(found.at, layout(), found.z)[1, 1])
    # samples, by a spin of at most 0.003, tell it to 1 or worse
    assert 0.4 < error <= 0.5


def test_an_unseen_direction_has_no_shares_of_what_makes_up_for_it():
    """A column of 1e-6 beside ones of 1e3 and 30, and almost along the last."""
    random = np.random.default_rng(1)
    J = random.standard_normal((50, 3)) * [1e3, 30.0, 1.0]
    J[:, 2] = 1e-6 * (J[:, 1] / 30.0 + 0.1 * J[:, 2])
    parts = spectrum(Evaluation(np.ones(50), J, 0), np.ones(3))
    assert parts.seen.tolist() == [True, True, False]
    np.testing.assert_array_equal(np.abs(parts.directions[2]), [0.0, 0.0, 1.0])
    np.testing.assert_array_equal(parts.directions[:2, 2], 0.0)
    # the others are as they would be without it
    alone = np.linalg.svd(J[:, :2], compute_uv=False)
    np.testing.assert_allclose(parts.values[:2], alone, rtol=1e-12)


def test_a_combination_that_is_not_seen_stays_one():
    """Two columns that are one: neither of them is dropped for being small."""
    random = np.random.default_rng(1)
    J = random.standard_normal((50, 3))
    J[:, 2] = 5e-3 * J[:, 1]
    parts = spectrum(Evaluation(np.ones(50), J, 0), np.ones(3))
    unit = np.array([0.0, -5e-3, 1.0]) / np.hypot(5e-3, 1.0)
    found = parts.directions[2] * np.sign(parts.directions[2, 2])
    np.testing.assert_allclose(found, unit, atol=1e-12)
