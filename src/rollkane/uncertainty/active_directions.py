"""Active directions: what an output varies along, from gradients of few motions."""

from collections.abc import Iterator
from dataclasses import dataclass
from os import PathLike
from typing import Any, cast

import numpy as np
from jaxtyping import Float

from ..validation.checks import FieldError, whole
from .evaluation import DifferentiableModel, failures
from .inputs import share
from .resampling import Spread, Sums, sum_by_unit, unit_numbers
from .sampling import sampler
from .standard_normal import column_names, slopes_by_normal, to_normal
from .study import Study
from .study_model import model_of

_MOST_SHOWN = 8


@dataclass(frozen=True)
class ActiveDirections:
    """Eigenvectors of the mean of ``g g^T``, g the gradient of an output.

    The gradient is by standard normal numbers z of what is drawn (u = Phi(z)); d is how
    many there are.

    Attributes:
        of: The output.
        names: Of the entries of z, shape (d,).
        factors: Of what is drawn, k of them.
        level: Probability with which an interval covers [1].
        matrix: The mean of ``g g^T`` [unit of the output, squared], shape (d, d).
        eigenvalues: Its eigenvalues [as matrix], largest first, shape (d,).
        eigenvalue_interval: Their intervals, shape (2, d).
        directions: Its eigenvectors [1], one in each column, the largest entry
            positive, shape (d, d).
        subspace_error: Mean distance [1] of the first i + 1 directions' space from that
            of resampled motions, 0 (none) to 1 (orthogonal), shape (d - 1,).
        activity: Activity score of each factor: its part of the eigenvalues' sum
            [as matrix], shape (k,).
        total_bound: Upper bounds of the factors' total Sobol indices [1], shape (k,).
        total_bound_interval: Their intervals [1], shape (2, k).
        mean: Of the output [its unit].
        variance: Of the output [its unit, squared].
        size: How many motions were run.
        reasons: How many of them failed, by the sentence that says why.
    """

    of: str
    names: tuple[str, ...]
    factors: tuple[str, ...]
    level: float
    matrix: Float[np.ndarray, "d d"]
    eigenvalues: Float[np.ndarray, " d"]
    eigenvalue_interval: Float[np.ndarray, "2 d"]
    directions: Float[np.ndarray, "d d"]
    subspace_error: Float[np.ndarray, " d-1"]
    activity: Float[np.ndarray, " k"]
    total_bound: Float[np.ndarray, " k"]
    total_bound_interval: Float[np.ndarray, "2 k"]
    mean: float
    variance: float
    size: int
    reasons: dict[str, int]

    @property
    def failed(self) -> int:
        """How many motions failed."""
        return sum(self.reasons.values())

    def __str__(self) -> str:
        """Eigenvalues, directions by name, bounds of the indices."""
        return "\n".join(self._lines())

    def _lines(self) -> Iterator[str]:
        yield f"Active directions of {self.of} from {self.size} gradients"
        if self.failed:
            yield f"WARNING: {self.failed} of {self.size} motions FAILED"
            yield from (f"  {count}: {why}" for why, count in self.reasons.items())
        whole_sum = self.eigenvalues.sum()
        shares = self.eigenvalues / (whole_sum if whole_sum else 1.0)
        percent = f"{100.0 * self.level:g} % interval"
        yield f"{'eigenvalue':>12}  {percent:24} {'share':>6}  {'space error':>11}"
        for i, value in enumerate(self.eigenvalues[:_MOST_SHOWN]):
            low, high = self.eigenvalue_interval[:, i]
            last = i == len(self.subspace_error)
            error = "" if last else f"{self.subspace_error[i]:11.2e}"
            between = f"{low:.3e} to {high:.3e}"
            yield f"{value:12.4e}  {between:24} {shares[i]:6.3f}  {error}".rstrip()
        for i in range(min(2, len(self.names))):
            parts = self.directions[:, i]
            order = np.argsort(-abs(parts), kind="stable")[:_MOST_SHOWN]
            text = ", ".join(f"{parts[j]:+.3f} {self.names[j]}" for j in order)
            yield f"direction {i + 1}: {text}"
        yield "total Sobol indices are at most (estimate, and its interval):"
        for i, name in enumerate(self.factors):
            low, high = self.total_bound_interval[:, i]
            yield f"  {name}: {self.total_bound[i]:.3g} ({low:.3g} to {high:.3g})"

    def plot(self, path: str | PathLike[str] | None = None, title: str = "") -> Any:
        """Draw eigenvalues and activity scores (extra ``plot``).

        Args:
            path: File to write, .png, .svg or .pdf; None for none.
            title: Above the figure.

        Returns:
            The matplotlib figure, or None where a file was written.
        """
        from ..pictures.plot_indices import plot_active_directions

        return plot_active_directions(self, path, title)


