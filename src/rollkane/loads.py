"""Loads: forces on the rolling body. A scene without loads has none in its program."""

import abc

import equinox as eqx
from jaxtyping import Array, Float

from .bodies import Body
from .checks import real
from .contact import Contact
from .small_linear import dot, matvec, matvec_transposed


class AbstractLoad(eqx.Module):
    """A force on a body, as a resultant through its mass centre."""

    @abc.abstractmethod
    def force(self, body: Body, contact: Contact) -> Float[Array, "3"]:
        """Resultant through the mass centre [N], BODY axes."""

    @abc.abstractmethod
    def potential_energy(self, body: Body, contact: Contact) -> Float[Array, ""]:
        """Potential energy [J]."""


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

    def force(self, body: Body, contact: Contact) -> Float[Array, "3"]:
        """Weight [N], BODY axes."""
        return body.mass * matvec_transposed(contact.rotation, self.acceleration)

    def potential_energy(self, body: Body, contact: Contact) -> Float[Array, ""]:
        """``-m g . r_C`` from the fixed origin [J]."""
        place = contact.position + matvec(contact.rotation, body.center_of_mass)
        return -body.mass * dot(self.acceleration, place)
