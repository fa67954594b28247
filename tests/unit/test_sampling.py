"""Samples of uniform numbers: the same for any blocks, balanced, and independent."""

import json
import pickle
import sys

import numpy as np
import pytest
import scipy.stats

import rollkane as rk
from rollkane.uncertainty.sampling import KINDS, SETS, sampler

SIZE = 1024
# Of tests at seeds that were not chosen: they fail for one seed in ten thousand.
P = 1e-4


@pytest.mark.parametrize("dimension", [1, 3, 9])
@pytest.mark.parametrize("kind", KINDS)
def test_members_do_not_depend_on_their_block(kind, dimension):
    """Bit for bit, in blocks of any size, in any order, in another process."""
    size = 1000  # of no kind's liking
    whole = sampler(kind, dimension, 7, size).uniforms(0, size)
    random = np.random.default_rng(0)
    for _ in range(3):
        cuts = np.unique([0, size, *random.integers(0, size, random.integers(1, 40))])
        blocks = list(zip(cuts[:-1].tolist(), cuts[1:].tolist(), strict=True))
        random.shuffle(blocks)
        one = pickle.loads(pickle.dumps(sampler(kind, dimension, 7, size)))
        for first, last in blocks:
            found = one.uniforms(first, last - first)
            np.testing.assert_array_equal(found, whole[first:last])
            groups = one.groups(first, last - first)
            np.testing.assert_array_equal(groups, one.groups(0, size)[first:last])
    assert one.uniforms(5, 0).shape == (0, dimension)


@pytest.mark.parametrize("kind", KINDS)
def test_numbers_are_inside_and_fine(kind):
    u = sampler(kind, 5, 0, 2**14).uniforms(0, 2**14)
    assert u.dtype == np.float64
    assert u.shape == (2**14, 5)
    assert ((u > 0.0) & (u < 1.0)).all()
    # steps of 2^-50 and less: doubles above a half are multiples of 2^-53, of which one
    # in sixteen is one of 2^-49; of numbers with fewer digits all would be
    assert np.mean(u * 2.0**49 % 1.0 == 0.0) < 0.1
    for column in u.T:
        assert scipy.stats.kstest(column, "uniform").pvalue > P
    # five columns: ten pairs, each correlation of deviation 1 / sqrt(n) at most
    apart = np.corrcoef(u.T) - np.eye(5)
    assert np.abs(apart).max() < scipy.stats.norm.isf(P / 20.0) / np.sqrt(2**14)


