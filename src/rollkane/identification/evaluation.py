"""Misfits at a point, and their derivatives."""

from typing import Any, NamedTuple

import numpy as np


class Evaluation(NamedTuple):
    """Residuals at a point.

    Attributes:
        residual: Over their deviations, shape (N,), finite.
        jacobian: Shape (N, P).
        failed: Runs that did not reach their end.
        rounding: Of the derivatives by relative changes of the coordinates.
        priors: How many residuals, the last ones, are of priors: normal, whatever the
            loss of the samples.
        channels: Which channel of which record each sample is of, counted from 0, shape
            (N - priors,); None: all of one.
    """

    residual: np.ndarray
    jacobian: np.ndarray
    failed: int
    rounding: float = 0.0
    priors: int = 0
    channels: np.ndarray | None = None

    def by_kind(self, of_samples: Any, of_priors: float) -> np.ndarray:
        """Numbers of the samples, and one for each prior behind them, shape (N,)."""
        samples = self.residual.size - self.priors
        ours = np.broadcast_to(of_samples, (samples,))
        return np.concatenate([ours, np.full(self.priors, of_priors)])

    def held(self, misfit: float, row: np.ndarray) -> "Evaluation":
        """With a number that is held: as firm as a prior, it hides no others.

        Args:
            misfit: Of the number, over a width.
            row: Its derivatives over that width, shape (P,).
        """
        return self._replace(
            residual=np.append(self.residual, misfit),
            jacobian=np.concatenate([self.jacobian, row[None]]),
            priors=self.priors + 1,
        )

    @property
    def of_samples(self) -> np.ndarray:
        """Residuals without those of priors."""
        return self.residual[: self.residual.size - self.priors]

    @property
    def usable(self) -> bool:
        """Whether all numbers are finite."""
        return bool(
            np.isfinite(self.residual).all() and np.isfinite(self.jacobian).all()
        )
