"""Families of relative periodic motions: over an energy, a period, a displacement."""

import dataclasses
from collections.abc import Mapping
from os import PathLike
from typing import Any, cast

import numpy as np

from ..dynamics.scene import Scene
from ..validation.checks import FieldError, real, whole
from .branch_segments import Passing, Segment
from .closing_newton import PERIOD, Held
from .critical_points import bisected, critical_on
from .floquet import FAMILY
from .narrow_windows import windows
from .orbit_symmetries import refuse_lost_later
from .periodic import PeriodicMotion
from .periodic_holds import held_of
from .periodic_walk import Course, FamilyPoint, onward, start_of, walked
from .refusals import refuse_other_scene

_FIELD = "periodic_family"
# Of the span: two critical values that are one, found by a crossing and in a window.
_SAME = 1e-10


@dataclasses.dataclass(frozen=True)
class CriticalPeriod:
    """Where a multiplier passes the unit circle, or a family turns back.

    Attributes:
        kind: What passes: ``"one"`` (a branching), ``"minus one"`` (period doubling),
            ``"pair"``; or ``"fold"``: what is varied turns back, and of an energy a
            multiplier passes one there.
        value: Of what is varied [its unit].
        multiplier: That passes, there [1].
        motion: There.
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
        points: How many steps the span is wide, at least. Steps are so short, too,
            that no multiplier turns by more than 0.7 rad in one. Two changes within one
            show by a dip of what passes zero and comes back, and are located; of three
            or more within two steps, or in a window in which nothing grows beyond
            rounding, some may be missed.
        max_points: Most motions each way.

    Raises:
        FieldError: names that are not known, another scene than the motion's, a motion
            outside of the span, nothing left free, a quantity that does not change; a
            member that goes where a symmetry does not hold that the first one counts:
            to first order all along it, and near it in some later periods.
    """
    if not isinstance(cast(object, motion), PeriodicMotion):
        remedy = "give what periodic_motion returns"
        raise FieldError(f"{_FIELD}.motion", motion, "is no periodic motion", remedy)
    refuse_other_scene(f"{_FIELD}.scene", scene, motion.scene)
    vary = vary.removeprefix("hold.")
    low, high = (float(real(f"{_FIELD}.span", x, (), "two numbers")) for x in span)
    shot = motion.shooting
    (varied,) = _held(motion, {vary: None})
    if not low <= varied.value <= high or not low < high:
        problem = f"does not hold the motion's own value {varied.value:.9g}"
        remedy = "begin from a motion within the span, or widen it"
        raise FieldError(f"{_FIELD}.span", span, problem, remedy)
    held = _held(motion, hold or {})
    if shot.driven:
        held = _with_period(motion, vary, held)
    points = whole(f"{_FIELD}.points", points, 1, "give 1 or more")
    most = whole(f"{_FIELD}.max_points", max_points, 1, "give 1 or more")
    families = motion.expected.count(FAMILY)
    course = Course(shot, held, varied, (low, high), points, most, families)
    return _family(vary, course, start_of(course, motion, vary))


def _with_period(
    motion: PeriodicMotion, vary: str, held: tuple[Held, ...]
) -> tuple[Held, ...]:
    """What is held of a scene that depends on time: its own period, too.

    Raises:
        FieldError: another period is asked for, by which the scene does not repeat.
    """
    others = [one for one in held if one.name == PERIOD]
    if vary == PERIOD or any(one.value != motion.period for one in others):
        problem = "is that of what drives the scene, and no other"
        remedy = "vary another quantity"
        raise FieldError(f"{_FIELD}.vary", PERIOD, problem, remedy)
    kept = (one for one in held if one.name != PERIOD)
    return (*kept, Held(PERIOD, motion.period))


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


_KINDS = {"fold": "fold", "Hopf": "pair", "collision": "pair"}


def _looked(course: Course, segment: Segment[FamilyPoint]) -> Any:
    """What is critical between two neighbours; None: they are of two families."""

    def way(base: FamilyPoint, far: float) -> FamilyPoint | None:
        return onward(course, base, far)

    told = critical_on(way, segment)
    first, last = segment.first, segment.last
    if told is None or first.motion.stable == last.motion.stable:
        return told
    return told or bisected(way, segment)


def _family(vary: str, course: Course, start: FamilyPoint) -> PeriodicFamily:
    """The family both ways, and what is critical on it."""

    def look(segment: Segment[FamilyPoint]) -> Any:
        return _looked(course, segment)

    def way(base: FamilyPoint, far: float) -> FamilyPoint | None:
        return onward(course, base, far)

    back, ahead = (walked(course, one, look) for one in (start.turned, start))
    line = [*(one.turned for one in back.points[:0:-1]), *ahead.points]
    lengths = [*back.lengths[::-1], *ahead.lengths]
    first = len(back.lengths)
    told = [(first - k - 0.5, one) for k, one in back.critical]
    told += [(first + k + 0.5, one) for k, one in ahead.critical]
    told += windows(way, line, lengths)
    low, high = course.span
    found: list[CriticalPeriod] = []
    for _, one in sorted(told, key=lambda placed: placed[0]):
        made = _critical(one)
        near = [
            c
            for c in found
            if c.kind == made.kind and abs(c.value - made.value) <= _SAME * (high - low)
        ]
        if low <= made.value <= high and not near:
            found.append(made)
    members = [(one.value, one.nodes) for one in line]
    refuse_lost_later("periodic_family.span", course.shot, members)
    points = tuple(one.motion for one in line)
    return PeriodicFamily(vary, points, tuple(found), (back.end, ahead.end))


def _critical(one: Passing[FamilyPoint]) -> CriticalPeriod:
    kind = _KINDS.get(one.kind)
    if kind is None:
        kind = "one" if abs(one.exponent.imag) < 0.5 * np.pi else "minus one"
    point = one.point
    return CriticalPeriod(kind, point.value, np.exp(one.exponent), point.motion)
