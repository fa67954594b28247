"""Numbers that cannot be, while JAX traces them: a code, a field's name and NaN."""

import collections
import logging

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
import scipy.optimize

import rollkane as rk
from rollkane import kane

from .. import problems
from ..quick import slow_but

TIMES = np.array([0.0, 0.2])
LEVEL = (1.0, 0.0, 0.0, 0.0)
INERTIA = np.diag([2e-3, 3e-3, 4e-3])


def stone(axes=(0.2, 0.15, 0.1), mass=1.0, inertia=INERTIA):
    return rk.Scene(rk.Body(mass, inertia, rk.Ellipsoid(axes)))


def rolled(scene, spin=(0.0, 1.0, 5.0), at=(0.0, 0.0, 0.0), **options):
    start = rk.place(scene, LEVEL, jnp.asarray(spin), at)
    return rk.simulate(scene, start, TIMES, **options)


AXES = jnp.asarray([0.2, 0.15, 0.1])
IMPOSSIBLE = {
    "a negative semi-axis": (
        lambda x: stone(AXES.at[1].set(x)),
        -0.15,
        0.15,
        "scene.body.surface.semi_axes",
    ),
    "no mass": (lambda x: stone(mass=x), 0.0, 1.0, "scene.body.mass"),
    "an inertia against the triangle": (
        lambda x: stone(inertia=jnp.asarray(INERTIA).at[0, 0].set(x)),
        1.0,
        2e-3,
        "scene.body.inertia",
    ),
    "an infinite field": (
        lambda x: eqx.tree_at(
            lambda s: s.loads, stone(), (rk.Gravity(jnp.stack([0.0 * x, 0.0 * x, x])),)
        ),
        -np.inf,
        -9.8,
        "scene.loads[0].acceleration",
    ),
}
METHODS = pytest.mark.parametrize("method", ["diffrax", "native"])


@METHODS
@pytest.mark.parametrize(
    "name", slow_but(["a negative semi-axis", "an infinite field"], IMPOSSIBLE)
)
def test_an_impossible_scene_ends_with_its_own_code(name, method):
    """In jit, in a batch beside a good member, and in derivatives."""
    make, bad, good, field = IMPOSSIBLE[name]
    run = lambda x: rolled(make(x), method=method)
    both = jax.jit(jax.vmap(run))(jnp.asarray([bad, good]))
    assert both.code.tolist() == [rk.Code.BAD_SCENE, rk.Code.COMPLETED]
    lost, kept = (jax.tree.map(lambda x, k=k: x[k], both) for k in (0, 1))
    assert field in lost.reason
    assert "outside of jit" in lost.reason
    assert np.isnan(np.asarray(lost.state.orientation)).all()
    assert np.isnan(np.asarray(lost.final_state.angular_velocity)).all()
    assert np.isfinite(np.asarray(kept.state.orientation)).all()
    one = jax.jit(run)(jnp.asarray(bad))
    assert (one.code, one.fault) == (rk.Code.BAD_SCENE, lost.fault)
    with pytest.raises(rk.FieldError):
        make(bad)  # known numbers, at once


@METHODS
def test_derivatives_at_an_impossible_trial_are_nan(method):
    def end(x):
        scene = stone(AXES.at[1].set(x))
        return jnp.sum(rolled(scene, method=method).final_state.orientation)

    for take in (jax.grad, jax.jacfwd):
        slope = jax.jit(take(end))
        assert np.isnan(slope(-0.15))
        assert np.isfinite(slope(0.15))


IMPOSSIBLE_STARTS = {
    "a quaternion of length 2": ({"orientation": (2.0, 0, 0, 0)}, "length"),
    "a point off the plane": ({"contact_on_base": (0, 0, 0.1)}, "off the base"),
    "an infinite spin": ({"angular_velocity": (0, np.inf, 0)}, "finite"),
}


@METHODS
@pytest.mark.parametrize("name", IMPOSSIBLE_STARTS)
def test_an_impossible_start_ends_with_its_own_code(name, method):
    changes, says = IMPOSSIBLE_STARTS[name]
    usual = {
        "orientation": LEVEL,
        "angular_velocity": (0.0, 1.0, 5.0),
        "contact_on_base": (0.0, 0.0, 0.0),
    }
    scene = stone()
    ((field, value),) = changes.items()
    pair = jnp.asarray([value, usual[field]], float)

    def run(x):
        start = rk.place(scene, **(usual | {field: x}))
        return rk.simulate(scene, start, TIMES, method=method)

    both = jax.jit(jax.vmap(run))(pair)
    assert both.code.tolist() == [rk.Code.BAD_START, rk.Code.COMPLETED]
    lost = jax.tree.map(lambda x: x[0], both)
    assert "start." in lost.reason
    assert np.isnan(np.asarray(lost.state.orientation)).all()
    with pytest.raises(rk.FieldError, match=says):
        run(pair[0])


