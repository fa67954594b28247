"""One run in the loop over lanes, within XLA's programs."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..tableau import Weights
from .right_hand_side import lanes_source
from .step_source import attempt_source
from .xla_call import XlaCall, in_one


class Course(NamedTuple):
    """Where a run is to go, and how; time runs forwards but in ``time``.

    Attributes:
        time: First time [s].
        sense: 1, or -1 where time runs backwards.
        rtol: Relative tolerance of a step [1].
        atol: Absolute tolerance of each number, shape (n,).
        dtmin: Least step [s].
        first_step: [s].
        ends: Where steps have to end [s], in order, shape (k,); infinite behind the
            last.
        begins: Where the next ones begin: behind a jump [s], shape (k,).
        outputs: Times of outputs after the first [s], shape (T - 1,).
    """

    time: Array
    sense: Array
    rtol: Array
    atol: Float[Array, " n"]
    dtmin: Array
    first_step: Array
    ends: Float[Array, " k"]
    begins: Float[Array, " k"]
    outputs: Float[Array, " T-1"]


class Ended(NamedTuple):
    """What came out.

    Attributes:
        y: At the outputs after the first, shape (T - 1, n); NaN where not reached.
        final_y: Shape (n,).
        final_time: [s].
        code: One of :class:`rollkane.Code`.
        steps: Accepted.
        rejected_steps: The others.
        record: Where steps began, and the last one ended [s], then states where every
            so manieth step began; any numbers behind. None where they are not wanted.
    """

    y: Float[Array, "T-1 n"]
    final_y: Float[Array, " n"]
    final_time: Array
    code: Array
    steps: Array
    rejected_steps: Array
    record: tuple[Array, Array] | None


class RunLoop:
    """A right-hand side compiled together with the loop that integrates it."""

    def __init__(
        self,
        derivative: Callable,
        state: Any,
        leaves: list[Array],
        weights: Weights,
        zeros: Sequence[bytes] | None = None,
        between: int = 0,
        watch: Callable | None = None,
    ):
        """Write the right-hand side as C and compile it.

        Args:
            derivative: ``derivative(t, y, *leaves)`` -> rates, shape (n,).
            state: y, or its shape and type.
            leaves: Of the model.
            weights: Of an explicit Runge-Kutta pair.
            zeros: Of each leaf, which numbers are zero; see ``lanes_source``.
            between: How many steps from one recorded state to the next; 0: no record.
            watch: Vectors that no step may reverse; see ``lanes_source``.

        Raises:
            NotElementwiseError: the right-hand side is more than arithmetic.
            NoCompilerError: no C compiler.
        """
        state = jax.ShapeDtypeStruct(state.shape, state.dtype)
        own = [False] * len(leaves)
        made = lanes_source(derivative, state, leaves, own, zeros, watch)
        self._shared = in_one([*leaves, *made.closed], state.dtype)
        self._between = between
        head = {
            "N": state.shape[0],
            "OWN": 0,
            "STAGES": len(weights.rows) + 1,
            "ORDER": weights.order,
            "RECORD": int(between > 0),
            "BETWEEN": between,
            **made.head,
        }
        parts = (
            made.text,
            attempt_source(weights),
            "lane_loop.c",
            "run_call.c",
        )
        self._call = XlaCall(state.dtype, 1, head, parts)

    def __call__(self, y: Array, course: Course, most: int) -> Ended:
        """Integrate a start, with this many steps at most, rejected ones too."""
        n, dtype = y.shape[0], y.dtype
        shapes: list[tuple[int, ...]] = [(*course.outputs.shape, n), (n,), (4,)]
        if self._between:
            shapes += [(most + 1,), (most // self._between + 1, n)]
        numbers = course.time * course.sense, course.sense, course.rtol, course.dtmin
        numbers = jnp.stack([*numbers, course.first_step, jnp.asarray(most, dtype)])
        stops = course.ends, course.begins, course.outputs
        found = self._call(tuple(shapes), self._shared, y, course.atol, numbers, *stops)
        y, final_y, told, *record = found
        whole = told[1:].astype(int)
        steps = (record[0], record[1]) if record else None
        return Ended(y, final_y, told[0], *whole, record=steps)
