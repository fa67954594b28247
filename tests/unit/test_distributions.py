"""Distributions: their laws, tails, derivatives, and what they refuse."""

import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.special
import scipy.stats

import rollkane as rk
from rollkane.geometry.rotations import multiply, rotation_matrix
from rollkane.uncertainty.draws import Draws, flat
from rollkane.uncertainty.normal_tails import log_normal_cdf, lower_quantile

COUNT = 4096
EPS = np.finfo(float).eps
# Two-sided Kolmogorov-Smirnov at COUNT independent numbers, passed with probability
# 1 - p, p = 1e-4, for a seed that was not chosen: sqrt(-log(p / 2) / (2 n)).
KOLMOGOROV = np.sqrt(-np.log(0.5e-4) / (2 * COUNT))
# The normal quantile that a sample mean's error stays below with the same probability.
SIGMAS = 3.9


def uniforms(size, seed=0, count=COUNT):
    return np.random.default_rng(seed).random((count, size))


def drawn(distribution, seed=0, count=COUNT):
    return at(distribution, uniforms(distribution.size, seed, count))


def at(distribution, u):
    return jax.tree.map(np.asarray, PROGRAM(distribution, u))


# one program for all distributions of one structure
PROGRAM = jax.jit(jax.vmap(lambda one, u: one.draw(u), in_axes=(None, 0)))


def distance(sample, cdf):
    """Kolmogorov's, of a sample from a distribution function."""
    return scipy.stats.kstest(sample, cdf).statistic


# One number

NORMAL = rk.Normal(2.0, 0.5)
SCALARS = {
    "normal": (NORMAL, scipy.stats.norm(2.0, 0.5).cdf),
    "uniform": (rk.Uniform(-1.0, 3.0), scipy.stats.uniform(-1.0, 4.0).cdf),
    "log-normal": (rk.LogNormal(2.0, 0.3), scipy.stats.lognorm(0.3, scale=2.0).cdf),
    "cut normal": (
        rk.Truncated(NORMAL, 1.8, 2.2),
        scipy.stats.truncnorm(-0.4, 0.4, 2.0, 0.5).cdf,
    ),
    "half normal": (
        rk.Truncated(NORMAL, low=0.0),
        scipy.stats.truncnorm(-4.0, np.inf, 2.0, 0.5).cdf,
    ),
    "cut twice": (
        rk.Truncated(rk.Truncated(NORMAL, low=1.8), high=2.2),
        scipy.stats.truncnorm(-0.4, 0.4, 2.0, 0.5).cdf,
    ),
    "cut uniform": (
        rk.Truncated(rk.Uniform(-1.0, 3.0), -2.0, 1.0),
        scipy.stats.uniform(-1.0, 2.0).cdf,
    ),
    "cut log-normal": (
        rk.Truncated(rk.LogNormal(2.0, 0.3), -1.0, 2.0),
        lambda x: 2.0 * scipy.stats.lognorm(0.3, scale=2.0).cdf(x),
    ),
}


@pytest.mark.parametrize("name", SCALARS)
def test_numbers_have_their_distribution(name):
    distribution, cdf = SCALARS[name]
    sample = drawn(distribution)
    assert sample.shape == (COUNT,)
    assert distance(sample, cdf) < KOLMOGOROV
    # and not one a quarter of a deviation off, by a probability of 0.07 at least: the
    # least density that the middle of a distribution has is 0.29 / sigma, the uniform's
    assert distance(sample + 0.25 * sample.std(), cdf) > KOLMOGOROV


@pytest.mark.parametrize("name", SCALARS)
def test_numbers_grow_with_u_and_are_finite_at_its_ends(name):
    distribution, cdf = SCALARS[name]
    tiny = 2.0**-53
    u = np.concatenate([[tiny], np.linspace(0.0, 1.0, COUNT)[1:-1], [1.0 - tiny]])
    x = at(distribution, u[:, None])
    assert np.isfinite(x).all()
    assert (np.diff(x) > 0.0).all()
    # quantiles are good to some ten roundings, and so is SciPy's distribution function
    np.testing.assert_allclose(cdf(x), u, rtol=0, atol=40 * EPS)


# F at the ends of intervals, in numbers of deviations
TAILS = {
    "above": (6.0, np.inf),
    "below": (-np.inf, -6.0),
    "far above": (38.0, np.inf),  # 3e-316: no normal number has it
    "beyond all numbers": (-np.inf, -100.0),
    "a slice": (10.0, 10.5),
    "a sliver": (5.0, 5.0 + 1e-6),
    "around": (-8.0, 9.0),
}


@pytest.mark.parametrize("name", TAILS)
def test_far_tails_agree_with_scipy(name):
    low, high = TAILS[name]
    u = np.linspace(0.0, 1.0, 2003)[1:-1]
    cut = rk.Truncated(rk.Normal(0.0, 1.0), low, high)
    x = at(cut, u[:, None])
    np.testing.assert_allclose(
        x, scipy.stats.truncnorm.ppf(u, low, high), rtol=0, atol=1e-10
    )
    assert ((low <= x) & (x <= high)).all()


