"""Unknowns of a periodic motion from which Newton's method begins."""

import numpy as np

from ..kinematics.coordinates import State
from .closing_newton import coordinates_of, scales
from .newton import SMALL
from .orbit_symmetries import spread
from .shooting import Nodes, Shooting, closing, offset, segment
from .symmetries import Symmetries


def first_nodes(shot: Shooting, start: State, period: float, segments: int) -> Nodes:
    """Nodes along the run from the guess, and the displacement that fits its end."""
    K = len(shot.group)
    states = spread(shot, start, period, segments)
    nodes = Nodes(tuple(states), period, np.zeros(K))
    if not K:
        return nodes
    end = segment(shot, nodes, segments - 1, start).end
    tries = [_displaced(shot, nodes, end, s) for s in _beginnings(shot.group)]
    best = min(tries, key=lambda one: one[1])
    return nodes._replace(steps=best[0])


def _beginnings(group: Symmetries) -> list[np.ndarray]:
    """Displacements from which turns of any angle are found."""
    turns = [k for k, name in enumerate(group.names) if "about" in name]
    found = [np.zeros(len(group))]
    for k in turns:
        found += [a * np.eye(len(group))[k] for a in (-2.0, 2.0, np.pi)]
    return found


def _displaced(
    shot: Shooting, nodes: Nodes, end: State, steps: np.ndarray
) -> tuple[np.ndarray, float]:
    """The displacement that brings the start nearest to an end, and what is left."""
    left = np.inf
    around = coordinates_of(shot, end)
    size = scales(around, nodes.period)
    for _ in range(12):
        closed = closing(shot, nodes._replace(steps=steps))
        short = np.asarray(offset(shot, closed.target, end)) / size
        slopes = np.asarray(closed.by_steps) / size[:, None]
        now = float(np.linalg.norm(short))
        if not now < left:
            break
        left = now
        steps = steps + np.linalg.lstsq(slopes, short, rcond=SMALL)[0]
    return steps, left
