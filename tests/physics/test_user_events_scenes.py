"""Events in all kinds of scenes: both loops, both modes of derivatives, differences."""

import functools

import diffrax as dfx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk

from ..quick import slow_but

UP, STILL = (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
EGG = rk.Ellipsoid((0.12, 0.1, 0.07), (0.01, -0.005, 0.01))
END = 0.5


def body_of(x):
    return rk.Body(1.0 + x, np.diag([0.004, 0.005, 0.006]), EGG)


def slider(x):
    masses = rk.PointMasses(
        (0.2,),
        lambda a, p: jnp.stack([0.05 * jnp.sin(a), 0.02 + 0.0 * a, 0.03 * a], 1),
        force=lambda t, a, a_dot, p: -p * a - 0.01 * a_dot,
        parameters=2.0 + x,
    )
    scene = rk.Scene(body_of(x), supported=(masses,))
    start = {"alpha": (0.3,), "alpha_dot": (1.0,)}
    return scene, rk.place(scene, UP, (2.0, -3.0, 1.0), STILL, **start)


def slips(x):
    law = rk.Slipping(rk.ViscousFriction(0.4 + x))
    scene = rk.Scene(body_of(x), contact=law)
    slip = (0.5, 0.2, 0.0)
    return scene, rk.place(scene, UP, (2.0, -3.0, 1.0), STILL, slip=slip)


def shaken(x):
    times = jnp.linspace(0.0, 0.6, 31)
    ways = jnp.stack([jnp.sin(20.0 * times), jnp.cos(17.0 * times), 0.3 * times], 1)
    motion = rk.RecordedMotion(times, (3.0 + x) * ways)
    scene = rk.Scene(body_of(x), rk.Base(rk.Plane(), motion))
    return scene, rk.place(scene, UP, (2.0, -3.0, 1.0), STILL)


def in_a_bowl(x):
    bowl = rk.Graph(lambda u, v, p: p * (u * u + 0.7 * v * v), 1.0 + x)
    scene = rk.Scene(body_of(x), rk.Base(bowl))
    height = (1.0 + x) * (0.1**2 + 0.7 * 0.05**2)
    where = jnp.stack([jnp.asarray(0.1), jnp.asarray(0.05), height])
    return scene, rk.place(scene, UP, (2.0, -3.0, 1.0), where)


MADE = {f.__name__: f for f in (slider, slips, shaken, in_a_bowl)}


def turning(scene, t, state):
    """A rate of the body [rad/s], on fixed axes."""
    contact = rk.contact_of(scene, t, state)
    return (contact.rotation @ contact.angular_velocity)[0]


@functools.cache
def level(name):
    """What it is at 0.37 s."""
    scene, start = MADE[name](jnp.asarray(0.0))
    run = rk.simulate(scene, start, (0.0, 0.37, END), rtol=1e-12)
    state = jax.tree.map(lambda x: x[1], run.state)
    return float(turning(scene, run.time[1], state))


def found_at(x, name, method="native"):
    """Time and a rate where that level is crossed next to 0.37 s."""
    scene, start = MADE[name](x)
    event = rk.Event(lambda s, t, y: turning(s, t, y) - level(name), name="level")
    run = rk.simulate(
        scene, start, (0.0, 0.3, END), rtol=1e-12, events=event, method=method
    )
    found = run.events["level"]
    late = jnp.nanargmin(jnp.abs(found.times - 0.37))
    state = jax.tree.map(lambda x: x[late], found.states)
    return jnp.stack([found.times[late], state.angular_velocity[1]])


EIGHTH = np.array([1 / 280, -4 / 105, 1 / 5, -4 / 5, 4 / 5, -1 / 5, 4 / 105, -1 / 280])
AWAY = np.array([-4.0, -3.0, -2.0, -1.0, 1.0, 2.0, 3.0, 4.0])


@pytest.mark.parametrize("name", slow_but([], MADE))
def test_events_and_their_derivatives(name):
    zero, h = jnp.asarray(0.0), 2e-3
    level(name)  # of known numbers
    own = functools.partial(found_at, name=name)
    by_diffrax = jax.jit(functools.partial(found_at, name=name, method="diffrax"))
    every = jax.jit(
        lambda x, y: (own(x), jax.jacfwd(own)(x), jax.jacrev(own)(x), jax.vmap(own)(y))
    )
    value, forward, backward, values = every(zero, h * AWAY)
    # 60 steps of rtol 1e-12 of rates of 3 rad/s, over how fast they change, 1 rad/s^2
    assert abs(value[0] - 0.37) < 1e-9
    # the same steps, and roundings of them
    np.testing.assert_allclose(by_diffrax(zero), value, rtol=0, atol=1e-11)
    np.testing.assert_allclose(backward, forward, rtol=1e-10, atol=1e-10)
    # of order h^8: 1e-21 of numbers of one; runs are equal to 1e-11 of their steps
    differences = EIGHTH @ values / h
    np.testing.assert_allclose(forward, differences, rtol=1e-8, atol=1e-8)


WAYS = {
    "dopri5": {"solver": dfx.Dopri5()},
    "implicit": {"solver": dfx.Kvaerno5()},
    "the paper's equations": {"formulation": "euler_lagrange"},
    "the paper's coordinates": {"coordinates": "voronets"},
}


def by_way(x, way):
    body = rk.Body(1.0, np.diag([0.004, 0.005, 0.006]), rk.Ellipsoid((0.12, 0.1, 0.07)))
    field = rk.Gravity(jnp.stack([x, 0.0 * x, -9.81 + 0.0 * x]))
    scene = rk.Scene(body, loads=(field,))
    q = np.array([0.9, 0.3, 0.2, 0.1])
    start = rk.place(scene, q / np.linalg.norm(q), (1.0, 3.0, 0.5), STILL)
    meets = lambda s, t, y: t + 0.5 * rk.contact_of(s, t, y).position[0] - 0.4
    how = {"rtol": 1e-9, "events": rk.Event(meets, name="meets"), **way}
    run = rk.simulate(scene, start, (0.0, 0.5, 1.0), **how)
    return run.events["meets"].times[0]


@pytest.mark.slow
@pytest.mark.parametrize("name", WAYS)
def test_every_way_to_integrate_moves_events_alike(name):
    """Explicit steps by their replay, implicit ones by diffrax's, other equations."""
    x = jnp.asarray(1.4)

    def found(way):
        f = functools.partial(by_way, way=way)
        return jax.jit(lambda x: (f(x), jax.jvp(f, (x,), (x,))[1], x * jax.grad(f)(x)))

    known, own = found({})(x), found(WAYS[name])(x)
    # some 100 steps of rtol 1e-9, over a rate of one
    np.testing.assert_allclose(own, known, rtol=0, atol=1e-7)
    # forwards and backwards along the same steps
    assert abs(own[1] - own[2]) < 1e-12
