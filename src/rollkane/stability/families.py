"""Families of steady motions: branches over a held quantity or a parameter."""

import dataclasses
import difflib
from typing import Any, NamedTuple, NoReturn, cast

import numpy as np

from ..identification import paths
from ..validation.checks import FieldError, whole
from .branch import Branch, BranchPoint, Critical
from .branch_segments import Passing, Segment
from .continuation import (
    is_near,
    made,
    nullity,
    refuse_span,
    step_from,
    tangents,
    walked,
)
from .critical_points import critical_on
from .kept_symmetries import refuse_lost, refuse_lost_on
from .local_model import with_parameter
from .narrow_windows import windows
from .newton import SOLVED, Asked, solved
from .quantities import quantity
from .refusals import refuse_moving, refuse_other_scene
from .steady import SteadyMotion

# Of the largest singular value: a second direction at a bifurcation. Located to
# SOLVED, 1e-10, beside curvatures of up to 1e3 it is 1e-7; what counts is seldom below
# 1e-4.
_NEAR = 1e-6
# Of the span: two critical values that are one, found by a crossing and in a window,
# each located to rounding.
_SAME = 1e-10


def steady_family(
    scene: Any,
    motion: SteadyMotion,
    vary: str,
    span: tuple[float, float],
    *,
    points: int = 100,
    max_points: int = 500,
) -> Branch:
    """The branch of steady motions through one of them.

    By pseudo-arclength continuation both ways, round folds, to the ends of the span,
    or as far as ``Branch.ends`` says. Two equal eigenvalues that pass zero together, as
    where body and base are surfaces of revolution, are located where stability changes
    with them; without damping it may not, and ``BranchPoint.eigenvalues`` come near to
    zero there.

    Args:
        scene: As for ``steady_motion``, of which ``motion`` is.
        motion: A steady motion of it, within the span; what it holds stays held.
        vary: ``"hold.NAME"``: a held quantity, or another one that is then held as
            well; else a number of the scene by its path: ``"body.mass"``,
            ``"base.motion.rate"``, ``"loads[0].acceleration[2]"``.
        span: Least and largest value of it [its unit].
        points: How many steps the span is wide, at least: folds and crossings are
            located whatever it is. Two within one step show by a dip of what passes
            zero and comes back, and are located, too, down to some 1e-5 of the step;
            where it does not dip (a step over more than one change), or of three or
            more within two steps, some may be missed: give more points.
        max_points: Most points each way.

    Returns:
        ``Branch``: its points, and critical values located to rounding.

    Raises:
        FieldError: a name that nothing has, another scene than the motion's, a motion
            outside of the span, more or less left free than one dimension.

    Source: docs/theory.md, (10.2) to (10.5).
    """
    if not isinstance(cast(object, motion), SteadyMotion):
        remedy = "give what steady_motion returns"
        raise FieldError("steady_family.motion", motion, "is no steady motion", remedy)
    refuse_other_scene("steady_family.scene", scene, motion.problem.model)
    points, most = _counts("steady_family", points, max_points)
    low, high = _checked_span(span)
    asked, p = _asked(motion, vary, high - low)
    if not low <= p <= high:
        problem = f"does not hold the motion's own value {p:.9g}"
        remedy = "begin from a motion within the span, or widen it"
        raise FieldError("steady_family.span", span, problem, remedy)
    found = solved(asked, motion.state, motion.solution.xi, p)
    refuse_moving("steady_family.vary", asked, found.point)
    refuse_span(asked, found.point, vary)
    start = made(asked, found.point, None)
    back = dataclasses.replace(start, tangent=-start.tangent)
    plan = _Plan(vary, asked, (low, high), points, most)
    return _both_ways(plan, start, back, [start])


