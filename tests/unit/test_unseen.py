"""Sentences about directions that records do not show."""

import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk
from rollkane.identification.layout import Layout
from rollkane.identification.parameters import Model
from rollkane.identification.unseen import described

SPIN = np.array([10.0, 4.0, 2.0])
BODY = rk.Body(0.5, 4e-4 * np.eye(3), rk.Sphere(0.05))
SCENE = rk.Scene(BODY)
START = rk.place(SCENE, (1.0, 0.0, 0.0, 0.0), SPIN, (0.0, 0.0, 0.0))
GYRO = rk.Gyro(np.ones((11, 3)), 0.01)
MODEL = Model(SCENE, START, jnp.zeros(()), None, {"gyro": GYRO})


@pytest.mark.parametrize("noise", [0.0, 1e-14, 1e-8, 1e-3])
def test_words_do_not_depend_on_numbers_that_are_nearly_zero(noise):
    """A turn from the guess and a bias, whose estimates may be nothing but noise.

    The axes of a ball turn by e about x: 1 rad beside e x w = (0, -2, 4) rad/s, of
    10 rad/s; a bias of 1 rad/s, its size where none is known, hides 1 of those 10.
    """
    free = [rk.Free(f"start.{name}") for name in ("orientation", "angular_velocity")]
    layout = Layout([MODEL], [*free, rk.Free("gyro.bias")])
    z = layout.start + noise * np.array([1.0, -2.0, 3.0, 0.0, 0.0, 0.0, 1.0, 2.0, 3.0])
    turned, biased = np.zeros((2, 1, 9))
    turned[0, :6] = [1.0, 0.0, 0.0, 0.0, -2.0, 4.0]
    biased[0, [4, 7]] = -1.0, 1.0
    start = "a combination is not seen: "
    assert described(turned, layout, z) == (
        f"{start}start.orientation about x +1.00, "
        "start.angular_velocity[1] -0.20, start.angular_velocity[2] +0.40",
    )
    assert described(biased, layout, z) == (
        f"{start}start.angular_velocity[1] -0.10, gyro.bias[1] +1.00",
    )
