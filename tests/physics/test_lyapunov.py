"""Lyapunov exponents: closed forms, the mean divergence, chaos, regular motions."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk
from rollkane.files.scene_files import load_scene
from rollkane.simulation.run_options import RunOptions
from rollkane.stability.independent_coordinates import IndependentCoordinates
from rollkane.stability.variational import carried, divergence

G = 9.81
STILL = (0.0, 0.0, 0.0)


def rattleback(tilt=0.46):
    """An ellipsoid whose inertia is turned against its axes."""
    a, b, c = axes = 0.2, 0.09, 0.03
    inertia = np.diag([b * b + c * c, a * a + c * c, a * a + b * b]) / 5.0
    cos, sin = np.cos(tilt), np.sin(tilt)
    turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    return rk.Scene(rk.Body(1.0, turn @ inertia @ turn.T, rk.Ellipsoid(axes)))


@pytest.fixture(scope="module")
def chaotic():
    scene = rattleback()
    start = rk.place(scene, (1.0, 0.0, 0.0, 0.0), (9.0, 3.0, -2.0), STILL)
    return scene, rk.lyapunov_exponents(scene, start, 600.0)


def test_a_rattlebacks_chaos(chaotic):
    _, found = chaotic
    assert found.chaotic
    # 0.75 +- 0.06 in 8000 s: well above the error of a thirteenth of that time
    assert found.values[0] > 2.0 * found.errors[0]
    assert np.all(np.diff(found.values) <= 0.0)
    # eight coordinates and velocities; five zeros: flow, three symmetries, energy
    assert found.dimension == found.values.size == 8
    assert np.sum(np.abs(found.values) <= found.errors) >= 5


@pytest.mark.slow
def test_zeros_have_names(chaotic):
    _, found = chaotic
    names = {"flow", "translation x", "translation y", "turn about z", "energy"}
    assert set(found.zeros) == names


def test_their_sum_is_the_mean_divergence(chaotic):
    """Along the same motion by another way: the trace of the rates' derivative."""
    scene, long = chaotic
    start = jax.tree.map(lambda leaf: leaf[-1], long.states)
    found = rk.lyapunov_exponents(scene, start, 60.0)
    length = found.time[1] - found.time[0]
    # 16 nodes in each of 24 parts of a batch: the spikes of the divergence (where the
    # stone turns over its tip) last some 5 ms, a part 39 ms
    nodes, weights = np.polynomial.legendre.leggauss(16)
    edges = np.linspace(0.0, length, 25)
    parts = edges[:-1, None] + 0.5 * (nodes + 1.0) * (edges[1] - edges[0])
    times = jnp.asarray(np.concatenate([[0.0], parts.ravel(), [length]]))
    weights = np.tile(0.5 * weights / 24.0, 24)

    @jax.jit
    def along(state):
        run = rk.simulate(scene, state, times)
        inside = jax.tree.map(lambda leaf: leaf[1:-1], run.state)
        return jax.vmap(lambda s: divergence(scene, jnp.zeros(()), s))(inside)

    rates = np.diff(found.growth.sum(axis=1), prepend=0.0) / length
    means = np.array(
        [
            weights
            @ np.asarray(along(jax.tree.map(lambda leaf, k=k: leaf[k], found.states)))
            for k in range(31, 63)
        ]
    )
    # a batch is a second, with up to seven e-folds of a state's error, 1e-9 times 1e2
    # steps, and a divergence whose slope is of order 10
    np.testing.assert_allclose(rates[32:], means, rtol=0, atol=1e-3)
    assert np.ptp(means) > 1.0
    assert found.sum == pytest.approx(means.mean(), abs=1e-3)
    # in the long run volumes shrink: on a bounded set of states they cannot grow
    assert long.sum < 0.0


def test_changes_are_carried_as_differences_are(chaotic):
    scene, found = chaotic
    state = jax.tree.map(lambda leaf: leaf[5], found.states)
    around = IndependentCoordinates(scene, jnp.zeros(()), state)
    options = RunOptions(rtol=1e-12)

    @jax.jit
    def ended(x, like):
        run = rk.simulate(scene, around.state(x), jnp.array([0.0, 0.3]), rtol=1e-12)
        end = IndependentCoordinates(scene, jnp.asarray(0.3), like)
        return end.coordinates(run.final_state)

    there = jax.jit(lambda x: carried(around, x, jnp.asarray(0.3), options))(np.eye(8))
    h = 1e-5
    for k in (0, 2, 4, 5, 7):
        ahead, behind = (ended(s * h * np.eye(8)[k], there.state) for s in (1.0, -1.0))
        # third derivatives of order 1e3 times h^2, and roundings of 1e-12 over h
        np.testing.assert_allclose(
            (ahead - behind) / (2.0 * h), there.changes[:, k], rtol=1e-6, atol=2e-6
        )


