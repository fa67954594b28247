"""Ensembles: each member is what simulate gives, by either method."""

import threading

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk
from rollkane.dynamics.observables import energy
from rollkane.simulation.ensemble_run import EnsembleRun

from .. import problems

COUNT = 21
TIMES = np.array([0.0, 0.1, 0.25, 0.3])


def discs(count=COUNT):
    """A disc, started with spins from slow to fast: uneven lanes."""
    scene, start = problems.disc(6.0)
    spins = jnp.linspace(1.0, 12.0, count)
    spin = lambda w: start.angular_velocity.at[2].set(w)
    make = lambda w: eqx.tree_at(lambda s: s.angular_velocity, start, spin(w))
    return scene, jax.vmap(make)(spins)


def member(tree, i):
    return jax.tree.map(lambda x: x[i], tree)


def agree(a, b, tolerance):
    for x, y in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True):
        np.testing.assert_allclose(x, y, rtol=tolerance, atol=tolerance)


@pytest.fixture(scope="module")
def runs():
    """The same ensemble by both methods, in blocks that do not divide it."""
    scene, starts = discs()
    how = {"solver": dfx.Dopri5(), "rtol": 1e-8, "block": 8}
    native = rk.ensemble(scene, starts, TIMES, method="native", **how)
    return native, rk.ensemble(scene, starts, TIMES, method="diffrax", **how)


def test_both_methods_take_the_same_steps(runs):
    """To rounding: 1e-16 a step, some 100 steps, motions that part tenfold."""
    native, slow = runs
    assert (native.method, slow.method) == ("native", "diffrax")
    agree(native.state, slow.state, 1e-12)
    agree(native.final_state, slow.final_state, 1e-12)
    for name in ("code", "steps", "rejected_steps", "final_time"):
        np.testing.assert_array_equal(getattr(native, name), getattr(slow, name))
    assert native.steps.max() > 1.5 * native.steps.min()
    assert native.succeeded.all()
    assert native.reasons == {"completed": COUNT}


def test_a_member_is_what_simulate_gives(runs):
    scene, starts = discs()
    alone = rk.simulate(
        scene, member(starts, 17), TIMES, rtol=1e-8, solver=dfx.Dopri5()
    )
    agree(member(runs[0].state, 17), alone.state, 1e-12)
    assert runs[0].steps[17] == alone.steps


QUANTITIES = (
    "position",
    "velocity",
    "orientation",
    "contact_on_base",
    "contact_force",
    "energy",
    "mode",
)


def shows_what_members_show(runs, alone, quantities=QUANTITIES):
    """Quantities of members, at their outputs and at their ends, those of simulate.

    Of motions that agree to 1e-12 (as above), whose forces are of order ten.
    """
    near = {"rtol": 1e-11, "atol": 1e-11}
    for i, one in alone.items():
        for name in quantities:
            own, expected = getattr(runs, name)[i], np.asarray(getattr(one, name))
            np.testing.assert_allclose(own, expected, **near, err_msg=name)
            end = getattr(runs.final, name)[i]
            np.testing.assert_allclose(end, expected[-1], **near, err_msg=name)


def test_quantities_are_those_of_simulate(runs):
    scene, starts = discs()
    how = {"rtol": 1e-8, "solver": dfx.Dopri5()}
    alone = {17: rk.simulate(scene, member(starts, 17), TIMES, **how)}
    for each in runs:
        shows_what_members_show(each, alone)
        assert isinstance(each.position, np.ndarray)
        assert each.scene.body.mass.shape == ()


