"""Draws of several chains, and what tells whether they agree."""

from collections.abc import Callable, Mapping

import numpy as np

from . import chain_diagnostics as diagnostics
from .transforms import entries

# Beyond these, quantiles are not to be relied upon (Vehtari et al., 2021).
_MOST_R_HAT = 1.01
_LEAST_SIZE = 100.0  # of each chain
# Share of draws: single ones happen where steps fit most of what bends.
_DIVERGED = 1e-3


class PosteriorDraws(dict[str, np.ndarray]):
    """Draws by path, in front of the parameter's shape, one chain behind the other.

    Attributes:
        chains: How many there are.
        divergences: Draws where the sampler's energy was lost, and so where it may have
            missed a part of the distribution.
        r_hat: By path, rank-normalised split R-hat of each entry, which falls to 1 as
            chains agree; NaN of an entry that does not vary.
        ess_bulk: How many independent draws would tell the middle as well; likewise.
        ess_tail: How many would tell the 5 % and 95 % quantiles as well.
    """

    def __init__(self, values: Mapping[str, np.ndarray], chains: int, divergences: int):
        """Compare chains.

        Args:
            values: Draws by path.
            chains: How many equal parts of them are chains.
            divergences: Of all draws together.
        """
        super().__init__(values)
        self.chains, self.divergences = chains, divergences
        self.r_hat = self._of_entries(diagnostics.split_r_hat)
        self.ess_bulk = self._of_entries(diagnostics.bulk_size)
        self.ess_tail = self._of_entries(diagnostics.tail_size)

    def by_chain(self) -> dict[str, np.ndarray]:
        """Draws by path, shape (chains, draws of each, ...): ArviZ reads them so."""
        return {p: v.reshape(self.chains, -1, *v.shape[1:]) for p, v in self.items()}

    def doubts(self) -> list[str]:
        """What speaks against relying on the draws, naming the parameters."""
        least = _LEAST_SIZE * self.chains
        parts: list[str] = []
        for path in self:
            worst = [_worst(path, self.r_hat[path], "R-hat", np.nanmax)]
            for name, sizes in (("bulk", self.ess_bulk), ("tail", self.ess_tail)):
                worst.append(_worst(path, sizes[path], f"{name} ESS", np.nanmin))
            limits = (_MOST_R_HAT, -least, -least)
            signs = (1.0, -1.0, -1.0)
            parts += [
                text
                for (text, value), limit, sign in zip(worst, limits, signs, strict=True)
                if sign * value > limit
            ]
        found: list[str] = []
        if parts:
            found.append(
                f"posterior: {'; '.join(parts)}: before quantiles are relied upon, "
                f"R-hat should be {_MOST_R_HAT} at most, and ESS {least:.0f} at least; "
                "take more draws and warmup, or give priors"
            )
        if self.divergences > _DIVERGED * len(next(iter(self.values()))):
            found.append(
                f"posterior: {self.divergences} draws diverged: a part of the "
                "distribution may be missed; take more warmup, or give priors"
            )
        return found

    def _of_entries(
        self, measure: Callable[[np.ndarray], float]
    ) -> dict[str, np.ndarray]:
        found: dict[str, np.ndarray] = {}
        for path, chains in self.by_chain().items():
            flat = chains.reshape(*chains.shape[:2], -1)
            known = [measure(flat[:, :, k]) for k in range(flat.shape[2])]
            found[path] = np.reshape(known, chains.shape[2:])
        return found


def _worst(
    path: str, values: np.ndarray, measure: str, of: Callable[[np.ndarray], float]
) -> tuple[str, float]:
    """An entry's worst measure, in words and as a number; NaN where none varies."""
    if np.isnan(values).all():
        return "", np.nan
    value = float(of(values))
    label = entries(values.shape)[int(np.argmax(values.ravel() == value))]
    shown = f"{value:.3f}" if measure == "R-hat" else f"{value:.0f}"
    return f"{path}{label} has {measure} {shown}", value
