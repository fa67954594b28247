"""Sobol indices: closed values, coverage of intervals, and what failures may do."""

import itertools

import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk
from rollkane.uncertainty.distributions import Normal, Uniform, UniformOrientation
from rollkane.uncertainty.evaluation import FunctionModel
from rollkane.uncertainty.sobol_estimates import Design, bound_sums, index_bounds
from rollkane.uncertainty.sobol_few_hits import with_few_hits

from ..model_failures import Failing
from ..rolling_models import Inclined

A, B = 7.0, 0.1
RANGES = {name: Uniform(-np.pi, np.pi) for name in "xyz"}


def ishigami(drawn):
    x, y, z = drawn["x"], drawn["y"], drawn["z"]
    return jnp.sin(x) + A * jnp.sin(y) ** 2 + B * z**4 * jnp.sin(x)


def closed():
    """First-order and total indices (Ishigami and Homma, 1990)."""
    x = 0.5 * (1.0 + B * np.pi**4 / 5.0) ** 2
    y = A**2 / 8.0
    both = B**2 * np.pi**8 * (1.0 / 18.0 - 1.0 / 50.0)
    total = x + y + both
    return np.array([x, y, 0.0]) / total, np.array([x + both, y, both]) / total


MODEL = FunctionModel(ishigami, RANGES)
FIRST, TOTAL = closed()


def inside(found, first, total, name="value"):
    """Whether each index is in its interval, first and total behind each other."""
    return np.concatenate(
        [
            (ends[name][0] <= true) & (true <= ends[name][1])
            for ends, true in (
                (found.first_interval, first),
                (found.total_interval, total),
            )
        ]
    )


@pytest.mark.parametrize("sampling", ["sobol", "plain"])
def test_ishigami(sampling):
    # one seed of intervals that leave out an index in 1000: 6 of them cover
    found = rk.sobol_indices(MODEL, 2048, level=0.999, sampling=sampling)
    assert inside(found, FIRST, TOTAL).all()
    assert found.evaluations == 5 * 2048
    assert found.names == ("x", "y", "z")
    # of 2048 rows: standard errors of at most 0.022, and some 3 of these on each side
    width = found.first_interval["value"][1] - found.first_interval["value"][0]
    assert (width < 0.2).all()


@pytest.mark.parametrize("share", [0.0, 0.05])
def test_intervals_cover_what_they_promise(share):
    """Of 100 repetitions, 95 expected; 3 deviations of a binomial number are 6.5."""
    hits = sum(
        inside(rk.sobol_indices(Failing(MODEL, share, s), 512, seed=s), FIRST, TOTAL)
        for s in range(100)
    )
    assert (hits >= 88).all()
    # all six together are 600 trials, correlated within a repetition: 3 deviations
    # were the six one trial each
    assert 88.4 <= hits.mean() <= 99.5


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.0, 0.05])
def test_intervals_of_plain_samples_cover(share):
    hits = sum(
        inside(
            rk.sobol_indices(
                Failing(MODEL, share, s), 2048, seed=s, sampling="plain", resamples=500
            ),
            *(FIRST, TOTAL),
        )
        for s in range(200)
    )
    # 3 deviations of a binomial number of 200 are 9.2
    assert (hits >= 180).all()


@pytest.mark.parametrize("share", [0.0, 0.05])
def test_a_rolling_ball(share):
    """Every motion is rolled by the ensemble; the indices are closed."""
    model = Inclined()
    first, total = model.indices()
    hits = sum(
        inside(
            rk.sobol_indices(Failing(model, share, s), 256, seed=s),
            *(first, total, "distance"),
        )
        for s in range(10)
    )
    # 60 intervals of 95 %: 57 expected; those of one repetition go together, so that
    # the deviation is at most sqrt(6) that of 60 trials, 4.1, and two are allowed
    assert hits.sum() >= 48


def test_rows_with_a_failure_are_dropped_whole():
    """Against the design written out, and its estimator on the rows that are left."""
    failing = Failing(MODEL, 0.1, 3)
    found = rk.sobol_indices(failing, 256, seed=5)
    bad = failing.bad.reshape(5, 256)
    assert found.dropped["value"] == bad.any(axis=0).sum()
    assert found.failed == bad.sum()
    kept = ~bad.any(axis=0)
    parts = rk.sobol_indices(Recorded(MODEL), 256, seed=5)
    assert not parts.dropped["value"]
    a, _, *c = Recorded.last.reshape(5, 256)[:, kept]
    every = Recorded.last.reshape(5, 256)[:, kept]
    expected = [0.5 * np.mean((a - x) ** 2) / every.var() for x in c]
    # sums of 200 numbers of order one: their rounding
    np.testing.assert_allclose(found.total["value"], expected, rtol=1e-12)


