"""Families of relative periodic motions: over an energy, a period, a displacement."""

import dataclasses
import itertools
from collections.abc import Mapping
from os import PathLike
from typing import Any, NamedTuple, TypeAlias, cast

import numpy as np

from ..dynamics.scene import Scene
from ..validation.checks import FieldError, real, whole
from .closing_newton import (
    PERIOD,
    Held,
    Linear,
    borders,
    linearized,
    solve,
    stepped_nodes,
)
from .periodic import PeriodicMotion, closeness, motion_of
from .periodic_holds import held_of
from .refusals import refuse_other_scene
from .shooting import Nodes, Shooting, offset

_FIELD = "periodic_family"
# Of the largest singular value: what a motion leaves free.
_FREE = 1e-7
# Of the flow, squared: a neighbour with less is a steady motion, solved to 1e-9.
_STEADY = 1e-12
# Largest step, in changes of like size [1], and the least before the search gives up.
_LONGEST, _SHORTEST = 0.3, 1e-5
_BISECTIONS = 30
_Svd: TypeAlias = tuple[np.ndarray, np.ndarray, np.ndarray]


@dataclasses.dataclass(frozen=True)
class CriticalPeriod:
    """Where the stability of a family changes.

    Attributes:
        kind: What the multiplier that leaves the unit circle is: ``"one"`` (a fold or
            a branching), ``"minus one"`` (period doubling), ``"pair"``.
        value: Of what is varied [its unit].
        multiplier: On the unstable side [1].
        motion: There, on the unstable side.
    """

    kind: str
    value: float
    multiplier: complex
    motion: PeriodicMotion


@dataclasses.dataclass(frozen=True, eq=False)
class PeriodicFamily:
    """Periodic motions in the order in which they follow each other, with T [s].

    Attributes:
        vary: What is varied.
        points: The motions.
        critical: Where their stability changes.
        ends: Why the family ends where it begins, and where it ends: ``"span"``,
            ``"steady motion"`` (what is left of the motion vanishes there),
            ``"max_points"``, or ``"not found"``: no motion farther on.
    """

    vary: str
    points: tuple[PeriodicMotion, ...]
    critical: tuple[CriticalPeriod, ...]
    ends: tuple[str, str]

    @property
    def values(self) -> np.ndarray:
        """Of what is varied [its unit], shape (P,)."""
        return self.along(self.vary)

    @property
    def periods(self) -> np.ndarray:
        """T [s], shape (P,)."""
        return self.along(PERIOD)

    @property
    def stable(self) -> np.ndarray:
        """Whether each is stable, shape (P,)."""
        return np.array([point.stable for point in self.points])

    def along(self, name: str) -> np.ndarray:
        """A quantity at every motion [its unit], shape (P,).

        Args:
            name: ``"period"``, ``"energy"`` and the like, or a symmetry's.
        """
        return np.array([point.measure(name) for point in self.points])

    def plot(self, path: str | PathLike[str] | None = None, title: str = "") -> Any:
        """Draw periods and largest multipliers (extra ``plot``).

        Args:
            path: File to write, .png, .svg or .pdf; None for none.
            title: Above the figure.

        Returns:
            The matplotlib figure, or None where a file was written.
        """
        from ..pictures.plot_spectra import plot_periodic_family

        return plot_periodic_family(self, path, title)

    def __str__(self) -> str:
        """How many motions, and where their stability changes."""
        low, high = self.values.min(), self.values.max()
        rows = [
            f"{len(self.points)} periodic motions, {self.vary} from {low:.9g} to "
            f"{high:.9g}, {int(np.sum(self.stable))} of them stable",
            f"  begins: {self.ends[0]}; ends: {self.ends[1]}",
        ]
        rows += [
            f"  {c.kind:<16}{self.vary} = {c.value:.12g}, multiplier {c.multiplier:.6g}"
            for c in self.critical
        ]
        return "\n".join(rows)


class _Course(NamedTuple):
    """How a family is followed."""

    shot: Shooting
    held: tuple[Held, ...]
    varied: Held
    span: tuple[float, float]
    points: int
    most: int


class _Here(NamedTuple):
    """A motion of the family, and where it goes on."""

    motion: PeriodicMotion
    nodes: Nodes
    linear: Linear
    value: float
    tangent: np.ndarray  # of unknowns of like size, of unit length
    slope: float  # of what is varied along it


