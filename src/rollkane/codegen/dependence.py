"""What of a program depends on its arguments."""

from collections.abc import Callable
from typing import Any, cast

import jax
import jax.extend as jex
import numpy as np

from .data_movement import Numbers, as_objects
from .jaxpr_types import Params
from .scalar_program import Program


def reached_outputs(jaxpr: Any) -> list[bool]:
    """Which outputs depend on the inputs, equation by equation.

    An inner program counts as one equation: each of its outputs as depending on all of
    its inputs.

    Args:
        jaxpr: Of ``jax.make_jaxpr``; what it closes over is no input.
    """
    reached: set[Any] = set(jaxpr.invars)
    known: Callable[[Any], bool] = lambda x: (
        not isinstance(x, jex.core.Literal) and x in reached
    )
    for equation in jaxpr.eqns:
        if any(map(known, equation.invars)):
            reached.update(equation.outvars)
    return [known(x) for x in jaxpr.outvars]


def reached_numbers(function: Callable[..., Any], size: int, given: Any) -> np.ndarray:
    """Which numbers of a function's result depend on which of its argument's.

    By its program, whatever the values: ``x[0] * x[1]`` depends on both. What a known
    zero multiplies is no dependence.

    Args:
        function: ``function(x, given)`` -> an array, of an array x of shape (size,).
        size: Of x.
        given: A tree of arrays whose values are not known.

    Returns:
        True where one may depend on the other, shape (*shape of the result, size).

    Raises:
        NotElementwiseError: the function is more than arithmetic on single numbers.
    """

    def operate(
        name: str, params: Params, operands: list[Any], dtype: np.dtype
    ) -> frozenset[int]:
        del name, params, dtype
        found: set[int] = set()
        for operand in operands:  # a number, or an array of those looked up in
            for x in np.asarray(operand, object).reshape(-1):
                if isinstance(x, frozenset):
                    found |= cast("frozenset[int]", x)
        return frozenset(found)

    def unknown(shape: tuple[int, ...]) -> Numbers:
        count = int(np.prod(shape, dtype=int))
        return as_objects([frozenset[int]()] * count, shape)

    x = jax.ShapeDtypeStruct((size,), jax.numpy.result_type(float))
    program = Program(function, x, given)
    leaves = [unknown(np.shape(leaf)) for leaf in jax.tree.leaves(given)]
    own = as_objects([frozenset({i}) for i in range(size)], (size,))
    (found,) = program([own, *leaves], operate)
    reached = np.zeros((*found.shape, size), bool)
    for index in np.ndindex(found.shape):
        if isinstance(found[index], frozenset):
            reached[index][list(found[index])] = True
    return reached
