"""Rare events: probabilities with closed forms, failures, what cannot be reached."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import ndtr
from scipy.stats import chi2

import rollkane as rk
from rollkane.uncertainty.conditional_chains import (
    conditional_chains,
    family_share,
    family_variance,
)
from rollkane.uncertainty.distributions import Normal, Uniform, UniformOrientation
from rollkane.uncertainty.evaluation import FunctionModel
from rollkane.uncertainty.intervals import probability_interval
from rollkane.uncertainty.proposal_mixture import fitted_mixture

from ..model_failures import Failing
from ..rolling_models import Hump

# Importance sampling stops at 3 % of standard error; its own estimate of that may be a
# quarter too small, and four of them are allowed.
NEAR = 4.0 * 1.25 * 0.03


def normal_model(function, count):
    normals = {"z": Normal(np.zeros(count), 1.0)}
    return FunctionModel(lambda drawn: function(drawn["z"]), normals)


def linear(count):
    return normal_model(lambda z: jnp.sum(z) / np.sqrt(count), count)


def curved_probability(beta, bend):
    """Of x + bend y^2 >= beta: over y by quadrature, to 1e-10 of it."""
    density = lambda y: np.exp(-0.5 * y * y) / np.sqrt(2.0 * np.pi)
    over = lambda y: ndtr(bend * y * y - beta) * density(y)
    return quad(over, -12.0, 12.0, points=[-4.0, 0.0, 4.0], epsrel=1e-10)[0]


CASES = {
    "one dimension": (linear(1), 4.75, ndtr(-4.75)),
    "two": (linear(2), 4.75, ndtr(-4.75)),
    "ten": (linear(10), 4.75, ndtr(-4.75)),
    "fifty": (linear(50), 4.0, ndtr(-4.0)),
    "both sides": (normal_model(lambda z: abs(z[0]), 2), 4.5, 2.0 * ndtr(-4.5)),
    "unequal sides": (
        normal_model(lambda z: jnp.maximum(z[0], -z[0] - 0.2), 2),
        4.0,
        ndtr(-4.0) + ndtr(-4.2),
    ),
    "all around": (normal_model(lambda z: z @ z, 3), 30.0, chi2.sf(30.0, 3)),
    "curved": (
        normal_model(lambda z: z[0] + 0.2 * z[1] ** 2, 2),
        5.0,
        curved_probability(5.0, 0.2),
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_known_probabilities(name):
    model, threshold, probability = CASES[name]
    found = rk.subset_simulation(model, "value", threshold, seed=3)
    assert found.method == "importance sampling", found.why
    assert abs(found.probability / probability - 1.0) < NEAR
    assert found.motions <= 100_000
    assert 0.0 < found.standard_error < 0.03 * found.probability
    # the estimate of subset simulation by itself: four of its own standard errors, of
    # its logarithm, and a third more, by which its error is estimated too small
    apart = abs(np.log(found.subset.probability / probability))
    assert apart < 4.0 * 1.33 * found.subset.relative
    # a tenth of the states at least reaches each level
    assert len(found.levels) >= -np.log10(found.subset.probability) - 1.0
    assert (np.diff([level.threshold for level in found.levels]) > 0.0).all()
    assert found.levels[-1].threshold == threshold


def test_no_side_is_lost():
    """Two points of the event lie 8 apart, each in a narrow part; a number of eight
    others does not matter. Ten runs of the whole; a side lost were 50 % off."""
    bend = normal_model(lambda z: z[0] + 0.2 * z[1] ** 2 + 0.0 * z[9], 10)
    true = curved_probability(6.0, 0.2)
    for seed in range(10):
        found = rk.subset_simulation(bend, "value", 6.0, seed=seed)
        assert abs(found.probability / true - 1.0) < NEAR


@pytest.mark.parametrize("angle", [0.2, 0.06, 0.02])
def test_orientations_near_a_given_one(angle):
    """Haar's measure of smaller angles; q and -q are two thin parts of the event.

    Of 10 intervals of 95 % three or more miss in 12 of 1000 cases.
    """
    turn = np.array([0.5, -0.1, 0.7, 0.5])
    near = lambda drawn: (drawn["q"] @ turn) ** 2
    model = FunctionModel(near, {"q": UniformOrientation()})
    true = (angle - np.sin(angle)) / np.pi
    threshold = np.cos(0.5 * angle) ** 2
    covered = 0
    for seed in range(10):
        found = rk.subset_simulation(model, "value", threshold, seed=seed)
        assert abs(found.probability / true - 1.0) < NEAR
        covered += found.interval[0] <= true <= found.interval[1]
    assert covered >= 8


def test_a_thin_part_is_not_drawn_wide():
    """Weights stay even where an event is a hundredth wide in each of three numbers."""
    thin = normal_model(lambda z: -jnp.max(jnp.abs(z)), 3)
    true = (ndtr(0.005) - ndtr(-0.005)) ** 3
    found = rk.subset_simulation(thin, "value", -0.005, seed=1)
    assert found.method == "importance sampling", found.why
    assert abs(found.probability / true - 1.0) < NEAR


@pytest.mark.parametrize("heavy", [False, True])
def test_samples_all_the_same_have_a_mixture(heavy):
    """In number, or by the weight of one."""
    rng = np.random.default_rng(2)
    z, weights = np.full((60, 3), 2.0), np.ones(60)
    if heavy:
        z, weights = z + rng.standard_normal(z.shape), 1e-18 + np.eye(60)[0]
    mixture = fitted_mixture(z, weights, 60.0, rng)
    assert np.isfinite(mixture.log_ratio(mixture.draw(100, rng))).all()


@pytest.mark.slow
def test_intervals_cover():
    """Of 60 intervals of 95 %, 57 expected; three deviations are 5.1."""
    model, threshold, probability = CASES["two"]
    runs = [
        rk.subset_simulation(model, "value", threshold, 500, seed=s) for s in range(60)
    ]
    covered = sum(r.interval[0] <= probability <= r.interval[1] for r in runs)
    assert covered >= 51
    assert all(abs(r.probability / probability - 1.0) < NEAR for r in runs)
    errors = np.array([np.log(r.subset.probability / probability) for r in runs])
    # 60 values tell a deviation to 1 / sqrt(120) = 9 %; of so few motions a level, what
    # is said is too small by some third: half and twice are told apart from that
    said = np.median([r.subset.relative for r in runs])
    assert 0.5 < errors.std() / said < 2.0


def test_below_is_the_mirror():
    model = linear(2)
    mirrored = normal_model(lambda z: -jnp.sum(z) / np.sqrt(2), 2)
    above = rk.subset_simulation(model, "value", 3.0, seed=2)
    below = rk.subset_simulation(mirrored, "value", -3.0, below=True, seed=2)
    assert below.probability == above.probability  # the same numbers, signs changed
    np.testing.assert_allclose(
        [x.threshold for x in below.levels], [-x.threshold for x in above.levels]
    )
    assert "<= -3" in str(below)


def test_a_frequent_event_is_counted():
    found = rk.subset_simulation(
        linear(1), "value", 0.5, 2000, runs=1, precision=1.0, seed=1
    )
    (level,) = found.levels
    share = float(ndtr(-0.5))
    error = np.sqrt(share * (1.0 - share) / 2000)
    assert abs(found.probability - share) < 4.0 * error
    assert found.motions == level.motions == 2000
    # that of independent motions, from the share that was counted
    counted = np.sqrt(found.probability * (1.0 - found.probability) / 2000)
    assert found.standard_error == pytest.approx(counted, rel=1e-12)
    assert level.relative_error == pytest.approx(counted / found.probability, rel=1e-12)
    hits = round(2000 * found.probability)
    assert found.interval == probability_interval(hits, 2000, 0.95)


def test_what_always_happens():
    """No motion of 4 x 1000 missed it: no error, and an interval as of so many."""
    found = rk.subset_simulation(linear(1), "value", -20.0, seed=1)
    assert found.probability == 1.0
    assert found.standard_error == 0.0
    low, high = found.interval
    # 3.84 / n is Wilson's end of none of n; one miss in a thousand is ruled out
    assert 1.0 - 3.85 / 4000 < low < 1.0
    assert high == 1.0


@pytest.mark.parametrize(
    ("threshold", "most"), [(-2.5, 250), (-1.5, 250), (0.0, 250), (1.6, 100)]
)
def test_errors_of_frequent_events(threshold, most):
    """Scatter of many seeds is what each says, and intervals cover."""
    share, model = float(ndtr(-threshold)), linear(1)
    few = {"size_per_level": 200, "runs": 2, "precision": 1.0}
    runs = [
        rk.subset_simulation(model, "value", threshold, **few, seed=s)
        for s in range(most)
    ]
    errors = np.array([run.probability - share for run in runs])
    said = np.sqrt(np.mean([run.standard_error**2 for run in runs]))
    # a deviation of n values is known to 1 / sqrt(2 n); four of them
    assert abs(errors.std() / said - 1.0) < 4.0 / np.sqrt(2.0 * most)
    covered = sum(x.interval[0] <= share <= x.interval[1] for x in runs)
    # of 95 %: less four deviations of a count; intervals of few misses cover more
    assert covered >= 0.95 * most - 4.0 * np.sqrt(0.95 * 0.05 * most)


def test_a_probability_is_no_more_than_one():
    """Asked for 1e-4, weights of an event that hardly misses have a mean above 1."""
    model = linear(1)
    for seed in range(6):
        found = rk.subset_simulation(
            model, "value", -3.5, 500, precision=1e-4, motions=8000, seed=seed
        )
        assert found.importance is None or found.importance.probability <= 1.0


def test_subset_simulation_alone():
    found = rk.subset_simulation(linear(2), "value", 4.0, precision=1.0, seed=1)
    assert found.method == "subset simulation"
    assert found.importance is None
    assert found.estimate is found.subset
    low, high = found.interval
    assert low < ndtr(-4.0) < high  # of one seed


def test_a_second_run_where_the_two_differ(monkeypatch):
    """Where next to nothing is allowed, every pair of estimates differs."""
    from rollkane.uncertainty import subset_simulation as module

    monkeypatch.setattr(module, "_CONSISTENT", 1e-6)
    found = rk.subset_simulation(linear(2), "value", 4.0, motions=60_000, seed=1)
    assert found.method == "subset simulation"
    assert "differs" in found.why
    assert found.runs >= 8  # four more, again and again


def test_failed_motions_are_no_event_but_told():
    """Motions fail where another number is above 1: the event is rarer by Phi(1)."""
    failing = Failing(linear_and_another(), where=lambda u: u[:, 1] > ndtr(1.0))
    found = rk.subset_simulation(failing, "value", 4.0, seed=1)
    expected = ndtr(-4.0) * ndtr(1.0)
    assert abs(found.probability / expected - 1.0) < NEAR
    assert found.failed > 0
    assert sum(found.reasons.values()) == found.failed
    # a motion fails with 0.159; 2000 of them tell it to 0.0082
    assert found.failed_probability > 1.0 - ndtr(1.0) - 4.0 * 0.0082
    assert found.bounds[1] > ndtr(-4.0)
    text = str(found)
    assert "WARNING" in text
    assert "FAILED" in text


def linear_and_another():
    return normal_model(lambda z: z[0] + 0.0 * z[1], 2)


def test_random_failures_take_their_share():
    failing = Failing(linear(2), 0.05, seed=7)
    found = rk.subset_simulation(failing, "value", 3.5, seed=1)
    assert abs(found.probability / (0.95 * ndtr(-3.5)) - 1.0) < NEAR
    # every proposal fails with 0.05: the motions' own deviation
    share = found.failed / found.motions
    assert abs(share - 0.05) < 4.0 * np.sqrt(0.05 * 0.95 / found.motions)


def test_what_is_never_reached_is_bounded():
    model = normal_model(lambda z: jnp.tanh(z[0]) + 0.0 * z[1], 2)
    found = rk.subset_simulation(model, "value", 1.5, 500, motions=5_000, seed=1)
    assert found.probability == 0.0
    assert found.motions <= 5_000
    assert "no motions were left" in found.why
    low, high = found.interval
    assert low == 0.0
    assert 0.0 < high < 1e-6
    assert np.isnan(found.likeliest).all()
    assert "P(value >= 1.5) = 0" in str(found)
    assert "subset simulation    0, as the event was not seen" in str(found)
    assert "inf" not in str(found)


def test_what_is_likeliest():
    """The nearest point of the event: (1, 1, 1, 1) / 2 times its distance."""
    found = rk.subset_simulation(linear(4), "value", 4.0, 5000, seed=1)
    assert found.names == ("z[0]", "z[1]", "z[2]", "z[3]")
    # of thousands of states the nearest one; chance alone puts a few tenths aside
    assert abs(found.likeliest - 2.0).max() < 1.0
    assert 4.0 <= found.likeliest.sum() / 2.0 < 4.2
    # the slope of the tail: d log p = -beta d beta = NEAR / 4
    assert abs(found.reliability_index - 4.0) < NEAR / 4.0


def test_the_same_seed_gives_the_same():
    once, again, other = (
        rk.subset_simulation(linear(2), "value", 3.0, 500, seed=seed)
        for seed in (1, 1, 2)
    )
    assert once.probability == again.probability
    assert once.probability != other.probability


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"of": "speed"}, "is no output"),
        ({"of": "value[0]"}, "is not one number"),
        ({"size_per_level": 105}, "no tenth part"),
        ({"size_per_level": 50}, "at least 100"),
        ({"precision": 0.0}, "must be positive"),
        ({"level": 2.0}, "between 0 and 1"),
        ({"below": 1}, "True or False"),
        ({"motions": 10}, "at least 1000"),
        ({"runs": 0}, "at least 1"),
        ({"threshold": "far"}, "made of numbers"),
    ],
)
def test_refusals(change, said):
    how = {"of": "value", "threshold": 3.0, **change}
    with pytest.raises(rk.FieldError, match=said):
        rk.subset_simulation(linear(2), **how)


@pytest.mark.parametrize("kind", [float, bool])
def test_whether_it_happened_is_no_output_to_follow(kind):
    step = normal_model(lambda z: (z[0] > 4.0).astype(kind), 1)
    with pytest.raises(rk.FieldError, match="more than a few values"):
        rk.subset_simulation(step, "value", 1.0)


def test_a_threshold_out_of_reach():
    """Levels pile up at the largest value there is."""
    model = normal_model(lambda z: -(z[0] ** 2), 1)
    with pytest.raises(rk.FieldError, match="within its reach"):
        rk.subset_simulation(model, "value", 0.5)


def test_counts_are_followed():
    """A number of few values: its levels are where it changes."""
    model = normal_model(lambda z: jnp.floor(2.0 * z[0]) + 0.0 * z[1], 2)
    found = rk.subset_simulation(model, "value", 8.0, seed=1)
    assert abs(found.probability / ndtr(-4.0) - 1.0) < NEAR


def test_nothing_but_failures_is_refused():
    with pytest.raises(rk.FieldError, match="known of too few motions"):
        rk.subset_simulation(Failing(linear(2), 0.995), "value", 3.0)


def test_chains_keep_the_normal_distribution_above_a_level():
    """Moments of a normal number above 2, and of one beside it."""
    rng = np.random.default_rng(1)
    count, steps, level = 4000, 10, 2.0
    u = 1.0 - ndtr(-level) * rng.random(count)
    from scipy.special import ndtri

    seeds = np.stack([ndtri(u), rng.standard_normal(count)], axis=1)
    margin = lambda z: z[:, 0]
    chains = conditional_chains(margin, seeds, seeds[:, 0], level, steps, rng)
    assert chains.z.shape == (steps, count, 2)
    assert (chains.margin >= level).all()
    np.testing.assert_array_equal(chains.margin, chains.z[..., 0])
    assert 0.2 < chains.accepted < 0.7  # adapts to 0.44
    last = chains.z[-1]
    # phi(2) / Phi(-2) and 1 + 2 m - m^2; chains are independent of each other
    mean = np.exp(-2.0) / np.sqrt(2.0 * np.pi) / ndtr(-2.0)
    deviation = np.sqrt(1.0 + 2.0 * mean - mean**2)
    assert abs(last[:, 0].mean() - mean) < 4.0 * deviation / np.sqrt(count)
    assert abs(last[:, 1].mean()) < 4.0 / np.sqrt(count)
    assert abs(last[:, 1].var() - 1.0) < 4.0 * np.sqrt(2.0 / count)


def test_families_share_out():
    """Independent states are worth their number; a single family is worth one."""
    reached = np.ones((1, 50), bool)
    assert family_share(reached, np.arange(50)) == pytest.approx(1.0 / 50, rel=1e-12)
    assert family_share(reached, np.zeros(50, int)) == 1.0
    # of a level alone, 30 of 50: that of a share, exactly
    reached[0, 30:] = False
    alone = (1.0 - 0.6) / (0.6 * 50)
    assert family_variance(reached, np.arange(50)) == pytest.approx(alone, rel=1e-12)
    # chains of 10 independent states each: the sum of both levels', on average
    rng = np.random.default_rng(1)
    found = [
        family_variance(rng.random((10, 100)) < 0.2, np.arange(100)) for _ in range(400)
    ]
    both = (1.0 - 0.1) / (0.1 * 1000) + (1.0 - 0.2) / (0.2 * 1000)
    # one is some 9 % off, and 400 are averaged: 1 / n left in were 8 % of it
    assert np.mean(found) == pytest.approx(both, rel=0.03)


def test_the_mixture_is_a_density():
    """The mean of the ratio of densities is 1, and no ratio is above 20."""
    rng = np.random.default_rng(3)
    sides = np.where(rng.random((400, 1)) < 0.5, 1.0, -1.0)
    z = 0.3 * rng.standard_normal((400, 3)) + 3.0 * sides * np.array([1.0, 0.0, 0.0])
    z[:, 1:] = rng.standard_normal((400, 2))
    mixture = fitted_mixture(z, np.ones(400), 400.0, rng)
    assert len(mixture.weights) == 2
    assert mixture.basis.shape == (3, 1)
    np.testing.assert_allclose(abs(mixture.centres), 3.0, atol=0.1)  # 0.3 / sqrt(200)
    drawn = mixture.draw(200_000, rng)
    ratio = np.exp(mixture.log_ratio(drawn))
    assert ratio.max() <= 20.0  # one over the standard normal component's 0.05
    # bounded by 20 and of mean 1, its deviation is below sqrt(19)
    assert abs(ratio.mean() - 1.0) < 4.0 * np.sqrt(19.0 / 200_000)


class TestHump:
    """A ball loses contact on a hump: a quadrature in one dimension, near 1e-6."""

    model = Hump()

    def test_the_crest_is_where_it_presses_least(self):
        """And the force there is that of the energy's conservation."""
        u = np.array([[0.9, 0.3]])
        values = self.model.evaluate(u).values["pressed"]
        scene, start = self.model._made(jnp.asarray(u[0]))
        drawn = self.model.draws.draw(jnp.asarray(u[0]))
        run = rk.simulate(scene, start, np.linspace(0.0, 1.0, 2001), rtol=1e-7)
        share = np.asarray(run.normal_force) / (self.model.mass * 9.81)
        # parabola through samples 0.5 ms apart: below 1e-5 of its top
        assert abs(share.min() - values[0]) < 1e-5
        square, height = float(drawn["speed"]) ** 2, float(drawn["height"])
        bend = self.model.width**2 / height + self.model.radius
        closed = 1.0 - (square - 10.0 / 7.0 * 9.81 * height) / (9.81 * bend)
        # rtol 1e-7, and the foot is 1.5e-8 of the hump up
        assert abs(values[0] - closed) < 1e-6

    def test_its_probability(self):
        found = rk.subset_simulation(self.model, "pressed", 0.0, below=True, seed=1)
        true = self.model.probability()
        assert 5e-7 < true < 2e-6
        assert abs(found.probability / true - 1.0) < 0.1
        assert found.motions <= 100_000

    @pytest.mark.slow
    def test_nineteen_of_twenty_are_within_ten_percent(self):
        true = self.model.probability()
        ask = "pressed", 0.0
        runs = [
            rk.subset_simulation(self.model, *ask, below=True, seed=s)
            for s in range(20)
        ]
        near = [abs(run.probability / true - 1.0) < 0.1 for run in runs]
        assert sum(near) >= 19
        assert max(run.motions for run in runs) <= 100_000


def test_distributions_of_the_draws_do_not_matter():
    """The same event by a uniform number: P(u >= 1 - 1e-5)."""
    model = FunctionModel(lambda drawn: drawn["u"], {"u": Uniform(0.0, 1.0)})
    found = rk.subset_simulation(model, "value", 1.0 - 1e-5, seed=1)
    assert abs(found.probability / 1e-5 - 1.0) < NEAR
