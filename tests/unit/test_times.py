"""Output times: derivatives by them, and times that are one stop."""

from decimal import Decimal
from fractions import Fraction

import diffrax as dfx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk
from rollkane.integration.step_control import stops_of
from rollkane.kane import KaneState, KaneSystem, Particle
from rollkane.kane import simulate as kane_simulate

from .. import problems
from ..quick import slow_but

TIMES = np.array([0.0, 0.1, 0.3])
METHODS = pytest.mark.parametrize("method", slow_but(["native"], ["diffrax", "native"]))


@METHODS
def test_the_final_state_and_time_move_with_the_times(method):
    """The outputs' derivatives were right; those of what is final were zero."""
    scene, start = problems.disc(6.0)

    def run(times):
        return rk.simulate(scene, start, times, method=method, rtol=1e-11)

    def last(times):
        result = run(times)
        return result.final_time, result.final_state, result.state

    at = jnp.asarray(TIMES)
    time, final, shown = jax.jacfwd(last)(at)
    np.testing.assert_array_equal(time, [0.0, 0.0, 1.0])
    for a, b in zip(*map(jax.tree.leaves, (final, shown)), strict=True):
        # the same numbers by two programs
        np.testing.assert_allclose(a, b[-1], rtol=1e-13, atol=1e-13)
    rates = rk.rolling_derivative(scene, at[-1], run(at).final_state)
    for a, b in zip(*map(jax.tree.leaves, (final, rates)), strict=True):
        if a.shape[0]:
            # a run that is differentiated takes shorter steps: its tolerance, of the
            # largest rate
            np.testing.assert_allclose(a[:, 2], b, rtol=1e-10, atol=1e-10)
            assert jnp.all(a[:, 1] == 0.0)
    # a later start is the same motion, later: on a base at rest nothing else changes
    for a in jax.tree.leaves(final):
        np.testing.assert_allclose(jnp.sum(a, axis=-1), 0.0, atol=1e-6)
    back = jax.grad(lambda t: jnp.sum(run(t).final_state.orientation))(at)
    np.testing.assert_allclose(back, jnp.sum(final.orientation, axis=0), rtol=1e-9)


@pytest.mark.slow
def test_through_changes_of_the_contact_too():
    ball = rk.Body(6.0, 0.4 * 6.0 * 0.11**2 * np.eye(3), rk.Sphere(0.11))
    scene = rk.Scene(ball)
    slides = rk.Scene(ball, contact=rk.Slipping())
    still = (0.0, 0.0, 0.0)
    start = rk.place(slides, (1.0, 0, 0, 0), still, still, slip=(1.0, 0, 0))

    def last(times):
        modes = rk.Modes(friction=0.2)
        run = rk.simulate(scene, start, times, modes=modes)
        return run.final_time, run.final_state.parts.contact_on_base

    time, place = jax.jacfwd(last)(jnp.asarray([0.0, 0.3, 0.9]))
    np.testing.assert_array_equal(time, [0.0, 0.0, 1.0])
    # it rolls on with 5/7 of its speed
    np.testing.assert_allclose(place[0], [-5 / 7, 0.0, 5 / 7], rtol=0, atol=1e-8)


def test_kane_systems_too():
    system = KaneSystem(
        1, 1, lambda t, q, u: u, [Particle(1.0, lambda t, q, u: [u[0], 0.0, 0.0])]
    )
    last = lambda times: kane_simulate(
        system, KaneState(jnp.zeros(1), jnp.full(1, 3.0)), times
    ).final_state.q[0]
    found = jax.grad(last)(jnp.asarray(TIMES))
    np.testing.assert_allclose(found, [-3.0, 0.0, 3.0], rtol=1e-12)


@pytest.mark.parametrize("method", slow_but(["native"], ["diffrax", "native"]))
def test_where_a_run_stops_has_no_derivative(method):
    """It stops of itself, at a time that depends on everything: NaN, never zero."""
    scene, start = problems.disc(6.0)

    def last(times, scene):
        run = rk.simulate(scene, start, times, method=method, max_steps=4)
        return run.final_time + run.final_state.orientation[0]

    at = jnp.asarray(TIMES)
    assert np.isfinite(last(at, scene))
    by_scene = jax.grad(last, 1)(at, scene)
    assert np.isnan(by_scene.body.mass)
    _, tangent = jax.jvp(lambda m: last(at, m), (scene,), (by_scene,))
    assert np.isnan(tangent)


