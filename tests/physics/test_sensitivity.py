"""Sensitivities, experiments and posteriors, against differences and closed forms."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk
from rollkane.dynamics.observables import energy

INERTIA = np.array([[2.0e-3, 1e-4, 0.0], [1e-4, 3e-3, 2e-4], [0.0, 2e-4, 4e-3]])
TIMES = np.linspace(0.0, 0.5, 26)
LEVEL = (1.0, 0.0, 0.0, 0.0)


def stone(inertia=INERTIA, axes=(0.2, 0.15, 0.1)):
    return rk.Scene(rk.Body(1.0, inertia, rk.Ellipsoid(axes)))


SCENE = stone()
START = rk.place(SCENE, LEVEL, (0.5, 1.0, 4.0), (0.0, 0.0, 0.0))
SIGMA = 0.01


def gyro(values=None):
    """A record of the motion; without values only its times and noise matter."""
    values = np.zeros((TIMES.size, 3)) if values is None else values
    return rk.Record(TIMES, {"gyro": rk.Gyro(values, SIGMA)})


def spin(scene, t, state):
    return rk.contact_of(scene, t, state).angular_velocity


def differences(function, step):
    """Richardson's: of two central differences, off by step^4."""
    one = lambda h: (function(h) - function(-h)) / (2.0 * h)
    return (4.0 * one(0.5 * step) - one(step)) / 3.0


def test_sensitivities_are_differences():
    paths = ["body.inertia", "start.orientation", "body.mass"]
    found = rk.sensitivity(
        SCENE, START, TIMES, paths, {"spin": spin, "energy": energy}, rtol=1e-11
    )
    assert found.code == rk.Code.COMPLETED
    assert found.names["body.inertia"][3] == "body.inertia.xy"

    def moved(tree_of, change):
        scene, start = tree_of(change)
        run = rk.simulate(scene, start, TIMES, rtol=1e-12)
        return np.asarray(run.each(spin))

    def inertia(h):
        change = np.zeros((3, 3))
        change[0, 1] = change[1, 0] = h
        at = lambda s: s.body.inertia
        return eqx.tree_at(at, SCENE, SCENE.body.inertia + change), START

    def about_y(h):
        half = np.array([np.cos(h / 2), 0.0, np.sin(h / 2), 0.0])  # times (1, 0, 0, 0)
        return SCENE, eqx.tree_at(lambda s: s.orientation, START, jnp.asarray(half))

    cases = (
        ("body.inertia", 3, inertia, 1e-5),
        ("start.orientation", 1, about_y, 2e-3),
    )
    for path, k, make, step in cases:
        expected = differences(lambda h, make=make: moved(make, h), step)
        own = found.values["spin"][path][..., k]
        # runs at rtol 1e-12 over a hundredth of the parameter, and its fourth power:
        # both are below 1e-7 of the largest derivative
        size = np.abs(expected).max()
        np.testing.assert_allclose(own, expected, rtol=0, atol=1e-6 * size)
    # the energy of a rolling body is kept, and so is its derivative along the run
    by_mass = found.values["energy"]["body.mass"][:, 0]
    np.testing.assert_allclose(by_mass, by_mass[0], rtol=1e-7)
    # height c = 0.1 m of the mass centre, and its speed w x r with r = (0, 0, 0.1)
    exact = 9.81 * 0.1 + 0.5 * 0.1**2 * (0.5**2 + 1.0**2)
    np.testing.assert_allclose(by_mass[0], exact, rtol=1e-12)


EGG_IN_A_BOWL = {
    "by its normal": rk.Ellipsoid((0.1, 0.1, 0.14)),
    "of revolution": rk.Revolution(lambda s: (0.1 * jnp.sin(s), -0.14 * jnp.cos(s))),
}


