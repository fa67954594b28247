"""Batches of runs in modes: plain steps in lanes, others as a run alone takes them.

A step is plain that has no event near, no output to end on, and a contact that rolls
or slips: it is accepted or made shorter by its error alone. So most steps are. Members
whose next step may not be plain are taken on by the loop of ``mode_loop``: both make
the same steps.
"""

import functools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Protocol, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ..codegen import (
    Bounds,
    Carried,
    LaneMode,
    MemberLanes,
    NoCompilerError,
    Whole,
    in_one_program,
)
from ..codegen.member_lanes import SMALL, Told
from ..codegen.scalar_program import NotElementwiseError
from ..codegen.tableau import Weights
from ..dynamics.directed_friction import SMALLEST_SLIP
from ..dynamics.precision import at_precision
from ..dynamics.rolling import watches_headings
from ..kinematics.coordinates import pack, unpack
from .event_bounds import BESIDE, RANGES, dip_tables
from .mode_loop import Loop
from .mode_rates import beside_ends
from .modes import HybridState, Mode
from .slip_bounds import NEARER, SETTLES
from .step_trial import Run
from .transitions import FOLLOWED, Motion


class Runs(Protocol):
    """Runs of one structure, of their inputs: a scene, and all else that they have."""

    @property
    def weights(self) -> Weights:
        """Of an explicit Runge-Kutta pair."""
        ...

    def loop(self, inputs: Any) -> tuple[Loop, Array, HybridState]:
        """The loop of steps of a run, its first mode and its start."""
        ...

    def ended(self, inputs: Any, c: Run) -> Any:
        """What comes out of it."""
        ...

    def stepped(self, inputs: Any, recording: bool) -> tuple[Any, Any]:
        """The same of all of its steps, and their record."""
        ...

    def motion(self, scene: Any, dtype: np.dtype) -> Motion:
        """Rates and events of a scene."""
        ...


class _Members(NamedTuple):
    """Runs of a batch, by the arrays that each of them depends on.

    Attributes:
        runs: By their inputs.
        most: Steps that may be tried.
        tree: Of all arrays.
        of_scene: Of the first of them, the scene's.
        fixed: All else of the inputs.
    """

    runs: Runs
    most: int
    tree: Any
    of_scene: Any
    fixed: Any

    def inputs(self, arrays: Sequence[Array]) -> Any:
        """Of a run."""
        return eqx.combine(jax.tree.unflatten(self.tree, arrays), self.fixed)

    def motion(self, leaves: Sequence[Array]) -> Motion:
        """Of a scene's arrays."""
        parts = jax.tree.unflatten(self.of_scene, leaves), self.fixed[0]
        return self.runs.motion(eqx.combine(*parts), leaves[0].dtype)

    def whole(self, arrays: list[Array]) -> Any:
        """What comes out of a run."""
        return self.runs.stepped(self.inputs(arrays), recording=False)[0]

    def alone(self, arrays: list[Array]) -> Any:
        """The same, as a program in C."""
        return in_one_program(self.whole, arrays)

    def begun(self, arrays: list[Array]) -> Run:
        """What a run carries first."""
        loop, mode, y = self.runs.loop(self.inputs(arrays))
        return loop.begun(mode, y, 0)

    def advanced(self, arrays: list[Array], run: Run) -> tuple[Run, Told]:
        """One turn of the loop and more, until plain steps follow, or the end."""
        loop, *_ = self.runs.loop(self.inputs(arrays))

        def going(carry: tuple[Run, Array]) -> Bool[Array, ""]:
            run, first = carry
            return loop.going(run, self.most) & (first | (loop.lane(run) == 0))

        def turn(carry: tuple[Run, Array]) -> tuple[Run, Array]:
            return loop.step(carry[0]), jnp.asarray(False)

        first = run, jnp.asarray(True)
        run, _ = jax.lax.while_loop(going, turn, first)
        lane = jnp.where(loop.going(run, self.most), loop.lane(run), 0)
        goal, most = loop.landings.ends[run.landing], jnp.asarray(self.most)
        atol = pack(unpack(loop.atol, run.place.y))
        return run, Told(lane, goal, most, loop.rtol, atol)

    def ended(self, arrays: list[Array], run: Run) -> Any:
        """What comes out of one that has ended."""
        return self.runs.ended(self.inputs(arrays), run)


def one_or_many(runs: Runs, inputs: Any, most: int) -> Any:
    """What comes out of a run in C; of those of a batch in lanes, where they can be.

    Args:
        runs: By their inputs.
        inputs: Of this one, or of all.
        most: Steps that may be tried.

    Raises:
        NotElementwiseError: an operation that is not written in C.
        NoCompilerError: no C compiler.
    """
    arrays, fixed = cast("tuple[Any, Any]", eqx.partition(inputs, eqx.is_array))
    leaves, tree = cast("tuple[list[Array], Any]", jax.tree.flatten(arrays))
    of_scene = cast(Any, jax.tree.structure(arrays[0]))
    members = _Members(runs, most, tree, of_scene, fixed)
    call = jax.custom_batching.custom_vmap(members.alone)

    @call.def_vmap
    def _(size: int, differ: list[list[bool]], leaves: list[Array]) -> tuple[Any, Any]:
        try:
            found = _in_lanes(members, size, differ[0], leaves)
        except (NotElementwiseError, NoCompilerError):
            axes = [0 if own else None for own in differ[0]]
            many = jax.vmap(members.alone, in_axes=(axes,), axis_size=size)
            found = many(leaves)
        every: Callable[[Any], bool] = lambda x: True
        return found, jax.tree.map(every, found)

    return call(leaves)


