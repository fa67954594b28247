"""What a study of many draws asks of a model: outputs of uniform numbers, and slopes.

A model maps uniform numbers ``u``, one row for each member, to outputs and codes. Sobol
indices, active directions and subset simulation ask for nothing else, so that they
serve a ``Study`` of rolling motions and a plain function alike.
"""

import re
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, NamedTuple, Protocol, cast

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..identification.transforms import entries
from ..validation.checks import FieldError
from ..validation.codes import Code, reason_of
from .distributions import AbstractDistribution
from .draws import Draws

# Members of a program: functions of draws are small, and their programs made once.
_BLOCK = 8192
# The name of the output of a function that gives one array.
_ONLY = "value"
FAILED = Code.MAX_STEPS  # of a function whose output is NaN


class Evaluated(NamedTuple):
    """Outputs of n members.

    Attributes:
        values: By name, shape (n, ...) [each its unit]; NaN where there is none.
        code: Why each motion ended, one of :class:`rollkane.Code`, shape (n,); 0 is
            success.
    """

    values: dict[str, np.ndarray]
    code: np.ndarray


class Slopes(NamedTuple):
    """One output of n members with its gradient by the uniform numbers.

    Attributes:
        values: Shape (n,) [unit of the output].
        gradients: By u, shape (n, d) [unit of the output].
        code: As in :class:`Evaluated`, shape (n,).
    """

    values: np.ndarray
    gradients: np.ndarray
    code: np.ndarray


class Model(Protocol):
    """Outputs of random draws."""

    @property
    def draws(self) -> Draws:
        """The distributions, by name."""
        ...

    def evaluate(self, u: np.ndarray) -> Evaluated:
        """Outputs of members whose uniform numbers are given, shape (n, d) [1]."""
        ...


class DifferentiableModel(Model, Protocol):
    """A model that also knows the slopes of its outputs."""

    def value_and_gradient(self, u: np.ndarray, of: str) -> Slopes:
        """The output ``of`` (as ``entry`` reads it) and its gradient by u [1]."""
        ...


class FunctionModel:
    """A plain function of the draw, as a model: for formulas beside motions.

    Attributes:
        draws: The distributions, by name.
        function: As given.
    """

    def __init__(
        self,
        function: Callable[[dict[str, Array]], Any],
        distributions: Mapping[str, AbstractDistribution],
    ):
        """Join a function and what it is a function of.

        Args:
            function: Of one draw, a dict from name to array, by jax.numpy operations:
                gives an array [any unit], called ``"value"``, or a dict of them. A
                member with a NaN in any of them has failed.
            distributions: Of each name in the draw.

        Raises:
            FieldError: the function is none; as :class:`Draws`.
        """
        if not callable(function):
            remedy = "give a function of one draw, a dict from name to array"
            raise FieldError(
                "FunctionModel.function", function, "is no function", remedy
            )
        self.function = function
        self.draws = Draws(distributions)
        self._batch = jax.jit(jax.vmap(self._outputs))
        self._slopes: dict[str, Callable[[Array], Any]] = {}

    def _outputs(self, u: Float[Array, " d"]) -> dict[str, Array]:
        found = self.function(self.draws.draw(u))
        if not isinstance(found, Mapping):
            return {_ONLY: jnp.asarray(found)}
        named = cast("Mapping[str, Any]", found)
        return {name: jnp.asarray(value) for name, value in named.items()}

    def evaluate(self, u: np.ndarray) -> Evaluated:
        """Outputs of members whose uniform numbers are given.

        Args:
            u: Uniform numbers in (0, 1) [1], shape (n, d).

        Returns:
            Outputs, and the code of failure where one is NaN.
        """
        values = _by_block(self._batch, u)
        failed = np.zeros(len(u), bool)
        for value in values.values():
            failed |= np.isnan(value).any(axis=tuple(range(1, value.ndim)))
        return Evaluated(values, np.where(failed, FAILED, Code.COMPLETED))

    def reason_of(self, code: int) -> str:
        """What a code [1] of this model says."""
        return "the function gave NaN" if code else "completed"

    def value_and_gradient(self, u: np.ndarray, of: str = _ONLY) -> Slopes:
        """One output and its gradient.

        Args:
            u: Uniform numbers in (0, 1) [1], shape (n, d).
            of: Name of the output, with an index where it is an array: ``"end[0]"``.

        Returns:
            Values and gradients by u; the code of failure where one of them is NaN.

        Raises:
            FieldError: no such output, or not one number.
        """
        if of not in self._slopes:

            def picked(v: Array) -> Array:
                outputs = {n: x[None] for n, x in self._outputs(v).items()}
                return entry(outputs, of, "value_and_gradient.of")[0]

            self._slopes[of] = jax.jit(jax.vmap(jax.value_and_grad(picked)))
        found = _by_block(lambda v: self._slopes[of](v), u)
        values, gradients = cast("tuple[np.ndarray, np.ndarray]", found)
        bad = np.isnan(values) | np.isnan(gradients).any(axis=1)
        return Slopes(values, gradients, np.where(bad, FAILED, Code.COMPLETED))