def switch_branch(
    branch: Branch, critical: Critical, *, points: int = 100, max_points: int = 500
) -> Branch:
    """The other branch through a simple bifurcation.

    Args:
        branch: Where the bifurcation was found.
        critical: One of its zero crossings, or a fold.
        points: How many steps the span is wide, at least [1].
        max_points: Most points each way [1].

    Raises:
        FieldError: no other branch leaves there, or several, as where two equal
            eigenvalues pass zero; what is no branch, or not critical.
    """
    if not isinstance(cast(object, branch), Branch):
        remedy = "give what steady_family returns"
        raise FieldError("switch_branch.branch", branch, "is no Branch", remedy)
    if not isinstance(cast(object, critical), Critical):
        remedy = "give one of branch.critical"
        raise FieldError("switch_branch.critical", critical, "is no Critical", remedy)
    points, most = _counts("switch_branch", points, max_points)
    asked, here = branch.asked, critical.point
    ways = nullity(asked, here.solution, _NEAR)
    if ways != 2:
        _refuse_switch(critical, together=ways > 2)
    both = tangents(asked, here.solution, 2)
    known = here.tangent
    other = both - np.outer(both @ known, known)
    way = other[int(np.argmax(np.linalg.norm(other, axis=1)))]
    way = way / np.linalg.norm(way)
    starts: list[BranchPoint] = []
    for sign in (1.0, -1.0):
        turned = dataclasses.replace(here, tangent=sign * way)
        # of the branch's unit: off the crossing the direction is right to first order,
        # so that a step misses by its square, 1e-4, in reach of Newton's method; where
        # the branch curves at once, a tenth of it
        for far in (1e-2, 1e-3):
            off = step_from(asked, turned, far)
            if not (off.error < SOLVED and is_near(asked, turned, off, far)):
                continue
            moved = made(asked, off.point, turned.tangent)
            # not back on the known branch, whose tangent turns little in such a step
            if abs(moved.tangent @ known) < 0.9:
                starts.append(moved)
                break
    if len(starts) < 2:
        _refuse_switch(critical)
    plan = _Plan(branch.vary, asked, branch.span, points, most)
    first, last = starts
    return _both_ways(plan, first, last, [_turned(last), here, first])


def _refuse_switch(critical: Critical, together: bool = False) -> NoReturn:
    why, remedy = (
        "has no other branch",
        "switch at a zero crossing where what is varied does not turn",
    )
    if together:
        why = "is where several eigenvalues pass zero together"
        remedy = "look for a motion beside it with steady_motion, and follow that one"
    raise FieldError("switch_branch.critical", critical.kind, why, remedy)


def _counts(field: str, points: Any, max_points: Any) -> tuple[int, int]:
    """How many steps and points, at least and at most."""
    remedy = "give 1 or more"
    return (
        whole(f"{field}.points", points, 1, remedy),
        whole(f"{field}.max_points", max_points, 1, remedy),
    )


class _Plan(NamedTuple):
    vary: str
    asked: Asked
    span: tuple[float, float]
    points: int
    most: int


def _turned(point: BranchPoint) -> BranchPoint:
    return dataclasses.replace(point, tangent=-point.tangent)


def _both_ways(
    plan: _Plan, ahead: BranchPoint, back: BranchPoint, middle: list[BranchPoint]
) -> Branch:
    """A branch from both of its starts outwards, and what lies between them."""
    dimensions = ahead.told.counts

    def onward(base: BranchPoint, far: float) -> BranchPoint | None:
        solution = step_from(plan.asked, base, far)
        if not solution.error < SOLVED:
            return None
        return made(plan.asked, solution.point, base.tangent, dimensions)

    def look(segment: Segment[BranchPoint]) -> list[Critical] | None:
        told = critical_on(onward, segment)
        return None if told is None else [_critical(one) for one in told]

    how = plan.span, plan.points, plan.most, dimensions, look
    forward = walked(plan.asked, ahead, *how)
    backward = walked(plan.asked, back, *how)
    points = [_turned(p) for p in backward.points[:0:-1]] + middle + forward.points[1:]
    is_back = middle[0].tangent[-1] < 0.0 and len(middle) == 1
    if is_back:
        points = [_turned(p) for p in points[::-1]]
    told = [(-k - 0.5, one) for k, one in backward.critical[::-1]]
    told += [(k + 0.5, one) for k, one in forward.critical]
    for sign, way, other in ((-1.0, backward, None), (1.0, forward, backward)):
        line, lengths, k = way.points, way.lengths, 0
        if other is not None and len(middle) == 1 and other.lengths:
            # the start, too, lies between two
            line = [_turned(other.points[1]), *line]
            lengths, k = [other.lengths[0], *lengths], 1
        inside = windows(onward, line, lengths)
        told += [(sign * (place - k), _critical(one)) for place, one in inside]
    found = _in_order(told, plan)
    if is_back:
        found = found[::-1]
    ends = backward.end, forward.end
    if is_back:
        ends = forward.end, backward.end
    _refuse_lost(plan, points)
    return Branch(plan.vary, tuple(points), tuple(found), plan.asked, plan.span, ends)


