"""Loads: what acts on the moving masses. A scene without loads has none in its program.

A load is a field, which accelerates every mass alike (the body's and those it carries),
or a force on the body, or both.
"""

from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple, TypeAlias, cast

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from ..geometry.small_linear import cross, dot, matvec, matvec_transposed
from ..kinematics.contact import Contact
from ..validation.checks import not_negative, real
from ..validation.user_functions import GivenFunction, as_floats
from .bodies import Body, Vector

# Force [N] and moment about the contact point [N m], body axes.
Wrench: TypeAlias = tuple[Float[Array, "3"], Float[Array, "3"]]


class AbstractLoad(eqx.Module):
    """A load; the kinds override what they are."""

    is_fixed_in_space: ClassVar[bool] = False  # it depends on the place on fixed axes
    needs_state: ClassVar[bool] = False  # it has generalized forces by the whole state

    @property
    def field(self) -> Float[Array, "3"] | None:
        """Acceleration that it gives to every mass [m/s^2], fixed axes; None: none."""
        return None

    def wrench(
        self, t: Float[Array, ""], body: Body, contact: Contact
    ) -> Wrench | None:
        """Force [N] and moment about the CONTACT POINT [N m], BODY axes; None: none."""
        del t, body, contact
        return None

    def generalized(
        self, scene: Any, t: Float[Array, ""], state: Any
    ) -> list[Array] | None:
        """Generalized forces on all quasi-velocities, by the state; None: none."""
        del scene, t, state
        return None

    def moment_by_normal_force(self, contact: Contact) -> Float[Array, "3"] | None:
        """Moment on the body for one newton of normal force [m], BODY axes."""
        del contact
        return None

    def potential_energy(
        self, t: Float[Array, ""], body: Body, contact: Contact
    ) -> Float[Array, ""] | None:
        """Energy stored against its wrench [J]; None: it is not conservative."""
        del t, body, contact
        return None

    @property
    def needs_contact(self) -> bool:
        """Whether it ends with the contact."""
        return False

    @property
    def needs_normal_force(self) -> bool:
        """Whether a part of it is proportional to the normal force."""
        return type(self).moment_by_normal_force is not (
            AbstractLoad.moment_by_normal_force
        )

    @property
    def does_work(self) -> bool:
        """Whether it gives energy to the system or takes some, potentials excepted."""
        return type(self).wrench is not AbstractLoad.wrench


class Gravity(AbstractLoad):
    """Uniform gravity.

    Attributes:
        acceleration: [m/s^2], fixed axes, shape (3,).
    """

    acceleration: Float[Array, "3"]

    def __init__(self, acceleration: Vector = (0.0, 0.0, -9.81)):
        """Make a uniform field.

        Args:
            acceleration: Three components in the fixed axes [m/s^2].

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


class PointMotion(NamedTuple):
    """A material point of the body, as a function of the user's sees it.

    Attributes:
        position: [m], FIXED axes, shape (3,).
        velocity: [m/s], FIXED axes, shape (3,).
        rotation: Of the body, body to fixed axes [1], shape (3, 3).
        angular_velocity: Of the body [rad/s], FIXED axes, shape (3,).
    """

    position: Float[Array, "3"]
    velocity: Float[Array, "3"]
    rotation: Float[Array, "3 3"]
    angular_velocity: Float[Array, "3"]


class Force(AbstractLoad):
    """A force on a point of the body.

    Attributes:
        force: Three components, or a function [N], FIXED axes.
        point: Where it acts [m], body axes, shape (3,).
        parameters: Numbers that the function depends on.
    """

    force: Float[Array, "3"] | GivenFunction
    point: Float[Array, "3"]
    parameters: Any

    def __init__(
        self,
        force: Vector | Callable[..., Any],
        point: Vector = (0.0, 0.0, 0.0),
        parameters: Any = None,
    ):
        """Make a force.

        Args:
            force: Three components [N], FIXED axes; or ``force(t, point)`` or
                ``force(t, point, parameters)`` of the time [s] and a ``PointMotion``,
                that returns them. Times at which it jumps: ``Scene(kinks=)``.
            point: Material point of the body where it acts [m], body axes.
            parameters: Tree of numbers for the function, differentiable.

        Raises:
            FieldError: not three numbers, or a function of another kind.
        """
        self.parameters = as_floats(parameters)
        self.force = _given("Force.force", force, self.parameters, "newtons")
        self.point = real("Force.point", point, (3,), "metres, body axes")

    def wrench(self, t: Float[Array, ""], body: Body, contact: Contact) -> Wrench:
        """The force, and its moment about the contact point."""
        del body
        force = self.force
        if isinstance(force, GivenFunction):
            force = force(t, point_motion(contact, self.point), self.parameters)
        force = matvec_transposed(contact.rotation, force)
        return force, cross(self.point - contact.body_point, force)


class Torque(AbstractLoad):
    """A torque on the body.

    Attributes:
        torque: Three components, or a function [N m], FIXED axes.
        parameters: Numbers that the function depends on.
    """

    torque: Float[Array, "3"] | GivenFunction
    parameters: Any

    def __init__(self, torque: Vector | Callable[..., Any], parameters: Any = None):
        """Make a torque.

        Args:
            torque: Three components [N m], FIXED axes; or ``torque(t, origin)`` or
                ``torque(t, origin, parameters)`` of the time [s] and a
                ``PointMotion`` of the body's origin, that returns them.
            parameters: Tree of numbers for the function, differentiable.

        Raises:
            FieldError: not three numbers, or a function of another kind.
        """
        self.parameters = as_floats(parameters)
        field = "Torque.torque"
        self.torque = _given(field, torque, self.parameters, "newton metres")

    def wrench(self, t: Float[Array, ""], body: Body, contact: Contact) -> Wrench:
        """No force, and the torque."""
        del body
        zero = jnp.zeros_like(contact.normal)
        torque = self.torque
        if isinstance(torque, GivenFunction):
            torque = torque(t, point_motion(contact, zero), self.parameters)
        return zero, matvec_transposed(contact.rotation, torque)


class Potential(AbstractLoad):
    """A force with a potential, on a point of the body: a spring, a magnet.

    Attributes:
        potential: Function of the place of the point, FIXED axes [m] -> energy [J].
        point: Where it acts [m], body axes, shape (3,).
        parameters: Numbers that the function depends on.
    """

    is_fixed_in_space: ClassVar[bool] = True
    potential: Any
    point: Float[Array, "3"]
    parameters: Any

    def __init__(
        self,
        potential: Callable[..., Any],
        point: Vector = (0.0, 0.0, 0.0),
        parameters: Any = None,
    ):
        """Make a force by its potential.

        Args:
            potential: ``potential(position)`` or ``potential(position, parameters)``
                -> energy [J]; position in FIXED axes [m]. It counts in the energy.
            point: Material point of the body where it acts [m], body axes.
            parameters: Tree of numbers for the function, differentiable.

        Raises:
            FieldError: no function, or one of another kind.
        """
        self.parameters = as_floats(parameters)
        field, place = "Potential.potential", (jnp.zeros(3),)
        meaning = "(position)"
        self.potential = GivenFunction(
            field, potential, (), place, self.parameters, meaning
        )
        self.point = real("Potential.point", point, (3,), "metres, body axes")

    @property
    def does_work(self) -> bool:
        """False: what it gives was stored in it."""
        return False

    def _energy(self, position: Float[Array, "3"]) -> Float[Array, ""]:
        return self.potential(position, self.parameters)

    def potential_energy(
        self, t: Float[Array, ""], body: Body, contact: Contact
    ) -> Float[Array, ""]:
        """The potential where the point is [J]."""
        del t, body
        return self._energy(point_motion(contact, self.point).position)

    def wrench(self, t: Float[Array, ""], body: Body, contact: Contact) -> Wrench:
        """Less the potential's gradient, and its moment about the contact point."""
        del t, body
        place = point_motion(contact, self.point).position
        slope = cast(Array, jax.grad(self._energy)(place))
        force = -matvec_transposed(contact.rotation, slope)
        return force, cross(self.point - contact.body_point, force)


