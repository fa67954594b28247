"""A right-hand side in C: for rows of motions, and with its derivatives."""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..numberwise import NotElementwiseError, Program, as_objects
from .listing import Functions, Listing, Result, array, as_functions, in_order, symbols


def lanes_source(
    derivative: Callable,
    state: jax.ShapeDtypeStruct,
    leaves: list,
    own: list[bool],
    zeros: list[tuple[bool, ...]] | None = None,
) -> Functions:
    """A right-hand side for a row of motions.

    Args:
        derivative: ``derivative(t, y, *leaves)`` -> rates, shape (n,).
        state: Shape and type of y.
        leaves: Shapes and types of the model's leaves for one motion.
        own: Which of them differ from motion to motion.
        zeros: Of each leaf, which numbers are zero for all: what they are multiplied
            by is left out. None: not known.

    Raises:
        NotElementwiseError: more than arithmetic on single numbers.
    """
    time = jax.ShapeDtypeStruct((), state.dtype)
    program = Program(derivative, time, state, *leaves)
    listing = Listing()
    values = [symbols(["t"], (), row=True), array("y", state.shape, row=True)]
    places = {"own": 0, "shared": 0}
    zeros = [()] * len(leaves) if zeros is None else zeros
    for leaf, differs, nothing in zip(leaves, own, zeros, strict=True):
        if not np.issubdtype(leaf.dtype, np.floating):
            raise NotElementwiseError("a model with whole numbers")
        name = "own" if differs else "shared"
        # a lane takes the next motion in the middle of the others' runs
        numbers = array(name, leaf.shape, places[name], row=differs, fixed=not differs)
        for i, is_zero in enumerate(nothing):
            if is_zero:
                numbers.reshape(-1)[i] = leaf.dtype.type(0)
        values.append(numbers)
        places[name] += math.prod(leaf.shape)
    (rates,) = program(values, listing.operate)
    stage = "row t, const row *restrict y, const row *restrict own"
    return as_functions(listing, stage, [Result("d", rates, row=True)])


class Derivative(NamedTuple):
    """What is compiled for changes along steps, or back along them.

    Attributes:
        functions: Of the rates alone; None where those of the changes give them too.
        changes: Of the changes.
        closed: Arrays that the rates close over: their numbers follow those of what is
            varied in ``shared``.
    """

    functions: Functions | None
    changes: Functions
    closed: list


def tangents_source(rates: Callable, state: Any, varied: list) -> Derivative:
    """A right-hand side of one motion together with its changes along a row.

    Args:
        rates: ``rates(t, y, *varied)`` -> rates, shape (n,).
        state: Shape and type of y.
        varied: What has changes, apart from y: arrays, or shapes and types.

    Raises:
        NotElementwiseError: more than arithmetic on single numbers.
    """

    def changes(t, y, varied, y_dot, varied_dot):
        along = lambda y, *varied: rates(t, y, *varied)
        return jax.jvp(along, (y, *varied), (y_dot, *varied_dot))

    time, like = _like([jnp.zeros((), state.dtype), *varied])
    program = Program(changes, time, state, like, state, like)
    given, closed = _given(state, like, program.closed)
    rows = array("dy", state.shape, row=True)
    moved = in_order("moved", like, state.dtype, row=True)
    listing = Listing()
    found = program([*given, rows, *moved], listing.operate, closed)
    stage = "real t, const real *restrict y, const row *restrict dy"
    results = [Result("d", found[0]), Result("dd", found[1], row=True)]
    return Derivative(None, as_functions(listing, stage, results), program.closed)


def cotangents_source(rates: Callable, state: Any, varied: list) -> Derivative:
    """A right-hand side of one motion, and what a cotangent of its rates becomes.

    That of the state, and what it adds to those of what is varied.

    Args:
        rates: ``rates(t, y, *varied)`` -> rates, shape (n,).
        state: Shape and type of y.
        varied: What has cotangents, apart from y: arrays, or shapes and types.

    Raises:
        NotElementwiseError: more than arithmetic on single numbers.
    """

    def pulled(t, y, varied, asked):
        along = lambda y, *varied: rates(t, y, *varied)
        return jax.vjp(along, y, *varied)[1](asked)

    time, like = _like([jnp.zeros((), state.dtype), *varied])
    there = Program(lambda t, y, varied: rates(t, y, *varied), time, state, like)
    back = Program(pulled, time, state, like, state)
    given, closed = _given(state, like, [*there.closed, *back.closed])
    listing = Listing()
    found = there(given, listing.operate, closed[: len(there.closed)])
    stage = "real t, const real *restrict y"
    functions = as_functions(listing, stage, [Result("d", found[0])])
    listing = Listing()
    asked = array("asked", state.shape, row=False)
    found = back([*given, asked], listing.operate, closed[len(there.closed) :])
    numbers = [x for part in found[1:] for x in part.reshape(-1)]
    results = [
        Result("g", found[0]),
        Result("m", as_objects(numbers, (-1,)), adds=True),
    ]
    stage = f"{stage}, const real *restrict asked"
    changes = as_functions(listing, stage, results, "_back")
    return Derivative(functions, changes, [*there.closed, *back.closed])


def _like(arrays: list) -> tuple[Any, list]:
    first, *rest = (jax.ShapeDtypeStruct(x.shape, x.dtype) for x in arrays)
    return first, rest


def _given(state: Any, like: list, closed: list) -> tuple[list, list]:
    """Time, state and what is varied as symbols, and what is closed over."""
    given = [symbols(["t"], (), row=False), array("y", state.shape, row=False)]
    shared = in_order("shared", [*like, *closed], state.dtype, row=False)
    return given + shared[: len(like)], shared[len(like) :]
