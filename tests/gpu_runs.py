"""Runs that a GPU makes natively, and what a processor is to give for the same."""

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import rollkane as rk

from . import problems

TIMES = np.array([0.0, 0.1, 0.25, 0.3])
SCALES = np.linspace(0.9, 1.1, 40)
# Of what XLA computes outside of runs, as records' slopes and starts, which it rounds
# otherwise on a GPU: a hundred roundings of 1e-16 of numbers up to 31, which motions of
# some tens of steps make ten times as much of, 3e-12; and three times that.
ROUNDING = 1e-11


def _problem():
    """A scene and a start that are the same numbers whatever device is the default."""
    (cpu, *_) = jax.devices("cpu")
    with jax.default_device(cpu), jax.ensure_compile_time_eval():
        return problems.disc(6.0)


def _disc(scale, mass=None, times=TIMES, **how):
    scene, start = _problem()
    if mass is not None:
        scene = eqx.tree_at(lambda s: s.body.mass, scene, mass)
    spun = start.angular_velocity * scale
    start = eqx.tree_at(lambda s: s.angular_velocity, start, spun)
    return rk.simulate(scene, start, times, **how)


def _told(run):
    return run.state.angular_velocity, run.final_state.contact, run.code, run.steps


def disc(scale):
    """Outputs on the way."""
    return _told(_disc(scale))


def backwards(scale):
    """In time."""
    return _told(_disc(scale, times=np.array([0.3, 0.2, 0.0]), solver=dfx.Tsit5()))


def few_steps(scale):
    """More than are allowed; where they lead to depends on their lengths."""
    run = _disc(scale, max_steps=3)
    return run.code, run.steps, run.rejected_steps


def no_start(scale):
    """A mass that is no number where the scale is above one."""
    return _told(_disc(scale, mass=jnp.where(scale > 1.0, jnp.nan, 0.3)))


def shaken(scale):
    """On a base whose acceleration jumps between outputs."""

    def sway(t, p):
        on = jnp.where(t < 0.1, 0.0, jnp.where(t < 0.17, 1.0, -1.0))
        return jnp.stack([p * on * (t - 0.1) ** 2, 0.0 * t, 0.0 * t])

    motion = rk.BaseMotion(sway, parameters=0.5 * scale, kinks=[0.1, 0.17])
    surface = rk.Ellipsoid([0.1, 0.08, 0.06])
    body = rk.Body(1.0, np.diag([1e-3, 1.2e-3, 1.5e-3]), surface)
    scene = rk.Scene(body, rk.Base(motion=motion))
    start = rk.place(scene, [1.0, 0.0, 0.0, 0.0], [0.3, 0.2, 4.0], [0.0] * 3)
    return _told(rk.simulate(scene, start, TIMES))


def recorded(scale):
    """On a base that moves as a record says, looked up in a table."""
    times = np.linspace(0.0, 0.5, 51)
    samples = np.sin(20.0 * times)[:, None] * np.array([1.0, 0.5, 0.0])
    motion = rk.RecordedMotion(times, samples * scale)
    body = rk.Body(
        1.0, np.diag([1e-3, 1.2e-3, 1.5e-3]), rk.Ellipsoid([0.1, 0.08, 0.06])
    )
    scene = rk.Scene(body, rk.Base(motion=motion))
    start = rk.place(scene, [1.0, 0.0, 0.0, 0.0], [0.3, 0.2, 4.0], [0.0] * 3)
    return _told(rk.simulate(scene, start, TIMES))


def events(scale):
    """Located, and a stop by one of them."""
    turned = rk.Event(lambda scene, t, state: state.angular_velocity[0], name="turned")
    late = rk.Event(lambda scene, t, state: t - 0.2, stop=True, name="late")
    run = _disc(scale, events=[turned, late])
    record = run.event_record
    return _told(run), record.time, record.number, record.by


# whose runs alone are given the same numbers by every machine
ALIKE = disc, backwards, few_steps, no_start, events
RUNS = *ALIKE, shaken, recorded


def single(scale):
    """In single precision."""
    scene, start = _problem()
    lower = lambda x: x.astype(jnp.float32) if eqx.is_inexact_array(x) else x
    scene, start = jax.tree.map(lower, jax.tree.map(jnp.asarray, (scene, start)))
    spun = start.angular_velocity * scale.astype(jnp.float32)
    start = eqx.tree_at(lambda s: s.angular_velocity, start, spun)
    times = TIMES.astype(np.float32)
    return rk.simulate(scene, start, times).final_state.angular_velocity


def of_mass(scale, mass):
    """What is differentiated."""
    return _disc(scale, mass=mass, max_steps=400).state.angular_velocity


def found(run, scales=SCALES):
    """One run, a batch of them, and a batch of batches, as NumPy arrays."""
    alone = jax.jit(run)(jnp.asarray(scales[0]))
    many = jax.jit(jax.vmap(run))(jnp.asarray(scales))
    nested = jax.jit(jax.vmap(jax.vmap(run)))(jnp.asarray(scales).reshape(4, -1))
    flat = jax.tree.map(lambda x: x.reshape(len(scales), *x.shape[2:]), nested)
    return jax.tree.map(np.asarray, (alone, many, flat))


def derivatives(scales=SCALES):
    """Forwards and backwards, alone and in batches, by the mass and by the scale."""
    one = jnp.asarray(scales[0]), jnp.asarray(0.3)
    many = jnp.asarray(scales), jnp.asarray(0.3)
    made = {}
    for name, slope in (
        ("forwards", jax.jacfwd(of_mass, argnums=(0, 1))),
        ("backwards", jax.grad(lambda *x: jnp.sum(of_mass(*x)[-1]), argnums=(0, 1))),
    ):
        made[name] = jax.jit(slope)(*one)
        made[f"{name}, all"] = jax.jit(jax.vmap(slope, (0, None)))(*many)
    return jax.tree.map(np.asarray, made)


def some():
    """A few of the above, by name."""
    made = {run.__name__: found(run) for run in (disc, events)}
    return made | {"derivatives": derivatives(), "method": str(_disc(1.0).method)}


def everything():
    """All of them."""
    return some() | {run.__name__: found(run) for run in (*RUNS, single)}


def check(known, other, exact):
    """Whether what two machines give is the same, to the last bit where it has to be.

    Args:
        known: What one gives.
        other: What the other one does.
        exact: Names of what is given the same numbers.
    """
    assert known["method"] == other["method"] == "native"
    for name in known:
        if name == "method":
            continue
        # steps at 1e-5 in single precision, of numbers up to ten
        room = 1e-4 if name == "single" else ROUNDING
        for a, b in zip(*map(jax.tree.leaves, (known[name], other[name])), strict=True):
            if name in exact:
                np.testing.assert_array_equal(b, a, err_msg=name)
            else:
                np.testing.assert_allclose(b, a, rtol=ROUNDING, atol=room, err_msg=name)
