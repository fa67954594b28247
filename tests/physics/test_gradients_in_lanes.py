"""Gradients of a batch go back in lanes, each along the steps of its own motion."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk
from rollkane.codegen import derivative_loops

from .. import problems

STONE, START = problems.rattleback()
TIMES = jnp.array([0.0, 0.3, np.nextafter(0.3, 1.0), 0.7, 1.0])  # two are one stop
COUNT = 19  # more than a row, and no multiple of one
# Some 300 steps back, each of some 1,000 roundings of 1e-16 of its numbers, in another
# order than of one motion: by the root of their number, grown tenfold by the way
CLOSE = 1e-16 * np.sqrt(300 * 1000) * 10 * 10


def looked(mass, spin, scene=STONE, times=TIMES):
    """A number of all outputs, of motions of which no two take the same steps."""
    changed = eqx.tree_at(lambda s: s.body.mass, scene, mass)
    spun = START.angular_velocity + spin * jnp.array([0.0, 0.1, 1.0])
    start = eqx.tree_at(lambda s: s.angular_velocity, START, spun)
    run = rk.simulate(changed, start, times, rtol=1e-8)
    end = run.final_state.angular_velocity
    return jnp.sum(run.state.orientation[1:] ** 3) + jnp.sum(end * end)


def same(many, alone):
    many, alone = map(np.asarray, (many, alone))
    assert np.all(np.abs(alone) > 0.0)
    np.testing.assert_allclose(many, alone, rtol=0, atol=CLOSE * np.max(np.abs(alone)))


def counted(monkeypatch):
    """Leaves of their own, of each loop over several lanes."""
    made, compiled = [], derivative_loops.CotangentLoop._compiled

    def counting(self, own, lanes):
        made.extend([own] if lanes > 1 else [])
        return compiled(self, own, lanes)

    monkeypatch.setattr(derivative_loops.CotangentLoop, "_compiled", counting)
    return made


def test_members_go_back_along_their_own_steps(monkeypatch):
    made = counted(monkeypatch)
    spins = jnp.linspace(-3.0, 5.0, COUNT)
    masses = STONE.body.mass * jnp.linspace(0.8, 1.2, COUNT)
    slope = jax.grad(looked, (0, 1))
    one = jax.jit(slope)
    shared = jax.jit(jax.vmap(slope, (None, 0)))(STONE.body.mass, spins)
    own = jax.jit(jax.vmap(slope))(masses, spins)
    alone = (
        [one(STONE.body.mass, spin) for spin in spins],
        list(map(one, masses, spins)),
    )
    for many, each in zip((shared, own), alone, strict=True):
        for k in range(2):
            same(many[k], [one[k] for one in each])
    assert made  # in lanes


@pytest.mark.slow
def test_batches_of_batches():
    masses, spins = jnp.array([0.9, 1.1, 1.3]), jnp.linspace(1.0, 2.0, 5)
    slope = jax.grad(looked, 1)
    grid = jax.jit(jax.vmap(jax.vmap(slope, (None, 0)), (0, None)))(masses, spins)
    turned = jax.jit(jax.vmap(jax.vmap(slope, (0, None)), (None, 0)))(masses, spins)
    alone = np.array([[jax.jit(slope)(m, s) for s in spins] for m in masses])
    same(grid, alone)
    same(turned, alone.T)


@pytest.mark.slow
def test_outputs_that_are_not_reached_and_motions_that_jump():
    def moved(spin, until, most):
        jumps = rk.BaseMotion(
            lambda t: 0.01 * jnp.sin(9.0 * t) * jnp.array([1.0, 0, 0])
        )
        base = rk.Base(rk.Plane(), jumps)
        scene = rk.Scene(STONE.body, base)
        times = jnp.array([0.0, 0.2, 1.0]) * until
        start = eqx.tree_at(
            lambda s: s.angular_velocity, START, jnp.array([0.0, 0.1, 1.0]) * spin
        )
        run = rk.simulate(scene, start, times, rtol=1e-8, max_steps=most)
        return jnp.sum(run.state.orientation[1] ** 3)

    for most in (4096, 60):  # with 60 no motion reaches its end, some its first output
        slope = jax.jit(jax.grad(lambda s, t, most=most: moved(s, t, most), (0, 1)))
        spins, ends = jnp.linspace(0.5, 3.0, COUNT), jnp.linspace(0.5, 1.5, COUNT)
        many = jax.jit(jax.vmap(slope))(spins, ends)
        alone = [slope(*pair) for pair in zip(spins, ends, strict=True)]
        for k in range(2):
            each = np.array([one[k] for one in alone])
            np.testing.assert_array_equal(np.isnan(many[k]), np.isnan(each))
            size = np.nanmax(np.abs(each), initial=1.0)
            np.testing.assert_allclose(many[k], each, rtol=0, atol=CLOSE * size)
