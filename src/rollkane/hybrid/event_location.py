"""Search for a step that ends on an event: by Newton or secants within a bracket."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

# [s], about zero: so near an event its value falls with each try, or is rounding
STAYS = 1e-11


class Bracket(NamedTuple):
    """Steps on both sides of an event, and the next to try.

    Attributes:
        low: One that ends before it [s].
        high: One that ends behind it [s].
        trial: Next try [s].
        last: The last one tried [s].
        value: Of the event at its end.
        off: By how much it ends behind the event, about [s].
    """

    low: Array
    high: Array
    trial: Array
    last: Array
    value: Array
    off: Array

    def after(
        self,
        begins: Bool[Array, ""],
        taken: Float[Array, ""],
        value: Float[Array, ""],
        rate: Float[Array, ""],
        exact: Bool[Array, ""],
    ) -> "Bracket":
        """With what a tried step found.

        The next try is Newton's, a secant's where the rate is not exact, or the middle.

        Args:
            begins: Whether the search begins with this step.
            taken: Length of the step [s].
            value: Of the event at its end.
            rate: Of the value there.
            exact: Whether the rate is more than a guess.
        """
        low = jnp.where(begins, 0.0, self.low)
        misses = value >= 0.0
        low = jnp.where(misses, taken, low)
        high = jnp.where(misses, self.high, taken)  # what is not known lies behind
        apart = taken - self.last
        slope = (value - self.value) / jnp.where(apart == 0.0, 1.0, apart)
        slope = jnp.where(begins | exact | (apart == 0.0), rate, slope)
        off = value / jnp.where(slope == 0.0, 1.0, slope)
        trial = taken - off
        inside = (trial > low) & (trial < high)
        trial = jnp.where(inside, trial, 0.5 * (low + high))
        return Bracket(low, high, trial, taken, value, off)
