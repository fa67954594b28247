"""Runs in the loop over lanes, within XLA's programs: one, or a batch."""

import functools
import math
from collections.abc import Callable, Sequence
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
from .platforms import platform
from .right_hand_side import Looked, lanes_source
from .runge_kutta_source import attempt_source, of_bearable_length
from .scalar_program import NotElementwiseError
from .step_ends import StepEnds
from .tableau import Weights
from .tracing import becoming_c


class Course(NamedTuple):
    """Where a run is to go, and how; time runs forwards but in ``time``.

    Attributes:
        time: First time [s].
        sense: 1, or -1 where time runs backwards.
        rtol: Relative tolerance of a step [1].
        atol: Absolute tolerance of each number, shape (n,).
        dtmin: Least step [s].
        longest: Longest step [s].
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
    longest: Array
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
            nth step began; any numbers behind. None where they are not wanted.
        happened: When events did [s] and the states there, shape (R, 1 + n), unused
            places NaN; how often each did, shape (E,); which one ended the run, -1:
            none. None where none are looked for.
    """

    y: Float[Array, "T-1 n"]
    final_y: Float[Array, " n"]
    final_time: Array
    code: Array
    steps: Array
    rejected_steps: Array
    record: tuple[Array, Array] | None
    happened: tuple[Array, Array, Array] | None = None


# a loop's arguments; of them first states, first steps, and ends of steps
_GIVEN = 10
_STARTS, _FIRST_STEPS, _ENDS = 2, 4, 7
# a first state, its absolute tolerances, the first and the longest step
_Start = tuple[Array, Array, Array, Array]


