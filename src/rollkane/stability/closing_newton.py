"""Relative periodic motions: unknowns, equations and their solution.

Unknown are the states at the nodes, the period and the group's displacement. What is
kept makes equations dependent, and a family leaves unknowns free; both become so only
at the solution. So the method is Levenberg and Marquardt's with the square of the miss
for its parameter, which converges quadratically to solutions that are not isolated
(Yamashita and Fukushima, 2001), near the guess.
"""

from typing import NamedTuple, TypeAlias, cast

import jax.numpy as jnp
import numpy as np

from ..kinematics.coordinates import State
from ..validation.checks import FieldError
from ..validation.codes import Code, reason_of
from .independent_coordinates import VELOCITIES, IndependentCoordinates, alike
from .neutral import FLOW, Neutral, neutral
from .shooting import (
    Closing,
    Nodes,
    Quantity,
    Segment,
    Shooting,
    closing,
    measured,
    segment,
    stepped,
)

# Of the largest singular value: less is a direction that nothing determines.
_RANK = 1e-9
_MOST_STEPS = 40
_MOST_TRIES = 8
_MOST_DAMPING = 0.01
PERIOD = "period"
_Svd: TypeAlias = tuple[np.ndarray, np.ndarray, np.ndarray]


class Held(NamedTuple):
    """A quantity that keeps a value.

    Attributes:
        name: For messages.
        value: [its unit].
        quantity: Of scene, time and state; None: the period or a displacement.
        place: Number of the symmetry whose displacement it is; None: another kind.
    """

    name: str
    value: float
    quantity: Quantity | None = None
    place: int | None = None


class Linear(NamedTuple):
    """Equations at some nodes, linearized.

    Attributes:
        miss: Of every equation, shape (m,): first those of the segments.
        slopes: By all unknowns: coordinates of the nodes, period, group, (m, u).
        segments: Of the shots.
        closed: The start, moved.
        around: What is neutral at the start.
        sizes: Of the unknowns' changes that are alike, shape (u,).
        flow: Rates of the start's coordinates, shape (n,); None: of a driven scene.
    """

    miss: np.ndarray
    slopes: np.ndarray
    segments: list[Segment]
    closed: Closing
    around: Neutral
    sizes: np.ndarray
    flow: np.ndarray | None

    @property
    def scaled(self) -> np.ndarray:
        """Slopes by unknowns of like size, shape (m, u)."""
        return self.slopes * self.sizes

    def step(self, damping: float) -> np.ndarray:
        """Change of the unknowns that least squares make, with some damping [1]."""
        left, values, right = cast(_Svd, np.linalg.svd(self.scaled, False))
        kept = values > _RANK * values[0]
        filtered = np.where(kept, values / (values**2 + damping), 0.0)
        return -self.sizes * (right.T @ (filtered * (left.T @ self.miss)))

    @property
    def own_flow(self) -> np.ndarray | None:
        """The flow without what symmetries do, in changes of like size [1/s].

        None: the scene depends on time.
        """
        known = self.around
        if self.flow is None:
            return None
        rows = known.directions / self.sizes[: known.directions.shape[1]]
        others = rows[[name != FLOW for name in known.names]]
        basis = np.linalg.qr(others.T)[0]
        flow = self.flow / self.sizes[: self.flow.size]
        return flow - basis @ (basis.T @ flow)

    @property
    def rank(self) -> int:
        """Of the equations."""
        values = np.linalg.svd(self.scaled, compute_uv=False)
        return int(np.sum(values > _RANK * values[0]))


def coordinates_of(
    shot: Shooting, state: State, time: float | None = None
) -> IndependentCoordinates:
    """Around a state, at a time [s]; None: that of the start."""
    t = jnp.asarray(shot.time if time is None else time, state.orientation.dtype)
    return IndependentCoordinates(shot.scene, t, state)


