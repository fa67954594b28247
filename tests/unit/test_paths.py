"""Paths of numbers of a model, as they are written and as they are found."""

import jax.numpy as jnp
import pytest

from rollkane.identification.paths import found, keys_of
from rollkane.validation.checks import FieldError


@pytest.mark.parametrize(
    "path", ["part.inertia[1][2]", "part.inertia[1,2]", "part.inertia[1, 2]"]
)
def test_an_entry_of_a_matrix_is_written_either_way(path):
    assert keys_of(path) == ("part", "inertia", 1, 2)
    matrix = jnp.arange(9.0).reshape(3, 3)
    assert float(found({"part": {"inertia": matrix}}, keys_of(path))) == 5.0


@pytest.mark.parametrize("path", ["", "a[1,]", "a[,1]", "a[1 2]", "a[-1]", "a b"])
def test_what_is_no_path_is_refused(path):
    with pytest.raises(FieldError, match="is not a path"):
        keys_of(path)
