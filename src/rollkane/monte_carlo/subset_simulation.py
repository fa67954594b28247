"""Probabilities of rare events: subset simulation, sharpened by importance sampling."""

import math
from typing import NamedTuple

import numpy as np

from ..validation.checks import FieldError, flag, real, whole
from .conditional_chains import Chains, conditional_chains, correlation_factor
from .evaluation import Model
from .inputs import share
from .limit_margin import LimitMargin
from .proposal_mixture import Mixture, fitted_mixture
from .rare_event import Estimate, Level, RareEvent
from .sampling import sampler
from .standard_normal import column_names, log_density, to_normal

_KEPT = 10  # a level is what every tenth state reaches
_MOST_LEVELS = 20
_CONSISTENT = 3.0  # standard errors that the two estimates may be apart
_FEW = 20  # states that show the event, below which nothing is fitted to them


def subset_simulation(
    model: Model,
    of: str,
    threshold: float,
    size_per_level: int = 2000,
    *,
    below: bool = False,
    seed: int = 0,
    level: float = 0.95,
    precision: float = 0.05,
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
        size_per_level: Motions of each level, a multiple of 10.
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
    most = whole(f"{field}.motions", motions, size, "give at least one level's")
    margin = LimitMargin(model, of, threshold, below)
    rng = np.random.default_rng([seed, 0x5B5E7])
    u = sampler("plain", model.draws.dimension, seed, size).uniforms(0, size)
    reached = _levels(margin, to_normal(u), rng, most)
    sharper, why = None, reached.stopped
    if reached.subset.probability:
        sharper, why = _importance(margin, reached, precision, most, size, rng)
    used, reason = _chosen(reached.subset, sharper, why)
    seen = reached.event
    nearest = seen[np.argmax(log_density(seen))] if len(seen) else u[0] * np.nan
    return RareEvent(
        of,
        threshold,
        below,
        used,
        reason,
        reached.subset,
        sharper,
        level,
        tuple(reached.levels),
        column_names(model.draws),
        nearest,
        margin.motions,
        dict(margin.reasons),
        min(reached.failed, 1.0),
    )


class _Reached(NamedTuple):
    """What subset simulation found.

    Attributes:
        subset: Its estimate.
        levels: One after the other.
        event: States that show the event, shape (n, d).
        effective: How many independent ones they stand for.
        failed: Probability of a motion that fails, over all levels.
        stopped: Why it did not come to the event; empty if it did.
    """

    subset: Estimate
    levels: list[Level]
    event: np.ndarray
    effective: float
    failed: float
    stopped: str


def _levels(
    margin: LimitMargin, z: np.ndarray, rng: np.random.Generator, most: int
) -> _Reached:
    """Levels up to the event, from plain samples on."""
    size, count = len(z), len(z) // _KEPT
    margins = margin(z)
    chains = Chains(z[None], margins[None], 1.0, 0.6)
    probability, failed, levels = 1.0, float(margin.failed.mean()), list[Level]()
    failures = int(margin.failed.sum())
    run, last = size, -math.inf
    while True:
        goal = min(_next_level(chains.margin, count, last, margin), 0.0)
        here = chains.margin >= goal
        part = float(here.mean())
        factor = correlation_factor(here)
        error = math.sqrt((1.0 - part) / (part * size) * factor) if part else math.inf
        known = margin.threshold_of(goal)
        levels.append(Level(known, part, error, chains.accepted, run, failures))
        probability *= part
        relative = math.sqrt(sum(one.relative_error**2 for one in levels))
        estimate = Estimate(probability, probability * relative)
        if goal >= 0.0:
            found = chains.z[here]
            return _Reached(estimate, levels, found, len(found) / factor, failed, "")
        run = size - count
        stopped = _stopped(levels, margin.motions + run > most)
        if stopped:
            none = np.zeros((0, z.shape[1]))
            return _Reached(Estimate(0.0, 0.0), levels, none, 0.0, failed, stopped)
        seeds = rng.permutation(np.flatnonzero(here.reshape(-1)))[:count]
        first = chains.z.reshape(size, -1)[seeds]
        before = sum(margin.reasons.values())
        chains = conditional_chains(
            margin,
            first,
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
    problem = "takes too few values to lead to the threshold: most motions share one"
    remedy = "name an output that grows towards the event, such as a margin"
    raise FieldError(field, known, problem, remedy)


def _importance(
    margin: LimitMargin,
    reached: _Reached,
    precision: float,
    most: int,
    size: int,
    rng: np.random.Generator,
) -> tuple[Estimate | None, str]:
    """Importance sampling from a mixture that is fitted twice.

    First to the states of subset simulation, then to weighted samples of the first
    mixture, which are independent of each other; those that are counted are drawn from
    the second one only.
    """
    if reached.subset.relative <= precision:
        return None, "its error is small enough"
    if precision >= 1.0 or margin.motions + 2 * size > most:
        return None, "no motions were left for importance sampling"
    if len(reached.event) < max(_FEW, 2 * reached.event.shape[1]):
        return None, "too few states show the event for a fit"
    ones = np.ones(len(reached.event))
    mixture = fitted_mixture(reached.event, ones, reached.effective, rng)
    z, weights = _weighted(margin, mixture, size, rng)
    seen = weights > 0.0
    if seen.any():
        total, squares = weights.sum(), float((weights**2).sum())
        effective = float(total**2 / squares)
        if effective > max(_FEW, 2 * z.shape[1]):
            mixture = fitted_mixture(z[seen], weights[seen], effective, rng)
    every = np.zeros(0)
    while margin.motions + size <= most:
        every = np.concatenate([every, _weighted(margin, mixture, size, rng)[1]])
        error = float(every.std(ddof=1)) / math.sqrt(len(every))
        found = Estimate(float(every.mean()), error)
        if found.relative <= precision:
            return found, ""
    return Estimate(
        float(every.mean()), float(every.std(ddof=1) / len(every) ** 0.5)
    ), ("motions ended before its precision was reached")


def _weighted(
    margin: LimitMargin, mixture: Mixture, count: int, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Samples of a mixture, and their weights: zero where it is not the event."""
    z = mixture.draw(count, rng)
    ratio = np.exp(log_density(z) - mixture.log_density(z))
    return z, np.where(margin(z) >= 0.0, ratio, 0.0)


def _chosen(subset: Estimate, importance: Estimate | None, why: str) -> tuple[str, str]:
    """Which of the two is used, and why."""
    plain, sharp = "subset simulation", "importance sampling"
    if importance is None:
        return plain, why
    apart = math.inf
    if importance.probability:
        apart = abs(math.log(importance.probability / subset.probability))
    allowed = _CONSISTENT * math.hypot(importance.relative, subset.relative)
    if apart > allowed:
        return plain, "importance sampling differs by more than the errors of both"
    if importance.relative >= subset.relative:
        return plain, "importance sampling has the larger error"
    return sharp, why or "it agrees with subset simulation and has the smaller error"