def test_a_saveat_of_the_users_is_not_differentiated_by_the_times():
    scene, start = problems.disc(6.0)

    def last(times):
        saved = dfx.SaveAt(t1=True)
        return rk.simulate(scene, start, times, saveat=saved).state.orientation[0, 0]

    assert np.isfinite(last(jnp.asarray(TIMES)))
    with pytest.raises(rk.FieldError, match="cannot be differentiated by the times"):
        jax.grad(last)(jnp.asarray(TIMES))


def beside(time: float, roundings: int) -> float:
    for _ in range(abs(roundings)):
        time = np.nextafter(time, np.inf * np.sign(roundings))
    return float(time)


CLOSE = {
    "in the middle": [0.0, 0.1, beside(0.1, 1), 0.3],
    "at the end": [0.0, 0.1, 0.3, beside(0.3, 1)],
    "at the start": [0.5, beside(0.5, 1), 0.6, 0.8],
    "three": [0.0, 0.1, beside(0.1, 2), beside(0.1, 5), 0.3],
    "backwards": [0.3, beside(0.3, -1), 0.1, beside(0.1, -1), 0.0],
}


@pytest.mark.parametrize("name", slow_but(["in the middle", "backwards"], CLOSE))
@pytest.mark.parametrize("way", ["diffrax", "native", "modes", "ensemble", "traced"])
def test_times_one_rounding_apart_are_one_stop(name, way):
    """Was: "the motion reached a singular place"."""
    scene, start = problems.disc(6.0)
    times = np.array(CLOSE[name])
    alone = np.append(times[:-1][np.abs(np.diff(times)) > 1e-12], times[-1])
    options: dict = {"rtol": 1e-11}
    if way == "modes":
        if name == "backwards":
            pytest.skip("time runs forwards with modes")
        options["modes"] = rk.Modes(friction=50.0)
    elif way != "ensemble" and way != "traced":
        options["method"] = way

    def states(times):
        if way == "ensemble":
            starts = jax.tree.map(lambda x: np.stack([x, x]), start)
            found = rk.ensemble(scene, starts, times, rtol=1e-11, method="native")
            return found.code[1], found.state.orientation[1], found.final_time[1]
        run = lambda times: rk.simulate(scene, start, times, **options)
        run = jax.jit(run)(times) if way == "traced" else run(times)
        state = run.state.parts if way == "modes" else run.state
        return run.code, state.orientation, run.final_time

    code, found, end = states(times)
    assert code == rk.Code.COMPLETED
    assert end == times[-1]
    _, wanted, _ = states(alone)
    which = np.argmin(np.abs(times[:, None] - alone), axis=1)
    # what a rounding of the time moves: 1e-16 s at 10 rad/s
    np.testing.assert_allclose(found, np.asarray(wanted)[which], rtol=0, atol=1e-13)


@pytest.mark.parametrize("method", slow_but(["native"], ["diffrax", "native"]))
def test_derivatives_at_such_times(method):
    scene, start = problems.disc(6.0)
    times = jnp.asarray(CLOSE["three"])
    run = lambda s, times: rk.simulate(s, start, times, method=method, rtol=1e-11)
    ahead = jax.jacfwd(lambda s: run(s, times).state.orientation)(scene)
    few = jnp.asarray([0.0, times[3], 0.3])
    wanted = jax.jacfwd(lambda s: run(s, few).state.orientation)(scene)
    radius = lambda s: s.body.surface.radius
    for k, j in enumerate([0, 1, 1, 1, 2]):
        a, b = radius(ahead)[k], radius(wanted)[j]
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-12)
    for k in range(5):
        one = lambda s, k=k: run(s, times).state.orientation[k, 0]
        back = radius(jax.grad(one)(scene))
        np.testing.assert_allclose(back, radius(ahead)[k, 0], rtol=0, atol=1e-11)


