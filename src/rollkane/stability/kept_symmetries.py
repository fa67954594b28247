"""Whether a family keeps the symmetries that it was begun with."""

from collections.abc import Callable, Sequence
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..codegen.compile_effort import for_one_call
from ..kane.system import KaneState
from ..validation.checks import FieldError
from .affine_symmetries import lost as lost_by_system
from .group_actions import Action
from .kane_problem import KaneProblem
from .newton import Point
from .problem import AbstractProblem, RollingProblem
from .spectrum import strays
from .symmetries import symmetries_at

# Of a generator's numbers, which are known to 1e-9: what is lost makes up all of one,
# and what moves with a parameter, its part in the family's span.
_SAME = 1e-6
# Of the fastest turn: what is slower is rounding of Newton's method, 1e-10.
_STILL = 1e-8
# States of a turn that are looked at, every 0.1 rad: what breaks a symmetry between two
# of them alone is not seen (docs/steady.md).
_PLACES = 64
# Of a linear model's largest column: what is less is rounding, 1e-12, and the error of
# generators, 1e-9.
_STRAY = 1e-8


class LostSymmetry(FieldError):
    """A way led to where the scene lacks a symmetry that was counted on it."""

    def __init__(self, field: str, value: Any, names: Sequence[str]):
        """Say which, and what to do.

        Args:
            field: What led there.
            value: Of it, there.
            names: Of the symmetries.
        """
        listed = ", ".join(map(repr, names))
        reason = f"leads to where the scene has no symmetry {listed}, as at the start"
        remedy = "end before, or begin from a motion found there"
        super().__init__(field, value, reason, remedy)
        self.names = tuple(names)


def lost_rows(known: Action, now: Action) -> np.ndarray:
    """Which generators are no combination of others, shape (K,)."""
    rows, there = _rows(known), _rows(now)
    left = rows - rows @ np.linalg.pinv(there) @ there if there.size else rows
    size = np.linalg.norm(rows, axis=1)
    return np.linalg.norm(left, axis=1) > _SAME * size


def group_orbit(
    problem: AbstractProblem, state: Any, xi: np.ndarray
) -> tuple[np.ndarray, Any]:
    """Times [s] and states of a steady motion in a turn of it, as far as it goes.

    Where it is nowhere near its beginning, less may be symmetric. What glides is
    followed while the body turns round once; what neither turns nor glides, not at all.

    Args:
        problem: Of a rolling scene.
        state: At the time zero.
        xi: Its group velocities, shape (K,).

    Returns:
        Times, shape (P,), and states, every array with a leading P.
    """
    once = 0.0
    if isinstance(problem, RollingProblem) and xi.size:
        parts = problem.action.turn, problem.action.spin, problem.action.shift
        rates = [float(np.linalg.norm(xi @ np.asarray(part))) for part in parts]
        most = max(rates)
        once = next((2.0 * np.pi / w for w in rates if w > _STILL * most), 0.0)
    times = once * np.arange(_PLACES if once else 1) / _PLACES
    return times, _along(problem, state, jnp.asarray(xi), jnp.asarray(times))


@for_one_call
def _along(
    problem: AbstractProblem,
    state: Any,
    xi: Float[Array, " K"],
    times: Float[Array, " P"],
) -> Any:
    def at(t: Array) -> Any:
        return problem.carried(problem.along_group(state, t * xi), t)

    return jax.vmap(at)(times)


def refuse_lost(
    field: str, value: Any, problem: AbstractProblem, state: Any, xi: np.ndarray
) -> None:
    """Refuse a point of a family whose scene lacks a symmetry that the family counts.

    Args:
        field: What led there.
        value: Of it, there.
        problem: With the family's symmetries, and the numbers of the point.
        state: Of the point.
        xi: Its group velocities, shape (K,).

    Raises:
        LostSymmetry: with their names.
    """
    if isinstance(problem, KaneProblem) and problem.group:
        at = cast(KaneState, state)
        gone = lost_by_system(problem.system, at, np.asarray(problem.laws))
        _refuse(field, value, problem, gone)
    if not isinstance(problem, RollingProblem) or not problem.group:
        return
    now = symmetries_at(problem.scene, *group_orbit(problem, state, xi)).action
    _refuse(field, value, problem, lost_rows(problem.action, now))


def refuse_strays(
    field: str, value: Any, problem: AbstractProblem, point: Point
) -> None:
    """Refuse a point of a family whose own rates show that a symmetry is lost.

    Args:
        field: What led there.
        value: Of it, there.
        problem: With the family's symmetries.
        point: Its solution.

    Raises:
        LostSymmetry: with their names.
    """
    _refuse(field, value, problem, strays(point) > _STRAY)


def refuse_lost_on(
    field: str, problem: AbstractProblem, points: Sequence[tuple[float, Point]]
) -> None:
    """Refuse points of one scene near any of which a symmetry is lost.

    Args:
        field: What led there.
        problem: With the family's symmetries.
        points: Values of what led there, and solutions.

    Raises:
        LostSymmetry: with their names.
    """
    if not isinstance(problem, RollingProblem) or not problem.group:
        return
    join: Callable[..., np.ndarray] = lambda *parts: np.stack(parts)
    states = jax.tree.map(join, *(point.state for _, point in points))
    now = symmetries_at(problem.scene, np.zeros(len(points)), states).action
    if lost_rows(problem.action, now).any():
        for value, point in points:
            refuse_lost(field, value, problem, point.state, point.xi)


def _refuse(field: str, value: Any, problem: AbstractProblem, lost: np.ndarray) -> None:
    if lost.any():
        both = zip(problem.group, lost, strict=True)
        raise LostSymmetry(field, value, [name for name, gone in both if gone])


def _rows(action: Action) -> np.ndarray:
    """All numbers of each generator, shape (K, m)."""
    parts = [np.asarray(part, float) for part in jax.tree.leaves(action)]
    flat = [part.reshape(part.shape[0], -1) for part in parts]
    return np.concatenate(flat, axis=1)
