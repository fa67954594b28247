"""Observables of states in modes: derivatives are of their own mode alone."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk
from rollkane.dynamics import observables
from rollkane.hybrid.by_mode import by_mode, moved_where
from rollkane.hybrid.modes import HybridScene, ModedState, of

UP, STILL = (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
SURFACE = rk.Sphere(0.1)
BALL = rk.Body(1.0, 0.004 * np.eye(3), SURFACE)
ODD = rk.Body(1.0, np.diag([0.004, 0.0045, 0.005]), SURFACE, (0.01, 0.0, -0.02))
NAMES = "slip", "contact_on_body", "normal_force", "friction_ratio", "power"
# compiled in a fifth of the time
QUICKLY = {"xla_backend_optimization_level": 0}
# What a run keeps of the slip's direction: of one that rolls and never slipped, or has
# slipped, that only begins, that slips, that flies from rolling and from slipping
STATES = (
    (rk.Mode.ROLLING, (0.0, 0.0, 0.0)),
    (rk.Mode.ROLLING, (0.6, 0.8, 0.0)),
    (rk.Mode.SLIPPING, (0.3, 0.4, 0.0)),
    (rk.Mode.SLIPPING, (0.6, 0.8, 0.0)),
    (rk.Mode.FLYING, (0.0, 0.0, 0.0)),
    (rk.Mode.FLYING, (0.6, 0.8, 0.0)),
)


def everything(scene, t, state):
    """Observables, those that are not there as zeros: cotangents of zero."""
    found = [getattr(observables, name)(scene, t, state) for name in NAMES]
    flat = jnp.concatenate([jnp.ravel(x) for x in found])
    return jnp.where(jnp.isnan(flat), 0.0, flat)


def seen(x, body):
    """Everything of all states, by what they depend on, shape (states, numbers)."""
    pull, turning, friction = x
    spin = jnp.stack([0.5, turning, 0.2])
    scene = rk.Scene(body, loads=(rk.Gravity(jnp.stack([pull, 0.2, -9.81 + pull])),))
    rolls = of(rk.place(scene, UP, spin, STILL))
    flies = of(rk.release(scene, UP, spin, (0.0, 0.0, 0.3), (1.0, 0.0, 0.0)))
    slip = turning * jnp.array([0.06, 0.08, 0.0])
    slips = eqx.tree_at(lambda y: y.slip, rolls, slip)
    parts = rolls, rolls, rolls, slips, flies, flies
    state = ModedState(
        jax.tree.map(lambda *y: jnp.stack(y), *parts),
        jnp.array([mode for mode, _ in STATES]),
        jnp.array([direction for _, direction in STATES]),
    )
    changing = HybridScene(scene, rk.Modes(friction, restitution=0.3))
    look = lambda state: by_mode(everything)(changing, jnp.asarray(0.0), state)
    return jax.vmap(look)(state)


def test_reverse_is_forward_is_the_difference():
    """Along one direction, of one sum over all that is seen."""
    rng = np.random.default_rng(0)
    x, dot, h = jnp.array([0.5, 3.0, 0.2]), jnp.array(rng.normal(size=3)), 1e-3
    size = jax.eval_shape(lambda x: seen(x, ODD), x).shape
    weights = jnp.array(rng.normal(size=size))
    total = lambda x: jnp.sum(weights * seen(x, ODD))
    every = lambda x: (*jax.jvp(total, (x,), (dot,)), jax.grad(total)(x))
    every = jax.jit(every, compiler_options=QUICKLY)
    _, forward, gradient = every(x)
    # the same numbers in another order: some 100 roundings of terms of up to 1e2
    np.testing.assert_allclose(gradient @ dot, forward, rtol=0, atol=1e-11)
    at = lambda k: every(x + k * h * dot)[0]
    first, second = ((at(k) - at(-k)) / (2.0 * k * h) for k in (1.0, 2.0))
    # Richardson leaves 4 h^4 / 5! of fifth derivatives, which are 1e3 or less, and
    # roundings of 1e3 over h: 1e-10
    np.testing.assert_allclose((4 * first - second) / 3, forward, rtol=0, atol=1e-8)


def test_what_a_level_ball_presses_moves_where_nothing_slips():
    """Its friction is nothing, and the slip that could begin has no direction."""
    y = of(rk.place(rk.Scene(BALL), UP, (0.0, 3.0, 0.0), STILL))
    state = ModedState(y, jnp.asarray(int(rk.Mode.ROLLING)), jnp.zeros(3))
    names = "normal_force", "friction_ratio", "power"

    def shown(g):
        scene = HybridScene(rk.Scene(BALL, loads=(rk.Gravity(g),)), rk.Modes(0.2))
        # a number that the observable closes over moves what it shows, too
        scaled = lambda *at: jnp.stack(
            [getattr(observables, name)(*at) * (1.0 - g[2]) for name in names]
        )
        return jnp.sum(by_mode(scaled)(scene, jnp.asarray(0.0), state))

    gradient = jax.jit(jax.grad(shown), compiler_options=QUICKLY)
    found = gradient(jnp.array([0.0, 0.0, -9.81]))
    # N = -m g_z, times 1 - g_z: less 1 and 2 * 9.81; of |T| / N none at T = 0
    np.testing.assert_allclose(found, [0.0, 0.0, -1.0 - 2 * 9.81], atol=1e-14)


@pytest.mark.parametrize("mapped", [False, True])
def test_what_comes_back_to_another_place_is_zero(mapped):
    """Even where it is not a number."""
    own = jnp.array([True, False])

    def f(x, factor):
        return jnp.where(own, moved_where(own, x) * factor, 1.0)

    shown = (lambda x, a: jax.vmap(f)(x[None], a[None])) if mapped else f
    x, factor = jnp.array([2.0, 3.0]), jnp.array([4.0, jnp.nan])
    _, pull = jax.vjp(lambda x: jnp.ravel(shown(x, factor)), x)
    np.testing.assert_array_equal(pull(jnp.ones(2))[0], [4.0, 0.0])
    _, dot = jax.jvp(lambda x: jnp.ravel(shown(x, factor)), (x,), (jnp.ones(2),))
    np.testing.assert_array_equal(dot, [4.0, 0.0])


def test_forces_of_a_run_where_nothing_slips_have_gradients():
    """Through the run, its outputs' program and the vmap over them."""

    def pressed(g):
        scene = rk.Scene(BALL, loads=(rk.Gravity(g),))
        start = rk.place(scene, UP, (0.0, 3.0, 0.0), STILL)
        run = rk.simulate(scene, start, (0.0, 0.1), modes=rk.Modes(0.2))
        return jnp.sum(run.normal_force)

    found = jax.grad(pressed)(jnp.array([0.0, 0.0, -9.81]))
    # N = -m g_z at both outputs, whatever the run
    np.testing.assert_allclose(found, [0.0, 0.0, -2.0], atol=1e-12)


