"""Newton's method for steady motions, on the host: bordered, damped, of any rank.

Unknown are the step x in independent coordinates, the group velocities xi and, along a
family, a parameter p. Symmetries and families make the equations singular by nature:
the rank is decided at every step, and what it leaves open is not moved.
"""

from typing import Any, NamedTuple, cast

import numpy as np

from ..identification import paths
from .local_model import LocalModel, LocalProgram, local_program
from .problem import AbstractProblem
from .quantities import Quantity
from .surface_motions import echelon

# Shares of the largest singular value, of equations whose rows have unit length: what
# is less is zero. In double precision zeros are 1e-13 or less where curvatures are of
# order one; directions that count are seldom below 1e-4.
SMALL = 1e-8
_TRIES = 60
# What the shortest row of the rates counts as, beside the longest: rounding of some 10
# operations, 1e-15 of the longest row, is then no direction (1e-8) in any. With ten
# times as much a search on a slope (1 in 9) ran away to a spin of 1e11 rad/s, beside
# which what was left counted as solved.
_SHORTEST = 1e-6
# Least and largest damping, beside squares of singular values up to some tens. Less
# does not change a step that counts, of a value above 1e-2, by 1% of it; with more a
# step is a millionth of what is asked for, and gets nowhere.
_LEAST, _MOST = 1e-6, 1e6
# Of the fastest small motion, where nothing moves by itself: what a slow one may be of.
# Rounding beside the fastest, 1e-16, is then 1e-11 of a slow one and still no motion.
_AT_REST = 1e-5
# Of steps that equations still ask for [1]: where they settle, some 50 roundings of
# numbers of order one.
ROUNDING = 1e-14
# The largest one of a solution: rounding of some 1e3 operations is 1e-13, and
# curvatures and ratios of coordinates' sizes up to 1e3 multiply it.
SOLVED = 1e-10


class Asked(NamedTuple):
    """What is solved: a problem, a parameter, quantities and their values.

    Attributes:
        problem: With symmetries.
        keys: Of the parameter; None: none, or a held value.
        quantities: Held.
        values: Theirs, shape (q,).
        varied: Number of the held quantity whose value is the parameter; None: another
            parameter, or none.
        unit: What the parameter is measured by.
        names: Of the independent coordinates.
        fast: Which of them are velocities.
    """

    problem: AbstractProblem
    keys: paths.Keys | None
    quantities: tuple[Quantity, ...]
    values: np.ndarray
    varied: int | None = None
    unit: float = 1.0
    names: tuple[str, ...] = ()
    fast: tuple[bool, ...] = ()


class Directions(NamedTuple):
    """The group at a point.

    Attributes:
        moved: Directions in which it moves the state, orthonormal where coordinates
            are measured by their sizes, shape (n, r).
        idle: Group velocities that leave the state where it is, one row each, with a
            place of its own each, shape (K - r, K).
    """

    moved: np.ndarray
    idle: np.ndarray


class Point(NamedTuple):
    """A state with group velocities and a parameter, and the problem around it.

    Attributes:
        state: That.
        xi: Group velocities, shape (K,).
        p: Parameter.
        local: The problem around it.
        size: What coordinates are measured by: changes that are alike, velocities in
            1 / ``rate``, shape (n,).
        rate: Of the motion, or that with which weight makes one [1/s].
        least: What terms of the linear model that cancel are of, at least [1/s].
        pace: What group velocities are measured by, shape (K,).
        group: Where the group moves it.
    """

    state: Any
    xi: np.ndarray
    p: float
    local: LocalModel
    size: np.ndarray
    rate: float
    least: float
    pace: np.ndarray
    group: Directions


def _directions(local: LocalModel, size: np.ndarray) -> Directions:
    """Where the group moves a state, by the rank of its generators."""
    if not local.groups.shape[1]:
        return Directions(np.zeros((size.size, 0)), np.zeros((0, 0)))
    scaled = local.groups / size[:, None]
    length = np.sqrt(np.sum(scaled * scaled, axis=0))
    if not np.isfinite(length).all():  # of bad numbers, which no step is to take
        return Directions(np.zeros((size.size, 0)), np.zeros((0, length.size)))
    length[length == 0.0] = 1.0
    unit = scaled / length
    left, values, across = np.linalg.svd(unit)
    least = SMALL * max(1.0, float(values[0]))
    moved = left[:, : int(np.sum(values > least))]
    full = np.zeros(length.size)
    full[: values.size] = values
    idle = across[full <= least]
    if not idle.shape[0]:
        return Directions(moved, idle)
    idle = idle / length
    return Directions(moved, echelon(idle / np.linalg.norm(idle, axis=1)[:, None]))


