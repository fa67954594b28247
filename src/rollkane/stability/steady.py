"""Steady motions: relative equilibria of a scene, and whether they are stable."""

import dataclasses
import functools
from collections.abc import Callable
from os import PathLike
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Complex, Float

from ..dynamics.scene import Scene
from ..kane.system import KaneSystem
from ..validation.checks import FieldError, is_traced
from .energy_sign import EnergySign, energy_sign
from .independent_coordinates import refuse_kind, refuse_rank
from .kane_problem import KaneProblem, kane_problem
from .kept_symmetries import group_orbit
from .newton import (
    SOLVED,
    Asked,
    Point,
    Solved,
    along_group,
    followed,
    point_at,
    program_of,
    solved,
)
from .problem import AbstractProblem, RollingProblem, rolling_problem
from .quantities import held_quantities
from .refusals import (
    refuse_moving,
    refuse_overheld,
    refuse_rest_that_is_none,
    refuse_unsolved,
)
from .spectrum import Spectrum, spectrum
from .symmetries import symmetries, symmetries_at


@dataclasses.dataclass(frozen=True)
class SteadyMotion:
    """A motion that a group of symmetries makes: ``rates = generator`` at every time.

    Attributes:
        state: At the time zero.
        generator: Group velocities by the names of ``symmetries`` [m/s] or [rad/s].
        held: Quantities that were held, by name.
        eigenvalues: Of small motions about it, in the frame that moves with the group,
            by falling growth [1/s], shape (k,), complex: without the zeros of group
            and family.
        modes: Their directions in the independent coordinates, shape (n, k).
        coordinates: Names of these coordinates.
        zeros: Eigenvalues that symmetry and family explain, by name [1/s]: zero, or
            plus and minus i times the turn that turns a direction of the group.
        errors: How far rounding may move each eigenvalue [1/s], shape (k,).
        stable: Whether no eigenvalue grows, beyond its error: on the imaginary axis
            that is stability of the linear model alone.
        clear: Whether what counts as zero is so to rounding; where it may as well be
            slow, the motion is not told stable.
        family: Number of dimensions of the family of steady motions through it.
        problem: What was asked, with its symmetries.
        solution: The solution in independent coordinates.
        asked: What was held.
    """

    state: Any
    generator: dict[str, float]
    held: dict[str, float]
    eigenvalues: Complex[np.ndarray, " k"]
    modes: Complex[np.ndarray, "n k"]
    coordinates: tuple[str, ...]
    zeros: dict[str, complex]
    errors: Float[np.ndarray, " k"]
    stable: bool
    clear: bool
    family: int
    problem: AbstractProblem = dataclasses.field(repr=False)
    solution: Point = dataclasses.field(repr=False)
    asked: Asked = dataclasses.field(repr=False)

    @property
    def growth(self) -> float:
        """Largest rate of growth [1/s]; zero where nothing is left to decide."""
        if not self.eigenvalues.size:
            return 0.0
        return float(np.max(np.real(self.eigenvalues)))

    @functools.cached_property
    def energy_sign(self) -> EnergySign:
        """Of the kept energy's second variation, (10.6): definite is stable for good.

        Compiled when it is first asked for, some seconds; printed from then on.
        """
        return energy_sign(self.asked, self.solution, self.eigenvalues, self.errors)

    def at(self, time: Any) -> Any:
        """The state at another time [s], exactly: moved by the group, with the base."""
        t = jnp.asarray(time, jnp.result_type(float))
        moved = self.problem.along_group(self.state, t * jnp.asarray(self.solution.xi))
        return self.problem.carried(moved, t)

    def __str__(self) -> str:
        """What it is, line by line."""
        kind = "stable" if self.stable else "unstable"
        if not self.clear and not np.any(np.real(self.eigenvalues) > self.errors):
            kind = "stability open: what counts as zero may be slow growth"
        rows = [f"steady motion, {kind}"]
        rows += [f"  {name:<28}{v:>16.9g}" for name, v in self.generator.items()]
        rows += [f"  held {name:<23}{v:>16.9g}" for name, v in self.held.items()]
        rows += [f"  eigenvalue {_complex(v):>33} 1/s" for v in self.eigenvalues]
        rows += [
            f"  zero of {name:<20} {_complex(v):>15}" for name, v in self.zeros.items()
        ]
        if "energy_sign" in vars(self):  # to print a motion should compile nothing
            rows.append(f"  sign of {self.energy_sign}")
        return "\n".join(rows)

    def plot(self, path: str | PathLike[str] | None = None, title: str = "") -> Any:
        """Draw eigenvalues in the complex plane (extra ``plot``).

        Args:
            path: File to write, .png, .svg or .pdf; None for none.
            title: Above the figure.

        Returns:
            The matplotlib figure, or None where a file was written.
        """
        from ..pictures.plot_spectra import plot_steady

        return plot_steady(self, path, title)