@pytest.mark.slow
def test_a_turned_start_touches_anew():
    """A body that holds its contact point is turned as its twin that does not."""
    turned = np.array([np.cos(0.35), 0.8 * np.sin(0.35), 0.6 * np.sin(0.35), 0.0])
    deep = (0.3, 0.2, -np.sqrt(1.0 - 0.13))
    paths = ["start.orientation", "start.contact_on_base", "base.surface.radius"]
    found = {}
    for name, surface in EGG_IN_A_BOWL.items():
        body = rk.Body(1.0, np.diag([4e-3, 5e-3, 3e-3]), surface)
        bowl = rk.Base(rk.Sphere(1.0, inside=True), rk.Spin(2.0, (0.96, 0.28, 0, 0)))
        scene = rk.Scene(body, bowl)
        start = rk.place(scene, turned, (0.3, 0.5, 2.0), deep, time=0.7)
        times = np.linspace(0.7, 0.9, 5)
        found[name] = rk.sensitivity(
            scene, start, times, paths, {"spin": spin}, rtol=1e-11
        )
    twin, own = (found[name].values["spin"] for name in EGG_IN_A_BOWL)
    for path in paths:
        size = np.abs(twin[path]).max()
        # no turn, nor a move, of the start is undone: not even of one number
        if path == "start.orientation":
            assert (np.abs(own[path]).max(axis=(0, 1)) > 0.1 * size).all()
        # runs at rtol 1e-11, of some 100 steps
        np.testing.assert_allclose(own[path], twin[path], rtol=0, atol=1e-8 * size)


def test_a_cylinder_in_a_bowl_is_not_turned():
    """No other point of it has the normal that it would need."""
    scene = rk.Scene(
        rk.Body(1.0, np.diag([4e-3, 4e-3, 3e-3]), rk.Cylinder(0.1)),
        rk.Base(rk.Sphere(1.0)),
    )
    lying, top = (np.sqrt(0.5), 0.0, np.sqrt(0.5), 0.0), (0.0, 0.0, 1.0)
    start = rk.place(scene, lying, (0.0, 1.0, 0.0), top)
    for path in ("start.orientation", "start.contact_on_base"):
        with pytest.raises(rk.FieldError, match="cannot change alone: no point") as no:
            rk.sensitivity(scene, start, TIMES, path, {"spin": spin})
        assert no.value.field == f"Free('{path}')"


def test_sensitivities_as_a_dataset_and_a_picture(tmp_path):
    found = rk.sensitivity(SCENE, START, TIMES, "body.mass", {"spin": spin})
    held = found.to_xarray()
    assert held["d(spin)/d(body.mass)"].shape == (TIMES.size, 3, 1)
    assert held["time"].attrs["units"] == "s"
    assert found.plot(tmp_path / "s.png") is None
    assert (tmp_path / "s.png").stat().st_size > 1000
    assert len(found.plot().axes) == 1


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"free": "body.masss"}, "Free.path"),
        ({"observe": {}}, "sensitivity.observe"),
        ({"times": [1.0, 0.5, 2.0]}, "simulate.times"),
    ],
)
def test_sensitivities_refuse(change, field):
    given = {"times": TIMES, "free": "body.mass", "observe": {"spin": spin}}
    with pytest.raises(rk.FieldError) as caught:
        rk.sensitivity(SCENE, START, **(given | change))
    assert caught.value.field == field


@pytest.mark.slow
def test_the_likelihood_has_the_gradient_of_differences():
    values = np.asarray(rk.simulate(SCENE, START, TIMES, rtol=1e-12).each(spin))
    values = values + SIGMA * np.random.default_rng(0).standard_normal(values.shape)
    record = gyro(values)
    cost = lambda x: rk.negative_log_likelihood(
        stone(axes=x), START, record, rtol=1e-11
    )
    axes = jnp.array([0.21, 0.15, 0.1])
    slope, unit = jax.grad(cost)(axes), jnp.array([1.0, 0.0, 0.0])
    by_first = lambda x: jax.jvp(cost, (x,), (unit,))[1]
    bend = jax.jit(lambda x: jax.jvp(by_first, (x,), (unit,))[1])(axes)
    along = lambda h: float(cost(axes + h * unit))
    expected = differences(along, 1e-4)
    # step^4 of a motion's phase over half a metre, and rounding: below 1e-7
    np.testing.assert_allclose(slope[0], expected, rtol=1e-6)
    tangent = jax.jit(by_first)
    second = differences(lambda h: float(tangent(axes + h * unit)), 1e-4)
    np.testing.assert_allclose(bend, second, rtol=1e-4)
    # the record's own misfit: half of chi2 of as many normal numbers, five deviations
    n = values.size
    own = float(rk.negative_log_likelihood(SCENE, START, record, rtol=1e-11))
    assert abs(2.0 * own - n) < 5.0 * np.sqrt(2.0 * n)


