"""Pseudo-arclength continuation of steady motions: one step, and the way along it."""

from collections.abc import Callable
from typing import NamedTuple, TypeAlias

import numpy as np

from ..validation.checks import FieldError
from .branch import BranchPoint, Critical
from .branch_segments import Segment
from .kept_symmetries import refuse_strays
from .newton import SMALL, Asked, Point, Solved, equations, solved, unit_steps
from .refusals import told as told_of
from .steady import SOLVED, spectrum_at

_TURN = 0.95  # least cosine between tangents of successive points
# Of a step along the tangent: how far the next point may be. Where the tangent turns by
# arccos 0.95, 18 degrees, the chord turns by half of that, or by all of it where the
# branch is bent at one end alone: 1 / 0.95. What is further off is another branch.
_CHORD = 1.0 / _TURN
_FEWEST = 1e-9  # smallest step, of the branch's unit, before it is given up


def tangents(asked: Asked, point: Point, count: int) -> np.ndarray:
    """Directions (x, xi, p) in which the equations stay solved, scaled, one row each.

    Args:
        asked: What is solved.
        point: A solution.
        count: How many are wanted: those of the smallest singular values.
    """
    matrix, _ = equations(asked, point)
    across = np.linalg.svd(matrix, full_matrices=True)[2]
    return across[across.shape[0] - count :]


def nullity(asked: Asked, point: Point, small: float = SMALL) -> int:
    """In how many directions the equations stay solved, by rank."""
    matrix, _ = equations(asked, point)
    values = np.linalg.svd(matrix, compute_uv=False)
    return matrix.shape[1] - int(np.sum(values > small * values[0]))


def is_near(asked: Asked, point: BranchPoint, tried: Solved, far: float) -> bool:
    """Whether a step of this length ended where its branch may be."""
    chord = tried.moved / unit_steps(asked, point.solution)
    return float(np.linalg.norm(chord)) < _CHORD * far


def refuse_span(asked: Asked, point: Point, vary: str) -> None:
    """Refuse a branch that is none: of no direction, or of more than one."""
    count = nullity(asked, point)
    if count == 1:
        return
    if count == 0:
        problem = "does not change along any family: more is held than is free"
        raise FieldError("steady_family.vary", vary, problem, "hold less")
    names = [
        *asked.names,
        *(f"velocity of {name}" for name in asked.problem.group),
        vary,
    ]
    ways = "; ".join(told_of(row, names) for row in tangents(asked, point, count))
    problem = (
        f"leaves a family of {count} dimensions free where a branch has one "
        f"(directions: {ways})"
    )
    remedy = f"hold {count - 1} more, in steady_motion(hold=...)"
    raise FieldError("steady_family.vary", vary, problem, remedy)


def step_from(asked: Asked, point: BranchPoint, far: float) -> Solved:
    """The solution a way along the tangent of a point, on the plane across it."""
    start, unit = point.solution, unit_steps(asked, point.solution)
    n = start.local.slope.shape[0]
    move = point.tangent * unit * far
    return solved(
        asked,
        start.state,
        start.xi + move[n:-1],
        start.p + move[-1],
        step=move[:n],
        border=point.tangent / unit,
    )


def made(
    asked: Asked,
    found: Point,
    before: np.ndarray | None,
    dimensions: tuple[int, ...] | None = None,
) -> BranchPoint:
    """A point of a branch, with a tangent that goes on as before.

    Raises:
        LostSymmetry: it is where a symmetry that the branch counts does not hold.
    """
    refuse_strays("steady_family.span", found.p, asked.problem, found)
    told_ = spectrum_at(asked, found, dimensions)
    (tangent,) = tangents(asked, found, 1)
    if before is not None and float(tangent @ before) < 0.0:
        tangent = -tangent
    problem = asked.problem
    names = [q.name for q in asked.quantities]
    return BranchPoint(
        value=found.p,
        state=found.state,
        generator=dict(zip(problem.group, found.xi.tolist(), strict=True)),
        held=dict(zip(names, found.local.held.tolist(), strict=True)),
        eigenvalues=told_.eigenvalues,
        stable=told_.unstable == 0,
        solution=found,
        told=told_,
        tangent=tangent,
    )


Look: TypeAlias = Callable[[Segment[BranchPoint]], list[Critical] | None]


class Walk(NamedTuple):
    """A way along a branch.

    Attributes:
        points: On it.
        critical: What is critical, each with the number of the point before.
        end: Why it ends.
        lengths: How far along its tangent from each point to the next.
    """

    points: list[BranchPoint]
    critical: list[tuple[int, Critical]]
    end: str
    lengths: list[float]


def walked(
    asked: Asked,
    start: BranchPoint,
    span: tuple[float, float],
    points: int,
    most: int,
    dimensions: tuple[int, ...],
    look: Look,
) -> Walk:
    """From a start along its tangent, to an end of the span or of the branch.

    Args:
        asked: What is solved.
        start: With the tangent to go along.
        span: Of the parameter.
        points: How many steps the span is wide, at least.
        most: How many points there may be.
        dimensions: Counts of the family that leaves zeros among the eigenvalues.
        look: For what is critical on a segment; None: its ends are of two branches.
    """
    low, high = span
    longest = (high - low) / asked.unit / points
    way, step = Walk([start], [], "max_points", []), longest
    while len(way.points) <= most and step > _FEWEST:
        here = way.points[-1]
        far = min(step, longest / max(abs(float(here.tangent[-1])), 0.1))
        tried = step_from(asked, here, far)
        next_ = here
        if tried.error < SOLVED and is_near(asked, here, tried, far):
            next_ = made(asked, tried.point, here.tangent, dimensions)
        told = None
        if next_ is not here and float(next_.tangent @ here.tangent) > _TURN:
            told = look(Segment(here, next_, far))
        if told is None:
            step = 0.5 * far
            continue
        way.critical.extend((len(way.points) - 1, one) for one in told)
        if not low <= next_.value <= high:
            end = low if next_.value < low else high
            landed = _landed(asked, here, tried, end)
            solved_there = landed.error < SOLVED
            if solved_there and here.value != end:
                last = made(asked, landed.point, here.tangent, dimensions)
                way.points.append(last)
                share = (end - here.value) / (next_.value - here.value)
                way.lengths.append(share * far)
            reached = solved_there or here.value == end
            return way._replace(end="span" if reached else "not found")
        way.points.append(next_)
        way.lengths.append(far)
        step = 2.0 * far
    return way if step > _FEWEST else way._replace(end="not found")


def _landed(asked: Asked, here: BranchPoint, tried: Solved, end: float) -> Solved:
    """The solution at an end of the span, between a point and a next one."""
    start = here.solution
    n = start.local.slope.shape[0]
    move = tried.moved * ((end - here.value) / (tried.point.p - here.value))
    return solved(asked, start.state, start.xi + move[n:-1], end, step=move[:n])
