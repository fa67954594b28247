"""Lyapunov exponents of a motion: how fast small changes of its start grow.

Tangent vectors of the states that the contact allows are carried along the run and
made orthonormal again by QR after every piece of it (Benettin, Galgani, Giorgilli and
Strelcyn, 1980), in an orthonormal basis of the tangent space: rounding out of that
space would in time hide the exponents below zero.
"""

import dataclasses
import functools
from collections.abc import Callable
from os import PathLike
from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..codegen.compile_effort import around_a_loop
from ..dynamics.scene import Scene
from ..integration.integrate import tolerances
from ..kinematics.coordinates import State
from ..simulation.run_checks import check_span
from ..simulation.run_options import RunOptions
from ..validation.checks import FieldError, is_traced, positive, real, whole
from ..validation.codes import Code, reason_of
from .independent_coordinates import IndependentCoordinates, independent_coordinates
from .neutral import neutral
from .symmetries import symmetries_at
from .variational import carried, frame

# The horizon in equal batches; exponents are of its second half, 32 of them.
_BATCHES = 64
# Bounds of Student's distribution at 97.5 %, of means of 8 and 16 batches: fewer see
# slower changes, more are surer of fast ones.
_STUDENT = {8: 2.365, 16: 2.131}
# A batch is made of at most so many pieces.
_MOST_PIECES = 1 << 16


@dataclasses.dataclass(frozen=True, eq=False)
class LyapunovSpectrum:
    """Lyapunov exponents of a motion, in falling order.

    Attributes:
        values: Mean growth rates over the second half of the horizon [1/s], shape
            (k,).
        errors: Of the values [1/s], shape (k,), about two standard deviations: the
            largest of what means of 8 and of 16 batches scatter, and of twice the
            change of the mean from the quarter before, which is more than the value
            where growth is a power of time (as of a regular motion's zeros); and one
            e-fold of growth, which depends on how states are measured.
        time: Ends of the batches [s], shape (64,).
        growth: Logarithms of all growth up to there [1], shape (64, k): its slope
            against ``time`` is what converges to the values.
        dimension: Number n of independent coordinates and velocities: of all
            exponents.
        pieces: After how many pieces of the run in all QR was made.
        states: At these times, every array with a leading 64.
        around: Independent coordinates around the start.
    """

    values: np.ndarray
    errors: np.ndarray
    time: np.ndarray
    growth: np.ndarray
    dimension: int
    pieces: int
    states: State
    around: IndependentCoordinates

    @functools.cached_property
    def zeros(self) -> tuple[str, ...]:
        """Names of exponents that are zero [1/s] for a known reason.

        The flow where nothing depends on time, symmetries of the scene, an energy that
        is kept; as many as are independent at the start. Symmetries hold near all of
        ``states``.
        """
        first, begin = self.around.reference, np.asarray(self.around.time)
        join: Callable[[Any, Any], Any] = lambda a, b: np.concatenate([a[None], b])
        visited = jax.tree.map(join, first, self.states)
        group = symmetries_at(self.around.scene, np.append(begin, self.time), visited)
        return neutral(self.around, group).all_names

    @property
    def sum(self) -> float:
        """Sum of the exponents [1/s]: the mean divergence, where all are there."""
        return float(np.sum(self.values))

    @property
    def chaotic(self) -> bool:
        """Whether the largest exponent is above zero by more than its error."""
        return bool(self.values[0] > self.errors[0])

    def __str__(self) -> str:
        """A table."""
        rows = zip(self.values, self.errors, strict=True)
        return "\n".join(f"{x:12.5g} +- {e:.2g} 1/s" for x, e in rows)

    def plot(self, path: str | PathLike[str] | None = None, title: str = "") -> Any:
        """Draw growth and exponents (extra ``plot``).

        Args:
            path: File to write, .png, .svg or .pdf; None for none.
            title: Above the figure.

        Returns:
            The matplotlib figure, or None where a file was written.
        """
        from ..pictures.plot_spectra import plot_lyapunov

        return plot_lyapunov(self, path, title)