def scales(around: IndependentCoordinates, period: float) -> np.ndarray:
    """Changes of the independent coordinates that are alike, shape (n,).

    As of ``alike``, with velocities that go it in T / 2 pi.
    """
    rate = 2.0 * np.pi / period
    fast = [np.full(k, name in VELOCITIES) for name, k in around.sizes.items()]
    return alike(around) * np.where(np.concatenate(fast), rate, 1.0)


def linearized(shot: Shooting, nodes: Nodes, held: tuple[Held, ...]) -> Linear:
    """All equations at some nodes, and their derivatives.

    Raises:
        FieldError: a segment whose run ends early, or has no finite derivatives.
    """
    closed = closing(shot, nodes)
    targets = (*nodes.states[1:], closed.target)
    segments = [segment(shot, nodes, k, target) for k, target in enumerate(targets)]
    for k, one in enumerate(segments):
        if int(one.code) != Code.COMPLETED:
            begun = shot.time + k * nodes.period / len(segments)
            problem = f"makes a run that ends early ({reason_of(one.code)})"
            remedy = f"look at the run from t = {begun:g} s; give another guess"
            raise FieldError("periodic_motion.guess", "...", problem, remedy)
    around = coordinates_of(shot, nodes.states[0])
    known = neutral(around, shot.group)
    n, count, K = around.count, len(segments), nodes.steps.size
    size = scales(around, nodes.period)
    unknowns = count * n + 1 + K
    group_sizes = np.ones(K)
    if K:
        moved = np.linalg.norm(np.asarray(closed.by_steps) / size[:, None], axis=0)
        group_sizes = 1.0 / np.where(moved > 0.0, moved, 1.0)
    sizes = np.concatenate([*[size] * count, [nodes.period], group_sizes])
    rows = np.zeros((count * n, unknowns))
    for k, one in enumerate(segments):
        place = slice(k * n, (k + 1) * n)
        rows[place, place] = one.by_start
        if k + 1 < count:
            rows[place, (k + 1) * n : (k + 2) * n] -= np.eye(n)
        else:
            rows[place, :n] -= closed.by_start
            rows[place, count * n + 1 :] = -np.asarray(closed.by_steps)
        rows[place, count * n] = np.asarray(one.by_time) / count
    tiled = np.tile(size, count)
    miss = np.concatenate([np.asarray(one.miss) for one in segments]) / tiled
    phases = _phases(known, size, unknowns)
    bordered, wanted, _ = borders(shot, nodes, held, size, unknowns)
    rows = np.concatenate([rows / tiled[:, None], phases, bordered])
    miss = np.concatenate([miss, np.zeros(phases.shape[0]), wanted])
    if not (np.isfinite(rows).all() and np.isfinite(miss).all()):
        problem = "makes a run that grows beyond all numbers within the period"
        remedy = "give more segments, or a guess that moves less or for a shorter time"
        raise FieldError("periodic_motion.guess", "...", problem, remedy)
    flow = None if shot.driven else known.flow
    return Linear(miss, rows, segments, closed, known, sizes, flow)


def _phases(known: Neutral, size: np.ndarray, unknowns: int) -> np.ndarray:
    """Rows that keep the start from sliding along flow and symmetries."""
    rows = np.zeros((known.directions.shape[0], unknowns))
    for row, direction in zip(rows, known.directions / size, strict=True):
        row[: size.size] = direction / np.linalg.norm(direction) / size
    return rows


