"""The compiled loop over lanes, from Python: queues of motions in, results out."""

import ctypes
import functools
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Array, Float, Int

from .compiler import Program, lanes_of, program_of
from .jaxpr_types import Shaped
from .right_hand_side import Looked, lanes_source
from .run_watch import follow
from .runge_kutta_source import attempt_source
from .tableau import Weights


class Stops(NamedTuple):
    """Where lanes have to stop, in order, the last of them the end.

    Attributes:
        ends: [s], shape (K,).
        starts: Where the next step begins: behind a jump [s], shape (K,).
        slots: Which output it is, shape (K,); -1 for none, a corner of the motion.
        outputs: How many outputs there are.
    """

    ends: Float[np.ndarray, " K"]
    starts: Float[np.ndarray, " K"]
    slots: Int[np.ndarray, " K"]
    outputs: int


class Queue(NamedTuple):
    """What is to be integrated.

    Attributes:
        starts: Packed states at the first time, shape (M, n).
        atol: Absolute tolerance of each number, shape (M, n).
        first_steps: [s], shape (M,).
        own: Numbers of the model that differ from motion to motion, shape (M, p).
        shared: Numbers that all motions share, shape (q,).
        time: First time [s].
        rtol: Relative tolerance of a step [1].
        dtmin: Least step [s].
        max_steps: Most steps of a motion, rejected ones too.
        sense: 1, or -1 where time runs backwards: it runs forwards in the loop.
    """

    starts: Float[np.ndarray, "M n"]
    atol: Float[np.ndarray, "M n"]
    first_steps: Float[np.ndarray, " M"]
    own: Float[np.ndarray, "M p"]
    shared: Float[np.ndarray, " q"]
    time: float
    rtol: float
    dtmin: float
    max_steps: int
    sense: float = 1.0


class Results(NamedTuple):
    """What came out, by motion.

    Attributes:
        y: At the outputs, shape (M, T, n); NaN where not reached.
        code: One of :class:`rollkane.Code`, shape (M,).
        final_time: [s], backwards in time too, shape (M,).
        final_y: Shape (M, n).
        steps: Accepted, shape (M,).
        rejected_steps: Shape (M,).
        turns: Steps of the whole row of lanes, waited through or not.
        fault: Of each motion, which field cannot be used, shape (M,); None: not looked
            at here.
        moments: When events happened [s] and the states there, shape (M, R, 1 + n);
            unused places NaN. None where none are looked for.
        numbers: How often each did, and which one ended the motion, -1: none, shape
            (M, E + 1).
    """

    y: Float[np.ndarray, "M T n"]
    code: Int[np.ndarray, " M"]
    final_time: Float[np.ndarray, " M"]
    final_y: Float[np.ndarray, "M n"]
    steps: Int[np.ndarray, " M"]
    rejected_steps: Int[np.ndarray, " M"]
    turns: int
    fault: Int[np.ndarray, " M"] | None = None
    moments: Float[np.ndarray, "M R m"] | None = None
    numbers: Int[np.ndarray, "M e"] | None = None


