"""Confidence intervals against SciPy's distributions and against exact coverage."""

import numpy as np
import pytest
from scipy import stats

import rollkane as rk
from rollkane.uncertainty.intervals import (
    checked_level,
    mean_half_width,
    probability_interval,
    student_quantile,
)


@pytest.mark.parametrize("freedom", [1, 2, 3, 4, 15, 100, 499, 500, 501, 10_000])
@pytest.mark.parametrize("level", [0.5, 0.9, 0.95, 0.999, 0.999999])
def test_students_quantiles(freedom, level):
    exact = stats.t.ppf(0.5 + 0.5 * level, freedom)
    # halvings end at the angle's rounding, which the tangent of 1 - 1e-6 raises by 1e6
    assert student_quantile(level, freedom) == pytest.approx(exact, rel=1e-9)


def test_wilsons_interval_where_hits_are_many():
    for hits, count in ((21, 42), (21, 1000), (500, 1000), (979, 1000)):
        exact = stats.binomtest(hits, count).proportion_ci(0.9, method="wilson")
        found = probability_interval(hits, count, 0.9)
        np.testing.assert_allclose(found, exact, rtol=1e-12)  # a few roundings


@pytest.mark.parametrize("count", [3, 40, 10**6])
def test_where_hits_are_few_no_end_lies_inside_the_mid_p_interval(count):
    hits = np.arange(min(count, 20) + 1)
    low, high = probability_interval(hits, count, 0.95)
    # the tails at both ends, half of what was seen in each; solved to 1e-15 of them
    below = stats.binom(count, high)
    assert np.all(
        (below.cdf(hits) - 0.5 * below.pmf(hits) <= 0.025 + 1e-9)[hits < count]
    )
    above = stats.binom(count, low)
    assert np.all(
        (above.sf(hits - 1) - 0.5 * above.pmf(hits) <= 0.025 + 1e-9)[hits > 0]
    )
    wilson = stats.binomtest(2, count).proportion_ci(method="wilson")
    assert low[2] <= wilson.low * (1.0 + 1e-12)  # a few roundings
    assert high[2] >= wilson.high * (1.0 - 1e-12)


def test_no_hit_and_all_hits():
    for count in (1, 10, 1000, 10**9):
        low, high = probability_interval(0, count, 0.95)
        assert low == 0.0
        # seeing none is less likely there than the level leaves: the whole of what it
        # leaves, as the other end is never missed
        assert stats.binom(count, high).pmf(0) <= 0.05 * (1.0 + 1e-9)
        mirrored = probability_interval(count, count, 0.95)
        # of the subtraction from one
        np.testing.assert_allclose(mirrored, (1.0 - high, 1.0), rtol=0, atol=1e-15)
    # Wilson's z^2 / (n + z^2), wider than the 3 / n of the mid-P interval
    z2 = 1.959963984540054**2
    assert probability_interval(0, 1000, 0.95)[1] == pytest.approx(z2 / (1000 + z2))
    assert probability_interval(0, 0, 0.95) == (0.0, 1.0)


@pytest.mark.parametrize("count", [1, 5, 30, 1000])
@pytest.mark.parametrize("level", [0.9, 0.95, 0.99, 0.999])
def test_coverage_of_every_probability(count, level):
    """Exact coverage, by summing the binomial distribution."""
    few = np.geomspace(1e-3 / count, 0.1, 400)
    p = np.concatenate([few, np.linspace(0.1, 0.5, 300)])
    hits = np.arange(count + 1)
    low, high = probability_interval(hits, count, level)
    terms = stats.binom(count, p[:, None]).pmf(hits)
    covered = np.sum(terms * ((low <= p[:, None]) & (p[:, None] <= high)), axis=1)
    # Below each end of a mid-P interval lie hits of less than the tail, and half of
    # one number of hits, which is less than the tail: no more than twice both tails.
    assert covered.min() > 1.0 - 2.0 * (1.0 - level)
    if count >= 30 and level == 0.95:
        assert covered.min() > 0.93  # as the function says
        # on average the level; somewhat more where members are few and numbers coarse
        assert -0.002 < covered[-300:].mean() - level < 0.01


def test_means_of_few():
    half = mean_half_width([2.0, 2.0, 2.0], [1, 2, 9], 0.95)
    assert np.isnan(half[0])
    exact = [stats.t.ppf(0.975, n - 1) * 2.0 / np.sqrt(n) for n in (2, 9)]
    np.testing.assert_allclose(half[1:], exact, rtol=1e-9)  # of the quantile


@pytest.mark.parametrize("level", [0.0, 1.0, 95, -0.1, "0.95", None, np.nan])
def test_levels_that_are_none(level):
    with pytest.raises(rk.FieldError, match="level"):
        checked_level(level)
