"""Relative periodic motions: those that repeat, up to a symmetry of the scene."""

import dataclasses
from collections.abc import Mapping
from os import PathLike
from typing import Any

import jax.numpy as jnp
import numpy as np

from ..dynamics.scene import Scene
from ..kinematics.coordinates import State
from ..simulation.run import simulate
from ..simulation.run_options import RunOptions
from ..simulation.trajectory import Trajectory
from ..validation.checks import FieldError, is_traced, positive, real, whole
from .closing_newton import PERIOD, Held, Solved, coordinates_of, scales, solve
from .first_nodes import first_nodes
from .floquet import Floquet, floquet
from .independent_coordinates import independent_coordinates
from .kept_symmetries import LostSymmetry
from .orbit_symmetries import (
    orbit,
    refuse_strays,
    relative_orbit,
    verified_near,
)
from .periodic_holds import check_invariant, held_of
from .quantities import NAMED
from .repetition import check_repeats
from .shooting import Nodes, Shooting, measured
from .symmetries import symmetries

_FIELD = "periodic_motion"
# Tolerance of shooting: Newton's method ends where runs end to be repeatable.
_RTOL = 1e-12
# A run's error over its tolerance, at most, in what counts as closed.
_ERRORS = 1e4
# A motion that goes less far in a period, in changes of like size, is a steady one.
_STEADY = 1e-7
# Error of a monodromy, over its size, with which no multiplier would be told.
_WRONG = 1e-4


@dataclasses.dataclass(frozen=True, eq=False)
class PeriodicMotion:
    """A motion that repeats after a period, moved by a symmetry.

    Attributes:
        state: At its beginning.
        period: T [s].
        group: Displacement of each symmetry in a period [m] or [rad], by name.
        multipliers: Floquet multipliers that tell stability [1], shape (p,), complex,
            in falling modulus: without those of the flow, of symmetries, of an energy
            and of the family.
        expected: Names of the others, as many as there are.
        expected_multipliers: Those [1], complex; of modulus one.
        monodromy: Derivative of the return, moved back by the symmetry, in independent
            coordinates around the state, shape (n, n).
        miss: How far the motion is from closing, in changes of like size [1].
        time: Of the beginning [s].
        nodes: States at the beginnings of the segments.
        shooting: What was shot.
        uncertain: How far rounding may have moved each multiplier [1], shape (p,).
        held: What was held.
    """

    state: State
    period: float
    group: dict[str, float]
    multipliers: np.ndarray
    expected: tuple[str, ...]
    expected_multipliers: np.ndarray
    monodromy: np.ndarray
    miss: float
    time: float
    nodes: tuple[State, ...]
    shooting: Shooting
    uncertain: np.ndarray
    held: tuple[Held, ...]

    @property
    def scene(self) -> Scene:
        """What rolls on what."""
        return self.shooting.scene

    @property
    def stable(self) -> bool:
        """Whether no multiplier is outside of the unit circle, up to rounding.

        Spectral stability: to first order, modulo flow, symmetries and family.
        """
        return not bool(np.any(self.outside))

    @property
    def outside(self) -> np.ndarray:
        """Which multipliers are outside of the unit circle beyond rounding, (p,)."""
        return np.abs(self.multipliers) - 1.0 > 2.0 * self.uncertain

    @property
    def volume_ratio(self) -> float:
        """Product of all multipliers [1]: how a small volume of states has grown.

        One where the motion keeps a measure; else the exponential of the integral of
        the divergence.
        """
        return float(np.linalg.det(self.monodromy))

    @property
    def energy(self) -> float:
        """Kinetic plus potential energy at the beginning [J]."""
        return self.measure("energy")

    def measure(self, name: str) -> float:
        """A quantity that can be held, by name, at the beginning [its unit].

        Args:
            name: ``"period"``, ``"energy"`` and the like, a symmetry's, or of what was
                held.

        Raises:
            FieldError: another name.
        """
        if name == PERIOD:
            return self.period
        if name in self.group:
            return self.group[name]
        quantity: Any = NAMED.get(name)
        for one in self.held:
            quantity = one.quantity if one.name == name else quantity
        if quantity is None:
            known = ", ".join(repr(x) for x in (PERIOD, *NAMED, *self.group))
            remedy = f"there are {known}"
            raise FieldError("PeriodicMotion.measure", name, "is not known", remedy)
        t = jnp.asarray(self.time, self.state.orientation.dtype)
        return float(measured(quantity, self.scene, t, self.state)[0])

    def trajectory(self, count: int = 201, periods: float = 1.0) -> Trajectory:
        """The motion, from its beginning [s].

        Args:
            count: Outputs.
            periods: How long, in periods.
        """
        times = self.time + np.linspace(0.0, periods * self.period, count)
        return simulate(self.scene, self.state, times, rtol=1e-11)

    def __str__(self) -> str:
        """What repeats, and how stably."""
        group = ", ".join(f"{k} {v:.6g}" for k, v in self.group.items()) or "none"
        listed = ", ".join(f"{m:.6g}" for m in self.multipliers) or "none"
        kind = "stable" if self.stable else "unstable"
        return (
            f"period {self.period:.9g} s, {kind}\ngroup: {group}\n"
            f"multipliers: {listed}\nexpected: {', '.join(self.expected)}"
        )

    def plot(self, path: str | PathLike[str] | None = None, title: str = "") -> Any:
        """Draw Floquet multipliers (extra ``plot``).

        Args:
            path: File to write, .png, .svg or .pdf; None for none.
            title: Above the figure.

        Returns:
            The matplotlib figure, or None where a file was written.
        """
        from ..pictures.plot_spectra import plot_periodic

        return plot_periodic(self, path, title)


