"""What a function of known arrays gives, found while it is walked: without a compiler.

A short program takes XLA half a second to compile, and a walk a tenth of that.
"""

from collections.abc import Callable
from typing import Any, cast

import equinox as eqx
import jax
import numpy as np

from .data_movement import Numbers, numbers_of, refuse_keys
from .jaxpr_types import ClosedJaxpr, Jaxpr, Params, numbers_in, parts_of
from .known_numbers import is_quick
from .scalar_program import NotElementwiseError, Walk

# Operations that a walk does in a tenth to half of a second, and for how many of them
# one counts that only XLA knows; numbers that may be given
_MOST, _BY_XLA = 5_000, 500


def evaluated(function: Callable[..., Any], *arguments: Any) -> Any:
    """What a function gives.

    Args:
        function: Of trees with arrays, to such a tree; pure.
        arguments: Those trees, of which all arrays are known.

    Raises:
        NotElementwiseError: it is more than some thousand operations on single numbers.
    """
    leaves: list[Any] = jax.tree.leaves(eqx.filter(arguments, eqx.is_array))
    if sum(x.size for x in leaves) > _MOST:
        raise NotElementwiseError("too many numbers")
    trace = cast("Callable[..., Any]", eqx.filter_make_jaxpr(function))
    closed, like, static = cast("tuple[ClosedJaxpr, Any, Any]", trace(*arguments))
    refuse_keys([*closed.consts, *leaves])
    if _has_loops(closed.jaxpr) or numbers_in(closed.jaxpr) > _MOST:
        raise NotElementwiseError("many operations")
    consts, given = ([numbers_of(x) for x in of] for of in (closed.consts, leaves))
    with np.errstate(all="ignore"):  # numbers may overflow, as XLA's do
        found = _Evaluation().through(closed.jaxpr, consts, given)
    shapes, structure = cast("tuple[list[Any], Any]", jax.tree.flatten(like))
    arrays = [_array(x, of.dtype) for x, of in zip(found, shapes, strict=True)]
    return eqx.combine(jax.tree.unflatten(structure, arrays), static)


def _has_loops(jaxpr: Jaxpr) -> bool:
    return any(
        equation.primitive.name in ("while", "scan")
        or any(_has_loops(getattr(x, "jaxpr", x)) for x in parts_of(equation.params))
        for equation in jaxpr.eqns
    )


class _Evaluation(Walk):
    """A walk that does what it meets, as long as that is little."""

    def __init__(self):
        super().__init__(_unknown)
        self._left = _MOST

    def operation(
        self, name: str, params: Params, operands: list[Any], dtype: np.dtype
    ) -> Any:
        """One operation on known numbers."""
        self._left -= 1 if is_quick(name) else _BY_XLA
        if self._left < 0:
            raise NotElementwiseError("too many operations")
        return super().operation(name, params, operands, dtype)


def _unknown(name: str, params: Params, operands: list[Any], dtype: np.dtype) -> Any:
    del params, operands, dtype
    raise NotElementwiseError(f"{name} of what is not known")


def _array(numbers: Numbers, dtype: np.dtype) -> Any:
    known = np.array(numbers.reshape(-1).tolist(), dtype)
    return jax.device_put(known.reshape(numbers.shape))
