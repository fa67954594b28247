"""The result of a fit: what it found, intervals, a report."""

import dataclasses
from collections.abc import Mapping
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..validation.checks import FieldError
from . import uncertainty
from .estimates import Estimates
from .profiles import linear_interval, profile_interval
from .report import text_report


@dataclasses.dataclass(frozen=True, eq=False)
class Fit(Estimates):
    """Estimates from records, and what is known about them.

    Attributes:
        estimates: By path, each in the parameter's shape [its unit]; of several
            records' own ones stacked along a first axis.
        standard_errors: Likewise; infinite for what the records do not show.
        names: Of the numbers that covariance and correlation are of.
        covariance: From ``J^T J``, of what is seen, shape (n, n); of a robust loss with
            what the loss does to the variance by the samples, and not to priors.
        correlation: Shape (n, n).
        chi2: Sum of squared misfits over deviations, priors included.
        degrees_of_freedom: Samples (and priors) minus coordinates that are seen.
        residuals: Misfits over deviations by channel (of several records, a list), NaN
            where no sample is. A sample that the run does not come to has at least 10,
            with which it counts.
        sigma: Standard deviations by channel [unit of its values], estimated where none
            was given.
        unseen: What the records cannot tell, in words.
        rollouts: Runs that were made, each with its derivatives.
        failed: How many of them did not reach their end.
        converged: Whether no step promised more.
        landings: How often the run with the estimates lands from a flight; of several
            records, a list.
        stages: Horizons that were fitted.
        minima: Distinct minima of several starts: chi2 and how many ended there.
        scene: The model with the estimates.
        start: The start with them, without what its contact does not allow, as the
            motion has it; of several records, a list.
        record: The record or records, with the estimates in their channels (``sigma``
            as it was given).
        loss: Of the misfits.
        problem: The least-squares problem, for more of it.
        search: How it was solved.
    """

    def interval(
        self, path: str, level: float = 0.95, method: str = "linear"
    ) -> tuple[np.ndarray, np.ndarray]:
        """Confidence interval of every entry of a parameter.

        Args:
            path: One of the estimates'.
            level: Its probability, between 0 and 1.
            method: ``"linear"``: from the standard errors; where bounds hold some of
                the estimates, by the profile of the linear model within them.
                ``"profile"``: where the least chi2 with the entry held has risen by the
                level's quantile (infinite where it does not rise so far).

        Returns:
            Lower and upper ends, in the parameter's shape.

        Raises:
            FieldError: an unknown path or method, a level out of range.
        """
        if path not in self.estimates:
            remedy = f"use one of {tuple(self.estimates)}"
            raise FieldError("Fit.interval.path", path, "was not fitted", remedy)
        if not 0.0 < level < 1.0:
            remedy = "give a probability, for example 0.95"
            raise FieldError("Fit.interval.level", level, "is out of range", remedy)
        if method == "linear":
            return linear_interval(self, path, level)
        if method == "profile":
            if self.loss != "linear":
                remedy = 'use "linear", or fit with loss="linear"'
                problem = f"is of chi2, not of the loss {self.loss!r}"
                raise FieldError("Fit.interval.method", method, problem, remedy)
            return profile_interval(self, path, level)
        remedy = 'use "linear" or "profile"'
        raise FieldError("Fit.interval.method", method, "is not known", remedy)

    def contains(self, values: Mapping[str, ArrayLike], level: float = 0.95) -> bool:
        """Whether values of all parameters together lie in their confidence region.

        Where chi2 has risen by the level's quantile of chi-square, at most: right where
        the region bends, too, unlike the ellipsoid of ``covariance``. Values that no
        model has (a negative mass, an inertia of no body) are outside.

        Args:
            values: By path, all that were fitted, each in its shape [its unit].
            level: Probability of the region.

        Raises:
            FieldError: other paths or shapes, a level out of range, a robust loss.
        """
        if not 0.0 < level < 1.0:
            remedy = "give a probability, for example 0.95"
            raise FieldError("Fit.contains.level", level, "is out of range", remedy)
        if self.loss != "linear":
            problem = f"is of chi2, not of the loss {self.loss!r}"
            remedy = 'fit with loss="linear"'
            raise FieldError("Fit.contains.values", "...", problem, remedy)
        shapes = {path: known.shape for path, known in self.estimates.items()}
        given = {path: np.shape(np.asarray(value)) for path, value in values.items()}
        if given != shapes:
            remedy = f"give one for each of {shapes}"
            raise FieldError("Fit.contains.values", given, "do not fit", remedy)
        layout, z = self.problem.layout, self.search.minimum.z
        there = z.copy()
        owners: dict[str, list[int | None]] = {}
        for entry in layout.entries:
            owners.setdefault(entry.free.path, []).append(entry.record)
        for entry in layout.entries:
            own = np.asarray(values[entry.free.path], float)
            if entry.record is not None:  # rows are of the records that have it
                own = own[owners[entry.free.path].index(entry.record)]
            there[entry.where] = entry.transform.coordinates(own)
        if not np.isfinite(there).all():
            return False
        at = self.problem.evaluate(there)
        seen = layout.size - len(uncertainty.unseen_directions(at, layout))
        risen = float(np.sum(at.residual**2)) - self.chi2
        return at.usable and risen <= uncertainty.rise_of(level, max(seen, 1))

    def report(self) -> str:
        """The fit in words and a table."""
        return text_report(self)

    def plot(self, path: str | PathLike[str] | None = None, title: str = "") -> Any:
        """Samples, predictions and misfits by channel (extra ``plot``).

        Args:
            path: File to write, .png, .svg or .pdf; None for none.
            title: Above the figure.

        Returns:
            The matplotlib figure, or None where a file was written.
        """
        from ..pictures.plot_fit import figure_fit, plot_fit

        if path is None:
            return figure_fit(self, title=title)
        return plot_fit(self, path, title=title)

    def write_report(self, path: str | PathLike[str], title: str = "") -> None:
        """Write the report and the pictures as one self-contained page.

        Needs the extra ``plot``.

        Args:
            path: HTML file to write; opens from disk, without a network.
            title: Of the page.
        """
        from ..pictures.fit_page import write_fit_page

        write_fit_page(self, path, title=title)

    def __str__(self) -> str:
        """The report."""
        return self.report()
