"""One call of an ensemble: blocks of its members, in lanes or by ``simulate``."""

import dataclasses
import os
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..codegen import NoCompilerError, Results, platform
from ..dynamics.abstract_supported import refuse_rolling_parts
from ..dynamics.clearance import may_touch_twice
from ..dynamics.scene import Scene
from ..hybrid.modes import HybridScene, Modes, modes_of, of
from ..integration.backends import METHODS
from ..integration.diffrax_checks import check_kinds
from ..integration.event_search import Happened
from ..integration.integrate import (
    checked_times,
    default_solver,
    tolerances,
    warn_without_compiler,
)
from ..integration.plans import UNRECORDED_STEPS
from ..kinematics.coordinates import State
from ..validation.checks import FieldError, flag, is_traced, whole
from ..validation.codes import Fields
from .ensemble_members import Members, OfLeaf, by_axis, members_of
from .ensemble_result import Ensemble
from .event_record import EventRecord, events_in_modes, events_of, record_of
from .lane_blocks import LaneBlocks, NotForLanesError
from .motion import Observable, evaluated
from .run import simulate
from .run_checks import check_span, check_start
from .samples import Samples, of_members
from .trajectory import Trajectory

# what a block's states may take [bytes]
_MEMORY = 2**25
_MOST_IN_BLOCK = 8192
# the same on a GPU, which has some 50,000 threads at work and takes one block at a time
_MEMORY_OF_GPU = 2**30
_MOST_ON_GPU = 2**18

# of every member, in what a loop gives and in an ensemble
_ENDS = "code", "final_time", "steps", "rejected_steps", "fault"
_STATES = "state", "final_state", "event_record"