def borders(
    shot: Shooting,
    nodes: Nodes,
    held: tuple[Held, ...],
    size: np.ndarray,
    unknowns: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows of what is held by all unknowns, their misses, and the units of both.

    Raises:
        FieldError: a quantity that does not change with the state.
    """
    n, count = size.size, len(nodes.states)
    rows, miss = np.zeros((len(held), unknowns)), np.zeros(len(held))
    units = np.ones(len(held))
    t = jnp.asarray(shot.time, nodes.states[0].orientation.dtype)
    for k, one in enumerate(held):
        unit = 1.0
        if one.place is not None:
            rows[k, count * n + 1 + one.place] = 1.0
            now = float(nodes.steps[one.place])
        elif one.quantity is None:
            unit, now = nodes.period, nodes.period
            rows[k, count * n] = 1.0
        else:
            value, slope = measured(one.quantity, shot.scene, t, nodes.states[0])
            now, unit = float(value), float(np.linalg.norm(np.asarray(slope) * size))
            if not unit > 0.0:
                problem = "does not change with the state at the guess"
                remedy = "hold another quantity, or give a guess off its extremum"
                field = f"periodic_motion.hold[{one.name!r}]"
                raise FieldError(field, one.value, problem, remedy)
            rows[k, :n] = np.asarray(slope)
        units[k] = unit
        rows[k] /= unit
        miss[k] = (now - one.value) / unit
    return rows, miss, units


def stepped_nodes(shot: Shooting, nodes: Nodes, step: np.ndarray) -> Nodes:
    """Nodes changed by a step of all unknowns."""
    count = len(nodes.states)
    n = (step.size - 1 - nodes.steps.size) // count
    dtype = nodes.states[0].orientation.dtype
    states: list[State] = []
    for k, state in enumerate(nodes.states):
        begun = shot.time + (k * nodes.period / count if shot.driven else 0.0)
        x = jnp.asarray(step[k * n : (k + 1) * n], dtype)
        states.append(stepped(shot.scene, jnp.asarray(begun, dtype), state, x))
    period = nodes.period + float(step[count * n])
    return Nodes(tuple(states), period, nodes.steps + step[count * n + 1 :])


class Solved(NamedTuple):
    """Where the search ended.

    Attributes:
        nodes: Unknowns.
        linear: Equations there.
        miss: What is left, in changes of like size [1].
        converged: Whether that is rounding and the tolerance of runs.
        steps: How many it took.
    """

    nodes: Nodes
    linear: Linear
    miss: float
    converged: bool
    steps: int


def solve(
    shot: Shooting,
    nodes: Nodes,
    held: tuple[Held, ...],
    close: float,
    across: np.ndarray | None = None,
) -> Solved:
    """Least squares, damped more while steps do not make the misses smaller.

    Args:
        shot: What is shot.
        nodes: The guess.
        held: Quantities that keep a value.
        close: Largest miss that is no more than errors of the runs [1].
        across: A row, whose product with all changes is to be zero; of continuation.
    """
    linear = linearized(shot, nodes, held)
    size = _size(linear)
    count, damping = 0, 1.0
    while count < _MOST_STEPS:
        found = None
        damping = max(1.0, 0.1 * damping)
        for _ in range(_MOST_TRIES):
            step = _step(linear, across, damping * min(size * size, _MOST_DAMPING))
            tried = _tried(shot, nodes, held, step)
            if tried is not None and _size(tried[1]) < size:
                found = tried
                break
            if size <= close:
                break
            damping *= 10.0
        count += 1
        if found is None:
            break
        before, (nodes, linear) = size, found
        size = _size(linear)
        if size <= close and size > 0.2 * before:
            break
    return Solved(nodes, linear, size, size <= close, count)


def _size(linear: Linear) -> float:
    """Of all that does not close, as a root of squares."""
    beside = [float(one.beside) for one in linear.segments]
    size = float(np.linalg.norm([*linear.miss, *beside]))
    return size if np.isfinite(size) else np.inf


def _step(linear: Linear, across: np.ndarray | None, damping: float) -> np.ndarray:
    if across is None:
        return linear.step(damping)
    bordered = np.concatenate([linear.slopes, across[None]])
    miss = np.append(linear.miss, 0.0)
    return linear._replace(slopes=bordered, miss=miss).step(damping)


def _tried(
    shot: Shooting, nodes: Nodes, held: tuple[Held, ...], step: np.ndarray
) -> tuple[Nodes, Linear] | None:
    """Nodes and equations after a step; None: it cannot be taken."""
    if not np.all(np.isfinite(step)):
        return None
    changed = stepped_nodes(shot, nodes, step)
    if not 0.5 < changed.period / nodes.period < 2.0:
        return None
    try:
        return changed, linearized(shot, changed, held)
    except FieldError:
        return None
