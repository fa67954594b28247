"""Posteriors: samples of the parameters, by Hamiltonian Monte Carlo."""

from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..validation.checks import FieldError, whole
from . import uncertainty
from .experiments import Problem
from .fit_result import Fit


def posterior(
    fit: Fit, draws: int = 1000, warmup: int = 500, seed: int = 0
) -> dict[str, np.ndarray]:
    """Samples of the parameters given the records (extra ``inference``: numpyro).

    By the No-U-Turn sampler, from the fit's likelihood and priors, which are of the
    numbers themselves; what has no prior is flat in the coordinates of the fit
    (logarithms of positive numbers). Begins at the estimates, in directions and units
    in which the linear covariance is one.

    Args:
        fit: What :func:`rollkane.fit` found.
        draws: How many samples.
        warmup: How many before, in which the sampler finds its step.
        seed: Of the random numbers.

    Returns:
        By path, draws in front of the parameter's shape [its unit].

    Raises:
        FieldError: counts or a seed that are none, parameters that the records do not
            show, bounds, a robust loss.
        ModuleNotFoundError: numpyro is not installed.
    """
    draws = whole("posterior.draws", draws, 1, "give how many samples")
    warmup = whole("posterior.warmup", warmup, 1, "give how many samples")
    seed = whole("posterior.seed", seed, 0, "give a whole number")
    layout, z = fit.problem.layout, fit.search.minimum.z
    if fit.unseen:
        remedy = "hold one of them, or give a prior"
        raise FieldError("posterior.fit", fit.unseen, "has unseen parameters", remedy)
    if np.isfinite(layout.lower).any() or np.isfinite(layout.upper).any():
        remedy = "leave bounds out, or give priors instead"
        raise FieldError("posterior.fit", "...", "has bounded parameters", remedy)
    if fit.loss != "linear":
        raise FieldError("posterior.fit.loss", fit.loss, "is not a likelihood", "refit")
    known = uncertainty.coordinate_covariance(fit.search.minimum.at, layout, z)
    root = np.linalg.cholesky(known)
    samples = _sampled(_potential(fit.problem, z, root), z.size, draws, warmup, seed)
    found = z + samples @ root.T
    return layout.by_path(lambda e: np.stack([e.at(x).value for x in found]))


def _potential(problem: Problem, z: np.ndarray, root: np.ndarray) -> Any:
    """Minus the logarithm of the density in whitened coordinates.

    Half of chi2, with its gradient ``J^T r``; less the volume of numbers with a prior
    that is in one of their coordinates, as the prior is a density of the numbers.
    """
    evaluate, volume = problem.pure(), jax.value_and_grad(problem.prior_volume())
    middle, whitened = jnp.asarray(z), jnp.asarray(root)

    def with_slope(u: Float[Array, " P"]) -> tuple[Array, Array]:
        at = middle + whitened @ u
        residual, jacobian = evaluate(at)
        more, uphill = volume(at)
        value = 0.5 * jnp.sum(residual**2) - more
        return value, whitened.T @ (jacobian.T @ residual - uphill)

    @jax.custom_vjp
    def potential(u: Float[Array, " P"]) -> Float[Array, ""]:
        return with_slope(u)[0]

    def backward(slope: Array, cotangent: Array) -> tuple[Array]:
        return (cotangent * slope,)

    potential.defvjp(with_slope, backward)
    return cast(Any, potential)


def _sampled(
    potential: Any, size: int, draws: int, warmup: int, seed: int
) -> np.ndarray:
    """Draws in whitened coordinates, shape (draws, P)."""
    from numpyro.infer import MCMC, NUTS  # pyright: ignore[reportMissingTypeStubs]

    kernel = NUTS(potential_fn=potential, dense_mass=False)
    chain = MCMC(kernel, num_warmup=warmup, num_samples=draws, progress_bar=False)
    # numpyro relies on both promotions, whatever the caller has set
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        chain.run(jax.random.PRNGKey(seed), init_params=jnp.zeros(size))
    return np.asarray(cast(Any, chain.get_samples()))