@pytest.mark.parametrize("way", ["diffrax", "native", "modes", "ensemble"])
def test_a_span_below_the_clock_is_no_motion(way):
    scene, start = problems.disc(6.0)
    times = np.array([1.0, beside(1.0, 1)])
    if way == "ensemble":
        starts = jax.tree.map(lambda x: np.asarray(x)[None], start)
        run = rk.ensemble(scene, starts, times, method="native")
        code, found = run.code[0], run.final_state.orientation[0]
    elif way == "modes":
        run = rk.simulate(scene, start, times, modes=rk.Modes(friction=9.0))
        code, found = run.code, run.final_state.orientation
    else:
        run = rk.simulate(scene, start, times, method=way)
        code, found = run.code, run.final_state.orientation
    assert code == rk.Code.COMPLETED
    np.testing.assert_array_equal(found, start.orientation)


@METHODS
def test_impossible_times_in_a_batch_fail_alone(method):
    scene, start = problems.disc(6.0)
    bad = jnp.asarray([[0.0, np.nan, 0.3], [0.0, 0.3, 0.1], TIMES])
    runs = jax.vmap(lambda t: rk.simulate(scene, start, t, method=method))(bad)
    assert runs.code.tolist() == [rk.Code.BAD_START] * 2 + [rk.Code.COMPLETED]
    first = jax.tree.map(lambda x: x[0], runs)
    assert first.reason.startswith("the times cannot be used")
    assert np.isnan(np.asarray(first.state.orientation)).all()


@pytest.mark.parametrize("end", [np.inf, -np.inf, np.nan])
def test_times_without_end_are_refused(end):
    with pytest.raises(rk.FieldError, match=r"simulate\.times: must be finite"):
        rk.simulate(*problems.disc(6.0), [0.0, end])


SECONDS = r'/ np\.timedelta64\(1, "s"\)'
NO_TIMES = {
    "durations": (np.array([0, 1, 500], "timedelta64[ms]"), SECONDS),
    "dates": (np.array([0, 1, 500], "datetime64[ms]"), SECONDS),
    "texts": (["0", "0.1", "0.3"], "real numbers"),
    "truth values": ([False, True], "real numbers"),
    "a truth value among numbers": ([0, True], "real numbers"),
    "a truth value of NumPy's": ((0.0, np.True_, 3.0), "real numbers"),
    "complex": (np.array([0.0, 0.1 + 2.0j, 0.3]), "real numbers"),
    "masked": (np.ma.array(TIMES, mask=[0, 1, 0]), "masked"),
    "a set": ({0.0, 0.3}, "real numbers"),
    "ragged": ([0.0, [0.1, 0.3]], "numbers"),
}
TAKES_TIMES = {
    "simulate": lambda times: rk.simulate(*problems.disc(6.0), times),
    "modes": lambda times: rk.simulate(*problems.disc(6.0), times, modes=rk.Modes(0.3)),
    "ensemble": lambda times: rk.ensemble(
        problems.disc(6.0)[0], [problems.disc(6.0)[1]] * 2, times
    ),
    "kane": lambda times: kane_simulate(
        KaneSystem(
            1, 1, lambda t, q, u: u, [Particle(1.0, lambda t, q, u: [u[0], 0.0, 0.0])]
        ),
        KaneState(jnp.zeros(1), jnp.ones(1)),
        times,
    ),
    "Record": lambda times: rk.Record(times, {"gyro": rk.Gyro(np.zeros((3, 3)))}),
    "RecordedMotion": lambda times: rk.RecordedMotion(times, np.zeros(3)),
}


@pytest.mark.parametrize("name", NO_TIMES)
@pytest.mark.parametrize("by", TAKES_TIMES)
def test_what_are_no_times_is_refused(by, name):
    """Was: 500 ms were 500 s, a masked entry and the real part of a number a time."""
    times, says = NO_TIMES[name]
    with pytest.raises(rk.FieldError, match=says) as caught:
        TAKES_TIMES[by](times)
    assert caught.value.field.rpartition(".")[2] in ("times", "time")


