"""Quantiles of a stream: exact while few, then within the told error of rank."""

import dataclasses

import numpy as np
import pytest
from scipy import stats

from rollkane.uncertainty.intervals import quantile_ranks
from rollkane.uncertainty.quantile_sketch import GroupedSketch, QuantileSketch

COUNT = 50_000
RNG = np.random.default_rng(3)
UP = np.arange(float(COUNT))
ORDERS = {
    "rising": UP,
    "falling": UP[::-1],
    "random": RNG.permutation(UP),
    "from both ends": np.stack([UP, UP[::-1]], axis=1).ravel()[:COUNT],
    "many equal": np.floor(RNG.exponential(2.0, COUNT)),
    "one far off": np.where(UP == 777.0, -1e300, RNG.normal(size=COUNT)),
    "all equal": np.full(COUNT, 3.5),
}


def fed(values, size, cuts=()):
    sketch = QuantileSketch(size)
    for piece in np.split(values, cuts):
        sketch = sketch.add(piece)
    return sketch


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("size", [64, 1024])
def test_ranks_are_within_the_error_that_is_told(order, size):
    values = ORDERS[order]
    sketch = fed(values, size)
    assert sketch.count == COUNT
    for q in (0.001, 0.05, 0.3, 0.5, 0.9, 0.999):
        value, *_ = sketch.quantile(q)
        wanted = np.ceil(q * COUNT)
        # its told rank reaches the wanted one, that of all below it does not
        assert np.sum(values <= value) >= wanted - sketch.above
        assert np.sum(values < value) <= wanted - 1 + sketch.below


@pytest.mark.parametrize("size", [64, 1024])
def test_the_error_is_what_merging_costs(size):
    sketch = fed(UP, size)
    above = below = 0
    level, buffers = 0, COUNT // size
    while buffers > 1:
        merges = buffers // 2  # each costs at most 2^level ranks, up and down in turn
        above += (merges + 1) // 2 << level
        below += merges // 2 << level
        level, buffers = level + 1, merges
    assert (sketch.above, sketch.below) == (above, below)
    # about n / (4 size) on every level
    assert above <= level * (COUNT / (4 * size) + 2**level)


def test_memory_grows_with_the_logarithm():
    kept = lambda s: (
        sum(map(np.size, s.recent)) + sum(np.size(x) for x in s.levels if x is not None)
    )
    sketch = fed(UP, 64)
    # one buffer a level at most, of log2(50000 / 64) = 9.6, and one that fills
    assert kept(sketch) <= 64 * (10 + 1)


def test_few_values_are_kept_exactly():
    values = RNG.normal(size=2 * 256 - 1)
    sketch = fed(values, 256)
    assert sketch.above == sketch.below == 0
    for q in (0.01, 0.25, 0.5, 0.99):
        value, low, high = sketch.quantile(q, 0.9)
        ranks = quantile_ranks(q, values.size, 0.9)
        ordered = np.concatenate([[-np.inf], np.sort(values), [np.inf]])
        assert value == np.sort(values)[int(np.ceil(q * values.size)) - 1]
        assert (low, high) == tuple(ordered[list(ranks)])


def test_how_values_are_handed_over_does_not_matter():
    values = ORDERS["random"]
    whole = fed(values, 128)
    for seed in range(3):
        cuts = np.sort(np.random.default_rng(seed).integers(0, COUNT, 40))
        parts = fed(values, 128, cuts)
        assert (parts.above, parts.below) == (whole.above, whole.below)
        for q in np.linspace(0.01, 0.99, 25):
            assert parts.quantile(q) == whole.quantile(q)


def test_adding_changes_no_sketch_made_before():
    before = fed(UP[:1000], 64)
    told = before.quantile(0.3)
    before.add(UP[1000:])
    assert before.quantile(0.3) == told
    assert before.count == 1000


