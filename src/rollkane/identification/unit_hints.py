"""Gyros that were read in degrees, or in radians, where it is the other."""

import warnings

import numpy as np
from jaxtyping import Float

from .body_sensors import Gyro
from .experiments import Problem

_DEGREES = 180.0 / np.pi  # in a radian
_NEAR = 0.3  # relative: a guess seldom predicts rates better, nor worse by chance


def hint_of_units(problem: Problem, z: Float[np.ndarray, " P"]) -> None:
    """Warn of gyros whose samples are 180/pi times what the guess predicts, or a part.

    Args:
        problem: Records and model.
        z: The guess.
    """
    gyros = [
        (number, name, channel)
        for number, record in enumerate(problem.records)
        for name, channel in record.channels.items()
        if isinstance(channel, Gyro)
    ]
    if not gyros:
        return
    misfits = problem.channel_misfits(z, reached=True)
    sigmas = problem.sigmas()
    measured = [
        {name: np.asarray(c.values) for g in groups for name, c in g.channels.items()}
        for groups in problem.groups
    ]
    for number, name, _ in gyros:
        samples = measured[number][name]
        predicted = samples - misfits[number][name] * sigmas[number][name]
        counted = np.isfinite(predicted)
        ratio = _size(samples[counted]) / max(_size(predicted[counted]), 1e-300)
        _warn(name if len(problem.records) == 1 else f"{name} {{{number}}}", ratio)


def _size(values: Float[np.ndarray, " N"]) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else 0.0


def _warn(name: str, ratio: float) -> None:
    for factor, looks, unit in (
        (_DEGREES, "degrees per second", "deg/s"),
        (1.0 / _DEGREES, "radians per second that were turned from degrees", "rad/s"),
    ):
        if abs(ratio / factor - 1.0) < _NEAR:
            channel = name.split()[0]
            message = (
                f"{name}: its values look like {looks}: they are {ratio:.3g} times "
                f'what the guess predicts; give units={{"{channel}": "{unit}"}} to '
                f"rollkane.read_record (--units {channel}={unit})"
            )
            warnings.warn(message, UserWarning, stacklevel=4)