def test_logarithms_of_normal_probabilities_agree_with_scipy():
    x = np.concatenate([np.linspace(-60.0, 9.0, 4001), [-1e3, -1e8]])
    expected = scipy.special.log_ndtr(x)
    # JAX's error function is good to 120 roundings
    np.testing.assert_allclose(log_normal_cdf(jnp.asarray(x)), expected, rtol=150 * EPS)
    x = x[x <= 0.0]
    found = jax.jit(lambda x: lower_quantile(log_normal_cdf(x)))(x)
    # back: an error e of log p moves x by e / |x|, and log p = x^2 / 2 has 20 roundings
    np.testing.assert_allclose(found, x, rtol=20 * EPS, atol=20 * EPS)
    # of zero probability no number is left
    assert lower_quantile(jnp.asarray(-jnp.inf)) == -jnp.inf


def test_single_precision_has_its_tails():
    u = np.linspace(0.0, 1.0, 203, dtype=np.float32)[1:-1]
    for low, high in ((6.0, np.inf), (-np.inf, -20.0), (-1.0, 2.0)):
        cut = rk.Truncated(rk.Normal(0.0, 1.0), low, high)
        x = at(cut, u[:, None])
        assert x.dtype == np.float32
        expected = scipy.stats.truncnorm.ppf(u.astype(float), low, high)
        # the logarithm, 200 at 20 deviations, has 5 digits behind the point: /20
        np.testing.assert_allclose(x, expected, rtol=0, atol=1e-5)


def test_arrays_are_independent_entries():
    spin = rk.Normal([0.0, 0.0, 5.0], [0.1, 0.0, 0.2])
    assert (spin.shape, spin.size) == ((3,), 3)
    x = drawn(spin)
    assert (x[:, 1] == 0.0).all()
    assert distance(x[:, 0], scipy.stats.norm(0.0, 0.1).cdf) < KOLMOGOROV
    assert distance(x[:, 2], scipy.stats.norm(5.0, 0.2).cdf) < KOLMOGOROV
    # the correlation of independent numbers has the deviation 1 / sqrt(n)
    assert abs(np.corrcoef(x[:, 0], x[:, 2])[0, 1]) < SIGMAS / np.sqrt(COUNT)
    cut = rk.Truncated(rk.Uniform([[0.0, 1.0]], 2.0), high=[[0.5, 1.5]])
    middle = cut.draw(jnp.array([0.5, 0.5]))
    np.testing.assert_allclose(middle, [[0.25, 1.25]], rtol=4 * EPS)


# Derivatives

# x(parameters) at u = 0.3, by SciPy's quantile
QUANTILES = {
    "normal": (rk.Normal, (1.0, 0.5), lambda m, s: scipy.stats.norm.ppf(0.3, m, s)),
    "uniform": (rk.Uniform, (1.0, 2.0), lambda a, b: a + 0.3 * (b - a)),
    "log-normal": (
        rk.LogNormal,
        (2.0, 0.4),
        lambda m, s: m * np.exp(s * scipy.stats.norm.ppf(0.3)),
    ),
    "tail": (
        lambda m, s, a: rk.Truncated(rk.Normal(m, s), a),
        (0.1, 1.0, 7.0),
        lambda m, s, a: scipy.stats.truncnorm.ppf(0.3, (a - m) / s, np.inf, m, s),
    ),
    "slice": (
        lambda m, s, b: rk.Truncated(rk.LogNormal(m, s), None, b),
        (1.0, 0.5, 0.7),
        lambda m, s, b: (
            m * np.exp(s * scipy.stats.truncnorm.ppf(0.3, -np.inf, np.log(b / m) / s))
        ),
    ),
}


@pytest.mark.parametrize("name", QUANTILES)
def test_derivatives_by_parameters(name):
    make, at, quantile = QUANTILES[name]
    draw = lambda *p: make(*p).draw(jnp.array([0.3]))
    found = jax.jit(jax.grad(draw, argnums=tuple(range(len(at)))))(*at)
    step = 1e-5
    for k, slope in enumerate(found):
        ends = [
            quantile(*(x + side * step * (j == k) for j, x in enumerate(at)))
            for side in (1.0, -1.0)
        ]
        # the difference leaves out step^2 / 6 of a third derivative of order 10, and
        # has the rounding of numbers below 10 over the step
        expected = (ends[0] - ends[1]) / (2 * step)
        assert abs(slope - expected) < 1e-9 + 10 * EPS / step


