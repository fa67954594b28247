"""What of a program depends on its arguments."""

from collections.abc import Callable
from typing import Any

import jax.extend as jex


def reached_outputs(jaxpr: Any) -> list[bool]:
    """Which outputs depend on the inputs, equation by equation.

    An inner program counts as one equation: each of its outputs as depending on all of
    its inputs.

    Args:
        jaxpr: Of ``jax.make_jaxpr``; what it closes over is no input.
    """
    reached: set[Any] = set(jaxpr.invars)
    known: Callable[[Any], bool] = lambda x: (
        not isinstance(x, jex.core.Literal) and x in reached
    )
    for equation in jaxpr.eqns:
        if any(map(known, equation.invars)):
            reached.update(equation.outvars)
    return [known(x) for x in jaxpr.outvars]
