"""Which experiment makes wanted parameters best known, before it is made."""

import dataclasses
from collections.abc import Callable, Sequence
from os import PathLike
from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..dynamics.scene import Scene
from ..hybrid.modes import Modes
from ..kinematics.coordinates import State
from ..simulation.run_options import RunOptions
from ..validation.checks import FieldError, whole
from . import uncertainty
from .estimates import expected_errors
from .experiments import Problem
from .fitting import problem_of
from .layout import Layout, share_numbers
from .parameters import Free, Model, located
from .records import Record
from .residuals import linearized, within

CRITERIA = ("D", "A")
_SMALLEST = 1e-3  # step at which the ascent ends [of the variables' size]


@dataclasses.dataclass(frozen=True, eq=False)
class ExperimentDesign:
    """The best of several experiments, and what it would tell.

    Attributes:
        scene: Its scene.
        start: Its start.
        scores: Of the candidates, shape (C,): minus the logarithm of the wanted
            parameters' relative errors [nat], geometric mean ("D") or root mean square
            ("A"); minus infinity where some are not seen.
        best: Number of the best candidate.
        score: Of the design; higher than the best candidate's where it was varied.
        standard_errors: That it would give, by path.
        history: Scores along the ascent.
    """

    scene: Scene
    start: State
    scores: np.ndarray
    best: int
    score: float
    standard_errors: dict[str, np.ndarray]
    history: np.ndarray

    def plot(self, path: str | PathLike[str] | None = None, title: str = "") -> Any:
        """Draw scores of the candidates (extra ``plot``).

        Args:
            path: File to write, .png, .svg or .pdf; None for none.
            title: Above the figure.

        Returns:
            The matplotlib figure, or None where a file was written.
        """
        from ..pictures.plot_indices import plot_design

        return plot_design(self, path, title)


class _Plan(NamedTuple):
    """What all experiments have in common."""

    record: Record
    free: tuple[Free, ...]
    wanted: tuple[str, ...]
    criterion: str
    modes: Modes | None
    options: RunOptions

    def problem(self, scene: Scene, start: State) -> Problem:
        """The fit that would follow."""
        return problem_of(
            scene, [start], [self.record], self.free, self.modes, self.options
        )

    def model(self, scene: Scene, start: State) -> Model:
        """What predicts its record."""
        record = self.record
        return Model(scene, start, record.start_time, self.modes, record.channels)

    def chosen(self, layout: Layout) -> np.ndarray:
        """Coordinates of the wanted parameters."""
        found: list[int] = []
        for entry in layout.entries:
            if entry.free.path in self.wanted:
                found += range(entry.where.start, entry.where.stop)
        return np.array(found)


def design_experiment(
    scene: Scene,
    candidates: State | Sequence[State | tuple[Scene, State]],
    record: Record,
    free: Free | Sequence[Free],
    *,
    wanted: Sequence[str] | None = None,
    criterion: str = "D",
    vary: Free | Sequence[Free] = (),
    steps: int = 20,
    modes: Modes | None = None,
    rtol: float | None = None,
    method: str = "auto",
) -> ExperimentDesign:
    """The start (or scene, or base motion) that makes parameters best known.

    Every candidate is simulated with its derivatives; the best one is then improved
    along the criterion's gradient by what may vary.

    Args:
        scene: The model.
        candidates: Starts, or pairs of a scene and a start.
        record: Times, channels and their noise; the samples do not matter.
        free: Parameters that the record will be fitted with, all of them.
        wanted: Paths of those that matter; None: all.
        criterion: ``"D"``: the volume of the confidence region; ``"A"``: the mean
            square of relative errors.
        vary: Numbers of the start or scene that may be changed, with bounds.
        steps: Most steps of the ascent.
        modes: How the contact may change in the runs.
        rtol: Relative tolerance of the runs [1].
        method: Of the runs.

    Returns:
        The best experiment and what it would tell.

    Raises:
        FieldError: unknown names, no candidate that shows all wanted parameters.
    """
    listed = [candidates] if isinstance(candidates, State) else list(candidates)
    pairs = [c if isinstance(c, tuple) else (scene, c) for c in listed]
    chosen = (free,) if isinstance(free, Free) else tuple(free)
    names = tuple(f.path for f in chosen) if wanted is None else tuple(wanted)
    for name in names:
        if name not in {f.path for f in chosen}:
            remedy = f"use some of {tuple(f.path for f in chosen)}"
            field = "design_experiment.wanted"
            raise FieldError(field, name, "is not among the free ones", remedy)
    if criterion not in CRITERIA:
        field, remedy = "design_experiment.criterion", f"use one of {CRITERIA}"
        raise FieldError(field, criterion, "is not known", remedy)
    if not pairs:
        remedy = "give starts"
        raise FieldError("design_experiment.candidates", pairs, "is empty", remedy)
    steps = whole("design_experiment.steps", steps, 0, "give how many")
    options = RunOptions(rtol, None, None, method)
    plan = _Plan(record, chosen, names, criterion, modes, options)
    scores = np.array([_told(plan, plan.problem(*pair)).score for pair in pairs])
    best = int(np.argmax(scores))
    if not np.isfinite(scores[best]):
        remedy = "see rollkane.identifiability for what is not seen, and hold it"
        field = "design_experiment.candidates"
        raise FieldError(field, "...", "do not show all wanted parameters", remedy)
    found, history = pairs[best], np.array([scores[best]])
    variables = (vary,) if isinstance(vary, Free) else tuple(vary)
    if variables:
        found, history = _ascended(plan, *found, variables, steps)
    problem = plan.problem(*found)
    at = problem.evaluate(problem.layout.start)
    return ExperimentDesign(
        scene=found[0],
        start=found[1],
        scores=scores,
        best=best,
        score=float(history[-1]),
        standard_errors=expected_errors(problem, at, problem.layout.start),
        history=history,
    )


