"""Search for the end of a step that is an event: a bracketing secant (Illinois)."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array


class Bracket(NamedTuple):
    """Steps on both sides of an event.

    Attributes:
        low: One that ends before it [s].
        high: One that ends behind it [s].
        at_low: The event's value there, over that at the beginning.
        at_high: The same.
    """

    low: Array
    high: Array
    at_low: Array
    at_high: Array

    @property
    def trial(self) -> Array:
        """Next try [s]: a secant, with a bisection as its guard."""
        rise = self.at_low / (self.at_low - self.at_high)
        secant = self.low + (self.high - self.low) * rise
        inside = (secant > self.low) & (secant < self.high)
        return jnp.where(inside, secant, 0.5 * (self.low + self.high))

    def after(self, searching, begins, taken, value) -> "Bracket":
        """With what a tried step found; a side that stays is halved.

        Args:
            searching: Whether the search was on.
            begins: Whether it begins with this step.
            taken: Length of the step [s].
            value: Of the event at its end, over that at the beginning.
        """
        hit = searching & ~(value >= 0.0)  # what is not known lies behind
        miss = searching & (value >= 0.0)
        low = jnp.where(miss, taken, jnp.where(begins, 0.0, self.low))
        high = jnp.where(hit | begins, taken, self.high)
        at_low = jnp.where(miss, value, jnp.where(begins, 1.0, self.at_low))
        at_high = jnp.where(hit | begins, value, self.at_high)
        at_low = jnp.where(hit, 0.5 * at_low, at_low)
        return Bracket(low, high, at_low, jnp.where(miss, 0.5 * at_high, at_high))
