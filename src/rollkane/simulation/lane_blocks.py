"""Blocks of an ensemble in the compiled loop over lanes."""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias, cast

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import NDArray

from ..codegen import LaneLoop, Looked, NoCompilerError, Queue, Results, Stops, zeros_of
from ..codegen.dependence import reached_outputs
from ..codegen.scalar_program import NotElementwiseError
from ..codegen.tableau import PLAIN, is_plain, weights_of
from ..dynamics.consistency import consistent
from ..dynamics.events import Event
from ..dynamics.rolling import rolling_derivative
from ..dynamics.rolling_problem import (
    corners,
    error_sizes,
    explained,
    explains_ends,
    unbroken,
)
from ..dynamics.scene import Scene
from ..integration.event_search import layout_of, values_of
from ..integration.integrate import tolerances
from ..integration.solve import unbroken_numbers
from ..integration.step_control import coarse, first_step, landings, stops_of
from ..kinematics.base_motion import ready_for_runs
from ..kinematics.coordinates import pack, unpack
from ..validation.codes import NO_FAULT, first_fault, is_stuck
from .ensemble_members import Members, OfLeaf, by_axis


class NotForLanesError(Exception):
    """Why the loop over lanes cannot do what is asked.

    Where there is no compiler that works, that is its cause.
    """


