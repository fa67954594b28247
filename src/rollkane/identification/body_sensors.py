"""Sensors whose axes turn with the body: gyroscope and accelerometer."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from ..dynamics.mass_matrix import field_of
from ..dynamics.rolling import contact_of, rolling_derivative
from ..dynamics.scene import Scene
from ..geometry.small_linear import cross, matvec, matvec_transposed
from ..kinematics.voronets import AnyState
from ..validation.checks import real
from .channels import AbstractSensor, body_point


class AbstractBodySensor(AbstractSensor):
    """A sensor of three axes that turn with the body.

    Attributes:
        values: What it read, on its own axes, shape (T, 3).
        sigma: Of its noise, shape (3,), or None.
        delay: [s].
        bias: Shape (3,).
        gain: Shape (3,).
        misalignment: Small rotation from the body's axes to its own [rad], shape (3,).
    """

    misalignment: Float[Array, "3"]

    def __init__(
        self,
        values: ArrayLike,
        sigma: ArrayLike | None = None,
        *,
        bias: ArrayLike = 0.0,
        gain: ArrayLike = 1.0,
        misalignment: ArrayLike = (0.0, 0.0, 0.0),
        delay: ArrayLike = 0.0,
    ):
        """Make a channel.

        Args:
            values: Samples, shape (T, 3); NaN where one is missing.
            sigma: Standard deviation of the noise, one or three; None: estimated.
            bias: Of the sensor, one or three.
            gain: Of the sensor [1], one or three.
            misalignment: Rotation from the body's axes to the sensor's, about x, y and
                z [rad], of first order: keep it below 0.1.
            delay: [s].

        Raises:
            FieldError: shapes that do not fit, a sigma that is not positive.
        """
        super().__init__(values, sigma, bias=bias, gain=gain, delay=delay)
        meaning = "three angles in rad"
        name = f"{type(self).__name__}.misalignment"
        self.misalignment = real(name, misalignment, (3,), meaning)

    def misfit(self, predicted: Float[Array, "T 3"]) -> Float[Array, "T 3"]:
        """Measured minus predicted, on the sensor's axes."""
        turned = predicted - jnp.cross(self.misalignment[None], predicted)
        return super().misfit(turned)


class Gyro(AbstractBodySensor):
    """Angular velocity on BODY axes [rad/s].

    Attributes:
        values: Shape (T, 3).
        sigma: [rad/s], shape (3,), or None.
        delay: [s].
        bias: [rad/s], shape (3,).
        gain: [1], shape (3,).
        misalignment: [rad], shape (3,).
    """

    __init__ = AbstractBodySensor.__init__  # else one of a dataclass, to type checkers

    def observed(self, scene: Scene, t: Array, state: AnyState) -> Float[Array, "3"]:
        """The angular velocity."""
        return contact_of(scene, t, state).angular_velocity


class Accelerometer(AbstractBodySensor):
    """Acceleration of a body point without gravity, on BODY axes [m/s^2].

    At rest it reads 9.81 upwards. Gravity is that of the scene's loads.

    Attributes:
        values: Shape (T, 3).
        sigma: Shape (3,), or None.
        delay: [s].
        bias: [m/s^2], shape (3,).
        gain: [1], shape (3,).
        misalignment: [rad], shape (3,).
        at: Where it sits, body axes [m], shape (3,).
    """

    at: Float[Array, "3"]

    def __init__(
        self,
        values: ArrayLike,
        sigma: ArrayLike | None = None,
        *,
        at: ArrayLike,
        bias: ArrayLike = 0.0,
        gain: ArrayLike = 1.0,
        misalignment: ArrayLike = (0.0, 0.0, 0.0),
        delay: ArrayLike = 0.0,
    ):
        """Make a channel.

        Args:
            values: Samples [m/s^2], shape (T, 3); NaN where one is missing.
            sigma: Standard deviation of the noise, one or three; None: estimated.
            at: Where it sits, from the body origin, body axes [m], shape (3,).
            bias: Of the sensor [m/s^2], one or three.
            gain: Of the sensor [1], one or three.
            misalignment: As of :class:`Gyro` [rad], shape (3,).
            delay: [s].

        Raises:
            FieldError: shapes that do not fit, a sigma that is not positive.
        """
        super().__init__(
            values, sigma, bias=bias, gain=gain, misalignment=misalignment, delay=delay
        )
        self.at = body_point("Accelerometer.at", at)

    def observed(self, scene: Scene, t: Array, state: AnyState) -> Float[Array, "3"]:
        """``R^T (a - g)``."""
        velocity: Callable[[Array, AnyState], Array]
        velocity = lambda t, s: _velocity(scene, t, s, self.at)
        rates = rolling_derivative(scene, t, state)
        rate = jax.jvp(velocity, (t, state), (jnp.ones_like(t), rates))[1]
        field = field_of(scene.loads)
        felt = rate if field is None else rate - field
        return matvec_transposed(contact_of(scene, t, state).rotation, felt)


def _velocity(scene: Scene, t: Array, state: AnyState, at: Array) -> Float[Array, "3"]:
    """Of a body point, FIXED axes [m/s]."""
    contact = contact_of(scene, t, state)
    v = cross(contact.angular_velocity, at - contact.body_point)
    j = contact.point_velocity
    return matvec(contact.rotation, v if j is None else v + j)
