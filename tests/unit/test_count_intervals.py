"""Intervals of mean counts: within what counts can be, and with a width."""

import numpy as np
import pytest
from scipy import stats

import rollkane as rk
from rollkane.uncertainty.statistics_summary import summary

LEVEL = 0.95


def _interval(values, group_count=None, level=LEVEL):
    found, count = rk.Statistics(group_count), len(values)
    groups = None if group_count is None else np.arange(count) % group_count
    found.add({"count": np.asarray(values)}, np.ones(count, bool), groups)
    return found.interval("count", level)


@pytest.mark.parametrize("group_count", [None, 16])
@pytest.mark.parametrize("hits", [0, 1, 3, 19])
def test_of_a_few_single_events_a_mean_is_a_probability(hits, group_count):
    """A count of 0 or 1 has the interval of a probability, or one drawn out."""
    low, high = _interval(np.arange(1000) < hits, group_count)  # truth values
    known = np.array([low, high])
    low, high = _interval((np.arange(1000) < hits).astype(int), group_count)
    np.testing.assert_allclose(low, known[0], rtol=1e-12)  # a few roundings
    assert known[1] * (1.0 - 1e-12) <= high < known[1] + 1.0 / 1000.0


def test_a_count_that_is_the_same_in_all_members_may_be_another():
    """By 3.84 of 1000 members, up and, above zero, down: Wilson's of no hit."""
    far = stats.norm.ppf(0.975) ** 2 / (1000.0 + stats.norm.ppf(0.975) ** 2)
    for number in (0, 1, 5):
        low, high = _interval(np.full(1000, number))
        known = number - far * (number > 0), number + far
        np.testing.assert_allclose((low, high), known, rtol=1e-12)  # a few roundings
    # what is not said to be whole is a constant
    assert _interval(np.full(1000, 5.0)) == (5.0, 5.0)
    assert np.isnan(_interval(np.array([3]))).all()


def test_many_counts_have_students_interval():
    values = np.random.default_rng(0).poisson(3.0, 500)
    known = stats.t(499, values.mean(), stats.sem(values)).interval(LEVEL)
    np.testing.assert_allclose(_interval(values), known, rtol=1e-9)
    np.testing.assert_allclose(_interval(values.astype(float)), known, rtol=1e-9)
    # and what is less than nothing is no count
    known = stats.t(499, values.mean() - 3.0, stats.sem(values)).interval(LEVEL)
    np.testing.assert_allclose(_interval(values - 3), known, rtol=1e-9)


@pytest.mark.parametrize("mean", [0.01, 0.03, 0.1])
def test_coverage_of_means_of_counts(mean):
    """Student's interval alone held 86 % of the rarest, and began below zero."""
    random, members, often = np.random.default_rng(1), 200, 400
    held = 0
    for _ in range(often):
        low, high = _interval(random.poisson(mean, members))
        assert low >= 0.0
        held += low <= mean <= high
    # 93 %, as of probabilities, less 3.1 deviations: one of 1000 such tests fails
    assert held >= stats.binom(often, 0.93).ppf(1e-3)


@pytest.mark.parametrize(
    ("rare", "large", "single", "members"),
    [(0.02, 9, 0.2, 150), (0.02, 20, 0.3, 250)],
)
def test_coverage_where_few_large_numbers_make_the_mean(rare, large, single, members):
    """Many members have 1, few a large number: 89 and 90 % were held."""
    random, often = np.random.default_rng(1), 1000
    mean, held = rare * large + single, 0
    for _ in range(often):
        drawn = random.random(members)
        values = np.where(drawn < rare, large, drawn < rare + single)
        low, high = _interval(values)
        held += low <= mean <= high
    # as above
    assert held >= stats.binom(often, 0.93).ppf(1e-3)


def test_few_larger_and_smaller_ones_are_not_all_to_one_side():
    """Of 1000 members 5 have one more, and 5 one less: errors of both, as squares."""
    values = np.repeat([2, 3, 4], [5, 990, 5])
    (low, high), share = _interval(values), _interval(np.arange(1000) < 5)
    np.testing.assert_allclose(3.0 - low, high - 3.0, rtol=1e-9)
    apart = np.hypot(share[1] - 0.005, 0.005 - share[0])
    np.testing.assert_allclose(high - 3.0, apart, rtol=1e-9)


def test_what_an_interval_supposes_is_told():
    """That no member is farther away than those that were seen."""

    def found(values):
        made = rk.Statistics()
        made.add({"count": np.asarray(values)}, np.ones(len(values), bool))
        return made

    none = found(np.zeros(200, int))
    assert "all 200 members have 0" in none.note("count")
    few = found(5 * (np.arange(200) < 3))
    assert "3 of 200 members have another number than 0, by up to 5" in str(few)
    assert few.reason("count") == ""
    assert summary(few)["numbers"]["count"]["note"] == few.note("count")
    many = found(np.random.default_rng(0).poisson(3.0, 500))
    assert many.note("count") == ""
    # a constant that is not said to be whole is no count
    assert found(np.full(200, 5.0)).note("count") == ""
    assert found(np.arange(200.0) < 3).note("count") == ""


def test_a_study_of_no_event_is_not_precise_at_once():
    """Its mean count had an interval without a width, which ended it."""
    found = rk.Statistics()
    found.add({"count": np.zeros(100, int)}, np.ones(100, bool))
    assert not rk.Precision("count", absolute=0.01).reached(found)
