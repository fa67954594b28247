"""Coefficients of diffrax's explicit Runge-Kutta methods, for a plain loop."""

from typing import Any, NamedTuple

import diffrax as dfx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .checks import FieldError


class Tableau(NamedTuple):
    """An explicit method whose last stage is the end of its step.

    Attributes:
        rows: Weights of the s rates known before each stage, the oldest first behind
            zeros, shape (s, s).
        nodes: Share of the step at each stage, shape (s,).
        error: Weights of the rates in the error estimate, shape (s,).
    """

    rows: Float[Array, "s s"]
    nodes: Float[Array, " s"]
    error: Float[Array, " s"]


def tableau_of(solver: Any, dtype) -> Tableau:
    """Coefficients of a diffrax solver.

    Raises:
        FieldError: not an explicit Runge-Kutta method with an error estimate whose
            last stage is its end.
    """
    known: Any = getattr(solver, "tableau", None)
    explicit = isinstance(known, dfx.ButcherTableau) and not known.implicit
    if not explicit or not known.ssal or known.b_error is None:
        raise FieldError(
            "simulate.solver",
            type(solver).__name__,
            "cannot make the steps of a run with modes",
            "use diffrax.Tsit5(), Dopri5(), Dopri8() or Bosh3()",
        )
    count = len(known.a_lower) + 1
    rows = np.zeros((count, count))
    for i, row in enumerate(known.a_lower, start=1):
        rows[i, count - i :] = row  # the newest of the rates stands last
    nodes = np.concatenate([[0.0], known.c])
    return Tableau(*(jnp.asarray(x, dtype) for x in (rows, nodes, known.b_error)))
