"""Coefficients of diffrax's explicit Runge-Kutta methods, for a plain loop."""

from collections.abc import Callable, Iterable
from typing import Any, NamedTuple, cast

import diffrax as dfx
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike
from jaxtyping import Array, Float

from ..validation.checks import FieldError
from .tracing import becomes_c

# diffrax's own whose steps are their tableau and nothing else
PLAIN = (dfx.Bosh3, dfx.Dopri5, dfx.Dopri8, dfx.Tsit5)


def is_plain(solver: Any) -> bool:
    """Whether a step of a solver, diffrax's or a user's, is its tableau alone.

    An explicit method whose last stage is the end of its step, with an error estimate.
    """
    kind = cast(Any, type(solver))
    if not isinstance(solver, dfx.AbstractERK) or kind.step is not dfx.AbstractERK.step:
        return False
    known = isinstance(kind.tableau, dfx.ButcherTableau)
    return known and kind.tableau.ssal and kind.tableau.b_error is not None


class Weights(NamedTuple):
    """An explicit method whose last stage is the end of its step, as plain numbers.

    Attributes:
        rows: Weights of the rates known before each stage but the first.
        nodes: Share of the step at each of these stages.
        error: Weights of all rates in the error estimate.
        order: That the error estimate counts on.
    """

    rows: tuple[tuple[float, ...], ...]
    nodes: tuple[float, ...]
    error: tuple[float, ...]
    order: int

    @property
    def padded(self) -> tuple[np.ndarray, np.ndarray]:
        """Rows of all stages with zeros behind, shape (s, s), and their nodes, (s,)."""
        count = len(self.rows) + 1
        rows = np.zeros((count, count))
        for i, row in enumerate(self.rows, start=1):
            rows[i, :i] = row
        return rows, np.concatenate([[0.0], self.nodes])


class Tableau(NamedTuple):
    """An explicit method whose last stage is the end of its step.

    Attributes:
        rows: Weights of the rates known before each stage, zeros behind, shape (s, s).
        nodes: Share of the step at each stage, shape (s,).
        error: Weights of the rates in the error estimate, shape (s,).
    """

    rows: Float[Array, "s s"]
    nodes: Float[Array, " s"]
    error: Float[Array, " s"]


def stage_sum(weights: Float[Array, " s"], rates: Float[Array, "s *n"]) -> Array:
    """A sum over the stages of a step, ``sum_j w_j k_j``, shape (*n,).

    In C a loop, of as many lines as one term; else term by term: a product of matrices
    would be a call to a library.
    """
    if becomes_c():
        return jnp.tensordot(weights, rates, 1)
    total = weights[0] * rates[0]
    for i in range(1, rates.shape[0]):
        total = total + weights[i] * rates[i]
    return total


def weights_of(solver: Any, purpose: str) -> Weights:
    """Coefficients of a diffrax solver as numbers.

    Args:
        solver: diffrax solver.
        purpose: What it is wanted for, for the error.

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
            f"cannot make the steps of {purpose}",
            "use diffrax.Tsit5(), Dopri5(), Dopri8() or Bosh3()",
        )
    numbers: Callable[[Iterable[Any]], tuple[float, ...]]
    numbers = lambda row: tuple(float(x) for x in row)
    return Weights(
        rows=tuple(numbers(row) for row in known.a_lower),
        nodes=numbers(known.c),
        error=numbers(known.b_error),
        order=solver.order(None),
    )


def tableau_of(solver: Any, dtype: DTypeLike) -> Tableau:
    """Coefficients of a diffrax solver as arrays, for a run with modes.

    Raises:
        FieldError: see :func:`weights_of`.
    """
    weights = weights_of(solver, "a run with modes")
    numbers = *weights.padded, weights.error
    return Tableau(*(jnp.asarray(x, dtype) for x in numbers))