def stones(depths):
    """A scene of every mass and depth: a body on a base that goes up and down."""

    def make(mass, depth):
        sway = lambda t, p: jnp.stack([p * jnp.sin(3.0 * t), 0.0 * t, 0.1 * p * t])
        inertia = mass * jnp.diag(jnp.array([1e-3, 1.2e-3, 1.5e-3]))
        body = rk.Body(mass, inertia, rk.Ellipsoid([0.1, 0.08, 0.06]))
        moving = rk.BaseMotion(sway, parameters=depth, kinks=[0.12])
        return rk.Scene(body, rk.Base(motion=moving))

    one = make(1.0, 0.05)
    spin = jnp.array([0.3, 0.2, 4.0])
    start = rk.place(one, [1.0, 0.0, 0.0, 0.0], spin, [0.0, 0.0, 0.0])
    made = jax.vmap(make, in_axes=(0, None if depths.ndim == 0 else 0))
    return made(jnp.linspace(0.5, 2.0, 9), depths), start


@pytest.mark.slow
def test_scenes_that_differ_on_a_moving_base():
    """One start, masses of their own; a kink that is no output."""
    scenes, start = stones(jnp.asarray(0.05))
    shared = eqx.tree_at(lambda s: s.base.motion, scenes, member(scenes.base.motion, 0))
    how = {"solver": dfx.Tsit5(), "rtol": 1e-9}
    native = rk.ensemble(shared, start, TIMES, method="native", **how)
    slow = rk.ensemble(shared, start, TIMES, method="diffrax", **how)
    agree(native.state, slow.state, 1e-12)
    np.testing.assert_array_equal(native.steps, slow.steps)
    # shared arrays stay shared, and each member is seen in its own scene
    assert native.scene.body.mass.shape == (9,)
    assert native.scene.base.motion.kinks.shape == (1,)
    fitting = eqx.tree_at(
        lambda s: s.base.motion, member(scenes, 7), shared.base.motion
    )
    alone = {7: rk.simulate(fitting, start, TIMES, **how)}
    shows_what_members_show(native, alone, ("position", "energy"))
    blocks = list(rk.ensemble_blocks(shared, start, TIMES, method="native", **how))
    last = blocks[-1]  # filled up while it ran, and cut to its own members again
    assert last.scene.body.mass.shape == last.code.shape
    own = native.momentum[last.first :]
    np.testing.assert_allclose(last.momentum, own, rtol=1e-13, atol=1e-13)
    ends = native.final_state.angular_velocity
    assert np.ptp(ends, axis=0).max() < 1e-12  # of one shape: their mass does not count


def test_parameters_of_functions_that_differ():
    """Nothing says how many axes they have: the user does."""
    scenes, start = stones(jnp.linspace(0.0, 0.2, 9))
    scenes = eqx.tree_at(lambda s: s.base.motion.kinks, scenes, None)
    with pytest.raises(rk.FieldError, match="scene_axes="):
        rk.ensemble(scenes, start, TIMES)
    native = rk.ensemble(scenes, start, TIMES, scene_axes=0, method="native")
    alone = rk.simulate(member(scenes, 7), start, TIMES)
    agree(member(native.state, 7), alone.state, 1e-9)
    still = rk.simulate(member(scenes, 0), start, TIMES).state.angular_velocity
    assert np.abs(native.state.angular_velocity[7] - still).max() > 1e-3


def test_backwards():
    """There and back again: the error of two runs at 1e-9."""
    scene, starts = discs(3)
    there = rk.ensemble(scene, starts, [0.0, 0.3])
    back = rk.ensemble(scene, there.final_state, [0.3, 0.0], method="native")
    agree(back.final_state.angular_velocity, starts.angular_velocity, 1e-7)
    np.testing.assert_array_equal(back.final_time, 0.0)


def test_a_lane_fails_alone(runs):
    scene, starts = discs()
    spoilt = starts.angular_velocity.at[5, 1].set(jnp.nan)
    starts = eqx.tree_at(lambda s: s.angular_velocity, starts, spoilt)
    how = {"solver": dfx.Dopri5(), "rtol": 1e-8, "method": "native"}
    result = rk.ensemble(scene, starts, TIMES, **how)
    assert result.code[5] == rk.Code.BAD_START
    assert np.isnan(result.state.orientation[5, 1:]).all()
    others = np.arange(COUNT) != 5
    agree(member(result.state, others), member(runs[0].state, others), 1e-15)
    few = rk.ensemble(scene, starts, TIMES, max_steps=5, **how)
    assert set(few.code[others]) == {rk.Code.MAX_STEPS}
    assert "raise max_steps" in next(iter(few.reasons))


