"""Parameters that neither records nor a prior keep from an end of their range.

Where the likelihood stops falling, a density that is flat in a coordinate has an
infinite mass beyond: no distribution. A positive number has such an end at zero, as its
logarithm goes on for ever: whether chains come there is a matter of how far the
likelihood falls on the way. A bound is no such end: there is nothing beyond it.
"""

from typing import TypeAlias

import numpy as np

from . import uncertainty
from .evaluation import Evaluation
from .experiments import Problem
from .horizons import Search
from .inertia_transforms import AbstractInertia
from .layout import Coordinates
from .least_squares import minimize

_FIRST = 5.0  # deviations: a parabola has risen by 25 there
_HELD = 1e-3  # of a deviation: how firmly a number is held
# How far is looked: a logarithm by a factor of e^12, other numbers by deviations.
_FACTOR, _FARTHEST = 12.0, 30.0
# Its row, how far it is looked at, and what ends it.
_Number: TypeAlias = tuple[np.ndarray, float, tuple[str, str]]
_MOST = 20  # points tried at a place: for an end chi2 need not be exact


def open_ends(problem: Problem, search: Search, rise: float) -> tuple[str, ...]:
    """Ends up to which the least chi2 rises by less, in words.

    Followed outwards from the estimates, the other parameters fitted at each place.

    Args:
        problem: Of the fit.
        search: How it ended.
        rise: Of chi2, beyond which no chain goes.
    """
    z, at = search.minimum.z, search.minimum.at
    layout = problem.layout
    known = uncertainty.coordinate_covariance(at, layout, z, bounded=False)
    found: list[str] = []
    for entry in layout.entries:
        if entry.free.prior is not None:
            continue
        for numbers in _numbers(entry, layout.size):
            ends = {
                end
                for row, farthest, names in numbers
                for sign, end in zip((-1.0, 1.0), names, strict=True)
                if not _is_bounded(problem, sign * row)
                and _is_open(problem, search, known, sign * row, farthest, rise)
            }
            found += [f"{entry.name} towards {end}" for end in sorted(ends)]
            if ends:  # other coordinates are relative to sizes
                break
    return tuple(found)


def _numbers(entry: Coordinates, size: int) -> list[list[_Number]]:
    """Logarithms of sizes, then coordinates that are none: rows, and what ends them."""
    logarithms = entry.transform.logarithms()
    plain = np.eye(entry.transform.start().size)
    plain = plain[~logarithms.any(axis=0)]
    is_inertia = isinstance(entry.transform, AbstractInertia)
    least = "no thickness along an axis" if is_inertia else "zero"
    found: list[list[_Number]] = []
    for rows, farthest, names in (
        (logarithms, _FACTOR, (least, "infinity")),
        (plain, 0.0, ("smaller values", "larger values")),
    ):
        whole = np.zeros((len(rows), size))
        whole[:, entry.where] = rows
        found.append([(row, farthest, names) for row in whole])
    return found


def _is_bounded(problem: Problem, row: np.ndarray) -> bool:
    """Whether a bound ends a number along its row: those that have one are alone."""
    ends = np.where(row > 0.0, problem.layout.upper, problem.layout.lower)
    return bool(np.isfinite(ends[row != 0.0]).all())


def _is_open(
    problem: Problem,
    search: Search,
    known: np.ndarray,
    row: np.ndarray,
    farthest: float,
    rise: float,
) -> bool:
    """Whether chi2 rises by less however far a number goes along its row."""
    z = search.minimum.z
    least = float(np.sum(search.minimum.at.residual**2))
    deviation = float(np.sqrt(row @ known @ row))
    farthest = max(farthest or _FARTHEST * deviation, 2.0 * _FIRST * deviation)
    away, point = min(_FIRST * deviation, farthest), z
    while True:
        goal = float(row @ z) + away
        point, chi2 = _least_at(problem, search, point, row, goal, _HELD * deviation)
        if chi2 - least > rise:
            return False
        if away >= farthest:
            return True
        away = min(2.0 * away, farthest)


def _least_at(
    problem: Problem,
    search: Search,
    point: np.ndarray,
    row: np.ndarray,
    goal: float,
    width: float,
) -> tuple[np.ndarray, float]:
    """The least chi2 with a number held, from a point whose others are as before."""

    def evaluate(z: np.ndarray) -> Evaluation:
        misfit = (float(row @ z) - goal) / width
        return problem.evaluate(z).held(misfit, row / width)

    start = point + row * (goal - row @ point) / (row @ row)
    box = problem.layout.box
    found = minimize(evaluate, start, *box, most=_MOST, first=search.first)
    return found.z, float(np.sum(found.at.residual[:-1] ** 2))
