"""Probabilities of rare events: subset simulation, sharpened by importance sampling."""

import math
from typing import NamedTuple

import numpy as np

from ..validation.checks import FieldError, flag, real, whole
from .conditional_chains import (
    Chains,
    conditional_chains,
    family_share,
    family_variance,
)
from .evaluation import Model
from .inputs import share
from .limit_margin import LimitMargin
from .proposal_mixture import Mixture, fitted_mixture
from .rare_event import Estimate, Level, RareEvent
from .sampling import sampler
from .standard_normal import column_names, log_density, to_normal
from .study import Study
from .study_model import model_of

_KEPT = 10  # a level is what every tenth state reaches
_MOST_LEVELS = 20
_CONSISTENT = 3.0  # standard errors that the two estimates may be apart
_REFITS = 5
_GOOD = 0.2  # of samples: what they are worth, with which refitting ends
_FEW = 20  # states that show the event, below which nothing is fitted to them


def subset_simulation(
    model: Model | Study,
    of: str,
    threshold: float,
    size_per_level: int = 1000,
    *,
    runs: int = 4,
    below: bool = False,
    seed: int = 0,
    level: float = 0.95,
    precision: float = 0.03,
    motions: int = 100_000,
) -> RareEvent:
    """Probability that an output reaches a threshold, however rarely it does.

    Subset simulation goes to the event in levels, each of which every tenth state of
    the one before reaches: a probability of 1e-6 takes six of them, and comes with an
    error of some 20 %. From a mixture of distributions fitted to the states that show
    the event, importance sampling then finds the probability to the wanted precision.
    The answer is the second one where its error is smaller and the two agree.

    Args:
        model: A ``Study`` of rolling motions, or a :class:`FunctionModel`.
        of: The output, with an index where it is an array: ``"end[0]"``. It has to grow
            towards the event (a margin, a largest value); whether the event happened,
            0 or 1, leads nowhere.
        threshold: That the output reaches [its unit].
        size_per_level: Motions of each level of a run, a multiple of 10.
        runs: Independent runs of subset simulation. Each may lose a part of the event
            that is not connected with the rest; all hardly do.
        below: Whether the event is an output at or below the threshold.
        seed: Of all random numbers.
        level: Probability with which the interval covers [1].
        precision: Standard error over probability that importance sampling stops at
            [1]; 1 or more leaves it out.
        motions: Most that are run, in all.

    Returns:
        Probability, error, interval, levels; ``print`` shows them, and what failed.
        Motions that fail count as not being the event.

    Raises:
        FieldError: no such output, sizes that are too small, an output that takes too
            few values, or hardly a motion that does not fail.

    Source: Au and Beck, Prob. Eng. Mech. 16 (2001); chains: Papaioannou et al., Prob.
    Eng. Mech. 41 (2015); mixture: Kurtz and Song, Structural Safety 42 (2013).
    """
    field = "subset_simulation"
    size = whole(f"{field}.size_per_level", size_per_level, 100, "give more motions")
    if size % _KEPT:
        remedy = f"give a multiple of {_KEPT}"
        raise FieldError(f"{field}.size_per_level", size, "has no tenth part", remedy)
    threshold = float(real(f"{field}.threshold", threshold, (), "a number"))
    below, level = flag(f"{field}.below", below), share(f"{field}.level", level)
    seed = whole(f"{field}.seed", seed, 0, "give a whole number")
    precision = float(real(f"{field}.precision", precision, (), "a number above 0"))
    if precision <= 0.0:
        remedy = "give the standard error over probability that is enough, as 0.05"
        raise FieldError(f"{field}.precision", precision, "must be positive", remedy)
    runs = whole(f"{field}.runs", runs, 1, "give how many runs")
    most = whole(f"{field}.motions", motions, size, "give at least one level's")
    model = model_of(model)
    margin = LimitMargin(model, of, threshold, below)
    search = _Search(margin, model.draws.dimension, size, runs, seed, most)
    search.run(precision)
    used, why = search.chosen()
    return RareEvent(
        of,
        threshold,
        below,
        used,
        why,
        search.subset,
        search.importance,
        level,
        tuple(search.runs[0].levels),
        len(search.runs),
        column_names(model.draws),
        search.likeliest(),
        margin.motions,
        dict(margin.reasons),
        min(max(run.failed for run in search.runs), 1.0),
    )


class _Reached(NamedTuple):
    """What one run of subset simulation found.

    Attributes:
        estimate: Its probability.
        levels: One after the other.
        event: States that show the event, shape (n, d).
        effective: How many independent ones they stand for.
        failed: Probability of a motion that fails, over all levels.
        stopped: Why it did not come to the event; empty if it did.
    """

    estimate: Estimate
    levels: list[Level]
    event: np.ndarray
    effective: float
    failed: float
    stopped: str


