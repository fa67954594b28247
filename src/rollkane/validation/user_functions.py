"""Functions that a user writes, as values that JAX can carry.

A plain function becomes static structure (a new lambda means a new compilation), with
a digest of its program: what it looks at may have changed since it was last given. A
callable that holds arrays, such as an ``equinox`` module, stays a tree of arrays and
is differentiated like any other part of a scene.
"""

import functools
import inspect
from collections.abc import Callable
from typing import Any, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr
from jaxtyping import Array

from .checks import FieldError, is_traced, known_array
from .function_errors import (
    ReturnedShapeError,
    called,
    refuse_complex,
    untraceable,
)
from .program_digest import digest_of_traced

# a program, the structure of its results and of what is not an array among them
_Trace = Callable[..., tuple[ClosedJaxpr, Any, Any]]


class UserFunction(eqx.Module):
    """A user's function of a few coordinates, and of parameters if it takes them.

    Attributes:
        parameters: Any tree of numbers; passed last where it is not None, and None
            where the function's owner holds them for several.
    """

    _arrays: Any
    parameters: Any
    _fixed: Any = eqx.field(static=True)
    _digest: str = eqx.field(static=True)
    _spread: bool = eqx.field(static=True)
    _takes_parameters: bool = eqx.field(static=True)
    _of_owner: bool = eqx.field(static=True)

    def __init__(
        self,
        field: str,
        function: Callable[..., Any],
        count: int,
        parameters: Any,
        of_array: bool = False,
        shared: bool = False,
    ):
        """Wrap ``function``.

        Args:
            field: Name used in errors, for example ``Graph.f``.
            function: Takes its coordinates one by one or as one array of shape
                (count,), then the parameters; or another owner's function.
            count: How many coordinates there are.
            parameters: Tree of numbers, or None for a function without.
            of_array: Only the form with one array, whatever the count; parameters
                are passed if it takes them (several functions may share them).
            shared: Whether its owner holds the parameters, and hands them over.

        Raises:
            FieldError: not callable, a signature that fits neither form, or one of
                coordinates whose derivatives are known backwards alone.
        """
        if not callable(function):
            raise FieldError(
                field, function, "must be a function", "give a function of JAX arrays"
            )
        if inspect.isroutine(parameters):
            problem = "must be numbers, and is a function"
            remedy = "let one function return all values: (radius, height), (x, y, z)"
            named = f"{field.split('.')[0]}.parameters"
            raise FieldError(named, parameters, problem, remedy)
        self.parameters = as_floats(parameters)
        takes = int(parameters is not None)
        for arguments, extra in _forms(function, count, takes, of_array):
            if accepts(function, arguments + extra):
                as_one = of_array or isinstance(function, UserFunction)
                self._spread = arguments == count and not as_one
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
        self._arrays, self._fixed = eqx.partition(function, eqx.is_array)
        self._digest, self._of_owner = "", False
        program = self._traced(count)
        if program is not None:
            if not of_array and _calls(program, "custom_vjp_call"):
                problem = "has a custom_vjp, and its slopes are taken forwards"
                raise FieldError(field, function, problem, "use jax.custom_jvp")
            refuse_complex(field, function, program.out_avals)
            self._digest = digest_of_traced(program)
            if is_traced(*program.consts):
                closed = self._closed_over(count)
                self._arrays, self._fixed = eqx.partition(closed, eqx.is_array)
                self._spread = False
        self._of_owner = shared and takes > 0 and self._takes_parameters
        if shared or not self._takes_parameters:
            self.parameters = None

    def _traced(self, count: int) -> ClosedJaxpr | None:
        """Its program; None where it has none, for a reason that check_output says."""
        # what it holds itself is no closure
        held, fixed = cast("tuple[Any, Any]", eqx.partition(self, eqx.is_array))
        value: Callable[[Any, Array], Array] = lambda held, u: eqx.combine(held, fixed)(
            u
        )
        try:
            return jax.make_jaxpr(value)(held, numbers_of((count,)))
        except Exception:
            return None

    def _closed_over(self, count: int) -> Callable[[Array], Array]:
        """The function with the traced values that it closes over made explicit.

        A closure such as ``lambda x, y: a * x**2`` with a traced ``a`` would hide
        ``a`` from differentiation.
        """
        function = eqx.combine(self._arrays, self._fixed)
        takes, given = self._takes_parameters, (jnp.zeros(count), self.parameters)

        def call(u: Array, parameters: Any = None) -> Array:
            return _call(function, self._spread, takes, parameters, u)

        return eqx.filter_closure_convert(call, *given[: 1 + takes])

    @property
    def takes_parameters(self) -> bool:
        """Whether it is one of parameters, too."""
        return self._takes_parameters

    @property
    def __name__(self) -> str:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Of the user's function, for errors."""
        return _name(self._fixed)

    def __call__(self, coordinates: Array, parameters: Any = None) -> Array:
        """Value at coordinates of shape (count,), and parameters of its owner's.

        Raises:
            FieldError: without parameters that its owner holds.
        """
        if self._of_owner and parameters is None:
            problem = "takes parameters, which are its owner's"
            remedy = "call it with them: part.position(alpha, part.parameters)"
            raise FieldError(self.__name__, None, problem, remedy)
        function = eqx.combine(self._arrays, self._fixed)
        own = self.parameters if parameters is None else parameters
        return _call(function, self._spread, self._takes_parameters, own, coordinates)

    def of(self, parameters: Any) -> Callable[[Array], Array]:
        """The function of coordinates alone, with parameters of its owner's."""

        def value(coordinates: Array) -> Array:
            return self(coordinates, parameters)

        value.__name__ = self.__name__
        return value


