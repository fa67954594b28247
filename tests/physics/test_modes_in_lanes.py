"""Batches of runs with modes take the steps of single runs, each its own.

Plain steps are taken in lanes, by rates that are written apart from those of a single
run: same steps, states to rounding. What rounding does to a state grows along a run,
and steps near an event tell sums apart that differ in their last digit.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk
import rollkane.hybrid.mode_lanes as mode_lanes

UP, STILL = (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
R, MASS = 0.11, 6.0
BALL = rk.Body(MASS, 0.4 * MASS * R**2 * np.eye(3), rk.Sphere(R))
OFF = rk.Body(2.0, np.diag([0.004, 0.005, 0.006]), rk.Sphere(0.1), (0.01, 0.0, -0.02))
ROCK = rk.Body(1.0, np.diag([0.02, 0.005, 0.022]), rk.Ellipsoid((0.1, 0.2, 0.08)))
SLIPS = rk.Slipping(rk.CoulombFriction(0.2))
TIMES = jnp.linspace(0.0, 1.5, 4)
COUNT = 19  # more than a row, and no multiple of one
# Roundings of 200 steps, each some ten of 1e-16 of its numbers, grown tenfold by the
# sensitivity of a slip's end to what was before it
CLOSE = 200 * 10 * 1e-16 * 10


def thrown(scene, spin=STILL):
    slips = rk.Scene(scene.body, scene.base, contact=SLIPS)

    def run(v, **more):
        start = rk.place(
            slips, UP, spin, STILL, velocity=jnp.stack([v, 0.2 * v, 0.0 * v])
        )
        return rk.simulate(
            scene, start, more.pop("times", TIMES), modes=rk.Modes(friction=0.2), **more
        )

    return run


def tilted(angle):
    down = 9.81 * np.array([np.sin(angle), 0.0, -np.cos(angle)])
    return rk.Scene(BALL, loads=(rk.Gravity(down),))


SHAKEN = rk.Base(
    rk.Plane(),
    rk.BaseMotion(lambda t: 0.02 * jnp.sin(15.0 * t) * jnp.array([1.0, 0, 0])),
)
SCENES = {
    "bowling ball": thrown(rk.Scene(BALL), (3.0, 0.0, 5.0)),
    "off its centre": thrown(rk.Scene(OFF), (0.0, 1.0, 2.0)),
    "ellipsoid": thrown(rk.Scene(ROCK), (0.5, 0.3, 4.0)),
    "on a slope": thrown(tilted(0.1)),
    "on a shaken plate": thrown(rk.Scene(BALL, SHAKEN)),
}
SPEEDS = {"ellipsoid": (0.3, 0.6), "off its centre": (0.5, 1.0)}
QUICK = "bowling ball", "off its centre"


def compared(run, values, **more):
    """A batch, and the single runs that are the same."""
    many = jax.jit(jax.vmap(lambda v: run(v, **more)))(values)
    one = jax.jit(lambda v: run(v, **more))
    alone = [one(v) for v in values]
    return many, jax.tree.map(lambda *x: jnp.stack(x), *alone)


def counted(monkeypatch):
    """How many batches are taken in lanes."""
    made = []
    lanes = mode_lanes.MemberLanes
    monkeypatch.setattr(
        mode_lanes, "MemberLanes", lambda *a: made.append(a) or lanes(*a)
    )
    return made


def check_same(many, alone):
    assert many.method == "native"
    np.testing.assert_array_equal(many.code, alone.code)
    np.testing.assert_array_equal(many.steps, alone.steps)
    # where 1e-10 m/s of a slip is left, a digit decides on one more try of its end
    tries = np.abs(many.rejected_steps - alone.rejected_steps)
    assert np.all(tries <= many.switches.count)
    np.testing.assert_array_equal(many.switches.after, alone.switches.after)
    np.testing.assert_allclose(many.switches.time, alone.switches.time, atol=CLOSE)
    np.testing.assert_array_equal(many.state.mode, alone.state.mode)
    pairs = [many.state.parts, alone.state.parts]
    for a, b in zip(*map(jax.tree.leaves, pairs), strict=True):
        size = np.max(np.abs(np.nan_to_num(b)), initial=1.0)
        np.testing.assert_allclose(a, b, rtol=0, atol=CLOSE * size)
    # of a contact that rolls it is where a slip would begin, and friction may be zero
    slips = np.asarray(alone.state.mode == rk.Mode.SLIPPING)
    ways = many.state.direction[slips], alone.state.direction[slips]
    np.testing.assert_allclose(*ways, rtol=0, atol=CLOSE)


@pytest.mark.parametrize(
    "name",
    [pytest.param(x, marks=() if x in QUICK else pytest.mark.slow) for x in SCENES],
)
def test_a_batch_takes_the_steps_of_single_runs(name, monkeypatch):
    made = counted(monkeypatch)
    low, high = SPEEDS.get(name, (1.0, 3.0))
    many, alone = compared(SCENES[name], jnp.linspace(low, high, COUNT))
    assert len(made) == 1
    assert np.all(np.asarray(many.code) == rk.Code.COMPLETED)
    assert np.max(many.switches.count) >= 1
    check_same(many, alone)


def test_outputs_and_bodies_of_their_own(monkeypatch):
    made, times = counted(monkeypatch), jnp.linspace(0.0, 1.5, 101)

    def run(v):
        ball = rk.Body(MASS * v, 0.4 * MASS * v * R**2 * jnp.eye(3), rk.Sphere(R))
        modes = rk.Modes(friction=0.1 * v)
        slips = rk.Scene(ball, contact=SLIPS)
        start = rk.place(slips, UP, (0.0, 1.0, 2.0), STILL, velocity=(2.0, 0.0, 0.0))
        return rk.simulate(rk.Scene(ball), start, times, modes=modes)

    check_same(*compared(run, jnp.linspace(1.0, 2.0, COUNT)))
    assert len(made) == 1


def test_a_slip_without_friction_does_not_end():
    """It goes on as it is, in the steps that a spin needs, at any speed."""
    ball = rk.Scene(BALL)
    slips = rk.Scene(BALL, contact=SLIPS)

    def run(v):
        start = rk.place(slips, UP, STILL, STILL, velocity=jnp.stack([v, v, 0.0 * v]))
        return rk.simulate(ball, start, (0.0, 2.0), modes=rk.Modes(friction=0.0))

    many, alone = compared(run, jnp.geomspace(0.01, 30.0, COUNT))
    check_same(many, alone)
    assert np.all(np.asarray(many.steps) < 10)  # of no error, five times longer each
    np.testing.assert_allclose(
        many.final_state.parts.slip[:, 0], jnp.geomspace(0.01, 30.0, COUNT), rtol=1e-14
    )


def test_members_end_as_they_do_alone():
    """One is no number, the others run out of steps at different times."""
    run, speeds = (
        SCENES["bowling ball"],
        jnp.linspace(0.5, 3.0, COUNT).at[4].set(jnp.nan),
    )
    many, alone = compared(run, speeds, max_steps=109)
    assert set(np.asarray(many.code)) == {
        rk.Code.COMPLETED, rk.Code.MAX_STEPS, rk.Code.BAD_START,
    }  # fmt: skip
    check_same(many, alone)


@pytest.mark.slow
def test_flights_between(monkeypatch):
    """What flies and lands is no lane's; it slides and rolls in lanes behind."""
    made, ball = counted(monkeypatch), rk.Scene(BALL)
    modes = rk.Modes(friction=0.3, restitution=0.2)

    def run(v):
        start = rk.release(ball, UP, (5.0, 0.0, 3.0), (0.0, 0.0, 0.2), (v, 0.0, 0.0))
        return rk.simulate(ball, start, TIMES, modes=modes)

    many, alone = compared(run, jnp.linspace(0.5, 2.0, COUNT))
    assert len(made) == 1
    assert np.all(many.switches.count >= 3)
    check_same(many, alone)