@pytest.mark.slow
def test_a_record_s_samples_have_reverse_derivatives_in_flight():
    """More numbers than each state could have a copy of; what slips would be NaN."""
    time = np.linspace(0.0, 1.2, 61)
    samples = np.random.default_rng(7).standard_normal((61, 3))
    body = rk.Body(0.8, np.diag([3e-3, 3.5e-3, 4e-3]), rk.Sphere(0.1), (0.01, 0.0, 0.0))

    def seen(scale):
        motion = rk.RecordedMotion(time, samples * scale)
        scene = rk.Scene(body, rk.Base(motion=motion))
        start = rk.release(
            scene,
            (1.0, 0.0, 0.0, 0.0),
            (1.0, 2.0, 3.0),
            (0.0, 0.0, 0.2),
            (0.5, 0.3, 0.0),
        )
        modes = rk.Modes(friction=0.3, restitution=0.5)
        run = rk.simulate(scene, start, (0.0, 0.1, 0.4), modes=modes)
        found = run.contact_force, run.power, run.switches.time[:1]
        return jnp.concatenate([jnp.ravel(x) for x in found])

    ahead, back = jax.jacfwd(seen)(1.0), jax.jacrev(seen)(1.0)
    assert np.abs(ahead).max() > 1e-3
    # the same steps, followed both ways: roundings of numbers of order ten
    np.testing.assert_allclose(back, ahead, rtol=1e-9, atol=1e-9)
