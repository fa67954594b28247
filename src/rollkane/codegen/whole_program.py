"""A whole program of arrays, with its loops and branches, compiled as one in C."""

import itertools
import os
from collections.abc import Callable, Sequence
from typing import Any, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..validation.checks import is_traced
from .array_memory import Memory, packed
from .compiler import NoCompilerError
from .control_flow import Structured
from .data_movement import as_objects
from .ffi_call import XlaCall, in_one
from .jaxpr_types import Aval, Jaxpr
from .memory_walk import SMALL, Value
from .scalar_program import NotElementwiseError
from .scalars import in_c, type_of
from .statement_writer import Writer, part

# Lines that are worth a compiler of their own, and beyond which it takes less care: a
# bowling ball's 8,000 take 1.6 s at most care (-O3), 1.2 s at some and 0.9 s at least,
# and run in 2.0, 2.1 and 2.8 ms; 94,000 of a flight over a bowl 46, 21 and 14 s.
_WORTH_A_COMPILER, _LONG = 2_000, 30_000


def in_one_program(function: Callable[..., Any], *arguments: Any) -> Any:
    """What a function gives, by a program in C, inside of XLA's.

    In a batch it runs once for each member, on all processors.

    Args:
        function: Of trees with arrays, to a tree of arrays; pure, not differentiated.
        arguments: Those trees.

    Raises:
        NotElementwiseError: an operation that is not written in C.
        NoCompilerError: no C compiler.
    """
    arrays, fixed = cast("tuple[Any, Any]", eqx.partition(arguments, eqx.is_array))

    def whole(arrays: Any) -> Any:
        return function(*eqx.combine(arrays, fixed))

    closed, like = jax.make_jaxpr(whole, return_shape=True)(arrays)
    given = [x for x in closed.consts if is_traced(x)] + jax.tree.leaves(arrays)
    consts = [None if is_traced(x) else np.asarray(x) for x in closed.consts]
    reals = (x.dtype for x in given if jnp.issubdtype(x.dtype, np.floating))
    dtype = np.dtype(next(reals, jnp.result_type(float)))
    leaves, tree = cast("tuple[list[Any], Any]", jax.tree.flatten(like))
    call, shapes = _compiled(closed.jaxpr, consts, dtype)
    return jax.tree.unflatten(tree, _called(call, shapes, given, leaves, dtype))


def in_one_program_or_not(function: Callable[..., Any], *arguments: Any) -> Any:
    """The same, or where that cannot be by XLA's program."""
    try:
        return in_one_program(function, *arguments)
    except (NotElementwiseError, NoCompilerError):
        return function(*arguments)


def _called(
    call: XlaCall,
    shapes: list[tuple[int, ...]],
    given: list[Array],
    leaves: list[Any],
    dtype: np.dtype,
) -> list[Array]:
    """The results of a call, with their shapes and types."""
    given = [jnp.asarray(x).astype(dtype).reshape(-1) for x in given]
    small = [x for x in given if x.size <= SMALL]
    handed = [in_one(small, dtype), *(x for x in given if x.size > SMALL)]
    first, *large = call(tuple(shapes), *handed)
    found: list[Array] = []
    at = 0
    rest = iter(large)
    for leaf in leaves:
        if leaf.size <= SMALL:
            numbers = first[at : at + leaf.size]
            at += leaf.size
        else:
            numbers = next(rest)
        found.append(numbers.reshape(leaf.shape).astype(leaf.dtype))
    return found


def _compiled(
    jaxpr: Jaxpr, consts: list[np.ndarray | None], dtype: np.dtype
) -> tuple[XlaCall, list[tuple[int, ...]]]:
    """The program, and the shapes of its results."""
    walk = Structured(dtype)
    closed, values, count = _given(walk.writer, jaxpr, consts)
    homes = _homes([v.aval for v in jaxpr.outvars])
    pairs = zip(jaxpr.outvars, homes, strict=True)
    walk.homes = {v: home for v, home in pairs if home and jaxpr.outvars.count(v) == 1}
    with np.errstate(all="ignore"):  # known numbers may overflow, as XLA's do
        found = walk.through(jaxpr, closed, values)
    size = _leave(walk, found, homes)
    shapes = [(size,), *((home.size,) for home in homes if home is not None)]
    writer = walk.writer
    head = {
        "MOST_GIVEN": count,
        "MOST_RESULTS": len(shapes),
        "WORKSPACE": writer.workspace,
    }
    begins, *others, last = _texts(writer, count, len(shapes))
    parts = "program.h", begins, last, "threads.h", "program_call.c"
    more = tuple(("rows.h", "program.h", begins, text) for text in others)
    long = begins.count("\n") + sum(text.count("\n") for text in (*others, last))
    effort = "-O1" if long > _LONG else "-O2"
    return XlaCall(dtype, 1, head, parts, more, effort), shapes


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
    return {"real": "{}", "whole": "whole_of({})", "truth": "({} != 0)"}[kind].format


def _homes(results: Sequence[Aval]) -> list[Memory | None]:
    """Where XLA takes the results: the larger ones, each in an array of its own."""
    count = itertools.count(1)
    return [
        Memory(f"o{next(count)}", type_of(x.dtype), x.shape, packed(x.shape))
        if x.size > SMALL
        else None
        for x in results
    ]


def _leave(walk: Structured, found: list[Value], homes: list[Memory | None]) -> int:
    """Write the results there; gives how many numbers the smaller ones are."""
    place = 0
    for x, home in zip(map(walk.numbers, found), homes, strict=True):
        if home is not None:
            if not x.is_at(home):
                walk.arrays.copied(x, home)
            continue
        for number in x.reshape(-1):
            walk.writer.line(f"o0[{place}] = (real)({in_c(number).text});")
            place += 1
    return place


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
    groups = _in_groups([*writer.functions, run])
    return ["\n".join(x) for x in (head, *groups)]


def _in_groups(functions: list[str]) -> list[list[str]]:
    """Functions shared out between compilers, the last one in the last group."""
    sizes = [text.count("\n") for text in functions]
    count = min(os.cpu_count() or 1, 8, sum(sizes) // _WORTH_A_COMPILER + 1)
    groups: list[list[str]] = [[] for _ in range(count)]
    loads = [0] * count
    groups[-1].append(functions[-1])
    loads[-1] = sizes[-1]
    # the longest first, each to who has least
    for i in sorted(range(len(functions) - 1), key=lambda i: -sizes[i]):
        least = loads.index(min(loads))
        groups[least].append(functions[i])
        loads[least] += sizes[i]
    return groups
