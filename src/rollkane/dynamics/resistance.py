"""Resistance against rolling and against spinning on the spot, viscous and dry."""

import abc

import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from ..geometry.small_linear import dot
from ..kinematics.contact import Contact
from ..validation.checks import not_negative, positive
from .bodies import Body
from .friction import regular_size
from .loads import AbstractLoad, Wrench


class _Resistance(AbstractLoad):
    """A moment against a part of the relative angular velocity ``Om``.

    Attributes:
        viscous: c [N m s].
        dry: f [m]: the moment for one newton of normal force.
        regularization: [rad/s]; below it the dry part fades.
    """

    viscous: Float[Array, ""] | None
    dry: Float[Array, ""] | None
    regularization: Float[Array, ""]

    def __init__(
        self,
        viscous: ArrayLike | None = None,
        dry: ArrayLike | None = None,
        regularization: ArrayLike = 1e-3,
    ):
        """Make a resistance; a part that is left out is no part of the program.

        The viscous part does not fade with the normal force: where a run with ``modes``
        may lift the body off, only the dry one goes through that.

        Args:
            viscous: Moment over angular velocity [N m s], 0 or more. None for none.
            dry: The arm of the normal force [m], 0 or more. None for none.
            regularization: An angular velocity below which the dry part fades [rad/s],
                positive. It is ``-f N Om / sqrt(Om^2 + eps^2)``.

        Raises:
            FieldError: negative coefficients, or no numbers.
        """
        own = type(self).__name__
        self.viscous = self.dry = None
        if viscous is not None:
            self.viscous = not_negative(f"{own}.viscous", viscous, "in N m s")
        if dry is not None:
            self.dry = not_negative(f"{own}.dry", dry, "in m")
        self.regularization = positive(
            f"{own}.regularization", regularization, (), "an angular velocity in rad/s"
        )

    @property
    def needs_contact(self) -> bool:
        """True."""
        return True

    @property
    def needs_normal_force(self) -> bool:
        """Whether it has a dry part."""
        return self.dry is not None

    @abc.abstractmethod
    def resisted(self, contact: Contact) -> Float[Array, "3"]:
        """The part of ``Om`` that it acts against [rad/s], body axes."""

    def wrench(
        self, t: Float[Array, ""], body: Body, contact: Contact
    ) -> Wrench | None:
        """No force, and the viscous moment."""
        del t, body
        if self.viscous is None:
            return None
        turning = self.resisted(contact)
        return jnp.zeros_like(turning), -self.viscous * turning

    def moment_by_normal_force(self, contact: Contact) -> Float[Array, "3"] | None:
        """The dry moment for one newton [m]."""
        if self.dry is None:
            return None
        turning = self.resisted(contact)
        return -self.dry * turning / regular_size(turning, self.regularization)


class RollingResistance(_Resistance):
    """A moment against rolling: against the part of ``Om`` along the surface.

    Attributes:
        viscous: c [N m s].
        dry: f [m].
        regularization: [rad/s].

    Source: docs/theory.md, (7.6).
    """

    def resisted(self, contact: Contact) -> Float[Array, "3"]:
        """``Om_t`` [rad/s], body axes."""
        Om, N = contact.relative_angular_velocity, contact.normal
        return Om - N * dot(N, Om)


class SpinningResistance(_Resistance):
    """A moment against turning about the normal.

    Attributes:
        viscous: c [N m s].
        dry: f [m].
        regularization: [rad/s].

    Source: docs/theory.md, (7.6).
    """

    def resisted(self, contact: Contact) -> Float[Array, "3"]:
        """``(Om . N) N`` [rad/s], body axes."""
        N = contact.normal
        return N * dot(N, contact.relative_angular_velocity)
