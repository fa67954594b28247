"""Mixtures of Student's t distributions, fitted to where a rare event happens.

Centres and scales are those of a mixture of normal distributions, fitted by expectation
maximization, which is the mixture of least cross-entropy to the samples; the components
that are drawn have heavy tails, and one of them is the standard normal density itself,
so that no weight is unbounded where the fit says nothing.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.special import (  # pyright: ignore[reportMissingTypeStubs]
    gammaln,
    logsumexp,
)

from .standard_normal import log_density

_FREEDOM = 4.0  # of Student's t: the tails of what is left out fall faster
_DEFENSE = 0.05  # the standard normal density's part
_MOST_COMPONENTS = 5
_SWEEPS = 200
_ENOUGH = 1e-6  # growth of the mean log-likelihood with which sweeps end
_STARTS = 3  # of each number of components


class Mixture(NamedTuple):
    """Components by their weights, centres and scales, in d dimensions.

    Attributes:
        weights: Shape (K,), of sum 1 [1].
        centres: Shape (K, d) [1].
        scales: Symmetric positive definite, shape (K, d, d) [1].
    """

    weights: Float[np.ndarray, " K"]
    centres: Float[np.ndarray, "K d"]
    scales: Float[np.ndarray, "K d d"]

    def log_density(self, z: Float[np.ndarray, "n d"]) -> Float[np.ndarray, " n"]:
        """Of the t components and the standard normal one [1]."""
        size = z.shape[1]
        squares, roots = _distances(self, z)
        half = 0.5 * (_FREEDOM + size)
        constant = gammaln(half) - gammaln(0.5 * _FREEDOM)
        constant -= 0.5 * size * np.log(_FREEDOM * np.pi)
        parts = np.log(self.weights) + constant - roots
        parts = parts - half * np.log1p(squares / _FREEDOM)
        normal = log_density(z)[:, None]
        shares = np.log([1.0 - _DEFENSE] * len(self.weights) + [_DEFENSE])
        return np.asarray(
            logsumexp(np.concatenate([parts, normal], axis=1) + shares, axis=1)
        )

    def draw(self, count: int, rng: np.random.Generator) -> Float[np.ndarray, "n d"]:
        """Samples of it, shape (count, d)."""
        z = rng.standard_normal((count, self.centres.shape[1]))
        which = rng.choice(len(self.weights), size=count, p=self.weights)
        stretch = np.sqrt(_FREEDOM / rng.chisquare(_FREEDOM, size=count))
        plain = rng.random(count) < _DEFENSE
        roots = np.linalg.cholesky(self.scales)
        moved = np.einsum("nij,nj->ni", roots[which], z) * stretch[:, None]
        return np.where(plain[:, None], z, self.centres[which] + moved)


def _distances(mixture: Mixture, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Squared distances from each centre, shape (n, K); log of the scales' roots."""
    squares = np.empty((len(z), len(mixture.weights)))
    roots = np.empty(len(mixture.weights))
    for k, scale in enumerate(mixture.scales):
        root = np.linalg.cholesky(scale)
        squares[:, k] = (np.linalg.solve(root, (z - mixture.centres[k]).T) ** 2).sum(0)
        roots[k] = np.log(np.diag(root)).sum()
    return squares, roots


def fitted_mixture(
    z: Float[np.ndarray, "n d"],
    weights: Float[np.ndarray, " n"],
    effective: float,
    rng: np.random.Generator,
) -> Mixture:
    """The mixture that fits weighted samples, with as many components as they bear.

    Args:
        z: Samples [1].
        weights: Of each [1].
        effective: How many independent samples they stand for [1]: the number of
            components is that of least Bayesian information criterion.
        rng: Random numbers, for first guesses.

    Source: Kurtz and Song, Structural Safety 42 (2013): cross-entropy-based adaptive
    importance sampling with Gaussian mixtures.
    """
    size = z.shape[1]
    parameters = 1 + size + size * (size + 1) // 2
    best: tuple[float, Mixture] | None = None
    for count in range(1, _MOST_COMPONENTS + 1):
        if best is not None and effective < 2.0 * count * parameters:
            break
        found = [
            _maximized(z, weights, count, effective, rng)
            for _ in range(_STARTS if count > 1 else 1)
        ]
        likely, mixture = max(found, key=lambda one: one[0])
        criterion = (count * parameters - 1) * np.log(effective)
        criterion -= 2.0 * effective * likely
        if best is not None and criterion >= best[0]:
            break
        best = float(criterion), mixture
    assert best is not None
    return best[1]


def _maximized(
    z: np.ndarray,
    weights: np.ndarray,
    count: int,
    effective: float,
    rng: np.random.Generator,
) -> tuple[float, Mixture]:
    """Mean log-likelihood and mixture of one start of expectation maximization."""
    weights = weights / weights.sum()
    near = _first_parts(z, weights, count, rng)
    last = -np.inf
    for _ in range(_SWEEPS):
        mixture = _moments(z, weights, near, effective)
        squares, roots = _distances(mixture, z)
        parts = np.log(mixture.weights) - roots - 0.5 * squares
        every = np.asarray(logsumexp(parts, axis=1))
        near = np.exp(parts - every[:, None])
        likely = float(weights @ every) - 0.5 * z.shape[1] * float(np.log(2.0 * np.pi))
        if likely - last < _ENOUGH:
            break
        last = likely
    return likely, mixture


def _first_parts(
    z: np.ndarray, weights: np.ndarray, count: int, rng: np.random.Generator
) -> np.ndarray:
    """Each sample to the nearest of centres that lie apart (k-means++), (n, K)."""
    centres = z[rng.choice(len(z), size=1, p=weights)]
    while len(centres) < count:
        far = ((z[:, None] - centres) ** 2).sum(axis=2).min(axis=1) * weights
        chosen = rng.choice(len(z), p=far / far.sum()) if far.any() else 0
        centres = np.concatenate([centres, z[chosen : chosen + 1]])
    nearest = ((z[:, None] - centres) ** 2).sum(axis=2).argmin(axis=1)
    return np.eye(count)[nearest]


def _moments(
    z: np.ndarray, weights: np.ndarray, near: np.ndarray, effective: float
) -> Mixture:
    """Weights, means and covariances of parts.

    Covariances are drawn to that of the standard normal density as far as samples are
    few for so many numbers: directions that do not matter have it.
    """
    size = z.shape[1]
    mass = np.maximum(weights @ near, 1e-12)
    centres = (weights[:, None] * near).T @ z / mass[:, None]
    scales = np.empty((len(mass), size, size))
    for k in range(len(mass)):
        around = z - centres[k]
        cover = (around * (weights * near[:, k])[:, None]).T @ around / mass[k]
        drawn = size / (size + effective * mass[k])
        scales[k] = (1.0 - drawn) * cover + drawn * np.eye(size)
    return Mixture(mass / mass.sum(), centres, scales)
