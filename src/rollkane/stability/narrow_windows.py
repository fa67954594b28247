"""Two changes of stability between neighbouring points of a branch.

At both ends of such a window all is alike: what passes zero and comes back shows by a
dip on the way to it. Where it dips between three points the bottom is looked for.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from .branch import BranchPoint, Critical
from .continuation import Segment, made, step_from
from .critical_points import critical_on
from .newton import SOLVED, Asked

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
_Test: TypeAlias = Callable[[BranchPoint], float]
_Values: TypeAlias = np.ndarray[Any, np.dtype[np.complex128]]


class _Dip(NamedTuple):
    """Three points of a branch, s along the middle one's or first one's tangent."""

    base: BranchPoint
    at: tuple[float, float, float]
    points: tuple[BranchPoint, BranchPoint, BranchPoint]


def windows(
    asked: Asked,
    points: Sequence[BranchPoint],
    lengths: Sequence[float],
    dimensions: tuple[int, ...],
) -> list[tuple[float, Critical]]:
    """What is critical in windows that lie between neighbouring points.

    Args:
        asked: What is solved.
        points: Of a way along a branch, with tangents that lead on.
        lengths: How far along its tangent from each to the next one.
        dimensions: Counts of the family that leaves zeros among the eigenvalues.

    Returns:
        Places, by number of the points and parts of a step, and what is critical.
    """
    found: list[tuple[float, Critical]] = []
    for k in range(1, len(points) - 1):
        before, here, after = points[k - 1 : k + 2]
        at = -lengths[k - 1], 0.0, lengths[k]
        for s, one in _within(asked, _Dip(here, at, (before, here, after)), dimensions):
            place = s / (lengths[k] if s > 0.0 else lengths[k - 1])
            found.append((k + place, one))
    for k, share in ((0, 1.0 - _BESIDE), (len(points) - 2, _BESIDE)):
        if k < 0 or not lengths:
            continue
        first, last = points[k : k + 2]
        at = 0.0, share * lengths[k], lengths[k]
        beside = _point(asked, first, at[1], dimensions)
        if beside is not None:
            dip = _Dip(first, at, (first, beside, last))
            inside = _within(asked, dip, dimensions)
            found += [(k + s / lengths[k], one) for s, one in inside]
    return found


def _within(
    asked: Asked, dip: _Dip, dimensions: tuple[int, ...]
) -> list[tuple[float, Critical]]:
    """What is critical in a window between three points that are alike."""
    before, here, after = dip.points
    counts = {(p.told.unstable, p.eigenvalues.size) for p in dip.points}
    if len(counts) > 1 or before.told.determinant * after.told.determinant <= 0.0:
        return []
    for test in _tests(before, here):
        inner = _bottom(asked, dip, test, dimensions)
        if inner is None:
            continue
        low, s, high, bottom = inner
        found: list[tuple[float, Critical]] = []
        for end in (low, high):
            edge = _point(asked, dip.base, end, dimensions)
            if edge is None:
                continue
            segment = Segment(edge, bottom, s, dip.base, end)
            if end == high:
                segment = Segment(bottom, edge, end, dip.base, s)
            told = critical_on(asked, segment, dimensions) or []
            found += [(0.5 * (s + end), one) for one in told]
        return found
    return []


def _tests(before: BranchPoint, here: BranchPoint) -> list[_Test]:
    """What may pass zero and come back, above zero at the point before."""
    sign = float(np.sign(before.told.determinant))
    tests: list[_Test] = [lambda point: sign * point.told.determinant]
    values: _Values = before.eigenvalues
    errors = before.told.errors
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


def _nearest(point: BranchPoint, value: complex) -> complex:
    values = point.eigenvalues
    return complex(values[np.argmin(np.abs(values - value))])


def _gap(point: BranchPoint) -> float:
    """Least squared distance of two that turn one way, below zero off the axis."""
    values: _Values = point.eigenvalues
    turning = values[values.imag > _OFF * point.told.errors]
    i, j = np.triu_indices(turning.size, 1)
    if not i.size:
        return np.inf
    squares = -((turning[i] - turning[j]) ** 2)
    return float(squares[np.argmin(np.abs(squares))].real)


def _bottom(
    asked: Asked, dip: _Dip, test: _Test, dimensions: tuple[int, ...]
) -> tuple[float, float, float, BranchPoint] | None:
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
        point = _point(asked, dip.base, s, dimensions)
        if point is None:
            return None
        if point.told.unstable != dip.points[0].told.unstable:
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


def _point(
    asked: Asked, base: BranchPoint, s: float, dimensions: tuple[int, ...]
) -> BranchPoint | None:
    """The branch's point a way along a tangent, either way; None: it is not found."""
    solution = step_from(asked, base, s)
    if not solution.error < SOLVED:
        return None
    return made(asked, solution.point, base.tangent, dimensions)
