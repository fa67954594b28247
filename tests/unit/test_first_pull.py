"""When a contact would first have to pull, and how that moves."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk
from rollkane.simulation.first_pull import first_pull
from rollkane.simulation.samples import Axis

LEVEL, ORIGIN = (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
TIMES = jnp.linspace(0.0, 2.0, 6)


def press(scene, t, state):
    """``m - t^2``, and nothing of a state that is one: falls at ``sqrt(m)``."""
    return scene.body.mass - t * t + 0.0 * state.angular_velocity[0]


@pytest.mark.parametrize("derivative", [jax.jacfwd, jax.jacrev])
@pytest.mark.parametrize(
    ("mass", "expected"), [(1.3, 0.5 / np.sqrt(1.3)), (9.0, 0.0)], ids=["falls", "not"]
)
def test_it_moves_with_the_force(derivative, mass, expected):
    """Also where a run did not reach its last output."""

    def first(m):
        scene = rk.Scene(rk.Body(m, 0.004 * m * np.eye(3), rk.Sphere(0.1)))
        start = rk.place(scene, LEVEL, ORIGIN, ORIGIN)
        many = lambda x: jnp.broadcast_to(x, (6, *x.shape)).at[5:].set(jnp.nan)
        states, along = jax.tree.map(many, start), Axis(None, 0, of_times=True)
        return first_pull(press, scene, TIMES, states, (along,))

    m = jnp.asarray(mass)
    found = first(m)
    # a cubic through a parabola is that: 60 halvings, roundings of the sum
    falls = expected > 0.0
    np.testing.assert_allclose(found, np.sqrt(mass) if falls else np.nan, rtol=1e-14)
    np.testing.assert_allclose(derivative(first)(m), expected, rtol=1e-13)
