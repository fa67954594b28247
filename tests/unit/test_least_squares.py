"""The search for least squares alone: bounds, losses, units, points without numbers."""

from types import SimpleNamespace

import numpy as np
import pytest
import scipy.optimize

import rollkane as rk
from rollkane.identification.least_squares import Bend, Evaluation, minimize
from rollkane.identification.losses import LOSSES, loss_of, score_moments
from rollkane.identification.uncertainty import coordinate_covariance

from ..quick import slow_but

# A search ends where the next step promises a fall of chi2 of no more than 1e-6, and
# its step is at most damped by half there (damping 1, of a matrix that is scaled to a
# unit diagonal): the rest is below 2e-6 or so, which leaves sqrt(2e-6) of a standard
# deviation. A hundredth of one is five times that.
NEAR = 1e-2


def free(size):
    return np.full(size, -np.inf), np.full(size, np.inf), np.ones(size)


def of_matrix(A, b):
    return lambda z: Evaluation(A @ z - b, A, 0)


def deviations(A):
    return np.sqrt(np.diag(np.linalg.inv(A.T @ A)))


def rosenbrock(z):
    x, y = z
    residual = np.array([10.0 * (y - x * x), 1.0 - x])
    return Evaluation(residual, np.array([[-20.0 * x, 10.0], [-1.0, 0.0]]), 0)


def regression(seed=0):
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((40, 3))
    b = A @ np.array([1.0, -2.0, 0.5]) + rng.standard_normal(40)
    b[::8] += 25.0
    return A, b


def test_a_curved_valley():
    found = minimize(rosenbrock, np.array([-1.2, 1.0]), *free(2))
    # J at (1, 1): [[-20, 10], [-1, 0]], with deviations 1 and sqrt(401) / 10 = 2.002
    assert found.converged
    assert found.cost < 1e-6
    np.testing.assert_allclose(found.z, [1.0, 1.0], atol=NEAR)
    assert found.evaluations < 126


def test_every_accepted_point_is_better():
    path = minimize(rosenbrock, np.array([-1.2, 1.0]), *free(2)).path
    costs = [float(np.sum(rosenbrock(z).residual ** 2)) for z in path]
    assert len(costs) > 5
    assert (np.diff(costs) < 0.0).all()


@pytest.mark.parametrize("target", [3.0, -3.0])
def test_a_start_on_its_bound(target):
    """It leaves the bound for an optimum inside, and stays for one outside."""
    A = np.array([[1.0, 0.3], [0.2, 1.0], [0.5, -0.4]])
    b = A @ np.array([target, 1.0])
    lower, upper = np.array([0.0, -np.inf]), np.full(2, np.inf)
    size = np.ones(2)
    found = minimize(of_matrix(A, b), np.array([0.0, 5.0]), lower, upper, size)
    expected = scipy.optimize.lsq_linear(A, b, (lower, upper)).x
    assert found.converged
    np.testing.assert_allclose(found.z, expected, atol=NEAR * deviations(A).max())
    assert (found.z[0] == 0.0) == (target < 0.0)


DECAY = np.linspace(0.0, 3.0, 30)  # times of samples of 2 exp(-t / 2)


def decay(z):
    """Misfits of a exp(-k t), of which the samples are known to 0.01."""
    k, a = z
    e = np.exp(-k * DECAY)
    residual = 100.0 * (a * e - 2.0 * np.exp(-0.5 * DECAY))
    return Evaluation(residual, 100.0 * np.stack([-a * DECAY * e, e], axis=1), 0)


