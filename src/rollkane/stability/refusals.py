"""Why there is no steady motion to be told of: sentences with ranks and directions."""

from collections.abc import Sequence
from typing import Any, NoReturn

import equinox as eqx
import numpy as np

from ..validation.checks import FieldError
from .newton import ROUNDING, SMALL, SOLVED, Asked, Point, Solved, followed, solved

# Of a quantity's change along a symmetry, beside its largest change. The symmetry's own
# numbers are known to 1e-9 (what it was found by), slopes better; what a symmetry does
# change, it changes by its own size.
_MOVES = 1e-6
# A step [1] that equations still ask for where a search ends. Newton's method squares
# it where its equations are regular: one that small and not yet 1e-10 goes on slowly,
# since they lose rank where it goes.
_CREEPS = 1e-6
# Of the rates of the guess: what is slower has come to rest, and what is faster has run
# away, to where accelerations that are left count as small beside the speed.
_RESTS, _AWAY = 1e-3, 10.0
# Rates of rest are known to the steps that are left, times what curvatures multiply
# them by; crept to they are 800 times these and more (Chaplygin's ball at 8e-8 rad/s)
_LEFT = 100.0


def refuse_other_scene(field: str, scene: Any, known: Any) -> None:
    """Refuse another scene than that of a motion, which would not be looked at."""
    if scene is not known and not eqx.tree_equal(scene, known):
        problem = "is not the scene of the motion, but another one"
        remedy = "give the same, or find a motion of this one first"
        raise FieldError(field, type(scene).__name__, problem, remedy)


def refuse_moving(field: str, asked: Asked, point: Point) -> None:
    """Refuse held quantities that a symmetry does not leave fixed."""
    local, size = point.local, point.size
    for k, q in enumerate(asked.quantities):
        slope = local.held_by_x[k] * size
        for j, name in enumerate(asked.problem.group):
            way = local.groups[:, j] / size
            change = abs(float(slope @ way))
            if change > _MOVES * float(np.linalg.norm(slope) * np.linalg.norm(way)):
                problem = f"is not left fixed by the symmetry {name!r}"
                remedy = (
                    "hold what the symmetry does not change (a speed, a tilt, an "
                    "energy), or the group velocity itself by its name"
                )
                raise FieldError(f"{field}[{q.name!r}]", q.name, problem, remedy)


def refuse_overheld(asked: Asked, point: Point, family: np.ndarray) -> None:
    """Refuse more held quantities than the family of steady motions has dimensions."""
    q = len(asked.quantities)
    if not q:
        return
    local, size = point.local, point.size
    follow = followed(point)
    rows: np.ndarray = local.held_by_x + local.held_by_group @ follow
    length = np.linalg.norm(rows * size[None], axis=1)
    rows = rows / np.where(length > 0.0, length, 1.0)[:, None]
    values = np.linalg.svd(rows @ family, compute_uv=False) if family.size else ()
    # of rows and directions of unit length: of a motion solved to 1e-10, where singular
    # values that count are 1e-4 or more, the family's directions are known to 1e-6
    rank = int(np.sum(np.asarray(values) > 1e-6))
    if rank < q:
        _refuse_holds(asked, point, family, rank)


def _refuse_holds(
    asked: Asked, point: Point, family: np.ndarray, rank: int
) -> NoReturn:
    names = asked.names
    d, held = family.shape[1], [q.name for q in asked.quantities]
    ways = "; ".join(told(column, names) for column in family.T) or "none"
    problem = (
        f"holds {len(held)} where the steady motions near the guess are a family of "
        f"{d} dimensions, of which these quantities see {rank} (directions: {ways})"
    )
    raise FieldError(
        "steady_motion.hold", held, problem, f"hold {rank} of them, or others"
    )


def refuse_unsolved(asked: Asked, state: Any, first: Point, found: Solved) -> NoReturn:
    """Say why no steady motion was found: none is near, or too much is held.

    Args:
        asked: What was solved.
        state: Guess.
        first: The point there, at rest in the group.
        found: Where the search ended.
    """
    if asked.quantities:
        free = asked._replace(quantities=(), values=np.zeros(0))
        near = solved(free, state, found.point.xi, 0.0)
        if near.error < SOLVED:
            held = {
                q.name: float(v)
                for q, v in zip(asked.quantities, asked.values, strict=True)
            }
            problem = (
                "cannot be reached: there is a steady motion near the guess, but none "
                "with these values; " + _of_rank(found, asked)
            )
            remedy = "give values nearer to those of the guess, or hold less"
            raise FieldError("steady_motion.hold", held, problem, remedy)
    faster = _faster(first, found.point)
    if found.error < _CREEPS and faster < _AWAY:
        _refuse_creeping(state, found, faster)
    problem = "has no steady motion near it; " + _of_rank(found, asked)
    remedy = (
        "begin nearer to one, or let the scene have its symmetries (a level plane, a "
        "body of revolution)"
    )
    raise FieldError("steady_motion.guess", type(state).__name__, problem, remedy)


def refuse_rest_that_is_none(state: Any, first: Point, found: Solved) -> None:
    """Refuse a search that crept towards rest until what was left counted as solved.

    Where families meet at rest what is left falls with the square of the speed, so that
    any state counts as steady that is slow enough. A motion at rest to which Newton's
    method leads is there to rounding.
    """
    faster = _faster(first, found.point)
    moves = _speed(found.point, found.point.size) / first.rate
    if faster < _CREEPS and moves > _LEFT * max(found.error, ROUNDING):
        _refuse_creeping(state, found, faster)


def _faster(first: Point, point: Point) -> float:
    """How much faster a search went than its guess, by the rates of the coordinates."""
    return _speed(point, first.size) / max(_speed(first, first.size), 1e-300)


def _speed(point: Point, size: np.ndarray) -> float:
    """Rates of the coordinates, by what these are measured by."""
    return float(np.linalg.norm(point.local.rates / size))


def _refuse_creeping(state: Any, found: Solved, faster: float) -> NoReturn:
    """Say that a search goes to where families of steady motions meet, without end."""
    where = "a state at which its equations lose rank, where families meet"
    if faster < _RESTS:
        where = "rest, where all families of steady motions meet"
    problem = (
        f"leads to {where}: the search slows down and does not settle (a step of "
        f"{found.error:.2g} is left)"
    )
    remedy = (
        "begin nearer to the steady motion that is meant (a balanced body: a spin "
        "about a principal axis that stands upright), and hold what keeps it going, "
        'such as "energy" or a spin'
    )
    raise FieldError("steady_motion.guess", type(state).__name__, problem, remedy)


def _of_rank(found: Solved, asked: Asked) -> str:
    """Rank of the equations where the search ended, and what they do not reach."""
    values = np.linalg.svd(found.matrix, compute_uv=False)
    rank = int(np.sum(values > SMALL * values[0]))
    names = asked.names
    n = len(names)
    # the residual that is left, in the rates of the coordinates
    rest = found.point.local.residual
    return (
        f"of {n} rates with {found.matrix.shape[1]} unknowns the equations have rank "
        f"{rank} and leave {told(rest, names)}"
    )


def told(direction: np.ndarray, names: Sequence[str]) -> str:
    """A direction by its largest parts."""
    size = float(np.abs(direction).max(initial=0.0))
    if not np.isfinite(size) or size == 0.0:
        return "nothing" if size == 0.0 else "no numbers"
    parts = [
        f"{value:+.3g} {name}"
        for value, name in zip(direction, names, strict=True)
        if abs(value) > 1e-3 * size  # as many digits as are told
    ]
    return " ".join(parts)
