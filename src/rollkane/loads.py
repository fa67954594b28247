"""Loads: what acts on the moving masses. A scene without loads has none in its program.

A load is a field, which accelerates every mass alike (the body's and those it carries),
or a force on the body, or both.
"""

import equinox as eqx
from jaxtyping import Array, Float

from .bodies import Body
from .checks import real
from .contact import Contact


class AbstractLoad(eqx.Module):
    """A load; the kinds override what they are."""

    @property
    def field(self) -> Float[Array, "3"] | None:
        """Acceleration that it gives to every mass [m/s^2], fixed axes; None: none."""
        return None

    def wrench(
        self, t: Float[Array, ""], body: Body, contact: Contact
    ) -> tuple[Float[Array, "3"], Float[Array, "3"]] | None:
        """Force [N] and moment about the CONTACT POINT [N m], BODY axes; None: none."""
        del t, body, contact
        return None


class Gravity(AbstractLoad):
    """Uniform gravity.

    Attributes:
        acceleration: [m/s^2], fixed axes, shape (3,).
    """

    acceleration: Float[Array, "3"]

    def __init__(self, acceleration=(0.0, 0.0, -9.81)):
        """Make a uniform field.

        Args:
            acceleration: [m/s^2], fixed axes, shape (3,).

        Raises:
            FieldError: not three finite numbers.
        """
        self.acceleration = real(
            "Gravity.acceleration", acceleration, (3,), "three components in m/s^2"
        )

    @property
    def field(self) -> Float[Array, "3"]:
        """The acceleration itself [m/s^2], fixed axes."""
        return self.acceleration