@pytest.mark.parametrize("start", [(0.1, 1.0), (0.39, 1.5), (0.2, 4.0), (0.4, 3.0)])
def test_a_search_ends_on_the_bound_that_holds_it(start):
    """Whatever the guess: k of 0.5 is beyond its bound 0.4, and misfits bend."""
    lower, upper = np.array([-9.0, -9.0]), np.array([0.4, 9.0])
    found = minimize(decay, np.array(start), lower, upper, np.ones(2))
    assert found.converged
    assert found.z[0] == 0.4
    layout = SimpleNamespace(lower=lower, upper=upper, scale=np.ones(2))
    known = coordinate_covariance(found.at, layout, found.z)
    # the amplitude alone is free: its deviation, where nothing depends on it
    alone = np.sum(decay((0.4, 1.0)).jacobian[:, 1] ** 2)
    # roundings of sums of 30 squares, 1e-16 of each
    np.testing.assert_allclose(known, [[0.0, 0.0], [0.0, 1.0 / alone]], rtol=1e-13)


@pytest.mark.parametrize("beyond", [1e-4, -1e-4])
@pytest.mark.parametrize("start", [1.0, 1.0 - 3e-4, 0.5])
def test_a_bound_near_a_minimum_holds_where_the_minimum_is_beyond(start, beyond):
    """By less than is searched for, a thousandth of a deviation, from any guess."""
    at = lambda z: Evaluation(z - (1.0 + beyond), np.ones((1, 1)), 0)
    lower, upper, size = np.zeros(1), np.ones(1), np.ones(1)
    found = minimize(at, np.array([start]), lower, upper, size)
    layout = SimpleNamespace(lower=lower, upper=upper, scale=size)
    known = coordinate_covariance(found.at, layout, found.z)
    assert found.converged
    assert known[0, 0] == pytest.approx(float(beyond < 0.0), rel=1e-14)


def test_what_is_hardly_seen_is_not_driven_to_a_bound():
    """A column of 1e-9, at the other's minimum: a step to the bound lowers nothing."""
    A = np.array([[1.0, 1e-9], [2.0, 0.0], [0.5, 0.0]])
    upper = np.array([np.inf, 7.2])
    at = of_matrix(A, np.array([5.0, 0.0, 0.0]))
    found = minimize(at, np.array([5.0 / 5.25, 7.0]), free(2)[0], upper, np.ones(2))
    assert found.converged
    assert found.z[1] == 7.0


@pytest.mark.parametrize("seed", range(5))
def test_a_box_against_another_solver(seed):
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((12, 6))
    b = 5.0 * rng.standard_normal(12)
    lower, upper = np.full(6, -0.4), np.full(6, 0.4)
    expected = scipy.optimize.lsq_linear(A, b, (lower, upper), tol=1e-14).x
    for start in (lower, upper, np.zeros(6)):
        found = minimize(of_matrix(A, b), start, lower, upper, np.ones(6))
        assert found.converged
        assert ((found.path >= lower) & (found.path <= upper)).all()
        cost = 0.5 * np.sum((A @ expected - b) ** 2)
        # twice the cost is to fall by no more than 1e-6 (and again by as much)
        assert found.cost - cost < 2e-6
    assert np.sum(np.abs(np.abs(expected) - 0.4) < 1e-9) > 0  # some are on the box


@pytest.mark.parametrize("name", [n for n in LOSSES if n != "linear"])
def test_losses_against_another_solver(name):
    A, b = regression()
    found = minimize(of_matrix(A, b), np.zeros(3), *free(3), LOSSES[name])
    known = scipy.optimize.least_squares(
        lambda z: A @ z - b, np.zeros(3), lambda z: A, loss=name, xtol=1e-12, ftol=1e-14
    )
    assert found.converged
    # the weighted steps fall short of Newton's by what outliers curve: ten times 1e-6
    assert abs(found.cost - known.cost) < 1e-5
    # the outliers move the straight loss by more than the robust ones
    straight = minimize(of_matrix(A, b), np.zeros(3), *free(3)).z
    truth = np.array([1.0, -2.0, 0.5])
    assert np.abs(found.z - truth).max() < 0.5 * np.abs(straight - truth).max()


@pytest.mark.parametrize("name", LOSSES)
def test_weights_are_the_slopes_of_losses(name):
    s = np.array([0.2, 0.9, 1.1, 3.0, 400.0])
    h = 1e-5 * s
    loss = LOSSES[name]
    slope = (loss.value(s + h) - loss.value(s - h)) / (2.0 * h)
    # rounding 1e-16 of values up to s over h = 1e-5 s, and h^2 / s^2: 1e-10
    np.testing.assert_allclose(loss.weight(s), slope, rtol=1e-9)