class LaneBlocks:
    """Integrates blocks of members of one kind.

    Attributes:
        like: Shapes of one state.
    """

    def __init__(
        self,
        members: Members,
        times: np.ndarray,
        rtol: float | None,
        atol: float | None,
        solver: dfx.AbstractSolver[Any],
        max_steps: int,
        extended: bool = False,
        events: tuple[Event, ...] = (),
    ):
        """Compile the loop for these members, unless it has been compiled before.

        Args:
            members: Of which every block is a part.
            times: Output times [s].
            rtol: Relative tolerance of a step [1], or None.
            atol: Absolute tolerance of a step [unit of the state], or None.
            solver: diffrax solver.
            max_steps: Most steps of a member.
            extended: Whether to compute with C's long doubles; what comes out is
                rounded to the precision that goes in.
            events: What is looked for in every member.

        Raises:
            NotForLanesError: with the reason.
        """
        if not is_plain(solver):
            known = ", ".join(kind.__name__ for kind in PLAIN)
            raise NotForLanesError(f"{type(solver).__name__} is none of {known}")
        scene, start = members.example()
        self.like = jax.tree.map(_shape_of, start)
        self._members = members
        self._times, self._max_steps = times, max_steps
        dtype = np.longdouble if extended else times.dtype
        self._rtol, self._atol = tolerances(rtol, atol, dtype)
        self._by_size = atol is None
        self._axes = _ready_axes(scene, members.scene_axes)
        axes = [*self._axes, *[None] * len(jax.tree.leaves(events))]
        as_run = ready_for_runs(scene), events
        both = cast(tuple[list[Any], Any], jax.tree.flatten(as_run))
        leaves, tree = both
        self._events = [np.asarray(x).reshape(-1) for x in jax.tree.leaves(events)]
        own = tuple(axis is not None for axis in axes)
        self._example = scene, start
        self._outputs = stops_of(times)
        self._stops = self._landings(scene, members)
        kind = _Kind(
            extended=extended,
            tree=tree,
            leaves=tuple((x.shape, x.dtype) for x in leaves),
            own=own,
            state=jax.tree.structure(self.like),
            sizes=tuple((x.shape, x.dtype) for x in jax.tree.leaves(self.like)),
            # what differs from member to member is not known
            zeros=tuple(
                zeros_of(x) if axis is None else b""
                for x, axis in zip(leaves, axes, strict=True)
            ),
        )
        try:
            self._loop = _compiled(kind, type(solver))
        except NotElementwiseError as error:
            raise NotForLanesError(
                f"the right-hand side has {error}, which is more than arithmetic"
            ) from error
        except NoCompilerError as error:
            raise NotForLanesError(str(error)) from error

    def _landings(self, scene: Any, members: Members) -> Stops:
        """Where all lanes stop; the way of time is forwards."""
        times, _ = self._outputs
        kinks, away = corners(scene)
        sense = -1.0 if times[-1] < times[0] else 1.0
        if kinks is None:
            ends = starts = np.unique(sense * times[1:])
        elif _corners_differ(scene, members.scene_axes):
            raise NotForLanesError("the times of corners differ from member to member")
        else:
            found = landings(times, kinks, away)
            ends = sense * np.asarray(found.ends)
            starts = sense * np.asarray(found.starts)
        # each of them once, behind the start
        behind = np.isfinite(ends) & (ends > np.append(sense * times[0], ends[:-1]))
        ends, starts = ends[behind], starts[behind]
        # of outputs at one time the last
        at = np.searchsorted(sense * times, starts, side="right") - 1
        slots = np.where(sense * times[at] >= ends, at - 1, -1)
        return Stops(ends, starts, slots, len(times) - 1)

    def run(
        self, scene: Any, starts: Any, count: int, wanted: int
    ) -> tuple[np.ndarray, Results]:
        """Integrate one block.

        Args:
            scene: Scenes of the block, batched where members differ.
            starts: Their starts, likewise.
            count: How many there are.
            wanted: How many of them, M, are integrated, the first ones.

        Returns:
            Packed states at the times, shape (M, T, n), and all results.
        """
        span = np.abs(self._times[-1] - self._times[0])
        axes = self._members.axes()
        prepared = _prepared(axes, count, scene, starts, self._times[0], span)
        begun: list[NDArray[Any]] = [np.asarray(x)[:wanted] for x in prepared]
        y0, sizes, steps, fault, code_of_fault, good = begun
        own, shared = [np.zeros((wanted, 0))], [np.zeros(0)]
        ready = self._ready(scene, count)
        for leaf, axis in zip(ready, self._axes, strict=True):
            leaf = np.asarray(leaf)
            if axis is None:
                shared.append(leaf.reshape(-1))
            else:
                own.append(leaf.reshape(count, -1)[:wanted])
        shared += self._events
        scale = sizes if self._by_size else np.ones_like(y0)
        sense = -1.0 if self._times[-1] < self._times[0] else 1.0
        eps = np.finfo(self._loop.dtype).eps
        queue = Queue(
            starts=y0,
            atol=float(self._atol) * scale,
            first_steps=steps,
            own=np.concatenate(own, axis=1),
            shared=np.concatenate(shared),
            time=sense * float(self._times[0]),
            rtol=float(self._rtol),
            dtmin=float(10 * eps * max(abs(self._times[0]), abs(self._times[-1]))),
            max_steps=self._max_steps,
            sense=sense,
        )
        results = self._loop.run(queue, self._stops)
        found = results.moments
        results = results._replace(
            y=results.y.astype(y0.dtype),
            final_y=results.final_y.astype(y0.dtype),
            final_time=results.final_time.astype(y0.dtype),
            moments=None if found is None else found.astype(y0.dtype, copy=False),
        )
        y = np.concatenate([y0[:, None], results.y], axis=1)
        if self._outputs.last is not None:
            y = y[:, self._outputs.last]
        y[~good], results.final_y[~good] = np.nan, np.nan
        if results.moments is not None and results.numbers is not None:
            results.moments[~good] = np.nan
            results.numbers[~good] = [0] * (results.numbers.shape[1] - 1) + [-1]
        code = results.code
        # asked last: it traces the surfaces' ends
        if is_stuck(code[good]).any() and explains_ends(*self._example):
            code = self._code(scene, results)
        code = np.where(good, code, code_of_fault)
        return y, results._replace(code=code, fault=fault)

    def _ready(self, scene: Any, count: int) -> list[Any]:
        """Leaves of a block's scenes, as runs take them."""
        if ready_for_runs(self._example[0]) is self._example[0]:
            return jax.tree.leaves(scene)
        made: Callable[[Any], list[Any]] = lambda scene: jax.tree.leaves(
            ready_for_runs(scene)
        )
        axes = self._members.axes()[:1]
        return jax.vmap(made, axes, self._axes, axis_size=count)(scene)

    def states(self, y: Any) -> Any:
        """States of packed numbers; every array with the same axes in front."""
        return unpack(y, self.like)

    def _code(self, scene: Any, results: Results) -> np.ndarray:
        """The codes, once it is seen what a small step was."""
        mapped = jax.vmap(explained, in_axes=(0, self._members.axes()[0], 0, 0))
        state = self.states(results.final_y)
        some = slice(len(results.code))
        mine: OfLeaf = lambda axis, x: x if axis is None else x[some]
        scene = by_axis(mine, self._members.scene_axes, scene)
        known = results.code, scene, results.final_time, state
        return np.asarray(cast(Array, mapped(*known)))