def test_a_known_call_takes_no_masked_times():
    scene, start = problems.disc(6.0)
    rk.simulate(scene, start, TIMES)
    with pytest.raises(rk.FieldError, match="masked"):
        rk.simulate(scene, start, np.ma.array(TIMES, mask=[0, 1, 0]))


def test_exact_numbers_are_numbers():
    scene, start = problems.disc(6.0)
    run = lambda *given, **options: rk.simulate(scene, start, *given, **options)
    wanted = run((0.0, 0.5), rtol=1e-8, atol=1e-9, dt0=0.01)
    options = {"rtol": Decimal("1e-8"), "atol": Fraction(1, 10**9)}
    times = [Decimal(0), Fraction(1, 2)]
    found = run(times, **options, dt0=Decimal("0.01"))
    np.testing.assert_array_equal(found.position, wanted.position)
    assert rk.Body(Fraction(3, 2), 0.004 * np.eye(3), rk.Sphere(Decimal("0.1")))


@pytest.mark.parametrize("name", ["rtol", "atol", "dt0"])
@pytest.mark.parametrize("value", [1e-8 + 1j, np.timedelta64(1, "s"), "small", True])
def test_what_is_no_tolerance_is_refused(name, value):
    with pytest.raises(rk.FieldError) as caught:
        rk.simulate(*problems.disc(6.0), TIMES, **{name: value})
    assert caught.value.field == f"simulate.{name}"


@pytest.mark.parametrize("way", ["diffrax", "native", "modes", "ensemble"])
def test_outputs_that_follow_closely_are_not_all_one(way):
    """Each is near to the next, and the last far from the first, by the clock's steps.

    A ball that rolls at 1 m/s; each output is shown within a step of the clock.
    """
    first = 1e6
    near = 100.0 * float(np.finfo(float).eps) * first
    times = first + np.linspace(0.0, 12.0 * near, 101)
    scene = rk.Scene(rk.Body(1.0, 4e-3 * np.eye(3), rk.Sphere(0.1)))
    start = rk.place(scene, (1.0, 0.0, 0.0, 0.0), (0.0, 10.0, 0.0), (0.0, 0.0, 0.0))
    if way == "ensemble":
        starts = jax.tree.map(lambda x: np.asarray(x)[None], start)
        run = rk.ensemble(scene, starts, times, method="native")
        code, found = run.code[0], run.state.contact_on_base[0, :, 0]
    else:
        more = {"modes": rk.Modes(friction=9.0)} if way == "modes" else {"method": way}
        run = rk.simulate(scene, start, times, **more)
        code, found = run.code, run.position[:, 0]
    assert code == rk.Code.COMPLETED
    late = np.asarray(found) - (times - first)
    # steps between stops are known to a rounding of the time at either end, 2 of 100
    assert np.abs(late).max() <= 1.02 * near
    assert abs(late[-1]) <= 0.02 * near
    assert late[0] == 0.0


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_stops_are_apart_and_near_to_what_they_show(dtype, sense):
    """By NumPy and in a program, of dense and of scattered times."""
    draw = np.random.default_rng(3)
    near = 100.0 * float(np.finfo(dtype).eps) * 8.0
    for spread in (0.05, 0.3, 1.0, 3.0):
        gaps = spread * near * draw.exponential(size=400)
        times = (sense * (8.0 - np.cumsum(gaps)[::-1])).astype(dtype)
        times = times[np.append(True, np.diff(sense * times) > 0)]
        known, found = stops_of(times), jax.jit(stops_of)(jnp.asarray(times))
        shown = np.asarray(found.time)
        np.testing.assert_array_equal(shown, known.time)
        last = np.arange(times.size) if known.last is None else known.last
        np.testing.assert_array_equal(found.last, last)
        # the largest of the times is what their roundings are of
        near = 100.0 * float(np.finfo(dtype).eps) * float(np.abs(times).max())
        assert np.abs(shown.astype(float) - times).max() <= near * (1.0 + 1e-6)
        assert shown[0] == times[0]
        assert shown[-1] == times[-1]
        apart = np.abs(np.diff(np.unique(shown).astype(float)))
        assert apart.min() > near * (1.0 - 1e-6)
        # rows are kept under the last of the outputs that share a stop
        np.testing.assert_array_equal(shown[last], shown)