def test_observables_are_kept_instead_of_states(runs):
    scene, starts = discs()
    seen = rk.ensemble(
        scene, starts, TIMES, observe=energy, solver=dfx.Dopri5(), rtol=1e-8, block=8
    )
    assert seen.state is None
    assert seen.observed.shape == (COUNT, 4)
    # kept by the motion to its tolerance over some 100 steps
    spread = np.ptp(seen.observed, axis=1)
    assert (spread < 1e-6 * seen.observed[:, 0]).all()
    one = energy(scene, jnp.asarray(0.25), member(member(runs[0].state, 4), 2))
    np.testing.assert_allclose(seen.observed[4, 2], one, rtol=1e-14)


def test_states_are_kept_beside_observables_if_asked(runs):
    scene, starts = discs()
    how = {"observe": energy, "solver": dfx.Dopri5(), "rtol": 1e-8}
    both = rk.ensemble(scene, starts, TIMES, keep_states=True, **how)
    agree(both.state, runs[0].state, 0.0)  # however long the blocks are
    # another program of the same formulas: roundings
    np.testing.assert_allclose(both.observed, both.energy, rtol=1e-14)


def test_blocks_are_as_long_as_what_they_keep():
    """32 MiB of states and of what is observed, of numbers of eight bytes."""
    scene, starts = discs(2)
    wide = lambda scene, t, state: jnp.zeros(1000) + state.angular_velocity[0]
    times = np.linspace(0.0, 1.0, 101)
    sizes = [
        EnsembleRun(
            scene, lambda i: member(starts, 0), times, observe, count=10**6
        ).block
        for observe in (None, wide)
    ]
    state = sum(x.shape[1] for x in jax.tree.leaves(starts))
    expected = [2**25 // (8 * 101 * n) for n in (state, state + 1000)]
    assert sizes == expected


def test_members_that_are_made_when_needed(runs):
    """Of their numbers alone; and no more blocks are made than are under way."""
    scene, starts = discs()
    table = starts.angular_velocity
    start = member(starts, 0)
    made, lock = [], threading.Lock()

    def make(i):
        return eqx.tree_at(lambda s: s.angular_velocity, start, table[i])

    how = {"solver": dfx.Dopri5(), "rtol": 1e-8, "block": 4, "workers": 2}
    blocks = rk.ensemble_blocks(scene, make, TIMES, count=COUNT, **how)
    whole = []
    for block in blocks:
        with lock:
            made.append(block.first)
        whole.append(block.state.angular_velocity)
    assert made == [0, 4, 8, 12, 16, 20]
    assert whole[-1].shape == (1, 4, 3)
    np.testing.assert_allclose(
        np.concatenate(whole), runs[0].state.angular_velocity, rtol=1e-13, atol=1e-13
    )


@pytest.mark.slow
def test_what_is_made_alike_for_all_is_shared():
    """Of what functions of the member's number make, each time anew."""

    def make(i):
        body = rk.Body(
            1.0 + 0.1 * i.astype(float), 0.01 * np.eye(3), rk.Ellipsoid((0.2, 0.1, 0.1))
        )
        shake = lambda t: 0.1 * jnp.stack([jnp.sin(t), 0.0 * t, 0.0 * t])
        return rk.Scene(body, rk.Base(rk.Plane(), rk.BaseMotion(shake)))

    one = make(jnp.asarray(0))
    start = rk.place(one, [1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 2.0], [0.0, 0.0, 0.0])
    runs = rk.ensemble(make, lambda i: start, TIMES, count=6, block=4)
    assert runs.method == "native"
    assert runs.scene.body.mass.shape == (6,)
    assert runs.scene.body.inertia.shape == (3, 3)
    alone = rk.simulate(make(jnp.asarray(5)), start, TIMES)
    shows_what_members_show(runs, {5: alone}, ("position", "energy"))


@pytest.mark.parametrize(
    "method", ["auto", pytest.param("diffrax", marks=pytest.mark.slow)]
)
def test_derivatives_go_through_the_ensemble(method):
    """Those of each member alone."""
    scene, starts = discs(3)

    def end(radius):
        wider = eqx.tree_at(lambda s: s.body.surface.radius, scene, radius)
        run = rk.ensemble(wider, starts, [0.0, 0.1], method=method)
        assert run.method == ("native" if method == "auto" else "diffrax")
        return run.state.angular_velocity[1, -1, 0], run.position[1, -1, 0]

    def alone(radius):
        wider = eqx.tree_at(lambda s: s.body.surface.radius, scene, radius)
        run = rk.simulate(wider, member(starts, 1), [0.0, 0.1])
        return run.state.angular_velocity[-1, 0], run.position[-1, 0]

    radius = jnp.asarray(0.25)
    moved = [jax.jvp(f, (radius,), (jnp.ones(()),))[1] for f in (end, alone)]
    np.testing.assert_allclose(*moved, rtol=1e-11)


@pytest.mark.slow
def test_runs_with_modes_are_native_each_by_itself():
    """A ball that may bounce is where simulate has it, in as many steps.

    To rounding: an ensemble's program is for many lanes, simulate's for one, and the
    compiler contracts products and sums in each as it likes (without that they are
    equal bit by bit). Thirty steps of twelve stages with ten roundings each:
    3,600 x 2.2e-16 of 1.5 m/s, at most.
    """
    scene = rk.Scene(rk.Body(2.0, 0.008 * np.eye(3), rk.Sphere(0.1)))
    thrown = lambda height: rk.release(
        *(scene, [1.0, 0.0, 0.0, 0.0], [0.0, 5.0, 0.0]),
        *(jnp.stack([0.0 * height, 0.0 * height, height]), [0.2, 0.0, 0.0]),
    )
    modes = rk.Modes(friction=0.1, restitution=0.5)
    heights = jnp.linspace(0.12, 0.2, 5)
    times = [0.0, 0.3]
    how = {"modes": modes, "observe": energy, "keep_states": True, "block": 2}
    runs = rk.ensemble(scene, jax.vmap(thrown)(heights), times, **how)
    assert (runs.method, runs.why) == ("native", "")
    for i, height in enumerate(heights):
        one = rk.simulate(scene, thrown(height), times, modes=modes)
        assert one.switches.count > 0
        assert runs.steps[i] == one.steps <= 30
        np.testing.assert_allclose(
            *(runs.state.parts.velocity[i], one.state.parts.velocity),
            **{"rtol": 0.0, "atol": 1.2e-12},
        )
        if i in (0, 4):
            # contact_on_base is NaN in flight, in both
            shows_what_members_show(runs, {i: one}, ("position", "mode"))
            np.testing.assert_allclose(runs.observed[i], one.energy, rtol=1e-13)


def test_modes_of_members_each_its_own():
    """Thrown along a lane, a ball that slips by mu v / g rolls at 5/7 of its speed.

    Members do what single runs do: with one program for many lanes and one for one, to
    some 60 steps of twelve stages with ten roundings each, 7200 x 2.2e-16 of 73 rad/s.
    """
    body = rk.Body(2.0, 0.008 * np.eye(3), rk.Sphere(0.1))
    slips = rk.Scene(body, contact=rk.Slipping(rk.CoulombFriction(0.2)))
    upright, still = (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    start = rk.place(slips, upright, still, still, velocity=(8.0, 0.0, 0.0))
    friction, times = jnp.array([0.05, 0.2, -0.2, 0.3]), [0.0, 1.0, 2.0]
    choose = lambda mu: rk.Modes(friction=mu)
    modes, how = jax.vmap(choose)(friction), {"rtol": 1e-9, "observe": energy}
    made = lambda i: eqx.tree_at(
        lambda s: s.body.mass, slips, 2.0 + 0.0 * i.astype(float)
    )
    runs = rk.ensemble(slips, start, times, modes=modes, keep_states=True, **how)
    again = rk.ensemble(made, start, times, modes=modes, keep_states=True, **how)
    assert runs.method == "native"
    # a member that cannot be fails alone, and its field is named
    assert runs.code.tolist() == again.code.tolist() == [0, 0, rk.Code.BAD_SCENE, 0]
    assert any("scene.modes.friction" in reason for reason in runs.reasons)
    lost = 9.81 * 2.0 * np.asarray(friction)
    np.testing.assert_allclose(
        runs.velocity[[0, 1, 3], -1, 0],
        [8.0 - lost[0], 40.0 / 7.0, 40.0 / 7.0],
        rtol=1e-7,  # sixty steps of rtol
    )
    for i in (0, 1, 3):
        one = rk.simulate(slips, start, times, modes=choose(friction[i]), rtol=1e-9)
        for other in (runs, again):
            beside, alone = other.state.parts, one.state.parts.angular_velocity
            np.testing.assert_allclose(
                beside.angular_velocity[i], alone, rtol=0.0, atol=1.2e-10
            )
            np.testing.assert_allclose(other.observed[i], one.energy, rtol=1.6e-12)
    starts = jax.tree.map(lambda x: jnp.stack([x] * 3), start)
    with pytest.raises(rk.FieldError, match="several counts"):
        rk.ensemble(slips, starts, times, modes=modes)
    slope = jax.grad(
        lambda mu: rk.ensemble(
            slips, start, times, modes=jax.vmap(choose)(mu), rtol=1e-9
        ).final_state.parts.slip[0, 0]
    )(friction[:2])
    # slip falls by (1 + 5/2) mu g, a constant, which any steps follow to the roundings
    # above, of the pulled-back 70 m/s; another member has no part in it
    np.testing.assert_allclose(slope, [-3.5 * 9.81 * 2.0, 0.0], rtol=0.0, atol=1.2e-10)


def test_the_scene_of_a_run_with_modes_is_one_of_a_contact_that_stays():
    """Where none are given, as ``simulate`` has it: it rolls, and does not slip."""
    body = rk.Body(1.0, 0.004 * np.eye(3), rk.Sphere(0.1))
    scene = rk.Scene(body, loads=rk.Gravity((4.0, 0.0, -9.0)))
    start = rk.place(scene, (1.0, 0.0, 0.0, 0.0), np.zeros(3), np.zeros(3))
    slips = rk.simulate(scene, start, [0.0, 0.1], modes=rk.Modes(friction=0.05))
    assert slips.final_state.mode == rk.Mode.SLIPPING
    rolls = rk.simulate(scene, start, [0.0, 0.1]).position[-1]
    starts = jax.tree.map(lambda x: jnp.stack([x] * 2), start)
    for known in (slips.scene, [slips.scene] * 2, lambda i: slips.scene):
        runs = rk.ensemble(known, starts, [0.0, 0.1])
        # one program for one motion and one for many: roundings of ten steps
        np.testing.assert_allclose(runs.position[:, -1], [rolls] * 2, atol=1e-14)


def test_what_the_native_loop_has_not_goes_by_diffrax():
    """And says why, or refuses where the loop was asked for."""
    scene, starts = discs(2)
    run = rk.ensemble(scene, starts, [0.0, 0.02], solver=dfx.Kvaerno5())
    assert run.method == "diffrax"
    assert "Kvaerno5 is none of Bosh3" in run.why
    with pytest.raises(rk.FieldError, match="Kvaerno5 is none of Bosh3"):
        rk.ensemble(scene, starts, TIMES, solver=dfx.Kvaerno5(), method="native")


REFUSED = {
    "no members": (
        lambda s, x: rk.ensemble(s, member(x, 0), TIMES),
        "ensemble.starts: has no axis of members",
    ),
    "counts": (
        lambda s, x: rk.ensemble(s, x, TIMES, count=4),
        r"has members of several counts, got \[3, 4\]",
    ),
    "method": (
        lambda s, x: rk.ensemble(s, x, TIMES, method="fast"),
        "ensemble.method: is not known, got 'fast'; use one of",
    ),
    "times": (
        lambda s, x: rk.ensemble(s, x, [0.0, 1.0, 0.5]),
        "simulate.times: must be finite and strictly",
    ),
    "another scene's starts": (
        lambda s, x: rk.ensemble(rk.Scene(s.body, rk.Base(rk.Sphere(1.0))), x, TIMES),
        "simulate.start.contact_on_base",
    ),
    "no start": (
        lambda s, x: rk.ensemble(s, x.orientation, TIMES),
        "ensemble.starts: is no State",
    ),
    "a shape": (
        lambda s, x: rk.ensemble(s, jax.tree.map(lambda y: y[None], x), TIMES),
        r"ensemble.starts.orientation: must have 1 axes, or one more",
    ),
    "block": (
        lambda s, x: rk.ensemble(s, x, TIMES, block=0),
        "ensemble.block: must be a whole number of at least 1, got 0",
    ),
    "a tolerance in words": (
        lambda s, x: rk.simulate(s, member(x, 0), TIMES, method="native", rtol="small"),
        "simulate.rtol: must be a positive number, got 'small'",
    ),
    "a solver that keeps": (
        lambda s, x: rk.ensemble(
            s,
            x,
            TIMES,
            method="native",
            solver=rk.keeping_energy(s, member(x, 0), dfx.Tsit5()),
        ),
        "KeepingEnergy is none of Bosh3",
    ),
    "an option of simulate": (
        lambda s, x: rk.simulate(
            s, member(x, 0), TIMES, method="native", adjoint=dfx.ForwardMode()
        ),
        "simulate.adjoint: cannot be chosen with method",
    ),
    "a solver of simulate": (
        lambda s, x: rk.simulate(
            s, member(x, 0), TIMES, method="native", solver=dfx.Kvaerno5()
        ),
        "cannot do this: Kvaerno5 is none of Bosh3",
    ),
}


@pytest.mark.parametrize("case", REFUSED.values(), ids=REFUSED)
def test_bad_input_is_refused(case):
    run, message = case
    scene, starts = discs(3)
    with pytest.raises(rk.FieldError, match=message):
        run(scene, starts)


def test_traced_arguments_do_not_stream():
    scene, starts = discs(2)

    @jax.jit
    def stream(starts):
        return list(rk.ensemble_blocks(scene, starts, TIMES))

    with pytest.raises(rk.FieldError, match="cannot stream"):
        stream(starts)


def test_the_loop_is_compiled_once_for_its_kind():
    """Other numbers, other starts, other counts: nothing new; another solver: one."""
    from rollkane.simulation.lane_blocks import _compiled

    scene, starts = discs(5)
    run = lambda s, x, **how: rk.ensemble(s, x, [0.0, 0.01], method="native", **how)
    run(scene, starts, rtol=1e-7)
    known = _compiled.cache_info().misses
    wider = eqx.tree_at(lambda s: s.body.surface.radius, scene, jnp.asarray(0.3))
    run(wider, member(starts, slice(0, 3)), rtol=1e-10)
    run(scene, starts, max_steps=7, block=2)
    assert _compiled.cache_info().misses == known
    run(scene, starts, solver=dfx.Bosh3(), rtol=1e-4)
    assert _compiled.cache_info().misses == known + 1
