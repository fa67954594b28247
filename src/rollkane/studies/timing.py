"""One run of a scene, timed, and how far its end is from a reference.

The reference is a run in extended precision (C's long doubles, of 64 bits on most
processors), or the finest that double precision allows; how far others like it end from
it is how sure it is, and no error below that is called one.
"""

import dataclasses
import statistics
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..codegen import NoCompilerError, check_usable
from ..codegen.compile_effort import for_one_call
from ..codegen.tableau import weights_of
from ..dynamics.observables import energy, kept_energy, moving_energy
from ..dynamics.rolling import contact_of
from ..dynamics.scene import Scene
from ..geometry.numpy_rotations import product
from ..geometry.rotations import quaternion_of
from ..geometry.small_linear import norm
from ..kinematics.coordinates import State
from ..simulation.ensemble_members import members_of
from ..simulation.lane_blocks import LaneBlocks, NotForLanesError
from ..simulation.run import simulate
from ..simulation.trajectory import Trajectory
from ..validation.checks import FieldError
from ..validation.codes import Code, reason_of

PRECISIONS = {"double": jnp.float64, "single": jnp.float32}
# below these a precision only adds rounding
_LEAST_TOLERANCE = {"double": 1e-14, "single": 2e-6}
_REFERENCES = (("Dopri8", 1e-14), ("Dopri8", 1e-13), ("Tsit5", 1e-13))
# the coefficients of Dopri5 are fractions, and so known to any precision
_EXTENDED = (1e-17, 1e-16, 1e-15, 1e-14)
_EXTENDED_BITS = 64
_COARSE = 1e-9
_EXTENDED_STEPS = 1_000_000  # take 3 to 5 s
_MOST_STEPS = 4_000_000


@dataclasses.dataclass(frozen=True)
class Setting:
    """How to run a scene.

    Attributes:
        solver: Name of a diffrax solver.
        rtol: Relative tolerance of a step [1]; None with fixed steps.
        steps: Number of equal steps; None with adaptive ones.
        method: ``"native"`` or ``"diffrax"``.
        precision: ``"double"`` or ``"single"``.
        coordinates: ``"pole-free"`` or ``"voronets"``.
        formulation: ``"rolling"`` or ``"euler_lagrange"``.
    """

    solver: str
    rtol: float | None
    steps: int | None = None
    method: str = "native"
    precision: str = "double"
    coordinates: str = "pole-free"
    formulation: str = "rolling"

    @property
    def series(self) -> str:
        """The setting without its tolerance: a line of a diagram."""
        parts = [self.solver + (" fixed steps" if self.steps else ""), self.method]
        usual = {"double", "pole-free", "rolling"}
        others = (self.precision, self.coordinates, self.formulation)
        return ", ".join([*parts, *(x for x in others if x not in usual)])

    @property
    def how(self) -> str:
        """The tolerance or the number of steps, as text."""
        return f"{self.steps}" if self.rtol is None else f"{self.rtol:.0e}"

    def options(self, horizon: float) -> dict[str, Any]:
        """Keywords for ``rollkane.simulate``.

        Args:
            horizon: How long the run lasts [s]; fixed steps divide it.
        """
        options: dict[str, Any] = {
            "solver": getattr(dfx, self.solver)(),
            "method": self.method,
            "max_steps": _MOST_STEPS,
            "coordinates": self.coordinates,
            "formulation": self.formulation,
        }
        if self.steps is None:
            return options | {"rtol": self.rtol}
        return options | {
            "stepsize_controller": dfx.ConstantStepSize(),
            "dt0": horizon / self.steps,
        }


@dataclasses.dataclass(frozen=True)
class Measured:
    """One run, measured.

    Attributes:
        setting: How it ran.
        error: At the end, the largest of the following three.
        position_error: Of the body origin [m].
        rotation_error: Angle between the orientations [rad].
        alpha_error: Largest of the coordinates of what is carried [their unit].
        energy_error: Relative change of what the motion has to keep [1]; None where it
            keeps nothing.
        seconds: Of one run, median [s].
        first: Of the first run of the series, compiling included [s].
        steps: Accepted and rejected.
        evaluations: Of the right-hand side; None for implicit methods.
        code: Why the run ended, one of ``Code``; errors are NaN unless it is 0.
    """

    setting: Setting
    error: float
    position_error: float
    rotation_error: float
    alpha_error: float
    energy_error: float | None
    seconds: float
    first: float
    steps: int
    evaluations: int | None
    code: int