def test_derivatives_of_joint_draws():
    slope = lambda function: jax.jit(jax.grad(function))
    u2, u3 = jnp.array([0.3, 0.8]), jnp.array([0.3, 0.8, 0.1])
    fall = lambda k: rk.VonMisesFisher([0.0, 0.0, 1.0], k).draw(u2)[2]
    # w = 1 + log(u + (1 - u) e^(-2k)) / k
    exact = lambda k: 1.0 + jnp.log(0.3 + 0.7 * jnp.exp(-2.0 * k)) / k
    assert abs(slope(fall)(3.0) - slope(exact)(3.0)) < 10 * EPS
    assert np.isfinite(slope(fall)(0.0))
    # x_2 = s z_2 of independent ones
    pair = lambda s: rk.MultivariateNormal([0.0, 0.0], s * s * jnp.eye(2)).draw(u2)[1]
    assert abs(slope(pair)(2.0) - scipy.stats.norm.ppf(0.8)) < 10 * EPS
    # of a flat disc: d I_zz / d r at r = 0 is the trace of dS, z_1 S_1 + z_2 S_2
    disc = lambda r: rk.InertiaPerturbation(np.diag([1.0, 1.0, 2.0]), r).draw(u3)[2, 2]
    expected = scipy.stats.norm.ppf([0.3, 0.8]).sum()
    assert abs(slope(disc)(0.0) - expected) < 10 * EPS
    copula = lambda r: rk.Correlated(
        {"a": rk.Normal(0.0, 1.0), "b": rk.Normal(0.0, 1.0)}, r
    ).draw(u2)["b"]
    # x_b = r z_a + sqrt(1 - r^2) z_b
    first, second = scipy.stats.norm.ppf([0.3, 0.8])
    expected = first - 0.6 / 0.8 * second
    assert abs(slope(copula)(0.6) - expected) < 40 * EPS


# Orientations and directions


def test_orientations_are_uniform():
    """Moments of the trace, the law of the angle, and no change under a rotation."""
    q = drawn(rk.UniformOrientation())
    np.testing.assert_allclose(np.sum(q * q, axis=1), 1.0, rtol=0, atol=4 * EPS)
    R = np.asarray(jax.vmap(rotation_matrix)(q))
    trace = np.trace(R, axis1=1, axis2=2)
    # of SO(3)'s group: how often the identity is in powers of the vector representation
    for power, moment in ((1, 0.0), (2, 1.0), (3, 1.0), (4, 3.0)):
        values = trace**power
        error = SIGMAS * values.std() / np.sqrt(COUNT)
        assert abs(values.mean() - moment) < error, power
    turn = np.array([0.5, -0.1, 0.7, 0.5]) / np.linalg.norm([0.5, -0.1, 0.7, 0.5])
    left = np.asarray(jax.vmap(lambda p: multiply(jnp.asarray(turn), p))(q))
    right = np.asarray(jax.vmap(lambda p: multiply(p, jnp.asarray(turn)))(q))
    of_angle = lambda x: (x - np.sin(x)) / np.pi
    for some in (q, left, right):
        angle = 2.0 * np.arccos(np.minimum(np.abs(some[:, 0]), 1.0))
        assert distance(angle, of_angle) < KOLMOGOROV
    # every column of R is uniform on the sphere: its components are on [-1, 1]
    even = scipy.stats.uniform(-1.0, 2.0).cdf
    assert all(distance(R[:, i, j], even) < KOLMOGOROV for i, j in np.ndindex(3, 3))


def test_orientations_are_directions_of_normal_numbers():
    """Of the same four that rare events are searched in, and none where these have no
    direction; one program may fuse what others round."""
    draw = rk.UniformOrientation().draw
    z = np.array([0.3, -1.2, 2.0, 0.1])
    np.testing.assert_allclose(
        draw(scipy.stats.norm.cdf(z)), z / np.linalg.norm(z), rtol=0, atol=16 * EPS
    )
    middle = jnp.full(4, 0.5)
    np.testing.assert_array_equal(draw(middle), [1.0, 0.0, 0.0, 0.0])
    assert np.isfinite(jax.jacobian(draw)(middle)).all()
    ends = draw(jnp.array([0.0, 1.0, 0.5, 0.5]))
    assert abs(float(ends @ ends) - 1.0) < 4 * EPS


@pytest.mark.parametrize("k", [0.0, 1e-8, 0.3, 1.0, 30.0, 1e8])
def test_directions_have_fishers_distribution(k):
    m = np.array([1.0, 2.0, -3.0]) / np.sqrt(14.0)
    x = drawn(rk.VonMisesFisher([1.0, 2.0, -3.0], k))
    np.testing.assert_allclose(np.sum(x * x, axis=1), 1.0, rtol=0, atol=8 * EPS)
    # 1 - m.x, without cancelling: half the square of the chord
    fall = 0.5 * np.sum((x - m) ** 2, axis=1)
    cdf = lambda t: -np.expm1(-k * t) / -np.expm1(-2.0 * k) if k else 0.5 * t
    assert distance(fall, cdf) < KOLMOGOROV
    # E[m.x] = coth k - 1/k: 1 - E = 1/k - 2/(e^(2k) - 1), k/3 where k is small
    mean = (
        1.0 - k / 3.0
        if k < 1e-3
        else 1.0 / k - 2.0 * np.exp(-2 * k) / -np.expm1(-2.0 * k)
    )
    assert abs(fall.mean() - mean) < SIGMAS * fall.std() / np.sqrt(COUNT)
    across = np.cross(m, [0.0, 0.0, 1.0])
    across /= np.linalg.norm(across)
    azimuth = np.arctan2(x @ across, x @ np.cross(m, across))
    assert distance(azimuth, scipy.stats.uniform(-np.pi, 2 * np.pi).cdf) < KOLMOGOROV


