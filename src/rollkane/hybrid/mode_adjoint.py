"""Cotangents of a run in modes: its recorded steps backwards, stage by stage.

A stage is transposed in its own mode alone: JAX's transpose of a loop over stages that
choose their mode takes a multiple of the time to trace, and keeps what all modes need.
"""

from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias, cast

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ..codegen.derivatives import pulled
from ..codegen.tableau import stage_sum
from ..codegen.tracing import becomes_c
from ..geometry.small_linear import dot
from ..kinematics.coordinates import pack, unpack
from .mode_rates import Seen, plain_cond
from .mode_replay import KIND, OUTPUT, Place, Record, begun, behind, landed
from .modes import HybridState, ModedState, Switches
from .transitions import Motion

# Of path, time and state, as ``mode_replay.replayed`` gives them.
Cotangents: TypeAlias = tuple[tuple[ModedState, None, Switches], Array, ModedState]
_Of: TypeAlias = Callable[[Array], Array]
# Of time, state and direction of a slip.
_OfPlace: TypeAlias = tuple[Array, HybridState, Array]
# Number of a step and of its event, then cotangents: of its end, of the inputs.
_Back: TypeAlias = tuple[Array, Array, _OfPlace, Any]
# Of a step's begin: of time, state in one array, and direction of a slip.
_Begin: TypeAlias = tuple[Array, Float[Array, " n"], Float[Array, "3"]]
# Number of a stage, then cotangents: of its rates, the inputs, the begin, the end.
_BackStages: TypeAlias = tuple[Array, Float[Array, "s n"], Any, _Begin, Array]


class Make(NamedTuple):
    """What a run is made of, by a tree of floats.

    Attributes:
        motion: Rates and events.
        start: State at the first time.
        times: Of outputs [s].
    """

    motion: Callable[[Any], Motion]
    start: Callable[[Any], HybridState]
    times: Callable[[Any], Float[Array, " T"]]


def pulled_back(
    make: Make,
    varied: Any,
    mode: Int[Array, ""],
    record: Record,
    cotangents: Cotangents,
) -> Any:
    """Cotangents of a run's inputs: its steps backwards, each from where it began.

    Args:
        make: What it is made of.
        varied: Tree of floats.
        mode: At the first time.
        record: Of the accepted steps.
        cotangents: Of path, time and state, as ``mode_replay.replayed`` gives them;
            those of integers are not looked at.
    """
    (saved, _, switches), t, last = cotangents

    def of_shown(row: Float[Array, "4"], number: Int[Array, ""]) -> _OfPlace:
        """What outputs and switches ask of the end of a step."""
        output, event = row[OUTPUT].astype(int), row[KIND] >= 0
        part: Callable[[Array, Array, Array], Array] = lambda where, array, i: (
            jnp.where(where, array[i], 0.0)
        )
        at_output: _Of = lambda array: part(output > 0, array, output)
        at_event: _Of = lambda array: part(event, array, number)
        y, direction = jax.tree.map(at_output, (saved.parts, saved.direction))
        time, changed = jax.tree.map(at_event, (switches.time, switches.state))
        return time, jax.tree.map(jnp.add, y, changed), direction

    def one(carry: _Back) -> _Back:
        i, number, cotangent, of_varied = carry
        kept: _Of = lambda x: x[i]
        place = jax.tree.map(kept, record.kept)
        number = number - jnp.where(record.steps[i, KIND] >= 0, 1, 0)
        row, turn = record.step(i, number)
        cotangent = list(cotangent), list(of_shown(row, number))
        own, cotangent = _through_step(make, varied, place, row, turn, cotangent)
        return i - 1, number, cotangent, jax.tree.map(jnp.add, of_varied, own)

    cotangent = t, last.parts, last.direction
    zeros: _Of = lambda x: jnp.zeros_like(x)
    none = jax.tree.map(zeros, varied)
    events = jnp.sum(record.steps[:, KIND] >= 0)
    carry = record.length - 1, events, cotangent, none
    more: Callable[[_Back], Array] = lambda c: c[0] >= 0
    *_, cotangent, of_varied = jax.lax.while_loop(more, one, carry)

    def start(varied: Any) -> _OfPlace:
        made = make.motion(varied), mode, make.start(varied), make.times(varied)
        place = begun(*made)
        return place.t, place.y, place.direction

    at_first: _Of = lambda x: x[0]
    first = jax.tree.map(at_first, (saved.parts, saved.direction))
    cotangent = cotangent[0], *jax.tree.map(jnp.add, cotangent[1:], first)
    (own,) = pulled(start, (varied,), cotangent)
    return jax.tree.map(jnp.add, of_varied, own)


def _through_step(
    make: Make,
    varied: Any,
    place: Place,
    row: Float[Array, "4"],
    turn: Float[Array, " m"],
    cotangent: tuple[list[Any], list[Any]],
) -> tuple[Any, _OfPlace]:
    """Cotangents of the inputs, and of time, state and direction before a step.

    Args:
        make: As for :func:`pulled_back`.
        varied: Likewise.
        place: Where the step began.
        row: Of the record.
        turn: What was recorded of its event.
        cotangent: Of time, state and direction where the next step begins, and of those
            that are shown.
    """
    motion, ends = make.motion(varied), landed(make.times(varied), row)
    t, y, mode, direction = place
    known, end, _, last = motion.stages(mode, direction, t, ends, y)

    def after(
        varied: Any,
        direction: Float[Array, "3"],
        end: Float[Array, " n"],
        last: Seen,
    ) -> list[list[Any]]:
        motion, ends = make.motion(varied), landed(make.times(varied), row)
        at = place._replace(direction=direction)
        known = row, turn, ends, end, last
        both = behind(motion, at, *known, cond=plain_cond if becomes_c() else _cond)
        return [[p.t, p.y, p.direction] for p in both]

    moving = varied, direction, end, last
    own, of_direction, of_end, of_last = pulled(after, moving, list(cotangent))
    stages = _Stages(make, varied, place, ends, known)
    of_varied, of_place, of_ends = stages.pulled(of_end, of_last)
    when: _Of = lambda varied: landed(make.times(varied), row)
    of_when = pulled(when, (varied,), of_ends)
    total = jax.tree.map(lambda *x: sum(x), own, of_varied, *of_when)
    of_t, of_y, more = of_place
    return total, (of_t, unpack(of_y, y), of_direction + more)