def _by_block(function: Callable[[Array], Any], u: np.ndarray) -> Any:
    """A function of rows, for blocks of few different lengths: each is compiled."""
    parts: list[Any] = []
    for first in range(0, max(len(u), 1), _BLOCK):
        rows = u[first : first + _BLOCK]
        size = 1 << max(len(rows) - 1, 0).bit_length()
        filled = np.full((size, *u.shape[1:]), 0.5)
        filled[: len(rows)] = rows
        found = function(jnp.asarray(filled))
        parts.append(jax.tree.map(partial(_first, len(rows)), found))
    joined: Callable[..., np.ndarray] = lambda *some: np.concatenate(some)
    return jax.tree.map(joined, *parts)


def _first(count: int, rows: Array) -> np.ndarray:
    return np.asarray(rows)[:count]


def entry(values: Mapping[str, Any], of: str, field: str) -> Any:
    """One number of each member's outputs, shape (n,).

    Args:
        values: Outputs by name, members in front [each its unit].
        of: A name, or a name with indices as in ``"end[0]"`` and ``"path[-1][2]"``.
        field: Name used in the error.

    Raises:
        FieldError: no such output, or not one number.
    """
    name, index = of, ()
    found = re.fullmatch(r"(.+?)((?:\[-?\d+\])+)", of)
    if of not in values and found:
        name = found[1]
        index = tuple(int(x) for x in found[2].strip("[]").split("]["))
    if name not in values:
        remedy = f"use one of {', '.join(sorted(values))}"
        raise FieldError(field, of, "is no output of the model", remedy)
    shape = values[name].shape[1:]
    inside = len(index) == len(shape) and all(
        -n <= i < n for i, n in zip(index, shape, strict=True)
    )
    if not inside:
        problem = f"is not one number: {name} has shape {tuple(shape)}"
        remedy = f'name one, as "{name}{entries(shape)[-1]}"'
        raise FieldError(field, of, problem, remedy)
    return values[name][(slice(None), *index)]


def failures(
    model: Model, code: np.ndarray, unknown: np.ndarray | None = None
) -> dict[str, int]:
    """How many motions failed, by the sentence that says why.

    Args:
        model: May have a ``reason_of`` of its own, from code to sentence.
        code: Of each motion, shape (n,).
        unknown: Which completed without a number as their output, shape (n,).
    """
    said: Callable[[int], str] = getattr(model, "reason_of", reason_of)
    found, counts = np.unique(code[code != Code.COMPLETED], return_counts=True)
    reasons = {
        said(one): count
        for one, count in zip(found.tolist(), counts.tolist(), strict=True)
    }
    if unknown is not None and unknown.any():
        reasons["the output is NaN"] = int(unknown.sum())
    return reasons