def _in_lanes(
    members: _Members, size: int, differ: Sequence[bool], arrays: list[Array]
) -> Any:
    """What comes out of the runs of a batch.

    Args:
        members: Of it.
        size: Of it.
        differ: Which of the arrays have an axis in front, of its members.
        arrays: That they depend on.

    Raises:
        NotElementwiseError: scenes whose steps are not for lanes.
        NoCompilerError: no C compiler.
    """
    like = [
        jax.ShapeDtypeStruct(x.shape[int(own) :], x.dtype)
        for x, own in zip(arrays, differ, strict=True)
    ]
    _check_plain(members, like)
    axes = [0 if own else None for own in differ]
    begin: Callable[[list[Array]], Run]
    begin = lambda arrays: in_one_program(members.begun, arrays)
    begun = jax.vmap(begin, in_axes=(axes,), axis_size=size)(arrays)
    shape: Callable[[Array], Any]
    shape = lambda x: jax.ShapeDtypeStruct(x.shape[1:], x.dtype)
    carried = cast(Run, jax.tree.map(shape, begun))
    program = Whole.of(members.advanced, like, carried)
    if program.closed:
        raise NotElementwiseError("numbers that a scene's functions close over")
    count = members.of_scene.num_leaves
    modes = _modes(members, like[:count], carried.place.y)
    weights = members.runs.weights
    known = like[:count], list(differ[:count])
    lanes = MemberLanes(
        program, _places(carried), modes, weights, _bounds(weights, carried), *known
    )
    pairs = zip(arrays, differ, strict=True)
    given = [x if own else x[None] for x, own in pairs]
    run, _ = lanes(size, [*given, *jax.tree.leaves(begun)], given[:count])
    end: Callable[[list[Array], Run], Any]
    end = lambda arrays, run: in_one_program(members.ended, arrays, run)
    return jax.vmap(end, in_axes=(axes, 0), axis_size=size)(arrays, run)


def _check_plain(members: _Members, like: list[Any]) -> None:
    """Refuse runs with further reasons for which a step may not stand."""
    found: list[tuple[Loop, HybridState]] = []

    def look(arrays: list[Array]) -> Array:
        loop, _, y = members.runs.loop(members.inputs(arrays))
        found.append((loop, y))
        return loop.rtol

    jax.eval_shape(look, like)
    ((loop, y),) = found
    watched = loop.allowed is not None or watches_headings(loop.motion.scenes.rolling)
    numbers = sum(x.size for x in jax.tree.leaves(y))
    if watched or loop.events or numbers > SMALL:
        raise NotElementwiseError("steps that are watched for more than their contact")


def _places(carried: Run) -> tuple[int, Carried]:
    """How many small numbers a run carries, and where those of lanes are."""
    leaves, tree = cast("tuple[list[Any], Any]", jax.tree.flatten(carried))
    place = 0
    places: list[np.ndarray] = []
    for leaf in leaves:
        count = leaf.size if leaf.size <= SMALL else 0
        places.append(place + np.arange(count))
        place += count
    at = cast(Run, jax.tree.unflatten(tree, places))
    first: Callable[[Any], int] = lambda x: int(x[0])
    state = np.concatenate(jax.tree.leaves(at.place.y))
    begin, direction = first(at.place.t), first(at.place.direction)
    parts = begin, first(at.step), state, direction, first(at.values)
    return place, Carried(*parts, first(at.accepted), first(at.tried))


def _bounds(weights: Weights, carried: Run) -> Bounds:
    """What lanes know a plain step by."""
    rows, nodes = weights.padded
    dips = dip_tables(np.concatenate([nodes, BESIDE]))
    known = carried.place.t
    followed = at_precision(FOLLOWED, known)
    smallest = at_precision(SMALLEST_SLIP, known)
    sizes = RANGES, followed, smallest, SETTLES, NEARER
    return Bounds(*sizes, beside_ends(rows[-1]), dips)


def _modes(
    members: _Members, leaves: Sequence[Any], like: HybridState
) -> list[LaneMode]:
    """The modes that have plain steps, in order."""
    count = sum(x.size for x in jax.tree.leaves(like))
    fly = like.position.size + like.velocity.size

    def made(mode: Mode, moved: int) -> LaneMode:
        def stage(
            turns: bool,
            t: Float[Array, ""],
            numbers: Float[Array, " m"],
            *leaves: Array,
        ) -> tuple[Array, Array]:
            rest = jnp.zeros(count - moved, numbers.dtype)
            y = unpack(jnp.concatenate([numbers[:moved], rest]), like)
            slips = mode == Mode.SLIPPING
            direction = numbers[moved:] if slips else jnp.zeros(3, numbers.dtype)
            rates, seen = members.motion(leaves).plain(mode, direction, t, y, turns)
            shown = [seen.values]
            if turns:
                shown += [seen.turn[None], seen.out]
            return pack(rates)[:moved], jnp.concatenate(shown)

        slips = mode == Mode.SLIPPING
        end = functools.partial(stage, slips)
        return LaneMode(functools.partial(stage, False), end, moved, slips)

    kept: list[bool] = []

    def look(leaves: Sequence[Array]) -> Array:
        kept.append(members.motion(leaves).modes.friction is not None)
        return jnp.zeros(())

    jax.eval_shape(look, leaves)
    rolls = made(Mode.ROLLING, count - fly - like.slip.size)
    return [rolls, made(Mode.SLIPPING, count - fly)] if kept[0] else [rolls]
