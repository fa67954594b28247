"""A parameter and its derivatives where its coordinates are known: one program."""

from typing import NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..codegen.compile_effort import for_one_call
from .transforms import AbstractTransform


class TransformValues(NamedTuple):
    """What a transform gives at its coordinates.

    Attributes:
        value: The parameter, in its own shape.
        shown: Its named numbers, shape (m,).
        slope: Derivative of the parameter's entries by the coordinates, shape (n, k).
        shown_slope: Of the named numbers, shape (m, k).
    """

    value: np.ndarray
    shown: np.ndarray
    slope: np.ndarray
    shown_slope: np.ndarray


def values_at(transform: AbstractTransform, z: np.ndarray) -> TransformValues:
    """Everything at coordinates z, shape (k,)."""
    return TransformValues(*map(np.asarray, _values(transform, z)))


@for_one_call
def _values(transform: AbstractTransform, z: Float[Array, " k"]) -> tuple[Array, ...]:
    def both(z: Array) -> tuple[Array, Array]:
        value = transform.value(z)
        return jnp.ravel(value), transform.shown(value)

    z = jnp.asarray(z)
    slopes = cast("tuple[Array, Array]", jax.jacfwd(both)(z))
    value = transform.value(z)
    return value, transform.shown(value), *slopes
