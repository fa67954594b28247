"""Numbers that are traced, in lists of others: taken as they are."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk
from rollkane import kane
from rollkane.validation.checks import FieldError, dimension


def in_a_row(alpha):
    """Places of two masses."""
    return jnp.stack([alpha[0] * jnp.array([1.0, 0.0, 0.0])] * 2)


def falling(g):
    """Of a body that nothing holds."""
    bodies = kane.free_bodies([1.0], [np.eye(3)], gravity=[0.0, 0.0, -g])
    at_rest = kane.KaneState(jnp.eye(7)[3], jnp.zeros(6))
    return kane.kane_derivative(bodies.system, 0.0, at_rest).u[2]


# a number of what was made, linear in x, and its slope
MADE = {
    "masses": (lambda x: rk.PointMasses([x, 0.2], in_a_row).mass.sum(), 1.0),
    "masses in a tuple": (
        lambda x: rk.PointMasses((0.1, 2.0 * x), in_a_row).mass.sum(),
        2.0,
    ),
    "a record of one component": (
        lambda x: rk.RecordedMotion([0.0, 0.1, 0.2], [x, 0.0, 0.0]).acceleration[0, 0],
        1.0,
    ),
    "a record of two": (
        lambda x: rk.RecordedMotion(
            [0.0, 0.1], [[0.0, 2.0 * x], [0.0, 0.0]]
        ).acceleration[0, 1],
        2.0,
    ),
    "gravity": (falling, -1.0),
    "moments of a disc": (
        lambda x: kane.rolling_disc(1.0, 1.0, [x, 0.5]).parts[0].inertia[0, 0],
        1.0,
    ),
    "moments of a plate": (
        lambda x: kane.babyboot(plate_moments=[0.3, x, 0.3]).parts[1].inertia[1, 1],
        1.0,
    ),
}


@pytest.mark.parametrize("name", MADE)
def test_traced_numbers_in_lists(name):
    made, slope = MADE[name]
    # a copy, or one multiplication
    np.testing.assert_allclose(jax.grad(made)(0.3), slope, rtol=1e-14)


def test_one_angle_in_a_list_is_that_angle():
    alone = jax.jacfwd(lambda x: rk.orientation_from_euler("Z", x))(0.3)
    listed = jax.jacfwd(lambda x: rk.orientation_from_euler("Z", [x]))(0.3)
    np.testing.assert_array_equal(listed, alone)


def test_axes_of_lists():
    given = (1.0, [], [1.0], [[1.0], (2.0,)], np.ones((2, 3)))
    assert [dimension(x) for x in given] == [0, 1, 1, 2, 2]
    with pytest.raises(FieldError, match=r"RecordedMotion\.acceleration: must be made"):
        rk.RecordedMotion([0.0, 0.1], [[1.0, 0.0], [0.0]])
