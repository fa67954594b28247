"""What a record holds: channels of sensors, and what a motion predicts for them.

A sensor reads ``gain M(misalignment) x(t - delay) + bias`` of what it measures, x. Its
noise is white, with standard deviation ``sigma``; sigma left out is estimated by a fit.
"""

import abc
from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from ..dynamics.scene import Scene
from ..kinematics.voronets import AnyState
from ..validation.checks import FieldError, is_traced, real, real_numbers


class AbstractChannel(eqx.Module):
    """Samples of one sensor.

    Attributes:
        values: What it read, shape (T, k); NaN where a sample is missing.
        sigma: Standard deviation of its noise [unit of the values], shape (k,), or
            None: to be estimated.
        delay: The sample at t shows the motion at ``t - delay`` [s].
    """

    values: Float[Array, "T k"]
    sigma: Float[Array, " k"] | None
    delay: Float[Array, ""]

    def _keep(
        self, values: ArrayLike, sigma: ArrayLike | None, delay: ArrayLike
    ) -> None:
        name = type(self).__name__
        samples = samples_of(f"{name}.values", values, self.columns())
        self.values = jnp.asarray(samples)
        self.delay = real(f"{name}.delay", delay, (), "a time in seconds")
        self.sigma = None
        if sigma is not None:
            self.sigma = _sigma(f"{name}.sigma", sigma, self.noise_columns())

    def columns(self) -> int | None:
        """How many columns its values have; None: any number."""
        return 3

    def noise_columns(self) -> int:
        """How many numbers of a sample have noise of their own."""
        return self.values.shape[1]

    @abc.abstractmethod
    def observed(self, scene: Scene, t: Array, state: AnyState) -> Float[Array, " k"]:
        """What it measures, of one state."""

    def misfit(self, predicted: Float[Array, "T k"]) -> Float[Array, "T m"]:
        """Measured minus predicted [unit of sigma], shape (T, m)."""
        return self.values - predicted

    def without(self, misfit: Float[np.ndarray, "T m"]) -> Float[np.ndarray, "T k"]:
        """Samples without a misfit: what the sensor would have read."""
        return np.asarray(self.values) - misfit

    def variation(self) -> Float[np.ndarray, "T m"]:
        """Samples without their mean [unit of sigma], NaN where one is missing.

        As many numbers a sample as its misfit has.
        """
        values = np.asarray(self.values)
        counts = np.maximum(np.isfinite(values).sum(axis=0), 1)
        return values - np.nansum(values, axis=0) / counts


def samples_of(field: str, values: ArrayLike, columns: int | None) -> np.ndarray:
    """Samples as an array of two axes.

    Raises:
        FieldError: another shape, no numbers, or infinite ones.
    """
    remedy = "give one row of numbers for each time, NaN where one is missing"
    if is_traced(values):
        raise FieldError(field, values, "must be known numbers", remedy)
    samples = real_numbers(field, values, remedy).astype(float, copy=False)
    if samples.ndim == 1 and columns in (None, 1):
        samples = samples[:, None]
    wanted = "n" if columns is None else str(columns)
    if samples.ndim != 2 or columns not in (None, samples.shape[1]):
        problem = f"must have shape (T, {wanted}), not {samples.shape}"
        raise FieldError(field, "...", problem, "give one row for each time")
    if np.isinf(samples).any():
        row = int(np.argwhere(np.isinf(samples))[0, 0])
        problem = f"is infinite in row {row}"
        raise FieldError(field, "...", problem, "mark missing samples by NaN")
    return samples


def _sigma(field: str, sigma: ArrayLike, columns: int) -> Array:
    remedy = "give the standard deviation of its noise"
    try:
        known = np.broadcast_to(np.asarray(sigma, float), (columns,))
    except (TypeError, ValueError) as error:
        problem = f"must be a number or {columns} numbers"
        raise FieldError(field, sigma, problem, remedy) from error
    if not np.all((known > 0.0) & (known < np.inf)):
        raise FieldError(field, sigma, "must be positive", remedy)
    return jnp.asarray(known)


class AbstractSensor(AbstractChannel):
    """A channel with a bias and a gain.

    Attributes:
        values: What it read, shape (T, k).
        sigma: Of its noise, shape (k,), or None.
        delay: [s].
        bias: Added to what it measures [unit of the values], shape (k,).
        gain: By which it is multiplied [1], shape (k,).
    """

    bias: Float[Array, " k"]
    gain: Float[Array, " k"]

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
            values: Samples [its unit], shape (T, k); NaN where one is missing.
            sigma: Standard deviation of the noise, one or k; None: estimated.
            bias: Of the sensor, or offset of the axes that it is measured on, one or k.
            gain: Of the sensor, or scale of these axes [1], one or k.
            delay: [s].

        Raises:
            FieldError: shapes that do not fit, a sigma that is not positive.
        """
        self._keep(values, sigma, delay)
        self._calibrate(bias, gain)

    def _calibrate(self, bias: ArrayLike, gain: ArrayLike) -> None:
        name, size = type(self).__name__, self.values.shape[1]
        each: Callable[[ArrayLike], np.ndarray]
        each = lambda x: np.broadcast_to(np.asarray(x, float), (size,))
        try:
            self.bias, self.gain = jnp.asarray(each(bias)), jnp.asarray(each(gain))
        except (TypeError, ValueError) as error:
            problem = f"and bias must be a number or {size} numbers"
            remedy = "give one for each column"
            raise FieldError(f"{name}.gain", (gain, bias), problem, remedy) from error
        for field, known in (("bias", self.bias), ("gain", self.gain)):
            if not np.isfinite(np.asarray(known)).all():
                remedy = "give its value, or leave it out"
                raise FieldError(f"{name}.{field}", known, "must be finite", remedy)

    def misfit(self, predicted: Float[Array, "T k"]) -> Float[Array, "T k"]:
        """Measured minus predicted, with gain and bias."""
        return self.values - (self.gain[None] * predicted + self.bias[None])


def body_point(field: str, at: ArrayLike) -> Float[Array, "3"]:
    """Where a sensor sits on the body, body axes [m].

    Raises:
        FieldError: not three finite numbers.
    """
    return real(field, at, (3,), "three lengths in metres, body axes")
