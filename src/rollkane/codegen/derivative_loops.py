"""Changes along a motion's steps, and back along them, in C within XLA's programs.

Called by XLA's foreign function interface, so they are there inside of ``jax.jit``, and
in batches go from motion to motion.
"""

import math
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .compiler import lanes_of
from .compiler_shares import apart
from .device_program import Kernel
from .ffi_call import XlaCall, in_one
from .jaxpr_types import Shaped
from .opened import opened
from .right_hand_side import cotangents_source, tangents_source
from .runge_kutta_source import of_bearable_length, pull_source, push_source
from .scalar_program import NotElementwiseError
from .tableau import Weights

_BUFFERS = {"MOST_GIVEN": 10, "MOST_RESULTS": 2}  # arguments and results of a loop
_STEPS = ("along_steps.h",)  # before what is written for it


class Way(NamedTuple):
    """The steps that a motion took; time runs forwards in ``outputs`` and ``jumps``.

    Attributes:
        record: Where steps began, and the last one ended [s], shape (n,).
        count: How many there are, as a float (up to 2^24 exact in single precision).
        sense: 1, or -1 where the motion went backwards in time.
        outputs: Times of outputs [s], shape (T,).
        jumps: Ends of steps [s] and, behind those of them that are before a jump, where
            the next ones begin, else the same, in order, shape (2, k).
    """

    record: Float[Array, " n"]
    # a tuple has a method of this name, which is not wanted of these
    count: Float[Array, ""]  # pyright: ignore[reportIncompatibleMethodOverride]
    sense: Float[Array, ""]
    outputs: Float[Array, " T"]
    jumps: Float[Array, "2 k"]


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
        # one, two, four or eight, in single precision, too
        count = changes.shape[-1]
        most = lanes_of(np.float64)
        lanes = self._lanes = min(most, 1 << (count - 1).bit_length())
        self._varied, self._closed = rates.varied, made.closed
        head = _sizes(rates, state) | {
            "ROWS": made.functions.rows,
            "NUMBERS": made.functions.numbers,
        }
        texts = of_bearable_length((made.functions.text, push_source(rates.weights)))
        there, others = apart(texts)

        def kernel() -> Kernel:
            return Kernel(
                dtype=np.dtype(state.dtype),
                head=(*head.items(), *_BUFFERS.items(), ("SPREAD", lanes)),
                parts=(*_STEPS, *texts, "tangent_loop.c", "device_tangents.c"),
                axes=(1, 3, 1, 3, 1, 0, 0, 1, 2),
                results=2,
                result_axes=4,
                spread=(3, state.shape[0]),
            )

        parts = "threads.h", *_STEPS, *there, "tangent_loop.c", "tangent_call.c"
        self._call = XlaCall(state.dtype, lanes, head, parts, others, kernel=kernel)

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
    """Cotangents back along steps: of one motion, or of those of a batch in lanes."""

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
        self._rates, self._between = rates, between
        self._state = jax.ShapeDtypeStruct(state.shape, state.dtype)
        self._function, self._known = opened(rates.function, self._state, rates.varied)
        self._call = self._compiled([False] * (len(rates.varied) + len(self._known)), 1)

    def _compiled(self, own: list[bool], lanes: int) -> XlaCall:
        """The loop of one motion, or of lanes where these leaves are their own."""
        rates, state = self._rates, self._state
        like = rates.varied, self._known
        made = cotangents_source(self._function, state, *like, own)
        assert made.back is not None
        pairs = zip([*rates.varied, *self._known], own, strict=True)
        head = _sizes(rates, state) | {
            "BETWEEN": self._between,
            "NUMBERS": made.functions.numbers,
            "ROWS": made.functions.rows,
            "BACK_NUMBERS": made.back.numbers,
            "BACK_ROWS": made.back.rows,
            "OWN": sum(x.size for x, differs in pairs if differs),
            **_BUFFERS,
        }
        both = made.functions.text, made.back.text
        texts = of_bearable_length((*both, pull_source(rates.weights)))
        there, others = apart(texts)
        alone = "cotangent_loop.c", "cotangent_call.c"
        loop = alone if lanes == 1 else ("cotangent_lanes.c",)
        by_own = lanes != 1

        def kernel() -> Kernel:
            axes = 2, 2, 1, 1, 0, 0, 1, 2  # of what is told of each motion
            return Kernel(
                dtype=np.dtype(state.dtype),
                head=(*head.items(), ("BY_OWN", int(by_own))),
                parts=(*_STEPS, *texts, "cotangent_loop.c", "device_cotangents.c"),
                axes=(1, 1, *axes) if by_own else (1, *axes),
                results=2,
                result_axes=1,
                spread=(4 if by_own else 3, state.shape[0]),
            )

        parts = "threads.h", *_STEPS, *there, *loop
        # at -O3 that of one motion takes twice as long to compile (the isolator's 2 s),
        # and gradients 5 to 14 % less; batches, which run longer, take up to 15 % less
        effort = "-O2" if lanes == 1 else ""
        return XlaCall(state.dtype, lanes, head, parts, others, effort, kernel)

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
        call = jax.custom_batching.custom_vmap(self._alone)

        @call.def_vmap
        def _(
            size: int,
            batched: list[Any],
            leaves: list[Array],
            along: tuple[Array, ...],
        ) -> tuple[list[Array], list[bool]]:
            differ, others = batched
            try:
                loop = self._compiled(list(differ), lanes_of(self._state.dtype))
            except NotElementwiseError:
                axis: Callable[[bool], int | None] = lambda x: 0 if x else None
                axes = jax.tree.map(axis, (list(differ), tuple(others)))
                found = jax.vmap(self._alone, in_axes=axes)(leaves, along)
                return found, [True, True]
            ahead: Callable[[Array, bool], Array] = lambda x, theirs: (
                x if theirs else x[None]
            )
            pairs = [
                (ahead(x, theirs).reshape(size if theirs else 1, -1), theirs)
                for x, theirs in zip(leaves, differ, strict=True)
            ]
            none = jnp.zeros((1, 0), self._state.dtype)
            shared = [none, *(x for x, theirs in pairs if not theirs)]
            own = [x for x, theirs in pairs if theirs]
            own = [jnp.broadcast_to(none, (size, 0)), *own]
            given = [ahead(x, theirs) for x, theirs in zip(along, others, strict=True)]
            both = jnp.concatenate(shared, axis=1), jnp.concatenate(own, axis=1)
            shapes = [(size, *shape) for shape in self._shapes]
            return loop(tuple(shapes), *both, *given), [True, True]

        leaves = [*self._rates.varied, *self._known]
        back, of_varied = call(leaves, (kept, cotangents, last_cotangent, *way))
        sizes = [math.prod(x.shape) for x in self._rates.varied]
        parts = jnp.split(of_varied, np.cumsum(sizes)[:-1]) if sizes else []
        pairs = zip(parts, self._rates.varied, strict=True)
        return back, [part.reshape(like.shape) for part, like in pairs]

    @property
    def _shapes(self) -> tuple[tuple[int, ...], ...]:
        """Of the cotangents of a motion's first state and of what is varied."""
        return self._state.shape, (sum(x.size for x in self._rates.varied),)

    def _alone(self, leaves: list[Array], along: tuple[Array, ...]) -> list[Array]:
        """Of one motion; in a batch one after the other on every processor."""
        shared = in_one(leaves, self._state.dtype)
        return self._call(self._shapes, shared, *along)


def _sizes(rates: Rates, state: Shaped) -> dict[str, int]:
    size: Callable[[Iterable[Shaped]], int]
    size = lambda arrays: sum(math.prod(x.shape) for x in arrays)
    return {
        "N": state.shape[0],
        "VARIED": size(rates.varied),
        "STAGES": len(rates.weights.rows),
    }
