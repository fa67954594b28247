"""Many motions at once: in blocks, on all cores, in memory that is the block's."""

import os
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, cast

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..codegen import NoCompilerError, Results
from ..dynamics.scene import Scene
from ..hybrid.modes import HybridScene, Modes
from ..integration.backends import METHODS
from ..integration.event_search import Happened
from ..integration.integrate import (
    checked_times,
    default_solver,
    tolerances,
    warn_without_compiler,
)
from ..integration.plans import UNRECORDED_STEPS
from ..kinematics.coordinates import State
from ..validation.checks import FieldError, is_traced, whole
from ..validation.codes import Fields
from .ensemble_members import members_of
from .ensemble_result import Ensemble
from .event_record import EventRecord, events_in_modes, events_of, record_of
from .lane_blocks import LaneBlocks, NotForLanesError
from .run import simulate
from .run_checks import check_span, check_start
from .trajectory import Trajectory

# what a block's states may take [bytes]
_MEMORY = 2**25
_MOST_IN_BLOCK = 8192

Observable = Callable[[Scene, Float[Array, ""], State], Any]


def ensemble(
    scene: Scene | Callable[[Array], Scene],
    starts: State | Callable[[Array], State],
    times: Any,
    *,
    observe: Observable | None = None,
    count: int | None = None,
    scene_axes: Any = None,
    rtol: float | None = None,
    atol: float | None = None,
    solver: dfx.AbstractSolver[Any] | None = None,
    modes: Modes | None = None,
    max_steps: int | None = None,
    method: str = "auto",
    block: int | None = None,
    workers: int | None = None,
    events: Any = (),
    stop: Any = None,
) -> Ensemble:
    """Motions of many members: starts, scenes, or both differ.

    The steps are those of :func:`rollkane.simulate`; a member that cannot go on ends
    with a code of its own and disturbs no other. On a CPU the right-hand side is
    compiled together with a loop in which every lane of the processor's vectors
    follows its own motion at its own step size; what that loop does not have (modes,
    records that differ, arguments that are traced) runs as ``simulate`` under
    ``jax.vmap``, natively where that can.

    Args:
        scene: Scene; every number of it may have an axis of N members in front, as
            ``jax.vmap`` of a function that makes scenes gives it. Or such a function
            of the member's number, called block by block.
        starts: States, from ``jax.vmap`` of :func:`rollkane.place`, or a function of
            the member's number; a single one is shared by all.
        times: Output times [s], shape (T,), T >= 2, those of all members; only the
            first and the last where no more is wanted.
        observe: ``observe(scene, t, state)`` -> tree of arrays, kept at the times
            instead of the states, such as those of ``rollkane.dynamics.observables``.
        count: N, where functions of the member's number do not tell.
        scene_axes: As ``in_axes`` of ``jax.vmap``, for scenes whose own functions have
            parameters that differ; found out otherwise.
        rtol: As in ``simulate`` [1].
        atol: As in ``simulate`` [unit of the state].
        solver: diffrax solver; by default Dopri8 below rtol 1e-6, else Tsit5.
        modes: How runs may change between rolling, slipping and flight.
        max_steps: Most steps of a member; 4194304 by default.
        method: ``"native"``, ``"diffrax"``, or ``"auto"``: native where it can.
        block: Members that are worked on together; by default as many as keep outputs
            of 32 MiB, at most 8192.
        workers: Threads; as many as processors by default.
        events: As in ``simulate``, the same for all members.
        stop: Likewise: a member that ends leaves its place to the next.

    Returns:
        The ensemble. Where an argument is traced (``jax.grad``, ``jax.jit``), it is
        made of JAX arrays and can be differentiated.

    Raises:
        FieldError: bad input, or a method that cannot do what is asked.
    """
    run = _Run(
        *(scene, starts, times, observe, count, scene_axes, rtol, atol, solver),
        *(modes, max_steps, method, block, workers, events, stop),
    )
    if run.traced:
        return run.whole()
    parts = list(run.blocks())
    arrays = [cast(Any, eqx.filter(part, eqx.is_array)) for part in parts]
    joined = jax.tree.map(lambda *x: np.concatenate(x), *arrays)
    joined = eqx.tree_at(lambda e: e.time, joined, parts[0].time)
    return eqx.combine(joined, parts[0])


