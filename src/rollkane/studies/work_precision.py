"""What accuracy costs in time: measured for a scene, solver by solver."""

import dataclasses
import json
from collections.abc import Callable, Iterable, Sequence
from typing import Any, cast

import diffrax as dfx
import numpy as np

from ..kinematics.coordinates import State
from ..validation.checks import FieldError
from ..validation.codes import reason_of
from .timing import (
    PRECISIONS,
    Measured,
    Setting,
    measured,
    reference_of,
    task_of,
    unfit,
    without_native,
)

SOLVERS = ("Tsit5", "Dopri5", "Dopri8")
TOLERANCES = tuple(10.0**-k for k in range(3, 13))
_METHODS = ("native", "diffrax")

Progress = Callable[[int, int, str], None]


@dataclasses.dataclass(frozen=True)
class WorkPrecision:
    """A scene's cost of accuracy.

    Where ``failure`` says something, no run reached the end: there is nothing to
    compare, to draw or to recommend.

    Attributes:
        name: Of the scene.
        horizon: How long the runs last [s].
        certainty: How far apart the finest runs end: errors below it are unknown.
        reference: What those runs were.
        rows: One for each run.
        skipped: Settings that could not run, with the reason.
    """

    name: str
    horizon: float
    certainty: float
    reference: str
    rows: tuple[Measured, ...]
    skipped: tuple[tuple[Setting, str], ...]

    @property
    def failure(self) -> str:
        """Why no setting worked, as a sentence; "" if one did."""
        if any(row.code == 0 for row in self.rows):
            return ""
        reasons = [f"{setting.series}: {why}" for setting, why in self.skipped]
        reasons += [f"{r.setting.series}: {reason_of(r.code)}" for r in self.rows]
        reasons = list(dict.fromkeys(reasons)) or ["none was asked for"]
        return f"no setting worked ({'; '.join(reasons)})"

    def recommend(self, error: float = 1e-6) -> Measured:
        """The fastest of the measured runs that meets an end error.

        Args:
            error: Largest of position [m], rotation [rad] and carried coordinates.

        Raises:
            FieldError: none does, or nobody can know.
        """
        return _fastest(self.rows, error, self.certainty)

    def table(self) -> str:
        """All runs as text."""
        head = f"{'solver':<34}{'rtol':>8}{'error':>10}{'energy':>10}{'ms':>10}"
        lines = [head + f"{'steps':>9}{'evaluations':>13}{'first s':>9}"]
        for row in self.rows:
            sure = "<" if row.error < self.certainty else ""
            error = f"{sure}{max(row.error, self.certainty):.1e}"
            kept = "-" if row.energy_error is None else f"{row.energy_error:.1e}"
            calls = "-" if row.evaluations is None else f"{row.evaluations}"
            if row.code:
                error = "ended"
            lines.append(
                f"{row.setting.series:<34}{row.setting.how:>8}{error:>10}{kept:>10}"
                f"{1e3 * row.seconds:>10.3f}{row.steps:>9}{calls:>13}{row.first:>9.2f}"
            )
        lines += [f"skipped: {s.series}: {why}" for s, why in self.skipped]
        return "\n".join(lines)

    def to_json(self) -> str:
        """Everything as JSON; what is not a number is null."""
        return json.dumps(_plain(dataclasses.asdict(self)), indent=1, allow_nan=False)

    def plot(self, path: Any = None, title: str = "") -> Any:
        """Draw error and energy error against time (extra ``plot``).

        Args:
            path: File to write, .png, .svg or .pdf; None for none.
            title: Above the figure; the scene's name by default.

        Returns:
            The matplotlib figure, or None where a file was written.

        Raises:
            FieldError: no setting worked.
        """
        if self.failure:
            remedy = "give other settings, or a shorter horizon"
            raise FieldError("WorkPrecision.rows", (), self.failure, remedy)
        from ..pictures import plot_precision

        if path is None:
            return plot_precision.figure_work_precision(self, title or self.name)
        return plot_precision.plot_work_precision(self, path, title or self.name)


def work_precision(
    scene: Any,
    start: State | None = None,
    horizon: float | None = None,
    *,
    solvers: tuple[str, ...] = SOLVERS,
    tolerances: tuple[float, ...] = TOLERANCES,
    steps: tuple[int, ...] = (),
    methods: tuple[str, ...] = _METHODS,
    precisions: tuple[str, ...] = ("double",),
    coordinates: tuple[str, ...] = ("pole-free",),
    formulations: tuple[str, ...] = ("rolling",),
    repeats: int = 5,
    progress: Progress | None = None,
) -> WorkPrecision:
    """Measure what accuracy costs in time.

    Every combination is run; those that do not exist (fixed steps or single precision's
    smallest tolerances, for example) are listed as skipped.

    Args:
        scene: Scene, or a scene file (``rollkane.files.scene_files.load_scene``), which
            brings start and horizon.
        start: State at time 0.
        horizon: How long runs last [s].
        solvers: Names of diffrax solvers.
        tolerances: Relative tolerances of a step [1].
        steps: Numbers of equal steps, for runs of fixed steps.
        methods: ``"native"``, ``"diffrax"``.
        precisions: ``"double"``, ``"single"``.
        coordinates: ``"pole-free"``, ``"voronets"``.
        formulations: ``"rolling"``, ``"euler_lagrange"``.
        repeats: Timed runs of each setting, of which the median is kept.
        progress: ``progress(done, of, what)``, called before every setting.

    Returns:
        The measurements.

    Raises:
        FieldError: bad input, or a scene whose reference cannot be made.
    """
    task = task_of(scene, start, horizon)
    _check_choices(solvers, methods, precisions, coordinates, formulations)
    settings = [
        Setting(solver, rtol, count, method, precision, chart, form)
        for solver in solvers
        for method in methods
        for precision in precisions
        for chart in coordinates
        for form in formulations
        for rtol, count in [
            *((r, None) for r in tolerances),
            *((None, n) for n in steps),
        ]
    ]
    reference = reference_of(task)
    rows: list[Measured] = []
    first: dict[str, float] = {}
    skipped: dict[tuple[str, str], Setting] = {}
    for done, setting in enumerate(settings):
        if progress is not None:
            progress(done, len(settings), setting.series)
        why = unfit(setting)
        try:
            if not why:
                rows.append(measured(task, setting, reference, repeats, first))
        except FieldError as error:
            why = str(error)
        if why:
            skipped.setdefault((setting.series, why), setting)
    if progress is not None:
        progress(len(settings), len(settings), "done")
    return WorkPrecision(
        task.name,
        task.horizon,
        reference.certainty,
        reference.text,
        tuple(rows),
        tuple((setting, why) for (_, why), setting in skipped.items()),
    )


