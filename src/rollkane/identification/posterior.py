"""Posteriors: samples of the parameters, by Hamiltonian Monte Carlo."""

import warnings
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..validation.checks import FieldError, whole
from .bounded_intervals import LinearBox
from .experiments import Problem
from .fit_result import Fit
from .inner_coordinates import InnerCoordinates
from .open_ends import open_ends
from .posterior_draws import PosteriorDraws

_LEAST = 4  # draws of a chain, of which halves have a variance
_VISITS = 0.05  # draws that may be expected to come to an end that is open
_ACCEPTED = 0.9  # shorter steps than numpyro's 0.8 makes: fewer of them diverge
_APART = 2.0  # deviations, times which chains begin apart


def posterior(
    fit: Fit, draws: int = 4000, warmup: int = 500, seed: int = 0, chains: int = 4
) -> PosteriorDraws:
    """Samples of the parameters given the records (extra ``inference``: numpyro).

    By the No-U-Turn sampler, from the fit's likelihood and priors, which are of the
    numbers themselves; what has no prior is flat in the coordinates of the fit
    (logarithms of positive numbers, and so a density ``1 / x`` of the number x). That
    is a distribution only where the records keep a number from zero: where they do not,
    it is refused. Within bounds, given or of physics (friction is not negative), the
    density is the same, outside it is zero: steps are in coordinates that have no ends,
    whose slope is taken in.
    Chains begin about the estimates, twice as far apart as the linear covariance tells,
    in directions and units in which it is one.

    Args:
        fit: What :func:`rollkane.fit` found.
        draws: How many samples, of all chains together; rounded up to a multiple of
            these.
        warmup: How many before, in which each chain finds its step.
        seed: Of the random numbers.
        chains: How many, which begin apart. With one only its halves are compared.

    Returns:
        By path, draws in front of the parameter's shape [its unit], one chain behind
        the other; with what tells whether these agree, which warns by itself.

    Raises:
        FieldError: counts or a seed that are none, parameters that the records do not
            show or do not keep from an end of their range, a robust loss.
        ModuleNotFoundError: numpyro is not installed.
    """
    draws = whole("posterior.draws", draws, 1, "give how many samples")
    warmup = whole("posterior.warmup", warmup, 1, "give how many samples")
    seed = whole("posterior.seed", seed, 0, "give a whole number")
    chains = whole("posterior.chains", chains, 1, "give how many, 4 for example")
    each = max(-(-draws // chains), _LEAST)
    _check(fit)
    # of draws of a bell's shape this share is within a deviation that begins where the
    # density is exp(-rise / 2) of the middle's
    rise = 2.0 * np.log(chains * each / (np.sqrt(2.0 * np.pi) * _VISITS))
    far = open_ends(fit.problem, fit.search, max(float(rise), 1.0))
    if far:
        problem = (
            "has parameters that the records do not keep from an end of their range, "
            "where a flat prior has no end"
        )
        remedy = (
            "give a prior (a wide one is nearly flat in the number itself), hold them, "
            "or record more"
        )
        raise FieldError("posterior.fit", far, problem, remedy)
    layout, linear = fit.problem.layout, LinearBox(fit)
    deviations = np.sqrt(np.diag(linear.covariance))
    inner = InnerCoordinates.of(layout.lower, layout.upper, deviations)
    middle, root = inner.about(linear.free, linear.covariance)
    starts = _starts(fit, inner, middle, root, chains, np.random.default_rng(seed))
    potential = _potential(fit.problem, inner, middle, root)
    samples, diverged = _sampled(potential, starts, each, warmup, seed)
    y = jnp.asarray(middle + samples @ root.T)
    found = np.asarray(jax.vmap(inner.numbers)(y))
    # draws in front, before the records of those that have their own
    each_draw = [layout.by_path(lambda e, x=x: e.at(x).value) for x in found]
    values = {p: np.stack([one[p] for one in each_draw]) for p in each_draw[0]}
    result = PosteriorDraws(values, chains, diverged)
    for message in result.doubts():
        warnings.warn(message, UserWarning, stacklevel=2)
    return result


def _check(fit: Fit) -> None:
    """Refuse a fit whose likelihood is no density of its coordinates.

    Raises:
        FieldError: what :func:`posterior` refuses of a fit but its open ends.
    """
    if fit.unseen:
        remedy = "hold one of them, or give a prior"
        raise FieldError("posterior.fit", fit.unseen, "has unseen parameters", remedy)
    if fit.loss != "linear":
        raise FieldError("posterior.fit.loss", fit.loss, "is not a likelihood", "refit")


def _starts(
    fit: Fit,
    inner: InnerCoordinates,
    middle: np.ndarray,
    root: np.ndarray,
    chains: int,
    random: np.random.Generator,
) -> np.ndarray:
    """Where chains begin in whitened coordinates, shape (C, P).

    Nearer where the model bends so much that chi2 rises beyond what it does of a linear
    one: there are minima that belong to other motions.
    """
    size = middle.size
    most = fit.chi2 + _APART**2 * (size + 4.0 * np.sqrt(2.0 * size))
    found = _APART * random.standard_normal((chains, size))
    for k in range(chains):
        for _ in range(20):  # to a millionth
            z = np.asarray(inner.numbers(jnp.asarray(middle + root @ found[k])))
            at = fit.problem.evaluate(z)
            if at.usable and float(np.sum(at.residual**2)) <= most:
                break
            found[k] *= 0.5
    return found


def _potential(
    problem: Problem, inner: InnerCoordinates, middle: np.ndarray, root: np.ndarray
) -> Any:
    """Minus the logarithm of the density in whitened coordinates.

    Half of chi2, with its gradient ``J^T r``; less the volume of numbers with a prior
    that is in one of their coordinates, as the prior is a density of the numbers, and
    that of the coordinates in those without ends.
    """
    evaluate, volume = problem.pure(), jax.value_and_grad(problem.prior_volume())
    centre, whitened = jnp.asarray(middle), jnp.asarray(root)
    inner_volume = jax.value_and_grad(inner.log_slope)

    def with_slope(u: Float[Array, " P"]) -> tuple[Array, Array]:
        y = centre + whitened @ u
        at, pulled = cast("tuple[Array, Any]", jax.vjp(inner.numbers, y))
        residual, jacobian = evaluate(at)
        more, uphill = volume(at)
        bent, uphill_bent = inner_volume(y)
        value = 0.5 * jnp.sum(residual**2) - more - bent
        slope = cast(Array, pulled(jacobian.T @ residual - uphill)[0])
        return value, whitened.T @ (slope - uphill_bent)

    @jax.custom_vjp
    def potential(u: Float[Array, " P"]) -> Float[Array, ""]:
        return with_slope(u)[0]

    def backward(slope: Array, cotangent: Array) -> tuple[Array]:
        return (cotangent * slope,)

    potential.defvjp(with_slope, backward)
    return cast(Any, potential)


def _sampled(
    potential: Any, starts: np.ndarray, draws: int, warmup: int, seed: int
) -> tuple[np.ndarray, int]:
    """Draws in whitened coordinates, shape (C draws, P), and how many diverged."""
    from numpyro.infer import MCMC, NUTS  # pyright: ignore[reportMissingTypeStubs]

    count = len(starts)
    chain = MCMC(
        NUTS(potential_fn=potential, dense_mass=False, target_accept_prob=_ACCEPTED),
        num_warmup=warmup,
        num_samples=draws,
        num_chains=count,
        chain_method="sequential",
        progress_bar=False,
    )
    first = jnp.asarray(starts if count > 1 else starts[0])
    # numpyro relies on both promotions, whatever the caller has set
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        key = jax.random.PRNGKey(seed)
        chain.run(key, init_params=first, extra_fields=("diverging",))
    known = cast(Any, chain)
    diverged = int(np.sum(np.asarray(known.get_extra_fields()["diverging"])))
    return np.asarray(known.get_samples()), diverged
