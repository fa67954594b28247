"""A whole program of arrays, with its loops and branches, compiled as one in C."""

import itertools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..validation.checks import is_traced
from .array_memory import Memory, packed
from .compiler import NoCompilerError
from .compiler_shares import in_groups
from .control_flow import Structured
from .data_movement import as_objects, refuse_keys
from .ffi_call import XlaCall, in_one
from .jaxpr_types import Aval, Jaxpr
from .memory_walk import SMALL, Value
from .platforms import platform
from .row_loops import without_lost_writes
from .scalar_program import NotElementwiseError
from .scalars import in_c
from .statement_writer import Writer, part
from .tracing import becoming_c, not_collecting
from .whole_numbers import type_of

# Lines beyond which a compiler takes less care: at -O1 14,000 lines take 1.1 s on two
# cores, at -O2 1.5 to 2.3; a plate's 10,000, or a gradient's, run a tenth to a quarter
# longer.
_LONG = 12_000


def in_one_program(
    function: Callable[..., Any], *arguments: Any, briefly: bool = False
) -> Any:
    """What a function gives, by a program in C, inside of XLA's.

    In a batch it runs once for each member, on all processors.

    Args:
        function: Of trees with arrays, to a tree of arrays; pure, not differentiated.
        arguments: Those trees.
        briefly: Whether it runs so briefly that the compiler takes less care.

    Raises:
        NotElementwiseError: an operation that is not written in C.
        NoCompilerError: no C compiler, or numbers that are on a GPU.
    """
    if platform() != "cpu":
        raise NoCompilerError("whole programs run on processors alone")
    whole = Whole.of(function, *arguments)
    parts = *whole.parts, "threads.h", "program_call.c"
    effort = "-O1" if briefly else whole.effort
    call = XlaCall(whole.dtype, 1, whole.head, parts, whole.further, effort)
    given = whole.given(jax.tree.leaves(eqx.filter(arguments, eqx.is_array)))
    handed = [in_one(given.small, whole.dtype), *given.large]
    return whole.result(call(whole.shapes, *handed))


def in_one_program_or_not(
    function: Callable[..., Any], *arguments: Any, briefly: bool = False
) -> Any:
    """The same, or where that cannot be by XLA's program."""
    try:
        return in_one_program(function, *arguments, briefly=briefly)
    except (NotElementwiseError, NoCompilerError):
        return function(*arguments)


class Given(NamedTuple):
    """What a program is given: small arrays, which go in one, and the others, flat."""

    small: list[Array]
    large: list[Array]


class Whole(NamedTuple):
    """A function of trees with arrays, written in C.

    Attributes:
        dtype: Of all numbers.
        head: Names of whole numbers that its texts know.
        parts: Files and texts up to the one with ``run``.
        further: Those of texts that are compiled by themselves.
        effort: Of the compiler.
        closed: Traced arrays that the function closes over.
        taken: Shapes of its arguments' arrays.
        results: Shapes and types of what it gives, in order, and their structure.
    """

    dtype: np.dtype
    head: dict[str, int]
    parts: tuple[str, ...]
    further: tuple[tuple[str, ...], ...]
    effort: str
    closed: list[Array]
    taken: list[tuple[int, ...]]
    results: tuple[list[Any], Any]

    @staticmethod
    @not_collecting()
    def of(function: Callable[..., Any], *arguments: Any) -> "Whole":
        """The program of a function.

        Args:
            function: Of trees with arrays, to a tree of arrays; pure.
            arguments: Those trees; of arrays shapes and types are enough.

        Raises:
            NotElementwiseError: an operation that is not written in C.
        """
        arrays, fixed = cast("tuple[Any, Any]", eqx.partition(arguments, _is_shaped))

        def whole(arrays: Any) -> Any:
            return function(*eqx.combine(arrays, fixed))

        with becoming_c():
            closed, like = jax.make_jaxpr(whole, return_shape=True)(arrays)
        refuse_keys([*closed.consts, *jax.tree.leaves(arrays)])
        traced = [x for x in closed.consts if is_traced(x)]
        consts = [None if is_traced(x) else np.asarray(x) for x in closed.consts]
        given = (x.dtype for x in [*traced, *jax.tree.leaves(arrays)])
        reals = (x for x in given if jnp.issubdtype(x, np.floating))
        dtype = np.dtype(next(reals, jnp.result_type(float)))
        results = cast("tuple[list[Any], Any]", jax.tree.flatten(like))
        head, texts = _written(closed.jaxpr, consts, dtype)
        begins, *others, last = texts
        further = tuple(("rows.h", "program.h", begins, text) for text in others)
        long = begins.count("\n") + sum(text.count("\n") for text in (*others, last))
        effort = "-O1" if long > _LONG else "-O2"
        parts = "program.h", begins, last
        taken = [x.shape for x in jax.tree.leaves(arrays)]
        how = dtype, head, parts, further, effort
        return Whole(*how, traced, taken, results)

    @property
    def shapes(self) -> tuple[tuple[int, ...], ...]:
        """Of what it leaves: all small results in one array, each other flat."""
        sizes = [leaf.size for leaf in self.results[0]]
        small = sum(size for size in sizes if size <= SMALL)
        return (small,), *((size,) for size in sizes if size > SMALL)

    def given(self, arrays: Sequence[Array]) -> Given:
        """What it is given of the arrays of its arguments, in order."""
        flat = [
            jnp.asarray(x).astype(self.dtype).reshape(-1)
            for x in (*self.closed, *arrays)
        ]
        small = [x for x in flat if x.size <= SMALL]
        return Given(small, [x for x in flat if x.size > SMALL])

    def result(self, left: Sequence[Array]) -> Any:
        """The function's result, of what the program leaves; with a batch's axes."""
        first, *large = left
        found: list[Array] = []
        at = 0
        rest = iter(large)
        for leaf in self.results[0]:
            if leaf.size <= SMALL:
                numbers = first[..., at : at + leaf.size]
                at += leaf.size
            else:
                numbers = next(rest)
            shape = *first.shape[:-1], *leaf.shape
            found.append(numbers.reshape(shape).astype(leaf.dtype))
        return jax.tree.unflatten(self.results[1], found)