def periodic_motion(
    scene: Scene,
    guess: State,
    period: Any,
    *,
    hold: Mapping[str, Any] | None = None,
    segments: int = 1,
    start_time: Any = 0.0,
    rtol: float | None = None,
    atol: float | None = None,
    max_steps: int | None = None,
    method: str = "auto",
) -> PeriodicMotion:
    """A relative periodic motion near a guess, and its Floquet multipliers.

    ``Phi_T(y) = g(xi) y`` for the state y, the period T and the displacement xi of the
    scene's symmetries, by Newton's method and shooting with exact derivatives. Of a
    family the motion nearest to the guess is found, or the one that ``hold`` names.

    Args:
        scene: What rolls on what, under which loads.
        guess: State near the motion, from :func:`rollkane.place`.
        period: About T [s]. Of a scene that depends on time, T itself, after which it
            has to repeat.
        hold: What is to have a value, by name: ``"period"`` [s], ``"energy"`` [J] and
            other quantities that :func:`rollkane.steady_motion` holds, at the motion's
            beginning; a symmetry's displacement; a number of the state; or of any name
            a pair of a function of scene, time and state, and its value. None: as in
            the guess.
        segments: Runs that a period is made of; more where the motion is so unstable
            that one run does not come back.
        start_time: Of the state [s].
        rtol: Relative tolerance of a step [1]; 1e-12 by default.
        atol: Absolute tolerance of a step [unit of the state].
        max_steps: Most steps in a segment.
        method: ``"auto"``, ``"native"`` or ``"diffrax"``.

    Raises:
        FieldError: no periodic motion near the guess, with what was left of the misses
            and the rank of the equations; a steady motion instead of it; single
            precision; a run that ends early; values that cannot be used.
    """
    shot, start = _prepared(
        scene, guess, start_time, RunOptions(rtol, atol, max_steps, method)
    )
    period = float(positive(f"{_FIELD}.period", period, (), "a time [s]"))
    segments = whole(f"{_FIELD}.segments", segments, 1, "give 1 or more")
    seen = orbit(shot, start, period)
    shot = verified_near(shot, seen)
    while True:
        found, held = _solution(shot, start, period, segments, hold)
        try:
            refuse_strays(f"{_FIELD}.period", period, shot, found.nodes, found.linear)
            lost = None
        except LostSymmetry as error:
            lost = error
        seen += relative_orbit(shot, found.nodes, lost is not None)
        verified = verified_near(shot, seen)
        if len(verified.group) == len(shot.group) and verified.driven == shot.driven:
            if lost is not None:
                raise lost
            return motion_of(shot, found, held)
        shot = verified  # of fewer symmetries, each time


def _solution(
    shot: Shooting,
    start: State,
    period: float,
    segments: int,
    hold: Mapping[str, Any] | None,
) -> tuple[Solved, tuple[Held, ...]]:
    """The motion near a start, and what is held of it.

    Raises:
        FieldError: there is none.
    """
    held = held_of(shot, start, period, hold)
    check_invariant(shot, start, held)
    if shot.driven:
        check_repeats(shot, start, period)
        held = (*(h for h in held if h.name != PERIOD), Held(PERIOD, period))
    nodes = first_nodes(shot, start, period, segments)
    found = solve(shot, nodes, held, closeness(shot))
    if not found.converged:
        _refuse(found, held)
    return found, held


