"""Folds and changes of stability on a branch, located between its points."""

from collections.abc import Callable
from typing import TypeAlias

import numpy as np

from .branch_segments import Followed, P, Passing, Segment, Way

# of how far along a tangent, where a located point may be off: rounding [1]
_EXACT = 1e-14
_TRIES = 40
_HALVINGS = 40  # of a segment, to a rounding of 1e-12
# Of a test's value at the segment's worse end: where it is zero it is rounding there,
# some 1e-10; between two branches it jumps past zero and is never small.
_SMALL = 1e-6
_Test: TypeAlias = Callable[[P], float]


def critical_on(way: Way[P], segment: Segment[P]) -> list[Passing[P]] | None:
    """What is critical between two neighbouring points of a branch.

    Args:
        way: Along the branch.
        segment: Of the branch.

    Returns:
        Critical points; None: a tangent turns or an eigenvalue changes its sign without
        passing zero, so that the ends are not of one branch. Of pairs that come apart
        without a meeting that can be found there is none to tell of.
    """
    first, last = segment.first, segment.last
    found: list[Passing[P]] = []
    fold: P | None = None
    if _passes(first.turning, last.turning):
        fold = _located(way, segment, lambda point: point.turning)
        if fold is None:
            return None
        found.append(Passing("fold", fold, _nearest(fold, 0j)))
    if first.exponents.size != last.exponents.size:
        return found
    crossed = 0
    for k, (place, value) in enumerate(first.determinants):
        if not _passes(value, last.determinants[k][1]):
            continue
        crossed += 1
        test = _determinant(k)
        if place == 0j and fold is not None and _is_zero(test, fold, segment):
            continue  # what turns back passes zero for that
        point = _located(way, segment, test)
        if point is None:
            return None
        found.append(Passing("zero crossing", point, _nearest(point, place)))
    settled = all(value for _, value in first.determinants)
    if not crossed and settled and first.unstable != last.unstable:
        kind, test = _of_pairs(first, last)
        point = _located(way, segment, test)
        if point is not None:
            worse = first if first.unstable > last.unstable else last
            lead = _nearest(point, 1j * complex(worse.exponents[0]).imag)
            kind = "zero crossing" if kind == "Hopf" and _is_one(point, lead) else kind
            found.append(Passing(kind, point, lead))
    return found


def _determinant(k: int) -> _Test[P]:
    return lambda point: point.determinants[k][1]


def _is_zero(test: _Test[P], point: P, segment: Segment[P]) -> bool:
    """Whether what passes zero between the ends of a segment does so at a point."""
    largest = max(abs(test(segment.first)), abs(test(segment.last)))
    return abs(test(point)) <= np.sqrt(_SMALL) * largest


def _nearest(point: Followed, value: complex) -> complex:
    values = point.exponents
    if not values.size:
        return 0j
    return complex(values[np.argmin(np.abs(values - value))])


def _is_one(point: Followed, lead: complex) -> bool:
    """Whether what grows from a point is where single ones pass, and no pair's.

    Two that are equal pass there together, as what is symmetric in two directions has.
    """
    turns = min(abs(abs(lead.imag) - place.imag) for place, _ in point.determinants)
    return turns <= float(point.errors[np.argmin(np.abs(point.exponents - lead))])


def _passes(first: float, last: float) -> bool:
    """Whether a value passes zero, or comes to it; what begins there came there."""
    return first * last < 0.0 or (last == 0.0 and first != 0.0)


def _of_pairs(first: P, last: P) -> tuple[str, _Test[P]]:
    """A pair that passes the imaginary axis, or two that meet on it."""
    worse, better = first, last
    if first.unstable < last.unstable:
        worse, better = last, first
    lead = complex(worse.exponents[0])
    same = better.exponents[np.argmin(np.abs(better.exponents - lead))]
    error = better.errors[np.argmin(np.abs(better.exponents - lead))]
    # where two have met, one falls as fast as the other grows; else one passed alone,
    # and may be on the axis at the better end. Mirrored: one is nearer to the mirror
    # image than the axis is
    mirrored = np.abs(worse.exponents + lead.conjugate()).min() < abs(lead.real)
    if same.real < -10.0 * error or not mirrored:
        middle = 0.5 * (lead + complex(same))
        return "Hopf", lambda point: _nearest(point, middle).real

    def apart(point: P) -> float:
        """Square of the distance of the two that are nearest: minus, then plus."""
        values = point.exponents
        i, j = np.triu_indices(values.size, 1)
        squares = (values[i] - values[j]) ** 2
        near = 0.5 * np.abs(values[i] + values[j] - 2j * lead.imag) < 0.5 * abs(lead)
        squares = squares[near] if near.any() else squares
        return float(squares[np.argmin(np.abs(squares))].real)

    return "collision", apart


def _located(way: Way[P], segment: Segment[P], test: _Test[P]) -> P | None:
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
        point = way(base, s)
        if point is None:
            break
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


def bisected(way: Way[P], segment: Segment[P]) -> list[Passing[P]]:
    """Where stability changes between the ends, of whatever multiplicity.

    Several that pass zero together leave no sign of a determinant; where they have
    passed they grow. Located to rounding of the way, or as near as the way is found.
    """
    base = segment.base or segment.first
    ends = [(segment.near, segment.first), (segment.far, segment.last)]
    for _ in range(_HALVINGS):
        middle = 0.5 * (ends[0][0] + ends[1][0])
        point = way(base, middle)
        if point is None:
            break
        same = point.unstable == segment.first.unstable
        ends[0 if same else 1] = middle, point
    grown = max((point for _, point in ends), key=lambda point: point.unstable)
    lead = complex(grown.exponents[0])
    kind = "zero crossing" if _is_one(grown, lead) else "Hopf"
    return [Passing(kind, grown, lead)]