def test_members_of_an_ensemble_fail_alone():
    """One bad start, one bad scene: counted by field, by both methods."""
    spins = jnp.asarray([[0.0, 1.0, 5.0], [0.0, jnp.inf, 0.0], [0.0, 1.0, 4.0]])
    axes = jnp.stack([AXES, AXES, AXES.at[2].set(-0.1)])
    scenes = jax.vmap(stone)(axes)

    def placed(axes, spin):
        return rk.place(stone(axes), LEVEL, spin, (0.0, 0.0, 0.0))

    starts = jax.vmap(placed)(axes, spins)
    for method in ("native", "diffrax"):
        runs = rk.ensemble(scenes, starts, TIMES, method=method)
        assert runs.code.tolist() == [0, rk.Code.BAD_START, rk.Code.BAD_SCENE]
        told = " ".join(runs.reasons)
        assert "start.angular_velocity" in told
        assert "scene.body.surface.semi_axes" in told
        assert np.isnan(runs.state.orientation[1:]).all()
        assert np.isfinite(runs.state.orientation[0]).all()


def test_changes_of_the_contact_too():
    run = lambda x: rolled(stone(AXES.at[1].set(x)), modes=rk.Modes(friction=0.5))
    both = jax.jit(jax.vmap(run))(jnp.asarray([-0.15, 0.15]))
    assert both.code.tolist() == [rk.Code.BAD_SCENE, rk.Code.COMPLETED]
    lost = jax.tree.map(lambda x: x[0], both)
    assert "semi_axes" in lost.reason
    assert np.isnan(np.asarray(lost.state.parts.orientation)).all()


def test_an_ensemble_with_changes_of_the_contact_names_the_field():
    """Numbers of the modes stand before those of the start, and shift no name."""
    scene = stone()
    spins = jnp.asarray([[0.0, 1.0, 5.0], [0.0, jnp.nan, 0.0]])
    place = lambda spin: rk.place(scene, LEVEL, spin, (0.0, 0.0, 0.0))
    modes = rk.Modes(friction=0.5)
    runs = rk.ensemble(scene, jax.vmap(place)(spins), TIMES, modes=modes)
    assert runs.code.tolist() == [rk.Code.COMPLETED, rk.Code.BAD_START]
    assert "start.angular_velocity is NaN" in " ".join(runs.reasons)


@pytest.mark.parametrize("height", [-0.1, np.nan, np.inf])
def test_a_release_that_cannot_be_names_the_place_not_what_was_to_follow(height):
    body = rk.Body(1.0, 0.004 * np.eye(3), rk.Sphere(0.1))
    scene = rk.Scene(body, rk.Base(rk.Graph(lambda x, y: 0.2 * (x * x + y * y))))
    still = (0.0, 0.0, 0.0)

    @jax.jit
    def released(height):
        place = jnp.stack([0.0 * height, 0.0 * height, height])
        return rk.release(scene, (1.0, 0.0, 0.0, 0.0), still, place, still)

    state = released(height)
    assert jnp.isnan(state.position).all()
    # a run names the first field with a NaN
    assert jnp.isfinite(state.contact_on_base).all()
    assert jnp.isfinite(released(0.5).position).all()


def test_kane_systems_too():
    def run(mass):
        part = kane.Particle(mass, lambda t, q, u: [u[0], 0.0, 0.0])
        system = kane.KaneSystem(1, 1, lambda t, q, u: u, [part])
        start = kane.KaneState(jnp.zeros(1), jnp.ones(1))
        return kane.simulate(system, start, TIMES)

    both = jax.jit(jax.vmap(run))(jnp.asarray([-1.0, 1.0]))
    assert both.code.tolist() == [rk.Code.BAD_SCENE, rk.Code.COMPLETED]
    assert "system.parts[0].mass" in jax.tree.map(lambda x: x[0], both).reason


