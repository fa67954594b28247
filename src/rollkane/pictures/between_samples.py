"""A motion between its outputs, as the viewer shows it: films are made of it.

Positions follow the cubic through two outputs with the velocities of both; orientations
turn with the mean angular velocity, so that what turns more than once between two
outputs does so here, too; all else is linear.
"""

from typing import NamedTuple

import numpy as np

from ..geometry.numpy_rotations import product
from .motion_samples import MotionSamples

_SMALL = 1e-12  # angle [rad] below which a turn is its own first order


class _Between(NamedTuple):
    """Which outputs times lie between, and where.

    Attributes:
        low: Rows of the outputs before, shape (n,).
        high: Rows of those behind, shape (n,).
        share: Of the way between them [1], shape (n, 1).
        step: From the one to the other [s], shape (n, 1).
    """

    low: np.ndarray
    high: np.ndarray
    share: np.ndarray
    step: np.ndarray


def at_times(motion: MotionSamples, times: np.ndarray) -> MotionSamples:
    """The motion at other times than its outputs.

    Args:
        motion: Its outputs, all of them reached.
        times: Between the first and the last of them [s], shape (n,).
    """
    at = _located(motion.time, times)
    columns = {name: _linear(column, at) for name, column in motion.columns.items()}
    columns["time"] = times
    columns["position"] = _placed(motion.position, motion.velocity, at)
    columns["orientation"] = _turned(motion.orientation, motion.angular_velocity, at)
    columns["base_origin"] = _placed(motion.base_origin, motion.base_velocity, at)
    columns["base_orientation"] = _turned(
        motion.base_orientation, motion.base_angular_velocity, at
    )
    found = motion._replace(**columns)
    for k in range(motion.rolling.shape[1]):
        place, velocity, turn, spin = (
            motion.rolling_column(k, name)
            for name in ("position", "velocity", "orientation", "angular_velocity")
        )
        found.rolling_column(k, "position")[:] = _placed(place, velocity, at)
        found.rolling_column(k, "orientation")[:] = _turned(turn, spin, at)
    return found


def _located(known: np.ndarray, times: np.ndarray) -> _Between:
    if len(known) == 1:
        none = np.zeros(len(times), dtype=int)
        return _Between(none, none, np.zeros((len(times), 1)), np.ones((len(times), 1)))
    way = 1.0 if known[-1] > known[0] else -1.0  # runs may go backwards in time
    place = np.interp(way * times, way * known, np.arange(float(len(known))))
    low = np.clip(np.floor(place).astype(int), 0, len(known) - 2)
    step = known[low + 1] - known[low]
    share = np.clip((times - known[low]) / step, 0.0, 1.0)
    return _Between(low, low + 1, share[:, None], step[:, None])


def _linear(column: np.ndarray, at: _Between) -> np.ndarray:
    share = at.share.reshape(-1, *[1] * (column.ndim - 1))
    return column[at.low] + share * (column[at.high] - column[at.low])


def _placed(place: np.ndarray, velocity: np.ndarray, at: _Between) -> np.ndarray:
    """Cubic through places with the velocities of both ends, shape (n, 3)."""
    p, q, s = place[at.low], place[at.high], at.share
    bend = s * (1.0 - s) * at.step
    bent = bend * ((1.0 - s) * velocity[at.low] - s * velocity[at.high])
    return p + s * s * (3.0 - 2.0 * s) * (q - p) + bent


def _turned(turn: np.ndarray, spin: np.ndarray, at: _Between) -> np.ndarray:
    """Turn with the mean angular velocity; what is left over is spread evenly."""
    start, end = turn[at.low], turn[at.high]
    mean = 0.5 * at.step * (spin[at.low] + spin[at.high])
    rest = _vector(product(end, _inverse(product(_by(mean), start))))
    return product(_by(at.share * rest), product(_by(at.share * mean), start))


def _inverse(q: np.ndarray) -> np.ndarray:
    return q * np.array([1.0, -1.0, -1.0, -1.0])


def _by(vector: np.ndarray) -> np.ndarray:
    """Rotation by the length of a vector about its direction, shape (n, 4)."""
    angle = np.linalg.norm(vector, axis=1, keepdims=True)
    large = angle > _SMALL
    share = np.where(large, np.sin(angle / 2) / np.where(large, angle, 1.0), 0.5)
    return np.concatenate([np.cos(angle / 2), share * vector], axis=1)


def _vector(q: np.ndarray) -> np.ndarray:
    """The inverse of ``_by``, the shorter way, shape (n, 3)."""
    q = np.where(q[:, :1] < 0.0, -q, q)
    sine = np.linalg.norm(q[:, 1:], axis=1, keepdims=True)
    large = sine > _SMALL
    angle = 2.0 * np.arctan2(sine, q[:, :1])
    return q[:, 1:] * np.where(large, angle / np.where(large, sine, 1.0), 2.0)
