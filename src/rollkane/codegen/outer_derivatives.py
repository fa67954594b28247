"""Derivatives, outside of programs, of what is compiled with an effort of its own.

Within a derivative JAX takes no options of the compiler: what ``jax.grad`` of a plain
function makes of a jitted one would be compiled with all effort, which takes longer
than what it computes. Here a function's values, with what its derivative keeps of them,
are one program, and the derivative, or its transpose, is another.
"""

import functools
from collections.abc import Callable, Sequence
from itertools import compress
from typing import Any, NamedTuple, TypeAlias, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import ShapedArray
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array

from ..validation.checks import is_traced
from .linear_call import Linear, is_asked_for, linear_call, shapes_of

_Function: TypeAlias = Callable[..., Any]
# A function, compiled with an effort.
Compiled: TypeAlias = Callable[[_Function], _Function]
_Moves: TypeAlias = tuple[bool, ...]  # which arrays have a tangent


class _Programs(NamedTuple):
    """Of a function; each is compiled where it is first called."""

    values: _Function
    along: _Function
    linearized: _Function
    pushed: _Function
    pulled: _Function
    by_jax: _Function  # as ``values``, of what is traced


class OuterDerivatives:
    """A function of known arguments some of which have tangents, outside of ``jit``."""

    def __init__(self, function: _Function, compiled: Compiled):
        """Of a function.

        Args:
            function: Of arguments by their places; what are no arrays is hashable.
            compiled: What compiles a function of such arguments with an effort, where
                it is called outside of ``jit``.
        """
        self._function, self._compiled = function, compiled

    @functools.cached_property
    def _programs(self) -> _Programs:
        """Made where there is a derivative: they may have such ones themselves."""
        made, function = self._compiled, self._function
        return _Programs(
            values=made(function),
            along=made(functools.partial(_along, function)),
            linearized=made(functools.partial(_linearized, function)),
            pushed=made(_pushed),
            pulled=made(_pulled),
            by_jax=eqx.filter_jit(function),
        )

    def __call__(self, *arguments: Any) -> Any:
        """What the function gives, with tangents."""
        given = with_no_numpy(arguments)
        arrays, fixed = _parted(given, eqx.is_array)
        leaves, tree = cast("tuple[list[Array], Any]", jax.tree.flatten(arrays))
        programs, known = self._programs, list[Any]()  # what it gives but arrays

        def arguments_of(leaves: Sequence[Any]) -> Any:
            # what is differentiated may be one of Python's own numbers
            given = [x if eqx.is_array(x) else jnp.asarray(x) for x in leaves]
            return eqx.combine(jax.tree.unflatten(tree, given), fixed)

        def shown(values: Any) -> Any:
            given, rest = _parted(values, eqx.is_array)
            known[:] = [rest]
            return given

        @jax.custom_jvp
        def call(*leaves: Array) -> Any:
            run = programs.by_jax if is_traced(leaves) else programs.values
            return shown(run(*arguments_of(leaves)))

        def call_jvp(primals: Sequence[Array], tangents: Sequence[Any]) -> Any:
            moves = tuple(not isinstance(t, SymbolicZero) for t in tangents)
            live = list(compress(tangents, moves))
            given = arguments_of(primals)
            if is_traced(primals):  # what is a derivative or a batch itself
                values, changes = _along(programs.by_jax, given, moves, live)
            elif is_traced(live):
                values, changes = self._linear(given, moves, live)
            else:
                values, changes = programs.along(given, moves, live)
            given = shown(values)
            return given, _tangents(given, changes)

        call.defjvp(call_jvp, symbolic_zeros=True)
        given = call(*leaves)
        return eqx.combine(given, known[0])

    def _linear(
        self, arguments: Any, moves: _Moves, live: list[Array]
    ) -> tuple[Any, list[Array]]:
        """Tangents that may be asked for backwards."""
        programs = self._programs
        values, push = programs.linearized(arguments, moves)
        arrays, fixed = _parted(push, eqx.is_array)
        residuals, tree = cast("tuple[list[Array], Any]", jax.tree.flatten(arrays))
        sizes = shapes_of(live)

        def push_of(residuals: Any) -> Any:
            return eqx.combine(jax.tree.unflatten(tree, residuals), fixed)

        def forward(residuals: Any, operands: Any) -> list[Array]:
            return programs.pushed(push_of(residuals), list(operands))

        def backward(residuals: Any, cotangents: Sequence[Array]) -> list[Array]:
            asked = tuple(is_asked_for(x) for x in cotangents)
            given: list[Array] = list(compress(cotangents, asked))
            return programs.pulled(push_of(residuals), sizes, asked, given)

        outputs = shapes_of(_floats(values))
        return values, linear_call(Linear(forward, backward), residuals, live, outputs)