def periodic_family(
    scene: Scene,
    motion: PeriodicMotion,
    vary: str,
    span: tuple[float, float],
    *,
    hold: Mapping[str, Any] | None = None,
    points: int = 50,
    max_points: int = 500,
) -> PeriodicFamily:
    """The family of periodic motions through one of them, with stability.

    By pseudo-arclength continuation both ways, round folds, to the ends of the span. Of
    a family of more dimensions (a bowl of revolution: energy and moments) each step
    goes on as straight as it can.

    Args:
        scene: The motion's.
        motion: What :func:`rollkane.periodic_motion` or
            :func:`rollkane.normal_mode_motion` returned, within the span.
        vary: ``"energy"`` [J], ``"period"`` [s] or another name that can be held, or
            that was; with ``"hold."`` in front or without.
        span: Least and largest value of it [its unit].
        hold: What keeps its value on the way, as of :func:`rollkane.periodic_motion`;
            what was held of the motion does not, unless it is named here. A value
            None: the motion's.
        points: How many steps the span is wide, at least. Stability is compared at
            neighbouring motions: two changes within one step are not seen.
        max_points: Most motions each way.

    Raises:
        FieldError: names that are not known, another scene than the motion's, a motion
            outside of the span, nothing left free, a quantity that does not change.
    """
    if not isinstance(cast(object, motion), PeriodicMotion):
        remedy = "give what periodic_motion returns"
        raise FieldError(f"{_FIELD}.motion", motion, "is no periodic motion", remedy)
    refuse_other_scene(f"{_FIELD}.scene", scene, motion.scene)
    vary = vary.removeprefix("hold.")
    low, high = (float(real(f"{_FIELD}.span", x, (), "two numbers")) for x in span)
    shot = motion.shooting
    nodes = Nodes(motion.nodes, motion.period, np.array(list(motion.group.values())))
    (varied,) = _held(motion, {vary: None})
    if not low <= varied.value <= high or not low < high:
        problem = f"does not hold the motion's own value {varied.value:.9g}"
        remedy = "begin from a motion within the span, or widen it"
        raise FieldError(f"{_FIELD}.span", span, problem, remedy)
    held = _held(motion, hold or {})
    points = whole(f"{_FIELD}.points", points, 1, "give 1 or more")
    most = whole(f"{_FIELD}.max_points", max_points, 1, "give 1 or more")
    course = _Course(shot, held, varied, (low, high), points, most)
    linear = linearized(shot, nodes, held)
    start = _found(course, motion, nodes, linear, None)
    back, first = _walk(course, start, -1.0)
    ahead, last = _walk(course, start, 1.0)
    line = [*reversed(back), start.motion, *ahead]
    return PeriodicFamily(vary, tuple(line), _critical(course, line), (first, last))


def _held(motion: PeriodicMotion, hold: Mapping[str, Any]) -> tuple[Held, ...]:
    """Quantities by name, with the motion's values where none is given."""
    known = {one.name: one for one in motion.held}
    found: list[Held] = []
    for name, given in hold.items():
        if name in known and type(given) is not tuple:
            one = known[name]
            value = motion.measure(name) if given is None else given
            number = float(real(f"{_FIELD}.hold[{name!r}]", value, (), "a number"))
            found.append(one._replace(value=number))
            continue
        value = cast(object, motion.group.get(name) if given is None else given)
        asked = {name: value}
        found += held_of(motion.shooting, motion.state, motion.period, asked)
    return tuple(found)


def _gradient(
    course: _Course, nodes: Nodes, linear: Linear
) -> tuple[np.ndarray, float]:
    """Of what is varied, by unknowns of like size; and its value."""
    n = linear.around.directions.shape[1]
    size = linear.sizes[:n]
    one = course.varied._replace(value=0.0)
    rows, miss, units = borders(course.shot, nodes, (one,), size, linear.sizes.size)
    return rows[0] * units[0] * linear.sizes, float(miss[0] * units[0])


def _found(
    course: _Course,
    motion: PeriodicMotion,
    nodes: Nodes,
    linear: Linear,
    before: np.ndarray | None,
) -> _Here:
    """A motion with the direction in which the family goes on."""
    gradient, value = _gradient(course, nodes, linear)
    _, values, right = cast(_Svd, np.linalg.svd(linear.scaled))
    full = np.zeros(right.shape[0])
    full[: values.size] = values
    free = right[full <= _FREE * values[0]]
    if not free.shape[0]:
        problem = "is isolated: with what is held there is no motion beside it"
        remedy = "hold less, or vary what it depends on"
        raise FieldError(f"{_FIELD}.motion", "...", problem, remedy)
    wanted = gradient / np.linalg.norm(gradient) if before is None else before
    tangent = free.T @ (free @ wanted)
    length = float(np.linalg.norm(tangent))
    if length < 1e-6:
        problem = "does not change along the family of this motion"
        remedy = "vary another quantity, or hold less"
        raise FieldError(f"{_FIELD}.vary", course.varied.name, problem, remedy)
    tangent = tangent / length
    return _Here(motion, nodes, linear, value, tangent, float(gradient @ tangent))


