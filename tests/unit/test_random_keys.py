"""Keys of random numbers in a user's functions: runs go by XLA, derivatives too."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk

from ..quick import slow_but

KEY = jax.random.key(0)
BALL = rk.Body(1.0, 0.004 * np.eye(3), rk.Sphere(0.1))


def noise(key, t):
    return jnp.stack([jax.random.normal(key, (4,))[1] * jnp.sin(3.0 * t), 0 * t, 0 * t])


FORCES = {
    "closed over": rk.Force(lambda t, p: noise(KEY, t)),
    "parameter": rk.Force(lambda t, p, key: noise(key, t), parameters=KEY),
}


def ends(name, turn, **options):
    scene = rk.Scene(BALL, loads=(rk.Gravity(), FORCES[name]))
    about = jnp.stack([0 * turn, turn, 0 * turn])
    start = rk.place(scene, (1.0, 0.0, 0.0, 0.0), about, (0.0, 0.0, 0.0))
    return rk.simulate(scene, start, (0.0, 0.5), rtol=1e-10, **options)


@pytest.mark.parametrize("name", slow_but(["closed over"], FORCES))
@pytest.mark.parametrize("method", slow_but(["auto"], ["auto", "diffrax"]))
def test_runs_and_derivatives_go_by_xla(name, method):
    """Was: a TypeError where it is closed over, an AttributeError as a parameter."""
    run = ends(name, jnp.asarray(5.0), method=method)
    assert run.method == "diffrax"
    if method == "auto":
        assert "numbers of key" in run.why
    # x'' = F / (m + I / r^2) = F / 1.4, F = a sin 3 t, from 0.5 m/s
    a = float(noise(KEY, jnp.asarray(np.pi / 6))[0])
    wanted = 0.25 + a / 1.4 * (0.5 / 3.0 - np.sin(1.5) / 9.0)
    np.testing.assert_allclose(run.position[-1, 0], wanted, rtol=1e-9)
    end = lambda turn: ends(name, turn, method=method).position[-1, 0]
    at = jnp.asarray(5.0)
    np.testing.assert_allclose(jax.grad(end)(at), 0.05, rtol=1e-9)
    np.testing.assert_allclose(jax.jvp(end, (at,), (1.0,))[1], 0.05, rtol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("name", FORCES)
def test_with_modes_and_in_ensembles_too(name):
    wanted = ends(name, jnp.asarray(5.0)).position[-1]
    run = ends(name, jnp.asarray(5.0), modes=rk.Modes(friction=9.0))
    np.testing.assert_allclose(run.position[-1], wanted, atol=1e-9)
    scene = rk.Scene(BALL, loads=(rk.Gravity(), FORCES[name]))
    start = rk.place(scene, (1.0, 0, 0, 0), (0.0, 5.0, 0.0), (0.0, 0.0, 0.0))
    many = rk.ensemble(scene, [start, start], (0.0, 0.5), rtol=1e-10)
    np.testing.assert_allclose(many.position[1, -1], wanted, atol=1e-9)