_Shape: TypeAlias = tuple[tuple[int, ...], np.dtype[Any]]  # with the type of numbers


class _Kind(NamedTuple):
    """What a compiled loop depends on, apart from numbers."""

    tree: Any
    leaves: tuple[_Shape, ...]
    own: tuple[bool, ...]
    state: Any
    sizes: tuple[_Shape, ...]
    zeros: tuple[bytes, ...]
    extended: bool


@functools.lru_cache(maxsize=64)
def _compiled(kind: _Kind, solver: Any) -> LaneLoop:
    like = jax.tree.unflatten(
        kind.state, [jax.ShapeDtypeStruct(*size) for size in kind.sizes]
    )

    def derivative(t: Array, y: Array, *leaves: Array) -> Array:
        scene, _ = jax.tree.unflatten(kind.tree, leaves)
        return pack(rolling_derivative(scene, t, unpack(y, like)))

    def values(t: Array, y: Array, *leaves: Array) -> Array:
        scene, events = jax.tree.unflatten(kind.tree, leaves)
        return values_of(events, scene, t, unpack(y, like))

    example, events = jax.tree.unflatten(
        kind.tree, [jax.ShapeDtypeStruct(*leaf) for leaf in kind.leaves]
    )
    return LaneLoop(
        derivative,
        jax.eval_shape(pack, like),
        [jax.ShapeDtypeStruct(*leaf) for leaf in kind.leaves],
        list(kind.own),
        weights_of(solver(), "the loop over lanes"),
        zeros=kind.zeros,
        extended=kind.extended,
        watch=unbroken_numbers(unbroken, example, like),
        events=Looked(values, layout_of(events)) if events else None,
    )


def _corners_differ(scene: Any, axes: list[int | None]) -> bool:
    """Whether numbers in which members differ reach the times of corners."""
    return any(_differing(lambda scene: corners(scene)[0], scene, axes))


def _ready_axes(scene: Any, axes: list[int | None]) -> list[int | None]:
    """Of each leaf of a scene as runs take it: 0 where members differ, else None."""
    if ready_for_runs(scene) is scene:
        return axes
    return [0 if x else None for x in _differing(ready_for_runs, scene, axes)]


def _differing(
    function: Callable[[Any], Any], scene: Any, axes: list[int | None]
) -> list[bool]:
    """Which results of a scene numbers in which members differ reach."""
    leaves, tree = cast("tuple[list[Any], Any]", jax.tree.flatten(scene))
    places = [i for i, axis in enumerate(axes) if axis is not None]

    def found(own: list[Any]) -> list[Any]:
        known = dict(zip(places, own, strict=True))
        every = [known.get(i, leaf) for i, leaf in enumerate(leaves)]
        return jax.tree.leaves(function(jax.tree.unflatten(tree, every)))

    program = jax.make_jaxpr(found)([leaves[i] for i in places])
    return reached_outputs(program.jaxpr)


def _shape_of(x: Any) -> jax.ShapeDtypeStruct:
    return jax.ShapeDtypeStruct(x.shape, x.dtype)


def _readied(scene: Scene, start: Any, time: Any, span: Any) -> tuple[Array, ...]:
    """A packed start, sizes of its numbers, the first step [s], and what is wrong.

    That as a field's number, a code, and whether there is none.
    """
    fault, code = first_fault(scene, start, jnp.asarray(True))
    start = consistent(scene, time, start)
    y = pack(start)
    good = (fault == NO_FAULT) & jnp.all(jnp.isfinite(y))
    y = jnp.where(good, y, 0.0)
    step = coarse(first_step(start.angular_velocity, span))
    step = jnp.where(jnp.isfinite(step), step, 1.0)
    return y, coarse(pack(error_sizes(start))), step, fault, code, good


@eqx.filter_jit
def _prepared(
    axes: tuple[Any, Any],
    count: int,
    scene: Any,
    starts: Any,
    time: Float[Array, ""],
    span: Float[Array, ""],
) -> tuple[Array, ...]:
    in_axes = (*axes, None, None)
    mapped = jax.vmap(_readied, in_axes, axis_size=count)
    return mapped(scene, starts, time, span)
