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
from ..codegen.linear_call import is_asked_for
from ..codegen.tableau import stage_sum
from ..codegen.tracing import becomes_c
from ..geometry.small_linear import dot
from ..kinematics.coordinates import pack, unpack
from .mode_rates import Cond, Seen, picked, plain_cond
from .mode_replay import KIND, EndOf, Place, Record, Taken
from .mode_tangents import Make, OfPlace, of_place
from .modes import HybridState, ModedState, Switches

# Of path, time and state, as a run leaves them.
Cotangents: TypeAlias = tuple[tuple[ModedState, None, Switches], Array, ModedState]
_Of: TypeAlias = Callable[[Array], Array]
# Number of a step and of its event, then cotangents: of its end, of the time of the
# change before those that followed at once, of the inputs.
_Back: TypeAlias = tuple[Array, Array, OfPlace, Array, Any]
# Of a step's begin: of time, state in one array, and direction of a slip.
_Begin: TypeAlias = tuple[Float[Array, ""], Float[Array, " n"], Float[Array, "3"]]
# Of the inputs, of the begin, and of the time of the end.
_OfStep: TypeAlias = tuple[Any, _Begin, Float[Array, ""]]
# Number of a turn, how what was asked follows the step's end, and what was found last.
_Along: TypeAlias = tuple[Array, Float[Array, "4"], _OfStep]
# Number of a stage, then cotangents: of its rates, the inputs, the begin, the end.
_BackStages: TypeAlias = tuple[Array, Float[Array, "s n"], Any, _Begin, Array]


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
        cotangents: Of path, time and state, as a run leaves them, some perhaps not
            asked for (``codegen.linear_call``); those of integers are not looked at.
    """
    (saved, _, switches), t, last = cotangents

    def of_shown(taken: Taken, count: Int[Array, ""], since: Array) -> OfPlace:
        """What outputs and switches ask of the end of a step, and what follows."""
        event = taken.kind >= 0

        def part(where: Array, array: Array, i: Array) -> Array:
            if not is_asked_for(array):
                return array[0, ...]
            return jnp.where(where, array[i], 0.0)

        at_output: _Of = lambda array: part(taken.output > 0, array, taken.output)
        at_event: _Of = lambda array: part(event, array, count)
        y, direction = jax.tree.map(at_output, (saved.parts, saved.direction))
        time, changed = jax.tree.map(at_event, (switches.time, switches.state))
        time = time + jnp.where(event, since, 0.0)
        return time, jax.tree.map(jnp.add, y, changed), direction

    def one(carry: _Back) -> _Back:
        i, count, cotangent, since, of_varied = carry
        event = record.steps[i, KIND] >= 0
        count = count - jnp.where(event, 1, 0)
        taken = record.step(i, count)
        both = cotangent, of_shown(taken, count, since)
        own, cotangent, follows = _through_step(make, varied, taken, both)
        since = jnp.where(event, 0.0, since) + follows
        return i - 1, count, cotangent, since, jax.tree.map(jnp.add, of_varied, own)

    cotangent = t, last.parts, last.direction
    zeros: _Of = lambda x: jnp.zeros_like(x)
    none = jax.tree.map(zeros, varied)
    carry = record.length - 1, record.events, cotangent, jnp.zeros_like(t), none
    more: Callable[[_Back], Array] = lambda c: c[0] >= 0
    *_, cotangent, since, of_varied = jax.lax.while_loop(more, one, carry)

    start: Callable[[Any], OfPlace] = lambda varied: make.begun(varied, mode)
    at_first: _Of = lambda x: x[0]
    first = jax.tree.map(at_first, (saved.parts, saved.direction))
    cotangent = cotangent[0] + since, *jax.tree.map(jnp.add, cotangent[1:], first)
    (own,) = pulled(start, (varied,), cotangent)
    return jax.tree.map(jnp.add, of_varied, own)


def _through_step(
    make: Make, varied: Any, taken: Taken, cotangent: tuple[OfPlace, OfPlace]
) -> tuple[Any, OfPlace, Float[Array, ""]]:
    """Cotangents of the inputs, of time, state and direction before a step.

    And of the time of the last change, if the step's event follows it at once.

    Args:
        make: What the run is made of.
        varied: Tree of floats.
        taken: The step.
        cotangent: Of time, state and direction where the next step begins, and of those
            that are shown.
    """
    cond = plain_cond if becomes_c() else _cond
    t = taken.begun.t
    when: Callable[[Any, Array], Array]
    when = lambda varied, since: taken.ends(make.times(varied), since)
    ends = when(varied, t)

    def behind(
        varied: Any, direction: Array, t: Array, y: HybridState
    ) -> tuple[OfPlace, OfPlace]:
        both = taken.behind(make.motion(varied), direction, t, y, cond)
        return of_place(both[0]), of_place(both[1])

    at_end = varied, taken.begun.direction, ends, taken.y
    own, turned, of_t, of_y = pulled(behind, at_end, cotangent)
    found = _through_stages(make, varied, taken, ends, (of_t, of_y), cond)
    of_varied, (of_begin, of_start, of_direction), of_ends = found
    of_when, since = pulled(when, (varied, t), of_t + of_ends)
    total = jax.tree.map(lambda *x: sum(x), own, of_varied, of_when)
    return total, (of_begin, unpack(of_start, taken.y), turned + of_direction), since


# Turns of a step's way back: the slip that ends or, in the last of them, the event's
# value; the state at its end; all at once.
_VALUE, _STATE, _ALL = 2, 3, 4


def _through_stages(
    make: Make,
    varied: Any,
    taken: Taken,
    ends: Float[Array, ""],
    cotangent: tuple[Float[Array, ""], HybridState],
    cond: Cond,
) -> _OfStep:
    """Cotangents of a step up to where an event changes its state.

    An event's time moves, and with it the step's end. So of an event two turns before
    the last, of the end of a slip four, ask how that moves what is looked at there.

    Args:
        make: What the run is made of.
        varied: Tree of floats.
        taken: The step.
        ends: When it ends [s].
        cotangent: Of time and state there.
        cond: As ``plain_cond``.
    """
    motion = make.motion(varied)
    t, y, mode, direction = taken.begun
    known, at, _, last = motion.stages(mode, direction, t, ends, y)
    stages = _Stages(make, varied, taken.begun, ends, known)
    slides, (of_t, of_y) = taken.slides(motion), cotangent
    zeros: _Of = lambda x: jnp.zeros_like(x)
    still = jax.tree.map(zeros, of_y)
    places, ways = jnp.arange(4), jnp.arange(3)

    def one(carry: _Along) -> _Along:
        turn, follows, _ = carry
        moved = taken.moved(motion, follows[_VALUE], follows[:_STATE])
        way, last_turn = moved.way, turn == _ALL
        back = jnp.where(last_turn, -(of_t + follows[_STATE]), 0.0)
        value = jnp.where((turn == _VALUE) & ~slides, 1.0, back * moved.value)
        slip = jnp.where((turn == ways) & slides, 1.0, 0.0)
        asked = (
            jnp.where(jnp.arange(2) == taken.number, value, 0.0),
            _with_slip(picked(turn == _STATE, of_y, still), slip),
            _with_slip(picked(last_turn, of_y, still), back * moved.slip),
        )

        def end(
            varied: Any, direction: Array, ends: Array, at: Array, last: Seen
        ) -> EndOf:
            motion = make.motion(varied)
            return taken.at_end(motion, direction, ends, at, last, way, cond)

        at_end = varied, direction, ends, at, last
        own, turned, of_time, of_at, of_last = pulled(end, at_end, asked)
        total, (of_begin, of_start, of_way), of_ends = stages.pulled(of_at, of_last)
        of_ends = of_ends + of_time
        found = (
            jax.tree.map(jnp.add, own, total),
            (of_begin, of_start, turned + of_way),
            of_ends,
        )
        return turn + 1, jnp.where(places == turn, of_ends, follows), found

    begin = zeros(t), zeros(pack(y)), zeros(direction)
    none = jax.tree.map(zeros, varied), begin, zeros(t)
    first = jnp.where(slides, 0, jnp.where(taken.kind >= 0, _VALUE, _ALL))
    more: Callable[[_Along], Array] = lambda carry: carry[0] <= _ALL
    carry = first, jnp.zeros(4, t.dtype), none
    return jax.lax.while_loop(more, one, carry)[2]


def _with_slip(y: HybridState, slip: Float[Array, "3"]) -> HybridState:
    """A state's cotangent with more of its slip's."""
    return eqx.tree_at(lambda y: y.slip, y, y.slip + slip)


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