def _forms(
    function: Callable[..., Any], count: int, takes: int, of_array: bool
) -> list[tuple[int, int]]:
    """How many arguments it may take for its coordinates, and for parameters."""
    if of_array:
        return [(1, takes), (1, 1 - takes)]
    if isinstance(function, UserFunction):  # which has its own, or takes others
        fits = not takes or function.takes_parameters
        return [(1, takes)] if fits else []
    # one of (coordinates, parameters) may need none
    further = [] if takes else [(count, 1), (1, 1)]
    return [(count, takes), (1, takes), *further]


def _call(
    function: Callable[..., Array],
    spread: bool,
    takes_parameters: bool,
    parameters: Any,
    coordinates: Array,
) -> Array:
    arguments: list[Any] = list(coordinates) if spread else [coordinates]
    if takes_parameters:
        arguments.append(parameters)
    return called(function, *arguments)


class GivenFunction(eqx.Module):
    """A user's function of several arguments, with a value of known shape."""

    _arrays: Any
    _fixed: Any = eqx.field(static=True)
    _digest: str = eqx.field(static=True)
    _takes_more: bool = eqx.field(static=True)

    def __init__(
        self,
        field: str,
        function: Callable[..., Any],
        shape: tuple[int, ...] | None,
        example: tuple[Any, ...],
        more: Any,
        meaning: str,
        source: str = "parameters",
    ):
        """Wrap it; refused if it does not give ``shape``.

        Args:
            field: Name used in errors.
            function: The user's.
            shape: Of its value; None for anything.
            example: Arguments of the right shapes.
            more: What it gets behind them if it cannot be called without.
            meaning: Of the arguments, for errors: ``(t, q, u)``.
            source: Where ``more`` comes from, for errors.

        Raises:
            FieldError: no function, or one of another shape or signature.
        """
        if not callable(function):
            raise FieldError(
                field,
                function,
                "must be a function",
                f"give a function of {meaning}, and of the parameters if it needs them",
            )
        count = len(example)
        # defaults are the user's own; another owner's leaves out what it does not want
        others = isinstance(function, GivenFunction)
        self._takes_more = others or not accepts(function, count)
        if self._takes_more and not accepts(function, count + 1):
            raise FieldError(
                field,
                function,
                "has a signature that does not fit",
                f"let it take {meaning}, and then the parameters if there are any",
            )
        remedy = f"let it return an array of shape {shape}, by jax.numpy operations"
        call = functools.partial(_value, self._takes_more)
        example = (*example, more)
        try:
            trace = cast("_Trace", eqx.filter_make_jaxpr(call))
            program, value, _ = trace(function, *example)
        except Exception as error:
            raise untraceable(field, function, error, remedy, source) from error
        if shape is not None and getattr(value, "shape", None) != shape:
            raise ReturnedShapeError(field, function, value, remedy)
        refuse_complex(field, function, program.out_avals)
        self._digest = digest_of_traced(program)
        if is_traced(*program.consts):
            # a closure would hide a traced number from differentiation
            closed = functools.partial(call, function)
            function = eqx.filter_closure_convert(closed, *example)
            self._takes_more = True
        self._arrays, self._fixed = eqx.partition(function, eqx.is_array)

    @property
    def __name__(self) -> str:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Of the user's function, for errors."""
        return _name(self._fixed)

    def __call__(self, *arguments: Any) -> Any:
        """Its value, at arguments of which the last is what it may not want."""
        function = eqx.combine(self._arrays, self._fixed)
        return _value(self._takes_more, function, *arguments)


