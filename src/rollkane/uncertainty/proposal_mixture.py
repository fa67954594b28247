"""Mixtures of Student's t distributions, fitted to where a rare event happens.

Centres and scales are those of a mixture of normal distributions, fitted by expectation
maximization, which is the mixture of least cross-entropy to the samples; the components
that are drawn have heavy tails, and one of them is the standard normal density itself,
so that no weight is unbounded where the fit says nothing.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.special import gammaln  # pyright: ignore[reportMissingTypeStubs]

from .standard_normal import log_density

_FREEDOM = 4.0  # of Student's t: the tails of what is left out fall faster
_DEFENSE = 0.05  # the standard normal density's part
_MOST_COMPONENTS = 5
_SWEEPS = 200
_ENOUGH = 1e-6  # growth of the mean log-likelihood with which sweeps end
_CLEAR = 1.3  # times as far from 1 as chance brings eigenvalues
_STARTS = 3  # of each number of components
_THINNEST = 1e-12  # variance of a part over its largest, which roundings leave [1]


class Mixture(NamedTuple):
    """Components in r directions of d; in all others the standard normal density.

    Attributes:
        weights: Shape (K,), of sum 1 [1].
        centres: Shape (K, r) [1].
        scales: Symmetric positive definite, shape (K, r, r) [1].
        basis: The directions [1], orthonormal, shape (d, r).
    """

    weights: Float[np.ndarray, " K"]
    centres: Float[np.ndarray, "K r"]
    scales: Float[np.ndarray, "K r r"]
    basis: Float[np.ndarray, "d r"]

    def log_ratio(self, z: Float[np.ndarray, "n d"]) -> Float[np.ndarray, " n"]:
        """Logarithm of the standard normal density over the mixture's [1].

        No more than that of one over the standard normal component's part.
        """
        y = z @ self.basis
        size = y.shape[1]
        squares, roots = _distances(self, y)
        half = 0.5 * (_FREEDOM + size)
        constant = float(gammaln(half) - gammaln(0.5 * _FREEDOM))
        constant -= 0.5 * size * np.log(_FREEDOM * np.pi)
        parts = np.log(self.weights) + constant - roots
        parts = parts - half * np.log1p(squares / _FREEDOM)
        normal = log_density(y)[:, None]
        shares = np.log([1.0 - _DEFENSE] * len(self.weights) + [_DEFENSE])
        joined = np.concatenate([parts, normal], axis=1) + shares
        return normal[:, 0] - np.logaddexp.reduce(joined, axis=1)

    def draw(self, count: int, rng: np.random.Generator) -> Float[np.ndarray, "n d"]:
        """Samples of it, shape (count, d)."""
        z = rng.standard_normal((count, len(self.basis)))
        y = z @ self.basis
        which = rng.choice(len(self.weights), size=count, p=self.weights)
        stretch = np.sqrt(_FREEDOM / rng.chisquare(_FREEDOM, size=count))
        plain = rng.random(count) < _DEFENSE
        roots = np.linalg.cholesky(self.scales)
        moved = np.einsum("nij,nj->ni", roots[which], y) * stretch[:, None]
        change = np.where(plain[:, None], 0.0, self.centres[which] + moved - y)
        return z + change @ self.basis.T


def _distances(mixture: Mixture, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Squared distances from each centre, shape (n, K); log of the scales' roots."""
    factors = np.linalg.cholesky(mixture.scales)
    around = z - mixture.centres[:, None]
    turned = np.linalg.solve(factors, np.swapaxes(around, 1, 2))
    roots = np.log(np.einsum("kii->ki", factors)).sum(axis=1)
    return (turned**2).sum(axis=1).T, roots


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
    basis = _directions(z, weights, effective)
    z = z @ basis
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
    return best[1]._replace(basis=basis)


def _directions(z: np.ndarray, weights: np.ndarray, effective: float) -> np.ndarray:
    """Directions in which samples are not standard normal, shape (d, r), r >= 1.

    Eigenvectors of the second moments whose eigenvalues are not those that as many
    standard normal samples show (Marchenko and Pastur, Math. USSR Sbornik 1, 1967); of
    hundreds of numbers, few or one decide, and weights in all of them would drown it.
    """
    moments = (z * (weights / weights.sum())[:, None]).T @ z
    values, vectors = np.linalg.eigh(moments)
    wide = _CLEAR * np.sqrt(z.shape[1] / effective)
    usual = (values < (1.0 + wide) ** 2) & (values > max(1.0 - wide, 0.0) ** 2)
    usual[-1] = False
    return vectors[:, ~usual]


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
    mixture, last = _moments(z, weights, near, effective), -np.inf
    for _ in range(_SWEEPS):
        squares, roots = _distances(mixture, z)
        parts = np.log(mixture.weights) - roots - 0.5 * squares
        every = np.logaddexp.reduce(parts, axis=1)
        near = np.exp(parts - every[:, None])
        likely = float(weights @ every) - 0.5 * z.shape[1] * float(np.log(2.0 * np.pi))
        if likely - last < _ENOUGH:
            break
        mixture, last = _moments(z, weights, near, effective), likely
    return last, mixture


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
    few for so many numbers: directions that do not matter have it. Logarithms of their
    eigenvalues are, as a thin part of the event would be lost in a mean of variances.
    """
    size = z.shape[1]
    mass = np.maximum(weights @ near, 1e-12)
    centres = (weights[:, None] * near).T @ z / mass[:, None]
    scales = np.empty((len(mass), size, size))
    for k in range(len(mass)):
        around, own = z - centres[k], weights * near[:, k]
        values, vectors = np.linalg.eigh((around * own[:, None]).T @ around / mass[k])
        # a few samples of large weight are no more than a few
        worth = min(effective * mass[k], mass[k] ** 2 / max((own**2).sum(), 1e-24))
        kept = max(1.0 - size / worth, 0.0)
        least = _THINNEST * max(values[-1], _THINNEST)  # also of samples all the same
        values = np.maximum(values, least) ** kept
        scales[k] = (vectors * values) @ vectors.T
    return Mixture(mass / mass.sum(), centres, scales, np.eye(size))