@pytest.mark.slow
def test_a_ball_on_top_of_a_ball():
    """Closed form: theta'' = 5 g / (7 (R + r)) theta, twice; the rest are zeros."""
    scene = rk.Scene(
        rk.Body(1.0, 0.4 * 0.01 * np.eye(3), rk.Sphere(0.1)), rk.Base(rk.Sphere(0.5))
    )
    start = rk.place(scene, (1.0, 0.0, 0.0, 0.0), STILL, (0.0, 0.0, 0.5))
    rate = np.sqrt(5.0 * G / (7.0 * 0.6))
    # 24 e-folds: a rounding of the start becomes 3e-6, whose square moves the rates;
    # what is left of neighbouring directions is e^-12 = 6e-6 at the half of it
    found = rk.lyapunov_exponents(scene, start, 24.0 / rate)
    expected = rate * np.array([1, 1, 0, 0, 0, 0, -1, -1])
    steep = expected != 0.0
    np.testing.assert_allclose(found.values[steep], expected[steep], rtol=1e-5)
    assert np.all(np.abs(found.values - expected)[~steep] <= found.errors[~steep])
    assert found.sum == pytest.approx(0.0, abs=1e-7 * rate)


@pytest.mark.slow
def test_a_slip_that_viscous_friction_damps():
    """Closed form: U' = -(7/2) (c / m) U for a homogeneous ball; the rest are zeros."""
    c = 0.6
    scene = rk.Scene(
        rk.Body(1.0, 0.4 * 0.01 * np.eye(3), rk.Sphere(0.1)),
        contact=rk.Slipping(rk.ViscousFriction(c)),
    )
    start = rk.place(
        scene, (1.0, 0.0, 0.0, 0.0), (1.0, 2.0, 3.0), STILL, velocity=(1.0, 0.0, 0.0)
    )
    found = rk.lyapunov_exponents(scene, start, 30.0)
    assert found.dimension == 10
    # each batch of half a second damps by its own e^-1; rtol 1e-9 of a step
    np.testing.assert_allclose(found.values[-2:], -3.5 * c, rtol=1e-6)
    assert np.all(np.abs(found.values[:-2]) <= found.errors[:-2])


REGULAR = {
    "routh-sphere": (),
    "chaplygin-ball": pytest.mark.slow,
    "rolling-disc": pytest.mark.slow,
    "ball-on-turntable": pytest.mark.slow,
}


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=mark) for name, mark in REGULAR.items()]
)
def test_integrable_motions_have_zeros_only(name):
    """Within errors that fall as one over the horizon, up to its logarithm."""
    known = load_scene(name)
    short, long = (
        rk.lyapunov_exponents(known.scene, known.start, horizon)
        for horizon in (20.0, 600.0)
    )
    for found in (short, long):
        assert np.all(np.abs(found.values) <= found.errors)
        assert not found.chaotic
    # growth as a power of time: 30 times the horizon, of which phases and the
    # logarithm may take some
    assert long.errors.max() < short.errors.max() / 8.0
    assert np.abs(long.values).max() < 0.03


@pytest.mark.slow
def test_fewer_exponents_are_the_largest(chaotic):
    scene, _ = chaotic
    start = rk.place(scene, (1.0, 0.0, 0.0, 0.0), (9.0, 3.0, -2.0), STILL)
    all_, two = (
        rk.lyapunov_exponents(scene, start, 20.0, count=n, interval=0.3)
        for n in (None, 2)
    )
    # no order is settled in 20 s; of the first growth is that of the same directions
    assert two.values.shape == (2,)
    assert two.growth.shape == (64, 2)
    assert two.growth[-1].max() == pytest.approx(all_.growth[-1].max(), rel=1e-6)


def test_refusals(chaotic):
    scene, _ = chaotic
    start = rk.place(scene, (1.0, 0.0, 0.0, 0.0), (9.0, 3.0, -2.0), STILL)
    for keywords, said in (
        ({"horizon": -1.0}, "horizon: must be positive"),
        ({"horizon": 1.0, "count": 9}, "count: is more than the 8"),
        ({"horizon": 1.0, "interval": 0.0}, "interval: must be positive"),
        ({"horizon": 1.0, "rtol": 2.0}, "rtol"),
    ):
        with pytest.raises(rk.FieldError, match=said):
            rk.lyapunov_exponents(scene, start, **keywords)
    tilted = rk.place(scene, (0.8, 0.6, 0.0, 0.0), STILL, STILL)
    with pytest.raises(rk.FieldError, match="state: is of another kind"):
        rk.lyapunov_exponents(scene, rk.to_voronets(scene, tilted), 1.0)
    with pytest.raises(rk.FieldError, match="outside of jit"):
        jax.jit(lambda s: rk.lyapunov_exponents(scene, s, 1.0).sum)(start)


@pytest.mark.slow
def test_a_run_that_ends_is_refused():
    known = load_scene("rolling-disc")
    tilted = rk.place(known.scene, (np.cos(0.7), np.sin(0.7), 0.0, 0.0), STILL, STILL)
    with pytest.raises(rk.FieldError, match="horizon: is not reached"):
        rk.lyapunov_exponents(known.scene, tilted, 10.0)
