"""What a fit found: estimates, errors and residuals."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, Self

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from ..dynamics.consistency import consistent
from ..dynamics.scene import Scene
from . import uncertainty
from .evaluation import Evaluation
from .experiments import Problem
from .horizons import Search, Stage
from .layout import Coordinates, Layout
from .losses import loss_of
from .unseen import described


@dataclasses.dataclass(frozen=True, eq=False)
class Estimates:
    """What a fit found; :class:`rollkane.Fit` says what each field is."""

    estimates: dict[str, np.ndarray]
    standard_errors: dict[str, np.ndarray]
    names: tuple[str, ...]
    covariance: np.ndarray
    correlation: np.ndarray
    chi2: float
    degrees_of_freedom: int
    residuals: Any
    sigma: Any
    unseen: tuple[str, ...]
    rollouts: int
    failed: int
    converged: bool
    landings: Any
    stages: tuple[Stage, ...]
    minima: tuple[tuple[float, int], ...]
    scene: Scene
    start: Any
    record: Any
    loss: str
    problem: Problem = dataclasses.field(repr=False)
    search: Search = dataclasses.field(repr=False)

    @classmethod
    def of(
        cls, problem: Problem, best: Search, searches: list[Search], loss: str
    ) -> Self:
        """The result of a search."""
        layout, found = problem.layout, best.minimum
        z, at = found.z, found.at
        known = uncertainty.coordinate_covariance(at, layout, z, loss_of(loss))
        covariance = uncertainty.named_covariance(layout, z, known)
        unseen = uncertainty.unseen_directions(at, layout)
        spread = np.sqrt(np.diag(covariance))
        apart = np.where(spread > 0.0, spread, 1.0)
        residuals = problem.channel_misfits(z)
        models = [layout.model(k, z) for k in range(len(problem.records))]
        several = len(models) > 1
        every: Callable[[Sequence[Any]], Any]
        every = lambda parts: list(parts) if several else parts[0]
        return cls(
            estimates=layout.by_path(lambda e: e.at(z).value),
            standard_errors=layout.by_path(
                lambda e: standard_errors_of(e, z, known, unseen)
            ),
            names=uncertainty.names_of(layout),
            covariance=covariance,
            correlation=covariance / np.outer(apart, apart),
            chi2=float(np.sum(at.residual**2)),
            degrees_of_freedom=problem.samples()
            + _priors(layout)
            - (layout.size - len(unseen)),
            residuals=every(residuals),
            sigma=every(problem.sigmas()),
            unseen=described(unseen, layout, z),
            rollouts=problem.rollouts,
            failed=problem.failed,
            converged=found.converged,
            landings=every(problem.landings(z)),
            stages=tuple(best.stages),
            minima=_minima(searches),
            scene=models[0].scene,
            start=every([consistent(m.scene, m.time, m.start) for m in models]),
            record=every(
                [
                    eqx.tree_at(lambda r: r.channels, record, m.channels)
                    for record, m in zip(problem.records, models, strict=True)
                ]
            ),
            loss=loss,
            problem=problem,
            search=best,
        )

    @property
    def iterates(self) -> list[dict[str, np.ndarray]]:
        """Estimates at every accepted point of the search, in order."""
        layout = self.problem.layout
        return [
            layout.by_path(lambda e, z=z: e.at(z).value)
            for z in self.search.minimum.path
        ]

    def predicted(self) -> Any:
        """What the fit predicts for the samples, by channel, as they were measured.

        NaN where no sample is, and where the run with the estimates does not come to.
        Of several records a list.
        """
        problem, z = self.problem, self.search.minimum.z
        found = [
            {
                name: c.without(misfits[name] * np.asarray(c.sigma))
                for g in groups
                for name, c in g.channels.items()
            }
            for groups, misfits in zip(
                problem.groups, problem.channel_misfits(z, reached=True), strict=True
            )
        ]
        return found if len(found) > 1 else found[0]


def expected_errors(
    problem: Problem, at: Evaluation, z: np.ndarray
) -> dict[str, np.ndarray]:
    """Standard errors by path, infinite for what is not seen.

    Without bounds: what they would hold depends on samples that are not there yet.
    """
    layout = problem.layout
    known = uncertainty.coordinate_covariance(at, layout, z, bounded=False)
    unseen = uncertainty.unseen_directions(at, layout)
    return layout.by_path(lambda e: standard_errors_of(e, z, known, unseen))


def standard_errors_of(
    entry: Coordinates, z: np.ndarray, known: np.ndarray, unseen: np.ndarray
) -> np.ndarray:
    """Of a parameter's entries; infinite where an unseen direction changes them."""
    rows = entry.at(z).slope
    own = known[entry.where, entry.where]
    errors = np.sqrt(np.maximum(np.einsum("ik,kl,il->i", rows, own, rows), 0.0))
    errors[uncertainty.hidden(rows, unseen, entry.where)] = np.inf
    return errors.reshape(entry.at(z).value.shape)


def _priors(layout: Layout) -> int:
    """Numbers that priors are of."""
    return sum(
        len(e.transform.deviations(jnp.ones(e.at(layout.start).value.shape)))
        for e in layout.entries
        if e.free.prior is not None
    )


def _minima(searches: list[Search]) -> tuple[tuple[float, int], ...]:
    """Distinct costs, twice, and how many searches ended there."""
    found: list[tuple[float, int]] = []
    for search in sorted(searches, key=lambda s: s.minimum.cost):
        chi2 = 2.0 * search.minimum.cost
        # a tenth of a standard deviation, and the accuracy of runs at their tolerance
        if found and chi2 - found[-1][0] < 1e-2 + 1e-6 * abs(chi2):
            found[-1] = found[-1][0], found[-1][1] + 1
        else:
            found.append((chi2, 1))
    return tuple(found)
