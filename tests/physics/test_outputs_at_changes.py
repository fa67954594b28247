"""Outputs on a change of the contact, or roundings beside it, change nothing."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk

INERTIA = np.diag([0.004, 0.0045, 0.005])
SPAN = 0.8


def shaken(t):
    return jnp.stack([0.0 * t, 0.0 * t, 0.06 * jnp.sin(14.0 * t)])


def scene_of(surface, motion=None):
    body = rk.Body(1.0, INERTIA, surface, (0.002, 0.001, -0.003))
    return rk.Scene(body, rk.Base(rk.Plane(), motion=motion))


def toss(scene, seed, low, high):
    """A random release, and its time."""
    r = np.random.default_rng(seed)
    begin = r.choice([0.0, r.uniform(-5.0, 5.0)])
    q = r.normal(size=4)
    spin, height = r.normal(size=3) * 3.0, r.uniform(low, high)
    at, velocity = (0.0, 0.0, height), r.normal(size=3) * 0.5
    q /= np.linalg.norm(q)
    return rk.release(scene, q, spin, at, velocity, time=begin), begin


def changes(run):
    """When and what, of all that there were."""
    count = int(run.switches.count)
    parts = run.switches.time, run.switches.before, run.switches.after
    return [np.asarray(x)[:count] for x in parts]


@pytest.mark.parametrize(
    ("surface", "motion", "restitution", "heights", "seeds"),
    [
        # of 60 random starts, those whose runs such outputs changed once
        (rk.Sphere(0.1), rk.BaseMotion(shaken), 0.15, (0.17, 0.2), (1, 3, 4, 7)),
        pytest.param(
            *(rk.Torus(0.08, 0.03), None, 0.5, (0.15, 0.45), (0,)),
            marks=pytest.mark.slow,
        ),
    ],
    ids=["ball-on-shaken-plate", "torus-in-bounces"],
)
def test_outputs_at_changes_change_nothing(
    surface, motion, restitution, heights, seeds
):
    """Each change of a run, exactly, and from roundings to a microsecond beside it."""
    scene = scene_of(surface, motion)
    modes = rk.Modes(friction=0.2, restitution=restitution)
    beside = -1e-14, -3e-15, 3e-15, 1e-14, 3e-14, 1e-13, 3e-13, 1e-12, 1e-9, 1e-6
    for seed in seeds:
        start, begin = toss(scene, seed, *heights)
        end = begin + SPAN
        run = lambda times, start=start: rk.simulate(
            scene, start, times, modes=modes, rtol=1e-10
        )
        plain = run(np.linspace(begin, end, 9))
        assert plain.succeeded
        when, *what = changes(plain)
        for moment in when[:9]:
            for offset in (0.0, *beside):
                at = moment + offset
                first = np.linspace(begin, at, 3)
                found = run(np.append(first, np.linspace(at, end, 7)[1:]))
                assert found.succeeded, (seed, moment, offset, found.reason)
                then, *other = changes(found)
                np.testing.assert_array_equal(other, what, err_msg=f"{seed}, {offset}")
                # steps at rtol 1e-10 end elsewhere, which bounces and lift-offs that
                # come slowly make more of: 4e-10 s and 1e-8 m at most in 2,000 runs
                np.testing.assert_allclose(then, when, rtol=0.0, atol=4e-9)
                ends = found.position[-1], plain.position[-1]
                np.testing.assert_allclose(*ends, rtol=0.0, atol=1e-7)


def up_from(t, point):
    """More than a weight of 9.81 N, from 0.5 s on."""
    del point
    return jnp.stack([0.0 * t, 0.0 * t, jnp.where(t >= 0.5, 20.0, 0.0)])


@pytest.mark.parametrize("first", [0.0, 0.5])
def test_an_output_at_a_lift_off_shows_the_contact(first):
    """With the force that would pull, 9.81 - 20 N, also where it is the first."""
    body = rk.Body(1.0, INERTIA, rk.Sphere(0.1))
    scene = rk.Scene(body, loads=(rk.Gravity(), rk.Force(up_from)), kinks=[0.5])
    still = (0.0, 0.0, 0.0)
    start = rk.place(scene, (1.0, 0.0, 0.0, 0.0), still, still)
    times = np.unique([first, 0.5, 0.75])
    run = rk.simulate(scene, start, times, modes=rk.Modes(friction=0.5))
    assert run.mode[-2] == rk.Mode.ROLLING
    # a sum of two terms, of 20 at most
    np.testing.assert_allclose(run.normal_force[-2], 9.81 - 20.0, atol=1e-13)
    assert run.mode[-1] == rk.Mode.FLYING
    np.testing.assert_allclose(run.switches.time[0], 0.5, atol=1e-12)
    assert "shows the state before" in " ".join(rk.Modes.__doc__.split())


def test_outputs_at_changes_change_no_derivative():
    """By the mass: a flight lands on an output, a slip lifts off before one."""
    motion = rk.BaseMotion(shaken)
    modes = rk.Modes(friction=0.2, restitution=0.15)

    def end(mass, start, times):
        body = rk.Body(mass, INERTIA, rk.Sphere(0.1), (0.002, 0.001, -0.003))
        scene = rk.Scene(body, rk.Base(rk.Plane(), motion=motion))
        run = rk.simulate(scene, start, times, modes=modes, rtol=1e-10)
        return run.position[-1], run.switches.time

    slope = jax.jit(
        lambda start, times: jax.jvp(lambda m: end(m, start, times), (1.0,), (1.0,))
    )
    for seed in (1, 7):
        start, begin = toss(scene_of(rk.Sphere(0.1), motion), seed, 0.17, 0.2)
        last = begin + SPAN
        (_, when), (plain, later) = slope(start, np.linspace(begin, last, 9))
        when = np.asarray(when)
        for moment in when[np.isfinite(when)][:9]:
            for offset in (0.0, -1e-14, 3e-15, 1e-12, 1e-9, 1e-7):
                at = moment + offset
                first = np.linspace(begin, at, 3)
                times = np.append(first, np.linspace(at, last, 7)[1:])
                _, (found, moved) = slope(start, times)
                # steps at rtol 1e-10, of tangents that lift-offs make more of: 5e-9
                # at most, of 7 starts; 1e-7 to 80 where they were wrong. Of times
                # of changes 1.3e-10; 1e-5 where that was
                np.testing.assert_allclose(found, plain, rtol=0.0, atol=3e-8)
                np.testing.assert_allclose(moved, later, rtol=0.0, atol=3e-8)