def test_first_rates_that_are_not_finite_are_told_by_function():
    """Which function gave it: a base's height, its motion, a load's force."""
    ball = rk.Body(1.0, 0.004 * np.eye(3), rk.Sphere(0.1))

    def cusp(x, y):
        return 0.1 * jnp.abs(x) ** 1.5 + 0.0 * y

    scene = rk.Scene(ball, rk.Base(rk.Graph(cusp)))
    start = rk.State(
        *(jnp.asarray(x) for x in (LEVEL, (0.0, 1.0, 0.0), (0.0, 0.0), ())),
        jnp.zeros(0),
        jnp.zeros(0),
    )
    start = eqx.tree_at(lambda s: s.contact_on_body, start, jnp.zeros(0))
    run = rk.simulate(scene, start, TIMES)
    assert run.code == rk.Code.BAD_START
    assert "scene.base.surface (Graph: cusp)" in run.reason

    def push(t, point):
        return jnp.stack([jnp.sqrt(t - 1.0), 0.0 * t, 0.0 * t])

    scene = rk.Scene(ball, loads=(rk.Gravity(), rk.Force(push)))
    start = rk.place(scene, LEVEL, (0.0, 1.0, 0.0), (0.0, 0.0, 0.0))
    run = rk.simulate(scene, start, TIMES)
    assert run.code == rk.Code.BAD_START
    assert "scene.loads[1] (Force: push)" in run.reason

    def sway(t):
        return jnp.stack([jnp.sqrt(t), 0.0 * t, 0.0 * t])

    scene = rk.Scene(ball, rk.Base(motion=rk.BaseMotion(sway)))
    run = rk.simulate(scene, start, TIMES)
    assert "the motion of the base (BaseMotion: sway)" in run.reason


def callbacks(function, *arguments) -> list[str]:
    """Names of primitives in a program that call back to the host."""
    found: collections.Counter = collections.Counter()

    def walk(jaxpr):
        for equation in jaxpr.eqns:
            found[equation.primitive.name] += 1
            for value in jax.tree.leaves(
                list(equation.params.values()),
                is_leaf=lambda x: hasattr(x, "jaxpr") or hasattr(x, "eqns"),
            ):
                inner = getattr(value, "jaxpr", value)
                if hasattr(inner, "eqns"):
                    walk(inner)

    walk(jax.make_jaxpr(function)(*arguments).jaxpr)
    assert sum(found.values()) > 50
    return [name for name in found if "callback" in name or "print" in name]


EGG = rk.Ellipsoid((0.1, 0.08, 0.05))
HILLS = rk.Graph(lambda x, y: 0.1 * x * x + 0.05 * y * y)
SCENES = {
    "disc": lambda: problems.disc(6.0)[0],
    "egg on hills": lambda: rk.Scene(
        rk.Body(0.1, 1e-4 * np.eye(3), EGG), rk.Base(HILLS)
    ),
}


@pytest.mark.parametrize("name", slow_but(["disc"], SCENES))
def test_no_program_calls_back_to_the_host(name):
    scene = SCENES[name]()

    def placed(scene, spin, at):
        return rk.place(scene, (0.8, 0.6, 0.0, 0.0), spin, at)

    given = scene, jnp.asarray([0.0, 2.0, 3.0]), jnp.zeros(3)
    assert callbacks(placed, *given) == []
    start = placed(*given)
    times = jnp.asarray([0.0, 0.1, 0.3])
    for options in (
        {},
        {"method": "native"},
        {"rtol": 1e-5, "dt0": 1e-3},
        {"coordinates": "voronets"},
        {"second_contact": True},
        {"modes": rk.Modes(friction=0.3, restitution=0.2)},
    ):
        run = lambda scene, start, times, options=options: rk.simulate(
            scene, start, times, **options
        )
        assert callbacks(run, scene, start, times) == [], options
    end = lambda s, t: jnp.sum(rk.simulate(scene, s, t).final_state.orientation)
    assert callbacks(jax.grad(end), start, times) == []


def test_optimisers_run_through_bad_trials():
    """A first step of optax leads to a negative semi-axis, one of scipy, too."""
    wanted = rolled(stone()).final_state.orientation

    def residuals(b):
        run = rolled(stone(AXES.at[1].set(b)))
        return run.final_state.orientation - wanted

    tried: list[float] = []

    @jax.jit
    def both(b):
        return residuals(b), jax.jacfwd(residuals)(b)

    def of_scipy(x):
        tried.append(float(x[0]))
        return np.asarray(both(jnp.asarray(x[0]))[0])

    # a trust region of five times the start: its first trial is beyond zero
    found = scipy.optimize.least_squares(
        of_scipy,
        [0.19],
        jac=lambda x: np.asarray(both(jnp.asarray(x[0]))[1])[:, None],
        x_scale=[5.0],
        xtol=1e-12,
        ftol=1e-14,
        gtol=1e-14,
    )
    np.testing.assert_allclose(found.x, 0.15, rtol=1e-6)
    np.testing.assert_array_less(0.0, found.x)

    cost = jax.jit(jax.value_and_grad(lambda b: jnp.sum(residuals(b) ** 2)))
    rule = optax.apply_if_finite(optax.sgd(1.0), max_consecutive_errors=100)
    b, state = jnp.asarray(0.19), None
    state = rule.init(b)
    value, slope = cost(jnp.asarray(-0.19))
    assert np.isnan(value)
    updates, state = rule.update(slope, state, b)
    assert updates == 0.0  # left out
    value, slope = cost(b)
    updates, state = rule.update(slope, state, b)
    assert cost(b + 1e-3 * updates / abs(updates))[0] < value


