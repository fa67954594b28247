"""Sensors that a record may hold, and what each of them measures."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from ..dynamics.mass_matrix import field_of
from ..dynamics.observables import normal_force
from ..dynamics.rolling import contact_of, rolling_derivative
from ..dynamics.scene import Scene
from ..geometry.rotations import multiply, quaternion_of
from ..geometry.small_linear import cross, matvec, matvec_transposed
from ..kinematics.voronets import AnyState
from ..validation.checks import FieldError, real
from .channels import AbstractChannel, AbstractSensor

Function = Callable[[Scene, Array, AnyState], Array]


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
        self._keep(values, sigma, delay)
        self._calibrate(bias, gain)
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
        self.at = _place("Accelerometer.at", at)

    def observed(self, scene: Scene, t: Array, state: AnyState) -> Float[Array, "3"]:
        """``R^T (a - g)``."""
        velocity = lambda t, s: _velocity(scene, t, s, self.at)
        rates = rolling_derivative(scene, t, state)
        rate = jax.jvp(velocity, (t, state), (jnp.ones_like(t), rates))[1]
        field = field_of(scene.loads)
        felt = rate if field is None else rate - field
        return matvec_transposed(contact_of(scene, t, state).rotation, felt)


class _AtPoint(AbstractSensor):
    at: Float[Array, "3"]

    def __init__(
        self,
        values: ArrayLike,
        sigma: ArrayLike | None = None,
        *,
        at: ArrayLike = (0.0, 0.0, 0.0),
        bias: ArrayLike = 0.0,
        gain: ArrayLike = 1.0,
        delay: ArrayLike = 0.0,
    ):
        """Make a channel.

        Args:
            values: Samples [m], FIXED axes, shape (T, 3); NaN where one is missing.
            sigma: Standard deviation of the noise [m], one or three; None: estimated.
            at: Of the body's points, body axes [m], shape (3,).
            bias: Offset of the axes that it is measured on [m], one or three.
            gain: Scale of these axes [1], one or three.
            delay: [s].

        Raises:
            FieldError: shapes that do not fit, a sigma that is not positive.
        """
        self._keep(values, sigma, delay)
        self._calibrate(bias, gain)
        self.at = _place(f"{type(self).__name__}.at", at)

    def observed(self, scene: Scene, t: Array, state: AnyState) -> Float[Array, "3"]:
        """Where the point is."""
        contact = contact_of(scene, t, state)
        return contact.position + matvec(contact.rotation, self.at)


class Position(_AtPoint):
    """Position of the body origin, or of the point ``at``, FIXED axes [m].

    Attributes:
        values: Shape (T, 3).
        sigma: Shape (3,), or None.
        delay: [s].
        bias: [m], shape (3,).
        gain: [1], shape (3,).
        at: The body's point, body axes [m], shape (3,).
    """


class Marker(_AtPoint):
    """Position of a marker on the body, FIXED axes [m].

    Attributes:
        values: Shape (T, 3).
        sigma: Shape (3,), or None.
        delay: [s].
        bias: [m], shape (3,).
        gain: [1], shape (3,).
        at: Where it is, body axes [m], shape (3,).
    """


class Orientation(AbstractChannel):
    """Quaternions, scalar first, body to fixed axes.

    Their misfit is the rotation from the predicted to the measured one, FIXED axes
    [rad], and so is their noise.

    Attributes:
        values: Of any length but zero, either sign, shape (T, 4).
        sigma: [rad], shape (3,), or None.
        delay: [s].
    """

    def __init__(
        self,
        values: ArrayLike,
        sigma: ArrayLike | None = None,
        *,
        delay: ArrayLike = 0.0,
    ):
        """Make a channel.

        Args:
            values: Samples, scalar first, shape (T, 4); NaN where one is missing.
            sigma: Standard deviation of the angles [rad], one or three.
            delay: [s].

        Raises:
            FieldError: shapes that do not fit, zeros, a sigma that is not positive.
        """
        self._keep(values, sigma, delay)
        length = np.linalg.norm(np.asarray(self.values), axis=1)
        if np.any(length == 0.0):
            row = int(np.argmax(length == 0.0))
            remedy = "mark missing samples by NaN"
            raise FieldError("Orientation.values", "...", f"is 0 in row {row}", remedy)

    def columns(self) -> int:
        """Four."""
        return 4

    def noise_columns(self) -> int:
        """Three angles."""
        return 3

    def observed(self, scene: Scene, t: Array, state: AnyState) -> Float[Array, "4"]:
        """The unit quaternion."""
        contact = contact_of(scene, t, state)
        if contact.orientation is None:
            return quaternion_of(contact.rotation)
        size = jnp.sqrt(jnp.sum(contact.orientation**2))
        return contact.orientation / size

    def misfit(self, predicted: Float[Array, "T 4"]) -> Float[Array, "T 3"]:
        """Rotation from the predicted to the measured orientation [rad]."""
        size = jnp.sqrt(jnp.sum(self.values**2, axis=1, keepdims=True))
        back = predicted * jnp.array([[1.0, -1.0, -1.0, -1.0]])
        apart = multiply((self.values / size).T, back.T)
        # of the shorter of the two ways round; 2 v / w is 2 tan(angle / 2)
        along = jnp.where(apart[:1] < 0.0, -1.0, 1.0)
        return (2.0 * along * apart[1:]).T


class ContactPath(AbstractSensor):
    """Contact point on the base, BASE axes [m].

    Attributes:
        values: Shape (T, 3).
        sigma: Shape (3,), or None.
        delay: [s].
        bias: [m], shape (3,).
        gain: [1], shape (3,).
    """

    def __init__(
        self,
        values: ArrayLike,
        sigma: ArrayLike | None = None,
        *,
        bias: ArrayLike = 0.0,
        gain: ArrayLike = 1.0,
        delay: ArrayLike = 0.0,
    ):
        """Make a channel.

        Args:
            values: Samples [m], shape (T, 3); NaN where one is missing.
            sigma: Standard deviation of the noise [m], one or three; None: estimated.
            bias: Offset of the axes that it is measured on [m], one or three.
            gain: Scale of these axes [1], one or three.
            delay: [s].

        Raises:
            FieldError: shapes that do not fit, a sigma that is not positive.
        """
        self._keep(values, sigma, delay)
        self._calibrate(bias, gain)

    def observed(self, scene: Scene, t: Array, state: AnyState) -> Float[Array, "3"]:
        """The point; NaN in flight."""
        point = contact_of(scene, t, state).base_point
        return point if state.touches else jnp.full_like(point, jnp.nan)


class NormalForce(AbstractSensor):
    """Normal component of the contact force [N].

    Attributes:
        values: Shape (T, 1).
        sigma: Shape (1,), or None.
        delay: [s].
        bias: [N], shape (1,).
        gain: [1], shape (1,).
    """

    def __init__(
        self,
        values: ArrayLike,
        sigma: ArrayLike | None = None,
        *,
        bias: ArrayLike = 0.0,
        gain: ArrayLike = 1.0,
        delay: ArrayLike = 0.0,
    ):
        """Make a channel.

        Args:
            values: Samples [N], shape (T,); NaN where one is missing.
            sigma: Standard deviation of the noise [N]; None: estimated.
            bias: Of the sensor [N].
            gain: Of the sensor [1].
            delay: [s].

        Raises:
            FieldError: shapes that do not fit, a sigma that is not positive.
        """
        self._keep(values, sigma, delay)
        self._calibrate(bias, gain)

    def columns(self) -> int:
        """One."""
        return 1

    def observed(self, scene: Scene, t: Array, state: AnyState) -> Float[Array, "1"]:
        """The force."""
        return normal_force(scene, t, state)[None]


class Observed(AbstractSensor):
    """Any function of the scene, the time and one state.

    Attributes:
        values: Shape (T, k).
        sigma: Shape (k,), or None.
        delay: [s].
        bias: Shape (k,).
        gain: [1], shape (k,).
        function: ``function(scene, t, state)`` -> shape (k,) or a number.
    """

    function: Function = eqx.field(static=True)

    def __init__(
        self,
        function: Function,
        values: ArrayLike,
        sigma: ArrayLike | None = None,
        *,
        bias: ArrayLike = 0.0,
        gain: ArrayLike = 1.0,
        delay: ArrayLike = 0.0,
    ):
        """Make a channel.

        Args:
            function: ``function(scene, t, state)`` -> shape (k,), or a number.
            values: Samples, shape (T, k) or (T,); NaN where one is missing.
            sigma: Standard deviation of the noise, one or k; None: estimated.
            bias: Of the sensor, one or k.
            gain: Of the sensor [1], one or k.
            delay: [s].

        Raises:
            FieldError: no function, shapes that do not fit, a sigma that is not
                positive.
        """
        if not callable(function):
            remedy = "give function(scene, t, state)"
            field = "Observed.function"
            raise FieldError(field, function, "must be a function", remedy)
        self.function = function
        self._keep(values, sigma, delay)
        self._calibrate(bias, gain)

    def columns(self) -> None:
        """Any number."""
        return

    def observed(self, scene: Scene, t: Array, state: AnyState) -> Float[Array, " k"]:
        """What the function gives."""
        return jnp.atleast_1d(self.function(scene, t, state))


def _place(field: str, at: ArrayLike) -> Array:
    return real(field, at, (3,), "three lengths in metres, body axes")


def _velocity(scene: Scene, t: Array, state: Any, at: Array) -> Float[Array, "3"]:
    """Of a body point, FIXED axes [m/s]."""
    contact = contact_of(scene, t, state)
    v = cross(contact.angular_velocity, at - contact.body_point)
    j = contact.point_velocity
    return matvec(contact.rotation, v if j is None else v + j)
