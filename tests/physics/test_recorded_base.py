"""A ball on a plate that a record shakes: what follows from the record, exactly.

The centre of a ball on a plate that moves without turning has a part of the plate's
acceleration, I / (I + m r^2), whatever that is.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk

MASS, RADIUS = 1.0, 0.1
INERTIA = 0.4 * MASS * RADIUS**2
PART = INERTIA / (INERTIA + MASS * RADIUS**2)
STEP = 0.05
CLOCK = STEP * np.arange(21) - 0.1
SHAKEN = np.random.default_rng(0).standard_normal((21, 3)) * [3.0, 3.0, 0.0]
TIMES = np.array([0.013, 0.31, 0.627])
# of steps at rtol 1e-12 over ways and velocities of about 1, some twenty of them
STEPS = 1e-10


def scene_of(motion):
    body = rk.Body(MASS, INERTIA * np.eye(3), rk.Sphere(RADIUS))
    return rk.Scene(body, rk.Base(rk.Plane(), motion))


def placed(scene):
    upright, zero = (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    return rk.place(scene, upright, zero, zero, time=TIMES[0])


def position(scene, t, state):
    return rk.contact_of(scene, t, state).position


def exact(motion, t=TIMES):
    """Centre [m]: it moves with the plate at first, as it does not turn."""
    first, above = motion.at(jnp.asarray(t[0])), jnp.array([0.0, 0.0, RADIUS])

    def at(now):
        along = first.position + first.velocity * (now - t[0])
        return above + along + PART * (motion.at(now).position - along)

    return jax.vmap(at)(jnp.asarray(t))


MOTION = rk.RecordedMotion(CLOCK, SHAKEN)
SCENE = scene_of(MOTION)


def scaled(factor, made=MOTION):
    samples = made.acceleration * factor
    return eqx.tree_at(lambda m: m.acceleration, made, samples)


def test_sensitivity_to_the_strength_of_a_record():
    """All is linear in it: what is there, less its height, is the derivative."""
    free = rk.Free("base.motion.acceleration", form="scale")
    found = rk.sensitivity(
        *(SCENE, placed(SCENE), TIMES, free, {"place": position}),
        rtol=1e-12,
    )
    by_scale = found.values["place"]["base.motion.acceleration"][..., 0]
    expected = np.asarray(exact(MOTION)) - [0.0, 0.0, RADIUS]
    # a coordinate of the factor's own, of a size of one
    np.testing.assert_allclose(by_scale, expected, atol=STEPS)


def test_gradient_by_the_record():
    """By its samples and by its clock: steps end before its kinks, begin behind them.

    Outputs are on kinks as well, off by their rounding. A stage that took the pieces
    of the other side was 1 % of the derivative by the clock.
    """
    weights, times = jnp.array([1.0, -2.0, 0.0]), np.linspace(0.0, 0.6, 7)
    assert 0 < np.abs(times[3:6] - CLOCK[[8, 10, 12]]).max() < 2e-16
    start = rk.place(SCENE, (1.0, 0.0, 0.0, 0.0), *np.zeros((2, 3)), time=times[0])

    def by_run(motion):
        run = rk.simulate(scene_of(motion), start, times, rtol=1e-12)
        return jnp.dot(run.position[-1], weights)

    by_form = lambda motion: jnp.dot(exact(motion, times)[-1], weights)
    found, expected = (eqx.filter_grad(f)(MOTION) for f in (by_run, by_form))
    for name in ("acceleration", "time", "start_velocity", "start_position"):
        np.testing.assert_allclose(
            getattr(found, name), getattr(expected, name), atol=STEPS
        )


@pytest.mark.parametrize("method", ["auto", "diffrax"])
def test_ensemble_with_a_record_of_its_own_for_each_member(method):
    factors = jnp.array([-1.0, 0.5, 2.0])
    scenes = jax.vmap(lambda factor: scene_of(scaled(factor)))(factors)
    starts = jax.vmap(placed)(scenes)
    run = rk.ensemble(scenes, starts, TIMES, rtol=1e-12, method=method)
    assert run.method == ("native" if method == "auto" else "diffrax")
    for k, factor in enumerate(factors):
        expected = exact(scaled(factor))
        np.testing.assert_allclose(run.position[k], expected, atol=STEPS)


def test_ensemble_with_velocities_of_their_own_on_a_shared_record():
    """What a run makes of a record is each member's own where one of its parts is."""
    velocities = jnp.array([[0.0, 0.0, 0.0], [0.3, -0.2, 0.0]])
    moved = lambda v: eqx.tree_at(lambda m: m.start_velocity, MOTION, v)
    scenes = scene_of(moved(velocities))
    own = jax.tree.map(lambda _: None, SCENE)
    where = lambda s: s.base.motion.start_velocity
    own = eqx.tree_at(where, own, 0, is_leaf=lambda x: x is None)
    starts = jax.vmap(placed, (own,))(scenes)
    run = rk.ensemble(scenes, starts, TIMES, rtol=1e-12)
    assert run.method == "native"
    for k, v in enumerate(velocities):
        np.testing.assert_allclose(run.position[k], exact(moved(v)), atol=STEPS)


