"""Inertias by their moments alone: bodies without thickness along an axis."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk
from rollkane.identification.inertia_transforms import inertia_transform


@pytest.mark.parametrize(
    "moments", [(1.0, 1.0, 2.0), (2.0, 1.0, 1.0), (1.0, 0.0, 1.0), (2.0, 3.0, 4.0)]
)
def test_diagonal_form_keeps_the_inertia_and_its_flatness(moments):
    """Discs across z and x, a rod along y, a solid body."""
    inertia = jnp.diag(jnp.array(moments))
    transform = inertia_transform("inertia", inertia, "diagonal")
    # sums of three exponentials of logarithms: rounding of a few units
    exact = {"rtol": 0.0, "atol": 16 * np.finfo(float).eps * max(moments)}
    np.testing.assert_allclose(transform.value(transform.start()), inertia, **exact)
    flat = 0.5 * sum(moments) - np.array(moments) == 0.0
    assert transform.start().size == 3 - flat.sum()
    moved = transform.second_moments(jnp.asarray(transform.start()) + 0.3)
    np.testing.assert_array_equal(np.diag(moved) == 0.0, flat)
    slope = jax.jacfwd(lambda z: jnp.diagonal(transform.value(z)))(
        jnp.asarray(transform.start())
    )
    assert np.linalg.matrix_rank(slope) == 3 - flat.sum()


def test_diagonal_form_refuses_what_no_density_has():
    """One moment over the sum of the others."""
    with pytest.raises(rk.FieldError, match="triangle"):
        inertia_transform("inertia", jnp.diag(jnp.array([1.0, 1.0, 3.0])), "diagonal")
