"""A base shaken by a recorded acceleration: piecewise linear, integrated exactly."""

from collections.abc import Sequence
from contextlib import nullcontext
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.core import eval_context
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from ..validation.checks import (
    FieldError,
    dimension,
    is_traced,
    real,
    refuse,
    refuse_disorder,
)
from .base_motion import AbstractBaseMotion, BaseKinematics

# How far a sample may be from equal spacing [steps]: times printed with few digits are.
# A sample that is missing puts another a quarter of a step off or more; below half a
# step, a time lies in the interval that equal spacing gives, or in one beside it.
_OFF = 0.2


class _Sampled(AbstractBaseMotion):
    """A motion by samples: derivatives jump at them."""

    time: eqx.AbstractVar[Float[Array, " N"]]

    @property
    def kinks(self) -> Float[Array, " N"]:
        """The sample times [s]."""
        return self.time

    @property
    def kept_away(self) -> int:
        """One: derivatives by the clock jump, though the acceleration does not."""
        return 1


class RecordedMotion(_Sampled):
    """A translation by samples of its acceleration, linear between samples.

    Velocity and position are the exact integrals, whatever the samples are: a fit, a
    sweep or a derivative by ``acceleration`` moves them along. Every sample time is a
    kink: the jerk jumps there, and the integrator ends a step on it.

    Attributes:
        time: Sample times [s], shape (N,), equally spaced but for their rounding: none
            is a fifth of a step or more from equal spacing between the ends.
        acceleration: [m/s^2], fixed axes, shape (N, 3).
        start_velocity: At the first sample [m/s], shape (3,).
        start_position: At the first sample [m], shape (3,).
    """

    time: Float[Array, " N"]
    acceleration: Float[Array, "N 3"]
    start_velocity: Float[Array, "3"]
    start_position: Float[Array, "3"]

    def __init__(
        self,
        time: ArrayLike | Sequence[ArrayLike],
        acceleration: ArrayLike | Sequence[Any],
        start_velocity: ArrayLike | Sequence[ArrayLike] = (0.0, 0.0, 0.0),
        start_position: ArrayLike | Sequence[ArrayLike] = (0.0, 0.0, 0.0),
    ):
        """Make a motion from a record.

        Args:
            time: Sample times [s], shape (N,), N >= 2, equally spaced, or rounded by
                less than a fifth of a step; the samples hold at the times given.
            acceleration: [m/s^2], shape (N,) for the x axis alone, or (N, 1), (N, 2),
                (N, 3) for x, y and z of the fixed axes.
            start_velocity: At the first sample [m/s], shape (3,).
            start_position: At the first sample [m], shape (3,).

        Raises:
            FieldError: gaps (numbers that are not finite), times out of order, unequal
                steps, arrays that do not belong together.

        Outside the record the motion is not known: ``simulate`` refuses times there.
        """
        self.time = _equal_steps(time)
        samples = _components(acceleration, self.time.shape[0])
        dtype = jnp.result_type(self.time, samples)
        self.time = self.time.astype(dtype)
        self.acceleration = samples.astype(dtype)
        field = "RecordedMotion.start_velocity"
        velocity = real(field, start_velocity, (3,), "three components in m/s")
        field = "RecordedMotion.start_position"
        position = real(field, start_position, (3,), "three lengths in metres")
        self.start_velocity = velocity.astype(dtype)
        self.start_position = position.astype(dtype)

    @property
    def velocity(self) -> Float[Array, "N 3"]:
        """At the samples [m/s], shape (N, 3)."""
        return self.for_runs().velocity

    @property
    def position(self) -> Float[Array, "N 3"]:
        """At the samples [m], shape (N, 3)."""
        return self.for_runs().position

    @property
    def span(self) -> tuple[Array, Array]:
        """First and last sample time [s]."""
        return self.time[0], self.time[-1]

    def at(self, t: Float[Array, ""]) -> BaseKinematics:
        """Position, velocity and acceleration at a time [s]; NaN outside the record."""
        return self.for_runs().at(t)

    def for_runs(self) -> "IntegratedRecord":
        """The record with velocity and position at its samples."""
        return IntegratedRecord(self.time, self.acceleration, *_tables(self))


class IntegratedRecord(_Sampled):
    """A record with its integrals at the samples, as a run takes it.

    Attributes:
        time: Sample times [s], shape (N,).
        acceleration: [m/s^2], fixed axes, shape (N, 3).
        velocity: [m/s], shape (N, 3).
        position: [m], shape (N, 3).
    """

    time: Float[Array, " N"]
    acceleration: Float[Array, "N 3"]
    velocity: Float[Array, "N 3"]
    position: Float[Array, "N 3"]

    def at(self, t: Float[Array, ""]) -> BaseKinematics:
        """Position, velocity and acceleration at a time [s]; NaN outside the record."""
        t = jnp.asarray(t, self.time.dtype)
        first, last = self.time[0], self.time[-1]
        count = self.time.shape[0]
        step = (last - first) / (count - 1)
        # a multiple of the step may be off by its rounding: far less than a step
        slack = 1e-6 * step
        known = (t >= first - slack) & (t <= last + slack)
        i = jnp.floor((t - first) / step).astype(jnp.int32)
        i = jnp.clip(i, 0, count - 2)
        # the samples are where they are, and equal spacing may be off by an interval
        i = jnp.where(
            t < self.time[i], i - 1, jnp.where(t < self.time[i + 1], i, i + 1)
        )
        i = jnp.clip(i, 0, count - 2)
        s = jnp.where(known, t - self.time[i], jnp.nan)
        a, v, x = self.acceleration[i], self.velocity[i], self.position[i]
        jerk = (self.acceleration[i + 1] - a) / (self.time[i + 1] - self.time[i])
        return BaseKinematics(
            position=x + s * (v + s * (a / 2.0 + s * (jerk / 6.0))),
            velocity=v + s * (a + s * (jerk / 2.0)),
            acceleration=a + s * jerk,
        )