@pytest.mark.slow
def test_the_experiment_that_tells_most():
    """A longer lever tells more: scores are minus the logarithms of errors."""
    free = (rk.Free("body.inertia", form="diagonal"),)
    scene = stone(np.diag([2e-3, 3e-3, 4e-3]))
    place = lambda w: rk.place(scene, LEVEL, w, (0.0, 0.0, 0.0))
    starts = [place((0.0, 0.0, 0.2)), place((0.5, 1.0, 4.0)), place((2.0, 1.0, 4.0))]
    found = rk.design_experiment(scene, starts, gyro(), free, criterion="A")
    assert found.scores.shape == (3,)
    assert found.best == int(np.argmax(found.scores)) != 0
    assert found.scores[0] == -np.inf  # a spin about a principal axis shows one moment
    # the score is what identifiability says of the same experiment
    alone = rk.identifiability(scene, starts[found.best], gyro(), free)
    errors = np.diag(alone.standard_errors["body.inertia"])
    same = np.diag(found.standard_errors["body.inertia"])
    np.testing.assert_allclose(same, errors, rtol=1e-9)
    vary = rk.Free("start.angular_velocity", bounds=(-5.0, 5.0))
    better = rk.design_experiment(
        scene, starts[1:2], gyro(), free, vary=vary, steps=4, rtol=1e-8
    )
    assert better.score > better.scores[0] + 0.5  # errors fall by e^0.5 at least
    assert (np.diff(better.history) > 0.0).all()
    assert (np.abs(better.start.angular_velocity) <= 5.0).all()


def test_experiments_refuse():
    free = rk.Free("body.inertia")
    bad = (
        ({"criterion": "E"}, "design_experiment.criterion"),
        ({"wanted": ["body.mass"]}, "design_experiment.wanted"),
        ({"candidates": []}, "design_experiment.candidates"),
        ({"vary": rk.Free("body.inertia")}, "design_experiment.vary"),
    )
    for change, field in bad:
        given = {"candidates": START, "free": free} | change
        candidates, parameters = given.pop("candidates"), given.pop("free")
        with pytest.raises(rk.FieldError) as caught:
            rk.design_experiment(SCENE, candidates, gyro(), parameters, **given)
        assert caught.value.field == field
    both = (
        rk.Free("body.mass"),
        rk.Free("body.inertia", form="scale"),
        rk.Free("body.surface.semi_axes", form="scale"),
    )
    no_force = rk.Scene(SCENE.body, loads=())
    with pytest.raises(rk.FieldError, match="do not show"):
        rk.design_experiment(no_force, START, gyro(), both)


def test_a_posterior_is_normal_where_the_model_is_linear():
    """Of an angular velocity by its own samples: mean and deviation of the fit."""
    times = np.array([0.0, 1e-3])
    body = rk.Body(1.0, 0.4 * 0.01 * np.eye(3), rk.Sphere(0.1))
    scene = rk.Scene(body)
    start = rk.place(scene, LEVEL, (0.0, 0.0, 4.0), (0.0, 0.0, 0.0))
    values = np.array([[0.01, -0.02, 4.01], [0.0, 0.01, 3.98]])
    record = rk.Record(times, {"gyro": rk.Gyro(values, SIGMA)})
    fit = rk.fit(scene, start, record, rk.Free("start.angular_velocity"))
    draws = 4000
    found = rk.posterior(fit, draws=draws, warmup=200)["start.angular_velocity"]
    # a ball's angular velocity stays: the mean of two samples, sigma / sqrt(2)
    np.testing.assert_allclose(
        fit.estimates["start.angular_velocity"], values.mean(axis=0), atol=1e-9
    )
    deviation = SIGMA / np.sqrt(2.0)
    # draws of the sampler are worth a quarter as many independent ones at least: five
    # deviations
    away = found.mean(axis=0) - values.mean(axis=0)
    assert (np.abs(away) < 5.0 * deviation / np.sqrt(draws / 4)).all()
    spread = found.std(axis=0) / deviation
    assert (np.abs(spread - 1.0) < 5.0 / np.sqrt(2.0 * draws / 4)).all()
    mass = rk.fit(
        scene, start, record, [rk.Free("start.angular_velocity"), rk.Free("body.mass")]
    )
    with pytest.raises(rk.FieldError, match="unseen"):
        rk.posterior(mass)
    with pytest.raises(rk.FieldError, match="whole number") as caught:
        rk.posterior(fit, seed=-1)
    assert caught.value.field == "posterior.seed"