def _parted(tree: Any, belongs: Callable[[Any], bool]) -> tuple[Any, Any]:
    return cast("tuple[Any, Any]", eqx.partition(tree, belongs))


def with_no_numpy(arguments: Any) -> Any:
    """As a jitted function sees them."""
    known: Callable[[Any], Any]
    known = lambda x: jnp.asarray(x) if isinstance(x, np.ndarray) else x
    return jax.tree.map(known, arguments)


def _floats(values: Any) -> list[Array]:
    """Numbers that have a tangent."""
    return jax.tree.leaves(_parted(values, eqx.is_inexact_array)[0])


def _tangents(values: Any, changes: Sequence[Array]) -> Any:
    """Of values, those of their floats being known."""
    left = iter(changes)

    def tangent(x: Any) -> Any:
        if eqx.is_inexact_array(x):
            return next(left)
        return np.zeros(jnp.shape(x), jax.dtypes.float0)

    return jax.tree.map(tangent, values)


class _Moving:
    """Floats that a function gives, of the arrays among its arguments that move."""

    def __init__(self, function: _Function, arguments: Any, moves: _Moves):
        arrays, self._fixed = _parted(arguments, eqx.is_array)
        flat = cast("tuple[list[Array], Any]", jax.tree.flatten(arrays))
        self._leaves, self._tree = flat
        self._function, self._moves = function, moves
        self.varied: list[Array] = list(compress(self._leaves, moves))
        self._rest: Any = None

    def __call__(self, *varied: Array) -> tuple[Any, Any]:
        """Floats, and the other arrays."""
        left, pairs = iter(varied), zip(self._leaves, self._moves, strict=True)
        mixed = [next(left) if moves else x for x, moves in pairs]
        arrays = jax.tree.unflatten(self._tree, mixed)
        values = self._function(*eqx.combine(arrays, self._fixed))
        floats, others = _parted(values, eqx.is_inexact_array)
        whole, self._rest = _parted(others, eqx.is_array)
        return floats, whole

    def values(self, floats: Any, whole: Any) -> Any:
        """All that the function gave, behind a call."""
        return eqx.combine(floats, whole, self._rest)


def _along(
    function: _Function, arguments: Any, moves: _Moves, tangents: Sequence[Array]
) -> tuple[Any, list[Array]]:
    """Values, and the changes of their floats along tangents of what moves."""
    of = _Moving(function, arguments, moves)
    floats, changes, whole = jax.jvp(of, of.varied, list(tangents), has_aux=True)
    return of.values(floats, whole), jax.tree.leaves(changes)


def _linearized(
    function: _Function, arguments: Any, moves: _Moves
) -> tuple[Any, Callable[..., Any]]:
    """Values, and how their floats change, with what that needs."""
    of = _Moving(function, arguments, moves)
    linearize = cast("Callable[..., Any]", jax.linearize)
    floats, push, whole = linearize(of, *of.varied, has_aux=True)
    # some releases leave what does not move in the function, out of the program's reach
    push = eqx.filter_closure_convert(push, *_like(of.varied))
    return of.values(floats, whole), push


def _like(arrays: Sequence[Array]) -> list[jax.ShapeDtypeStruct]:
    return [jax.ShapeDtypeStruct(x.shape, x.dtype) for x in arrays]


def _pushed(push: Callable[..., Any], tangents: list[Array]) -> list[Array]:
    return jax.tree.leaves(push(*tangents))


def _pulled(
    push: Callable[..., Any],
    sizes: tuple[ShapedArray, ...],
    asked: tuple[bool, ...],
    cotangents: list[Array],
) -> list[Array]:
    """The transpose, of the changes that are asked for."""

    def changes(*tangents: Array) -> list[Array]:
        return list(compress(_pushed(push, list(tangents)), asked))

    back = cast("Callable[..., Any]", jax.linear_transpose(changes, *sizes))
    return list(back(cotangents))