def ensemble_blocks(
    scene: Scene | Callable[[Array], Scene],
    starts: State | Callable[[Array], State],
    times: Any,
    **options: Any,
) -> Iterator[Ensemble]:
    """An ensemble block by block, as it is computed: memory is that of a few blocks.

    Args:
        scene: As in :func:`ensemble`.
        starts: As in ``ensemble``; a function of the member's number where even the
            starts would fill the memory.
        times: Output times [s], shape (T,).
        options: Those of ``ensemble``.

    Yields:
        Ensembles of the members in order, each with ``first``, the number of its
        first member.

    Raises:
        FieldError: as ``ensemble``; traced arguments.
    """
    run = _Run(scene, starts, times, **options)
    if run.traced:
        raise FieldError(
            "ensemble_blocks", "a traced value", "cannot stream", "call ensemble"
        )
    return run.blocks()


class _Run:
    """One call, checked and planned."""

    def __init__(
        self,
        scene: Any,
        starts: Any,
        times: Any,
        observe: Observable | None = None,
        count: Any = None,
        scene_axes: Any = None,
        rtol: Any = None,
        atol: Any = None,
        solver: dfx.AbstractSolver[Any] | None = None,
        modes: Modes | None = None,
        max_steps: Any = None,
        method: str = "auto",
        block: Any = None,
        workers: Any = None,
        events: Any = (),
        stop: Any = None,
    ):
        self.members = members_of(scene, starts, count, scene_axes)
        self.traced = is_traced(scene, starts, times, rtol, atol)
        if method not in METHODS:
            raise FieldError(
                "ensemble.method", method, "is not known", f"use one of {METHODS}"
            )
        self.observe = observe
        example = self.members.example
        self.example = jax.eval_shape(example) if self.traced else example()
        scene, start = self.example
        scene = scene if modes is None else HybridScene(scene, modes)
        self.fields = Fields.of(scene, start)
        dtype = start.angular_velocity.dtype
        self.times = checked_times(times, dtype)
        known, _ = tolerances(rtol, atol, dtype)
        self.rtol, self.atol = known, atol
        self.solver = default_solver(known) if solver is None else solver
        self.how: dict[str, Any] = {
            "modes": modes,
            "max_steps": max_steps,
            "solver": self.solver,
        }
        self.lanes, self.method = None, method
        at = jnp.asarray(self.times[0])
        looked_for = events_of if modes is None else events_in_modes
        self.events = looked_for(events, stop, scene, at, start, "ensemble")
        if self.events:
            self.how["events"] = self.events
        if not self.traced:
            self._check(modes)
        if method != "diffrax" and modes is None and not self.traced:
            self._choose()
        self.block = self._size(block)
        self.workers = _whole("workers", workers, _processors())

    def _check(self, modes: Modes | None) -> None:
        scene, start = self.example
        check_span(scene, self.times)
        if modes is None:
            check_start(scene, start)

    def _choose(self) -> None:
        """The loop over lanes, if it serves; else ``simulate`` goes its own way."""
        try:
            self.lanes = self._by_lanes()
        except NotForLanesError as error:
            if isinstance(error.__cause__, NoCompilerError):
                warn_without_compiler(str(error.__cause__))

    def _by_lanes(self) -> LaneBlocks:
        if jax.default_backend() != "cpu":
            raise NotForLanesError(f"numbers are on a {jax.default_backend()}")
        return LaneBlocks(
            self.members,
            np.asarray(self.times),
            self.rtol,
            self.atol,
            self.solver,
            _whole("max_steps", self.how["max_steps"], UNRECORDED_STEPS),
            events=self.events,
        )

    def _size(self, block: int | None) -> int:
        numbers = sum(x.size for x in jax.tree.leaves(self.example[1]))
        fitting = _MEMORY // (8 * max(numbers, 1) * self.times.shape[0])
        # small enough that every processor has some
        fair = -(-self.members.size // _processors())
        default = max(min(_MOST_IN_BLOCK, fitting, fair), 1)
        return min(_whole("block", block, default), self.members.size)

    def whole(self) -> Ensemble:
        """All members at once, as JAX arrays."""
        every = *self.members.block(0, self.members.size), 0, self.members.size
        return self._simulated(*every)

    def blocks(self) -> Iterator[Ensemble]:
        """The blocks in order; while one is taken, the next ones are computed."""
        firsts = range(0, self.members.size, self.block)
        with ThreadPoolExecutor(self.workers) as pool:
            under_way: deque[Future[Ensemble]] = deque()
            for first in firsts:
                under_way.append(pool.submit(self._one, first))
                if len(under_way) > self.workers:
                    yield under_way.popleft().result()
            while under_way:
                yield under_way.popleft().result()

    def _one(self, first: int) -> Ensemble:
        """One block, as NumPy arrays."""
        count = min(self.block, self.members.size - first)
        scene, starts = self.members.block(first, first + count)
        scene, starts = self._filled(scene, starts, count)
        run = self._simulated if self.lanes is None else self._in_lanes
        return run(scene, starts, first, count)

    def _filled(self, scene: Scene, starts: State, count: int) -> tuple[Scene, State]:
        """A last, shorter block filled up with its last member: compiled once."""
        missing = self.block - count
        if not missing:
            return scene, starts

        def repeated(x: Any, axis: int | None) -> Any:
            if axis is None:
                return x
            x = jnp.asarray(x)
            return jnp.concatenate([x, jnp.repeat(x[-1:], missing, axis=0)])

        return self.members.mapped(repeated, scene, starts)

    def _in_lanes(
        self, scene: Scene, starts: State, first: int, count: int
    ) -> Ensemble:
        assert self.lanes is not None
        y, results = self.lanes.run(scene, starts, self.block)
        return self._ensemble(
            *(("native", ""), first, count, scene),
            self.lanes.states(y),
            results.code,
            results.final_time,
            self.lanes.states(results.final_y),
            results.steps,
            results.rejected_steps,
            results.fault,
            found=self._found(results),
        )

    def _found(self, results: Results) -> EventRecord | None:
        """Events of a block in lanes."""
        if self.lanes is None or results.moments is None or results.numbers is None:
            return None
        time, y = results.moments[..., 0], results.moments[..., 1:]
        counts = results.numbers[:, :-1], results.numbers[:, -1]
        parts: Any = time, self.lanes.states(y), *counts
        return record_of(self.events, Happened(*parts))

    def _simulated(
        self, scene: Scene, starts: State, first: int, count: int
    ) -> Ensemble:
        # as arrays: another tolerance compiles nothing
        dtype = self.times.dtype
        sizes = {"rtol": jnp.asarray(self.rtol, dtype)}
        if self.atol is not None:
            sizes["atol"] = jnp.asarray(self.atol, dtype)
        axes = self.members.axes()
        how = self.how | {"method": self.method}
        run = _simulated(axes, how, sizes, scene, starts, self.times)
        return self._ensemble(
            *((run.method, run.why), first, count, scene),
            run.state,
            run.code,
            run.final_time,
            run.final_state,
            run.steps,
            run.rejected_steps,
            run.fault,
            found=run.event_record,
        )

    def _ensemble(
        self,
        made: tuple[str, str],
        first: int,
        count: int,
        scene: Scene,
        state: Any,
        *rest: Any,
        found: EventRecord | None,
    ) -> Ensemble:
        observed = None
        if self.observe is not None:
            axes = self.members.axes()[0]
            observed = _observed(self.observe, axes, scene, self.times, state)
            state = None
        parts: Any = (state, observed, *rest), found
        if not self.traced:
            # without what filled the block up
            own: Callable[[Any], np.ndarray] = lambda x: np.asarray(x)[:count]
            parts = jax.tree.map(own, parts)
        parts, found = parts
        times: Any = self.times
        how: dict[str, Any] = dict(zip(("method", "why"), made, strict=True))
        how |= {"fields": self.fields, "event_record": found}
        return Ensemble(times, *parts, first=first, **how)


@eqx.filter_jit
def _observed(
    observe: Observable, axes: Any, scene: Any, times: Any, state: Any
) -> Any:
    of_times = jax.vmap(observe, in_axes=(None, 0, 0))
    return jax.vmap(of_times, in_axes=(axes, None, 0))(scene, jnp.asarray(times), state)


@eqx.filter_jit
def _simulated(
    axes: tuple[Any, Any],
    how: dict[str, Any],
    tolerances: dict[str, Any],
    scene: Any,
    starts: Any,
    times: Any,
) -> Trajectory:
    one: Callable[[Scene, State], Trajectory] = lambda scene, start: simulate(
        scene, start, times, **how, **tolerances
    )
    return jax.vmap(one, in_axes=axes)(scene, starts)


def _processors() -> int:
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _whole(name: str, value: Any, default: int) -> int:
    if value is None:
        return default
    return whole(f"ensemble.{name}", value, 1, f"give one, or leave {name} out")
