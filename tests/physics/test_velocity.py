"""The velocity of the body's origin is the rate of its position."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk
from rollkane.dynamics.observables import position, velocity
from rollkane.geometry.rotations import rotation_matrix

BODY = rk.Body(1.3, np.diag([4e-3, 5e-3, 7e-3]), rk.Ellipsoid((0.1, 0.08, 0.06)))
LEVEL, SPIN = (1.0, 0.0, 0.0, 0.0), (0.7, -1.1, 2.3)


def heaving():
    """A bowl that moves and turns as it likes."""
    path = lambda t: 0.1 * jnp.stack([jnp.sin(t), t * t, jnp.cos(3.0 * t)])
    lean = lambda t: rotation_matrix(
        jnp.stack([jnp.ones_like(t), 0.1 * jnp.sin(2.0 * t), 0.0 * t, 0.5 * t])
    )
    bowl = rk.Graph(lambda x, y: 0.4 * x * x + 0.3 * y * y)
    return rk.Base(bowl, rk.BaseMotion(path, lean))


def rolling():
    scene = rk.Scene(BODY, heaving())
    return scene, rk.place(scene, LEVEL, SPIN, (0.1, 0.05, 0.00475))


def in_charts():
    scene = rk.Scene(BODY)
    tilted = (0.8, 0.6, 0.0, 0.0)
    return scene, rk.to_voronets(scene, rk.place(scene, tilted, SPIN, (0.1, 0.0, 0.0)))


def slipping():
    scene = rk.Scene(BODY, heaving(), contact=rk.Slipping(rk.CoulombFriction(0.2)))
    state = rk.place(scene, LEVEL, SPIN, (0.1, 0.05, 0.00475))
    contact = rk.contact_of(scene, jnp.asarray(0.0), state)
    along = contact.rotation @ jnp.cross(contact.normal, jnp.array([0.3, -0.5, 0.1]))
    return scene, eqx.tree_at(lambda s: s.slip, state, along)


@pytest.mark.parametrize("case", [rolling, in_charts, slipping])
def test_it_is_the_rate_of_the_position(case):
    scene, state = case()

    @jax.jit
    def both(t):
        rates = rk.rolling_derivative(scene, t, state)
        where = lambda t, state: position(scene, t, state)
        _, rate = jax.jvp(where, (t, state), (jnp.ones(()), rates))
        return velocity(scene, t, state), rate

    found, rate = both(jnp.asarray(0.0))
    assert jnp.linalg.norm(found) > 0.02
    # some hundred roundings of speeds of order one
    np.testing.assert_allclose(found, rate, rtol=0, atol=1e-13)


def test_of_a_result():
    """Thrown, falling and landed: in flight its own; in contact by the contact."""
    scene = rk.Scene(rk.Body(2.0, 0.008 * np.eye(3), rk.Sphere(0.1)))
    start = rk.release(scene, LEVEL, (0.0, 5.0, 0.0), (0.0, 0.0, 0.2), (0.2, 0.0, 0.0))
    modes = rk.Modes(friction=0.3, restitution=0.0)
    times = np.array([0.0, 0.05, 0.1, 1.0, 2.0])
    run = rk.simulate(scene, start, times, modes=modes)
    # flight is exact but for the rounding of its steps, some ten of order one
    falling = np.stack([np.full(3, 0.2), np.zeros(3), -9.81 * times[:3]], axis=1)
    np.testing.assert_allclose(run.velocity[:3], falling, rtol=0, atol=1e-13)
    # a ball that rolls on a plane: v = w x r e_z
    assert list(run.mode[3:]) == [rk.Mode.ROLLING] * 2
    w = np.asarray(run.angular_velocity[3:])
    turned = 0.1 * np.stack([w[:, 1], -w[:, 0], 0.0 * w[:, 0]], axis=1)
    np.testing.assert_allclose(run.velocity[3:], turned, rtol=0, atol=1e-13)