def _equal_steps(time: Any) -> Array:
    field = "RecordedMotion.time"
    times = real(field, time, (None,), "equally spaced sample times in seconds")
    if times.shape[0] < 2:
        raise FieldError(
            field, time, "must hold two samples or more", "give the record"
        )
    if not is_traced(times):
        # as given: single precision may round two times to one
        refuse_disorder(field, np.asarray(time, np.float64))

    def uneven(t: Any) -> Any:  # a NumPy array or a traced one
        _, step, off = _spacing(t)
        return ~((step > 0) & (abs(off) < _OFF * step).all())

    worst = "" if is_traced(times) else _worst(np.asarray(times))
    return refuse(
        times,
        uneven,
        field,
        f"must grow by equal steps{worst}",
        "fill the gap, or resample the record",
    )


def _spacing(t: Any) -> tuple[Any, Any, Any]:
    """Steps, the mean one, and how far samples are from equal spacing [s]."""
    library = jnp if is_traced(t) else np
    count = t.shape[0]
    step = (t[-1] - t[0]) / (count - 1)
    return (
        library.diff(t),
        step,
        t - (t[0] + step * library.arange(count, dtype=t.dtype)),
    )


def _worst(times: np.ndarray) -> str:
    """Where a clock is farthest from equal steps."""
    steps, step, off = _spacing(times)
    usual = np.median(steps)
    i, j = int(np.argmax(np.abs(steps - usual))), int(np.argmax(np.abs(off)))
    return (
        f" (the step after {float(times[i]):g} s is {steps[i]:g} s, the usual one "
        f"{usual:g} s; the sample at {float(times[j]):g} s is {abs(off[j]):.3g} s from "
        f"equal spacing, and roundings of less than {_OFF * step:.3g} s are allowed)"
    )


def _components(acceleration: Any, count: int) -> Array:
    """Samples of x, y and z from one to three components."""
    field = "RecordedMotion.acceleration"
    meaning = f"{count} samples in m/s^2, shape ({count},) or ({count}, 1 to 3)"
    flat = dimension(acceleration) == 1
    samples = real(field, acceleration, (None,) if flat else (None, None), meaning)
    samples = samples[:, None] if flat else samples
    found, width = samples.shape
    if found != count or not 1 <= width <= 3:
        raise FieldError(
            field,
            samples.shape,
            f"must hold one row for each of the {count} sample times, of one to three "
            "components",
            f"give {meaning}",
        )
    return jnp.pad(samples, ((0, 0), (0, 3 - width)))


def _tables(record: RecordedMotion) -> tuple[Array, Array]:
    """Velocity and position at the samples.

    Of known numbers in double precision, outside of what may be traced around.
    """
    given = (
        *(record.time, record.acceleration),
        *(record.start_velocity, record.start_position),
    )
    dtype = record.time.dtype
    traced = is_traced(*given)
    # a clock may be known where the samples are traced
    wide = [x if is_traced(x) else np.asarray(x, np.float64) for x in given]
    eps = float(np.finfo(dtype).eps)
    found = _integrals(jnp if traced else np, wide, eps)
    with nullcontext() if traced else eval_context():
        velocity, position = (jnp.asarray(x, dtype) for x in found)
    return velocity, position


def _integrals(library: Any, given: Sequence[Any], eps: float) -> tuple[Any, Any]:
    """Velocity and position at the samples, exact for linear pieces.

    Args:
        library: ``jnp`` where some are traced, else ``np``.
        given: Times [s], shape (N,), accelerations [m/s^2], shape (N, 3), velocity
            [m/s] and position [m] at the first sample, shape (3,).
        eps: Relative rounding of the times [1].
    """
    time, acceleration, velocity, position = given
    step = _steps(time, eps)[:, None]
    a, b = acceleration[:-1], acceleration[1:]
    gained = library.cumsum(step * (a + b) / 2.0, axis=0)
    velocities = library.concatenate([velocity[None], velocity[None] + gained])
    travelled = step * (velocities[:-1] + step * (2.0 * a + b) / 6.0)
    positions = position[None] + library.cumsum(travelled, axis=0)
    return velocities, library.concatenate([position[None], positions])


def _steps(time: Any, eps: float) -> Any:
    """Steps of a clock [s], but for what only the rounding of its times makes of them.

    In single precision that is a thousandth of a step late in a long record, and sums
    to 2 % of the way of a base.
    """
    steps, step, off = _spacing(time)
    # half a rounding each of both ends, of the sample, and of what is computed of them
    if not is_traced(time):
        near = 4.0 * eps * max(abs(time[0]), abs(time[-1]))
        return step + np.diff(np.where(abs(off) <= near, 0.0, off))
    near = 4.0 * eps * jnp.maximum(abs(time[0]), abs(time[-1]))
    even = step + jnp.diff(jnp.where(abs(off) <= near, 0.0, off))
    return steps + lax.stop_gradient(even - steps)  # each time has its derivative