class _Batch(NamedTuple):
    """After a batch of pieces.

    Attributes:
        state: Where the run is.
        frame: Orthonormal tangents in the basis of the tangent space, shape (n, k).
        growth: Logarithms of their growth in the batch [1], shape (k,).
        spread: Largest ratio of growths in a piece, as its logarithm [1].
        code: Why the run ended.
        time: When the first piece that failed began, or the end [s].
    """

    state: State
    frame: Float[Array, "n k"]
    growth: Float[Array, " k"]
    spread: Float[Array, ""]
    code: Int[Array, ""]
    time: Float[Array, ""]


def lyapunov_exponents(
    scene: Scene,
    start: State,
    horizon: Any,
    *,
    interval: Any = None,
    count: int | None = None,
    start_time: Any = 0.0,
    rtol: float | None = None,
    atol: float | None = None,
    max_steps: int | None = None,
    method: str = "auto",
) -> LyapunovSpectrum:
    """Lyapunov exponents of the motion from a start, with an estimate of their errors.

    Args:
        scene: What rolls on what, under which loads.
        start: State at the start time, from :func:`rollkane.place`.
        horizon: How long the motion is followed [s]: its first half aligns the
            tangents, its second half gives the exponents.
        interval: Longest time between two orthonormalizations [s]; a
            sixty-fourth of the horizon when left out. It is halved wherever tangents
            part too far for the tolerance.
        count: How many, from the largest; all when left out.
        start_time: [s].
        rtol: Relative tolerance of a step [1], as of :func:`rollkane.simulate`.
        atol: Absolute tolerance of a step [unit of the state].
        max_steps: Most steps in a piece.
        method: ``"auto"``, ``"native"`` or ``"diffrax"``.

    Returns:
        The spectrum. Its errors are those of a finite time on this one motion; a
        motion that changes its kind later (transient chaos) is not foreseen.

    Raises:
        FieldError: a state or numbers that cannot be used; a run that ends before the
            horizon; tangents that part too fast.
    """
    if is_traced(scene, start, horizon):
        problem = "is traced, and the pieces of the run depend on its numbers"
        remedy = "call it outside of jit, vmap and derivatives"
        raise FieldError("lyapunov_exponents.start", "...", problem, remedy)
    field = "lyapunov_exponents"
    horizon = float(positive(f"{field}.horizon", horizon, (), "a time [s]"))
    begin = float(real(f"{field}.start_time", start_time, (), "a time [s]"))
    around = independent_coordinates(scene, start, begin)
    n = around.count
    count = n if count is None else whole(f"{field}.count", count, 1, f"give 1 to {n}")
    if count > n:
        problem = f"is more than the {n} independent coordinates and velocities"
        raise FieldError(f"{field}.count", count, problem, f"give 1 to {n}")
    if interval is not None:
        interval = float(positive(f"{field}.interval", interval, (), "a time [s]"))
    check_span(scene, np.asarray([begin, begin + horizon]))
    options = RunOptions(rtol, atol, max_steps, method)
    return _spectrum(around, horizon, interval, count, options)