def test_units_do_not_matter():
    A, b = regression()
    units = np.array([1e-6, 1.0, 1e7])
    start = np.array([0.5, 0.5, 0.5])
    one = minimize(of_matrix(A, b), start, *free(3)).path
    other = minimize(of_matrix(A * units, b), start / units, *free(3)[:2], 1.0 / units)
    # the same steps but for rounding, 1e-16 times some 1e3 operations
    np.testing.assert_allclose(other.path * units, one, atol=1e-12)


def test_points_without_numbers_are_avoided():
    """Beyond 1.2 nothing is known, and the optimum would be at 1.4."""
    tried = []

    def evaluate(z):
        tried.append(z[0])
        bad = z[0] > 1.2
        value = np.nan if bad else 1e3 * (z[0] - 1.4)
        return Evaluation(np.array([value]), np.array([[1e3]]), int(bad))

    found = minimize(evaluate, np.array([0.3]), *free(1))
    beyond = sum(z > 1.2 for z in tried)
    assert beyond > 0
    assert found.evaluations == len(tried)
    assert (found.path <= 1.2).all()
    assert np.isfinite(found.cost)
    assert found.cost < 0.5 * (1e3 * 1.1) ** 2  # that of the start
    assert not found.converged


def test_a_start_without_numbers_is_given_back():
    nothing = Evaluation(np.array([np.nan]), np.array([[1.0]]), 1)
    found = minimize(lambda z: nothing, np.array([2.0]), *free(1))
    assert found.z == 2.0
    assert found.cost == np.inf
    assert not found.converged


def test_a_coordinate_that_nothing_shows_stays():
    A = np.array([[1.0, 0.0], [2.0, 0.0], [0.5, 0.0]])
    b = A @ np.array([4.0, 0.0])
    found = minimize(of_matrix(A, b), np.array([0.0, 7.0]), *free(2))
    assert found.converged
    assert found.z[1] == 7.0
    assert abs(found.z[0] - 4.0) < NEAR / np.sqrt(5.25)


def test_few_points_do_not_converge():
    found = minimize(rosenbrock, np.array([-1.2, 1.0]), *free(2), most=4)
    assert not found.converged
    assert found.evaluations == 4


@pytest.mark.parametrize("name", slow_but(["huber"], LOSSES))
def test_what_a_loss_does_to_the_variance(name):
    """Of a mean: the variance over many samples of normal noise with outliers."""
    loss, random = LOSSES[name], np.random.default_rng(3)
    noise = random.standard_normal((2000, 50))
    noise = np.where(random.random(noise.shape) < 0.05, 8.0 * noise, noise)
    one = np.ones((50, 1))
    free = -np.inf * np.ones(1), np.inf * np.ones(1), np.ones(1)
    means, factors = [], []
    for row in noise:
        at = lambda z, row=row: Evaluation(row - z, -one, 0)
        found = minimize(at, np.array([np.median(row)]), *free, loss)
        means.append(found.z[0])
        slope, square = score_moments(found.at.residual, loss)
        factors.append(square / slope**2)
    # a variance of 2000 means is known to 3.2 %, by four deviations 13 %; the factor is
    # of many samples, and of fifty off by a few per cent more
    told = np.mean(factors) / 50.0
    assert abs(np.var(means) / told - 1.0) < 0.2


