"""Folds and changes of stability on a branch, located between its points."""

from collections.abc import Callable
from typing import TypeAlias

import numpy as np

from .branch import BranchPoint, Critical
from .continuation import Segment, made, step_from
from .newton import SOLVED, Asked

# of how far along a tangent, where a located point may be off: rounding [1]
_EXACT = 1e-14
_TRIES = 40
# Of a test's value at the segment's worse end: where it is zero it is rounding there,
# some 1e-10; between two branches it jumps past zero and is never small.
_SMALL = 1e-6
_Test: TypeAlias = Callable[[BranchPoint], float]


def critical_on(
    asked: Asked, segment: Segment, dimensions: tuple[int, ...]
) -> list[Critical] | None:
    """What is critical between two neighbouring points of a branch.

    Args:
        asked: What is solved.
        segment: Of the branch.
        dimensions: Counts of the family that leaves zeros among the eigenvalues.

    Returns:
        Critical points; None: a tangent turns or an eigenvalue changes its sign without
        passing zero, so that the ends are not of one branch. Of pairs that come apart
        without a meeting that can be found there is none to tell of.
    """
    first, last = segment.first, segment.last
    tests: list[tuple[str, _Test]] = []
    if _passes(first.tangent[-1], last.tangent[-1]):
        tests.append(("fold", lambda point: float(point.tangent[-1])))
    same = first.eigenvalues.size == last.eigenvalues.size
    if same and _passes(first.told.determinant, last.told.determinant):
        if not tests:
            tests.append(("zero crossing", lambda point: point.told.determinant))
    elif same and first.told.determinant and _stability_changes(first, last):
        tests.append(_of_pairs(first, last))
    found: list[Critical] = []
    for kind, test in tests:
        point = _located(asked, segment, test, dimensions)
        if point is None:
            if kind in ("fold", "zero crossing"):
                return None
            continue
        value = _passing(kind, point, first, last)
        found.append(Critical(kind, point.value, point.state, value, point))
    return found


def _passes(first: float, last: float) -> bool:
    """Whether a value passes zero, or comes to it; what begins there came there."""
    return first * last < 0.0 or (last == 0.0 and first != 0.0)


def _stability_changes(first: BranchPoint, last: BranchPoint) -> bool:
    return first.told.unstable != last.told.unstable


def _of_pairs(first: BranchPoint, last: BranchPoint) -> tuple[str, _Test]:
    """A pair that passes the imaginary axis, or two that meet on it."""
    worse, better = first, last
    if first.told.unstable < last.told.unstable:
        worse, better = last, first
    lead = complex(worse.eigenvalues[0])
    same = better.eigenvalues[np.argmin(np.abs(better.eigenvalues - lead))]
    error = better.told.errors[np.argmin(np.abs(better.eigenvalues - lead))]
    # where two have met, one falls as fast as the other grows; else one passed alone,
    # and may be on the axis at the better end. Mirrored: one is nearer to the mirror
    # image than the axis is
    mirrored = np.abs(worse.eigenvalues + lead.conjugate()).min() < abs(lead.real)
    if same.real < -10.0 * error or not mirrored:
        middle = 0.5 * (lead + complex(same))

        def damping(point: BranchPoint) -> float:
            nearest = np.argmin(np.abs(point.eigenvalues - middle))
            return float(point.eigenvalues[nearest].real)

        return "Hopf", damping

    def apart(point: BranchPoint) -> float:
        """Square of the distance of the two that are nearest: minus, then plus."""
        values = point.eigenvalues
        i, j = np.triu_indices(values.size, 1)
        squares = (values[i] - values[j]) ** 2
        near = 0.5 * np.abs(values[i] + values[j] - 2j * lead.imag) < 0.5 * abs(lead)
        squares = squares[near] if near.any() else squares
        return float(squares[np.argmin(np.abs(squares))].real)

    return "collision", apart


def _located(
    asked: Asked, segment: Segment, test: _Test, dimensions: tuple[int, ...]
) -> BranchPoint | None:
    """The root of a test on a segment, by the Illinois method; None: there is none."""
    first, last = segment.first, segment.last
    base = segment.base or first
    (a, fa), (b, fb) = (segment.near, test(first)), (segment.far, test(last))
    best, least = (first, abs(fa)) if abs(fa) < abs(fb) else (last, abs(fb))
    small = _SMALL * max(abs(fa), abs(fb))
    for _ in range(_TRIES):
        s = b - fb * (b - a) / (fb - fa)
        if not min(a, b) < s < max(a, b):
            break
        solution = step_from(asked, base, s)
        if not solution.error < SOLVED:
            break
        point = made(asked, solution.point, base.tangent, dimensions)
        value = test(point)
        if abs(value) < least:
            best, least = point, abs(value)
        if value == 0.0 or abs(s - b) < _EXACT * (segment.far - segment.near):
            break
        if value * fb < 0.0:
            a, fa = b, fb
        else:
            fa *= 0.5  # so that the other end moves, too
        b, fb = s, value
    return best if least <= small else None


def _passing(
    kind: str, point: BranchPoint, first: BranchPoint, last: BranchPoint
) -> complex:
    """The eigenvalue that passes or meets at a critical point."""
    values = point.eigenvalues
    if not values.size:
        return 0j
    if kind in ("fold", "zero crossing"):
        return complex(values[np.argmin(np.abs(values))])
    worse = first if first.told.unstable > last.told.unstable else last
    lead = complex(worse.eigenvalues[0])
    return complex(values[np.argmin(np.abs(values - 1j * lead.imag))])