@pytest.mark.parametrize("kind", KINDS)
def test_seeds_are_apart(kind):
    first, again, other = (
        sampler(kind, 3, seed, SIZE).uniforms(0, SIZE) for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(first, again)
    assert not (first == other).any()
    joined = np.corrcoef(first.T, other.T)[:3, 3:]
    if kind == "sobol":  # a digit of all points is the same or the other one
        return
    assert np.abs(joined).max() < scipy.stats.norm.isf(P / 18.0) / np.sqrt(SIZE)


@pytest.mark.parametrize("kind", KINDS)
def test_descriptions_identify(kind):
    """Another size is the same sample, but of Latin sets."""
    spec = lambda *given: json.dumps(sampler(kind, *given).spec())
    known = spec(3, 1, 512)
    assert known == spec(3, 1, 512)
    assert (known == spec(3, 1, 1024)) == (kind != "latin")
    assert len({known, spec(3, 2, 512), spec(4, 1, 512)}) == 3


def test_plain_members_are_those_of_philox():
    """Which NumPy promises to keep: a study goes on with another version."""
    u = sampler("plain", 3, 12, 10).uniforms(0, 2)
    key = np.random.SeedSequence(12, spawn_key=(1,)).generate_state(2, np.uint64)
    words = np.random.Philox(key=key).random_raw(8).reshape(2, 4)[:, :3]
    np.testing.assert_array_equal(u, ((words >> np.uint64(12)) + 0.5) / 2.0**52)
    far = sampler("plain", 3, 12, 10**12).uniforms(10**12 - 2, 2)
    assert ((far > 0.0) & (far < 1.0)).all()


@pytest.mark.parametrize("kind", ["plain", "sobol"])
def test_members_do_not_depend_on_the_size(kind):
    few, many = (sampler(kind, 4, 3, n).uniforms(0, 100) for n in (100, 10**6))
    np.testing.assert_array_equal(few, many)


@pytest.mark.parametrize("size", [16, 32, 37, 160, 200, 1000])
def test_every_latin_set_is_a_latin_hypercube(size):
    latin = sampler("latin", 3, 5, size)
    u, groups = latin.uniforms(0, size), latin.groups(0, size)
    length = latin.set_size
    assert latin.group_count == len(np.unique(groups)) == groups.max() + 1
    for group in range(groups.max() + 1):
        members = u[groups == group]
        strata = np.sort(np.floor(members * length).astype(int), axis=0)
        if len(members) == length:
            expected = np.tile(np.arange(length)[:, None], (1, 3))
            np.testing.assert_array_equal(strata, expected)
        else:  # the last is cut: of no stratum two
            assert group == groups.max()
            assert (np.diff(strata, axis=0) > 0).all()
    assert (latin.note is None) == (size % length == 0)


def test_no_latin_set_is_cut_to_less_than_half():
    """Such a set is in the mean, but not in its interval."""
    for size in range(2, 1001):
        length = sampler("latin", 1, 0, size).set_size
        left = size % length
        assert left == 0 or left >= 0.5 * length
        assert max(2, size / SETS) <= length < 3.5 * max(2, size / SETS)  # 8 of 37


@pytest.mark.parametrize("size", [200, 433])
def test_means_of_latin_samples_err_as_they_say(size):
    """Over seeds: (mean - 1/2) over its standard error is Student's."""
    seeds = 400
    ratios = []
    for seed in range(seeds):
        latin = sampler("latin", 1, seed, size)
        count = latin.group_count
        assert count is not None
        found = rk.Statistics(group_count=count)
        u, groups = latin.uniforms(0, size)[:, 0], latin.groups(0, size)
        found.add({"u": u}, np.ones(size, bool), groups)
        low, high = found.interval("u")
        assert low < found.mean["u"] < high
        ratios.append((found.mean["u"] - 0.5) / found.standard_error["u"])
    free = count - 1
    squared = np.mean(np.square(ratios))
    # the mean square of Student's t, known to sqrt((kurtosis - 1) / seeds) of itself;
    # four of these, and a fifth more for a last set that is smaller than the others
    spread = np.sqrt((3.0 * (free - 2.0) / (free - 4.0) - 1.0) / seeds)
    assert squared < 1.2 * free / (free - 2.0) * (1.0 + 4.0 * spread)


def test_places_in_strata_are_uniform_and_sets_are_independent():
    size = 2**12
    latin = sampler("latin", 2, 5, size)
    length = size // SETS
    u = latin.uniforms(0, size)
    within = u * length % 1.0
    assert all(scipy.stats.kstest(x, "uniform").pvalue > P for x in within.T)
    sets = u.reshape(SETS, length, 2)
    every = np.corrcoef(np.concatenate([sets[..., 0], sets[..., 1]]))
    pairs = np.abs(every - np.eye(2 * SETS)).max()
    count = SETS * (2 * SETS - 1)
    assert pairs < scipy.stats.norm.isf(0.5 * P / count) / np.sqrt(length)


def test_every_scramble_is_a_net():
    """Of 64 points one in every interval of 1/64, in boxes of 1/8 by 1/8 likewise."""
    size = 64 * SETS
    sobol = sampler("sobol", 4, 5, size)
    u, groups = sobol.uniforms(0, size), sobol.groups(0, size)
    assert sobol.group_count == SETS
    assert (groups == np.arange(size) % SETS).all()
    for scramble in range(SETS):
        points = u[groups == scramble]
        for column in points.T:
            assert len(np.unique(np.floor(64 * column))) == 64
        # the first two dimensions of the sequence are a (0, 2)-sequence
        boxes = np.floor(8 * points[:, :2]) @ [8, 1]
        assert len(np.unique(boxes)) == 64


@pytest.mark.parametrize("kind", ["latin", "sobol"])
def test_groups_are_independent(kind):
    """The error of a mean is what its groups say: by an F test over many seeds."""
    size, seeds = 32 * SETS, 60
    exact = (np.e - 1.0) ** 3
    errors, within = [], []
    for seed in range(seeds):
        one = sampler(kind, 3, seed, size)
        x = np.exp(one.uniforms(0, size).sum(axis=1))
        groups = one.groups(0, size)
        means = np.array([x[groups == g].mean() for g in range(SETS)])
        errors.append((means.mean() - exact) ** 2)
        within.append(means.var(ddof=1) / SETS)
    ratio = np.mean(errors) / np.mean(within)
    law = scipy.stats.f(seeds, seeds * (SETS - 1))
    assert law.ppf(P / 2.0) < ratio < law.isf(P / 2.0)


def test_balanced_samples_know_smooth_means_better():
    """Deviations of means over 16 groups: whole numbers of orders apart."""
    size = 2**14
    value = lambda u: np.exp(u).sum(axis=1)
    exact = 3.0 * (np.e - 1.0)
    errors = {}
    for kind in KINDS:
        one = sampler(kind, 3, 11, size)
        x = value(one.uniforms(0, size))
        if one.group_count is None:
            errors[kind] = x.std() / np.sqrt(size)
        else:
            groups = one.groups(0, size)
            means = np.array([x[groups == g].mean() for g in range(one.group_count)])
            errors[kind] = means.std(ddof=1) / np.sqrt(len(means))
        # student's t of 15 degrees of freedom
        limit = scipy.stats.t.isf(P / 2.0, 15)
        assert abs(x.mean() - exact) < limit * errors[kind]
    # an additive function: n^-1/2, then (n/16)^-3/2 / 4 of either balanced one; at
    # 2^14 that is 1 : 1e-3, within a factor of three
    assert errors["latin"] < 0.004 * errors["plain"]
    assert errors["sobol"] < 0.004 * errors["plain"]


@pytest.mark.parametrize(
    ("size", "says"),
    [(1024, None), (16, None), (1000, "512 and 1024"), (3, "16 and 32")],
)
def test_a_note_says_which_sizes_are_balanced(size, says):
    note = sampler("sobol", 2, 0, size).note
    assert note is None if says is None else says in note


REFUSED = {
    "another kind": (("halton", 2, 0, 16), "sampler.kind", "use one of"),
    "no dimension": (("plain", 0, 0, 16), "sampler.dimension", "at least 1"),
    "a negative seed": (("plain", 2, -1, 16), "sampler.seed", "at least 0"),
    "half a seed": (("plain", 2, 0.5, 16), "sampler.seed", "whole number"),
    "no members": (("latin", 2, 0, 0), "sampler.size", "at least 1"),
    "too many dimensions": (
        ("sobol", 21202, 0, 16),
        "sampler.dimension",
        'take "latin"',
    ),
    "too many members": (("sobol", 2, 0, 2**36 + 1), "sampler.size", 'take "plain"'),
}


@pytest.mark.parametrize("name", REFUSED)
def test_refused(name):
    given, field, says = REFUSED[name]
    with pytest.raises(rk.FieldError, match=says) as caught:
        sampler(*given)
    assert caught.value.field == field


def test_a_range_that_is_none():
    one = sampler("plain", 2, 0, 16)
    with pytest.raises(rk.FieldError, match="members count from 0"):
        one.uniforms(-1, 3)


def test_without_scipy(monkeypatch):
    monkeypatch.setitem(sys.modules, "scipy.stats", None)
    with pytest.raises(ImportError, match=r"pip install 'rollkane\[study\]'"):
        sampler("sobol", 2, 0, 16)
    sampler("latin", 2, 0, 16).uniforms(0, 16)