# plain_cond, each branch of which is transposed by itself: by XLA
_cond = eqx.filter_custom_vjp(plain_cond)


@_cond.def_fwd
def _cond_forwards(
    perturbed: object,
    operands: tuple[Any, ...],
    where: Bool[Array, ""],
    then: Callable[..., Any],
    other: Callable[..., Any],
) -> tuple[Any, None]:
    del perturbed
    return plain_cond(operands, where, then, other), None


@_cond.def_bwd
def _cond_backwards(
    residuals: object,
    cotangent: Any,
    perturbed: object,
    operands: tuple[Any, ...],
    where: Bool[Array, ""],
    then: Callable[..., Any],
    other: Callable[..., Any],
) -> Any:
    del residuals, perturbed
    moving, fixed = cast(tuple[Any, Any], eqx.partition(operands, eqx.is_inexact_array))

    def pulled(branch: Callable[..., Any]) -> Callable[[], Any]:
        outputs: Callable[[Any], Any] = lambda moving: eqx.filter(
            branch(*eqx.combine(moving, fixed)), eqx.is_inexact_array
        )
        return lambda: jax.vjp(outputs, moving)[1](cotangent)[0]

    return cast(Any, jax.lax.cond(where, pulled(then), pulled(other)))


class _Stages(NamedTuple):
    """The stages of a recorded step.

    Attributes:
        make: As for :func:`pulled_back`.
        varied: Likewise.
        place: Where the step began.
        ends: When it ended [s].
        known: Rates at its stages.
    """

    make: Make
    varied: Any
    place: Place
    ends: Array
    known: Float[Array, "s n"]

    def pulled(
        self, of_end: Float[Array, " n"], of_last: Seen
    ) -> tuple[Any, _Begin, Float[Array, ""]]:
        """Cotangents of inputs, of the step's begin, and of the time at which it ends.

        Args:
            of_end: Cotangent of the state that the last stage is at, in one array.
            of_last: Of what is seen there.
        """
        tableau = self.make.motion(self.varied).tableau
        t, y, _, direction = self.place
        start, h = pack(y), self.ends - t
        last = tableau.nodes.shape[0] - 1

        def one(carry: _BackStages) -> _BackStages:
            i, of_rates, total, (of_t, of_start, of_direction), of_ends = carry
            weights, node = tableau.rows[i], tableau.nodes[i]
            way = stage_sum(weights, self.known)
            time = jnp.where(i == last, self.ends, t + node * h)
            at_end: _Of = lambda x: jnp.where(i == last, x, 0.0)
            cotangent = of_rates[i], jax.tree.map(at_end, of_last)
            own, turned, of_time, of_at = self._through(
                time, start + h * way, cotangent
            )
            of_at = of_at + at_end(of_end)
            of_h = dot(of_at, way) + node * of_time
            begin = of_t + of_time - of_h, of_start + of_at, of_direction + turned
            of_rates = of_rates + h * (weights[:, None] * of_at[None, :])
            total = jax.tree.map(jnp.add, total, own)
            return i - 1, of_rates, total, begin, of_ends + of_h

        zeros: _Of = lambda x: jnp.zeros_like(x)
        none = jax.tree.map(zeros, self.varied)
        begin = jnp.zeros_like(t), jnp.zeros_like(start), jnp.zeros_like(direction)
        rates, of_ends = jnp.zeros_like(self.known), jnp.zeros_like(t)
        carry = jnp.asarray(last), rates, none, begin, of_ends
        more: Callable[[_BackStages], Array] = lambda c: c[0] >= 0
        *_, total, begin, of_ends = jax.lax.while_loop(more, one, carry)
        return total, begin, of_ends

    def _through(
        self,
        time: Float[Array, ""],
        at: Float[Array, " n"],
        cotangent: tuple[Float[Array, " n"], Seen],
    ) -> tuple[Any, Float[Array, "3"], Float[Array, ""], Float[Array, " n"]]:
        """Cotangents of inputs, direction, time and state of one stage."""
        y, mode = self.place.y, self.place.mode

        def pulled_in(number: int) -> Callable[..., Any]:
            def seen(
                varied: Any,
                direction: Float[Array, "3"],
                time: Float[Array, ""],
                at: Float[Array, " n"],
            ) -> tuple[Float[Array, " n"], Seen]:
                motion = self.make.motion(varied)
                rates, seen = motion.by_mode[number](direction, time, unpack(at, y))
                return pack(rates), seen

            def back(cotangent: Any, *where: Any) -> Any:
                return pulled(seen, where, cotangent)

            return back

        where = self.varied, self.place.direction, time, at
        branches = [pulled_in(i) for i in range(3)]
        return cast(Any, jax.lax.switch(mode, branches, cotangent, *where))
