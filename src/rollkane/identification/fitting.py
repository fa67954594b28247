"""Fit: parameters of a scene from records of its motion."""

from collections.abc import Callable, Sequence
from typing import Any, cast

import numpy as np

from ..dynamics.scene import Scene, require_scene
from ..hybrid.modes import Modes
from ..kinematics.coordinates import State
from ..simulation.run_checks import check_span
from ..simulation.run_options import RunOptions
from ..validation.checks import FieldError, not_negative, whole
from .directions import not_seen
from .evaluation import Evaluation
from .experiments import Problem
from .fit_result import Fit
from .horizons import Search, followed, progressive, single
from .losses import Loss, loss_of
from .parameters import Free, Tied
from .records import Record
from .residuals import Group, with_delay_bounds
from .unit_hints import hint_of_units

STRATEGIES = ("auto", "single", "progressive")
_NOISE_ROUNDS = 10  # deviations that are estimated settle within, with outliers, too


def fit(
    scene: Scene,
    start: State | Sequence[State],
    record: Record | Sequence[Record],
    free: Free | Tied | Sequence[Free | Tied],
    *,
    modes: Modes | None = None,
    loss: str = "linear",
    strategy: str = "auto",
    starts: int = 1,
    spread: float = 0.1,
    seed: int = 0,
    rtol: float | None = None,
    atol: float | None = None,
    max_steps: int | None = None,
    max_evaluations: int = 200,
    method: str = "auto",
    progress: Callable[[int, float], None] | None = None,
) -> Fit:
    """Parameters for which the motion agrees best with records of it.

    Levenberg and Marquardt's method on exact derivatives. The model's own values are
    the first guess. A run that cannot go on counts as misfit, and is counted. What the
    guess does not show stays there until more than noise shows it.

    Args:
        scene: The model, with a guess for what is free.
        start: State at each record's ``start_time``; of several records, a list.
        record: What was measured, or a list of it.
        free: Which parameters to find, with bounds and priors.
        modes: How the contact may change in the runs.
        loss: Of misfits: ``"linear"`` (least squares), ``"huber"``, ``"soft_l1"`` or
            ``"cauchy"``, which weigh outliers less; priors are normal in all of them.
            These three bend at a channel's ``sigma``, and without one at Huber's scale
            (proposal 2), which outliers hardly move.
        strategy: ``"single"``: over whole records at once. ``"progressive"``: over
            growing horizons, for motions whose neighbours part. ``"auto"``: single
            where the guess follows the records to their end, else progressive.
        starts: How many guesses: the model's own, and random ones around it.
        spread: Standard deviation of these, relative (absolute for angles [rad]).
        seed: Of the random guesses.
        rtol: Relative tolerance of the runs; see :func:`rollkane.simulate`.
        atol: Absolute tolerance.
        max_steps: Most steps of a run.
        max_evaluations: Points tried by each search.
        method: Of the runs: ``"auto"``, ``"native"`` or ``"diffrax"``.
        progress: Hears of every point that is tried: runs so far, and chi2 there.

    Returns:
        The estimates and what is known about them.

    Raises:
        FieldError: records, parameters, bounds or priors that do not fit each other.
    """
    options = RunOptions(rtol, atol, max_steps, method)
    problem = problem_of(scene, start, record, free, modes, options)
    known = loss_of(loss)
    if strategy not in STRATEGIES:
        remedy = f"use one of {STRATEGIES}"
        raise FieldError("fit.strategy", strategy, "is not known", remedy)
    count = whole("fit.starts", starts, 1, "give how many guesses")
    most = whole("fit.max_evaluations", max_evaluations, 1, "give how many points")
    known_spread = not_negative("fit.spread", spread, "relative to the guess")
    known_seed = whole("fit.seed", seed, 0, "give a whole number")
    guesses = _guesses(problem, count, float(known_spread), known_seed)
    z0 = guesses[0]
    at = problem.evaluate(z0)
    check_usable(at)
    first = not_seen(at, problem.layout.scale)
    if not at.failed and len(first) == z0.size:
        named = tuple(e.free.path for e in problem.layout.entries)
        remedy = "free what the samples depend on, or record what depends on these"
        raise FieldError("fit.free", named, "is not seen in the records", remedy)
    hint_of_units(problem, z0)
    problem.progress = progress
    rest = known, strategy, most, first
    searches = [_search(problem, guess, *rest) for guess in guesses]
    best = min(searches, key=lambda s: s.minimum.cost)
    if any(problem.deviations):
        for _ in range(_NOISE_ROUNDS):
            if not problem.with_noise_of(best.minimum.z, known):
                break
            again = single(problem, best.minimum.z, known, most, first)
            best = _continued(best, again)
    return Fit.of(problem, best, searches, loss)


