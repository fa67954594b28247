"""Laws of sliding friction: the force on the body from the slip of the contact."""

import abc

import equinox as eqx
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from ..geometry.small_linear import dot
from ..validation.checks import not_negative, positive


class AbstractFriction(eqx.Module):
    """A law ``f(U, N)``, in two parts: one by itself, one times the normal force."""

    def force(self, slip: Float[Array, "3"]) -> Float[Array, "3"] | None:
        """Force that does not depend on the normal force [N]; None: none.

        Args:
            slip: ``U`` [m/s].
        """
        del slip
        return None

    @property
    def needs_normal_force(self) -> bool:
        """Whether a part of it is proportional to the normal force."""
        return True

    @property
    def one_sided(self) -> bool:
        """Whether it goes with the sign of the normal force, not with its size.

        Smoothly through its zero, for a run that ends the contact there.
        """
        return False

    @abc.abstractmethod
    def ratio(self, slip: Float[Array, "3"]) -> Float[Array, "3"] | None:
        """Force for each newton of normal force [1], against the slip; None: none.

        Args:
            slip: ``U`` [m/s].
        """


class ViscousFriction(AbstractFriction):
    """``f = -c U``: a film of oil.

    Attributes:
        coefficient: c [N s/m].

    Source: docs/theory.md, (7.5).
    """

    coefficient: Float[Array, ""]

    def __init__(self, coefficient: ArrayLike):
        """Make the law.

        Args:
            coefficient: Force over slip [N s/m], 0 or more.

        Raises:
            FieldError: not such a number.
        """
        name = "ViscousFriction.coefficient"
        self.coefficient = not_negative(name, coefficient, "in N s/m")

    @property
    def needs_normal_force(self) -> bool:
        """False."""
        return False

    def force(self, slip: Float[Array, "3"]) -> Float[Array, "3"]:
        """``-c U`` [N]."""
        return -self.coefficient * slip

    def ratio(self, slip: Float[Array, "3"]) -> None:
        """None: the normal force does not matter."""
        del slip


class CoulombFriction(AbstractFriction):
    """``f = -mu N U / sqrt(U^2 + eps^2)``: dry friction, smooth where the slip ends.

    Attributes:
        coefficient: mu [1].
        regularization: eps [m/s]; below it the friction fades. The equations are stiff
            by mu g / eps [1/s] while it holds the body: for sticking in earnest, roll.

    Source: docs/theory.md, (7.5).
    """

    coefficient: Float[Array, ""]
    regularization: Float[Array, ""]

    def __init__(self, coefficient: ArrayLike, regularization: ArrayLike = 1e-3):
        """Make the law.

        Args:
            coefficient: Force over normal force [1], 0 or more.
            regularization: A speed below which dry friction fades [m/s], positive.

        Raises:
            FieldError: not such numbers.
        """
        name = "CoulombFriction.coefficient"
        self.coefficient = not_negative(name, coefficient, "without unit")
        self.regularization = positive(
            "CoulombFriction.regularization", regularization, (), "a speed in m/s"
        )

    def ratio(self, slip: Float[Array, "3"]) -> Float[Array, "3"]:
        """``-mu U / sqrt(U^2 + eps^2)`` [1]."""
        return -self.coefficient * slip / regular_size(slip, self.regularization)


class StribeckFriction(AbstractFriction):
    """Dry friction that falls with the speed, and a viscous part.

    ``mu(U) = mu_k + (mu_s - mu_k) exp(-(U / v_s)^2)``, ``f = -(mu(U) N / sqrt(U^2 +
    eps^2) + c) U``.

    Attributes:
        static: mu_s [1].
        kinetic: mu_k [1].
        speed: v_s [m/s].
        viscous: c [N s/m].
        regularization: eps [m/s].
    """

    static: Float[Array, ""]
    kinetic: Float[Array, ""]
    speed: Float[Array, ""]
    viscous: Float[Array, ""]
    regularization: Float[Array, ""]

    def __init__(
        self,
        static: ArrayLike,
        kinetic: ArrayLike,
        speed: ArrayLike,
        viscous: ArrayLike = 0.0,
        regularization: ArrayLike = 1e-3,
    ):
        """Make the law.

        Args:
            static: The coefficient at rest [1], 0 or more.
            kinetic: The coefficient of fast slips [1], 0 or more.
            speed: The speed between both [m/s], positive.
            viscous: A viscous part, force over slip [N s/m], 0 or more.
            regularization: A speed below which dry friction fades [m/s], positive.

        Raises:
            FieldError: not such numbers.
        """
        self.static = not_negative("StribeckFriction.static", static, "without unit")
        self.kinetic = not_negative("StribeckFriction.kinetic", kinetic, "without unit")
        self.viscous = not_negative("StribeckFriction.viscous", viscous, "in N s/m")
        self.speed = positive("StribeckFriction.speed", speed, (), "a speed in m/s")
        self.regularization = positive(
            "StribeckFriction.regularization", regularization, (), "a speed in m/s"
        )

    def force(self, slip: Float[Array, "3"]) -> Float[Array, "3"]:
        """``-c U`` [N]."""
        return -self.viscous * slip

    def ratio(self, slip: Float[Array, "3"]) -> Float[Array, "3"]:
        """``-mu(U) U / sqrt(U^2 + eps^2)`` [1]."""
        fallen = jnp.exp(-dot(slip, slip) / self.speed**2)
        mu = self.kinetic + (self.static - self.kinetic) * fallen
        return -mu * slip / regular_size(slip, self.regularization)


def regular_size(vector: Float[Array, "3"], least: Float[Array, ""]) -> Array:
    """``sqrt(v^2 + eps^2)``, differentiable at zero."""
    return jnp.sqrt(dot(vector, vector) + least * least)
