"""Functions that a user writes, as values that JAX can carry.

A plain function becomes static structure (a new lambda means a new compilation); a
callable that holds arrays, such as an ``equinox`` module, stays a tree of arrays and
is differentiated like any other part of a scene.
"""

import inspect
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from .checks import FieldError


class UserFunction(eqx.Module):
    """A user's function of a few coordinates, and of parameters if it takes them.

    Attributes:
        parameters: Any tree of numbers; passed last where it is not None.
    """

    _fixed: Callable | None = eqx.field(static=True)
    _carried: Any
    parameters: Any
    _spread: bool = eqx.field(static=True)
    _takes_parameters: bool = eqx.field(static=True)

    def __init__(self, field: str, function: Callable, count: int, parameters: Any):
        """Wrap ``function``.

        Args:
            field: Name used in errors, for example ``Graph.f``.
            function: Takes its coordinates one by one or as one array of shape
                (count,), then the parameters.
            count: How many coordinates there are.
            parameters: Tree of numbers, or None for a function without.

        Raises:
            FieldError: not callable, or a signature that fits neither form.
        """
        if not callable(function):
            raise FieldError(
                field, function, "must be a function", "give a function of JAX arrays"
            )
        holds_arrays = any(eqx.is_array(x) for x in jax.tree.leaves(function))
        self._fixed = None if holds_arrays else function
        self._carried = function if holds_arrays else None
        self.parameters = jax.tree.map(_as_float, parameters)
        takes = int(parameters is not None)
        forms = [(count, takes), (1, takes)]
        if not takes:  # a function of (coordinates, parameters) that needs none
            forms += [(count, 1), (1, 1)]
        for arguments, extra in forms:
            if _accepts(function, arguments + extra):
                self._spread = arguments == count
                self._takes_parameters = bool(extra)
                break
        else:
            raise FieldError(
                field,
                function,
                "has a signature that does not fit",
                f"let it take {count} coordinates (one by one, or one array of "
                f"shape ({count},))" + (" and then the parameters" if takes else ""),
            )

    def __call__(self, coordinates: Array) -> Array:
        function = self._carried if self._fixed is None else self._fixed
        arguments = list(coordinates) if self._spread else [coordinates]
        if self._takes_parameters:
            arguments.append(self.parameters)
        return function(*arguments)


def _as_float(x: Any) -> Any:
    if isinstance(x, (int, float)) and not isinstance(x, bool):
        return jnp.asarray(x, dtype=jnp.result_type(float))
    return x


def _accepts(function: Callable, count: int) -> bool:
    try:
        inspect.signature(function).bind(*[None] * count)
    except TypeError:
        return False
    except ValueError:  # no signature to be had (some built-in functions)
        return True
    return True


def check_output(
    field: str, function: Callable, argument: Array, shape: tuple[int, ...]
) -> None:
    """Evaluate the shape of a user's function once, to fail early and clearly.

    Raises:
        FieldError: it raises, or returns something of another shape.
    """
    remedy = f"let it return an array of shape {shape}, by jax.numpy operations"
    try:
        result = jax.eval_shape(function, argument)
    except Exception as error:
        raise FieldError(
            field, function, f"cannot be traced by JAX ({error})", remedy
        ) from error
    found = getattr(result, "shape", None)
    if found != shape:
        raise FieldError(field, function, f"returns shape {found}", remedy)
