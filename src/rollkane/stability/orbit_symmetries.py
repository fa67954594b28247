"""Symmetries that hold all along an orbit, not at its start alone."""

import itertools

import jax
import numpy as np

from ..kinematics.coordinates import State
from .closing_newton import Linear, coordinates_of, scales
from .kept_symmetries import LostSymmetry, lost_rows
from .neutral import tangents
from .shooting import Nodes, Shooting, closing, segment
from .symmetries import symmetries_at

# States of an orbit near which symmetries have to hold; and where one is lost that
# held near those, how many are looked at to find which do hold.
_SEEN, _MANY = 8, 64
# Later periods that are looked at, as one goes where the first one did not. What turns
# has gone round in them, or is as dense there.
_PERIODS = 16
# Of a displacement [m] or [rad]: what is less is rounding of runs.
_STILL = 1e-9
# A run's error over its tolerance, at most, in what comes back from a period, beside
# all that does: ten thousand times the largest seen in 1e3 motions.
_ERRORS = 1e3


def orbit(
    shot: Shooting, start: State, period: float, count: int = _SEEN
) -> list[tuple[float, State]]:
    """Times [s] and states along a run of a period, as far as it goes."""
    states = spread(shot, start, period, count)
    lengths = period / count * np.arange(count) if shot.driven else np.zeros(count)
    good = [all(np.all(np.isfinite(x)) for x in jax.tree.leaves(y)) for y in states]
    both = zip(lengths, states, good, strict=True)
    return [(shot.time + float(t), state) for t, state, fine in both if fine]


def relative_orbit(
    shot: Shooting, nodes: Nodes, many: bool = False
) -> list[tuple[float, State]]:
    """Times [s] and states of a relative periodic motion, in later periods, too.

    A symmetry moves those to where no state of the first one is.
    """
    count = _MANY if many else _SEEN
    seen = orbit(shot, nodes.states[0], nodes.period, count)
    steps = nodes.steps
    if not np.any(np.abs(steps) > _STILL):
        return seen
    turns = [k for k, name in enumerate(shot.group.names) if "about" in name]
    widest = float(np.abs(steps[turns]).max(initial=0.0))
    once = 2.0 * np.pi / widest if widest > _STILL else 0.0
    stride = max(1, int(np.ceil(once / _PERIODS)))
    moved: list[tuple[float, State]] = []
    for k in range(1, _PERIODS + 1):
        time, state = seen[k % len(seen)]
        there = Nodes((state,), nodes.period, stride * k * steps)
        moved.append((time, closing(shot, there).target))
    return seen + moved


def verified_near(shot: Shooting, seen: list[tuple[float, State]]) -> Shooting:
    """What is shot, with the symmetries that hold near all of some states."""
    times, states = zip(*seen, strict=True)
    stacked = jax.tree.map(lambda *parts: np.stack(parts), *states)
    group = symmetries_at(shot.scene, np.array(times), stacked)
    return shot._replace(group=group, driven=group.drift is None)


def refuse_lost_later(
    field: str, shot: Shooting, members: list[tuple[float, Nodes]]
) -> None:
    """Refuse members of a family that a symmetry moves to where it does not hold.

    Of those that come back where they were nothing is asked but their own period.

    Args:
        field: What led there.
        shot: With the symmetries that are counted.
        members: Each with the value of what led there.

    Raises:
        LostSymmetry: with their names.
    """
    moving = [one for one in members if np.any(np.abs(one[1].steps) > _STILL)]
    seen = [relative_orbit(shot, nodes) for _, nodes in moving]
    if not seen or not _lost_near(shot, list(itertools.chain(*seen))):
        return
    for (value, _), places in zip(moving, seen, strict=True):
        lost = _lost_near(shot, places)
        if lost:
            raise LostSymmetry(field, value, lost)


def _lost_near(shot: Shooting, seen: list[tuple[float, State]]) -> list[str]:
    now = verified_near(shot, seen).group
    gone = lost_rows(shot.group.action, now.action)
    return [name for name, lost in zip(shot.group.names, gone, strict=True) if lost]


def spread(shot: Shooting, start: State, period: float, count: int) -> list[State]:
    """States along a run from a start, after each of equal parts of a period."""
    states, still = [start], np.zeros(len(shot.group))
    for k in range(count - 1):
        so_far = Nodes(tuple(states), period / count * (k + 1), still)
        states.append(segment(shot, so_far, k, states[-1]).end)
    return states


def strays(shot: Shooting, nodes: Nodes, linear: Linear) -> np.ndarray:
    """How far each generator comes back from a period as something else, shape (K,).

    A symmetry that holds all along the motion carries its tangent at the start into
    its tangent at the end, to first order in all that is beside the motion.
    """
    if not len(shot.group):
        return np.zeros(0)
    last = shot.time + (nodes.period if shot.driven else 0.0)
    size = scales(coordinates_of(shot, nodes.states[0]), nodes.period)
    first = tangents(coordinates_of(shot, nodes.states[0]), shot.group)
    end = tangents(coordinates_of(shot, linear.closed.target, last), shot.group)
    moved = first
    for one in linear.segments:
        moved = moved @ np.asarray(one.by_start).T
    length = np.linalg.norm(first / size, axis=1)
    apart = np.linalg.norm((moved - end) / size, axis=1)
    return apart / np.where(length > 0.0, length, 1.0)


def refuse_strays(
    field: str, value: float, shot: Shooting, nodes: Nodes, linear: Linear
) -> None:
    """Refuse a motion somewhere along which a symmetry does not hold that is counted.

    Args:
        field: What led there.
        value: Of it, there.
        shot: With the symmetries that are counted.
        nodes: Of the motion.
        linear: Its equations.

    Raises:
        LostSymmetry: with their names.
    """
    rtol = shot.options.rtol
    most = _ERRORS * (1e-12 if rtol is None else float(rtol))
    size = scales(coordinates_of(shot, nodes.states[0]), nodes.period)
    grown = np.eye(size.size)
    for one in linear.segments:
        grown = (np.asarray(one.by_start) / size[:, None] * size) @ grown
    largest = max(1.0, float(np.linalg.norm(grown, 2)))
    gone = strays(shot, nodes, linear) > most * largest
    names = [name for name, lost in zip(shot.group.names, gone, strict=True) if lost]
    if names:
        raise LostSymmetry(field, value, names)
