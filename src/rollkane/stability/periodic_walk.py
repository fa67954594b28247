"""Pseudo-arclength continuation of relative periodic motions: points and steps."""

import dataclasses
from collections.abc import Callable
from typing import NamedTuple, TypeAlias, cast

import numpy as np

from ..validation.checks import FieldError
from .branch_segments import Passing, Segment
from .closing_newton import Held, Linear, borders, linearized, solve, stepped_nodes
from .kept_symmetries import LostSymmetry
from .orbit_symmetries import refuse_strays
from .periodic import PeriodicMotion, closeness, motion_of
from .shooting import Nodes, Shooting, offset

# Of the largest singular value: what a motion leaves free.
_FREE = 1e-7
# Of the flow, squared: a neighbour with less is a steady motion, solved to 1e-9.
_STEADY = 1e-12
# Largest step, in changes of like size [1], and the least before the search gives up.
_LONGEST, _SHORTEST = 0.3, 1e-5
# Least cosine of tangent and chord, 18 degrees: what turns more is another family.
_TURN = 0.95
# How far logarithms of multipliers may move in a step [rad]: a turn about the unit
# circle, 2 pi, is then seen at nine points, and a window at +-1 by a dip between three.
_MOVED = 0.7
# Steps that are so short are taken however far multipliers move, and whatever changes
# its sign without passing zero.
_SHORT = 1e-3
# Below which a step's chord is rounding beside the tangent.
_CHORD = 1e-3
_DECAYED = 1e-30  # a multiplier whose logarithm would be none
_Svd: TypeAlias = tuple[np.ndarray, np.ndarray, np.ndarray]


class Course(NamedTuple):
    """How a family is followed.

    Attributes:
        shot: What is shot.
        held: What keeps its value.
        varied: What is varied.
        span: Its least and largest value.
        points: How many steps the span is wide, at least.
        most: Most points each way.
        families: Directions of the family that the start has beside it.
    """

    shot: Shooting
    held: tuple[Held, ...]
    varied: Held
    span: tuple[float, float]
    points: int
    most: int
    families: int


class FamilyPoint(NamedTuple):
    """A motion of the family, and where it goes on.

    Attributes:
        motion: That.
        nodes: Its unknowns.
        linear: Its equations.
        value: Of what is varied.
        tangent: Of unknowns of like size, of unit length.
        turning: Change of what is varied along it.
    """

    motion: PeriodicMotion
    nodes: Nodes
    linear: Linear
    value: float
    tangent: np.ndarray
    turning: float

    @property
    def exponents(self) -> np.ndarray:
        """Logarithms of the multipliers, in falling modulus, shape (p,)."""
        values = np.asarray(self.motion.multipliers, complex)
        return np.log(np.where(np.abs(values) > _DECAYED, values, _DECAYED))

    @property
    def errors(self) -> np.ndarray:
        """How far rounding may move each, shape (p,)."""
        size = np.maximum(np.abs(self.motion.multipliers), _DECAYED)
        return self.motion.uncertain / size

    @property
    def unstable(self) -> int:
        """How many are outside of the unit circle."""
        return int(np.sum(self.motion.outside))

    @property
    def determinants(self) -> tuple[tuple[complex, float], ...]:
        """Of what passes one, and minus one; zero where rounding may have moved it."""
        return (0j, self._from(1.0)), (1j * np.pi, self._from(-1.0))

    def _from(self, place: float) -> float:
        gaps = np.asarray(self.motion.multipliers, complex) * place - 1.0
        if np.any(np.abs(gaps) <= 2.0 * self.motion.uncertain):
            return 0.0
        return float(np.real(np.prod(gaps)))

    @property
    def turned(self) -> "FamilyPoint":
        """The same, going the other way."""
        return self._replace(tangent=-self.tangent, turning=-self.turning)


class Walk(NamedTuple):
    """A way along a family.

    Attributes:
        points: On it, from the start.
        critical: What is critical, each with the number of the point before.
        end: Why it ends.
        lengths: How far along its tangent from each point to the next.
    """

    points: list[FamilyPoint]
    critical: list[tuple[int, Passing[FamilyPoint]]]
    end: str
    lengths: list[float]