@pytest.mark.slow
def test_batches_of_batches_and_functions_that_differ():
    """Numbers that a scene's function closes over are of no lane."""

    def run(a, v):
        moves = lambda t: a * jnp.sin(15.0 * t) * jnp.array([1.0, 0.0, 0.0])
        return thrown(rk.Scene(BALL, rk.Base(rk.Plane(), rk.BaseMotion(moves))))(v)

    sizes, speeds = jnp.array([0.01, 0.02]), jnp.array([1.0, 2.0, 3.0])
    grid = jax.jit(jax.vmap(jax.vmap(run, (None, 0)), (0, None)))(sizes, speeds)
    ball = SCENES["bowling ball"]
    moved = jax.vmap(jax.vmap(lambda a, v: ball(v + a), (None, 0)), (0, None))
    both = jax.jit(moved)(sizes, speeds)
    for i, a in enumerate(sizes):
        for j, v in enumerate(speeds):
            one = lambda run, i=i, j=j: jax.tree.map(lambda x: x[i, j][None], run)
            alone = lambda run: jax.tree.map(lambda x: jnp.asarray(x)[None], run)
            check_same(one(grid), alone(run(a, v)))
            check_same(one(both), alone(ball(v + a)))


@pytest.mark.slow
def test_derivatives_of_a_batch_are_those_of_single_runs():
    run = SCENES["bowling ball"]
    end = lambda v: run(v).final_state.parts.angular_velocity[1]
    speeds = jnp.linspace(1.0, 3.0, 3)
    many = jax.jit(jax.vmap(jax.grad(end)))(speeds)
    # both replay steps of single runs: nothing but their order differs
    np.testing.assert_allclose(many, [jax.grad(end)(v) for v in speeds], rtol=1e-13)
