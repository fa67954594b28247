"""Confidence intervals: from standard errors, and by profiles of chi-square."""

from collections.abc import Callable
from statistics import NormalDist

import numpy as np

from . import uncertainty
from .bounded_intervals import LinearBox
from .estimates import Estimates, standard_errors_of
from .evaluation import Evaluation
from .experiments import Problem
from .horizons import Search
from .layout import Coordinates
from .least_squares import minimize
from .transform_values import values_at
from .transforms import Plain, Positive

_HELD = 1e-3  # of a standard error: how firmly a profile holds its number
_FARTHEST = 30.0  # standard errors: beyond, an interval has no end
_ALIKE = 1e-9  # relative: entries that a program rounds differently
_CLOSE = 2e-3  # relative error of the rise at an end, and so 1e-3 of its distance


def linear_interval(
    fit: Estimates, path: str, level: float
) -> tuple[np.ndarray, np.ndarray]:
    """Estimate minus and plus the normal quantile of standard errors.

    Where bounds hold estimates, the ends of the linear model's profile within them.
    """
    quantile = NormalDist().inv_cdf(0.5 + 0.5 * level)
    box = LinearBox(fit)
    if box.held:
        return _by_entry(fit.problem, path, lambda e: box.interval(e, quantile))
    middle, apart = fit.estimates[path], quantile * fit.standard_errors[path]
    return middle - apart, middle + apart


def profile_interval(
    fit: Estimates, path: str, level: float
) -> tuple[np.ndarray, np.ndarray]:
    """Where the least chi2 with an entry held has risen by the level's quantile."""
    rise = NormalDist().inv_cdf(0.5 + 0.5 * level) ** 2
    search, problem = fit.search, fit.problem
    return _by_entry(problem, path, lambda e: _of_entry(problem, e, search, rise))


def _by_entry(
    problem: Problem,
    path: str,
    interval: Callable[[Coordinates], tuple[np.ndarray, np.ndarray]],
) -> tuple[np.ndarray, np.ndarray]:
    """Both ends of a parameter, which records may have their own of."""
    ends = {
        entry.where.start: interval(entry)
        for entry in problem.layout.entries
        if entry.free.path == path
    }
    of: Callable[[int], np.ndarray]
    of = lambda side: problem.layout.by_path(
        lambda e: ends[e.where.start][side] if e.where.start in ends else np.zeros(0)
    )[path]
    return of(0), of(1)


def _of_entry(
    problem: Problem, entry: Coordinates, search: Search, rise: float
) -> tuple[np.ndarray, np.ndarray]:
    """Ends for every entry of one parameter, in its shape."""
    z, at = search.minimum.z, search.minimum.at
    value, _, slope, _ = entry.at(z)
    known = uncertainty.coordinate_covariance(at, problem.layout, z, bounded=False)
    unseen = uncertainty.unseen_directions(at, problem.layout)
    errors = np.ravel(standard_errors_of(entry, z, known, unseen))
    low, high = value.ravel().copy(), value.ravel().copy()
    numbers = np.column_stack([value.ravel(), slope])
    for k, error in enumerate(errors):
        same = _first_alike(numbers[: k + 1])  # of a symmetric array
        if same != k:
            low[k], high[k] = low[same], high[same]
        elif np.isinf(error):
            low[k], high[k] = -np.inf, np.inf
        elif error > 0.0:
            # a step by more than the number itself leaves what is known of it
            size = float(np.abs(value).max()) or error
            step = min(error, size)
            farthest = _FARTHEST * error / step
            low[k] = _end(problem, entry, k, search, -step, rise, farthest)
            high[k] = _end(problem, entry, k, search, step, rise, farthest)
    least, most = _allowed(entry)
    low, high = np.maximum(low, least), np.minimum(high, most)
    return low.reshape(value.shape), high.reshape(value.shape)


def _first_alike(numbers: np.ndarray) -> int:
    """The first row that is the last one but for roundings, of its own size."""
    apart, sizes = np.abs(numbers - numbers[-1]), np.abs(numbers[-1])
    alike = apart[:, 0] <= _ALIKE * sizes[0]
    alike &= np.all(apart[:, 1:] <= _ALIKE * sizes[1:].max(), axis=1)
    return int(np.argmax(alike))


def _allowed(entry: Coordinates) -> tuple[np.ndarray, np.ndarray]:
    """Bounds of a parameter's entries; none of those that have other coordinates."""
    if not isinstance(entry.transform, (Plain, Positive)):
        return np.array(-np.inf), np.array(np.inf)
    ends = (values_at(entry.transform, z).value for z in (entry.lower, entry.upper))
    least, most = (np.ravel(end) for end in ends)
    return least, most


def _end(
    problem: Problem,
    entry: Coordinates,
    k: int,
    search: Search,
    error: float,
    rise: float,
    farthest: float,
) -> float:
    """Where the profile has risen, on the side of the error's sign."""
    layout, z = problem.layout, search.minimum.z
    least = float(np.sum(search.minimum.at.residual**2))
    number: Callable[[np.ndarray], float]
    number = lambda z: float(np.ravel(entry.at(z).value)[k])
    middle, width = number(z), _HELD * abs(error)
    steps, inside, reached = np.sqrt(rise), z, middle
    inner, outer = 0.0, np.inf  # standard errors where the rise is less, and more
    for _ in range(40):
        goal = middle + steps * error

        def evaluate(x: np.ndarray, goal: float = goal) -> Evaluation:
            row = np.zeros(layout.size)
            row[entry.where] = entry.at(x).slope[k] / width
            return problem.evaluate(x).held((number(x) - goal) / width, row)

        # not from a point beyond the end, from which there may be no way back: a
        # logarithm that was sent to where its number no longer changes
        found = minimize(evaluate, inside, *layout.box, most=30, first=search.first)
        point, reached = found.z, number(found.z)
        risen = float(np.sum(found.at.residual[:-1] ** 2)) - least
        taken = (reached - middle) / error
        if abs(risen - rise) < _CLOSE * rise:
            return reached
        if risen < rise:
            own = point[entry.where]
            held = np.any((own <= entry.lower) | (own >= entry.upper))
            if held and abs(taken - steps) > 0.01 * steps:
                return reached
            inner, inside = max(inner, taken), point
            if inner > farthest:
                return float(np.copysign(np.inf, error))
        else:
            outer = taken
        guess = taken * np.sqrt(rise / max(risen, 0.1 * rise))  # a parabola's
        limit = outer if np.isfinite(outer) else 3.0 * max(inner, 1.0)
        steps = guess if inner < guess < limit else 0.5 * (inner + limit)
        if outer - inner < 1e-3 * outer:
            return reached
    return reached
