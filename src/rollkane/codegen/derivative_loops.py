"""Changes along a motion's steps, and back along them, in C within XLA's programs.

Called by XLA's foreign function interface, so they are there inside of ``jax.jit``, and
in batches go from motion to motion.
"""

import math
from collections.abc import Callable, Iterable
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .ffi_call import XlaCall, in_one
from .jaxpr_types import Shaped
from .right_hand_side import cotangents_source, tangents_source
from .runge_kutta_source import of_bearable_length, pull_source, push_source
from .tableau import Weights

_MOST_LANES = 8  # numbers of 8 bytes in a vector of 64
_ALONG = "along_steps.h", "threads.h"


class Way(NamedTuple):
    """The steps that a motion took; time runs forwards in ``outputs`` and ``jumps``.

    Attributes:
        record: Where steps began, and the last one ended [s], shape (n,).
        count: How many there are, as a float (up to 2^24 exact in single precision).
        sense: 1, or -1 where the motion went backwards in time.
        outputs: Times of outputs [s], shape (T,).
        jumps: Times of jumps [s] before which steps end, shape (k,).
    """

    record: Float[Array, " n"]
    # a tuple has a method of this name, which is not wanted of these
    count: Float[Array, ""]  # pyright: ignore[reportIncompatibleMethodOverride]
    sense: Float[Array, ""]
    outputs: Float[Array, " T"]
    jumps: Float[Array, " k"]


class Rates(NamedTuple):
    """What is differentiated.

    Attributes:
        function: ``function(t, y, *varied)`` -> rates, shape (n,).
        varied: What it depends on differentiably, apart from y.
        weights: Of an explicit Runge-Kutta method.
    """

    function: Callable[..., Array]
    varied: list[Array]
    weights: Weights


class TangentLoop:
    """Changes along steps."""

    def __init__(self, rates: Rates, state: Shaped, changes: Shaped):
        """Write the right-hand side and its changes as C and compile them.

        Args:
            rates: What is differentiated.
            state: y, or its shape and type.
            changes: Of it, shape (n, P), or their shape and type.

        Raises:
            NotElementwiseError: the right-hand side is more than arithmetic.
            NoCompilerError: no C compiler.
        """
        made = tangents_source(rates.function, state, rates.varied)
        # one, two, four or eight
        count = changes.shape[-1]
        self._lanes = min(_MOST_LANES, 1 << (count - 1).bit_length())
        self._varied, self._closed = rates.varied, made.closed
        head = _sizes(rates, state) | {"ROWS": made.functions.rows}
        head["NUMBERS"] = made.functions.numbers
        texts = made.functions.text, push_source(rates.weights)
        parts = (
            "along_steps.h",
            "threads.h",
            *of_bearable_length(texts),
            "tangent_loop.c",
        )
        self._call = XlaCall(state.dtype, self._lanes, head, parts)

    def __call__(
        self, way: Way, y: Array, y_dot: Array, tangents: list[Array]
    ) -> tuple[Array, Array]:
        """Changes of the states.

        Args:
            way: Steps of the motion.
            y: Its first state, shape (n,).
            y_dot: Changes of that, shape (n, P).
            tangents: Changes of what is varied, each with an axis of length P behind.

        Returns:
            Changes of the states at the outputs, shape (T, n, P), NaN where no step
            ended on them, and of the last state, shape (n, P).
        """
        count = y_dot.shape[-1]
        groups = -(-count // self._lanes)
        padded = groups * self._lanes

        def rows(x: Array) -> Array:
            """Shape (groups, numbers, lanes)."""
            x = jnp.pad(x, ((0, 0), (0, padded - count)))
            return jnp.moveaxis(x.reshape(-1, groups, self._lanes), 1, 0)

        def back(x: Array) -> Array:
            x = jnp.moveaxis(x, 0, -2)
            return x.reshape(*x.shape[:-2], padded)[..., :count]

        shared = in_one([*self._varied, *self._closed], y.dtype)
        changes = [x.reshape(-1, count) for x in tangents]
        changes = jnp.concatenate([jnp.zeros((0, count), y.dtype), *changes])
        sizes = (
            (groups, *way.outputs.shape, *y.shape, self._lanes),
            (groups, *y.shape, self._lanes),
        )
        shown, last = self._call(sizes, shared, rows(changes), y, rows(y_dot), *way)
        return back(shown), back(last)


class CotangentLoop:
    """Cotangents back along steps."""

    def __init__(self, rates: Rates, state: Shaped, between: int):
        """Write the right-hand side and the way back through it as C and compile them.

        Args:
            rates: What is differentiated.
            state: y, or its shape and type.
            between: Steps from one recorded state to the next.

        Raises:
            NotElementwiseError: the right-hand side is more than arithmetic.
            NoCompilerError: no C compiler.
        """
        made = cotangents_source(rates.function, state, rates.varied)
        self._varied, self._closed = rates.varied, made.closed
        assert made.back is not None
        head = _sizes(rates, state) | {"BETWEEN": between}
        head["NUMBERS"] = made.functions.numbers
        head["BACK_NUMBERS"] = made.back.numbers
        texts = made.functions.text, made.back.text, pull_source(rates.weights)
        parts = (
            "along_steps.h",
            "threads.h",
            *of_bearable_length(texts),
            "cotangent_loop.c",
        )
        self._call = XlaCall(state.dtype, 1, head, parts)

    def __call__(
        self, way: Way, kept: Array, cotangents: Array, last_cotangent: Array
    ) -> tuple[Array, list[Array]]:
        """Cotangents of the first state, shape (n,), and of what is varied.

        Args:
            way: Steps of the motion.
            kept: Recorded states, shape (m, n).
            cotangents: Cotangents of the states at the outputs, shape (T, n).
            last_cotangent: Of the last state, shape (n,).
        """
        shared = in_one([*self._varied, *self._closed], cotangents.dtype)
        sizes = [math.prod(x.shape) for x in self._varied]
        shapes = last_cotangent.shape, (sum(sizes),)
        back, of_varied = self._call(
            shapes, shared, kept, cotangents, last_cotangent, *way
        )
        parts = jnp.split(of_varied, np.cumsum(sizes)[:-1]) if sizes else []
        pairs = zip(parts, self._varied, strict=True)
        return back, [part.reshape(like.shape) for part, like in pairs]


def _sizes(rates: Rates, state: Shaped) -> dict[str, int]:
    size: Callable[[Iterable[Shaped]], int]
    size = lambda arrays: sum(math.prod(x.shape) for x in arrays)
    return {
        "N": state.shape[0],
        "VARIED": size(rates.varied),
        "STAGES": len(rates.weights.rows),
    }