def followed(point: Point) -> np.ndarray:
    """Group velocities along a family by x, shape (K, n): ``A x = G dxi`` there."""
    return along_group(point, point.local.slope)


def along_group(point: Point, rates: np.ndarray) -> np.ndarray:
    """Group velocities that come nearest to rates of the coordinates, (K, ...)."""
    groups = point.local.groups / point.size[:, None]
    unit = point.rate / point.pace
    inverse = cast(np.ndarray, np.linalg.pinv(groups / unit, rcond=SMALL))
    return ((inverse / unit[:, None]) / point.size) @ rates


def program_of(asked: Asked) -> LocalProgram:
    """What gives points; made once for a search, where a point takes half a ms."""
    return local_program(asked.problem, asked.keys, asked.quantities)


def point_at(
    asked: Asked,
    program: LocalProgram,
    state: Any,
    step: np.ndarray,
    xi: np.ndarray,
    p: float,
) -> Point:
    """The point at a step from a state."""
    there, local = program(state, step, xi, p)
    size, rate, least = _measures(asked, there, local)
    length = np.linalg.norm(local.groups / size[:, None], axis=0)
    moves = np.isfinite(length) & (length > 0.0)
    pace = rate / np.where(moves, length, 1.0)
    group = _directions(local, size)
    return Point(there, xi, p, local, size, rate, least, pace, group)


def _measures(
    asked: Asked, state: Any, local: LocalModel
) -> tuple[np.ndarray, float, float]:
    """Sizes of changes that are alike, the rate of velocities, and that of terms.

    That of the motion or of weight, whichever is faster; where there is neither, the
    fastest of small motions: so that none depends on the units of length and time.
    """
    size, rate = asked.problem.sizes(state)
    fast = np.asarray(asked.fast, bool)
    rates = cast(np.ndarray, np.abs(local.rates / size))
    moves = float(rates[~fast].max(initial=rate))
    share = 1.0
    if rate == 0.0 and np.isfinite(local.slope).all():
        small = cast(np.ndarray, np.linalg.eigvals(local.slope))
        fastest = float(np.abs(small).max(initial=0.0))
        if moves <= SMALL * fastest:  # what a step towards rest has left over
            moves, share = fastest, _AT_REST
    rate = moves if np.isfinite(moves) and moves > 0.0 else rate or 1.0
    return np.where(fast, size * rate, size), rate, share * rate


def mismatch(asked: Asked, point: Point) -> np.ndarray:
    """Held quantities less their values."""
    values = np.array(asked.values, float)
    if asked.varied is not None:
        values[asked.varied] = point.p
    return point.local.held - values


def equations(asked: Asked, point: Point) -> tuple[np.ndarray, np.ndarray]:
    """Matrix and right-hand side of a step (x, xi, p), rows of unit length.

    Rows: the residual, phase conditions (no motion along the group, no idle velocity),
    what is held.
    """
    local, size, group = point.local, point.size, point.group
    n, K, q = size.size, point.xi.size, len(asked.quantities)
    r, idle = group.moved.shape[1], group.idle.shape[0]
    rows = np.zeros((n + r + idle + q, n + K + 1))
    rows[:n, :n], rows[:n, n:-1] = local.slope, -local.groups
    rows[:n, -1] = local.by_parameter
    rows[:n] /= size[:, None]
    rows[n : n + r, :n] = (group.moved / size[:, None]).T
    rows[n + r : n + r + idle, n:-1] = group.idle
    rows[n + r + idle :, :n] = local.held_by_x
    rows[n + r + idle :, n:-1] = local.held_by_group
    rows[n + r + idle :, -1] = local.held_by_parameter
    if asked.varied is not None:
        rows[n + r + idle + asked.varied, -1] -= 1.0
    right = np.zeros(rows.shape[0])
    right[:n] = -local.residual / size
    right[n + r + idle :] = -mismatch(asked, point)
    rows[:, :n] *= size[None]
    rows[:, n:-1] *= point.pace
    rows[:, -1] *= asked.unit
    length = np.linalg.norm(rows, axis=1)
    length[:n] = np.maximum(length[:n], _SHORTEST * length[:n].max(initial=0.0))
    length = np.where(length > 0.0, length, 1.0)
    return rows / length[:, None], right / length