class Recorded:
    """Keeps the last outputs."""

    last = np.zeros(0)

    def __init__(self, model):
        self.model, self.draws = model, model.draws

    def evaluate(self, u):
        found = self.model.evaluate(u)
        Recorded.last = found.values["value"]
        return found


def test_failures_are_said_loudly():
    text = str(rk.sobol_indices(Failing(MODEL, 0.05), 512))
    assert "WARNING" in text
    assert "FAILED" in text
    assert "rows" in text
    assert "could be" in text
    assert "max_steps" in text  # what code 1 says
    assert "WARNING" not in str(rk.sobol_indices(MODEL, 64))


EVENT = FunctionModel(
    lambda drawn: (drawn["x"] > 0.9) & (drawn["y"] > 0.8),
    {name: Uniform(0.0, 1.0) for name in "xyz"},
)
# of two independent conditions of probabilities a = 0.1 and b = 0.2, P = a b: the
# variances of b [x > 0.9] and of a [y > 0.8] over P (1 - P), and 1 less the other's
EVENT_FIRST = np.array([0.2 * 0.9, 0.1 * 0.8, 0.0]) / 0.98
EVENT_TOTAL = np.array([0.9, 0.8, 0.0]) / 0.98


@pytest.mark.parametrize("sampling", ["sobol", "plain"])
@pytest.mark.parametrize("size", [512, 2048])
def test_intervals_of_an_event_of_few_percent_cover(sampling, size):
    """Of 1 and of 4 rows in which both of y's pair are the event, on average.

    Of 40 intervals of 95 % 38 are expected; 3 deviations of a binomial number are 4.1.
    """
    how = {"sampling": sampling, "resamples": 200}
    found = [rk.sobol_indices(EVENT, size, seed=s, **how) for s in range(40)]
    hits = sum(inside(one, EVENT_FIRST, EVENT_TOTAL) for one in found)
    assert (hits >= 34).all()
    first = np.array([one.first["value"] for one in found])
    # what changes nothing: the product of two numbers that are small at random
    assert abs(first[:, 2]).max() < 1e-2
    # at least 20 events of each sample of 2048 rows: its index to 4 deviations
    upper = np.array([one.first_interval["value"][1, 2] for one in found])
    assert (upper < 0.5 * 512 / size).all()


def test_what_no_row_shows_may_be_all_the_same():
    """A factor that changed none of 500 events; of none, 3.84 of n might have been."""
    rng = np.random.default_rng(3)
    one, other = (rng.random((2, 500, 1)) < 0.05).astype(float)
    design = Design(one, other, one[:, None])
    p = design.every().mean()
    resampled = {kind: np.zeros((2, 1, 1)) for kind in ("first", "total")}
    ends = with_few_hits(design, resampled, 0.95)
    assert (ends["total"][0] == 0.0).all()
    # 3.84 is rounded, and a limit of large n
    expected = 3.84 / 500 / (2.0 * p * (1.0 - p))
    assert ends["total"][1, 0, 0] == pytest.approx(expected, rel=0.01)
    assert 0.0 < ends["first"][1, 0, 0] <= ends["total"][1, 0, 0]
    # an output of many values says how much it varies
    many = Design(*(x + 1e-3 * rng.random(x.shape) for x in design))
    kept = with_few_hits(many, resampled, 0.95)
    assert all((x == 0.0).all() for x in kept.values())


def test_events_so_rare_that_a_sample_may_show_none():
    """Without NumPy's warning of 0 / 0; what no resample tells is NaN."""
    both = lambda drawn: (drawn["x"] > 0.95) & (drawn["y"] > 0.98)  # of 0.001
    model = FunctionModel(both, {name: Uniform(0.0, 1.0) for name in "xyz"})
    known = 0
    for seed in range(12):
        found = rk.sobol_indices(model, 256, seed=seed, sampling="plain")
        low, high = np.asarray(found.total_interval["value"])
        told = np.isfinite(low)
        known += int(told.any())
        assert ((low <= high) | ~told).all()
    # 5 * 256 motions of 0.001 show none with a probability of 0.28
    assert 0 < known < 12