@pytest.mark.parametrize("m", [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [1e200, 0.0, 0.0]])
def test_concentrated_directions_are_that_direction(m):
    x = drawn(rk.VonMisesFisher(m, 1e12), count=16)
    # the largest of 16 angles is below sqrt(2 * 40 / k), as u > e^-40
    np.testing.assert_allclose(x, np.tile(np.sign(m), (16, 1)), rtol=0, atol=1e-5)


# Numbers that vary together

COVARIANCE = np.array([[4.0, 1.2, 0.0], [1.2, 1.0, -0.3], [0.0, -0.3, 0.25]])


def test_normal_numbers_have_their_covariance():
    # units far apart change nothing but units
    units = np.array([1.0, 1e-9, 1e6])
    mean = np.array([1.0, 2.0, 3.0]) * units
    joint = rk.MultivariateNormal(mean, COVARIANCE * np.outer(units, units))
    x = drawn(joint) / units
    found = np.cov(x.T)
    # of normal numbers: var(s_ij) = (s_ii s_jj + s_ij^2) / n
    variances = np.diag(COVARIANCE)
    error = np.sqrt((np.outer(variances, variances) + COVARIANCE**2) / COUNT)
    assert (np.abs(found - COVARIANCE) < SIGMAS * error).all()
    for k in range(3):
        law = scipy.stats.norm(mean[k] / units[k], np.sqrt(variances[k])).cdf
        assert distance(x[:, k], law) < KOLMOGOROV


def test_a_semidefinite_covariance_keeps_its_condition():
    known = np.outer([1.0, 2.0, -1.0], [1.0, 2.0, -1.0])
    x = drawn(rk.MultivariateNormal([0.0, 0.0, 0.0], known), count=64)
    assert x[:, 0].std() > 0.5
    # eigenvalues of zero are known to 3 eps, and deviations to the root of that
    limits = {"rtol": 0, "atol": 4 * np.sqrt(3 * EPS) * 3.0}
    np.testing.assert_allclose(x[:, 1], 2.0 * x[:, 0], **limits)
    np.testing.assert_allclose(x[:, 2], -x[:, 0], **limits)


def test_a_copula_keeps_the_distributions():
    names = ("z", "a", "m")  # not in alphabetical order
    parts = rk.Normal(1.0, 2.0), rk.LogNormal(1.0, 0.5), rk.Truncated(NORMAL, 2.0)
    laws = (
        scipy.stats.norm(1.0, 2.0).cdf,
        scipy.stats.lognorm(0.5).cdf,
        scipy.stats.truncnorm(0.0, np.inf, 2.0, 0.5).cdf,
    )
    r = np.array([[1.0, 0.8, -0.5], [0.8, 1.0, 0.0], [-0.5, 0.0, 1.0]])
    joint = rk.Correlated(dict(zip(names, parts, strict=True)), r)
    x = drawn(joint)
    assert all(
        distance(x[n], law) < KOLMOGOROV for n, law in zip(names, laws, strict=True)
    )
    for i, j in ((0, 1), (0, 2), (1, 2)):
        rank = scipy.stats.spearmanr(x[names[i]], x[names[j]]).statistic
        expected = 6.0 / np.pi * np.arcsin(r[i, j] / 2.0)
        # the deviation of a rank correlation is at most 1.06 / sqrt(n)
        assert abs(rank - expected) < SIGMAS * 1.06 / np.sqrt(COUNT)
    # normal ones are correlated as their covariance says, to rounding of a quantile
    two = rk.Correlated({"a": rk.Normal(0.0, 1.0), "b": rk.Normal(0.0, 3.0)}, 0.6)
    same = rk.MultivariateNormal([0.0, 0.0], [[1.0, 1.8], [1.8, 9.0]])
    pairs, expected = drawn(two, count=64), drawn(same, count=64)
    np.testing.assert_allclose(pairs["a"], expected[:, 0], rtol=0, atol=1e-14)
    np.testing.assert_allclose(pairs["b"], expected[:, 1], rtol=0, atol=4e-14)


# Tables