def problem_of(
    scene: object,
    start: Any,
    record: Any,
    free: Any,
    modes: Modes | None,
    options: RunOptions,
) -> Problem:
    """The records as one least-squares problem, checked; each may be one or several.

    Raises:
        FieldError: something that does not fit.
    """
    starts, records, chosen = _listed(start), _listed(record), tuple(_listed(free))
    scene = require_scene("fit.scene", scene)
    for one in records:
        if not isinstance(one, Record):
            remedy = "make it with rollkane.Record or rollkane.read_record"
            raise FieldError("fit.record", one, "must be a Record", remedy)
    if not records:
        remedy = "give a rollkane.Record, or several"
        raise FieldError("fit.record", records, "is missing", remedy)
    if len(starts) != len(records):
        given = f"{len(starts)} starts, {len(records)} records"
        remedy = "give one start for each record"
        raise FieldError("fit.start", given, "do not fit each other", remedy)
    for one in starts:
        if not isinstance(one, State):
            remedy = "make it with rollkane.place"
            raise FieldError("fit.start", one, "must be a State", remedy)
    _check_free(chosen)
    bounded = with_delay_bounds(chosen, records)
    problem = Problem(scene, starts, records, bounded, modes, options)
    for record, groups in zip(records, problem.groups, strict=True):
        latest = [_latest(group, bounded) for group in groups]
        check_span(scene, np.array([record.start_time, *latest]))
    return problem


def _listed(given: Any) -> list[Any]:
    return (
        list(cast("list[Any]", given)) if isinstance(given, (list, tuple)) else [given]
    )


def _check_free(free: tuple[object, ...]) -> None:
    for one in free:
        if not isinstance(one, (Free, Tied)):
            remedy = 'give rollkane.Free("body.inertia"), or several of them'
            raise FieldError("fit.free", one, "must be a parameter", remedy)


def check_usable(at: Evaluation) -> None:
    """Refuse a first guess whose misfits are no numbers."""
    if not at.usable:
        problem = "gives no numbers: a run or its derivatives are not finite"
        raise FieldError("fit.start", "...", problem, "begin nearer to the record")


def _latest(group: Group, free: tuple[Free | Tied, ...]) -> float:
    """The latest time of a group's run [s], with the least delay that it may have."""
    last = float(group.time[-1])
    if not group.delayed:
        return last
    (name,) = group.channels
    delay = float(group.channels[name].delay)
    bounds = [
        float(np.min(np.asarray(f.bounds[0])))
        for f in free
        if isinstance(f, Free) and f.path == f"{name}.delay" and f.bounds
    ]
    return last - min([delay, *bounds])


def _search(
    problem: Problem,
    z: np.ndarray,
    loss: Loss,
    strategy: str,
    most: int,
    first: np.ndarray,
) -> Search:
    far = strategy == "progressive"
    if strategy == "auto":
        far = followed(problem, z, least=0.0) < problem.span
    return (progressive if far else single)(problem, z, loss, most, first)


def _continued(first: Search, again: Search) -> Search:
    """A search and the one from where it ended, as one."""
    before, last = first.minimum, again.minimum
    whole = last._replace(
        evaluations=before.evaluations + last.evaluations,
        path=np.concatenate([before.path, last.path[1:]]),
    )
    return Search(whole, first.stages + again.stages[-1:], first.first)


def _guesses(
    problem: Problem, count: int, spread: float, seed: int
) -> list[np.ndarray]:
    layout = problem.layout
    random = np.random.default_rng(seed)
    found: list[np.ndarray] = [layout.start]
    for _ in range(count - 1):
        away = spread * layout.scale * random.standard_normal(layout.size)
        found.append(np.clip(layout.start + away, layout.lower, layout.upper))
    return found
