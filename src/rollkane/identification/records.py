"""Records of motions: times and what sensors read."""

from collections.abc import Mapping

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from ..validation.checks import (
    FieldError,
    is_traced,
    real,
    real_numbers,
    refuse_disorder,
)
from .channels import AbstractChannel
from .sensors import Orientation


class Record(eqx.Module):
    """What was measured of one motion.

    Attributes:
        time: When samples were taken [s], shape (T,), increasing; spacing may vary.
        channels: By name; paths of their numbers begin with it (``"gyro.bias"``).
        start_time: When the start state holds [s].
    """

    time: Float[Array, " T"]
    channels: dict[str, AbstractChannel]
    start_time: Float[Array, ""]

    def __init__(
        self,
        time: ArrayLike,
        channels: Mapping[str, AbstractChannel],
        start_time: float | None = None,
    ):
        """Make a record.

        Args:
            time: [s], shape (T,), T >= 2, strictly increasing.
            channels: ``rollkane.Gyro`` and others, by name.
            start_time: When the start state holds [s], no later than the first sample;
                the first sample's time when left out.

        Raises:
            FieldError: times out of order, channels of another length, no channel, a
                name that belongs to the scene.
        """
        known = _times(time)
        _check_named(channels)
        for name, channel in channels.items():
            _check_channel(name, channel, known.size)
        self.time = jnp.asarray(known)
        self.channels = dict(channels)
        first = known[0]
        if start_time is not None:
            meaning = "a time in seconds"
            first = float(real("Record.start_time", start_time, (), meaning))
        if first > known[0]:
            problem = f"is after the first sample, at {known[0]:g} s"
            remedy = "give a time before the samples, or leave earlier samples out"
            raise FieldError("Record.start_time", start_time, problem, remedy)
        self.start_time = jnp.asarray(first)


# Roots of paths that are not a channel's.
RESERVED = ("scene", "start", "modes", "body", "base", "supported", "loads", "contact")


def _times(time: ArrayLike) -> np.ndarray:
    remedy = "give increasing times in seconds"
    if is_traced(time):
        raise FieldError("Record.time", time, "must be known numbers", remedy)
    known = real_numbers("Record.time", time, remedy).astype(float, copy=False)
    if known.ndim != 1 or known.size < 2:
        problem = f"must have shape (T,) with T >= 2, not {known.shape}"
        raise FieldError("Record.time", "...", problem, remedy)
    if not np.isfinite(known).all():
        row = int(np.argmin(np.isfinite(known)))
        raise FieldError("Record.time", "...", f"is not finite in row {row}", remedy)
    refuse_disorder("Record.time", known)
    return known


def _check_named(channels: object) -> None:
    if not isinstance(channels, Mapping) or not channels:
        remedy = 'give {"gyro": rollkane.Gyro(values, sigma=0.02)}'
        raise FieldError("Record.channels", channels, "must name channels", remedy)


def _check_channel(name: str, channel: object, size: int) -> None:
    field = f"Record.channels[{name!r}]"
    if not isinstance(channel, AbstractChannel):
        remedy = "give rollkane.Gyro, Accelerometer, Position, ..., Observed"
        raise FieldError(field, channel, "must be a channel", remedy)
    if not str(name).isidentifier() or name in RESERVED:
        remedy = 'give another name, for example "gyro"'
        raise FieldError(field, name, "cannot be the name of a channel", remedy)
    if channel.values.shape[0] != size:
        problem = f"has {channel.values.shape[0]} samples at {size} times"
        raise FieldError(field, "...", problem, "give one for each time")
    if np.isnan(np.asarray(channel.values)).all():
        raise FieldError(field, "...", "has no samples, all are NaN", "leave it out")
    if isinstance(channel, Orientation):
        length = np.linalg.norm(np.asarray(channel.values), axis=1)
        if np.nanmax(np.abs(length - 1.0)) > 0.05:
            problem = f"has quaternions of length {np.nanmax(length):.3g}"
            remedy = "are these Euler angles, or degrees? give unit quaternions"
            raise FieldError(field, "...", problem, remedy)