Look: TypeAlias = Callable[[Segment[FamilyPoint]], list[Passing[FamilyPoint]] | None]


def start_of(course: Course, motion: PeriodicMotion, vary: str) -> FamilyPoint:
    """The motion that a family begins at, with the way up.

    Raises:
        FieldError: there is no motion beside it, or what is varied does not change.
    """
    nodes = Nodes(motion.nodes, motion.period, np.array(list(motion.group.values())))
    linear = linearized(course.shot, nodes, course.held)
    free = _free(linear)
    if not free.shape[0]:
        problem = "is isolated: with what is held there is no motion beside it"
        remedy = "hold less, or vary what it depends on"
        raise FieldError("periodic_family.motion", "...", problem, remedy)
    gradient, value = _gradient(course, nodes, linear)
    tangent = free.T @ (free @ (gradient / np.linalg.norm(gradient)))
    length = float(np.linalg.norm(tangent))
    if length < 1e-6:
        problem = "does not change along the family of this motion"
        remedy = "vary another quantity, or hold less"
        raise FieldError("periodic_family.vary", vary, problem, remedy)
    tangent = tangent / length
    turning = float(gradient @ tangent)
    return FamilyPoint(motion, nodes, linear, value, tangent, turning)


def _free(linear: Linear) -> np.ndarray:
    """Directions in which there are motions, of unknowns of like size, one row each."""
    _, values, right = cast(_Svd, np.linalg.svd(linear.scaled))
    full = np.zeros(right.shape[0])
    full[: values.size] = values
    return right[full <= _FREE * values[0]]


def _gradient(course: Course, nodes: Nodes, linear: Linear) -> tuple[np.ndarray, float]:
    """Of what is varied, by unknowns of like size; and its value."""
    n = linear.around.directions.shape[1]
    size = linear.sizes[:n]
    one = course.varied._replace(value=0.0)
    rows, miss, units = borders(course.shot, nodes, (one,), size, linear.sizes.size)
    return rows[0] * units[0] * linear.sizes, float(miss[0] * units[0])


def onward(course: Course, here: FamilyPoint, far: float) -> FamilyPoint | None:
    """The family's motion a way along a tangent, either way; None: it is not found."""
    sizes = here.linear.sizes
    guess = stepped_nodes(course.shot, here.nodes, far * here.tangent * sizes)
    across = here.tangent / sizes
    try:
        solved = solve(course.shot, guess, course.held, closeness(course.shot), across)
        if not solved.converged or solved.steps > 8:
            return None
        nodes, linear = solved.nodes, solved.linear
        _refuse_lost(course, nodes, linear)
        motion = motion_of(course.shot, solved, course.held, course.families)
        chord = secant(course, here.nodes, nodes, linear.sizes)
        size = float(np.linalg.norm(chord))
        way = here.tangent if abs(far) < _CHORD else chord / np.copysign(size, far)
        if abs(far) >= _CHORD and not _TURN * size < abs(far) < size / _TURN:
            return None
        return _placed(course, motion, nodes, linear, way)
    except LostSymmetry:
        raise
    except FieldError:
        return None


def _refuse_lost(course: Course, nodes: Nodes, linear: Linear) -> None:
    value = _gradient(course, nodes, linear)[1]
    refuse_strays("periodic_family.span", value, course.shot, nodes, linear)


def _placed(
    course: Course,
    motion: PeriodicMotion,
    nodes: Nodes,
    linear: Linear,
    way: np.ndarray,
) -> FamilyPoint | None:
    """A motion with the direction in which its family goes on as before."""
    free = _free(linear)
    tangent = free.T @ (free @ way)
    length = float(np.linalg.norm(tangent))
    if length < _TURN:
        return None
    gradient, value = _gradient(course, nodes, linear)
    tangent = tangent / length
    held = (*course.held, course.varied._replace(value=value))
    motion = dataclasses.replace(motion, held=held)
    turning = float(gradient @ tangent)
    return FamilyPoint(motion, nodes, linear, value, tangent, turning)