def _spectrum(
    around: IndependentCoordinates,
    horizon: float,
    interval: float | None,
    count: int,
    options: RunOptions,
) -> LyapunovSpectrum:
    begin, state = float(around.time), around.reference
    dtype = state.orientation.dtype
    rtol = float(tolerances(options.rtol, options.atol, dtype)[0])
    widest = -0.5 * np.log(rtol)  # least growths are known to the root of rtol
    length = horizon / _BATCHES
    fewest = 1 if interval is None else max(1, int(np.ceil(length / interval)))
    pieces = fewest
    frames = jnp.asarray(_generic(around.count, count), dtype)
    found: list[np.ndarray] = []
    states: list[State] = []
    total = 0
    for k in range(_BATCHES):
        t = begin + k * length
        while True:
            _refuse_pieces(pieces, t, widest)
            batch = _batch(
                around.scene,
                jnp.asarray(t, dtype),
                state,
                frames,
                jnp.asarray(length / pieces, dtype),
                jnp.asarray(pieces),
                options,
            )
            if int(batch.code) != Code.COMPLETED:
                _refuse_end(horizon, float(batch.time), int(batch.code))
            if float(batch.spread) <= widest:  # not where tangents overflow
                break
            pieces *= 2
        state, frames, total = batch.state, batch.frame, total + pieces
        found.append(np.asarray(batch.growth, float))
        states.append(state)
        if float(batch.spread) < 0.25 * widest:
            pieces = max(fewest, pieces // 2)
    time = begin + length * np.arange(1, _BATCHES + 1)
    rates = np.stack(found) / length
    values, errors = _estimates(rates, horizon)
    order = np.argsort(-values, kind="stable")
    growth = np.cumsum(np.stack(found), axis=0)[:, order]
    known = values[order], errors[order], time, growth, around.count, total
    stacked: Any = jax.tree.map(lambda *leaves: jnp.stack(leaves), *states)
    return LyapunovSpectrum(*known, stacked, around)


def _generic(n: int, k: int) -> np.ndarray:
    """Orthonormal columns along no special direction, the same in every call."""
    square = np.random.default_rng(0).standard_normal((n, n))
    return np.linalg.qr(square)[0][:, :k]


def _estimates(rates: np.ndarray, horizon: float) -> tuple[np.ndarray, np.ndarray]:
    """Values and errors from the rates of growth in equal batches."""
    half, quarter = _BATCHES // 2, _BATCHES // 4
    late = rates[half:]
    values = late.mean(axis=0)
    scatter = [student * _of_means(late, count) for count, student in _STUDENT.items()]
    trend = 2.0 * np.abs(values - rates[quarter:half].mean(axis=0))
    errors = np.max([*scatter, trend], axis=0) + 2.0 / horizon
    return values, errors


def _of_means(rates: np.ndarray, count: int) -> np.ndarray:
    """Standard error of the mean, from means of so many batches."""
    means = rates.reshape(count, -1, rates.shape[1]).mean(axis=1)
    return means.std(axis=0, ddof=1) / np.sqrt(count)


def _refuse_pieces(pieces: int, t: float, widest: float) -> None:
    if pieces > _MOST_PIECES:
        problem = (
            f"cannot be short enough: at t = {t:g} s tangents part by more than "
            f"e^{widest:.0f} within the shortest piece"
        )
        remedy = "give a smaller rtol, fewer exponents (count), or a shorter horizon"
        raise FieldError("lyapunov_exponents.interval", "...", problem, remedy)


def _refuse_end(horizon: float, t: float, code: int) -> None:
    problem = f"is not reached: the run ends soon after t = {t:g} s ({reason_of(code)})"
    remedy = "shorten it, or choose another start"
    raise FieldError("lyapunov_exponents.horizon", horizon, problem, remedy)


def _followed(
    scene: Scene,
    t: Float[Array, ""],
    state: State,
    tangents: Float[Array, "n k"],
    step: Float[Array, ""],
    pieces: Int[Array, ""],
    options: RunOptions,
) -> _Batch:
    """So many pieces of a run, with QR of its tangents after each."""

    def onward(i: Array, so_far: _Batch) -> _Batch:
        begun = t + i.astype(step.dtype) * step
        here = IndependentCoordinates(scene, begun, so_far.state)
        changes = cast(Array, jnp.linalg.solve(frame(here), so_far.frame))
        moved = carried(here, changes, step, options)
        there = IndependentCoordinates(scene, begun + step, moved.state)
        both: Any = jnp.linalg.qr(frame(there) @ moved.changes)
        turned, upper = cast(tuple[Array, Array], both)
        grown = jnp.log(jnp.abs(cast(Array, jnp.diagonal(upper))))
        spread = jnp.maximum(jnp.max(grown), 0.0) - jnp.minimum(jnp.min(grown), 0.0)
        good = so_far.code == Code.COMPLETED
        return _Batch(
            state=moved.state,
            frame=turned,
            growth=so_far.growth + grown,
            spread=jnp.maximum(so_far.spread, spread),
            code=jnp.where(good, moved.code, so_far.code),
            time=jnp.where(good, begun, so_far.time),
        )

    zero = jnp.zeros_like(tangents[0])
    code = jnp.asarray(Code.COMPLETED)
    begun = _Batch(state, tangents, zero, zero[0], code, t)
    return cast(_Batch, jax.lax.fori_loop(0, pieces, onward, begun))


_batch = around_a_loop(_followed)