def test_bounds_of_an_event_hold_its_intervals():
    found = rk.sobol_indices(Failing(EVENT, 1e-3), 512)
    assert found.dropped["value"] > 0
    for ends, bounds in (
        (found.first_interval, found.first_bounds),
        (found.total_interval, found.total_bounds),
    ):
        low, high = np.clip(ends["value"], 0.0, 1.0)
        assert (bounds["value"][0] <= low).all()
        assert (high <= bounds["value"][1]).all()


def test_bounds_hold_where_failing_depends_on_what_is_drawn():
    """Motions fail where x is large: dropping gives other indices, bounds do not."""
    least, most = -1.0 - B * np.pi**4, 1.0 + B * np.pi**4 + A
    failing = Failing(MODEL, where=lambda u: u[:, 0] > 0.75)
    found = rk.sobol_indices(failing, 2048, limits={"value": (least, most)})
    # with x in three quarters of its range sin(x) has another variance
    assert not inside(found, FIRST, TOTAL).all()
    for bounds, true in ((found.first_bounds, FIRST), (found.total_bounds, TOTAL)):
        low, high = bounds["value"]
        assert (low <= true).all()
        assert (true <= high).all()


def test_without_failures_bounds_are_the_intervals():
    found = rk.sobol_indices(MODEL, 64)
    np.testing.assert_array_equal(
        found.first_bounds["value"], found.first_interval["value"]
    )
    assert found.limits == {}


def test_bounds_hold_for_every_completion():
    """Any values within the limits in place of what failed, ends among them."""
    rng = np.random.default_rng(2)
    full = rng.normal(size=(40, 4, 1))
    full[:, 2] += full[:, 0]
    full[:, 3] += full[:, 1]
    bad = rng.random((40, 4, 1)) < 0.2
    holes = np.where(bad, np.nan, full)
    low, high = np.nanmin(holes, axis=(0, 1)), np.nanmax(holes, axis=(0, 1))
    units = np.zeros(40, int)
    sums = bound_sums(Design(holes[:, 0], holes[:, 1], holes[:, 2:]), low, high, units)
    bounds = {n: x[0] for n, x in index_bounds(sums).items()}
    tight = np.inf
    for trial in range(400):
        ends = rng.random(full.shape) < rng.random()
        middle = low + (high - low) * rng.random(full.shape)
        values = np.where(ends, low, high) if trial % 2 else middle
        done = np.where(bad, values, full)
        a, b, c = done[:, :1], done[:, 1:2], done[:, 2:]
        first = 1.0 - 0.5 * ((b - c) ** 2).mean(axis=0) / done.var()
        total = 0.5 * ((a - c) ** 2).mean(axis=0) / done.var()
        # indices of a completion may leave [0, 1] by their error, bounds do not
        for name, x in (("first", first), ("total", total)):
            x = np.clip(x, 0.0, 1.0)
            assert (bounds[f"{name}_low"] <= x + 1e-12).all()  # rounding of sums
            assert (x <= bounds[f"{name}_high"] + 1e-12).all()
            tight = min(tight, (x - bounds[f"{name}_low"]).min())
    assert tight < 0.3  # they are not merely 0 and 1


def test_bounds_are_quotients_of_extremes():
    """Written out: mean squares and variances at the ends that failures may reach."""
    rng = np.random.default_rng(4)
    b = rng.normal(size=(60, 1))
    a = rng.normal(size=(60, 1))
    c = a[:, None] + 0.1 * rng.normal(size=(60, 1, 1))
    a[:2], b[4], c[1:4] = np.nan, np.nan, np.nan  # row 1 lacks both of a pair
    design, units = Design(a, b, c), np.zeros(60, int)
    every = design.every()[..., 0]
    known = every[np.isfinite(every)]
    low, high = np.array([known.min()]), np.array([known.max()])
    found = index_bounds(bound_sums(design, low, high, units))
    missing = every.size - known.size
    filled = lambda x: np.concatenate([known, np.full(missing, x)]).var()
    largest = max(
        np.concatenate([known, np.full(k, low), np.full(missing - k, high)]).var()
        for k in range(missing + 1)
    )
    x, y = a[:, 0], c[:, 0, 0]
    pairs = np.isfinite(x) & np.isfinite(y)
    one = np.concatenate([y[:1], x[2:4]])
    most = 0.5 * ((x - y)[pairs] ** 2).sum() + 0.5 * (high - low) ** 2
    most = most + 0.5 * np.maximum((one - low) ** 2, (one - high) ** 2).sum()
    least = 0.5 * ((x - y)[pairs] ** 2).sum()
    # sums of 180 numbers of order one: their rounding
    expected = most[0] / 60 / filled(known.mean())
    assert found["total_high"][0, 0, 0] == pytest.approx(expected, rel=1e-12)
    assert expected < 1.0
    # the share at the upper end is a number of motions here, any number there: their
    # variances differ by some (1 / 180)^2 of the range's square
    apart = float((high - low)[0] ** 2) / 180**2 / largest
    reached = least / 60 / largest
    assert reached * (1.0 - apart) <= found["total_low"][0, 0, 0]
    assert found["total_low"][0, 0, 0] <= reached * (1.0 + 1e-12)  # rounding