class Drag(AbstractLoad):
    """Resistance of the air: ``-(c1 + c2 |v|) v`` on a point, ``-c_w w`` on turning.

    Attributes:
        linear: c1 [N s/m].
        quadratic: c2 [N s^2/m^2].
        angular: c_w [N m s].
        point: Where it acts [m], body axes, shape (3,).
    """

    linear: Float[Array, ""]
    quadratic: Float[Array, ""]
    angular: Float[Array, ""]
    point: Float[Array, "3"]

    def __init__(
        self,
        linear: ArrayLike = 0.0,
        quadratic: ArrayLike = 0.0,
        angular: ArrayLike = 0.0,
        point: Vector = (0.0, 0.0, 0.0),
    ):
        """Make a drag.

        Args:
            linear: Force over speed [N s/m]. Zero or more.
            quadratic: Force over the square of the speed [N s^2/m^2]. Zero or more.
            angular: Moment over angular velocity [N m s]. Zero or more.
            point: The point of the body on which it acts, body axes [m].

        Raises:
            FieldError: negative coefficients, or no numbers.
        """
        self.linear = not_negative("Drag.linear", linear, "in N s/m")
        self.quadratic = not_negative("Drag.quadratic", quadratic, "in N s^2/m^2")
        self.angular = not_negative("Drag.angular", angular, "in N m s")
        self.point = real("Drag.point", point, (3,), "metres, body axes")

    def wrench(self, t: Float[Array, ""], body: Body, contact: Contact) -> Wrench:
        """Force and moment about the contact point, body axes."""
        del t, body
        w, arm = contact.angular_velocity, self.point - contact.body_point
        v = _point_velocity(contact, arm)
        squared = dot(v, v)
        moving = squared > 0.0  # the speed has no derivative at rest, |v| v has
        speed = jnp.where(moving, jnp.sqrt(jnp.where(moving, squared, 1.0)), 0.0)
        force = -(self.linear + self.quadratic * speed) * v
        return force, cross(arm, force) - self.angular * w


def point_motion(contact: Contact, point: Float[Array, "3"]) -> PointMotion:
    """A material point of the body, on fixed axes.

    Args:
        contact: The body's contact.
        point: [m], body axes.
    """
    R, arm = contact.rotation, point - contact.body_point
    return PointMotion(
        contact.place + matvec(R, arm),
        matvec(R, _point_velocity(contact, arm)),
        R,
        matvec(R, contact.angular_velocity),
    )


def _point_velocity(contact: Contact, arm: Float[Array, "3"]) -> Float[Array, "3"]:
    v = cross(contact.angular_velocity, arm)
    moved = contact.point_velocity
    return v if moved is None else moved + v


def _given(
    field: str, value: Vector | Callable[..., Any], parameters: Any, unit: str
) -> Any:
    """Constant components, or a checked function of the time and a point."""
    if not callable(value):
        return real(field, value, (3,), f"three components in {unit}, or a function")
    still = PointMotion(jnp.zeros(3), jnp.zeros(3), jnp.eye(3), jnp.zeros(3))
    example = jnp.zeros(()), still
    return GivenFunction(field, value, (3,), example, parameters, "(t, point)")
