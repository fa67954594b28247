"""Observables by their names."""

import jax
import jax.numpy as jnp
import numpy as np

import rollkane as rk
from rollkane.dynamics.ready_observables import READY


def test_a_tilt_has_derivatives_where_it_vanishes():
    """Of a body that leans about x by a, |a|: 1 beside zero, taken as zero there."""
    scene = rk.Scene(rk.Body(1.0, 0.004 * np.eye(3), rk.Sphere(0.1)))

    def tilt(a):
        turn = jnp.stack([jnp.cos(0.5 * a), jnp.sin(0.5 * a), 0.0 * a, 0.0 * a])
        state = rk.place(scene, turn, (0.0, 0.0, 1.0), (0.0, 0.0, 0.0))
        return READY["tilt"](scene, 0.0, state)

    slope = jax.grad(tilt)
    assert tilt(0.0) == 0.0
    assert slope(0.0) == 0.0
    # some ten roundings of numbers of 1, over the length of 0.3
    np.testing.assert_allclose(tilt(-0.3), 0.3, rtol=1e-14)
    np.testing.assert_allclose([slope(0.3), slope(-0.3)], [1.0, -1.0], rtol=1e-14)