def _complex(value: complex) -> str:
    if value.imag == 0.0:
        return f"{value.real:.9g}"
    return f"{value.real:.9g} {'+' if value.imag > 0 else '-'} {abs(value.imag):.9g}i"


def steady_motion(scene: Any, guess: Any, hold: Any = ()) -> SteadyMotion:
    """The steady motion near a guess, and its stability.

    Args:
        scene: What rolls on what; its base may rest, glide or turn steadily. Or a
            ``rollkane.kane.KaneSystem``.
        guess: A state near it.
        hold: What is held, by name: ``{"speed": 1.0, "tilt": 0.3}`` [m/s], [rad]; a
            sequence of names, or a value None, holds what the guess has. Names:
            "speed" of the mass centre, "tilt" of the body's z axis, "spin" about it,
            "energy", "moving energy", "momentum x", "angular momentum z", "normal
            force"; a generator, for its velocity; a number of the state
            ("angular_velocity[2]"); ``{"name": (function, value)}`` of
            ``function(scene, t, state)``. Of what is left free the motion nearest to
            the guess is taken.

    Returns:
        ``SteadyMotion``, solved to rounding.

    Raises:
        FieldError: a scene that depends on time, no steady motion near the guess, more
            held than is free, what a symmetry does not leave fixed.

    Source: docs/theory.md, (10.2) to (10.4).
    """
    problem, state = problem_of(scene, guess)
    start: Callable[[Any], np.ndarray] = lambda part: np.asarray(part)[None]
    seen = [(np.zeros(1), jax.tree.map(start, state))]
    while True:
        asked, found = _solution(problem, state, hold)
        point = found.point
        seen.append(group_orbit(problem, point.state, point.xi))
        verified = _verified(problem, point.state, seen)
        if len(verified.group) == len(problem.group):
            return motion_of(asked, found)
        problem = verified  # of fewer symmetries, each time


def _verified(
    problem: AbstractProblem, state: Any, seen: list[tuple[np.ndarray, Any]]
) -> AbstractProblem:
    """The problem with the symmetries that hold near all of some states.

    What a search comes to may be far from its guess, where less is symmetric, and its
    motion goes on from there; of a Kane system the symmetries at that state count, if
    they are fewer.
    """
    if isinstance(problem, KaneProblem):
        there, _ = kane_problem(problem.system, state)
        return there if len(there.group) < len(problem.group) else problem
    if not isinstance(problem, RollingProblem):
        return problem
    times, places = zip(*seen, strict=True)
    join: Callable[..., np.ndarray] = lambda *parts: np.concatenate(parts)
    states = jax.tree.map(join, *places)
    group = symmetries_at(problem.scene, np.concatenate(times), states)
    return rolling_problem(problem.scene, group)