@pytest.mark.parametrize(
    "order", ["vmap(jit(place))", "jit(vmap(place))", "vmap(place)"]
)
def test_a_bad_member_of_a_batch_of_placements_fails_alone(order):
    scene = stone()

    def placed(at):
        return rk.place(scene, LEVEL, (0.0, 1.0, 5.0), at)

    ways = {
        "vmap(jit(place))": jax.vmap(jax.jit(placed)),
        "jit(vmap(place))": jax.jit(jax.vmap(placed)),
        "vmap(place)": jax.vmap(placed),
    }
    starts = ways[order](jnp.asarray([[0.0, 0.0, 0.0], [0.0, 0.0, 0.1]]))
    assert np.isfinite(starts.orientation[0]).all()
    assert np.isnan(starts.orientation[1]).all()


def compiled(caplog):
    return [m for m in caplog.messages if m.startswith("Finished XLA compilation")]


def test_a_release_is_few_programs(caplog):
    """Not one for each check: eleven programs, half of its first time, were."""
    scene = stone()
    jax.clear_caches()
    with jax.log_compiles(True), caplog.at_level(logging.WARNING):
        rk.release(scene, LEVEL, (0.0, 1.0, 5.0), (0.0, 0.0, 1.0), (0.0, 0.0, 0.0))
    programs = compiled(caplog)
    # what finds the nearest points, the spin's, and what JAX makes its numbers by
    assert 1 <= len(programs) <= 4, programs


def test_a_batch_of_placements_is_few_programs(caplog):
    """Not one for each operation: 1,000 coins took 5 to 18 s the first time."""
    coin = rk.Scene(rk.Body(0.1, np.diag([1e-5, 1e-5, 2e-5]), rk.DiscEdge(0.02)))
    placed = lambda rate: rk.place(
        coin, (0.8, 0.6, 0, 0), jnp.stack([0.0, 2.0, rate]), (0.0, 0.0, 0.0)
    )
    jax.clear_caches()
    with jax.log_compiles(True), caplog.at_level(logging.WARNING):
        jax.block_until_ready(jax.vmap(placed)(jnp.linspace(5.0, 50.0, 1000)))
    programs = compiled(caplog)
    # the placement, what checks and moves arguments of four shapes, linspace and stack;
    # one program for each operation was several hundreds
    assert 1 <= len(programs) <= 25, programs


FINE = 1e-8
ASKED = {
    "rtol": (-1.0, 0.0, np.inf, 10.0, 1e-30),
    "atol": (-1.0, 0.0, np.inf),
    "dt0": (-1.0, 0.0, np.inf),
}
LOOPS = {
    "native": {"method": "native"},
    "diffrax": {"method": "diffrax"},
    "modes": {"modes": rk.Modes(friction=0.2)},
}
# dt0 goes by diffrax's loop alone
FITTING = [(name, loop) for name in ("rtol", "atol") for loop in LOOPS]
FITTING.append(("dt0", "diffrax"))


@pytest.mark.parametrize(("name", "loop"), FITTING)
def test_an_impossible_tolerance_or_first_step_ends_with_its_name(name, loop):
    """Traced; a good one beside it stands, and known ones are refused."""
    how = LOOPS[loop]
    run = lambda x: rolled(stone(), **how, **{name: x})
    found = jax.jit(jax.vmap(run))(jnp.asarray([*ASKED[name], np.nan, FINE]))
    bad = len(ASKED[name]) + 1
    assert found.code.tolist() == [rk.Code.BAD_START] * bad + [rk.Code.COMPLETED]
    lost = np.isnan(np.asarray(found.state.angular_velocity)).all((1, 2))
    assert lost.tolist() == [True] * bad + [False]
    for k in range(bad):
        reason = jax.tree.map(lambda x, k=k: x[k], found).reason
        assert reason.startswith(f"{name} cannot be used")
    for x in ASKED[name]:
        with pytest.raises(rk.FieldError, match=f"simulate.{name}"):
            run(x)


def test_a_traced_tolerance_of_an_ensemble_is_refused_alike():
    scene = stone()
    start = rk.place(scene, LEVEL, (0.0, 1.0, 5.0), (0.0, 0.0, 0.0))
    two = jax.tree.map(lambda x: jnp.stack([x, x]), start)

    @jax.jit
    def ends(x):
        found = rk.ensemble(scene, two, TIMES, rtol=x)
        return found.code, found.final_state.angular_velocity

    code, spin = ends(-1.0)
    assert code.tolist() == [rk.Code.BAD_START] * 2
    assert np.isnan(np.asarray(spin)).all()
    assert ends(FINE)[0].tolist() == [rk.Code.COMPLETED] * 2
