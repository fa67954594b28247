"""One motion in the compiled loop, with as little round it as can be.

A run of the loop takes less than a millisecond: what depends on the kind of the scene
alone is planned once and found again by its structure.
"""

import functools
from typing import Any

import jax
import numpy as np

from .integration import UNRECORDED_STEPS, default_solver, tolerances
from .lane_blocks import LaneBlocks
from .members import single
from .rolling_run import corners
from .trajectory import Trajectory


class _Call:
    """Arguments of a run, equal to those of another of the same kind.

    Attributes:
        arguments: As they were given.
        numbers: All of the scene, in order of leaves.
    """

    def __init__(self, scene, start, times, rtol, atol, solver, max_steps):
        leaves, tree = jax.tree.flatten(scene)
        begun, like = jax.tree.flatten(start)
        self.arguments = scene, start, times, rtol, atol, solver, max_steps
        self.numbers = np.concatenate([np.asarray(x).ravel() for x in leaves])
        self.kind = (
            *(tree, like, tuple((x.shape, x.dtype) for x in (*leaves, *begun))),
            # the compiled loop leaves out what is zero
            *((self.numbers == 0).tobytes(), times.tobytes(), times.dtype),
            *(rtol, atol, type(solver), max_steps),  # solvers are known by their type
        )

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Call) and self.kind == other.kind

    def __hash__(self) -> int:
        return hash(self.kind)


def _planned(call: _Call) -> LaneBlocks:
    scene, start, times, rtol, atol, solver, max_steps = call.arguments
    rtol_known, _ = tolerances(rtol, atol, times.dtype)
    return LaneBlocks(
        single(scene, start),
        times,
        rtol,
        atol,
        default_solver(rtol_known) if solver is None else solver,
        UNRECORDED_STEPS if max_steps is None else max_steps,
        lanes=1,
    )


_found_again = functools.lru_cache(maxsize=64)(_planned)


def in_one_lane(
    scene: Any,
    start: Any,
    times: np.ndarray,
    rtol: float | None,
    atol: float | None,
    solver: Any,
    max_steps: int | None,
) -> Trajectory:
    """A run in the compiled loop, with NumPy arrays: JAX's would cost 1 ms more.

    Args:
        scene: What moves.
        start: State at the first time, pole-free.
        times: Checked output times [s].
        rtol: Relative tolerance of a step [1], or None.
        atol: Absolute tolerance of a step [unit of the state], or None.
        solver: diffrax solver, or None.
        max_steps: Most steps, or None.

    Raises:
        NotForLanesError: the loop cannot do this, with the reason.
    """
    tolerances(rtol, atol, times.dtype)  # refuses what is no number
    rtol, atol = (None if x is None else float(x) for x in (rtol, atol))
    call = _Call(scene, start, times, rtol, atol, solver, max_steps)
    # the times of corners are numbers of the scene: planned anew
    plan = _found_again if corners(scene)[0] is None else _planned
    loop = plan(call)
    y, results = loop.run_alone(scene, call.numbers, start)
    parts: Any = (
        *(times, loop.states(y[0]), scene, results.code[0], results.final_time[0]),
        *(loop.states(results.final_y[0]), results.steps[0]),
        results.rejected_steps[0],
    )
    return Trajectory(*parts)
