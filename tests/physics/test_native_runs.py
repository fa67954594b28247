"""Runs of ``simulate`` in the loop in C: diffrax's, and what JAX does with them."""

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk
from rollkane.codegen import RunLoop

from .. import problems

TIMES = np.array([0.0, 0.1, 0.3])
# Steps of the same lengths, rounded in another order: some tens of steps with tens of
# roundings of numbers up to six, 1e-15 each, in motions that make ten times as much of
# a difference at the start.
ROUNDING = {"rtol": 0, "atol": 1e-11}


def disc():
    return problems.disc(6.0)


def shaken(depth=0.5, mass=1.0):
    """A body on a base whose acceleration jumps on an output and between two."""

    def sway(t, p):
        on = jnp.where(t < 0.1, 0.0, jnp.where(t < 0.17, 1.0, -1.0))
        return jnp.stack([p * on * (t - 0.1) ** 2, 0.0 * t, 0.0 * t])

    motion = rk.BaseMotion(sway, parameters=jnp.asarray(depth), kinks=[0.1, 0.17])
    surface = rk.Ellipsoid([0.1, 0.08, 0.06])
    body = rk.Body(mass, np.diag([1e-3, 1.2e-3, 1.5e-3]), surface)
    scene = rk.Scene(body, rk.Base(motion=motion))
    return scene, rk.place(scene, [1.0, 0.0, 0.0, 0.0], [0.3, 0.2, 4.0], [0.0] * 3)


def same(native, slow):
    for a, b in zip(*map(jax.tree.leaves, (native, slow)), strict=True):
        np.testing.assert_allclose(a, b, **ROUNDING)


@pytest.mark.parametrize("traced_tolerance", [False, True])
def test_a_batch_takes_lanes(monkeypatch, traced_tolerance):
    # not the loop of one motion for each member, which takes five times as long
    scene, start = disc()
    loops = []
    compiled = RunLoop._compiled

    def noted(loop, own, lanes, caller):
        loops.append(caller)
        return compiled(loop, own, lanes, caller)

    monkeypatch.setattr(RunLoop, "_compiled", noted)
    spins = (
        start.angular_velocity[None]
        * jnp.linspace(0.9, 1.1, 7 + traced_tolerance)[:, None]
    )

    def end(spin, rtol):
        begun = eqx.tree_at(lambda s: s.angular_velocity, start, spin)
        return rk.simulate(scene, begun, (0.0, 0.1), rtol=rtol).final_time

    if traced_tolerance:
        times = jax.jit(jax.vmap(end, (0, None)))(spins, 1e-8)
    else:
        times = jax.jit(jax.vmap(lambda spin: end(spin, 1e-8)))(spins)
    np.testing.assert_array_equal(times, 0.1)
    assert loops[-1] == "batch_call.c"


@pytest.mark.parametrize(
    ("made", "how"),
    [
        (disc, {}),
        (disc, {"formulation": "euler_lagrange", "solver": dfx.Tsit5()}),
        (disc, {"coordinates": "voronets", "solver": dfx.Dopri5(), "dt0": 1e-3}),
        (shaken, {"solver": dfx.Bosh3(), "rtol": 1e-6}),
    ],
)
def test_equal_to_diffrax(made, how):
    scene, start = made()
    runs = [
        rk.simulate(scene, start, TIMES, method=method, **how)
        for method in ("native", "diffrax")
    ]
    assert runs[0].code == rk.Code.COMPLETED
    same(*(eqx.tree_at(lambda r: r.scene, run, None) for run in runs))


def test_derivatives_batches_and_the_way_back():
    """Through jit, vmap, forward and reverse mode, in both directions of time."""
    _, start = shaken()

    def end(method, p, spin):
        moved, _ = shaken(*p)
        begun = eqx.tree_at(lambda s: s.angular_velocity, start, spin)
        there = rk.simulate(moved, begun, TIMES, method=method, solver=dfx.Tsit5())
        middle = jax.tree.map(lambda x: x[1], there.state)
        back = rk.simulate(
            moved, middle, TIMES[1::-1], method=method, solver=dfx.Tsit5()
        )
        return there.state.contact_on_base[-1, 0] + back.final_state.angular_velocity[0]

    at = jnp.asarray([0.5, 1.0])
    spins = start.angular_velocity[None] + jnp.asarray([[0.0] * 3, [0.7] * 3])
    found = []
    for method in ("native", "diffrax"):
        one = lambda p, spin, method=method: end(method, p, spin)
        ahead = jax.vmap(jax.value_and_grad(one, (0, 1)), (None, 0))
        back = jax.vmap(jax.jacfwd(one, (0, 1)), (None, 0))
        both = lambda p, s, a=ahead, b=back: (a(p, s), b(p, s))
        found.append(jax.jit(both)(at, spins))
    same(*found)
    (_, reverse), forward = found[0]
    same(reverse, forward)
    assert np.abs(np.asarray(forward[0][:, 0])).min() > 1e-3