def active_directions(
    model: DifferentiableModel | Study,
    of: str = "value",
    size: int = 1000,
    *,
    seed: int = 0,
    level: float = 0.95,
    resamples: int = 1000,
) -> ActiveDirections:
    """Directions of what is drawn along which an output varies, by its gradients.

    The eigenvectors of the mean of ``g g^T``, g the gradient by standard normal numbers
    (u = Phi(z)), say along which combinations an output varies, and its diagonal bounds
    every factor's total Sobol index: a few hundred gradients tell what is of no
    account, for any number of factors. A jump of the output (a count, whether something
    happened) has no gradient and is not seen.

    Args:
        model: A ``Study`` of rolling motions, or a :class:`FunctionModel`.
        of: The output, with an index where it is an array: ``"end[0]"``.
        size: Motions with gradients.
        seed: Of all random numbers.
        level: Probability with which intervals cover [1].
        resamples: Of the bootstrap, from which intervals and errors are.

    Raises:
        FieldError: no such output, or a model without gradients; sizes that are too
            small; fewer than two motions that do not fail.

    Source: Constantine, Active Subspaces, SIAM 2015, sections 3.1 to 3.4; scores:
    Constantine and Diaz, Reliab. Eng. Syst. Saf. 162 (2017); bounds: Sobol and
    Kucherenko, Math. Comput. Simul. 79 (2009), and Lamboni, Iooss, Popelin and Gamboa,
    Math. Comput. Simul. 87 (2013), with Poincare's constant 1 of the normal density.
    """
    size = whole("active_directions.size", size, 2, "give how many motions")
    seed = whole("active_directions.seed", seed, 0, "give a whole number")
    resamples = whole("active_directions.resamples", resamples, 100, "give more")
    level = share("active_directions.level", level)
    differentiable = _differentiable(model)
    draws = differentiable.draws
    u = sampler("plain", draws.dimension, seed, size).uniforms(0, size)
    values, gradients, code = differentiable.value_and_gradient(u, of)
    good = (code == 0) & np.isfinite(values) & np.isfinite(gradients).all(axis=1)
    if good.sum() < 2:
        remedy = "look at what fails"
        count = int(good.sum())
        problem = f"has {count} motions that did not fail"
        raise FieldError("active_directions.model", of, problem, remedy)
    slopes = slopes_by_normal(to_normal(u[good]), gradients[good])
    factors = draws.names
    parts = np.zeros((len(factors), draws.dimension))
    for i, name in enumerate(factors):
        parts[i, draws.columns(name)] = 1.0
    units = unit_numbers(len(slopes), None)
    sums = _sums(values[good], slopes, units)
    eigenvectors = _eigen(slopes.T @ slopes / len(slopes))[1]

    def estimates(sums: Sums) -> dict[str, np.ndarray]:
        return _estimates(sums, parts, eigenvectors)

    spread = Spread(sums, estimates, level, resamples, seed)
    found = spread.estimate
    return ActiveDirections(
        of,
        column_names(draws),
        factors,
        level,
        found["matrix"],
        found["eigenvalues"],
        spread.interval("eigenvalues"),
        eigenvectors,
        spread.mean("distance"),
        found["activity"],
        found["bound"],
        spread.interval("bound"),
        float(values[good].mean()),
        float(values[good].var()),
        size,
        failures(differentiable, code, ~good & (code == 0)),
    )


def _differentiable(given: DifferentiableModel | Study) -> DifferentiableModel:
    model = given if hasattr(given, "value_and_gradient") else model_of(given)
    if not hasattr(model, "value_and_gradient"):
        remedy = "use a Study or a FunctionModel, or write its value_and_gradient"
        raise FieldError("active_directions.model", given, "has no gradients", remedy)
    return cast(DifferentiableModel, model)


def _sums(
    values: np.ndarray, slopes: np.ndarray, units: np.ndarray
) -> dict[str, np.ndarray]:
    """Sums over units of what the estimates are functions of."""
    around = values - values.mean()
    outer = slopes[:, :, None] * slopes[:, None, :]
    rows = {"count": np.ones(len(values)), "value": around, "square": around**2}
    rows["outer"] = outer
    return {name: sum_by_unit(x, units) for name, x in rows.items()}


def _eigen(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Eigenvalues, largest first, and eigenvectors, the largest entry positive."""
    values, vectors = np.linalg.eigh(matrix)
    # rounding may make a zero negative
    values, vectors = np.maximum(values[..., ::-1], 0.0), vectors[..., ::-1]
    largest = np.argmax(abs(vectors), axis=-2)[..., None, :]
    sign = np.sign(np.take_along_axis(vectors, largest, axis=-2))
    return values, vectors * sign


def _estimates(
    sums: Sums, parts: np.ndarray, reference: np.ndarray
) -> dict[str, np.ndarray]:
    """Of sums with any axes in front; distances are from the reference's spaces."""
    count = sums["count"][..., None]
    matrix = sums["outer"] / count[..., None]
    values, vectors = _eigen(matrix)
    mean, square = sums["value"][..., None] / count, sums["square"][..., None] / count
    diagonal = np.einsum("...ii->...i", matrix)
    activity = diagonal @ parts.T
    variance = square - mean * mean
    overlap = np.swapaxes(vectors, -1, -2) @ reference
    size = matrix.shape[-1]
    distances = [
        np.linalg.norm(overlap[..., :i, i:], ord=2, axis=(-2, -1))
        for i in range(1, size)
    ]
    return {
        "matrix": matrix,
        "eigenvalues": values,
        "activity": activity,
        "bound": np.minimum(activity / np.where(variance > 0.0, variance, np.nan), 1.0),
        "distance": np.stack(distances, axis=-1) if distances else values[..., :0],
    }