def test_values_come_as_often_as_they_should():
    middles = ((np.arange(600) + 0.5) / 600)[:, None]
    counted = lambda d: np.unique(at(d, middles), return_counts=True)
    values, counts = counted(rk.Empirical([3.0, 1.0, 2.0]))
    assert (values.tolist(), counts.tolist()) == ([1.0, 2.0, 3.0], [200, 200, 200])
    values, counts = counted(rk.Empirical([3.0, 1.0, 2.0, 9.0], [1.0, 2.0, 3.0, 0.0]))
    assert (values.tolist(), counts.tolist()) == ([1.0, 2.0, 3.0], [200, 300, 100])
    grown = at(rk.Empirical([3.0, 1.0, 2.0]), middles)
    assert (np.diff(grown) >= 0.0).all()
    rows = rk.Empirical([[1.0, 10.0], [2.0, 20.0], [0.0, 0.0]], [1.0, 1.0, 2.0])
    assert (rows.shape, rows.size) == ((2,), 1)
    x = at(rows, middles)
    np.testing.assert_array_equal(x[:, 1], 10.0 * x[:, 0])
    assert rows.draw(jnp.array([0.3])).tolist() == [2.0, 20.0]
    single = rk.Empirical([7.0])
    assert single.draw(jnp.array([0.999])) == 7.0


def test_rows_of_a_file(tmp_path):
    path = tmp_path / "starts.csv"
    path.write_text("# seen\nspin, tilt, n\n5.0, 0.1, 1\n6.0, 0.2, 3\n")
    one = rk.Empirical.from_table(path, "spin", weights="n")
    assert one.values.tolist() == [5.0, 6.0]
    assert one.cumulative.tolist() == [0.25]
    both = rk.Empirical.from_table(path, ["tilt", "spin"])
    assert both.values.tolist() == [[0.1, 5.0], [0.2, 6.0]]
    with pytest.raises(rk.FieldError, match="did you mean 'spin'") as caught:
        rk.Empirical.from_table(path, "spinn")
    assert caught.value.field == "Empirical.from_table.columns"
    path.write_text("spin, tilt\n5.0, 0.1\n, 0.2\n")
    with pytest.raises(rk.FieldError, match="line 3: has no number"):
        rk.Empirical.from_table(path, ("tilt", "spin"))
    with pytest.raises(rk.FieldError, match="names none"):
        rk.Empirical.from_table(path, ())
    for name, unit in (("spin [deg/s]", "deg/s"), ("tilt_deg", "deg")):
        path.write_text(f"{name}\n5.0\n6.0\n")
        with pytest.raises(rk.FieldError, match=f"is in '{unit}'"):
            rk.Empirical.from_table(path, name)


# Inertias

ASKEW = np.array([[4e-4, 2e-5, 1e-5], [2e-5, 6e-4, -3e-5], [1e-5, -3e-5, 7e-4]])
BODIES = {
    "askew": (ASKEW, 6),
    "ball": (4e-3 * np.eye(3), 6),
    "needle": (np.diag([1e-6, 1.0, 1.0]), 6),
    "disc": (np.diag([0.02, 0.02, 0.04]), 3),
}


@pytest.mark.parametrize("relative", [0.05, 1.0])
@pytest.mark.parametrize("name", BODIES)
def test_every_inertia_is_that_of_a_body(name, relative):
    inertia, size = BODIES[name]
    perturbed = rk.InertiaPerturbation(inertia, relative)
    assert perturbed.size == size
    tensors = drawn(perturbed)
    moments = np.linalg.eigvalsh(tensors)
    # eigenvalues are good to some eps of the largest
    slack = 16 * EPS * moments.sum(axis=1)
    assert (moments[:, 0] > slack).all()
    assert (moments[:, 0] + moments[:, 1] - moments[:, 2] > -slack).all()
    if size == 3:  # flat, in its plane
        assert (tensors[:, 2, :2] == 0.0).all()
        np.testing.assert_allclose(
            moments[:, 0] + moments[:, 1], moments[:, 2], rtol=16 * EPS
        )
    rk.Body(1.0, tensors[0], rk.Sphere(0.1))


@pytest.mark.parametrize("axis", [[1.0, 0.0, 0.0], [0.6, 0.0, -0.8]])
def test_second_moments_have_their_deviation(axis):
    """Along any axis, whatever the axes of the tensor are."""
    r = 0.01
    tensors = drawn(rk.InertiaPerturbation(ASKEW, r))
    S = 0.5 * np.trace(tensors, axis1=1, axis2=2)[:, None, None] * np.eye(3) - tensors
    along = np.einsum("i,nij,j->n", axis, S, axis)
    # the deviation's own is 1 / sqrt(2 n); orders beyond the first are r^2 and less
    limit = SIGMAS / np.sqrt(2 * COUNT) + r
    assert abs(along.std() / along.mean() / r - 1.0) < limit


# A fit


