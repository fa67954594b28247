"""Which values a program still reads, and which it may change in place."""

import math
from collections.abc import Sequence
from typing import TypeGuard

import numpy as np
from jax.extend import core

from .array_memory import Memory
from .data_movement import numbers_of
from .jaxpr_types import Equation, Literal, Variable
from .memory_walk import Value


def is_literal(v: object) -> TypeGuard[Literal]:
    """Whether a variable of a program is a known number."""
    return isinstance(v, core.Literal)


def read(v: Variable, known: dict[Variable, Value]) -> Value:
    """The value of a variable."""
    return numbers_of(np.asarray(v.val, v.aval.dtype)) if is_literal(v) else known[v]


def last_uses(
    equations: list[Equation], outvars: Sequence[Variable]
) -> dict[Variable, float]:
    """Of each variable, the last equation that reads it; infinite for results."""
    last: dict[Variable, float] = {}
    for i, equation in enumerate(equations):
        last.update((v, i) for v in equation.invars if not is_literal(v))
    last.update((v, math.inf) for v in outvars if not is_literal(v))
    return last


def is_free(
    v: Variable,
    known: dict[Variable, Value],
    names: list[Variable],
    last: dict[Variable, float],
    i: int,
) -> bool:
    """Whether equation i changes a value in place: nobody else reads it, or later."""
    x = known[v]
    if not isinstance(x, Memory) or not x.owned or last[v] > i or names.count(v) > 1:
        return False
    return not any(
        isinstance(y, Memory) and y.base == x.base and last.get(other, -1) >= i
        for other, y in known.items()
        if other is not v
    )