def test_a_record_that_begins_at_zero_runs_natively():
    """Of more samples than are chosen from, and of so few that zeros are looked for."""
    time = STEP * np.arange(40)
    motion = rk.RecordedMotion(time, np.cos(time))
    scene = scene_of(motion)
    start = rk.place(scene, (1.0, 0.0, 0.0, 0.0), *np.zeros((2, 3)))
    times = np.array([0.0, 0.5])
    run = rk.simulate(scene, start, times, rtol=1e-12, method="native")
    assert run.method == "native"
    np.testing.assert_allclose(run.position, exact(motion, times), atol=STEPS)


# -- shaken until it hops --------------------------------------------------------------

HOPS = np.linspace(0.0, 0.5, 11)
MODES = rk.Modes(friction=0.3, restitution=0.4)


def hopping(size):
    """A ball on a plate whose record has up to 1.5 g downwards, and its start."""
    t = 0.01 * np.arange(61)
    shaken = np.stack([3 * np.sin(7 * t), 2 * np.cos(5 * t), 15 * np.sin(20 * t)], 1)
    scene = scene_of(rk.RecordedMotion(t, size * shaken))
    return scene, rk.place(scene, (1.0, 0.0, 0.0, 0.0), (0.0, 3.0, 0.0), (0.0,) * 3)


def test_a_ball_hops_on_a_record_natively():
    scene, start = hopping(1.0)
    run = rk.simulate(scene, start, HOPS, modes=MODES)
    assert run.method == "native"
    assert run.succeeded
    # it leaves where the plate falls by g, between two samples of the linear record
    after = np.asarray(run.switches.after)
    lifts = run.switches.time[np.argmax(after == rk.Mode.FLYING)]
    falls = np.interp(lifts, 0.01 * np.arange(61), 15 * np.sin(0.2 * np.arange(61)))
    # by jerks of 300 m/s^3, to the 1e-12 s that events are found within
    gravity = scene.loads[0].acceleration[2]
    np.testing.assert_allclose(falls, gravity, rtol=0, atol=1e-9)


@pytest.mark.slow
def test_hops_by_diffrax_are_the_same():
    scene, start = hopping(1.0)
    run = rk.simulate(scene, start, HOPS, modes=MODES)
    other = rk.simulate(scene, start, HOPS, modes=MODES, method="diffrax")
    assert int(run.switches.count) == int(other.switches.count)
    # the same steps to rounding, and a few impacts
    np.testing.assert_allclose(run.position, other.position, rtol=0, atol=1e-11)


def test_members_of_an_ensemble_hop_on_records_of_their_own():
    each = [hopping(size) for size in (0.5, 0.9, 1.0, 1.1)]
    scenes, starts = zip(*each, strict=True)
    runs = rk.ensemble(list(scenes), list(starts), HOPS, modes=MODES)
    assert runs.method == "native"
    for (scene, start), found in zip(each, runs.position, strict=True):
        alone = rk.simulate(scene, start, HOPS, modes=MODES)
        assert alone.succeeded
        np.testing.assert_allclose(found, alone.position, rtol=0, atol=1e-11)