def test_outputs_of_any_shape():
    """Each number of an array has the indices that it has alone."""

    def outputs(drawn):
        value = ishigami(drawn)
        return {"pair": jnp.stack([value, drawn["y"]]), "one": value}

    found = rk.sobol_indices(FunctionModel(outputs, RANGES), 128)
    assert found.first["pair"].shape == (3, 2)
    assert found.total_interval["pair"].shape == (2, 3, 2)
    for ours, whole in itertools.product(("first", "total"), ("pair",)):
        alone = getattr(found, ours)
        # the same sums in another order
        np.testing.assert_allclose(alone[whole][:, 0], alone["one"], atol=1e-13)
    assert "pair[1]:" in str(found)
    only = rk.sobol_indices(FunctionModel(outputs, RANGES), 128, outputs=["one"])
    assert list(only.first) == ["one"]


def test_a_name_is_one_factor_however_many_numbers_it_draws():
    """First-order indices of a sum of two parts: their variances."""
    draws = {"turn": UniformOrientation(), "shift": Normal([0.0, 0.0], [1.0, 2.0])}
    weights = jnp.array([1.0, 0.5])

    def output(drawn):
        # w^2 of a quaternion uniform on the 3-sphere: variance 1/16
        return 8.0 * drawn["turn"][0] ** 2 + drawn["shift"] @ weights

    model = FunctionModel(output, draws)
    found = rk.sobol_indices(model, 1024, level=0.999)
    shares = np.array([4.0, 2.0]) / 6.0
    assert inside(found, shares, shares).all()
    parts = rk.sobol_indices(model, 1024, level=0.999, factors=("shift[0]", "turn"))
    assert parts.names == ("shift[0]", "turn")
    shares = np.array([1.0, 4.0]) / 6.0
    assert inside(parts, shares, shares).all()


def test_an_output_that_does_not_vary_has_no_indices():
    model = FunctionModel(lambda drawn: 3.0 + 0.0 * drawn["x"], RANGES)
    found = rk.sobol_indices(model, 64)
    assert np.isnan(found.first["value"]).all()


def test_the_same_seed_gives_the_same():
    once, again = (rk.sobol_indices(MODEL, 64, seed=4) for _ in range(2))
    np.testing.assert_array_equal(once.first["value"], again.first["value"])
    other = rk.sobol_indices(MODEL, 64, seed=5)
    assert (once.first["value"] != other.first["value"]).all()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"size": 8}, "at least 32"),
        ({"level": 1.0}, "between 0 and 1"),
        ({"sampling": "latin"}, "is not known"),
        ({"factors": ("w",)}, "is not drawn"),
        ({"outputs": ("end",)}, "is no output"),
        ({"limits": {"value": (0.0, 1.0)}}, "is exceeded"),
        ({"limits": {"value": "low"}}, "no pair of numbers"),
        ({"resamples": 3}, "at least 100"),
    ],
)
def test_refusals(change, said):
    how = {"size": 128, **change}
    with pytest.raises(rk.FieldError, match=said):
        rk.sobol_indices(Failing(MODEL, 0.05), **how)


def test_an_output_that_hardly_a_row_has():
    """Refused where it is asked for; else its indices are NaN."""
    with pytest.raises(rk.FieldError, match="without a NaN or a failed motion"):
        rk.sobol_indices(Failing(MODEL, 0.9), 64, outputs=["value"])
    found = rk.sobol_indices(Failing(MODEL, 0.9), 64)
    assert found.first["value"].shape == (3,)
    assert found.total_interval["value"].shape == (2, 3)
    assert np.isnan(found.first["value"]).all()
    assert found.dropped["value"] > 60
    assert "nan" in str(found)