def test_a_batch_goes_in_lanes():
    """In blocks on every processor: as alone, whatever differs, and in batches of such.

    More than 128 are two blocks. One that cannot begin fails alone.
    """
    count = 300
    _, start = shaken()
    masses = 1.0 + 0.001 * jnp.arange(float(count))
    swing = jnp.linspace(0.4, 0.6, count)
    spins = start.angular_velocity[None] + jnp.linspace(0.0, 1.0, count)[:, None]
    spins = spins.at[7, 1].set(jnp.nan)

    def end(mass, depth, spin, times=TIMES):
        moved, _ = shaken(depth, mass)
        begun = eqx.tree_at(lambda s: s.angular_velocity, start, spin)
        run = rk.simulate(moved, begun, times, solver=dfx.Tsit5())
        assert run.method == "native"
        return run.state, run.final_state, run.code, run.steps, run.final_time

    together = jax.jit(jax.vmap(end))(masses, swing, spins)
    alone = jax.jit(end)
    for i in (0, 1, 7, 128, 299):
        one = alone(masses[i], swing[i], spins[i])
        same(jax.tree.map(lambda x, i=i: x[i], together), one)
    assert jnp.sum(together[2] != rk.Code.COMPLETED) == 1
    assert together[2][7] == rk.Code.BAD_START
    twice = lambda x: x.reshape(2, 150, *x.shape[1:])
    rows = jax.vmap(jax.vmap(end))(*map(twice, (masses, swing, spins)))
    shapes = jax.tree.map(lambda x: x.reshape(count, *x.shape[2:]), rows)
    same(shapes, together)
    # one scene for all, and times for each
    shared = jax.vmap(end, (None, None, 0))(1.0, 0.5, spins[:3])
    times = jnp.stack([TIMES, 0.5 * TIMES, TIMES])
    own_times = jax.vmap(end, (None, None, 0, 0))(1.0, 0.5, spins[:3], times)
    for i in (0, 2):
        pick = lambda x, i=i: x[i]
        same(*(jax.tree.map(pick, x) for x in (own_times, shared)))
    assert own_times[4].tolist() == [0.3, 0.15, 0.3]


def test_a_batch_of_records():
    """Samples are looked up where they lie: shared by all lanes, or one by one."""
    time = np.linspace(0.0, 0.3, 16)
    shake = np.sin(40.0 * time)
    start = disc()[1]

    def end(strength, spin):
        motion = rk.RecordedMotion(time, strength * jnp.asarray(shake))
        scene = eqx.tree_at(
            lambda s: s.base.motion, disc()[0], motion, is_leaf=lambda x: x is None
        )
        begun = eqx.tree_at(lambda s: s.angular_velocity, start, spin)
        run = rk.simulate(scene, begun, TIMES)
        assert run.method == "native"
        return run.state, run.steps

    spins = start.angular_velocity[None] * jnp.array([[1.0], [1.1], [1.2]])
    strengths = jnp.array([1.0, 2.0, 3.0])
    alone = jax.jit(end)
    shared = jax.jit(jax.vmap(end, (None, 0)))(2.0, spins)
    differing = jax.jit(jax.vmap(end))(strengths, spins)
    for i in range(3):
        pick = lambda x, i=i: x[i]
        same(jax.tree.map(pick, shared), alone(2.0, spins[i]))
        same(jax.tree.map(pick, differing), alone(strengths[i], spins[i]))


def test_a_batch_by_what_a_function_closes_over():
    """A height that differs from motion to motion, and is no part of the scene."""

    def end(height):
        ground = rk.Graph(lambda x, y: height * x * x)
        body = rk.Body(1.0, 0.004 * np.eye(3), rk.Sphere(0.1))
        scene = rk.Scene(body, rk.Base(ground))
        upright, at = [1.0, 0.0, 0.0, 0.0], jnp.stack([0.1, 0.0, 0.01 * height])
        start = rk.place(scene, upright, [0.5, 2.0, 1.0], at)
        return rk.simulate(scene, start, TIMES).position[-1]

    heights = jnp.array([0.1, 0.2, 0.4])
    ends = jax.jit(jax.vmap(end))(heights)
    same(ends, jnp.stack([jax.jit(end)(h) for h in heights]))
    assert np.ptp(ends[:, 0]) > 1e-5