class LaneLoop:
    """A right-hand side compiled together with the loop that integrates it.

    Attributes:
        lanes: How many motions advance together.
    """

    def __init__(
        self,
        derivative: Callable[..., Array],
        state: jax.ShapeDtypeStruct,
        leaves: Sequence[Shaped],
        own: list[bool],
        weights: Weights,
        lanes: int | None = None,
        zeros: Sequence[bytes] | None = None,
        extended: bool = False,
        watch: Callable[..., Array] | None = None,
        events: Looked | None = None,
    ):
        """Write the right-hand side as C and compile it.

        Args:
            derivative: ``derivative(t, y, *leaves)`` -> rates, shape (n,).
            state: Shape and type of y.
            leaves: Shapes and types of the model's leaves for one motion.
            own: Which of them differ from motion to motion.
            weights: Of an explicit Runge-Kutta pair.
            lanes: How many; what a vector of 64 bytes holds by default.
            zeros: Of each leaf, which numbers are zero for all; None: not known.
            extended: Whether it computes with C's long doubles, of 64 bits on most
                processors, and one motion after the other.
            watch: Vectors that no step may reverse; see ``lanes_source``.
            events: What is looked for; see ``lanes_source``.

        Raises:
            NotElementwiseError: the right-hand side is more than arithmetic.
            NoCompilerError: no C compiler.
        """
        self.dtype = np.dtype(np.longdouble if extended else state.dtype)
        lanes = 1 if extended else lanes
        lanes = lanes_of(self.dtype) if lanes is None else lanes
        self.lanes = lanes
        self._events = None if events is None else events.layout
        made = lanes_source(derivative, state, leaves, own, zeros, watch, events)
        sizes = [
            math.prod(leaf.shape)
            for leaf, differs in zip(leaves, own, strict=True)
            if differs
        ]
        head = {
            "N": state.shape[0],
            "OWN": sum(sizes),
            "STAGES": len(weights.rows) + 1,
            "ORDER": weights.order,
            "RECORD": 0,
            **made.head,
        }
        parts = "rows.h", "watch.h", made.text, attempt_source(weights), *made.loop
        self.source = program_of(self.dtype, lanes, head, parts)
        self._library = Program.of(self.source).loaded()
        follow(self._library)
        self._library.integrate.restype = ctypes.c_int64
        sizes = ctypes.c_float, ctypes.c_double, ctypes.c_longdouble
        self._real = next(x for x in sizes if ctypes.sizeof(x) == self.dtype.itemsize)

    def run(self, queue: Queue, stops: Stops) -> Results:
        """Integrate a queue of motions; other threads of Python go on meanwhile.

        Without stops there is no time to go to, and every motion ends where it begins.
        """
        count, n = queue.starts.shape
        layout = self._events
        size = 4 if layout is None else 5 + len(layout.ways)

        def empty(*shape: int) -> np.ndarray:
            return np.full((count, *shape), np.nan, self.dtype)

        y, final_y, told = empty(stops.outputs, n), empty(n), empty(size)
        moments = None if layout is None else empty(layout.capacity, 1 + n)
        turns = 0
        if len(stops.ends):
            filled = [x for x in (y, final_y, told, moments) if x is not None]
            turns = self._filled(queue, stops, filled)
        else:
            final_y[:], told[:, 0] = queue.starts, queue.sense * queue.time
            told[:, 1:4], told[:, 4:-1], told[:, 4:][:, -1:] = 0, 0, -1
        whole = told[:, 1:].astype(np.int64)
        return Results(
            y=y,
            code=whole[:, 0].astype(np.int32),
            final_time=told[:, 0],
            final_y=final_y,
            steps=whole[:, 1],
            rejected_steps=whole[:, 2],
            turns=turns,
            moments=moments,
            numbers=None if layout is None else whole[:, 3:],
        )

    def _filled(self, queue: Queue, stops: Stops, results: list[np.ndarray]) -> int:
        """Fill what ``Results`` of lane_loop.c has; the steps of the whole row."""
        reals = [
            np.ascontiguousarray(x, self.dtype)
            for x in (
                *(queue.starts, queue.own, queue.shared, queue.atol),
                *(queue.first_steps, stops.ends, stops.starts),
            )
        ]
        slots = np.ascontiguousarray(stops.slots, np.int64)
        asked = _queue_type(self._real)(
            *(len(queue.starts), stops.outputs, len(slots)),
            *(x.ctypes.data for x in (*reals, slots)),
            *(queue.time, queue.rtol, queue.dtmin, queue.sense),
            queue.max_steps,
        )
        places = [x.ctypes.data for x in results]
        outputs = (ctypes.c_void_p * len(places))(*places)
        return self._library.integrate(ctypes.byref(asked), ctypes.byref(outputs))


@functools.cache
def _queue_type(real: Any) -> Any:
    """``Queue`` of lane_loop.c."""
    fields: list[Any] = [
        (name, ctypes.c_long) for name in ("count", "outputs", "stops")
    ]
    fields += [(f"array_{i}", ctypes.c_void_p) for i in range(8)]
    fields += [(name, real) for name in ("time", "rtol", "dtmin", "sense")]
    # of any length here: NULL
    fields += [("max_steps", ctypes.c_int64), ("longest", ctypes.c_void_p)]
    return type("Queue", (ctypes.Structure,), {"_fields_": fields})