class Solved(NamedTuple):
    """Where Newton's method ended.

    Attributes:
        point: There.
        error: Largest of the residuals, each as a step of its own equation [1].
        matrix: The equations' last matrix, scaled.
        moved: All steps (x, xi, p) from the guess, added.
    """

    point: Point
    error: float
    matrix: np.ndarray
    moved: np.ndarray


def solved(
    asked: Asked,
    state: Any,
    xi: np.ndarray,
    p: float,
    step: np.ndarray | None = None,
    border: np.ndarray | None = None,
    tries: int = _TRIES,
    program: LocalProgram | None = None,
) -> Solved:
    """Levenberg and Marquardt's method from a guess, to rounding.

    Args:
        asked: What is solved.
        state: Guess.
        xi: Guess of the group velocities.
        p: Value of the parameter: kept, or where the border begins.
        step: First step from the state, shape (n,); None: none.
        border: Row of (x, xi, p) that all further steps have to be at right angles
            to; None: p is kept.
        tries: Most steps; 0: none, the guess itself.
        program: Of the same problem, parameter and quantities, where it is made.
    """
    n, K = len(asked.names), xi.size
    step = np.zeros(n) if step is None else step
    program = program_of(asked) if program is None else program
    point, done = point_at(asked, program, state, step, xi, p), np.zeros(n)
    matrix, right = _bordered(asked, point, done, xi, p, border)
    error, damping = _size(right), 0.0
    for _ in range(tries):
        if error < ROUNDING:
            break
        move = _damped(matrix, right, damping)
        x = move[:n] * point.size
        own = move[n : n + K] * point.pace
        p_next = point.p + (0.0 if border is None else float(move[-1]) * asked.unit)
        trial = point_at(asked, program, point.state, x, point.xi + own, p_next)
        there = _bordered(asked, trial, done + x, xi, p, border)
        size = _size(there[1])
        if size < error:  # false of bad numbers, too
            settles = size > 0.5 * error
            point, done, error = trial, done + x, size
            matrix, right = there
            damping = 0.0 if damping < _LEAST else 0.1 * damping
            if settles and error < SOLVED:
                break
            continue
        if error < SOLVED or damping > _MOST:
            break  # rounding, or nothing helps
        damping = _LEAST if damping == 0.0 else 10.0 * damping
    moved = np.concatenate([done, point.xi - xi, [point.p - p]])
    return Solved(point, error, matrix, moved)


def _bordered(
    asked: Asked,
    point: Point,
    done: np.ndarray,
    xi: np.ndarray,
    p: float,
    border: np.ndarray | None,
) -> tuple[np.ndarray, np.ndarray]:
    matrix, right = equations(asked, point)
    if border is None:
        return matrix[:, :-1], right
    gone = np.concatenate([done, point.xi - xi, [point.p - p]])
    row = border * unit_steps(asked, point)
    length = float(np.linalg.norm(row))
    left = -float(border @ gone) / length
    return np.concatenate([matrix, row[None] / length]), np.append(right, left)


def unit_steps(asked: Asked, point: Point) -> np.ndarray:
    """What a unit of each unknown (x, xi, p) of the scaled equations is."""
    return np.concatenate([point.size, point.pace, [asked.unit]])


def _size(right: np.ndarray) -> float:
    return float(np.max(np.abs(right), initial=0.0))


def _damped(matrix: np.ndarray, right: np.ndarray, damping: float) -> np.ndarray:
    """The least step that the equations ask for, damped."""
    left, values, across = np.linalg.svd(matrix, full_matrices=False)
    kept = values > SMALL * values[0]
    weights = np.where(kept, values / np.where(kept, values**2 + damping, 1.0), 0.0)
    return across.T @ (weights * (left.T @ right))
