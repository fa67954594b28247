"""A right-hand side in C: for rows of motions, and with its derivatives."""

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..validation.checks import is_traced
from ..validation.remembered import holds_no_numpy, remembered
from .data_movement import Numbers, as_objects, numbers_of
from .derivatives import jvp, pulled
from .event_layout import Layout
from .jaxpr_types import Shaped
from .scalar_program import FEW, NotElementwiseError, Program
from .scalar_source import (
    Functions,
    Result,
    Statements,
    array,
    as_functions,
    in_order,
    symbols,
)

# Numbers of an array whose zeros are structure: frames and inertias of a few bodies.
# Each other pattern of zeros is a program of its own.
_MOST_ZEROS = 64
# A step may come no nearer to zero with a vector that it must not reverse, in relative
# tolerances: nearer, it may turn the vector by any angle within its error. Loose runs
# may come to 1 / CLOSEST, below what such tolerances are asked for
_NEAREST, CLOSEST = 10, 100
_WITH_EVENTS = "lane_math.h", "event_search.c", "lane_loop.c"


def least_product(rtol: Any) -> Any:
    """What two vectors have to exceed by their dot product for a step to join them."""
    nearest = jnp.minimum(_NEAREST * rtol, 1.0 / CLOSEST)
    return nearest * nearest


@remembered(lambda x: isinstance(x, jax.Array))  # looking takes 5 us
def zeros_of(x: Any) -> bytes:
    """Which numbers of an array are zero, one byte for each.

    No bytes if it is none, is traced, holds keys of random numbers, or is too large for
    its zeros to be its structure.
    """
    of_numbers = isinstance(getattr(x, "dtype", None), np.dtype)
    if not of_numbers or is_traced(x):
        return b""
    # what is looked up where it lies, as a record's samples are, stays as it lies there
    if np.size(x) > _MOST_ZEROS or max(np.shape(x), default=0) > FEW:
        return b""
    return (np.asarray(x) == 0).tobytes()


@remembered(holds_no_numpy)  # and to list the leaves of a scene as much again
def zeros_in(tree: Any) -> tuple[bytes, ...]:
    """:func:`zeros_of` each array of a tree, which is one value and does not change."""
    return tuple(map(zeros_of, jax.tree.leaves(tree)))


def with_known_zeros(tree: Any, zeros: Sequence[bytes]) -> Any:
    """A tree of arrays whose zeros a program in C knows.

    Args:
        tree: Whose arrays may be traced.
        zeros: Of each of them, by :func:`zeros_of` before they were.
    """
    leaves, structure = cast("tuple[list[Any], Any]", jax.tree.flatten(tree))

    def known(x: Any, which: bytes) -> Any:
        mask = np.frombuffer(which, bool)
        if not mask.any():
            return x
        none = np.zeros(x.shape, x.dtype)
        return jnp.where(mask.reshape(x.shape), none, jnp.asarray(x))

    return jax.tree.unflatten(structure, list(map(known, leaves, zeros)))


class Looked(NamedTuple):
    """Events that are looked for along a motion.

    Attributes:
        values: ``values(t, y, *leaves)`` -> a number of each, shape (E,).
        layout: Of them.
    """

    values: Callable[..., Array]
    layout: Layout


class Source(NamedTuple):
    """A right-hand side, with or without what belongs to its derivatives.

    Attributes:
        functions: Of the rates; with those of their changes, if these are in a row.
        closed: Traced arrays that they close over: their numbers follow those of what
            is given in ``shared``.
        back: Of the cotangents; None where they are not asked for.
        watch: Of the vectors that no step may reverse; None where there are none.
        watched: How many vectors those are.
        events: Of the rates, and behind them the values of events; None where there
            are none.
        layout: Of those.
    """

    functions: Functions
    closed: list[Array]
    back: Functions | None = None
    watch: Functions | None = None
    watched: int = 0
    events: Functions | None = None
    layout: Layout | None = None

    @property
    def head(self) -> dict[str, int]:
        """Sizes that the loop over lanes has to know."""
        watch = self.watch
        sizes = {
            "NUMBERS": self.functions.numbers,
            "ROWS": self.functions.rows,
            "WATCHED": self.watched,
            "NEAREST": _NEAREST,
            "CLOSEST": CLOSEST,
            "WATCH_NUMBERS": 0 if watch is None else watch.numbers,
            "WATCH_ROWS": 0 if watch is None else watch.rows,
        }
        if self.events is None or self.layout is None:
            return sizes
        sizes["EVENT_NUMBERS"] = self.events.numbers
        sizes["EVENT_ROWS"] = self.events.rows
        return sizes | self.layout.head

    @property
    def text(self) -> str:
        """All functions, in C."""
        parts = self.functions, self.watch, self.events
        texts = [part.text for part in parts if part is not None]
        return "\n".join(texts if self.layout is None else [*texts, self.layout.text])

    @property
    def loop(self) -> tuple[str, ...]:
        """The files of the loop over lanes."""
        return ("lane_math.h", "lane_loop.c") if self.events is None else _WITH_EVENTS