def _solution(problem: AbstractProblem, state: Any, hold: Any) -> tuple[Asked, Solved]:
    """What was asked of a problem with holds, and the solution near a guess."""
    quantities, values = held_quantities("steady_motion.hold", problem, state, hold)
    names, fast = problem.coordinates(state)
    asked = Asked(problem, None, quantities, np.zeros(len(quantities)))
    asked = asked._replace(names=names, fast=fast)
    start = np.zeros(len(problem.group))
    program = program_of(asked)
    first = point_at(asked, program, state, np.zeros(len(names)), start, 0.0)
    refuse_rank(first.local.basis)
    xi = guessed_velocities(first)
    moving = point_at(asked, program, state, np.zeros(len(names)), xi, 0.0)
    given = zip(values, moving.local.held, strict=True)
    wanted = [float(own) if v is None else v for v, own in given]
    asked = asked._replace(values=np.array(wanted, float))
    refuse_moving("steady_motion.hold", asked, first)
    found = solved(asked, state, xi, 0.0, program=program)
    if not found.error < SOLVED:
        refuse_unsolved(asked, state, first, found)
    refuse_rest_that_is_none(state, first, found)
    return asked, found


def problem_of(scene: Any, guess: Any) -> tuple[AbstractProblem, Any]:
    """The problem of a scene or a system, and a guess that it can have.

    Raises:
        FieldError: neither, numbers that are traced or of single precision, a state of
            another kind.
    """
    if is_traced(scene, guess):
        problem, remedy = "is traced", "call it outside of jit and derivatives"
        raise FieldError("steady_motion.guess", "a traced state", problem, remedy)
    if isinstance(scene, KaneSystem):
        return kane_problem(scene, guess)
    if not isinstance(scene, Scene):
        remedy = "give a Scene or a rollkane.kane.KaneSystem"
        raise FieldError("steady_motion.scene", scene, "is neither", remedy)
    if jax.tree.leaves(guess)[0].dtype != np.float64:
        problem = "is in single precision, in which no rank can be told"
        remedy = 'call jax.config.update("jax_enable_x64", True) first'
        raise FieldError("steady_motion.guess", "float32", problem, remedy)
    refuse_kind(scene, guess)
    return rolling_problem(scene, symmetries(scene, guess)), guess


def guessed_velocities(point: Point) -> np.ndarray:
    """Group velocities that come nearest to the rates of a state."""
    xi = along_group(point, point.local.rates)
    for row in point.group.idle:  # the first of those that do the same
        place = int(np.argmax(np.abs(row)))
        xi = xi - xi[place] / row[place] * row
    return xi


def motion_of(asked: Asked, found: Solved) -> SteadyMotion:
    """A steady motion from a solution, refused where more is held than free."""
    point = found.point
    told = spectrum_at(asked, point)
    refuse_overheld(asked, point, told.family)
    problem = asked.problem
    names = [q.name for q in asked.quantities]
    return SteadyMotion(
        state=point.state,
        generator=dict(zip(problem.group, point.xi.tolist(), strict=True)),
        held=dict(zip(names, point.local.held.tolist(), strict=True)),
        eigenvalues=told.eigenvalues,
        modes=told.modes,
        coordinates=asked.names,
        zeros=told.zeros,
        errors=told.errors,
        stable=told.unstable == 0 and told.clear,
        clear=told.clear,
        family=told.family.shape[1],
        problem=problem,
        solution=point,
        asked=asked,
    )


def spectrum_at_rest(scene: Scene, state: Any) -> Spectrum:
    """Eigenvalues about a state that stays at rest."""
    problem, state = problem_of(scene, state)
    names, fast = problem.coordinates(state)
    asked = Asked(problem, None, (), np.zeros(0), names=names, fast=fast)
    step, xi = np.zeros(len(names)), np.zeros(len(problem.group))
    point = point_at(asked, program_of(asked), state, step, xi, 0.0)
    return spectrum_at(asked, point)


def spectrum_at(
    asked: Asked, point: Point, dimensions: tuple[int, ...] | None = None
) -> Spectrum:
    """Eigenvalues at a solution; of a family of known dimensions, or by rank."""
    local = point.local
    names = asked.problem.group
    labels = [
        (q.name, row)
        for q, row in zip(asked.quantities, local.held_by_x, strict=True)
        if q.velocity is None
    ]
    follow = followed(point)
    labels += [(f"velocity of {n}", row) for n, row in zip(names, follow, strict=True)]
    coordinates = asked.names
    labels += list(zip(coordinates, np.eye(len(coordinates)), strict=True))
    return spectrum(point, names, labels, dimensions)