def secant(
    course: Course, before: Nodes, after: Nodes, sizes: np.ndarray
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


def walked(course: Course, start: FamilyPoint, look: Look) -> Walk:
    """Motions one way, to an end of the span or of the family.

    Args:
        course: How it is followed.
        start: With the tangent to go along.
        look: For what is critical on a segment; None: its ends are of two families.
    """
    low, high = course.span
    way = Walk([start], [], "max_points", [])
    if start.value == (high if start.turning > 0.0 else low):
        return way._replace(end="span")
    longest = _LONGEST
    while len(way.points) <= course.most:
        here = way.points[-1]
        wide = (high - low) / course.points / max(abs(here.turning), 1e-300)
        there, told, far = None, None, min(longest, wide)
        while there is None and far > _SHORTEST:
            there = onward(course, here, far)
            if there is not None and moves_on(here, there.linear):
                inside = low < there.value < high
                told = look(Segment(here, there, far)) if inside else []
                told = [] if told is None and far < _SHORT else told
                if told is None or (far > _SHORT and _far_apart(here, there)):
                    there = None
            far *= 0.5
        if there is None:
            return way._replace(end="not found")
        far *= 2.0
        longest = min(_LONGEST, 2.0 * far)
        turned = not moves_on(here, there.linear)
        if turned or not low < there.value < high:
            above = here.turning > 0.0 if turned else there.value >= high
            last = _landed(course, here, there, high if above else low)
            if last is None:
                return way._replace(end="steady motion" if turned else "not found")
            there, far = last
            told = look(Segment(here, there, far))
        way.critical.extend((len(way.points) - 1, one) for one in told or [])
        way.points.append(there)
        way.lengths.append(far)
        if there.value in (low, high):
            return way._replace(end="span")
    return way


def moves_on(here: FamilyPoint, linear: Linear) -> bool:
    """Whether a motion goes the way of another, and is no steady one.

    Where the flow has changed its sign, a steady motion lies between.
    """
    flows = here.linear.own_flow, linear.own_flow
    if flows[0] is None or flows[1] is None:
        return True
    return bool(flows[0] @ flows[1] > _STEADY * (flows[0] @ flows[0]))


def _far_apart(here: FamilyPoint, there: FamilyPoint) -> bool:
    """Whether multipliers move so far in a step that what they pass may be missed."""
    first, last = here.exponents, there.exponents
    if first.size != last.size or not first.size:
        return False
    turn: np.ndarray = np.imag(first)[:, None] - np.imag(last)
    turn = (turn + np.pi) % (2.0 * np.pi) - np.pi
    # what decays at once says little by how fast
    rates = [np.clip(np.real(part), -3.0, 3.0) for part in (first, last)]
    grown = rates[0][:, None] - rates[1]
    return bool(np.max(np.min(np.hypot(grown, turn), axis=1)) > _MOVED)


def _landed(
    course: Course, here: FamilyPoint, there: FamilyPoint, value: float
) -> tuple[FamilyPoint, float] | None:
    """The motion with a value of what is varied, near one, and how far from it."""
    sizes = here.linear.sizes
    far = (value - here.value) / here.turning if here.turning else 0.0
    step = np.clip(far, -_LONGEST, _LONGEST) * here.tangent * sizes
    held = (*course.held, course.varied._replace(value=value))
    for guess in (stepped_nodes(course.shot, here.nodes, step), here.nodes):
        try:
            solved = solve(course.shot, guess, held, closeness(course.shot))
            if not (solved.converged and moves_on(here, solved.linear)):
                continue
            nodes = solved.nodes
            _refuse_lost(course, nodes, solved.linear)
            motion = motion_of(course.shot, solved, held, course.families)
            linear = linearized(course.shot, nodes, course.held)
            chord = secant(course, here.nodes, nodes, linear.sizes)
            length = float(np.linalg.norm(chord))
            if length > 0.0:
                last = _placed(course, motion, nodes, linear, chord / length)
                if last is not None:
                    return last._replace(motion=motion, value=value), length
        except LostSymmetry:
            raise
        except FieldError:
            continue
    return None
