"""A motion is the same to the last bit, whatever others it is computed with."""

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk

from .. import problems

SCALES = np.linspace(0.9, 1.1, 11)
TIMES = np.array([0.0, 0.3, 0.5])


def run(problem, scale, mass, solver, events=()):
    scene, start = problem
    scene = eqx.tree_at(lambda s: s.body.mass, scene, scene.body.mass * mass)
    spun = start.angular_velocity * scale
    start = eqx.tree_at(lambda s: s.angular_velocity, start, spun)
    how = {"solver": solver, "rtol": 1e-7}
    return rk.simulate(scene, start, TIMES, events=events, **how)


def told(made):
    return made.state, made.final_state, made.code, made.steps, made.rejected_steps


def assert_same(some, others):
    for a, b in zip(*map(jax.tree.leaves, (some, others)), strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("name", ["disc", "rattleback"])
@pytest.mark.parametrize("solver", [dfx.Dopri5(), dfx.Dopri8()])
def test_alone_and_in_a_batch(name, solver):
    # a mass that is shared, or each lane's own, is another program
    problem = problems.disc(6.0) if name == "disc" else problems.rattleback()
    one = lambda scale, mass: told(run(problem, scale, mass, solver))
    masses = jnp.asarray(2.0 - SCALES)
    alone = [jax.jit(one)(*x) for x in zip(jnp.asarray(SCALES), masses, strict=True)]
    batch = jax.jit(jax.vmap(one))(jnp.asarray(SCALES), masses)
    assert_same(jax.tree.map(lambda *x: np.stack(x), *alone), batch)


@pytest.mark.parametrize("name", ["ball in a bowl", "rattleback"])
def test_of_a_scene_that_is_known_or_not(name):
    # what is multiplied by a known zero is left out of the program
    if name == "rattleback":
        scene, start = problems.rattleback()
    else:
        body = rk.Body(1.0, np.diag([4e-3, 5e-3, 6e-3]), rk.Sphere(0.1), (0, 0, 0.02))
        scene = rk.Scene(body, rk.Base(rk.Sphere(1.0, inside=True)))
        turned = (0.8, 0.6, 0.0, 0.0)
        start = rk.place(scene, turned, (1.0, 2.0, -3.0), (0.36, 0.48, -0.8))
    one = lambda scene, start: told(rk.simulate(scene, start, TIMES))
    known = one(scene, start)
    assert_same(known, jax.jit(one)(scene, start))
    three = jax.tree.map(lambda x: jnp.stack([x] * 3), (scene, start))
    every = rk.ensemble(*three, TIMES, scene_axes=0)
    assert_same(jax.tree.map(lambda x: np.stack([x] * 3), known), told(every))


def test_with_events():
    problem = problems.disc(6.0)
    turned = rk.Event(lambda scene, t, state: state.angular_velocity[0], name="turned")

    def one(scale):
        made = run(problem, scale, 1.0, dfx.Dopri5(), [turned])
        return told(made), made.event_record.time, made.event_record.number

    alone = [jax.jit(one)(x) for x in jnp.asarray(SCALES)]
    batch = jax.jit(jax.vmap(one))(jnp.asarray(SCALES))
    assert np.sum(batch[2]) > 0
    assert_same(jax.tree.map(lambda *x: np.stack(x), *alone), batch)


def test_derivatives():
    problem = problems.disc(6.0)

    def end(scale, mass):
        made = run(problem, scale, mass, dfx.Dopri5())
        return jnp.sum(made.final_state.angular_velocity)

    # forwards one motion's tangents go in lanes, backwards many motions
    for one in (jax.grad(end, (0, 1)), jax.jacfwd(end, (0, 1))):
        alone = [jax.jit(one)(scale, 1.1) for scale in jnp.asarray(SCALES)]
        batch = jax.jit(jax.vmap(one, (0, None)))(jnp.asarray(SCALES), 1.1)
        assert_same(jax.tree.map(lambda *x: np.stack(x), *alone), batch)


def test_an_ensemble_in_blocks():
    scene, start = problems.rattleback()
    spun = lambda scale: eqx.tree_at(
        lambda s: s.angular_velocity, start, start.angular_velocity * scale
    )
    starts = jax.vmap(spun)(jnp.asarray(SCALES))
    whole = rk.ensemble(scene, starts, TIMES)
    parts = rk.ensemble(scene, starts, TIMES, block=3)
    alone = [rk.simulate(scene, spun(scale), TIMES) for scale in SCALES]
    assert_same(told(whole), told(parts))
    assert_same(told(whole), jax.tree.map(lambda *x: np.stack(x), *map(told, alone)))