class Task(NamedTuple):
    """What is run."""

    name: str
    scene: Scene
    start: State
    horizon: float


def task_of(scene: Any, start: State | None, horizon: float | None) -> Task:
    """A scene with start and horizon, or a scene file that brings them, checked."""
    name = "scene"
    if not isinstance(scene, Scene) and hasattr(scene, "times"):
        if scene.modes is not None:
            remedy = "leave its [modes] out"
            problem = "changes its contact, which is not measured"
            raise FieldError("work_precision.scene", scene.name, problem, remedy)
        name = scene.name
        start = scene.start if start is None else start
        horizon = float(scene.times[-1]) if horizon is None else horizon
        scene = scene.scene
    for field, value, kind in (("scene", scene, Scene), ("start", start, State)):
        if not isinstance(value, kind):
            remedy = "give a scene file, or a Scene, a State and a horizon"
            problem = f"is no {kind.__name__}"
            raise FieldError(f"work_precision.{field}", value, problem, remedy)
    if not (isinstance(horizon, (int, float, np.number)) and 0 < horizon < np.inf):
        remedy = "give how long runs last, in seconds"
        problem = "must be a positive number"
        raise FieldError("work_precision.horizon", horizon, problem, remedy)
    assert isinstance(start, State)
    return Task(name, scene, start, float(horizon))


def unfit(setting: Setting) -> str:
    """Why a setting is not even tried; "" if it is."""
    if setting.rtol is not None:
        least = _LEAST_TOLERANCE[setting.precision]
        if setting.rtol < 0.99 * least:
            return f"tolerances below {least:.0e} only add rounding"
    if setting.method == "native":
        if setting.steps is not None:
            return "the native loop has no fixed steps"
        return without_native()
    return ""


def without_native() -> str:
    """Why there is no native loop on this machine; "" if there is."""
    try:
        check_usable()
    except NoCompilerError as error:
        return str(error)
    return ""


class _End(NamedTuple):
    """Where a run ended."""

    position: np.ndarray
    orientation: np.ndarray
    alpha: np.ndarray


class Reference(NamedTuple):
    """The finest run, and how sure it is."""

    end: _End
    certainty: float
    text: str
    method: str


def reference_of(task: Task) -> Reference:
    """The finest runs: in extended precision, or by two methods in double."""
    method = "diffrax" if without_native() else "native"
    try:
        coarse = _run(task, Setting("Dopri5", _COARSE, None, method))
    except FieldError:
        method, runs = "diffrax", []
    else:
        runs = _extended(task, int(coarse.steps)) if coarse.succeeded else []
    runs = runs or [
        (f"{solver} at {rtol:.0e}", _run(task, Setting(solver, rtol, None, method)))
        for solver, rtol in _REFERENCES
    ]
    for name, run in runs:
        if int(run.code) != Code.COMPLETED:
            raise FieldError(
                "work_precision.scene",
                task.name,
                f"has no reference: {name} ended at "
                f"t = {float(run.final_time):.6g} s ({reason_of(run.code)})",
                "shorten the horizon",
            )
    ends = [_end_of(run) for _, run in runs]
    apart = [max(_differences(ends[0], end)) for end in ends[1:]]
    # ends are compared in double precision, however they were found
    rounding = np.finfo(float).eps * max(1.0, *map(abs, ends[0].position))
    text = " and ".join(name for name, _ in runs)
    return Reference(ends[0], max(rounding, *apart), text, method)


def _extended(task: Task, steps: int) -> list[tuple[str, Trajectory]]:
    """Runs with C's long doubles; none where they are doubles, or would take long.

    Args:
        task: What to run.
        steps: That Dopri5 takes at the coarse tolerance, from which those at a finer
            one follow by its order.
    """
    bits = np.finfo(np.longdouble).nmant + 1
    within = [r for r in _EXTENDED if steps * (_COARSE / r) ** 0.2 <= _EXTENDED_STEPS]
    fine = next(iter(within), None)
    if bits < _EXTENDED_BITS or fine is None:
        return []
    tolerances = fine, 10.0 * fine
    scene, start = task.scene, task.start
    times = np.array([0.0, task.horizon])
    members = members_of(scene, jax.tree.map(_alone, start), 1)
    how = None, dfx.Dopri5(), _MOST_STEPS
    try:
        loops = [
            LaneBlocks(members, times, rtol, *how, extended=True) for rtol in tolerances
        ]
    except NotForLanesError:
        return []

    def at_once(loop: LaneBlocks) -> tuple[np.ndarray, Any]:
        return loop.run(*members.block(0, 1), 1, 1)

    with ThreadPoolExecutor() as pool:
        found = list(pool.map(at_once, loops))
    runs: list[tuple[str, Trajectory]] = []
    for loop, rtol, (y, out) in zip(loops, tolerances, found, strict=True):
        every = loop.states(y), out.code, out.final_time, loop.states(out.final_y)
        state, code, *ended = jax.tree.map(_first, every)
        counts = out.steps[0], out.rejected_steps[0]
        parts: Any = times, state, scene, code, *ended, *counts
        run = Trajectory(*parts)
        runs.append((f"Dopri5 at {rtol:.0e} in {bits} bits", run))
    return runs


