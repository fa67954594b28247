"""Whether a family keeps the symmetries that it was begun with."""

from collections.abc import Callable
from typing import Any, cast

import jax
import numpy as np

from ..kane.system import KaneState
from ..validation.checks import FieldError
from .affine_symmetries import lost as lost_by_system
from .group_actions import Action
from .kane_problem import KaneProblem
from .problem import AbstractProblem, RollingProblem
from .symmetries import symmetries_at

# Of a generator's numbers, which are known to 1e-9: what is lost makes up all of one,
# and what moves with a parameter, its part in the family's span.
_SAME = 1e-6


def refuse_lost(field: str, value: Any, problem: AbstractProblem, state: Any) -> None:
    """Refuse a point of a family whose scene lacks a symmetry that the family counts.

    Args:
        field: What led there.
        value: Of it, there.
        problem: With the family's symmetries, and the numbers of the point.
        state: Of the point.
    """
    if isinstance(problem, KaneProblem) and problem.group:
        at = cast(KaneState, state)
        gone = lost_by_system(problem.system, at, np.asarray(problem.laws))
        _refuse(field, value, problem, gone)
    if not isinstance(problem, RollingProblem) or not problem.group:
        return
    one: Callable[[Any], np.ndarray] = lambda part: np.asarray(part)[None]
    first = jax.tree.map(one, state)
    now = _rows(symmetries_at(problem.scene, np.zeros(1), first).action)
    known = _rows(problem.action)
    left = known - known @ np.linalg.pinv(now) @ now if now.size else known
    size = np.linalg.norm(known, axis=1)
    lost: np.ndarray = np.linalg.norm(left, axis=1) > _SAME * size
    _refuse(field, value, problem, lost)


def _refuse(field: str, value: Any, problem: AbstractProblem, lost: np.ndarray) -> None:
    if lost.any():
        names = ", ".join(
            repr(name) for name, gone in zip(problem.group, lost, strict=True) if gone
        )
        reason = f"leads to where the scene has no symmetry {names}, as at the start"
        remedy = "end before, or begin from a steady motion found there"
        raise FieldError(field, value, reason, remedy)


def _rows(action: Action) -> np.ndarray:
    """All numbers of each generator, shape (K, m)."""
    parts = [np.asarray(part, float) for part in jax.tree.leaves(action)]
    flat = [part.reshape(part.shape[0], -1) for part in parts]
    return np.concatenate(flat, axis=1)
