"""The margin by which a member's output passes a threshold; motions that were run."""

from collections import Counter

import numpy as np
from jaxtyping import Bool, Float

from ..validation.checks import FieldError
from .evaluation import Model, entry, failures
from .standard_normal import to_uniform


class LimitMargin:
    """Output less threshold, of standard normal numbers; keeps count of motions.

    Attributes:
        motions: How many were run.
        reasons: How many of them failed, by the sentence that says why.
        failed: Which of the last ones failed, shape (n,).
    """

    def __init__(self, model: Model, of: str, threshold: float, below: bool):
        """Take what is asked.

        Args:
            model: Of the motions.
            of: An output, as ``entry`` reads it.
            threshold: [unit of the output].
            below: Whether smaller outputs pass it.
        """
        self._model, self._of, self._threshold = model, of, threshold
        self._sign = -1.0 if below else 1.0
        self.motions = 0
        self.reasons: Counter[str] = Counter()
        self.failed: Bool[np.ndarray, " n"] = np.zeros(0, bool)

    def __call__(self, z: Float[np.ndarray, "n d"]) -> Float[np.ndarray, " n"]:
        """Margins, at least 0 where it is the event; -inf where a motion failed."""
        values, code = self._model.evaluate(to_uniform(z))
        found = np.asarray(entry(values, self._of, "subset_simulation.of"))
        if found.dtype.kind not in "biuf":
            problem, remedy = "is not made of real numbers", "name another output"
            raise FieldError("subset_simulation.of", self._of, problem, remedy)
        margins = self._sign * (found.astype(float) - self._threshold)
        unknown = np.isnan(margins) & (code == 0)
        self.failed = (code != 0) | unknown
        self.motions += len(z)
        self.reasons.update(failures(self._model, code, unknown))
        return np.where(self.failed, -np.inf, margins)

    def threshold_of(self, margin: float) -> float:
        """The output with a margin [its unit]."""
        return self._threshold + self._sign * margin
