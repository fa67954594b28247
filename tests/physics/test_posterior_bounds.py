"""Posteriors within bounds: densities cut off there, and flat ones stay flat.

A ball that rolls on a plane keeps its spin, which a gyro reads: a normal distribution,
cut off by bounds. With a drag ``-c v`` it is at ``R w t f(c t / (m (1 + k)))`` with
``f(x) = (1 - exp(-x)) / x``, which quadrature integrates over c and w.
"""

import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

import rollkane as rk
from rollkane.identification.inner_coordinates import InnerCoordinates

RADIUS, INERTIA, SIGMA = 0.1, 0.004, 0.1
SPIN = "start.angular_velocity[1]"
DRAG = "loads[1].linear"
TIMES = np.linspace(0.0, 1.0, 12)


def test_numbers_stay_inside_and_slopes_are_derivatives():
    lower = np.array([0.0, -np.inf, 1.0, -np.inf, 0.0, 2.0])
    upper = np.array([np.inf, 2.0, 1.5, np.inf, 100.0, 2.0 + 1e-9])
    deviation = np.array([0.1, 0.3, 0.4, 1.0, 0.02, 1.0])
    inner = InnerCoordinates.of(lower, upper, deviation)
    slopes = lambda y: jnp.diag(jax.jacfwd(inner.numbers)(y))
    for y in (-700.0, -30.0, -3.0, -0.1, 0.2, 4.0, 40.0, 700.0):
        z = np.asarray(inner.numbers(jnp.full(6, y)))
        assert ((z >= lower) & (z <= upper)).all()
        if abs(y) > 5.0:
            continue
        # beyond, digits of z are those of the bound; of the last number always
        np.testing.assert_allclose(inner.inverse(z)[:5], y, rtol=0.0, atol=1e-10)
        own = jax.grad(inner.log_slope)(jnp.full(6, y))
        known = jax.jacfwd(lambda y: jnp.log(slopes(y)))(jnp.full(6, y))
        np.testing.assert_allclose(own, np.diag(known), atol=1e-12)  # some roundings


def test_without_bounds_nothing_changes():
    none = np.full(2, np.inf)
    inner = InnerCoordinates.of(-none, none, np.ones(2))
    z, known = np.array([3.0, -1.0]), np.array([[2.0, 0.5], [0.5, 1.0]])
    y, root = inner.about(z, known)
    np.testing.assert_array_equal(y, z)
    np.testing.assert_array_equal(root, np.linalg.cholesky(known))
    np.testing.assert_array_equal(inner.numbers(jnp.asarray(y)), z)
    assert float(inner.log_slope(jnp.asarray(y))) == 0.0


def _posterior(found, seed):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # 4000 draws are worth few of tails
        return rk.posterior(found, draws=4000, warmup=500, seed=seed)


def _agree(draws, path, below):
    """Whether draws have a distribution, and chains agree.

    Every twentieth draw is nearly independent: they are worth a tenth of their number
    or more. One of 1000 such tests fails.
    """
    apart = stats.kstest(draws[path][::20], below).pvalue
    return apart > 1e-3 and draws.r_hat[path] < 1.02 and draws.divergences < 4


def _spun(bounds, guess):
    scene = rk.Scene(rk.Body(1.0, INERTIA * np.eye(3), rk.Sphere(RADIUS)))
    place = lambda spin: rk.place(scene, (1, 0, 0, 0), (1.0, spin, 3.0), (0, 0, 0))
    run = rk.simulate(scene, place(2.0), np.linspace(0.0, 0.5, 10))
    seen = np.asarray(run.state.angular_velocity)
    seen = seen + SIGMA * np.random.default_rng(2).standard_normal(seen.shape)
    record = rk.Record(run.time, {"gyro": rk.Gyro(seen, sigma=SIGMA)})
    return rk.fit(scene, place(guess), record, rk.Free(SPIN, bounds=bounds))


# in deviations of the estimate without bounds: on and beyond it, from one or two sides
ENDS = [(-0.5, None), (None, -4.0), (-0.2, 0.3), (-16.0, 60.0)]


@pytest.mark.parametrize(
    "ends", [ENDS[0], *(pytest.param(e, marks=pytest.mark.slow) for e in ENDS[1:])]
)
def test_a_normal_distribution_is_cut_off(ends):
    free = _spun(None, 2.0)
    middle, deviation = (float(x[SPIN]) for x in (free.estimates, free.standard_errors))
    bounds = tuple(None if x is None else middle + x * deviation for x in ends)
    cut = (-np.inf if ends[0] is None else ends[0]), (ends[1] or np.inf)
    inside = (middle + x * deviation for x in (cut[0] + 0.01, cut[1] - 0.01))
    draws = _posterior(_spun(bounds, float(np.clip(2.0, *inside))), seed=3)
    known = stats.truncnorm(*cut, middle, deviation)
    assert known.support()[0] <= draws[SPIN].min()
    assert draws[SPIN].max() <= known.support()[1]
    assert _agree(draws, SPIN, known.cdf)


def _dragged(true, sigma, seed):
    """A fit of the drag, which the library itself keeps from below zero."""
    noise = sigma * np.random.default_rng(seed).standard_normal(TIMES.size)
    seen = _place(np.array(true), np.array(2.0)) + noise
    loads = rk.Gravity(), rk.Drag(linear=0.1)
    body = rk.Body(1.0, INERTIA * np.eye(3), rk.Sphere(RADIUS))
    scene = rk.Scene(body, loads=loads)
    start = rk.place(scene, (1, 0, 0, 0), (0.0, 1.9, 0.0), (0, 0, 0))
    place = rk.Observed(
        lambda scene, t, state: rk.contact_of(scene, t, state).position[:1],
        jnp.asarray(seen)[:, None],
        sigma=sigma,
    )
    free = rk.Free(DRAG), rk.Free(SPIN)
    return rk.fit(scene, start, rk.Record(TIMES, {"place": place}), free), seen


def _place(drag, spin):
    x = np.maximum(drag[..., None] * TIMES / 1.4, 1e-12)
    return spin[..., None] * RADIUS * TIMES * -np.expm1(-x) / x


@pytest.mark.slow
@pytest.mark.parametrize(("true", "seed"), [(0.0, 3), (0.05, 1)])
def test_a_drag_near_zero_is_that_of_quadrature(true, seed):
    """Its estimate is zero in the first, and 1.3 deviations from it in the other."""
    sigma = 0.002
    found, seen = _dragged(true, sigma, seed)
    draws = _posterior(found, seed=seed)
    drag, spin = np.linspace(0.0, 0.6, 1201), np.linspace(1.8, 2.4, 601)
    density = np.array(
        [
            np.exp(
                -0.5 * np.sum((_place(c + 0 * spin, spin) - seen) ** 2, -1) / sigma**2
            )
            for c in drag
        ]
    )
    assert (found.estimates[DRAG] == 0.0) == (true == 0.0)
    for path, x, axis in ((DRAG, drag, 1), (SPIN, spin, 0)):
        own = density.sum(axis=axis)
        # half a cell, 1 % of a deviation at most
        shares = (np.cumsum(own) - 0.5 * own) / own.sum()
        below = lambda z, x=x, shares=shares: np.interp(z, x, shares)
        assert _agree(draws, path, below)