def recommend(
    scene: Any,
    start: State | None = None,
    horizon: float | None = None,
    *,
    error: float = 1e-6,
    solvers: tuple[str, ...] = SOLVERS,
    method: str = "auto",
    repeats: int = 5,
) -> Measured:
    """Solver and tolerance that meet an end error at the least time, as measured.

    ``rk.simulate(scene, start, times, **found.setting.options(horizon))`` uses them.

    Args:
        scene: Scene, or a scene file, which brings start and horizon.
        start: State at time 0.
        horizon: How long the run lasts [s].
        error: Asked of the end: the largest of position [m], rotation [rad] and
            coordinates of what is carried.
        solvers: Names of diffrax solvers to choose from.
        method: ``"native"``, ``"diffrax"`` or ``"auto"``: native where it can.
        repeats: Timed runs of each setting.

    Returns:
        The measurement that was best; its ``setting`` is the recommendation.

    Raises:
        FieldError: nothing meets the error, or it is below what can be known.
    """
    task = task_of(scene, start, horizon)
    _check_choices(solvers, () if method == "auto" else (method,))
    why = without_native() if method == "native" else ""
    if why:
        raise FieldError(
            "recommend.method", method, f"cannot run here: {why}", 'give "auto"'
        )
    reference = reference_of(task)
    if method == "auto":
        method = reference.method
    rows: list[Measured] = []
    first: dict[str, float] = {}
    for solver in solvers:
        for rtol in (*TOLERANCES, 1e-13, 1e-14):
            setting = Setting(solver, rtol, None, method)
            row = measured(task, setting, reference, repeats, first)
            rows.append(row)
            if row.error + reference.certainty <= error:
                break
    return _fastest(tuple(rows), error, reference.certainty)


def _check_choices(
    solvers: Iterable[str],
    methods: Iterable[str] = (),
    precisions: Iterable[str] = (),
    coordinates: Iterable[str] = (),
    formulations: Iterable[str] = (),
) -> None:
    """Refuse names that nobody knows, before anything runs."""
    for solver in solvers:
        known = isinstance(getattr(dfx, solver, None), type)
        if not (known and issubclass(getattr(dfx, solver), dfx.AbstractSolver)):
            remedy = "give names such as Tsit5, Dopri8 or Kvaerno5"
            raise FieldError(
                "work_precision.solvers", solver, "is no solver of diffrax", remedy
            )
    for field, names, all_names in (
        ("methods", methods, _METHODS),
        ("precisions", precisions, tuple(PRECISIONS)),
        ("coordinates", coordinates, ("pole-free", "voronets")),
        ("formulations", formulations, ("rolling", "euler_lagrange")),
    ):
        for name in names:
            if name not in all_names:
                raise FieldError(
                    f"work_precision.{field}",
                    name,
                    "is not known",
                    f"use some of {all_names}",
                )


def _fastest(rows: tuple[Measured, ...], error: object, certainty: float) -> Measured:
    if not (isinstance(error, (int, float, np.number)) and error > 0):
        raise FieldError(
            "recommend.error", error, "must be a positive number", "give 1e-6"
        )
    if certainty > error:
        raise FieldError(
            "recommend.error",
            error,
            f"is below what is known of this motion's end, {certainty:.1e}",
            "ask for less, or shorten the horizon",
        )
    good = [row for row in rows if row.code == 0 and row.error + certainty <= error]
    if not good:
        best = min((row.error for row in rows if row.code == 0), default=np.inf)
        raise FieldError(
            "recommend.error",
            error,
            f"is met by no setting that was tried; the best had {best:.1e}",
            "allow smaller tolerances or other solvers, or ask for less",
        )
    return min(good, key=lambda row: row.seconds)


def _plain(x: Any) -> Any:
    """What JSON can hold."""
    if isinstance(x, dict):
        return {k: _plain(v) for k, v in cast(dict[str, Any], x).items()}
    if isinstance(x, (list, tuple)):
        return [_plain(v) for v in cast(Sequence[Any], x)]
    if isinstance(x, float) and not np.isfinite(x):
        return None
    return x