@pytest.fixture(scope="module")
def found():
    """A ball that should turn at other rates, at the fit's first point."""
    ball = rk.Body(0.5, ASKEW, rk.Sphere(0.05))
    scene = rk.Scene(ball, loads=(rk.Drag(quadratic=1e-5),))
    still = (0.0, 0.0, 0.0)
    starts = [
        rk.place(scene, (1.0, 0.0, 0.0, 0.0), spin, still)
        for spin in ((8.0, 3.0, 2.0), (1.0, 6.0, 5.0))
    ]
    channels = {"gyro": rk.Gyro(np.ones((11, 3)), 0.02)}
    records = [rk.Record(np.linspace(0.0, 0.5, 11), channels) for _ in starts]
    free = [
        rk.Free("body.inertia"),
        rk.Free("start.angular_velocity"),
        rk.Free("loads[0].quadratic"),
        rk.Free("gyro.bias", prior=(0.0, 0.01), shared=True),
        rk.Tied("body.center_of_mass", lambda v: v["loads[0].quadratic"] * np.ones(3)),
    ]
    options = {"strategy": "single", "max_evaluations": 1, "method": "diffrax"}
    return rk.fit(scene, starts, records, free, **options)


def test_draws_of_a_fit(found):
    joint = rk.FitCovariance(found)
    middle = joint.draw(jnp.full(joint.size, 0.5))
    assert {p: v.shape for p, v in middle.items()} == joint.shape
    x = drawn(joint)
    moments = np.linalg.eigvalsh(x["body.inertia"])
    assert (moments[:, 0] + moments[:, 1] > moments[:, 2]).all()
    # drag is none or more, and plain coordinates follow it, as normal numbers do
    drag, least = "loads[0].quadratic", found.names.index("loads[0].quadratic")
    estimate, variance = float(found.estimates[drag]), found.covariance[least, least]
    error = np.sqrt(variance)
    within = scipy.stats.truncnorm(-estimate / error, np.inf, estimate, error)
    assert (x[drag] > 0.0).all()
    assert scipy.stats.kstest(x[drag], within.cdf).pvalue > 1e-4
    np.testing.assert_allclose(middle[drag], within.median(), rtol=1e-9)  # of tails
    own, spin = x["start.angular_velocity"].reshape(COUNT, -1), "start.angular_velocity"
    rows = [k for k, name in enumerate(found.names) if name.startswith("start.")]
    slope = found.covariance[rows, least] / variance
    followed = found.estimates[spin].ravel() + slope * (within.median() - estimate)
    np.testing.assert_allclose(middle[spin].ravel(), followed, rtol=1e-9)
    expected = found.covariance[np.ix_(rows, rows)]
    expected = expected - np.outer(slope, slope) * (variance - within.var())
    variances = np.diag(expected)
    error = np.sqrt((np.outer(variances, variances) + expected**2) / COUNT)
    assert (np.abs(np.cov(own.T) - expected) < SIGMAS * error).all()


def test_a_draw_is_put_into_the_scene(found):
    joint = rk.FitCovariance(found)
    u = jnp.asarray(uniforms(joint.size, seed=3, count=1)[0])
    drawn_once = joint.draw(u)
    for record in (0, 1):
        scene, start = jax.jit(lambda u, k=record: joint.apply(joint.draw(u), k))(u)
        parts = {
            "body.inertia": scene.body.inertia,
            "loads[0].quadratic": scene.loads[0].quadratic,
            "body.center_of_mass": scene.body.center_of_mass,
            "start.angular_velocity": start.angular_velocity,
        }
        drag = drawn_once["loads[0].quadratic"]
        expected = drawn_once | {
            "start.angular_velocity": drawn_once["start.angular_velocity"][record],
            "body.center_of_mass": jnp.full(3, drag),
        }
        for path, value in parts.items():
            np.testing.assert_allclose(value, expected[path], rtol=1e-13, atol=1e-17)
    with pytest.raises(rk.FieldError, match="beyond the 2"):
        joint.apply(drawn_once, 2)
    with pytest.raises(rk.FieldError, match="are not the fit's"):
        joint.apply({"body.mass": 1.0})
    with pytest.raises(rk.FieldError, match="must be a Fit"):
        rk.FitCovariance(found.covariance)


def weighed(**given):
    """A ball of a gram on a balance whose readings are good to a kilogram."""
    scene = rk.Scene(rk.Body(1e-3, 4e-3 * np.eye(3), rk.Sphere(0.1)))
    still = (0.0, 0.0, 0.0)
    start = rk.place(scene, (1.0, 0.0, 0.0, 0.0), still, still)
    weight = rk.NormalForce(np.full(2, 1e-3 * 9.80665), 9.80665)
    record = rk.Record([0.0, 0.1], {"weight": weight})
    return rk.fit(scene, start, record, rk.Free("body.mass", **given))


