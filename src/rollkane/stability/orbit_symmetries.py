"""Symmetries that hold all along an orbit, not at its start alone."""

import jax
import numpy as np

from ..kinematics.coordinates import State
from .shooting import Nodes, Shooting, segment
from .symmetries import symmetries_at

# States of an orbit near which symmetries have to hold.
_SEEN = 8


def orbit(shot: Shooting, start: State, period: float) -> list[tuple[float, State]]:
    """Times [s] and states along a run of a period, as far as it goes."""
    states = spread(shot, start, period, _SEEN)
    lengths = period / _SEEN * np.arange(_SEEN) if shot.driven else np.zeros(_SEEN)
    good = [all(np.all(np.isfinite(x)) for x in jax.tree.leaves(y)) for y in states]
    both = zip(lengths, states, good, strict=True)
    return [(shot.time + float(t), state) for t, state, fine in both if fine]


def verified_near(shot: Shooting, seen: list[tuple[float, State]]) -> Shooting:
    """What is shot, with the symmetries that hold near all of some states."""
    times, states = zip(*seen, strict=True)
    stacked = jax.tree.map(lambda *parts: np.stack(parts), *states)
    group = symmetries_at(shot.scene, np.array(times), stacked)
    return shot._replace(group=group, driven=group.drift is None)


def spread(shot: Shooting, start: State, period: float, count: int) -> list[State]:
    """States along a run from a start, after each of equal parts of a period."""
    states, still = [start], np.zeros(len(shot.group))
    for k in range(count - 1):
        so_far = Nodes(tuple(states), period / count * (k + 1), still)
        states.append(segment(shot, so_far, k, states[-1]).end)
    return states