def closeness(shot: Shooting) -> float:
    """Largest miss that is no more than errors of the runs [1]."""
    rtol = _RTOL if shot.options.rtol is None else float(shot.options.rtol)
    return _ERRORS * rtol


def motion_of(
    shot: Shooting, found: Solved, held: tuple[Held, ...], families: int | None = None
) -> PeriodicMotion:
    """What Newton's method found, with its multipliers.

    Args:
        shot: What was shot.
        found: That.
        held: Of it.
        families: Directions of a family, at most; None: by rank.

    Raises:
        FieldError: it is a steady motion.
    """
    nodes, linear = found.nodes, found.linear
    flow = linear.own_flow
    moves = np.inf if flow is None else float(np.linalg.norm(flow)) * nodes.period
    if moves < _STEADY:
        problem = "leads to a steady motion, which repeats after any time"
        remedy = "give a guess farther from it, or hold an energy that it does not have"
        raise FieldError(f"{_FIELD}.guess", "...", problem, remedy)
    product = np.eye(linear.around.directions.shape[1])
    for one in linear.segments:
        product = np.asarray(one.by_start) @ product
    monodromy = np.linalg.solve(np.asarray(linear.closed.by_start), product)
    split = _split(shot, nodes, monodromy, found, families)
    if not split.error < _WRONG:
        problem = (
            f"leads to a motion whose flow or energy does not come back, by "
            f"{split.error:.2g} of the largest multiplier, though its state does"
        )
        remedy = "give more segments, a smaller rtol, or another guess"
        raise FieldError(f"{_FIELD}.guess", "...", problem, remedy)
    names = shot.group.names
    group = {name: float(x) for name, x in zip(names, nodes.steps, strict=True)}
    return PeriodicMotion(
        state=nodes.states[0],
        period=nodes.period,
        group=group,
        multipliers=split.multipliers,
        expected=split.expected,
        expected_multipliers=split.expected_multipliers,
        monodromy=monodromy,
        miss=found.miss,
        time=shot.time,
        nodes=nodes.states,
        shooting=shot,
        uncertain=split.uncertain,
        held=held,
    )


def _split(
    shot: Shooting,
    nodes: Nodes,
    monodromy: np.ndarray,
    found: Solved,
    families: int | None,
) -> Floquet:
    around = found.linear.around
    size = scales(coordinates_of(shot, nodes.states[0]), nodes.period)
    directions, slopes = around.directions / size, around.slopes * size
    like = monodromy * size[None] / size[:, None]
    rtol = closeness(shot) / _ERRORS
    known = around.names, directions, around.integrals, slopes
    return floquet(like, *known, rtol, families)


def _prepared(
    scene: Scene, guess: State, start_time: Any, options: RunOptions
) -> tuple[Shooting, State]:
    """Checked, with the symmetries of the scene."""
    if is_traced(scene, guess):
        problem = "is traced, and Newton's method looks at its numbers"
        remedy = "call it outside of jit, vmap and derivatives"
        raise FieldError(f"{_FIELD}.guess", "...", problem, remedy)
    time = float(real(f"{_FIELD}.start_time", start_time, (), "a time [s]"))
    around = independent_coordinates(scene, guess, time)
    dtype = around.time.dtype
    if dtype != jnp.float64:
        problem = "is in single precision, in which no run comes back near enough"
        remedy = 'set jax.config.update("jax_enable_x64", True) first'
        raise FieldError(f"{_FIELD}.guess", str(dtype), problem, remedy)
    if options.rtol is None:
        options = options._replace(rtol=_RTOL)
    group = symmetries(scene, around.reference, time)
    shot = Shooting(scene, group, time, group.drift is None, options)
    return shot, around.reference


def _refuse(found: Solved, held: tuple[Held, ...]) -> None:
    linear = found.linear
    unknowns = linear.slopes.shape[1]
    named = ", ".join(f"{one.name} = {one.value:.6g}" for one in held) or "nothing"
    problem = (
        f"leads to no periodic motion: after {found.steps} steps the largest miss is "
        f"{found.miss:.2g} (in radians and like changes), with {named} held; the "
        f"equations have rank {linear.rank} for {unknowns} unknowns"
    )
    remedy = "give a nearer guess or period, more segments, or hold less"
    raise FieldError(f"{_FIELD}.guess", "...", problem, remedy)