class _Search:
    """Runs of subset simulation, and importance sampling from what they found.

    Where the two estimates differ by more than their errors, subset simulation is run
    again and the mixture fitted to the states of all runs: one that missed a part of
    the event, or an unlucky run, is found out by that.
    """

    def __init__(
        self,
        margin: LimitMargin,
        dimension: int,
        size: int,
        count: int,
        seed: int,
        most: int,
    ):
        self.margin, self.size, self.count, self.most = margin, size, count, most
        self.rng = np.random.default_rng([seed, 0x5B5E7])
        self.sampler = sampler("plain", dimension, seed, most)
        self.runs: list[_Reached] = []
        self.importance: Estimate | None = None
        self.why = ""

    @property
    def subset(self) -> Estimate:
        """The mean of all runs."""
        found = [run.estimate for run in self.runs]
        probability = sum(one.probability for one in found) / len(found)
        error = math.sqrt(sum(one.standard_error**2 for one in found)) / len(found)
        counted = sum(one.counted for one in found) * all(x.counted for x in found)
        return Estimate(probability, error, counted)

    @property
    def left(self) -> int:
        return self.most - self.margin.motions

    def run(self, precision: float) -> None:
        """Until both estimates agree, or no motions are left."""
        wanted = self.count
        while self._explored(wanted):
            self.why = self._no_fit(precision)
            if self.why:
                return
            self._sharpen(precision)
            if self._agree():
                return
            wanted = 2 * len(self.runs)

    def _explored(self, wanted: int) -> bool:
        """Runs of subset simulation, up to so many; whether there is a new one."""
        before = len(self.runs)
        while len(self.runs) < wanted:
            if self.runs and self.left < self._cost():
                break
            first = len(self.runs) * self.size
            z = to_normal(self.sampler.uniforms(first, self.size))
            reached = _levels(self.margin, z, self.rng, self.most)
            if reached.stopped and self.runs:
                break
            self.runs.append(reached)
            if reached.stopped:
                self.why = reached.stopped
                return False
        return len(self.runs) > before

    def _cost(self) -> int:
        """Motions that one more run may take, and a level to spare."""
        return max(sum(x.motions for x in run.levels) for run in self.runs) + self.size

    def _no_fit(self, precision: float) -> str:
        if self.subset.relative <= precision:
            return "its error is small enough"
        if precision >= 1.0 or self.left < 2 * self.size:
            return "no motions were left for importance sampling"
        if sum(len(run.event) for run in self.runs) < _FEW:
            return "too few states show the event for a fit"
        return ""

    def _sharpen(self, precision: float) -> None:
        """Importance sampling from a mixture that is fitted again and again.

        First to the states of subset simulation, then to weighted samples of all
        mixtures so far, which are independent of each other, until the last ones are
        good; those that are counted are drawn from the final one only. Half of the
        motions are kept where the two estimates disagree.
        """
        mixture = self._fitted()
        every = np.zeros(0)
        enough, half = False, self.left // 2
        while self.left >= self.size and not enough:
            every = np.concatenate([every, self._weighted(mixture)[1]])
            error = float(every.std(ddof=1)) / math.sqrt(len(every))
            # weights of events that hardly ever miss may have a mean above 1
            self.importance = Estimate(min(float(every.mean()), 1.0), error)
            enough = self.importance.relative <= precision
            if self.left < half and not self._agree():
                break
        self.why = "" if enough else "motions ended before its precision was reached"

    def _fitted(self) -> Mixture:
        """The mixture whose samples are counted."""
        event = np.concatenate([run.event for run in self.runs])
        effective = sum(run.effective for run in self.runs)
        weights = np.concatenate(
            [
                np.full(len(run.event), run.estimate.probability / len(run.event))
                for run in self.runs
            ]
        )
        mixture = fitted_mixture(event, weights, effective, self.rng)
        parts: list[tuple[np.ndarray, np.ndarray]] = []
        worth = 0.0
        for _ in range(_REFITS):
            z, weights = self._weighted(mixture)
            seen = weights > 0.0
            if not seen.any():
                break
            # a sample counts by what its mixture's samples are worth together
            effective = float(weights.sum() ** 2 / (weights**2).sum())
            parts.append((z[seen], weights[seen] * (effective / weights.sum())))
            worth += effective
            if worth >= _FEW:
                every = np.concatenate([part[0] for part in parts])
                shares = np.concatenate([part[1] for part in parts])
                mixture = fitted_mixture(every, shares, worth, self.rng)
            if self.left < 3 * self.size or effective > _GOOD * self.size:
                break
        return mixture

    def _weighted(self, mixture: Mixture) -> tuple[np.ndarray, np.ndarray]:
        """Samples of a mixture, and their weights: zero where it is not the event."""
        z = mixture.draw(self.size, self.rng)
        ratio = np.exp(mixture.log_ratio(z))
        return z, np.where(self.margin(z) >= 0.0, ratio, 0.0)

    def _agree(self) -> bool:
        """Whether the two estimates are as near as their errors allow."""
        sharp, plain = self.importance, self.subset
        if sharp is None or not sharp.probability or not plain.probability:
            return False
        apart = abs(math.log(sharp.probability / plain.probability))
        return apart <= _CONSISTENT * math.hypot(sharp.relative, plain.relative)

    def chosen(self) -> tuple[str, str]:
        """Which of the two is used, and why."""
        plain, sharp = "subset simulation", "importance sampling"
        if self.importance is None:
            return plain, self.why
        if not self._agree():
            problem = "importance sampling differs by more than the errors of both"
            return plain, problem
        if self.importance.relative >= self.subset.relative:
            return plain, "importance sampling has the larger error"
        good = "it agrees with subset simulation and has the smaller error"
        return sharp, self.why or good

    def likeliest(self) -> np.ndarray:
        """The z of largest density at which subset simulation saw the event."""
        seen = np.concatenate([run.event for run in self.runs])
        if not len(seen):
            return np.full(seen.shape[1:], np.nan)
        return seen[int(np.argmax(log_density(seen)))]


