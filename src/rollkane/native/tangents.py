"""Changes along a motion's steps, in C, as a part of XLA's programs.

Called by XLA's foreign function interface, so it is there inside of ``jax.jit``, and in
batches goes from motion to motion.
"""

import functools
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..tableau import Weights
from .compiler import compiled
from .source import advance_source, program_of, tangents_source

_MOST_LANES = 8  # numbers of 8 bytes in a vector of 64


class Way(NamedTuple):
    """The steps that a motion took; time runs forwards in ``outputs`` and ``jumps``.

    Attributes:
        record: Where steps began, and the last one ended [s], shape (n,).
        count: How many there are.
        sense: 1, or -1 where the motion went backwards in time.
        outputs: Times of outputs [s], shape (T,).
        jumps: Times of jumps [s] before which steps end, shape (k,).
    """

    record: Float[Array, " n"]
    count: Array
    sense: Array
    outputs: Float[Array, " T"]
    jumps: Float[Array, " k"]


class TangentLoop:
    """A right-hand side, and its changes, compiled together with a method's steps."""

    def __init__(
        self,
        rates: Callable,
        state: Any,
        varied: list[Any],
        weights: Weights,
        tangents: int,
    ):
        """Write the right-hand side and its changes as C and compile them.

        Args:
            rates: ``rates(t, y, *varied)`` -> rates, shape (n,).
            state: y, or its shape and type.
            varied: What has changes, apart from y: arrays, or shapes and types.
            weights: Of an explicit Runge-Kutta method.
            tangents: How many changes there are.

        Raises:
            NotElementwiseError: the right-hand side is more than arithmetic.
            NoCompilerError: no C compiler.
        """
        functions, self._closed = tangents_source(rates, state, varied)
        # one, two, four or eight
        self._lanes = min(_MOST_LANES, 1 << (tangents - 1).bit_length())
        self._tangents = tangents
        size = lambda arrays: sum(math.prod(x.shape) for x in arrays)
        head = {
            "N": state.shape[0],
            "SHARED": size([*varied, *self._closed]),
            "MOVED": size(varied),
            "STAGES": len(weights.rows),
            "NUMBERS": functions.numbers,
            "ROWS": functions.rows,
        }
        parts = _interface(), "rows.h", functions.text, advance_source(weights)
        loop = *parts, "tangent_loop.c"
        self._name = _registered(program_of(state.dtype, self._lanes, head, loop))

    def __call__(
        self, way: Way, y: Array, y_dot: Array, varied: list[Array], moved: list[Array]
    ) -> tuple[Array, Array]:
        """Changes of the states.

        Args:
            way: Steps of the motion.
            y: Its first state, shape (n,).
            y_dot: Changes of that, shape (n, P).
            varied: What the rates depend on.
            moved: Changes of that, each with an axis of length P behind.

        Returns:
            Changes of the states at the outputs, shape (T, n, P), NaN where no step
            ended on them, and of the last state, shape (n, P).
        """
        dtype, count = y.dtype, self._tangents
        groups = -(-count // self._lanes)
        room = groups * self._lanes - count

        def rows(x: Array) -> Array:
            """Shape (groups, numbers, lanes)."""
            x = jnp.pad(x.reshape(-1, count), ((0, 0), (0, room)))
            return jnp.moveaxis(x.reshape(-1, groups, self._lanes), 1, 0)

        def back(x: Array) -> Array:
            x = jnp.moveaxis(x, 0, -2)
            return x.reshape(*x.shape[:-2], groups * self._lanes)[..., :count]

        flat = [jnp.ravel(x) for x in (*varied, *self._closed)]
        nothing = jnp.zeros((0, count), dtype)
        changes = [x.reshape(-1, count) for x in moved]
        shape = lambda *axes: jax.ShapeDtypeStruct((groups, *axes, self._lanes), dtype)
        # whole numbers up to 2^24 are exact in single precision, too
        called = jax.ffi.ffi_call(
            self._name,
            (shape(way.outputs.shape[0], y.shape[0]), shape(y.shape[0])),
            vmap_method="broadcast_all",
        )
        shown, last = called(
            jnp.concatenate([jnp.zeros(0, dtype), *flat]),
            rows(jnp.concatenate([nothing, *changes])),
            y,
            rows(y_dot),
            way.record,
            way.count.astype(dtype),
            way.sense,
            way.outputs,
            way.jumps,
        )
        return back(shown), back(last)


@functools.cache
def _interface() -> str:
    """XLA's own header, of the release that is installed."""
    return Path(jax.ffi.include_dir(), "xla", "ffi", "api", "c_api.h").read_text()


@functools.cache
def _registered(source: str) -> str:
    """The name under which XLA knows a compiled loop."""
    library = compiled(source)
    name = f"rollkane_{Path(library._name).stem}"
    capsule = jax.ffi.pycapsule(library.push_from_xla)
    jax.ffi.register_ffi_target(name, capsule, platform="cpu")
    return name