def _refuse_lost(plan: _Plan, points: list[BranchPoint]) -> None:
    """Refuse a branch that leads to where a symmetry does not hold that it counts.

    Each point's own rates are looked at as it is found; here also what is near it, and
    round the motions at both ends.
    """
    field, problem = "steady_family.span", plan.asked.problem
    for point in (points[0], points[-1]):
        there = with_parameter(problem, plan.asked.keys, point.value)
        at = point.state, point.solution.xi
        refuse_lost(field, float(point.value), there, *at)
    if plan.asked.keys is None:
        members = [(float(point.value), point.solution) for point in points]
        refuse_lost_on(field, problem, members)


def _critical(one: Passing[BranchPoint]) -> Critical:
    point = one.point
    return Critical(one.kind, point.value, point.state, one.exponent, point)


def _in_order(told: list[tuple[float, Critical]], plan: _Plan) -> list[Critical]:
    """What is critical within the span, by its place, each once."""
    low, high = plan.span
    found: list[Critical] = []
    for _, one in sorted(told, key=lambda placed: placed[0]):
        same = [c for c in found if c.kind == one.kind]
        close = [abs(c.value - one.value) <= _SAME * (high - low) for c in same]
        if low <= one.value <= high and not any(close):
            found.append(one)
    return found


def _checked_span(span: Any) -> tuple[float, float]:
    try:
        low, high = (float(end) for end in span)
    except (TypeError, ValueError):
        low = high = np.nan
    if not (np.isfinite(low) and np.isfinite(high) and low < high):
        remedy = "give (least, largest)"
        raise FieldError("steady_family.span", span, "is no range", remedy)
    return low, high


def _asked(motion: SteadyMotion, vary: str, width: float) -> tuple[Asked, float]:
    """What is solved along a family, and the value to begin at."""
    asked, state = motion.asked, motion.state
    field = "steady_family.vary"
    if vary.startswith("hold."):
        name = vary.removeprefix("hold.")
        names = [q.name for q in asked.quantities]
        if name in names:
            k = names.index(name)
            own = float(motion.solution.local.held[k])
            return asked._replace(varied=k, unit=width), own
        extra = quantity(field, asked.problem, state, name)
        quantities = *asked.quantities, extra
        values = np.zeros(len(quantities))
        values[:-1] = asked.values
        more = asked._replace(
            quantities=quantities, values=values, varied=len(names), unit=width
        )
        first = solved(more, state, motion.solution.xi, 0.0, tries=0).point
        return more, float(first.local.held[-1])
    try:
        keys = paths.keys_of(vary)
        value = paths.found(asked.problem.model, keys)
    except (FieldError, LookupError):
        value = ()
    if not paths.is_floating(np.asarray(value)) or np.shape(value):
        known = list(paths.floats(asked.problem.model))
        held = [f"hold.{q.name}" for q in asked.quantities]
        near = difflib.get_close_matches(vary, [*held, *known], n=1, cutoff=0.5)
        meant = f"did you mean {near[0]!r}? " if near else ""
        remedy = f"{meant}name one number: {', '.join([*held, *known])} (with an index)"
        raise FieldError(field, vary, "is nothing that can be varied", remedy)
    keys = paths.keys_of(vary)
    return asked._replace(keys=keys, unit=width), float(cast(float, value))
