"""Bodies that never slip, where their contact ends: they leave, or say they cannot."""

import jax
import jax.numpy as jnp
import numpy as np

import rollkane as rk
from rollkane.dynamics.rolling import contact_force

RADIUS, MASS, G = 0.1, 1.0, 9.81


def shaken(t, p):
    wide, phase = p
    up = wide * jnp.sin(20.0 * t + phase)
    return jnp.stack([0.5 * wide * jnp.cos(26.0 * t), 0.0 * t, up])


def scene_of(shake, center, contact=None):
    body = rk.Body(MASS, np.diag([0.003, 0.004, 0.005]), rk.Sphere(RADIUS), center)
    base = rk.Base(rk.Plane(), rk.BaseMotion(shaken, parameters=shake))
    return rk.Scene(body, base, contact=contact)


def toss(seed, center):
    """A random release over a shaken plate, and its run."""
    r = np.random.default_rng(seed)
    q = r.normal(size=4)
    shake = r.uniform([0.005, 0.0], [0.08, 6.28])
    spin, height, velocity = (
        r.normal(size=3) * 3.0,
        r.uniform(0.2, 0.45),
        r.normal(size=3),
    )
    e = r.choice([0.0, 0.25])
    return _run(q / np.linalg.norm(q), shake, spin, height, velocity, e, center)


@jax.jit
def _run(q, shake, spin, height, velocity, restitution, center):
    scene = scene_of(shake, center)
    place = jnp.stack([0.05, 0.03, height])
    start = rk.release(scene, q, spin, place, 0.4 * velocity)
    modes = rk.Modes(restitution=restitution)
    times = np.linspace(0.0, 0.5, 4)
    return rk.simulate(scene, start, times, modes=modes, rtol=1e-10), shake


def test_they_leave_or_say_that_they_cannot():
    """Held along the base as its normal force vanishes: let go of, some turn into it.

    They are those which would be pressed if nothing but the normal force held them.
    """
    center = jnp.array([0.004, 0.002, -0.003])
    codes = []
    for seed in range(40):
        run, shake = toss(seed, center)
        codes.append(int(run.code))
        if run.succeeded:
            assert np.isfinite(run.position).all()
            continue
        assert run.code == rk.Code.PAINLEVE
        assert "Modes(friction=)" in run.reason
        last, t = run.final_state, run.final_time
        assert last.mode == rk.Mode.ROLLING
        rolls = contact_force(scene_of(shake, center), t, last.parts.rolling())
        # a root of it, or less where it landed without a rebound (no plate here turns).
        # Roots are found to 1e-12 of what it was; runs jam from 1.5e-8 of it on
        assert rolls[2] < 1e-9 * MASS * G
        free = scene_of(shake, center, rk.Slipping(rk.CoulombFriction(0.0)))
        assert contact_force(free, t, last.parts.sliding())[2] > 1e-9 * MASS * G
    assert set(codes) == {rk.Code.COMPLETED, rk.Code.PAINLEVE}


def test_a_centred_ball_always_leaves():
    """What holds it along the base has the normal as its arm: it turns into nothing."""
    left = 0
    for seed in range(16):
        run, _ = toss(seed, jnp.zeros(3))
        assert run.succeeded
        assert np.isfinite(run.position).all()
        before, after = run.switches.before, run.switches.after
        left += int(((before == rk.Mode.ROLLING) & (after == rk.Mode.FLYING)).sum())
    assert left > 0