def _calls(program: Any, name: str) -> bool:
    """Whether a program, or one inside of it, has an operation."""
    for equation in program.eqns:
        inner = jax.tree.leaves(list(equation.params.values()))
        if equation.primitive.name == name:
            return True
        if any(_calls(x, name) for x in inner if hasattr(x, "eqns")):
            return True
    return False


def _name(function: Any) -> str:
    return getattr(function, "__name__", type(function).__name__)


def _value(takes_more: bool, function: Callable[..., Any], *arguments: Any) -> Any:
    value = called(function, *(arguments if takes_more else arguments[:-1]))
    if isinstance(value, list):
        parts = cast("list[Any]", value)
        kind = complex if any(map(jnp.iscomplexobj, parts)) else float
        value = jnp.stack([jnp.asarray(v, jnp.result_type(kind)) for v in parts])
    return value


def as_floats(tree: Any) -> Any:
    """A tree of numbers with plain ones as arrays of floats."""
    return jax.tree.map(_as_float, tree)


def _as_float(x: Any) -> Any:
    if isinstance(x, (int, float)) and not isinstance(x, bool):
        return known_array(np.asarray(x, jnp.result_type(float)))
    return x


def as_time(t: Any) -> Array:
    """A time [s] as an array of floats; plain numbers are times, too."""
    return jnp.asarray(t, jnp.result_type(t, float))


def accepts(function: Callable[..., Any], count: int) -> bool:
    """Whether a function can be called with so many positional arguments."""
    try:
        inspect.signature(function).bind(*[None] * count)
    except TypeError:
        return False
    except ValueError:  # no signature to be had (some built-in functions)
        return True
    return True


def numbers_of(shape: tuple[int, ...]) -> jax.ShapeDtypeStruct:
    """Numbers of a shape that a function is traced with: arrays would be compiled."""
    return jax.ShapeDtypeStruct(shape, jnp.result_type(float))


def check_output(
    field: str,
    function: Callable[..., Any],
    takes: tuple[int, ...],
    shape: tuple[int, ...],
) -> None:
    """Find the shape of a user's function once, to fail early and clearly.

    Args:
        field: Name used in the error.
        function: Of one array.
        takes: The array's shape.
        shape: That its value must have.

    Raises:
        FieldError: it raises, or returns something of another shape.
    """
    wanted = f"an array of shape {shape}" if shape else "one number alone"
    remedy = f"let it return {wanted}, by jax.numpy operations"
    try:
        result = jax.eval_shape(function, numbers_of(takes))
    except Exception as error:
        raise untraceable(field, function, error, remedy) from error
    if getattr(result, "shape", None) != shape:
        raise ReturnedShapeError(field, function, result, remedy)


def check_rotation(
    field: str,
    function: Callable[[Array], Array],
    arguments: np.ndarray,
    meaning: str,
) -> None:
    """Refuse a function whose values are no rotations, where they are known.

    Args:
        field: Name used in the error.
        function: Of one argument, to (3, 3).
        arguments: Where to try it, shape (k, ...).
        meaning: What the columns of its value are, for the remedy.

    Raises:
        FieldError: columns that are not a right-handed set of unit vectors.
    """
    loose = 1e-6 if jnp.result_type(float) == jnp.float64 else 1e-3
    matrices = jax.vmap(function)(jnp.asarray(arguments))
    if is_traced(matrices):
        return
    for at, A in zip(arguments, np.asarray(matrices, float), strict=True):
        # a function may be unknown outside its own domain
        if np.isfinite(A).all() and (
            np.abs(A.T @ A - np.eye(3)).max() > loose or np.linalg.det(A) < 0
        ):
            where = ", ".join(f"{x:g}" for x in np.atleast_1d(at))
            raise FieldError(
                field,
                function,
                f"is not a rotation at {where}, where it gives {A.tolist()}",
                f"let its columns be unit vectors at right angles, right-handed: "
                f"{meaning}",
            )