def _alone(x: Any) -> np.ndarray:
    """An array of one member."""
    return np.asarray(x)[None]


def _first(x: Any) -> Any:
    return x[0]


def _run(task: Task, setting: Setting) -> Trajectory:
    return _ready(task, setting)()


def _ready(task: Task, setting: Setting) -> Callable[[], Trajectory]:
    """A run with everything at hand that a program would have."""
    dtype = PRECISIONS[setting.precision]

    def converted(x: Any) -> Any:
        return x.astype(dtype) if eqx.is_inexact_array(x) else x

    scene, start = jax.tree.map(converted, (task.scene, task.start))
    times = np.array([0.0, task.horizon])
    options = setting.options(task.horizon)

    def run() -> Trajectory:
        result = simulate(scene, start, times, **options)
        jax.block_until_ready(result.final_state)
        return result

    return run


def _end_of(run: Trajectory) -> _End:
    pose = _pose(run.scene, jnp.asarray(run.final_time), run.final_state)
    return _End(*(np.asarray(x, float) for x in pose))


@for_one_call
def _pose(scene: Scene, t: Any, state: Any) -> tuple[Any, Any, Any]:
    contact = contact_of(scene, t, state)
    quaternion = contact.orientation
    if quaternion is None:
        quaternion = quaternion_of(contact.rotation)
    return contact.position, quaternion / norm(quaternion), state.alpha


def _differences(a: _End, b: _End) -> tuple[float, float, float]:
    """Of positions [m], orientations [rad] and carried coordinates."""
    between = product(a.orientation * [1.0, -1.0, -1.0, -1.0], b.orientation)
    angle = 2.0 * np.arctan2(np.linalg.norm(between[1:]), abs(between[0]))
    carried = np.abs(a.alpha - b.alpha)
    return (
        float(np.linalg.norm(a.position - b.position)),
        float(angle),
        float(carried.max()) if carried.size else 0.0,
    )


def measured(
    task: Task,
    setting: Setting,
    reference: Reference,
    repeats: int,
    first: dict[str, float],
) -> Measured:
    """One setting, run and timed."""
    ready = _ready(task, setting)
    began = time.perf_counter()
    run = ready()
    first.setdefault(setting.series, time.perf_counter() - began)
    spans: list[float] = []
    for _ in range(repeats):
        began = time.perf_counter()
        ready()
        spans.append(time.perf_counter() - began)
    code = int(run.code)
    errors = (np.nan,) * 3 if code else _differences(_end_of(run), reference.end)
    tried = int(run.steps + run.rejected_steps)
    return Measured(
        setting,
        float(np.max(errors)),
        *errors,
        energy_error=None if code else _energy_error(run, task),
        seconds=statistics.median(spans),
        first=first[setting.series],
        steps=tried,
        evaluations=_evaluations(setting, tried),
        code=code,
    )


def _evaluations(setting: Setting, tried: int) -> int | None:
    """Of the right-hand side: a step's last stage is the first of the next."""
    try:
        weights = weights_of(getattr(dfx, setting.solver)(), "a count")
    except FieldError:
        return None
    return 1 + tried * len(weights.rows)


def _energy_error(run: Trajectory, task: Task) -> float | None:
    kept = kept_energy(task.scene)
    if not kept:
        return None
    of = _moving_energy if kept == "moving energy" else _energy
    before = float(of(task.scene, jnp.zeros(()), task.start))
    after = float(of(run.scene, jnp.asarray(run.final_time), run.final_state))
    return abs(after - before) / (abs(before) or 1.0)


_energy, _moving_energy = for_one_call(energy), for_one_call(moving_energy)