class RunLoop:
    """A right-hand side compiled together with the loop that integrates it.

    One motion, or under ``jax.vmap`` all of a batch, in lanes, on every processor.
    """

    def __init__(
        self,
        derivative: Callable[..., Array],
        state: Shaped,
        leaves: list[Array],
        weights: Weights,
        zeros: Sequence[bytes] | None = None,
        between: int = 0,
        watch: Callable[..., Array] | None = None,
        events: Looked | None = None,
        ends: Callable[..., Array] | None = None,
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
            events: What is looked for; see ``lanes_source``.
            ends: ``ends(t, y, *leaves)`` -> whether a step may end there; None:
                anywhere.

        Raises:
            NotElementwiseError: the right-hand side is more than arithmetic, or on a
                GPU it is asked where steps may end.
            NoCompilerError: no C compiler.
        """
        state = jax.ShapeDtypeStruct(state.shape, state.dtype)
        zeros = [b""] * len(leaves) if zeros is None else zeros
        self._rates, closed = opened(derivative, state, leaves)
        self._watch: Callable[..., Array] | None = None
        seen: list[Array] = []
        if watch is not None:
            self._watch, seen = opened(watch, state, leaves, len(closed))
        known = [*closed, *seen]
        self._events = events
        if events is not None:
            values, more = opened(events.values, state, leaves, len(known))
            self._events = events._replace(values=values)
            known += more
        self._ends: Callable[..., Array] | None = None
        if ends is not None:
            if platform() == "cuda":
                raise NotElementwiseError("a look over all of both surfaces")
            with becoming_c():
                self._ends, more = opened(ends, state, leaves, len(known))
            known += more
        self._leaves = [*leaves, *known]
        self._zeros = [*zeros, *[b""] * len(known)]
        self._state, self._weights, self._between = state, weights, between
        self._one = self._compiled([False] * len(self._leaves), 1, "run_call.c")

    def _compiled(self, own: list[bool], lanes: int, caller: str) -> XlaCall:
        """The loop, for leaves some of which differ from motion to motion."""
        state, weights = self._state, self._weights
        like = [jax.ShapeDtypeStruct(x.shape, x.dtype) for x in self._leaves]
        zeros = [
            b"" if differs else known
            for known, differs in zip(self._zeros, own, strict=True)
        ]
        looked = self._watch, self._events
        made = lanes_source(self._rates, state, like, own, zeros, *looked)
        sizes = zip(like, own, strict=True)
        head = {
            "N": state.shape[0],
            "OWN": sum(math.prod(x.shape) for x, differs in sizes if differs),
            "STAGES": len(weights.rows) + 1,
            "ORDER": weights.order,
            "RECORD": int(self._between > 0),
            "BETWEEN": self._between,
            "MOST_GIVEN": _GIVEN,
            "MOST_RESULTS": 7,
            **made.head,
        }
        known = of_bearable_length((made.text, attempt_source(weights)))
        around = *made.loop, "queue.h"
        before: tuple[str, ...] = ()
        there, further = apart(known)
        if self._ends is not None:
            asked = StepEnds(self._ends, state, like, own, zeros)
            most = max(_GIVEN, asked.program.head["MOST_GIVEN"])
            head |= asked.head | {"MOST_GIVEN": most}
            before, further = asked.parts, (*further, *asked.program.further)
        alone = lanes == 1

        def kernel() -> Kernel:
            there = {"MOST_GIVEN": _GIVEN + 1}  # and an order of the motions
            results = 3 + (self._events is not None) + 2 * head["RECORD"]
            return Kernel(
                dtype=np.dtype(state.dtype),
                head=(*(head | there).items(), ("ALONE", int(alone))),
                parts=(*known, *around, "device_runs.c"),
                axes=(1,) * _GIVEN if alone else (1, 2, 2, 2, *(1,) * (_GIVEN - 4)),
                results=results,
                result_axes=2 if alone else 3,
                spread=(_STARTS, state.shape[0]),
                stops=_ENDS,
                by_members=not alone,
                shortest=None if alone else _FIRST_STEPS,
            )

        parts = *before, "threads.h", *there, *around, caller
        return XlaCall(state.dtype, lanes, head, parts, further, kernel=kernel)

    def __call__(self, y: Array, course: Course, most: int) -> Ended:
        """Integrate a start, with this many steps at most, rejected ones too."""
        dtype = y.dtype
        numbers = course.time * course.sense, course.sense, course.rtol, course.dtmin
        numbers = jnp.stack([*numbers, jnp.asarray(most, dtype)])
        alone = functools.partial(self._alone, most)
        call = jax.custom_batching.custom_vmap(alone)

        @call.def_vmap
        def _(
            size: int,
            batched: list[Any],
            leaves: list[Array],
            start: _Start,
            *course: Array,
        ) -> tuple[list[Array], list[bool]]:
            differs, begun, *others = batched
            loop = None
            if not any(others):
                loop = self._of_lanes(tuple(differs))
            if loop is None:  # at times or by tables of their own
                axis: Callable[[bool], int | None] = lambda x: 0 if x else None
                axes = jax.tree.map(axis, tuple(batched))
                found = jax.vmap(alone, in_axes=axes)(leaves, start, *course)
            else:
                spread: Callable[[Array, bool], Array] = lambda x, theirs: (
                    x if theirs else jnp.broadcast_to(x, (size, *x.shape))
                )
                every = list(map(spread, start, begun))
                pairs = list(zip(leaves, differs, strict=True))
                own = [x.reshape(size, -1) for x, theirs in pairs if theirs]
                own = jnp.concatenate([jnp.zeros((size, 0), dtype), *own], axis=1)
                shared = in_one([x for x, theirs in pairs if not theirs], dtype)
                shapes = [(size, *shape) for shape in self._shapes(most, course[-1])]
                found = loop(tuple(shapes), shared, own, *every, *course)
            return found, [True] * len(found)

        start = y, course.atol, course.first_step, course.longest
        stops = course.ends, course.begins, course.outputs
        y, final_y, told, *others = call(self._leaves, start, numbers, *stops)
        whole = told[1:].astype(int)
        moments = others.pop(0) if self._events is not None else None
        steps = (others[0], others[1]) if others else None
        ended = Ended(y, final_y, told[0], *whole[:3], record=steps)
        if moments is None:
            return ended
        return ended._replace(happened=(moments, whole[3:-1], whole[-1]))

    def _shapes(self, most: int, outputs: Array) -> list[tuple[int, ...]]:
        """Of what a motion of so many steps leaves."""
        n = self._state.shape[0]
        shapes: list[tuple[int, ...]] = [(outputs.shape[-1], n), (n,)]
        if self._events is None:
            shapes.append((4,))
        else:
            layout = self._events.layout
            shapes += [(5 + len(layout.ways),), (layout.capacity, 1 + n)]
        if self._between:
            shapes += [(most + 1,), (most // self._between + 1, n)]
        return shapes

    def _alone(
        self,
        most: int,
        leaves: list[Array],
        start: _Start,
        numbers: Array,
        ends: Array,
        begins: Array,
        outputs: Array,
    ) -> list[Array]:
        """One motion; in a batch one after the other."""
        y, atol, first_step, longest = start
        shared = in_one(leaves, y.dtype)
        given = shared, shared[:0], y, atol, first_step[None], longest[None]
        given = *given, numbers, ends, begins, outputs
        return self._one(tuple(self._shapes(most, outputs)), *given)

    def _of_lanes(self, differs: tuple[bool, ...]) -> XlaCall | None:
        """The loop for a batch at the same times; None: not where tables differ."""
        lanes = lanes_of(self._state.dtype)
        try:
            return self._compiled(list(differs), lanes, "batch_call.c")
        except NotElementwiseError:
            return None
