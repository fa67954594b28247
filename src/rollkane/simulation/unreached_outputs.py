"""Quantities of outputs some of which a run did not reach: NaN, and derivatives, too.

Reverse mode pulls what is not used back as zeros, and 0 times NaN is NaN: so nothing is
evaluated at states of NaN, which would spoil the derivatives of all that was reached.
"""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ..codegen.linear_call import Linear, linear_call, shapes_of, unchanged

# A number in place of one that no state has: halves make a quaternion of unit length,
# directions that are not zero, and no point of symmetry.
_HALF = 0.5


def of_reached(quantity: Callable[[Any], Any], state: Any) -> Any:
    """A quantity of states, NaN where they were not reached.

    Args:
        quantity: Function of the states; its values have their axes in front.
        state: States, every array with the same axes in front, the last of them time.

    Its derivatives are NaN where they use an output that was not reached, else exact.
    """
    # in Voronets coordinates there is no orientation
    known = [state.angular_velocity, getattr(state, "orientation", None)]
    missing = [_missing(x) for x in known if x is not None]
    reached = ~jnp.all(jnp.stack(missing), axis=0)
    values = quantity(_with_stand_ins(state, reached))
    # truth values and whole numbers cannot tell: they are those of the states of NaN
    numeric = map(_is_number, jax.tree.leaves(values))
    as_it_is = values if all(numeric) else quantity(state)
    # through a number of the state, which has the run's own derivatives: NaN
    missed = state.angular_velocity[..., 0]

    def marked(value: Any, plain: Any) -> Any:
        if not _is_number(value):
            return plain
        own = (*reached.shape, *[1] * (value.ndim - reached.ndim))
        lost = jnp.broadcast_to(missed.reshape(own), value.shape).astype(value.dtype)
        return jnp.where(reached.reshape(own), value, _used(lost))

    return jax.tree.map(marked, values, as_it_is)


def _missing(x: Float[Array, "*B n"]) -> Bool[Array, "*B"]:
    return jnp.all(jnp.isnan(x), axis=-1)


def _is_number(x: Any) -> bool:
    return jnp.issubdtype(jnp.result_type(x), jnp.inexact)


def _with_stand_ins(state: Any, reached: Bool[Array, "*B"]) -> Any:
    """States, of those that were not reached the first of the run."""

    def filled(x: Array) -> Array:
        if not _is_number(x):
            return x
        first = jax.lax.stop_gradient(
            jax.lax.slice_in_dim(x, 0, 1, axis=reached.ndim - 1)
        )
        first = jnp.where(jnp.isnan(first), _HALF, first)
        own = (*reached.shape, *[1] * (x.ndim - reached.ndim))
        return jnp.where(reached.reshape(own), x, jnp.broadcast_to(first, x.shape))

    return jax.tree.map(filled, state)


def _used(x: Array) -> Array:
    """The same, whose cotangents are NaN unless they are zero: none cancel others."""
    return linear_call(_USED, (), (x,), shapes_of((x,)))[0]


def _nan_if_used(
    residuals: Sequence[Array], cotangents: Sequence[Array]
) -> list[Array]:
    del residuals
    return [jnp.where(c == 0.0, 0.0, jnp.nan).astype(c.dtype) for c in cotangents]


_USED = Linear(unchanged, _nan_if_used)
