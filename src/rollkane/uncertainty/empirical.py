"""Numbers from a table: one of its rows."""

import os
from collections.abc import Sequence
from typing import Any, Self

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..files.record_tables import READER, end_of_name, table_of
from ..validation.checks import FieldError, is_traced, real, refuse
from .distribution_checks import described, inside, numbers, refuse_negative
from .distributions import AbstractUnivariate

# units that columns of draws may be in, of which one is not worth one of SI
_NOT_SI = (
    *("deg", "deg/s", "rpm", "g", "lb", "cm", "mm", "in", "ft", "cm/s", "mm/s", "km/h"),
    *("cm/s2", "mm/s2", "ms", "us", "min", "mN", "kN"),
)


class Empirical(AbstractUnivariate):
    """One of given values, each as likely as another or by weights.

    Single numbers are sorted, so that a draw grows with its uniform number; rows keep
    the order that they have.

    Attributes:
        values: [unit of what it draws], shape (n, ...); a draw is one of them.
        cumulative: Probability of the values up to each but the last [1],
            shape (n - 1,).
    """

    values: Float[Array, "n *shape"]
    cumulative: Float[Array, " m"]

    def __init__(self, values: Any, weights: Any = None):
        """Take the values.

        Args:
            values: n numbers, or n rows of any shape [unit of what it draws].
            weights: n numbers, not negative, in any unit; None: all alike.

        Raises:
            FieldError: no values, values that are not finite, negative weights or none
                above zero.
        """
        field, remedy = "Empirical.values", "give a list of numbers, or of rows"
        found = numbers(field, values)
        if found.ndim == 0 or found.shape[0] == 0:
            raise FieldError(field, values, "must hold at least one value", remedy)
        n = found.shape[0]
        if weights is None:
            shares = jnp.ones(n)
        else:
            field = "Empirical.weights"
            shares = real(field, weights, (n,), f"{n} numbers of zero or more")
            shares = refuse_negative(field, shares)
            problem, remedy = "are all zero", "leave them out, or give one above zero"
            some = shares.max() if is_traced(shares) else np.max(np.asarray(shares))
            shares = refuse(shares, ~(some > 0.0), field, problem, remedy)
        if found.ndim == 1:
            order = jnp.argsort(found)
            found, shares = found[order], shares[order]
        self.values = found
        total = jnp.cumsum(shares / jnp.max(shares))
        self.cumulative = total[:-1] / total[-1]

    @classmethod
    def from_table(
        cls,
        path: str | os.PathLike[str] | Any,
        columns: str | Sequence[str],
        weights: str | None = None,
    ) -> Self:
        """Take columns of a table: its rows stay together.

        Args:
            path: CSV or NetCDF file, or a data frame, as :func:`rollkane.read_record`
                reads them.
            columns: Name of one column: a draw is a number; or several: shape (k,).
            weights: Name of the column of weights; None: none.

        Raises:
            FieldError: what cannot be read, columns that are not there, missing cells,
                columns that say a unit which is not of SI ("[deg/s]", "x_cm").
        """
        field = "Empirical.from_table"
        single = isinstance(columns, str)
        names = (columns,) if isinstance(columns, str) else tuple(columns)
        if not names:
            remedy = 'give for example "speed"'
            raise FieldError(f"{field}.columns", columns, "names none", remedy)
        try:
            table = table_of(path)
            first = names[0]
            found = [table.column("columns", name, beside=first) for name in names]
            shares = None
            if weights is not None:
                shares = table.column("weights", weights, beside=first)
        except FieldError as error:
            # said of the reader of records, which reads this table, too
            where = error.field.replace(READER, field)
            told = where, error.value, error.problem, error.remedy
            raise FieldError(*told) from error
        checked = [*zip(names, found, strict=True)]
        if weights is not None and shares is not None:
            checked.append((weights, shares))
        for name, column in checked:
            said = table.of(name).unit or end_of_name(name)
            if said in _NOT_SI:
                problem = f"is in {said!r} by its name or attributes, and draws are SI"
                remedy = "convert the column, and name it so"
                raise FieldError(f"{field}.columns", name, problem, remedy)
            missing = np.flatnonzero(np.isnan(column))
            if missing.size:
                place = f"{table.source}, {table.row(int(missing[0]))}"
                problem = f"{place}: has no number"
                remedy = "fill the cell, or leave the row out"
                raise FieldError(f"{field}.columns", name, problem, remedy)
        return cls(found[0] if single else np.stack(found, axis=1), shares)

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of one value."""
        return self.values.shape[1:]

    @property
    def size(self) -> int:
        """One uniform number, of whatever shape a value is."""
        return 1

    @property
    def factors(self) -> tuple[tuple[str, int], ...]:
        """The value as a whole."""
        return (("", 1),)

    def draw(self, u: Float[Array, "1"]) -> Float[Array, "*shape"]:
        """The value up to which the probability exceeds u."""
        return self._at(inside(u)[0])

    def quantile(
        self, log_cdf: Float[Array, ""], log_survival: Float[Array, ""]
    ) -> Float[Array, "*shape"]:
        """The value at a probability."""
        del log_survival
        return self._at(jnp.exp(log_cdf))

    def _at(self, probability: Array) -> Array:
        steps = self.cumulative.astype(probability.dtype)
        index = jnp.searchsorted(steps, probability, side="right")
        return self.values.astype(probability.dtype)[index]

    def spec(self) -> dict[str, Any]:
        """Kind and numbers; of large tables their digest."""
        return described(self, "values", "cumulative")