def test_what_is_known_to_no_factor_is_not_drawn():
    """The deviation of the logarithm: 1000 / sqrt(2); e^709 is the largest number."""
    found = weighed()
    assert found.unseen == ()
    with pytest.raises(rk.FieldError, match=r"body\.mass.*prior") as caught:
        rk.FitCovariance(found)
    assert "varies by 707" in str(caught.value)
    within = rk.FitCovariance(weighed(bounds=(1e-4, 1.0)))
    masses = drawn(within)["body.mass"]
    # logarithms and back, of numbers down to 1e-4: 9 roundings
    assert masses.min() > 1e-4 * (1.0 - 16 * EPS)
    assert masses.max() < 1.0 + 16 * EPS
    prior = rk.FitCovariance(weighed(prior=(1e-3, 1e-4)))
    assert (drawn(prior)["body.mass"] > 0.0).all()


# All that is random in a study


def study():
    return Draws(
        {
            "spin": rk.Normal([0.0, 1.0], 0.1),
            "orientation": rk.UniformOrientation(),
            "pair": rk.Correlated({"z": NORMAL, "a": rk.Uniform(0.0, 1.0)}, 0.5),
            "mass": rk.LogNormal(0.1, 0.05),
        }
    )


def test_draws_by_name():
    draws = study()
    assert draws.dimension == 9
    assert draws.names == ("spin", "orientation", "pair", "mass")
    assert draws.labels == ("spin[0]", "spin[1]", "orientation", "pair", "mass")
    assert draws.columns("spin") == slice(0, 2)
    assert draws.columns("spin[1]") == slice(1, 2)
    assert draws.columns("orientation") == slice(2, 6)
    u = uniforms(9, count=1)[0]
    # through JAX's containers, which sort dictionaries
    again = jax.tree.map(lambda x: x, draws)
    found, same = draws.draw(u), jax.jit(lambda d, u: d.draw(u))(again, u)
    assert list(found) == list(draws.names)
    for name, one in draws.distributions.items():
        alone = jax.jit(lambda v, one=one: one.draw(v))(u[draws.columns(name)])
        close = lambda x, y: np.testing.assert_allclose(x, y, rtol=0, atol=16 * EPS)
        jax.tree.map(close, found[name], alone)
    assert flat(found).keys() == {"spin", "orientation", "pair.z", "pair.a", "mass"}
    for name, value in flat(found).items():
        # one program fuses what single operations round
        np.testing.assert_allclose(flat(same)[name], value, rtol=8 * EPS, atol=8 * EPS)


def test_single_precision():
    draws = study()
    found = flat(at(draws, uniforms(9, count=16).astype(np.float32)))
    exact = flat(at(draws, uniforms(9, count=16)))
    for name, value in found.items():
        assert value.dtype == np.float32
        # u is rounded by 6e-8, quantiles of a unit deviation rise by up to 100 at the
        # least u here, 2e-3; angles of up to 2 pi are as exact
        np.testing.assert_allclose(value, exact[name], rtol=0, atol=1e-5)
    # numbers that single precision would round to 0 and 1
    with jax.enable_x64(False):
        ends = rk.Normal(0.0, 1.0).draw
        least, most = (float(ends(np.array([x]))) for x in (1e-60, 1.0 - 2.0**-53))
    assert -np.inf < least < most < np.inf


def test_descriptions_identify():
    """All kinds and all numbers, as JSON keeps them."""
    every = [
        *(one for one, _ in SCALARS.values()),
        rk.Truncated(NORMAL, 1.8),
        rk.UniformOrientation(),
        rk.VonMisesFisher([0.0, 0.0, 1.0], 2.0),
        rk.VonMisesFisher([0.0, 0.0, 1.0], 2.0 + 1e-15),
        rk.MultivariateNormal([0.0, 0.0], np.eye(2)),
        rk.Correlated({"a": NORMAL, "b": rk.Uniform(0.0, 1.0)}, 0.5),
        rk.Correlated({"b": NORMAL, "a": rk.Uniform(0.0, 1.0)}, 0.5),
        rk.Empirical(np.arange(10000.0)),
        rk.Empirical(np.arange(10000.0) + 1e-9),
        rk.InertiaPerturbation(ASKEW, 0.1),
    ]
    texts = [json.dumps(one.spec(), allow_nan=False) for one in every]
    assert len(set(texts)) == len(texts)
    assert all(len(text) < 1000 for text in texts[8:11])
    named = study().spec()
    assert list(json.loads(json.dumps(named))) == list(study().names)


def test_the_description_of_a_fit(found):
    text = json.dumps(rk.FitCovariance(found).spec(), allow_nan=False)
    assert json.loads(text)["kind"] == "FitCovariance"


# What is refused

