"""All that is random in a study: distributions by name, drawn from one row of u."""

from collections.abc import Mapping
from typing import Any, cast

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..validation.checks import FieldError
from .distributions import AbstractDistribution, Drawn


class Draws(eqx.Module):
    """Independent distributions by name.

    Attributes:
        names: Of the distributions, in the order in which they take uniform numbers.
        members: The distributions, in the same order.
    """

    # no dictionary: JAX would sort it
    names: tuple[str, ...] = eqx.field(static=True)
    members: tuple[AbstractDistribution, ...]

    def __init__(self, distributions: Mapping[str, AbstractDistribution]):
        """Take the distributions.

        Args:
            distributions: By name; names are words, as Python's.

        Raises:
            FieldError: no distribution, a name that is no word, something else than a
                distribution.
        """
        field = "Draws.distributions"
        remedy = 'give for example {"spin": rollkane.Normal(5.0, 0.2)}'
        if not isinstance(cast(object, distributions), Mapping) or not distributions:
            problem = "must name at least one distribution"
            raise FieldError(field, distributions, problem, remedy)
        for name, one in distributions.items():
            if not isinstance(cast(object, name), str) or not name.isidentifier():
                problem = "has a name that is no word"
                raise FieldError(field, name, problem, "use letters, digits and _")
            if not isinstance(cast(object, one), AbstractDistribution):
                where = f"{field}[{name!r}]"
                raise FieldError(where, one, "must be a distribution", remedy)
        self.names = tuple(distributions)
        self.members = tuple(distributions.values())

    @property
    def distributions(self) -> dict[str, AbstractDistribution]:
        """By name, in order."""
        return dict(zip(self.names, self.members, strict=True))

    @property
    def dimension(self) -> int:
        """How many uniform numbers a member takes."""
        return sum(one.size for one in self.members)

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the independent factors, for sensitivities.

        A distribution's own name; of independent entries ``name[i]``.
        """
        return tuple(self._columns())

    def columns(self, name: str) -> slice:
        """Which of a member's uniform numbers a distribution, or a factor, takes.

        Args:
            name: One of the names or labels.

        Raises:
            FieldError: neither of them.
        """
        known = self._columns() | self._wholes()
        if name not in known:
            remedy = f"use one of {tuple(known)}"
            raise FieldError("Draws.columns.name", name, "is not drawn", remedy)
        return known[name]

    def _wholes(self) -> dict[str, slice]:
        ends = np.cumsum([one.size for one in self.members]).tolist()
        parts = zip(self.names, self.members, ends, strict=True)
        return {name: slice(end - one.size, end) for name, one, end in parts}

    def _columns(self) -> dict[str, slice]:
        found: dict[str, slice] = {}
        first = 0
        for name, one in self.distributions.items():
            for label, size in one.factors:
                found[name + label] = slice(first, first + size)
                first += size
        return found

    def draw(self, u: Float[Array, " d"]) -> dict[str, Drawn]:
        """One member's numbers, by name.

        Args:
            u: In (0, 1) [1], shape (d,), d the dimension.

        Raises:
            FieldError: another shape.
        """
        given = jnp.shape(u)
        if given != (self.dimension,):
            problem = f"must have shape ({self.dimension},), not {given}"
            remedy = "give one member's numbers; take several by jax.vmap"
            raise FieldError("Draws.draw.u", "...", problem, remedy)
        u = jnp.asarray(u)
        return {
            name: one.draw(u[columns])
            for one, (name, columns) in zip(
                self.members, self._wholes().items(), strict=True
            )
        }

    def spec(self) -> dict[str, Any]:
        """Kind and numbers of each, as JSON has them, in order."""
        return {name: one.spec() for name, one in self.distributions.items()}


def flat(drawn: Mapping[str, Drawn], stem: str = "") -> dict[str, Array]:
    """Draws as arrays by dotted name, those of several numbers by each.

    Args:
        drawn: What :meth:`Draws.draw` gives, or many of them.
        stem: Before the names.
    """
    found: dict[str, Array] = {}
    for name, value in drawn.items():
        if isinstance(value, Mapping):
            inner = cast(Mapping[str, Drawn], value)
            found |= flat(inner, f"{stem}{name}.")
        else:
            found[f"{stem}{name}"] = value
    return found
