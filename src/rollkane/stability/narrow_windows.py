"""Two changes of stability between neighbouring points of a branch.

At both ends of such a window all is alike: what passes zero and comes back shows by a
dip on the way to it. Where it dips between three points the bottom is looked for.
"""

from collections.abc import Callable, Sequence
from typing import Any, Generic, NamedTuple, TypeAlias

import numpy as np

from .branch_segments import Followed, P, Passing, Segment, Way
from .critical_points import critical_on

# Steps to the bottom of a dip, each by a parabola: one that is a parabola takes one or
# two, others gain digits as secants do.
_TRIES = 12
# Of a dip's width: where two steps to its bottom are one. A window that is narrower is
# not found.
_SAME = 1e-6
# How far along a last step, and from the end of a first one, the way is looked at, to
# see whether it comes from a dip: far enough for rounding, 1e-10, near enough for a
# slope.
_BESIDE = 0.99
# Of errors: what is further off the axis is damped, and not on it by rounding.
_OFF = 10.0
_Test: TypeAlias = Callable[[P], float]
_Values: TypeAlias = np.ndarray[Any, np.dtype[np.complex128]]


class _Dip(NamedTuple, Generic[P]):
    """Three points of a branch, s along the middle one's or first one's tangent."""

    base: P
    at: tuple[float, float, float]
    points: tuple[P, P, P]


def windows(
    way: Way[P], points: Sequence[P], lengths: Sequence[float]
) -> list[tuple[float, Passing[P]]]:
    """What is critical in windows that lie between neighbouring points.

    Args:
        way: Along the branch.
        points: Of a way along it, with tangents that lead on.
        lengths: How far along its tangent from each to the next one.

    Returns:
        Places, by number of the points and parts of a step, and what is critical.
    """
    found: list[tuple[float, Passing[P]]] = []
    for k in range(1, len(points) - 1):
        before, here, after = points[k - 1 : k + 2]
        at = -lengths[k - 1], 0.0, lengths[k]
        for s, one in _within(way, _Dip(here, at, (before, here, after))):
            place = s / (lengths[k] if s > 0.0 else lengths[k - 1])
            found.append((k + place, one))
    for k, share in ((0, 1.0 - _BESIDE), (len(points) - 2, _BESIDE)):
        if k < 0 or not lengths:
            continue
        first, last = points[k : k + 2]
        at = 0.0, share * lengths[k], lengths[k]
        beside = way(first, at[1])
        if beside is not None:
            inside = _within(way, _Dip(first, at, (first, beside, last)))
            found += [(k + s / lengths[k], one) for s, one in inside]
    return found


def _within(way: Way[P], dip: _Dip[P]) -> list[tuple[float, Passing[P]]]:
    """What is critical in a window between three points that are alike."""
    before, here, after = dip.points
    counts = {(p.unstable, p.exponents.size) for p in dip.points}
    both = zip(before.determinants, after.determinants, strict=True)
    if len(counts) > 1 or any(a * b <= 0.0 for (_, a), (_, b) in both):
        return []
    for test in _tests(before, here):
        inner = _bottom(way, dip, test)
        if inner is None:
            continue
        low, s, high, bottom = inner
        found: list[tuple[float, Passing[P]]] = []
        for end in (low, high):
            edge = way(dip.base, end)
            if edge is None:
                continue
            segment = Segment(edge, bottom, s, dip.base, end)
            if end == high:
                segment = Segment(bottom, edge, end, dip.base, s)
            told = critical_on(way, segment) or []
            found += [(0.5 * (s + end), one) for one in told]
        return found
    return []


def _tests(before: P, here: P) -> list[_Test[P]]:
    """What may pass zero and come back, above zero at the point before."""
    tests: list[_Test[P]] = []
    for k, (_, value) in enumerate(before.determinants):
        tests.append(_determinant(k, float(np.sign(value))))
    values: _Values = before.exponents
    errors = before.errors
    turns = np.abs(values.imag) > _OFF * errors
    damped = values[turns & (np.abs(values.real) > _OFF * errors)]
    if damped.size:
        there: _Values = np.array([_nearest(here, one) for one in damped])
        k = int(np.argmin(np.abs(there.real)))
        side, lead = float(np.sign(damped[k].real)), complex(there[k])
        tests.append(lambda point: side * _nearest(point, lead).real)
    if int(np.sum(turns & (values.imag > 0.0))) > 1:
        tests.append(_gap)
    return tests


def _determinant(k: int, sign: float) -> _Test[P]:
    return lambda point: sign * point.determinants[k][1]


def _nearest(point: Followed, value: complex) -> complex:
    values = point.exponents
    return complex(values[np.argmin(np.abs(values - value))])


def _gap(point: Followed) -> float:
    """Least squared distance of two that turn one way, below zero off the axis."""
    values: _Values = point.exponents
    turning = values[values.imag > _OFF * point.errors]
    i, j = np.triu_indices(turning.size, 1)
    if not i.size:
        return np.inf
    squares = -((turning[i] - turning[j]) ** 2)
    return float(squares[np.argmin(np.abs(squares))].real)


def _bottom(
    way: Way[P], dip: _Dip[P], test: _Test[P]
) -> tuple[float, float, float, P] | None:
    """A point of other stability where a test dips, between two; None: there is none.

    Returns:
        Places s of an end, of the point, of the other end; and the point.
    """
    at, values = list(dip.at), [test(point) for point in dip.points]
    for _ in range(_TRIES):
        if not (values[1] < values[0] and values[1] < values[2]):
            return None
        s = _vertex(at, values)
        if abs(s - at[1]) < _SAME * (at[2] - at[0]):
            return None
        point = way(dip.base, s)
        if point is None:
            return None
        if point.unstable != dip.points[0].unstable:
            return at[0], s, at[2], point
        k = 1 if s < at[1] else 2
        at.insert(k, s)
        values.insert(k, test(point))
        least = 1 if values[1] < values[2] else 2
        at, values = at[least - 1 : least + 2], values[least - 1 : least + 2]
    return None


def _vertex(at: list[float], values: list[float]) -> float:
    """Where a parabola through three points, the middle one the lowest, is least."""
    a, b = at[0] - at[1], at[2] - at[1]
    left, right = (values[0] - values[1]) / a, (values[2] - values[1]) / b
    return at[1] + 0.5 * (a * right - b * left) / (right - left)
