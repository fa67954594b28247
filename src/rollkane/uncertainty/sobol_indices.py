"""Sobol indices: which of what is drawn makes an output vary, right when runs fail."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from ..validation.checks import FieldError, whole
from .evaluation import Model, failures
from .inputs import chosen_outputs, share
from .resampling import Spread, unit_numbers
from .sampling import sampler
from .sobol_estimates import Design, bound_sums, index_bounds, index_sums, indices
from .sobol_few_hits import with_few_hits
from .sobol_result import SobolIndices
from .study import Study
from .study_model import model_of

_KINDS = ("sobol", "plain")
_LEAST = 32  # rows, below which nothing can be said


def sobol_indices(
    model: Model | Study,
    size: int,
    *,
    seed: int = 0,
    level: float = 0.95,
    factors: Sequence[str] | None = None,
    outputs: Sequence[str] | None = None,
    sampling: str = "sobol",
    resamples: int = 1000,
    limits: Mapping[str, tuple[Any, Any]] | None = None,
) -> SobolIndices:
    """First-order and total Sobol indices of a model's outputs, with intervals.

    The first-order index of a factor is the share of an output's variance that goes
    with the factor alone, the total index the share that is left when everything else
    is known. Motions are run in Saltelli's design, ``size (k + 2)`` of them for k
    factors; a row of it in which one fails is dropped whole, because what is left of
    it would be compared with what is not its pair.

    Args:
        model: A ``Study`` of rolling motions, or a :class:`FunctionModel`.
        size: Rows of the design; with Sobol samples 16 times a power of two is best.
        seed: Of all random numbers.
        level: Probability with which an interval covers its index [1].
        factors: Names of what is drawn, or labels of their entries (``"spin[0]"``); by
            default all names. One name is one factor, however many numbers it draws.
        outputs: Names of outputs; by default all, and indices are NaN of those that
            hardly a row has.
        sampling: ``"sobol"``: 16 independent scrambles of a Sobol sequence, from whose
            differences the intervals are; ``"plain"``: independent rows, resampled.
        resamples: Of the bootstrap, with plain samples.
        limits: By output, least and most that it can be [unit of the output]: what the
            bounds for failed motions take them to have been. By default the least and
            the most that were seen.

    Returns:
        Indices [1] by output; ``print`` shows them, and what failed.

    Raises:
        FieldError: sizes that are too small, unknown names, an output that is not
            made of numbers or that hardly a row has, limits that what was seen exceeds.

    Source: Saltelli et al., Comput. Phys. Commun. 181 (2010); estimators as in
    ``rollkane.uncertainty.sobol_estimates``.
    """
    size = whole("sobol_indices.size", size, _LEAST, "give more rows of the design")
    seed = whole("sobol_indices.seed", seed, 0, "give a whole number")
    level = share("sobol_indices.level", level)
    resamples = whole("sobol_indices.resamples", resamples, 100, "give more")
    if sampling not in _KINDS:
        remedy = f"use one of {_KINDS}"
        raise FieldError("sobol_indices.sampling", sampling, "is not known", remedy)
    model = model_of(model)
    names = tuple(model.draws.names if factors is None else factors)
    columns = [model.draws.columns(name) for name in names]
    dimension = model.draws.dimension
    samples = sampler(sampling, 2 * dimension, seed, size)
    u = _design(samples.uniforms(0, size), dimension, columns)
    values, code = model.evaluate(u)
    groups = None if samples.group_count is None else samples.groups(0, size)
    units = unit_numbers(size, groups)
    made = SobolIndices(names, level, size, failures(model, code))
    # few scrambles are too few to draw from
    how = _Resampling(units, level, resamples if groups is None else None, seed)
    limits = {} if limits is None else limits
    for name in chosen_outputs(values, outputs, "sobol_indices.outputs"):
        value = np.where(
            (code == 0).reshape(-1, *(1,) * (values[name].ndim - 1)),
            values[name].astype(float),
            np.nan,
        )
        parts = _parts(value.reshape(len(code), -1), size, len(names))
        asked = outputs is not None
        _add(made, name, value.shape[1:], parts, limits.get(name), how, asked)
    return made


class _Resampling:
    """How intervals are found."""

    def __init__(
        self, units: np.ndarray, level: float, resamples: int | None, seed: int
    ):
        self.units = units
        self.how = level, resamples, seed


def _design(u: np.ndarray, dimension: int, columns: list[slice]) -> np.ndarray:
    """Numbers of all motions: those of A, of B, and of A with each factor from B."""
    first, second = u[:, :dimension], u[:, dimension:]
    parts = [first, second]
    for part in columns:
        mixed = first.copy()
        mixed[:, part] = second[:, part]
        parts.append(mixed)
    return np.concatenate(parts)


def _parts(value: np.ndarray, size: int, count: int) -> Design:
    """Outputs by their place in the design."""
    mixed = value[2 * size :].reshape(count, size, -1)
    return Design(value[:size], value[size : 2 * size], np.moveaxis(mixed, 0, 1))


def _add(
    made: SobolIndices,
    name: str,
    shape: tuple[int, ...],
    design: Design,
    limits: tuple[Any, Any] | None,
    how: _Resampling,
    asked: bool,
) -> None:
    """Indices of one output, put into the result."""
    shaped: Callable[[np.ndarray], np.ndarray] = lambda x: x.reshape(
        *x.shape[:-1], *shape
    )
    complete = design.complete
    made.dropped[name] = int((~complete).sum())
    if complete.sum() < _LEAST or len(np.unique(how.units[complete])) < 2:
        if asked:
            problem = f"has {int(complete.sum())} rows without a NaN or a failed motion"
            remedy = "raise size, or look at what fails"
            raise FieldError("sobol_indices.outputs", name, problem, remedy)
        unknown = np.full((2, design.c.shape[1], *shape), np.nan)
        made.first[name], made.total[name] = unknown[0], unknown[0]
        made.first_interval[name] = made.first_bounds[name] = unknown
        made.total_interval[name] = made.total_bounds[name] = unknown
        return
    units = np.unique(how.units[complete], return_inverse=True)[1]
    kept = design.rows(complete)
    spread = Spread(index_sums(kept.standardized(), units), indices, *how.how)
    found = spread.estimate
    intervals = {kind: spread.interval(kind) for kind in ("first", "total")}
    intervals = with_few_hits(kept, intervals, how.how[0])
    made.first[name], made.total[name] = shaped(found["first"]), shaped(found["total"])
    made.first_interval[name] = shaped(intervals["first"])
    made.total_interval[name] = shaped(intervals["total"])
    bounds = dict(intervals)
    if not complete.all():
        low, high = _limits(name, design, shape, limits)
        made.limits[name] = (low.reshape(shape), high.reshape(shape))
        sums = bound_sums(design, low, high, how.units)
        wide = Spread(sums, index_bounds, *how.how)
        for kind in ("first", "total"):
            least = np.fmin(wide.interval(f"{kind}_low")[0], intervals[kind][0])
            most = np.fmax(wide.interval(f"{kind}_high")[1], intervals[kind][1])
            bounds[kind] = np.clip(np.stack([least, most]), 0.0, 1.0)
    made.first_bounds[name] = shaped(bounds["first"])
    made.total_bounds[name] = shaped(bounds["total"])


def _limits(
    name: str, design: Design, shape: tuple[int, ...], given: tuple[Any, Any] | None
) -> tuple[np.ndarray, np.ndarray]:
    """Least and most of an output, shape (E,)."""
    every = design.every()
    every = every.reshape(-1, every.shape[-1])
    seen = np.nanmin(every, axis=0), np.nanmax(every, axis=0)
    if given is None:
        return seen
    field = f"sobol_indices.limits[{name!r}]"
    remedy = "give the least and the most that the output can be"
    try:
        low, high = (np.broadcast_to(np.asarray(x, float), shape) for x in given)
    except (TypeError, ValueError) as error:
        raise FieldError(field, given, "is no pair of numbers", remedy) from error
    low, high = low.reshape(-1), high.reshape(-1)
    if (seen[0] < low).any() or (seen[1] > high).any():
        worst = float(seen[0].min()), float(seen[1].max())
        raise FieldError(field, given, f"is exceeded: {worst} was seen", remedy)
    return low, high
