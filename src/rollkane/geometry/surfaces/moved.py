"""Functions of coordinates that are counted from elsewhere."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
from jaxtyping import Array, Float


class MovedFunction(eqx.Module):
    """A function of coordinates that are counted from another place.

    Attributes:
        function: Of the coordinates as they were.
        shift: What is added to those that are given.
    """

    function: Callable[[Array], Any]
    shift: Float[Array, " k"]

    def __call__(self, u: Float[Array, " k"]) -> Any:
        """Its value there."""
        return self.function(u + self.shift)