def test_two_merged_are_one_of_all_values():
    values = ORDERS["random"]
    both = fed(values[:20_100], 64).merge(fed(values[20_100:], 64))
    assert both.count == COUNT
    assert both.extremes == (0.0, COUNT - 1.0)
    for q in (0.01, 0.5, 0.9):
        value, *_ = both.quantile(q)
        wanted = np.ceil(q * COUNT)
        assert np.sum(values <= value) >= wanted - both.above
        assert np.sum(values < value) <= wanted - 1 + both.below


def test_groups_in_sketches_of_their_own():
    values, groups = ORDERS["random"], RNG.integers(0, 5, COUNT)
    whole = GroupedSketch.of_nothing(5, 64).add(values, groups)
    parts = GroupedSketch.of_nothing(5, 64)
    for where in np.split(np.arange(COUNT), [7, 400, 30_000]):
        parts = parts.add(values[where], groups[where])
    alone = [fed(values[groups == k], 64) for k in range(5)]
    assert whole.count == COUNT
    assert whole.above == sum(sketch.above for sketch in alone)
    for q in (0.001, 0.3, 0.5, 0.999):
        value, low, high = whole.quantile(q)
        assert parts.quantile(q) == (value, low, high)
        wanted = np.ceil(q * COUNT)
        assert np.sum(values <= value) >= wanted - whole.above
        assert np.sum(values < value) <= wanted - 1 + whole.below
        assert low <= q * COUNT <= high  # the values are the ranks
    share = alone[2].share_below(12_345.0)
    exact = np.mean(values[groups == 2] <= 12_345.0)
    error = max(alone[2].above, alone[2].below) / alone[2].count
    assert abs(share - exact) <= error


def test_none_and_too_few():
    assert np.isnan(QuantileSketch(64).quantile(0.5)).all()
    value, low, high = fed(np.array([1.0, 2.0, 3.0]), 64).quantile(0.5)
    # 3 of 3 are on one side of the median with probability 1/8: more than 2.5 %
    assert (value, low, high) == (2.0, -np.inf, np.inf)
    # 8 on one side: 1/256; at the ends of a sketch that keeps not all, extremes
    sketch = fed(UP, 64)
    _, low, high = sketch.quantile(0.001)
    assert low == 0.0
    assert high > 50.0


def test_ends_hold_the_exact_order_statistics():
    """Moved outwards by the error of rank they hold those of all values."""
    values = ORDERS["random"]
    ordered, sketch = np.sort(values), fed(values, 64)
    for q in (0.02, 0.5, 0.97):
        _, low, high = sketch.quantile(q)
        lower, upper = quantile_ranks(q, COUNT, 0.95)
        assert low <= ordered[lower - 1]
        assert high >= ordered[upper - 1]
        # no farther than both errors, told ranks lying at most 2^9 apart
        apart = sketch.above + sketch.below + 2**9
        assert low >= ordered[max(lower - 1 - apart, 0)]
        assert high <= ordered[min(upper - 1 + apart, COUNT - 1)]


def test_ends_are_moved_by_the_error_of_rank():
    exact = fed(UP[:1000], 1024)
    lower, upper = quantile_ranks(0.4, 1000, 0.95)
    assert exact.quantile(0.4) == (399.0, lower - 1.0, upper - 1.0)
    unsure = dataclasses.replace(exact, above=30, below=50)
    assert unsure.quantile(0.4) == (399.0, lower - 51.0, upper + 29.0)


@pytest.mark.parametrize("count", [1, 7, 40, 1000, 123_457])
@pytest.mark.parametrize("q", [0.003, 0.5, 0.9])
@pytest.mark.parametrize("level", [0.5, 0.95, 0.999])
def test_ranks_have_the_level_and_no_more_than_needed(count, q, level):
    low, high = quantile_ranks(q, count, level)
    below, tail = stats.binom(count, q), 0.5 * (1.0 - level)
    # 1e-9: rounding of 1e5 terms' logarithms, of some 1e-11, in tails of a thousandth
    assert below.cdf(low - 1) <= tail * (1.0 + 1e-9)
    assert below.cdf(low) > tail * (1.0 - 1e-9)
    assert below.sf(high - 1) <= tail * (1.0 + 1e-9) or high == count + 1
    assert high == 1 or below.sf(high - 2) > tail * (1.0 - 1e-9)
