"""Whether several Markov chains sample the same distribution, and how well."""

from typing import Any, cast

import numpy as np
from jaxtyping import Float
from scipy.special import ndtri  # pyright: ignore[reportMissingTypeStubs]

Chains = Float[np.ndarray, "C N"]


def split_r_hat(chains: Chains) -> float:
    """Rank-normalised split R-hat: of places, and of distances from the median.

    NaN of a number that does not vary.

    Args:
        chains: Draws of one number, shape (C, N), N of 4 or more.

    Source: Vehtari, Gelman, Simpson, Carpenter and Bürkner, Bayesian Analysis 16
    (2021), section 3.
    """
    halves = _halves(chains)
    folded = np.abs(halves - np.median(halves))
    return max(_r_hat(_normalised(halves)), _r_hat(_normalised(folded)))


def bulk_size(chains: Chains) -> float:
    """How many independent draws tell the middle as well (section 4.2, likewise)."""
    return _effective_size(_normalised(_halves(chains)))


def tail_size(chains: Chains) -> float:
    """How many tell the 5 % and 95 % quantiles as well, whichever they tell worse."""
    halves = _halves(chains)
    ends = np.quantile(halves, (0.05, 0.95))
    return min(_effective_size((halves <= end).astype(float)) for end in ends)


def _halves(chains: Chains) -> Chains:
    """The first and the second halves of chains, as chains."""
    half = chains.shape[1] // 2
    return np.concatenate([chains[:, :half], chains[:, -half:]])


def _normalised(chains: Chains) -> Chains:
    """Normal quantiles of ranks, Blom's; equal numbers have the mean of theirs."""
    _, places, counts = np.unique(chains, return_inverse=True, return_counts=True)
    ranks = np.cumsum(counts) - 0.5 * (counts - 1)
    shares = (ranks[places.ravel()] - 0.375) / (chains.size + 0.25)
    quantiles = cast("np.ndarray", cast(Any, ndtri)(shares))
    return quantiles.reshape(chains.shape)


def _variances(chains: Chains) -> tuple[float, float]:
    """Within chains, and of all of them."""
    count = chains.shape[1]
    own: np.ndarray = np.var(chains, axis=1, ddof=1)
    within, between = float(own.mean()), float(np.var(chains.mean(axis=1), ddof=1))
    return within, (count - 1) / count * within + between


def _r_hat(chains: Chains) -> float:
    within, whole = _variances(chains)
    if whole == 0.0:
        return np.nan
    return float(np.sqrt(whole / within)) if within > 0.0 else np.inf


def _effective_size(chains: Chains) -> float:
    """By autocorrelations of all chains together, up to where pairs are noise.

    Source: Geyer, Statist. Sci. 7 (1992), initial monotone sequence.
    """
    within, whole = _variances(chains)
    if whole == 0.0:
        return np.nan
    count = chains.shape[1]
    away = chains - chains.mean(axis=1, keepdims=True)
    power = np.abs(np.fft.rfft(away, 2 * count)) ** 2
    # about each chain's own mean, over count - 1 as the variance within
    along = np.fft.irfft(power, 2 * count)[:, :count].mean(axis=0) / (count - 1)
    rho = 1.0 - (within - along) / whole
    rho[0] = 1.0
    pairs = rho[: count // 2 * 2].reshape(-1, 2).sum(axis=1)
    noise = np.flatnonzero(pairs < 0.0)
    pairs = np.minimum.accumulate(pairs[: noise[0] if noise.size else None])
    # a mean of draws that alternate is better known; not by more than this
    least = 1.0 / np.log10(chains.size)
    return chains.size / max(2.0 * float(pairs.sum()) - 1.0, least)