def _walk(
    course: _Course, start: _Here, sign: float
) -> tuple[list[PeriodicMotion], str]:
    """Motions one way, and why they end."""
    low, high = course.span
    found: list[PeriodicMotion] = []
    if start.value == (high if sign > 0.0 else low):
        return found, "span"
    here = start._replace(tangent=sign * start.tangent, slope=sign * start.slope)
    longest = _LONGEST
    while len(found) < course.most:
        wide = (high - low) / course.points / max(abs(here.slope), 1e-300)
        there = None
        far = min(longest, wide)
        while there is None and far > _SHORTEST:
            there = _next(course, here, far)
            far *= 0.5
        if there is None:
            return found, "not found"
        turned = _turned_back(here, there)
        longest = min(_LONGEST, 4.0 * far)
        if turned or not low < there.value < high:
            above = here.slope > 0.0 if turned else there.value >= high
            last = _at(course, here, high if above else low)
            if last is None:
                return found, "steady motion" if turned else "not found"
            return [*found, last], "span"
        found.append(there.motion)
        here = there
    return found, "max_points"


def _turned_back(here: _Here, there: _Here) -> bool:
    """Whether a steady motion lies between: the flow has changed its sign."""
    return not _moves_on(here, there.linear)


def _moves_on(here: _Here, linear: Linear) -> bool:
    """Whether a motion goes the way of another, and is no steady one."""
    flows = here.linear.own_flow, linear.own_flow
    if flows[0] is None or flows[1] is None:
        return True
    return bool(flows[0] @ flows[1] > _STEADY * (flows[0] @ flows[0]))


def _next(course: _Course, here: _Here, far: float) -> _Here | None:
    """The next motion, about so far away; None: it was not found."""
    sizes = here.linear.sizes
    guess = stepped_nodes(course.shot, here.nodes, far * here.tangent * sizes)
    across = here.tangent / sizes
    try:
        solved = solve(course.shot, guess, course.held, closeness(course.shot), across)
        if not solved.converged or solved.steps > 8:
            return None
        moved = _secant(course, here.nodes, solved.nodes, solved.linear.sizes)
        size = float(np.linalg.norm(moved))
        if not 0.3 * far < size < 3.0 * far:
            return None
        motion = motion_of(course.shot, solved, course.held)
        there = _found(course, motion, solved.nodes, solved.linear, moved / size)
        held = (*course.held, course.varied._replace(value=there.value))
        return there._replace(motion=dataclasses.replace(motion, held=held))
    except FieldError:
        return None


def _secant(
    course: _Course, before: Nodes, after: Nodes, sizes: np.ndarray
) -> np.ndarray:
    """From one motion to another, in unknowns of like size around that."""
    shot = course.shot
    parts = [
        -np.asarray(offset(shot, there, here))
        for here, there in zip(before.states, after.states, strict=True)
    ]
    change = np.concatenate(
        [*parts, [after.period - before.period], after.steps - before.steps]
    )
    return change / sizes


def _at(course: _Course, here: _Here, value: float) -> PeriodicMotion | None:
    """The motion with a value of what is varied, near another; None: not found."""
    far = (value - here.value) / here.slope if here.slope else 0.0
    step = np.clip(far, -_LONGEST, _LONGEST) * here.tangent * here.linear.sizes
    held = (*course.held, course.varied._replace(value=value))
    for guess in (stepped_nodes(course.shot, here.nodes, step), here.nodes):
        try:
            solved = solve(course.shot, guess, held, closeness(course.shot))
            if solved.converged and _moves_on(here, solved.linear):
                return motion_of(course.shot, solved, held)
        except FieldError:
            continue
    return None


def _critical(
    course: _Course, line: list[PeriodicMotion]
) -> tuple[CriticalPeriod, ...]:
    """Changes of stability between neighbours, located by bisection."""
    found: list[CriticalPeriod] = []
    for one, other in itertools.pairwise(line):
        if one.stable != other.stable:
            found.append(_located(course, one, other))
    return tuple(found)


def _located(
    course: _Course, one: PeriodicMotion, other: PeriodicMotion
) -> CriticalPeriod:
    shot = course.shot
    close = 1e-8 * (course.span[1] - course.span[0])
    for _ in range(_BISECTIONS):
        values = _measured(course, one), _measured(course, other)
        if abs(values[1] - values[0]) <= close:
            break
        nodes = Nodes(one.nodes, one.period, np.array(list(one.group.values())))
        held = (*course.held, course.varied._replace(value=0.5 * sum(values)))
        try:
            solved = solve(shot, nodes, held, closeness(shot))
            if not solved.converged:
                break
            middle = motion_of(shot, solved, held)
        except FieldError:
            break
        one, other = (middle, other) if middle.stable == one.stable else (one, middle)
    unstable = other if one.stable else one
    multiplier = complex(unstable.multipliers[0])
    kind = "pair"
    if abs(multiplier.imag) <= float(unstable.uncertain[0]):
        kind = "one" if multiplier.real > 0.0 else "minus one"
    return CriticalPeriod(kind, _measured(course, unstable), multiplier, unstable)


def _measured(course: _Course, motion: PeriodicMotion) -> float:
    return motion.measure(course.varied.name)