class EnsembleRun:
    """One call of ``ensemble``, which documents its arguments: checked and planned.

    Attributes:
        members: What they share, and what each has of its own.
        traced: Whether an argument is traced.
        modes: How runs may change between rolling, slipping and flight, or None.
    """

    def __init__(
        self,
        scene: Any,
        starts: Any,
        times: Any,
        observe: Observable | None = None,
        keep_states: Any = None,
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
        second_contact: Any = False,
    ):
        """Check and plan it; see :func:`rollkane.ensemble`.

        ``scene`` may be members that are known already, with their modes.
        """
        ready = isinstance(scene, Members)
        if not ready:
            scene = members_of(scene, starts, count, scene_axes, modes)
        self.members: Members = scene
        self.traced = is_traced(scene, starts, times, rtol, atol)
        if method not in METHODS:
            raise FieldError(
                "ensemble.method", method, "is not known", f"use one of {METHODS}"
            )
        check_kinds("ensemble", solver=solver)
        self.observe, self.modes = observe, self.members.modes
        self.keeps = observe is None
        if keep_states is not None:
            self.keeps = flag("ensemble.keep_states", keep_states)
        example = self.members.example
        self.example = jax.eval_shape(example) if self.traced else example()
        scene, start = self.example
        self.fields = Fields.of(scene, start)
        self.scene_axes = tuple(self.members.scene_axes)
        dtype = start.angular_velocity.dtype
        self.times = checked_times(times, dtype)
        known, _ = tolerances(rtol, atol, dtype)
        self.rtol, self.atol = known, atol
        self.solver = default_solver(known) if solver is None else solver
        self.how: dict[str, Any] = {
            "max_steps": max_steps,
            "solver": self.solver,
            "second_contact": flag("ensemble.second_contact", second_contact),
        }
        self.lanes, self.method = None, method
        at = jnp.asarray(self.times[0])
        looked_for = events_of if self.modes is None else events_in_modes
        self.events = looked_for(events, stop, scene, at, start, "ensemble")
        if self.events:
            self.how["events"] = self.events
        if not self.traced:
            self._check()
        if method != "diffrax" and self.modes is None and not self.traced:
            self._choose()
        self.block = self._size(block)
        # the next block is prepared while a GPU works
        able = 2 if platform() == "cuda" else processors()
        self.workers = _whole("workers", workers, able)

    def _check(self) -> None:
        scene, start = self.example
        check_span(scene, self.times)
        if self.modes is None:
            check_start(scene, start)
        else:
            refuse_rolling_parts("ensemble.modes", scene.supported)

    def _choose(self) -> None:
        """The loop over lanes, if it serves; else ``simulate`` goes its own way."""
        if self.how["second_contact"] and may_touch_twice(self.example[0]):
            return
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
        numbers = sum(x.size for x in jax.tree.leaves(self._kept_at_a_time()))
        on_gpu = platform() == "cuda"
        memory = _MEMORY_OF_GPU if on_gpu else _MEMORY
        fitting = memory // (8 * max(numbers, 1) * self.times.shape[0])
        # small enough that every processor has some
        fair = -(-self.members.size // processors())
        most = _MOST_ON_GPU if on_gpu else min(_MOST_IN_BLOCK, fair)
        default = max(min(most, fitting), 1)
        return min(_whole("block", block, default), self.members.size)

    def _kept_at_a_time(self) -> Any:
        """Shapes of what a block holds for each output of a member."""
        scene, start = self.example
        if self.observe is None:
            return start
        if isinstance(scene, HybridScene):
            scene = scene.in_modes.rolling
            start = jax.eval_shape(lambda start: of(start).rolling(), start)
        return start, jax.eval_shape(self.observe, scene, self.times[0], start)

    def whole(self) -> Ensemble:
        """All members at once, as JAX arrays."""
        scene, starts = self.members.block(0, self.members.size)
        return self._ensemble(
            self._simulated(scene, starts), scene, 0, self.members.size
        )

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
        return self.block_of(*self._filled(scene, starts, count), first, count)

    def block_of(self, scene: Scene, starts: State, first: int, count: int) -> Ensemble:
        """One block of members that are given, as NumPy arrays.

        Args:
            scene: Scenes of as many members as ``block`` says.
            starts: Their starts.
            first: Number of the first.
            count: How many of them are wanted.
        """
        if self.lanes is None:
            made = self._simulated(scene, starts)
        else:
            wanted = count if self.observe is None else self.block
            made = self._in_lanes(self.lanes, scene, starts, wanted)
        return self._ensemble(made, scene, first, count)

    def _filled(self, scene: Scene, starts: State, count: int) -> tuple[Scene, State]:
        """A last, shorter block filled up with its last member: compiled once."""
        missing = self.block - count
        if not missing:
            return scene, starts

        def repeated(axis: int | None, x: Any) -> Any:
            if axis is None:
                return x
            x = jnp.asarray(x)
            return jnp.concatenate([x, jnp.repeat(x[-1:], missing, axis=0)])

        return self.members.mapped(repeated, scene, starts)

    def _in_lanes(
        self, lanes: LaneBlocks, scene: Scene, starts: State, count: int
    ) -> dict[str, Any]:
        """What the loop over lanes makes of a block, by the names of ``Ensemble``."""
        y, results = lanes.run(scene, starts, self.block, count)
        return {
            "state": lanes.states(y),
            "final_state": lanes.states(results.final_y),
            "event_record": self._found(results),
            "method": "native",
            "why": "",
        } | {name: getattr(results, name) for name in _ENDS}

    def _found(self, results: Results) -> EventRecord | None:
        """Events of a block in lanes."""
        if self.lanes is None or results.moments is None or results.numbers is None:
            return None
        time, y = results.moments[..., 0], results.moments[..., 1:]
        counts = results.numbers[:, :-1], results.numbers[:, -1]
        parts: Any = time, self.lanes.states(y), *counts
        return record_of(self.events, Happened(*parts))

    def _simulated(self, scene: Scene, starts: State) -> dict[str, Any]:
        """What ``simulate`` makes of a block, likewise."""
        # as arrays: another tolerance compiles nothing
        dtype = self.times.dtype
        sizes = {"rtol": jnp.asarray(self.rtol, dtype)}
        if self.atol is not None:
            sizes["atol"] = jnp.asarray(self.atol, dtype)
        axes = self.members.axes()
        how = self.how | {"method": self.method}
        how_many = self.members.size if self.traced else self.block
        run = _simulated(axes, how_many, how, sizes, scene, starts, self.times)
        names = *_ENDS, *_STATES, "method", "why"
        return {name: getattr(run, name) for name in names}

    def _ensemble(
        self, made: dict[str, Any], scene: Scene, first: int, count: int
    ) -> Ensemble:
        values = {name: made.pop(name) for name in (*_ENDS, *_STATES)}
        values["observed"] = None
        if self.observe is not None:
            axes = of_members(self.scene_axes)
            samples = Samples(scene, self.times, values["state"], axes)
            values["observed"] = evaluated(self.observe, *samples)
        if not self.keeps:
            values["state"] = None
        if not self.traced:
            # without what filled the block up
            own: Callable[[Any], np.ndarray] = lambda x: np.asarray(x)[:count]
            values = jax.tree.map(own, values)
            if count < self.block:
                leaf: OfLeaf = lambda axis, x: x if axis is None else own(x)
                scene = by_axis(leaf, self.scene_axes, scene)
        times: Any = self.times
        how: Any = {"fields": self.fields, "scene_axes": self.scene_axes}
        return Ensemble(time=times, first=first, scene=scene, **values, **made, **how)


@eqx.filter_jit
def _simulated(
    axes: tuple[Any, Any],
    count: int,
    how: dict[str, Any],
    tolerances: dict[str, Any],
    scene: Any,
    starts: Any,
    times: Any,
) -> Trajectory:
    def one(scene: Scene, start: State) -> Trajectory:
        run = simulate(scene, start, times, modes=modes_of(scene), **how, **tolerances)
        known: Any = {"scene": None, "time": None, "switches": None}
        return dataclasses.replace(run, **known)  # not to be repeated for each member

    return jax.vmap(one, in_axes=axes, axis_size=count)(scene, starts)


def processors() -> int:
    """How many processors this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _whole(name: str, value: Any, default: int) -> int:
    if value is None:
        return default
    return whole(f"ensemble.{name}", value, 1, f"give one, or leave {name} out")
