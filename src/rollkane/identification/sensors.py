"""Sensors of place, orientation, contact, and of any function of the motion."""

from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from ..dynamics.observables import normal_force
from ..dynamics.rolling import contact_of
from ..dynamics.scene import Scene
from ..geometry.rotations import multiply, quaternion_of
from ..geometry.small_linear import matvec
from ..kinematics.voronets import AnyState
from ..validation.checks import FieldError
from .channels import AbstractChannel, AbstractSensor, body_point

Function = Callable[[Scene, Array, AnyState], Array]


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
        super().__init__(values, sigma, bias=bias, gain=gain, delay=delay)
        self.at = body_point(f"{type(self).__name__}.at", at)

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

    __init__ = _AtPoint.__init__


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

    __init__ = _AtPoint.__init__


class Orientation(AbstractChannel):
    """Quaternions, scalar first, body to fixed axes.

    Their misfit is the rotation from the predicted to the measured one, FIXED axes
    [rad], and so is their noise: along its axis, by ``2 sin(angle / 2)``, which of
    small rotations is the angle.

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
        """Rotation from the predicted to the measured orientation [rad].

        Smooth up to half a turn, where it is 2 at most.
        """
        size = jnp.sqrt(jnp.sum(self.values**2, axis=1, keepdims=True))
        back = predicted * jnp.array([[1.0, -1.0, -1.0, -1.0]])
        apart = multiply((self.values / size).T, back.T)
        # of the shorter of the two ways round
        along = jnp.where(apart[:1] < 0.0, -1.0, 1.0)
        return (2.0 * along * apart[1:]).T

    def without(self, misfit: Float[np.ndarray, "T 3"]) -> Float[np.ndarray, "T 4"]:
        """Unit quaternions from which the misfit's rotation leads to the samples."""
        measured = np.asarray(self.values)
        size = np.linalg.norm(measured, axis=1, keepdims=True)
        sine = 0.5 * misfit
        cosine = np.sqrt(np.maximum(1.0 - np.sum(sine**2, axis=1, keepdims=True), 0.0))
        back = np.concatenate([cosine, -sine], axis=1)
        found = multiply(jnp.asarray(back.T), jnp.asarray((measured / size).T))
        return np.asarray(found).T

    def variation(self) -> Float[np.ndarray, "T 3"]:
        """Rotations from the mean orientation to the samples [rad]."""
        measured = np.asarray(self.values)
        known = measured[np.isfinite(measured).all(axis=1)]
        # either sign is the same orientation: the axis that all lie nearest to
        middle = np.linalg.eigh(known.T @ known)[1][:, -1]
        return np.asarray(self.misfit(jnp.asarray(np.tile(middle, (len(measured), 1)))))


class ContactPath(AbstractSensor):
    """Contact point on the base, BASE axes [m].

    Attributes:
        values: Shape (T, 3).
        sigma: Shape (3,), or None.
        delay: [s].
        bias: [m], shape (3,).
        gain: [1], shape (3,).
    """

    __init__ = AbstractSensor.__init__

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

    __init__ = AbstractSensor.__init__

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
        super().__init__(values, sigma, bias=bias, gain=gain, delay=delay)

    def columns(self) -> None:
        """Any number."""
        return

    def observed(self, scene: Scene, t: Array, state: AnyState) -> Float[Array, " k"]:
        """What the function gives.

        Raises:
            FieldError: other than one number for each column: JAX would repeat one.
        """
        found = jnp.atleast_1d(self.function(scene, t, state))
        if found.shape != self.values.shape[1:]:
            problem = (
                f"gives numbers of shape {found.shape}, and its values have "
                f"{self.values.shape[1]} columns"
            )
            remedy = "return one number for each column of the values"
            raise FieldError("Observed.function", self.function, problem, remedy)
        return found