class _Told(NamedTuple):
    """What one experiment would tell.

    Attributes:
        score: Minus infinity where wanted parameters are not seen.
        seen: Directions that are seen, columns relative to the sizes of the
            coordinates, shape (P, S).
        priors: Derivatives of what is known before, by the coordinates, shape (Q, P).
    """

    score: float
    seen: np.ndarray
    priors: np.ndarray


def _told(plan: _Plan, problem: Problem) -> _Told:
    """Of one experiment.

    Bounds do not count: what they would hold depends on samples that are not there yet.
    """
    layout = problem.layout
    at = problem.evaluate(layout.start)
    if at.failed or not at.usable:
        return _Told(-np.inf, np.eye(layout.size), np.zeros((0, layout.size)))
    parts = uncertainty.spectrum(at, layout.scale)
    seen, priors = parts.directions[parts.seen].T, at.jacobian[at.of_samples.size :]
    unseen = uncertainty.unseen_directions(at, layout)
    chosen = plan.chosen(layout)
    if uncertainty.hidden(np.eye(layout.size), unseen, slice(None))[chosen].any():
        return _Told(-np.inf, seen, priors)
    known = uncertainty.coordinate_covariance(at, layout, layout.start, bounded=False)
    scale = layout.scale[chosen]
    covariance = known[np.ix_(chosen, chosen)] / np.outer(scale, scale)
    if plan.criterion == "A":
        score = -0.5 * float(np.log(np.mean(np.diag(covariance))))
    else:
        score = -0.5 * float(np.linalg.slogdet(covariance)[1]) / scale.size
    return _Told(score, seen, priors)


def _check_vary(plan: _Plan, model: Model, vary: tuple[Free, ...]) -> None:
    """Refuse what is to be found, and what an experiment is not made of."""
    field = "design_experiment.vary"
    for one in vary:
        if located(one.path, model.channels)[0] not in ("scene", "start"):
            problem, remedy = "is no number of the start or scene", "vary others"
            raise FieldError(field, one.path, problem, remedy)
        for free in plan.free:
            if share_numbers(model, one.path, free.path):
                problem = f"is to be found, or a part of {free.path!r}, which is"
                raise FieldError(field, one.path, problem, "vary others")


def _ascended(
    plan: _Plan, scene: Scene, start: State, vary: tuple[Free, ...], steps: int
) -> tuple[tuple[Scene, State], np.ndarray]:
    """The experiment after an ascent along the gradient, and the scores on its path."""
    model = plan.model(scene, start)
    variables = Layout([model], vary)
    _check_vary(plan, model, vary)
    slope_of = _gradient(plan, model, variables)
    d, length = variables.start, 0.1  # [of the variables' size]; it doubles or halves

    def moved(d: np.ndarray) -> tuple[Scene, State]:
        found = variables.model(0, d)
        return found.scene, found.start

    at = _told(plan, plan.problem(scene, start))
    scores = [at.score]
    for _ in range(steps):
        slope = variables.scale * slope_of(d, at)
        if not np.isfinite(slope).all() or not np.any(slope):
            break
        while length > _SMALLEST:
            step = length * variables.scale * slope / np.abs(slope).max()
            tried = np.clip(d + step, variables.lower, variables.upper)
            there = _told(plan, plan.problem(*moved(tried)))
            if there.score > at.score:
                d, at, length = tried, there, 2.0 * length
                scores.append(at.score)
                break
            length *= 0.5
        else:
            break
    return moved(d), np.array(scores)


def _gradient(
    plan: _Plan, model: Model, variables: Layout
) -> Callable[[np.ndarray, _Told], np.ndarray]:
    """Derivative of the criterion by the variables.

    In directions that are seen, held: wanted parameters are no part of the others, so
    that their covariance is the same in any directions that complete the unseen ones.
    """
    problem = plan.problem(model.scene, model.start)
    layout = problem.layout
    slots, _ = layout.of_record(0)
    changed, _ = variables.of_record(0)
    groups, counts = within(problem.groups[0], np.inf)
    chosen, scale = plan.chosen(layout), jnp.asarray(layout.scale)

    def score(d: Array, seen: Array, priors: Array) -> Array:
        z = jnp.asarray(layout.start)
        now = changed.applied(model, d)
        found = linearized(slots, now, groups, counts, plan.options, z)
        rows = jnp.concatenate([found.jacobian, priors])
        columns = (rows * scale[None]) @ seen
        inverse = cast(Array, jnp.linalg.inv(columns.T @ columns))
        covariance = seen[chosen] @ inverse @ seen[chosen].T
        if plan.criterion == "A":
            return -0.5 * jnp.log(jnp.trace(covariance) / chosen.size)
        volume = cast(Array, jnp.linalg.slogdet(covariance)[1])
        return -0.5 * volume / chosen.size

    slope = cast(Callable[..., Array], jax.jit(jax.jacfwd(score)))
    return lambda d, at: np.asarray(
        slope(jnp.asarray(d), jnp.asarray(at.seen), jnp.asarray(at.priors))
    )
