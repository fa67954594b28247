"""Searches that reach as much of a record as the model already follows.

A motion whose neighbours part cannot be fitted over its whole length from afar: the
misfit has a minimum wherever the phases agree by a turn more or less. So the record is
used to where the prediction leaves it, fitted, and used on from there.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from .evaluation import Evaluation
from .experiments import LONGER, Problem
from .least_squares import FIRST_DAMPING, Minimum, minimize
from .losses import Loss

# A prediction follows a record as long as its misfit is below this share of the
# record's own variation (both as root mean squares up to there): an oscillation that is
# out of phase by a fifth of a radian.
_FOLLOWS = 0.2
# A minimum whose misfit is above this share is of another motion: while a horizon is
# short, one that stands still has a misfit little larger.
_FITS = 0.05
_SAMPLES = 3.0  # for each coordinate, at least
_FEW = 30  # points tried at one horizon: a longer one follows
_ENOUGH = 1.0  # promised fall of chi2 at one horizon: a standard deviation
_GUESSES, _AROUND = 24, 0.2  # others that are tried, and their deviation [of the size]
_WEAK = 1.0  # deviation of a coordinate [of its size] while the horizon is short


class Stage(NamedTuple):
    """A search up to one horizon.

    Attributes:
        horizon: [s] after the start.
        chi2: Of the samples up to there.
        samples: How many they are.
    """

    horizon: float
    chi2: float
    samples: int


class Search(NamedTuple):
    """What a search found, and how it went.

    Attributes:
        minimum: Where it ended.
        stages: Horizons on its way.
        first: Directions that the first guess does not show in the whole records, rows
            relative to the coordinates' sizes.
    """

    minimum: Minimum
    stages: list[Stage]
    first: np.ndarray


def single(
    problem: Problem, z: np.ndarray, loss: Loss, most: int, first: np.ndarray
) -> Search:
    """One search over the whole records."""
    box = problem.layout.box
    found = minimize(problem.evaluate, z, *box, loss, most, first=first)
    return Search(found, [_stage(problem, found, np.inf)], first)


def progressive(
    problem: Problem, z: np.ndarray, loss: Loss, most: int, first: np.ndarray
) -> Search:
    """Searches up to growing horizons, each from what the last one found.

    Where one ends in a minimum that the record leaves, others from around the first
    guess are tried: a short horizon is cheap, and no longer one can mend it.
    """
    growth = _Growth(problem, loss, z, first)
    horizon = followed(problem, z, least=_shortest(problem))
    guesses = _GUESSES
    while horizon < problem.span:
        found = growth.searched(z, horizon)
        while guesses and not _fits(problem, found.z, horizon):
            guesses -= 1
            other = growth.searched(growth.guess(), horizon)
            found = min(found, other, key=lambda m: m.cost)
        z, growth.damping = found.z, min(FIRST_DAMPING, found.damping)
        growth.path.extend(found.path)
        growth.stages.append(_stage(problem, found, horizon))
        horizon = followed(problem, z, 1.25 * horizon, LONGER * horizon)
    known = *problem.layout.box, loss, most
    last = minimize(problem.evaluate, z, *known, damping=growth.damping, first=first)
    growth.stages.append(_stage(problem, last, np.inf))
    whole = last._replace(
        evaluations=growth.evaluations + last.evaluations,
        path=np.concatenate([np.array(growth.path).reshape(-1, z.size), last.path]),
    )
    return Search(whole, growth.stages, first)


class _Growth:
    """What searches up to growing horizons have in common, and how far they are."""

    def __init__(
        self, problem: Problem, loss: Loss, guess: np.ndarray, hidden: np.ndarray
    ):
        self.problem, self.loss = problem, loss
        self.first, self.hidden = guess, hidden
        self.random = np.random.default_rng(0)
        self.stages: list[Stage] = []
        self.path: list[np.ndarray] = []
        self.evaluations, self.damping = 0, FIRST_DAMPING

    def searched(self, z: np.ndarray, horizon: float) -> Minimum:
        """The minimum up to a horizon."""
        held = _weakly_held(self.problem, z, horizon)
        known = *self.problem.layout.box, self.loss, _FEW, _ENOUGH, self.damping
        found = minimize(held, z, *known, self.hidden)
        self.evaluations += found.evaluations
        return found

    def guess(self) -> np.ndarray:
        """One near the first."""
        layout = self.problem.layout
        away = _AROUND * layout.scale * self.random.standard_normal(layout.size)
        return np.clip(self.first + away, layout.lower, layout.upper)


def followed(
    problem: Problem, z: np.ndarray, least: float, most: float = np.inf
) -> float:
    """How long the prediction follows the records [s], between two limits."""
    horizon = most
    parts = zip(
        problem.records,
        problem.times(),
        problem.channel_misfits(z, most),
        problem.sizes(),
        strict=True,
    )
    for record, times, misfits, sizes in parts:
        for name, misfit in misfits.items():
            time = times[name] - float(record.start_time)
            off = np.cumsum(np.nansum(misfit**2, axis=1))
            size = np.cumsum(np.nansum(sizes[name] ** 2, axis=1))
            # noise alone is no reason to stop
            noise = np.cumsum(np.sum(np.isfinite(misfit), axis=1))
            left = (off - 2.0 * noise > _FOLLOWS**2 * size) & (time > least)
            if left.any():
                horizon = min(horizon, float(time[np.argmax(left)]))
    return horizon


def _fits(problem: Problem, z: np.ndarray, horizon: float) -> bool:
    """Whether a minimum is of the records' motion, up to a horizon [s]."""
    parts = zip(
        problem.records,
        problem.times(),
        problem.channel_misfits(z, horizon),
        problem.sizes(),
        strict=True,
    )
    for record, times, misfits, sizes in parts:
        for name, misfit in misfits.items():
            within = times[name] - float(record.start_time) <= horizon
            known = np.isfinite(misfit) & within[:, None]
            off, noise = np.sum(misfit[known] ** 2), np.sum(known)
            if off - 2.0 * noise > _FITS**2 * np.nansum(sizes[name][known] ** 2):
                return False
    return followed(problem, z, 0.0, horizon) >= horizon


def _shortest(problem: Problem) -> float:
    """The shortest horizon with enough samples for the coordinates [s]."""
    wanted = _SAMPLES * problem.layout.size
    times = [
        np.sort(np.concatenate([t for t in own.values()])) - float(r.start_time)
        for r, own in zip(problem.records, problem.times(), strict=True)
    ]
    for horizon in np.unique(np.concatenate(times)):
        if problem.samples(float(horizon)) >= wanted:
            return float(horizon)
    return problem.span


def _weakly_held(
    problem: Problem, z0: np.ndarray, horizon: float
) -> Callable[[np.ndarray], Evaluation]:
    """Misfits up to a horizon, and a weak pull to where the search begins.

    A short horizon may not show every coordinate; such ones stay.
    """
    scale = _WEAK * problem.layout.scale

    def evaluate(z: np.ndarray) -> Evaluation:
        at = problem.evaluate(z, horizon)
        residual = np.concatenate([at.residual, (z - z0) / scale])
        jacobian = np.concatenate([at.jacobian, np.diag(1.0 / scale)])
        whole = at._replace(residual=residual, jacobian=jacobian, rounding=0.0)
        return whole._replace(priors=at.priors + z.size)

    return evaluate


def _stage(problem: Problem, found: Minimum, horizon: float) -> Stage:
    samples = problem.samples(horizon)
    chi2 = float(np.sum(found.at.residual**2))
    return Stage(min(horizon, problem.span), chi2, samples)
