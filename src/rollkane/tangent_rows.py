"""A function's changes along several tangents, computed number by number.

Differentiated as it is written, a function of small vectors spends most of its time on
vectors of three and matrices of nine. Walked number by number (:mod:`numberwise`), the
tangents are rows of one length that XLA vectorises, and what is zero is left out: eight
take 0.55 instead of 0.97 us for the rates of a disc. (Cotangents gain nothing, and in
batches lose.)
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array

from .numberwise import NotElementwiseError, Numbers, Program, as_objects, numbers_of

# Beyond, arrays are faster: eight tangents of a shell with a pendulum have 1131
# operations and take 1.4 us instead of 3.4, those of an ellipsoid in a bowl have 1415
# and take 2.7 instead of 2.2 (and 2.4 instead of 2.1 s to compile).
_MOST_OPERATIONS = 1200
# One takes 285 ns number by number for the rates of a disc, 190 as it is.
_FEWEST_TANGENTS = 3


def pushed(
    function: Callable, primals: list[Array], tangents: list[Array]
) -> tuple[Array, Array]:
    """A function's value, and its changes along several tangents.

    Args:
        function: Of arrays, to one array.
        primals: Its arguments.
        tangents: Of the arguments, each with one more axis behind, all of one length P.

    Returns:
        The value, and its tangents with an axis of length P behind.
    """
    one = lambda moved: jax.jvp(function, primals, moved)
    count = tangents[0].shape[-1]
    if count == 1:
        value, moved = one([x[..., 0] for x in tangents])
        return value, moved[..., None]
    if count >= _FEWEST_TANGENTS:
        try:
            return _pushed_by_numbers(function, primals, tangents)
        except NotElementwiseError:
            pass
    return jax.vmap(one, in_axes=-1, out_axes=(None, -1))(tangents)


def _pushed_by_numbers(function, primals, tangents):
    single = [jax.ShapeDtypeStruct(x.shape, x.dtype) for x in primals]
    program = Program(lambda x, moved: jax.jvp(function, x, moved), single, single)
    if program.size > _MOST_OPERATIONS:
        raise NotElementwiseError("too many numbers")
    values = [*map(numbers_of, primals), *map(_rows, tangents)]
    value, moved = program(values, _Operations())
    count = tangents[0].shape[-1]
    return _array(value, program.outputs[0]), _array(moved, program.outputs[1], count)


class _Operations:
    """Operations of numbers and of rows of numbers, in JAX."""

    def __init__(self):
        self._left = _MOST_OPERATIONS

    def __call__(self, name: str, params: Any, operands: list, dtype: Any) -> Array:
        del dtype
        self._left -= 1
        if not self._left:
            raise NotElementwiseError("too many operations")
        lengths = {x.shape for x in operands if x.shape}
        if lengths:
            (length,) = lengths
            operands = [
                x if x.shape else jax.lax.broadcast(x, length) for x in operands
            ]
        primitive = getattr(jax.lax, _NAMES.get(name, name) + "_p")
        return primitive.bind(*operands, **params)


_NAMES = {"add_any": "add"}  # of primitives that jax.lax has under another


def _rows(x: Array) -> Numbers:
    rows = jnp.reshape(x, (-1, x.shape[-1]))
    return as_objects(jnp.unstack(rows) if rows.size else (), x.shape[:-1])


def _array(numbers: Numbers, like: Any, *row: int) -> Array:
    """Numbers, or rows of them, as an array."""
    if not numbers.size:
        return jnp.zeros((*like.shape, *row), like.dtype)
    parts = [jnp.broadcast_to(jnp.asarray(x, like.dtype), row) for x in numbers.flat]
    return jnp.stack(parts).reshape(*like.shape, *row)