@pytest.mark.parametrize("name", slow_but(["huber"], LOSSES))
def test_what_a_loss_does_beside_a_prior(name):
    """The variance over many samples and priors; of a prior alone its own.

    Two numbers: a mean, whose prior is worth as much as its 25 samples, and one that
    only a prior tells.
    """
    loss, random = LOSSES[name], np.random.default_rng(3)
    count, draws = 25, 500
    noise = random.standard_normal((draws, count))
    if name != "linear":  # of which least squares is told the deviation
        noise = np.where(random.random(noise.shape) < 0.05, 8.0 * noise, noise)
    firm = np.sqrt(count)
    slopes = np.zeros((count + 2, 2))
    slopes[:count, 0], slopes[count, 0], slopes[count + 1, 1] = -1.0, firm, 1.0
    lower, upper, scale = free(2)
    layout = SimpleNamespace(lower=lower, upper=upper, scale=scale)
    found, told = [], []
    for row, prior in zip(noise, random.standard_normal((draws, 2)), strict=True):
        away = np.concatenate([row, prior])
        at = lambda z, away=away: Evaluation(away + slopes @ z, slopes, 0, 0.0, 2)
        ended = minimize(at, np.zeros(2), lower, upper, scale, loss)
        found.append(ended.z)
        told.append(coordinate_covariance(ended.at, layout, ended.z, loss))
    mean = np.mean(told, axis=0)
    # a variance of 500 numbers is known to 6.3 %, by four deviations 25 %; the moments
    # are of many samples, and of 25 off by some per cent more
    assert abs(np.var([z[0] for z in found]) / mean[0, 0] - 1.0) < 0.3
    # rounding of an inverse of numbers of one
    np.testing.assert_allclose(np.array(told)[:, 1, 1], 1.0, rtol=1e-12)
    assert abs(np.var([z[1] for z in found]) - 1.0) < 0.26


def test_a_loss_does_not_bend_a_prior():
    """One sample at 10, and a prior of 0 with deviation 1, from beside the sample."""
    at = lambda z: Evaluation(z - np.array([10.0, 0.0]), np.ones((2, 1)), 0, 0.0, 1)
    found = minimize(at, 9.0 * np.ones(1), *free(1), LOSSES["cauchy"])
    # where z = (10 - z) / (1 + (10 - z)^2): 0.1 to first order; a fall of 1e-6 of twice
    # the cost z^2 is waited for, and so 1e-3 of z
    assert abs(found.z[0] - 0.1) < 2e-3


def test_an_unknown_loss():
    with pytest.raises(rk.FieldError, match="use one of"):
        loss_of("absolute")


def test_how_misfits_bend_is_known_from_both_ends_of_a_step():
    """Of r = (x^2, x y): second derivatives by a step (u, v) are (2 u^2, 2 u v)."""
    squares = lambda z: Evaluation(
        np.array([z[0] ** 2, z[0] * z[1]]), np.array([[2.0 * z[0], 0.0], z[::-1]]), 0
    )
    z, step = np.array([1.0, 2.0]), np.array([0.5, -0.25])
    lost = squares(z + step)._replace(failed=1)
    for accepted in (True, False):
        bend = Bend.between(squares(z), squares(z + step), step, accepted)
        # numbers are exact in binary
        assert bend.second.tolist() == [0.5, -0.25]
        assert bend.along(2.0 * step, np.array([1.0, 3.0])).tolist() == [2.0, -1.0]
        across = np.array([0.25, 0.5])
        assert bend.along(across, np.ones(2)).tolist() == [0.0, 0.0]
        assert Bend.between(squares(z), lost, step, accepted) is None


def test_a_bent_valley_is_followed():
    """The parabola y = x^2, 1e3 steeper across than along: in strides, not in crawls.

    A straight step s leaves it by s^2, misfits by 1e3 s^2, which may be no more than
    the rest 2 - x that the step lessens: s < sqrt((2 - x) / 1e3). To go from -2 to 2
    takes the integral of dx / s = 2 sqrt(4 1e3) = 126 of them.
    """
    valley = lambda z: Evaluation(
        np.array([1e3 * (z[1] - z[0] ** 2), z[0] - 2.0]),
        np.array([[-2e3 * z[0], 1e3], [1.0, 0.0]]),
        0,
    )
    found = minimize(valley, np.array([-2.0, 4.0]), *free(2))
    assert found.converged
    np.testing.assert_allclose(found.z, [2.0, 4.0], rtol=1e-3)
    assert found.evaluations < 126