def _is_shaped(x: Any) -> bool:
    return eqx.is_array(x) or isinstance(x, jax.ShapeDtypeStruct)


def _written(
    jaxpr: Jaxpr, consts: list[np.ndarray | None], dtype: np.dtype
) -> tuple[dict[str, int], list[str]]:
    """The program's sizes, and its texts; see :func:`_texts`."""
    walk = Structured(dtype, jaxpr)
    closed, values, count = _given(walk.writer, jaxpr, consts)
    homes = _homes([v.aval for v in jaxpr.outvars])
    pairs = zip(jaxpr.outvars, homes, strict=True)
    walk.homes = {v: home for v, home in pairs if home and jaxpr.outvars.count(v) == 1}
    with np.errstate(all="ignore"):  # known numbers may overflow, as XLA's do
        found = walk.through(jaxpr, closed, values)
    _leave(walk, found, homes)
    left = 1 + sum(home is not None for home in homes)
    writer = walk.writer
    head = {"MOST_GIVEN": count, "MOST_RESULTS": left, "WORKSPACE": writer.workspace}
    return head, _texts(writer, count, left)


def _given(
    writer: Writer, jaxpr: Jaxpr, consts: list[np.ndarray | None]
) -> tuple[list[Value], list[Value], int]:
    """The arguments: small ones in one array, each of the others in its own."""
    place, count = 0, 1
    found: list[Value] = []
    variables = [*jaxpr.constvars, *jaxpr.invars]
    known = [*consts, *[None] * len(jaxpr.invars)]
    for v, x in zip(variables, known, strict=True):
        if x is not None:
            found.append(x)
            continue
        aval, kind = v.aval, type_of(v.aval.dtype)
        if aval.size > SMALL:
            found.append(Memory(f"a{count}", kind, aval.shape, packed(aval.shape)))
            count += 1
            continue
        number = _read_as(kind)
        numbers = [
            writer.let(number(f"a0[{place + i}]"), kind) for i in range(aval.size)
        ]
        found.append(as_objects(numbers, aval.shape))
        place += aval.size
    behind = len(jaxpr.constvars)
    return found[:behind], found[behind:], count


def _read_as(kind: str) -> Callable[[str], str]:
    """How a number of a type is read."""
    whole = "whole_of_one({}, 64, 1)"
    return {"real": "{}", "whole": whole, "truth": "({} != 0)"}[kind].format


def _homes(results: Sequence[Aval]) -> list[Memory | None]:
    """Where XLA takes the results: the larger ones, each in an array of its own."""
    count = itertools.count(1)
    return [
        Memory(f"o{next(count)}", type_of(x.dtype), x.shape, packed(x.shape))
        if x.size > SMALL
        else None
        for x in results
    ]


def _leave(walk: Structured, found: list[Value], homes: list[Memory | None]) -> None:
    """Write the results there; the smaller ones one behind the other."""
    place = 0
    for x, home in zip(map(walk.numbers, found), homes, strict=True):
        if home is not None:
            if not x.is_at(home):
                walk.arrays.copied(x, home)
            continue
        for number in x.reshape(-1):
            walk.writer.line(f"o0[{place}] = (real)({in_c(number).text});")
            place += 1


def _texts(writer: Writer, given: int, left: int) -> list[str]:
    """A program in C: what all its texts begin with, and its functions in texts.

    The last one has ``run``.
    """
    head = [
        *(f"#define a{i} (frame->given[{i}])" for i in range(given)),
        *(f"#define o{i} (frame->left[{i}])" for i in range(left)),
        *(
            f"#define m{i} (frame->workspace + {at})"
            for i, at in enumerate(writer.places)
        ),
        *(
            f"static const real {name}[] = {{{text}}};"
            for text, name in writer.tables.items()
        ),
        *(f"{part(i)};" for i in range(len(writer.functions))),
    ]
    body = "\n".join(writer.block.lines)
    run = f"static void run(const Frame *frame) {{\n{body}\n}}"
    groups = in_groups(without_lost_writes([*writer.functions, run]))
    return ["\n".join(x) for x in (head, *groups)]