def _levels(
    margin: LimitMargin, z: np.ndarray, rng: np.random.Generator, most: int
) -> _Reached:
    """Levels up to the event, from plain samples on."""
    size, count = len(z), len(z) // _KEPT
    margins = margin(z)
    chains = Chains(z[None], margins[None], 1.0, 0.6)
    failures = int(margin.failed.sum())
    roots = np.arange(size)  # of each chain: the first state that it descends from
    probability, failed, levels = 1.0, failures / size, list[Level]()
    run, last = size, -math.inf
    while True:
        goal = min(_next_level(chains.margin, count, last, margin), 0.0)
        here = chains.margin >= goal
        part = float(here.mean())
        probability *= part
        error = math.sqrt(family_variance(here, roots)) if part else math.inf
        known = margin.threshold_of(goal)
        levels.append(Level(known, part, error, chains.accepted, run, failures))
        if goal >= 0.0:
            counted = size if len(levels) == 1 else 0
            found = Estimate(probability, probability * error, counted)
            worth = 1.0 / family_share(here, roots)
            return _Reached(found, levels, chains.z[here], worth, failed, "")
        run = size - count
        stopped = _stopped(levels, margin.motions + run > most)
        if stopped:
            none = np.zeros((0, z.shape[1]))
            return _Reached(Estimate(0.0, 0.0), levels, none, 0.0, failed, stopped)
        seeds = rng.permutation(np.flatnonzero(here.reshape(-1)))
        seeds = np.resize(seeds, count)  # some twice where states share few values
        roots = roots[seeds % here.shape[1]]
        before = sum(margin.reasons.values())
        chains = conditional_chains(
            margin,
            chains.z.reshape(size, -1)[seeds],
            chains.margin.reshape(-1)[seeds],
            goal,
            _KEPT,
            rng,
            chains.scale,
        )
        failures = sum(margin.reasons.values()) - before
        failed += probability * failures / run
        last = goal


def _stopped(levels: list[Level], spent: bool) -> str:
    if len(levels) == _MOST_LEVELS:
        return f"{_MOST_LEVELS} levels did not lead to the threshold"
    return "no motions were left for the next level" if spent else ""


def _next_level(
    margins: np.ndarray, count: int, last: float, margin: LimitMargin
) -> float:
    """The margin that a tenth of the states reach, more than the last level."""
    ordered = np.sort(margins.reshape(-1))[::-1]
    goal = float(ordered[count - 1])
    if goal >= 0.0:
        return goal
    higher = ordered[ordered > goal]
    # states that share a value leave too few to go on from, or none beyond it
    if goal > last and (ordered >= goal).sum() <= 5 * count:
        return goal
    if len(higher) >= count // 5 and higher[-1] > last:
        return float(higher[-1])
    field, known = "subset_simulation.of", margin.threshold_of(goal)
    if not math.isfinite(goal):
        problem, remedy = "is known of too few motions", "look at what fails"
        raise FieldError(field, dict(margin.reasons), problem, remedy)
    problem = "does not lead to the threshold: most motions share one value"
    remedy = (
        "name an output that takes more than a few values and grows towards the event, "
        "such as a margin, or a threshold within its reach"
    )
    raise FieldError(field, known, problem, remedy)