def lanes_source(
    derivative: Callable[..., Array],
    state: jax.ShapeDtypeStruct,
    leaves: Sequence[Shaped],
    own: list[bool],
    zeros: Sequence[bytes] | None = None,
    watch: Callable[..., Array] | None = None,
    events: Looked | None = None,
) -> Source:
    """A right-hand side for a row of motions.

    Args:
        derivative: ``derivative(t, y, *leaves)`` -> rates, shape (n,).
        state: Shape and type of y.
        leaves: Shapes and types of the model's leaves for one motion.
        own: Which of them differ from motion to motion.
        zeros: Of each leaf, which numbers are zero for all (:func:`zeros_of`): what
            they are multiplied by is left out. None: not known of any.
        watch: ``watch(t, y, *leaves)`` -> numbers of plane vectors that no step may
            reverse, one vector behind the other; None for none.
        events: What is looked for; None for nothing.

    Raises:
        NotElementwiseError: more than arithmetic on single numbers.
    """
    zeros = [b""] * len(leaves) if zeros is None else zeros
    lanes = _Lanes(state, leaves, own, zeros)
    made, traced, _ = lanes.written(derivative, 0, "", "d")
    source = Source(made, traced)
    if watch is not None:
        behind = sum(math.prod(x.shape) for x in traced)
        watched, more, size = lanes.written(watch, behind, "_watch", "d")
        closed = [*traced, *more]
        source = Source(made, closed, watch=watched, watched=size // 3)
    if events is None:
        return source
    behind = sum(math.prod(x.shape) for x in source.closed)

    def both(*given: Any) -> tuple[Array, Array]:  # of a step's last stage
        return derivative(*given), events.values(*given)

    seen, more, _ = lanes.written(both, behind, "_events", "d", "seen")
    closed = [*source.closed, *more]
    return source._replace(closed=closed, events=seen, layout=events.layout)


class _Lanes(NamedTuple):
    """What functions of rows of motions are given; see :func:`lanes_source`."""

    state: Shaped
    leaves: Sequence[Shaped]
    own: list[bool]
    zeros: Sequence[bytes]

    def written(
        self, function: Callable[..., Any], further: int, ending: str, *names: str
    ) -> tuple[Functions, list[Array], int]:
        """A function in C, what it closes over, and of how many numbers is its first.

        Args:
            function: ``function(t, y, *leaves)`` -> arrays of these names.
            further: Numbers behind those of the leaves, before what it closes over.
            ending: Of its name in C.
            names: Of its results.
        """
        dtype = self.state.dtype
        time = jax.ShapeDtypeStruct((), dtype)
        program = Program(function, time, self.state, *self.leaves)
        statements = Statements()
        values, size = self.symbols()
        closed, traced = _closed(program, size + further, dtype)
        found = program(values, statements.operate, closed)
        results = [Result(*pair, row=True) for pair in zip(names, found, strict=True)]
        stage = "row t, const row *restrict y, const row *restrict own"
        made = as_functions(statements, stage, results, ending)
        return made, traced, found[0].size

    def symbols(self) -> tuple[list[Numbers], int]:
        """Time, state and leaves as symbols, and how many numbers all lanes share."""
        values = [symbols(["t"], (), row=True), array("y", self.state.shape, row=True)]
        places = {"own": 0, "shared": 0}
        parts = zip(self.leaves, self.own, self.zeros, strict=True)
        for leaf, differs, nothing in parts:
            if not np.issubdtype(leaf.dtype, np.floating):
                raise NotElementwiseError("a model with whole numbers")
            name = "own" if differs else "shared"
            # a lane takes the next motion in the middle of the others' runs
            first, fixed = places[name], not differs
            numbers = array(name, leaf.shape, first, row=differs, fixed=fixed)
            for i, is_zero in enumerate(nothing):
                if is_zero:
                    numbers.reshape(-1)[i] = leaf.dtype.type(0)
            values.append(numbers)
            places[name] += math.prod(leaf.shape)
        return values, places["shared"]


def stages_source(
    function: Callable[..., Any],
    state: Shaped,
    leaves: Sequence[Shaped],
    own: list[bool],
    ending: str,
) -> Functions:
    """A right-hand side for a row of motions, and what else is seen at every stage.

    Args:
        function: ``function(t, y, *leaves)`` -> rates of y's first numbers, and what is
            seen.
        state: Shape and type of y.
        leaves: Shapes and types of the model's leaves for one motion.
        own: Which of them differ from motion to motion.
        ending: Of the functions' names in C.

    Raises:
        NotElementwiseError: more than arithmetic on single numbers, or on numbers that
            the function closes over and that are not known.
    """
    lanes = _Lanes(state, leaves, own, [b""] * len(leaves))
    made, traced, _ = lanes.written(function, 0, ending, "d", "seen")
    if traced:
        raise NotElementwiseError("numbers that a function closes over")
    return made


def tangents_source(
    rates: Callable[..., Array], state: Shaped, varied: Sequence[Shaped]
) -> Source:
    """A right-hand side of one motion together with its changes along a row.

    Args:
        rates: ``rates(t, y, *varied)`` -> rates, shape (n,).
        state: Shape and type of y.
        varied: What has changes, apart from y: arrays, or shapes and types.

    Raises:
        NotElementwiseError: more than arithmetic on single numbers.
    """

    def changes(
        t: Array, y: Array, varied: list[Array], y_dot: Array, varied_dot: list[Array]
    ) -> tuple[Array, Array]:
        def along(y: Array, *varied: Array) -> Array:
            return rates(t, y, *varied)

        return jvp(along, (y, *varied), (y_dot, *varied_dot))

    time, like = jax.ShapeDtypeStruct((), state.dtype), list(map(_shape_of, varied))
    program = Program(changes, time, state, like, state, like)
    given, size = _given(state, like)
    closed, traced = _closed(program, size, state.dtype)
    rows = array("dy", state.shape, row=True)
    tangents = in_order("tangents", like, state.dtype, row=True)
    statements = Statements()
    found = program([*given, rows, *tangents], statements.operate, closed)
    stage = "real t, const real *restrict y, const row *restrict dy"
    results = [Result("d", found[0]), Result("dd", found[1], row=True)]
    return Source(as_functions(statements, stage, results), traced)


def cotangents_source(
    rates: Callable[..., Array],
    state: Shaped,
    varied: Sequence[Shaped],
    known: Sequence[Shaped],
    own: list[bool],
) -> Source:
    """A right-hand side of a row of motions, and what a cotangent of its rates becomes.

    That of the state, and what it adds to those of what is varied.

    Args:
        rates: ``rates(t, y, *varied, *known)`` -> rates, shape (n,); it closes over
            nothing that is traced.
        state: Shape and type of y.
        varied: What has cotangents, apart from y: arrays, or shapes and types.
        known: What has none.
        own: Which of both differ from motion to motion of a row.

    Raises:
        NotElementwiseError: more than arithmetic on single numbers.
    """
    count = len(varied)

    def back_through(t: Array, y: Array, leaves: list[Array], bar: Array) -> Any:
        def along(y: Array, *varied: Array) -> Array:
            return rates(t, y, *varied, *leaves[count:])

        return pulled(along, (y, *leaves[:count]), bar)

    time = jax.ShapeDtypeStruct((), state.dtype)
    like = list(map(_shape_of, (*varied, *known)))
    listed: Callable[[Array, Array, list[Array]], Array]
    listed = lambda t, y, leaves: rates(t, y, *leaves)
    there = Program(listed, time, state, like)
    back = Program(back_through, time, state, like, state)
    given, _ = _Lanes(state, like, own, [b""] * len(like)).symbols()
    statements = Statements()
    found = there(given, statements.operate)
    stage = "row t, const row *restrict y, const row *restrict own"
    functions = as_functions(statements, stage, [Result("d", found[0], row=True)])
    statements = Statements()
    cotangent = array("cotangent", state.shape, row=True)
    found = back([*given, cotangent], statements.operate)
    numbers = as_objects([x for part in found[1:] for x in part.reshape(-1)], (-1,))
    results = [Result("g", found[0], row=True), Result("m", numbers, True, adds=True)]
    stage = f"{stage}, const row *restrict cotangent"
    changes = as_functions(statements, stage, results, "_back")
    return Source(functions, [], changes)


def _shape_of(x: Shaped) -> jax.ShapeDtypeStruct:
    return jax.ShapeDtypeStruct(x.shape, x.dtype)


def _given(state: Shaped, like: Sequence[Shaped]) -> tuple[list[Numbers], int]:
    """Time, state and what is varied as symbols, and how many numbers that has."""
    given = [symbols(["t"], (), row=False), array("y", state.shape, row=False)]
    shared = in_order("shared", like, state.dtype, row=False)
    return given + shared, sum(x.size for x in shared)


def _closed(
    program: Program, first: int, dtype: np.dtype
) -> tuple[list[Numbers], list[Array]]:
    """Numbers of what a program closes over, and what of it is traced."""
    traced = [x for x in program.closed if is_traced(x)]
    given = iter(in_order("shared", traced, dtype, first, row=False))
    return [
        next(given) if is_traced(x) else numbers_of(x) for x in program.closed
    ], traced
