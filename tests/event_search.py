"""Searches that miss no zero: of functions of time, and of the way to a surface.

Between two zeros of its derivative a function is monotone: so its zeros are found from
those of its derivatives, down to one that is sampled so densely, and refined at its
extremes, that none of its zeros is missed.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

Function = Callable[[np.ndarray], np.ndarray]
Surface = Callable[[np.ndarray, np.ndarray], np.ndarray]

# Of the search for zeros in time [s]: the fastest plates of the tests (12 Hz) get 830
# samples a period; what lies between samples is found at the refined extremes.
SAMPLING = 1e-4
# A search splits what is left of an interval in so many, so often: 16^-14 = 1e-17 of it
# is left, below the rounding of a time.
SPLITS, ROUNDS = 16, 14
# Samples of a surface beside a ball's centre to each side, out to so many radii: what
# is farther than one does not touch. Surfaces must be smooth over 1/20 of a radius.
CELLS, REACH = 24, 1.2
NEWTON = 12  # steps to a nearest point, from 1/20 of a radius: their error squares


class GrazingError(ValueError):
    """A change that hangs on less than the margin."""


class Margin(NamedTuple):
    """How near to a change of another kind a motion may come.

    Attributes:
        gap: Least gap [m] where it is least without a landing, and how deep a landing
            would go at least.
        speed: Of rebounds beside the speed of rest [m/s].
        acceleration: Of what presses, or of what slips, beside zero [m/s^2].
        time: Between a change and what may come of it, or the end [s].
        approach: Of a thrown ball to the surface, and of a slip that does not end
            [m/s].
    """

    gap: float = 0.0
    speed: float = 0.0
    acceleration: float = 0.0
    time: float = 0.0
    approach: float = 0.0

    def check(self, which: str, value) -> None:
        """Refuse a value that is nearer to zero than it may be."""
        if np.any(np.abs(value) < getattr(self, which)):
            raise GrazingError(which)


ANY = Margin()


def root(f: Function, low: float, high: float, sign: float) -> float:
    """First time at which f has no longer the sign that it has at low."""
    for _ in range(ROUNDS):
        times = np.linspace(low, high, SPLITS + 1)
        changed = np.sign(f(times))[1:] != sign
        if not changed.any():
            return high  # by rounding alone
        first = int(np.argmax(changed))
        low, high = times[first], times[first + 1]
    return float(0.5 * (low + high))


def least(f: Function, low: float, high: float) -> float:
    """Where f is least between two times, if it has one minimum there."""
    for _ in range(ROUNDS):
        times = np.linspace(low, high, SPLITS + 1)
        at = int(np.argmin(f(times)))
        low, high = times[max(at - 1, 0)], times[min(at + 1, SPLITS)]
    return float(0.5 * (low + high))


def extremes(f: Function, times, y, below: float = np.inf) -> np.ndarray:
    """Where f, between samples, comes nearest to zero without a change of its sign.

    Args:
        f: Of time.
        times: In order.
        y: Its values there.
        below: Only near samples of at most this size.
    """
    size, sign = np.abs(y), np.sign(y)
    inner = (size[1:-1] < size[:-2]) & (size[1:-1] <= size[2:])
    inner &= (sign[1:-1] == sign[:-2]) & (sign[1:-1] == sign[2:])
    inner &= size[1:-1] < below
    found = [
        least(lambda t, s=sign[i]: s * f(t), times[i - 1], times[i + 1])
        for i in 1 + np.flatnonzero(inner)
    ]
    return np.array(found)


def zeros(f: Function, start: float, end: float, margin: Margin = ANY) -> np.ndarray:
    """All zeros of an acceleration between two times, by dense samples."""
    times = np.linspace(start, end, 2 + int((end - start) / SAMPLING))
    nearest = extremes(f, times, f(times))
    margin.check("acceleration", f(nearest) if len(nearest) else 1.0)
    return changes(f, np.sort(np.concatenate([times, nearest])))


def changes(f: Function, knots: np.ndarray, first: float | None = None) -> np.ndarray:
    """Zeros of f, which is monotone between knots.

    Args:
        f: Of time.
        knots: In order.
        first: Its exact value at the first knot; where it is zero, f has the sign there
            that it has at the next.
    """
    sign = np.sign(f(knots))
    if first is not None:
        sign[0] = np.sign(first) or sign[1]
    at = np.flatnonzero(sign[1:] != sign[:-1])
    return np.array([root(f, knots[i], knots[i + 1], sign[i]) for i in at])


def between(start: float, inner: np.ndarray, end: float) -> np.ndarray:
    """Knots from a start to an end."""
    inside = inner[(inner > start) & (inner < end)]
    return np.concatenate([[start], inside, [end]])


def slopes(height: Surface, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Both slopes of a height, by complex steps: exact to rounding."""
    tiny = 1e-40
    along = height(x + 1j * tiny, y), height(x, y + 1j * tiny)
    return np.stack([h.imag for h in along]) / tiny


def improved(height: Surface, centers: np.ndarray, at: np.ndarray, most: float):
    """Points nearest to centres, by Newton's method.

    Args:
        height: z of x and y.
        centers: [m], shape (3, n).
        at: x and y where the search begins [m], shape (2, n).
        most: Longest step [m].
    """
    h = 1e-5  # [m]; of differences for curvatures, which only lead the steps

    def unbalance(x, y):
        return [x, y] - centers[:2] + (height(x, y) - centers[2]) * slopes(height, x, y)

    for _ in range(NEWTON):
        x, y = at
        (a, c), (b, d) = (
            (unbalance(*(at + e)) - unbalance(*(at - e))) / (2.0 * h)
            for e in h * np.eye(2)[:, :, None]
        )
        u, v = unbalance(x, y)
        step = np.stack([d * u - b * v, a * v - c * u]) / (a * d - b * c)
        at = at - np.clip(step, -most, most)
    return np.stack([*at, height(*at)])


def nearby(height: Surface, centers: np.ndarray, radius: float):
    """All points of a surface that are nearest to a centre among their neighbours.

    Args:
        height: z of x and y.
        centers: [m], shape (3, n).
        radius: What is farther than one and a half [m] is left out.

    Returns:
        The number of the centre of each, its distance [m], and the point, shape (3, k).
    """
    beside = radius * np.linspace(-REACH, REACH, 2 * CELLS + 1)
    x = centers[0, :, None, None] + beside[:, None]
    y = centers[1, :, None, None] + beside
    x, y = np.broadcast_arrays(x, y)
    up = height(x, y) - centers[2, :, None, None]
    squared = beside[:, None] ** 2 + beside**2 + up**2
    inner = squared[:, 1:-1, 1:-1]
    lowest = inner < (1.5 * radius) ** 2
    count = 2 * CELLS - 1
    for i in range(3):
        for j in range(3):
            lowest &= inner <= squared[:, i : i + count, j : j + count]
    n, i, j = np.nonzero(lowest)
    start = np.stack([x[n, i + 1, j + 1], y[n, i + 1, j + 1]])
    point = improved(height, centers[:, n], start, beside[1] - beside[0])
    distance = np.linalg.norm(point - centers[:, n], axis=0)
    # where Newton's method led elsewhere, what was sampled is nearer
    return n, np.minimum(distance, np.sqrt(inner[n, i, j])), point


def clearance(height: Surface, centers: np.ndarray, radius: float) -> np.ndarray:
    """Between a ball and a surface [m], at most half a radius, shape (n,)."""
    nearest = np.full(centers.shape[1], 1.5 * radius)
    n, distance, _ = nearby(height, centers, radius)
    np.minimum.at(nearest, n, distance)
    return nearest - radius