def test_a_run_that_cannot_go_on_says_so():
    scene, start = disc()
    run = lambda start, times, most: rk.simulate(
        scene, start, times, method="native", max_steps=most
    )
    short = run(start, TIMES, 3)
    assert (short.code, short.steps + short.rejected_steps) == (rk.Code.MAX_STEPS, 3)
    assert 0.0 < short.final_time < 0.1
    assert np.isnan(short.state.orientation[1:]).all()
    bad = [[0.0, np.nan, 0.3], [0.0, 0.3, 0.1], [0.0, np.nan, np.nan], TIMES]
    lanes = jax.vmap(lambda times: run(start, times, 100))(jnp.asarray(bad))
    assert lanes.code.tolist() == [*3 * [rk.Code.BAD_START], rk.Code.COMPLETED]
    lost = eqx.tree_at(lambda s: s.angular_velocity, start, jnp.full(3, jnp.nan))
    assert run(lost, TIMES, 100).code == rk.Code.BAD_START


def test_steps_that_end_on_outputs_are_counted():
    """Outputs closer than steps: each step ends on one, and the most still holds."""
    scene, start = disc()
    times, most = np.linspace(0.0, 0.05, 51), 7

    def rates(start, method):
        run = rk.simulate(scene, start, times, method=method, max_steps=most)
        return run.state.angular_velocity, run

    for method in ("native", "diffrax"):
        primal = lambda start, method=method: rates(start, method)
        reached, tangent, run = jax.jvp(primal, (start,), (start,), has_aux=True)
        assert (run.code, run.steps, run.rejected_steps) == (rk.Code.MAX_STEPS, most, 0)
        # the first step is half an interval, as no step may fall short of its goal
        assert run.final_time == times[most - 1]
        for values in (reached, tangent):
            np.testing.assert_array_equal(
                np.isfinite(values).all(axis=1), times < times[most]
            )
    starts = jax.tree.map(lambda x: jnp.stack([x, x]), start)
    both = rk.ensemble(scene, starts, times, max_steps=most)
    assert both.steps.tolist() == [most, most]
    assert both.code.tolist() == [rk.Code.MAX_STEPS] * 2
    whole = rk.simulate(scene, start, times, method="native", max_steps=len(times))
    assert whole.code == rk.Code.COMPLETED


def test_a_force_by_a_table_is_native():
    """Its corners are those of the table: steps that meet them differ by rounding."""
    knots = np.linspace(0.0, 1.0, 6)

    def push(t, motion):
        del motion
        far = jnp.select([t < 0.3, t < 0.6], [0.0, 1.0], 2.0)
        along = jnp.interp(t, knots, np.sin(3.0 * knots))
        return jnp.stack([along, 0.1 * jnp.round(far), 0.0 * t])

    ball = rk.Body(1.0, 0.004 * np.eye(3), rk.Sphere(0.1))
    scene = rk.Scene(ball, loads=(rk.Gravity(), rk.Force(push)))
    start = rk.place(scene, [1.0, 0.0, 0.0, 0.0], [0.5, 2.0, 1.0], [0.0, 0.0, 0.0])
    ends = []
    for method in ("auto", "diffrax"):
        run = rk.simulate(scene, start, (0.0, 1.0), rtol=1e-10, method=method)
        ends.append(np.asarray(run.position[-1]))
        assert run.method == ("native" if method == "auto" else "diffrax")
    # a ball takes 5/7 of the push; of a step of 1e-10 over a corner or a jump as much
    # may be lost, at six of them
    np.testing.assert_allclose(*ends, rtol=0.0, atol=1e-9)


def test_what_is_more_than_arithmetic_is_refused():
    def dished(x, y):  # C has no modified Bessel functions
        return 1e-3 * (jax.scipy.special.i0(x) + y * y)

    scene = rk.Scene(
        rk.Body(1.0, 0.004 * np.eye(3), rk.Sphere(0.1)), rk.Base(rk.Graph(dished))
    )
    at = [0.5, 0.0, float(dished(0.5, 0.0))]
    start = rk.place(scene, [1.0, 0.0, 0.0, 0.0], [0.5, 2.0, 1.0], at)
    with pytest.raises(rk.FieldError, match="cannot do this"):
        rk.simulate(scene, start, TIMES, method="native")
