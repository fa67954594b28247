"""The linear model of a fit's misfits, and its intervals, within bounds.

A number on its bound is not known the better for it: the truth lies inside, and the
others follow it there. So the misfits' linear model is profiled within the bounds.
"""

from typing import Any, cast

import numpy as np
from scipy import optimize  # pyright: ignore[reportMissingTypeStubs]

from . import uncertainty
from .directions import spectrum
from .estimates import Estimates, standard_errors_of
from .layout import Coordinates
from .losses import loss_of

_DOUBLINGS = 30  # of a pull, after which only a corner of the bounds can hold it
_HALVINGS = 50  # of a pull: below its rounding


class LinearBox:
    """Misfits as linear functions of coordinates within bounds, at estimates.

    Attributes:
        held: Whether bounds hold any of them.
        covariance: Of the coordinates, as without bounds, shape (P, P).
        free: Their estimates, as without bounds, shape (P,).
    """

    def __init__(self, fit: Estimates):
        """Take the misfits at the estimates of a fit.

        Of a robust loss rows are weighed so that, without bounds, the covariance is
        that of :func:`uncertainty.coordinate_covariance`.
        """
        self._layout, found, loss = fit.problem.layout, fit.search.minimum, fit.loss
        z, at, of = found.z, found.at, loss_of(loss)
        self._z = z
        self.held = bool(uncertainty.active(at, self._layout, z, of).any())
        scale, everything = self._layout.scale, slice(None)
        parts = spectrum(at, scale)
        slope, square = uncertainty.row_moments(at, parts, everything, of)
        weights = at.by_kind(of.weight(at.of_samples**2), 1.0)
        self._rows = (slope / square**0.5)[:, None] * at.jacobian * scale
        self._misfit = weights * at.residual / square**0.5
        self._box = tuple(
            (x - z) / scale for x in (self._layout.lower, self._layout.upper)
        )
        self.covariance = uncertainty.coordinate_covariance(
            at, self._layout, z, of, bounded=False
        )
        downhill = self._rows.T @ self._misfit / scale
        self.free = z - self.covariance @ downhill if self.held else z
        self._unseen = uncertainty.unseen_directions(at, self._layout)

    def interval(
        self, entry: Coordinates, quantile: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Ends for every entry of a parameter, in its shape.

        Args:
            entry: One of the layout's.
            quantile: Of the normal distribution: the root of chi2's rise.
        """
        errors = standard_errors_of(entry, self._z, self.covariance, self._unseen)
        value, _, slope, _ = entry.at(self._z)
        ends = np.stack(
            [value.ravel() - errors.ravel(), value.ravel() + errors.ravel()]
        )
        along = np.zeros((errors.size, self._z.size))
        along[:, entry.where] = slope * self._layout.scale[entry.where]
        for k, error in enumerate(errors.ravel()):
            if np.isfinite(error) and error > 0.0:
                apart = [self._end(along[k] / (s * error), quantile) for s in (-1, 1)]
                ends[:, k] = value.ravel()[k] + error * np.array([-apart[0], apart[1]])
        return ends[0].reshape(value.shape), ends[1].reshape(value.shape)

    def _end(self, along: np.ndarray, quantile: float) -> float:
        """How far a number can go until chi2 has risen [its error]."""
        least, _ = self._pulled(along, 0.0)

        def risen(pull: float) -> tuple[float, float]:
            chi2, taken = self._pulled(along, pull)
            return chi2 - least, taken

        low, high = 0.0, 2.0 * quantile  # without bounds they meet halfway
        for _ in range(_DOUBLINGS):
            if risen(high)[0] >= quantile**2:
                break
            low, high = high, 2.0 * high
        for _ in range(_HALVINGS):
            middle = 0.5 * (low + high)
            above = risen(middle)[0] >= quantile**2
            low, high = (low, middle) if above else (middle, high)
        return risen(high)[1]

    def _pulled(self, along: np.ndarray, pull: float) -> tuple[float, float]:
        """Least chi2 with a number drawn along, and where it is then.

        Of all points with the number there it is the least, as these are drawn alike.
        """
        draws = pull > 0.0
        rows = np.concatenate([self._rows, along[None]]) if draws else self._rows
        target = np.append(-self._misfit, pull) if draws else -self._misfit
        solve = cast(Any, optimize).lsq_linear
        step = solve(rows, target, self._box, method="bvls", tol=1e-14).x
        return float(np.sum((self._misfit + self._rows @ step) ** 2)), float(
            along @ step
        )