PAIR = {"a": NORMAL, "b": NORMAL}
REFUSED = {
    "a negative deviation": (
        lambda: rk.Normal(0.0, [1.0, -1.0]),
        "Normal.std",
        "must not be negative",
    ),
    "text": (lambda: rk.Normal("five", 1.0), "Normal.mean", "made of numbers"),
    "infinite": (lambda: rk.Normal(np.inf, 1.0), "Normal.mean", "must be finite"),
    "shapes": (lambda: rk.Normal([0.0, 1.0], [1.0] * 3), "Normal", "do not fit"),
    "ragged": (lambda: rk.Normal([0.0, [1.0]], 1.0), "Normal.mean", "of numbers"),
    "an empty interval": (lambda: rk.Uniform(1.0, 1.0), "Uniform.low", "below the"),
    "a negative median": (lambda: rk.LogNormal(-1.0, 0.1), "LogNormal.median", "posit"),
    "no tails": (
        lambda: rk.Truncated(rk.Empirical([1.0]), 0.0),
        "Truncated.distribution",
        "give Normal",
    ),
    "ends in disorder": (
        lambda: rk.Truncated(NORMAL, 1.0, 0.0),
        "Truncated.low",
        r"less than the upper end, 0\.0",
    ),
    "no probability": (
        lambda: rk.Truncated(rk.Uniform(0.0, 1.0), 2.0, 3.0),
        "Truncated.low",
        "without any probability",
    ),
    "an end of another shape": (
        lambda: rk.Truncated(NORMAL, [0.0, 1.0]),
        "Truncated.low",
        "the distribution's shape",
    ),
    "no direction": (
        lambda: rk.VonMisesFisher([0.0, 0.0, 0.0], 1.0),
        "VonMisesFisher.direction",
        "has no direction",
    ),
    "a negative concentration": (
        lambda: rk.VonMisesFisher([0.0, 0.0, 1.0], -1.0),
        "VonMisesFisher.concentration",
        "must not be negative",
    ),
    "an indefinite covariance": (
        lambda: rk.MultivariateNormal([0.0, 0.0], [[1e-6, 2e-6], [2e-6, 1e-6]]),
        "MultivariateNormal.covariance",
        "negative eigenvalue",
    ),
    "a negative variance": (
        lambda: rk.MultivariateNormal([0.0], [[-1.0]]),
        "MultivariateNormal.covariance",
        "negative eigenvalue",
    ),
    "no symmetry": (
        lambda: rk.MultivariateNormal([0.0, 0.0], [[1.0, 0.1], [0.0, 1.0]]),
        "MultivariateNormal.covariance",
        "must be symmetric",
    ),
    "one alone": (
        lambda: rk.Correlated({"a": NORMAL}, 0.5),
        "Correlated.distributions",
        "two or more",
    ),
    "several numbers": (
        lambda: rk.Correlated({"a": NORMAL, "b": rk.UniformOrientation()}, 0.5),
        "Correlated.distributions['b']",
        "of one number",
    ),
    "a covariance": (
        lambda: rk.Correlated(PAIR, [[4.0, 1.0], [1.0, 4.0]]),
        "Correlated.correlation",
        "ones on its diagonal",
    ),
    "more than one": (
        lambda: rk.Correlated(PAIR, 1.2),
        "Correlated.correlation",
        "exceeds one",
    ),
    "no values": (lambda: rk.Empirical([]), "Empirical.values", "at least one"),
    "no weight": (
        lambda: rk.Empirical([1.0, 2.0], [0.0, 0.0]),
        "Empirical.weights",
        "are all zero",
    ),
    "a negative weight": (
        lambda: rk.Empirical([1.0, 2.0], [1.0, -1.0]),
        "Empirical.weights",
        "must not be negative",
    ),
    "no body": (
        lambda: rk.InertiaPerturbation(np.diag([1.0, 1.0, 3.0]), 0.1),
        "InertiaPerturbation.inertia",
        "triangle inequality",
    ),
    "nothing drawn": (lambda: Draws({}), "Draws.distributions", "at least one"),
    "a number alone": (
        lambda: Draws({"spin": 5.0}),
        "Draws.distributions['spin']",
        "must be a distribution",
    ),
    "no word": (lambda: Draws({"a b": NORMAL}), "Draws.distributions", "is no word"),
    "no factor": (lambda: study().columns("tilt"), "Draws.columns.name", "use one of"),
    "a block of u": (
        lambda: study().draw(np.zeros((3, 8))),
        "Draws.draw.u",
        r"take several by jax\.vmap",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_refused(name):
    make, field, says = REFUSED[name]
    with pytest.raises(rk.FieldError, match=says) as caught:
        make()
    assert caught.value.field == field


def test_traced_numbers_that_are_bad_draw_nothing():
    """They cannot raise: the draw is NaN, and its member fails alone."""
    u = jnp.array([0.5])
    makes = (
        lambda x: rk.Normal(0.0, x),
        lambda x: rk.Uniform(0.0, x),
        lambda x: rk.LogNormal(x, 1.0),
        lambda x: rk.Truncated(rk.Uniform(0.0, 1.0), 1.0 - x, 4.0),
    )
    for make in makes:
        draw = jax.jit(jax.vmap(lambda x, make=make: make(x).draw(u)))
        found = draw(jnp.array([-1.0, 0.5]))
        assert np.isnan(found).tolist() == [True, False]
