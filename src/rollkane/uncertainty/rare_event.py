"""The probability of a rare event, as :func:`rollkane.subset_simulation` gives it."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from os import PathLike
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.special import ndtri  # pyright: ignore[reportMissingTypeStubs]

from .intervals import probability_interval


class Estimate(NamedTuple):
    """A probability and its error.

    Attributes:
        probability: [1].
        standard_error: [1].
        counted: Of how many independent motions it is the share [1]; 0: of none.
    """

    probability: float
    standard_error: float
    counted: int = 0

    @property
    def relative(self) -> float:
        """Standard error over probability [1]; infinite where that is zero."""
        if not self.probability:
            return math.inf
        return self.standard_error / self.probability

    def __str__(self) -> str:
        """The probability and its error, where it has one."""
        if not self.probability:
            return "0, as the event was not seen"
        return f"{self.probability:.4g} +- {100.0 * self.relative:.1f} %"

    def interval(self, level: float) -> tuple[float, float]:
        """Ends of an interval [1]: of a share, or by a log-normal distribution.

        Args:
            level: Probability that it covers [1].
        """
        if not self.probability:
            return 0.0, 1.0
        if self.counted:
            hits = round(self.probability * self.counted)
            ends = probability_interval(hits, self.counted, level)
            return float(ends[0]), float(ends[1])
        wide = float(ndtri(0.5 + 0.5 * level)) * self.relative
        low, high = math.exp(-min(wide, 700.0)), math.exp(min(wide, 700.0))
        return self.probability * low, min(self.probability * high, 1.0)


class Level(NamedTuple):
    """One level of subset simulation.

    Attributes:
        threshold: Value of the output that is reached [its unit].
        probability: Of reaching it, given the level before [1].
        relative_error: Of the probability of reaching it at all [1].
        accepted: Share of the chains' proposals that were accepted [1]; 1 at first.
        motions: That were run for it.
        failed: How many of them failed.
    """

    threshold: float
    probability: float
    relative_error: float
    accepted: float
    motions: int
    failed: int


@dataclass(frozen=True)
class RareEvent:
    """Probability that an output reaches a threshold.

    Attributes:
        of: The output.
        threshold: [its unit].
        below: Whether the event is to be at or below the threshold.
        method: ``"importance sampling"`` or ``"subset simulation"``: of which of the
            two the probability is.
        why: Why it is that one.
        subset: Estimate of subset simulation [1].
        importance: Estimate of importance sampling [1]; None where there was none.
        level: Probability with which ``interval`` covers [1].
        levels: Those of the first run of subset simulation.
        runs: Of subset simulation: more than were asked for where importance sampling
            differed.
        names: Of the standard normal numbers z of what is drawn, shape (d,).
        likeliest: The z of largest density at which the event was seen [1], shape (d,);
            NaN where it was not seen.
        motions: How many were run, for everything.
        reasons: How many of them failed, by the sentence that says why.
        failed_probability: Of a motion that fails [1]: what the probability would be
            larger by, if all of them had been the event.
    """

    of: str
    threshold: float
    below: bool
    method: str
    why: str
    subset: Estimate
    importance: Estimate | None
    level: float
    levels: tuple[Level, ...]
    runs: int
    names: tuple[str, ...]
    likeliest: Float[np.ndarray, " d"]
    motions: int
    reasons: dict[str, int]
    failed_probability: float

    @property
    def estimate(self) -> Estimate:
        """The one that is used [1]."""
        if self.importance is not None and self.method == "importance sampling":
            return self.importance
        return self.subset

    @property
    def probability(self) -> float:
        """Of the event [1]; motions that fail count as none."""
        return self.estimate.probability

    @property
    def standard_error(self) -> float:
        """Of the probability [1]."""
        return self.estimate.standard_error

    @property
    def interval(self) -> tuple[float, float]:
        """Ends of its interval [1].

        Where the event was never seen, from 0 to what lies beyond the last level.
        """
        if self.probability:
            return self.estimate.interval(self.level)
        reached = math.prod(level.probability for level in self.levels[:-1])
        return 0.0, reached

    @property
    def bounds(self) -> tuple[float, float]:
        """The interval, and above it what it were if failed motions had been it [1]."""
        low, high = self.interval
        return low, min(high + self.failed_probability, 1.0)

    @property
    def failed(self) -> int:
        """How many motions failed."""
        return sum(self.reasons.values())

    @property
    def reliability_index(self) -> float:
        """The z that a standard normal number exceeds with the probability [1]."""
        return -float(ndtri(self.probability))

    def __str__(self) -> str:
        """The probability with its error, the levels, and what failed."""
        return "\n".join(self._lines())

    def _lines(self) -> Iterator[str]:
        sign = "<=" if self.below else ">="
        low, high = self.interval
        yield f"P({self.of} {sign} {self.threshold:g}) = {self.probability:.4g}"
        yield f"  {100.0 * self.level:g} % interval {low:.4g} to {high:.4g}"
        yield f"  by {self.method} ({self.why}), {self.motions} motions"
        if self.failed:
            yield f"WARNING: {self.failed} of {self.motions} motions FAILED"
            yield from (f"  {count}: {why}" for why, count in self.reasons.items())
            more = self.failed_probability
            yield f"  They count as no event: if they are, add up to {more:.3g}"
        for name, one in (
            ("subset simulation", self.subset),
            ("importance sampling", self.importance),
        ):
            if one is not None:
                yield f"  {name:20} {one}"
        yield f"  levels of the first of {self.runs} runs of subset simulation:"
        yield "  level   threshold      given the last   error   accepted"
        for i, level in enumerate(self.levels):
            shown = f"{level.threshold:<13.6g}  {level.probability:<15.4g}"
            error = f"{100 * level.relative_error:.1f} %"
            yield f"  {i:<6}  {shown}  {error:7} {level.accepted:.2f}"
        if np.isfinite(self.likeliest).all():
            order = np.argsort(-abs(self.likeliest), kind="stable")[:8]
            parts = (f"{self.names[i]} {self.likeliest[i]:+.2f}" for i in order)
            yield f"  likeliest seen, in deviations: {', '.join(parts)}"

    def plot(self, path: str | PathLike[str] | None = None, title: str = "") -> Any:
        """Draw probabilities of the levels (extra ``plot``).

        Args:
            path: File to write, .png, .svg or .pdf; None for none.
            title: Above the figure.

        Returns:
            The matplotlib figure, or None where a file was written.
        """
        from ..pictures.plot_indices import plot_rare_event

        return plot_rare_event(self, path, title)
