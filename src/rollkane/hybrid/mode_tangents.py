"""Tangents of a run in modes: its recorded steps forwards, each from where it began."""

from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ..codegen.derivatives import jvp
from ..geometry.small_linear import dot
from .mode_rates import picked
from .mode_replay import EndOf, Moved, Path, Place, Record, Taken, begun, stored
from .modes import HybridState, ModedState, Switches
from .transitions import Motion


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

    def begun(self, varied: Any, mode: Int[Array, ""]) -> "OfPlace":
        """Time, state and direction at the start."""
        return of_place(
            begun(self.motion(varied), mode, self.start(varied), self.times(varied))
        )


# Of time, state and direction of a slip.
OfPlace: TypeAlias = tuple[Array, HybridState, Array]
# Number of a step and of its event, then tangents: of its begin, of the time of the
# last change, of what was shown at outputs and at events.
_Forth: TypeAlias = tuple[Array, Array, OfPlace, Array, "_Shown", "_Shown"]
# Number of a turn, tangents along the step's end, and those found last.
_Along: TypeAlias = tuple[Array, EndOf, EndOf]
_INPUTS = 1  # the turn along the inputs; the one before is along the step's end


class _Shown(NamedTuple):
    """Tangents of times, states and directions, each in a row."""

    time: Float[Array, " m"]
    y: HybridState
    direction: Float[Array, "m 3"]

    @staticmethod
    def empty(of_place: OfPlace, rows: int) -> "_Shown":
        """Room for some, all zero."""
        many: Callable[[Array], Array] = lambda x: jnp.zeros((rows, *x.shape), x.dtype)
        return _Shown(*jax.tree.map(many, of_place))

    def after(self, row: Array, where: Array, of_place: OfPlace) -> "_Shown":
        """With those of a place, if there are any."""
        return stored(self, row, where, _Shown(*of_place))


def of_place(place: Place) -> OfPlace:
    """What of a place has derivatives."""
    return place.t, place.y, place.direction


def pushed_on(
    make: Make,
    varied: Any,
    mode: Int[Array, ""],
    record: Record,
    tangents: Any,
    switches: int,
) -> tuple[Path, Float[Array, ""], ModedState]:
    """Tangents of a run's path, last time and last state.

    Args:
        make: What it is made of.
        varied: Tree of floats.
        mode: At the first time.
        record: Of the accepted steps.
        tangents: Of ``varied``.
        switches: How many changes are kept.

    Returns:
        Of whole numbers zeros.
    """
    start: Callable[[Any], OfPlace] = lambda varied: make.begun(varied, mode)
    _, first = jvp(start, (varied,), (tangents,))
    outputs = make.times(varied).shape[0]
    whole = jnp.asarray(0)
    saved = _Shown.empty(first, outputs).after(whole, jnp.asarray(True), first)

    def one(carry: _Forth) -> _Forth:
        i, count, dots, since, saved, changes = carry
        taken = record.step(i, count)
        dots, shown = _through_step(make, varied, taken, tangents, dots, since)
        event = taken.kind >= 0
        since = jnp.where(event, shown[0], since)
        saved = saved.after(taken.output, taken.output > 0, shown)
        changes = changes.after(count, event, shown)
        return i + 1, count + jnp.where(event, 1, 0), dots, since, saved, changes

    more: Callable[[_Forth], Array] = lambda carry: carry[0] < record.length
    carry = whole, whole, first, first[0], saved, _Shown.empty(first, switches)
    *_, (t, y, direction), _, saved, changes = jax.lax.while_loop(more, one, carry)
    none = jnp.zeros(switches, int)
    return (
        Path(
            ModedState(saved.y, jnp.zeros(outputs, int), saved.direction),
            whole,
            Switches(changes.time, none, none, changes.y, whole),
        ),
        t,
        ModedState(y, whole, direction),
    )


def _through_step(
    make: Make, varied: Any, taken: Taken, tangents: Any, dots: OfPlace, since: Array
) -> tuple[OfPlace, OfPlace]:
    """Tangents where the next step begins, and of what this one shows.

    Those of its begin are ``dots``, that of the last change's time is ``since``.

    An event's time moves, and with it the step's end: the first of two tangents is
    along that alone. It is the step's own: as a slip ends its direction may turn
    without end, ever more slowly, and the rates there would not fit its tangents.
    """
    motion = make.motion(varied)
    t, y, mode, direction = taken.begun
    when: Callable[[Any, Array], Array]
    when = lambda varied, since: taken.ends(make.times(varied), since)
    ends, of_ends = jvp(when, (varied, t), (tangents, since))

    own = tangents, *dots, of_ends
    zeros: Callable[[Array], Array] = lambda x: jnp.zeros_like(x)
    along_end = *jax.tree.map(zeros, own[:-1]), jnp.ones_like(t)

    def moved(by_end: EndOf) -> Moved:
        return taken.moved(motion, by_end[0][taken.number], by_end[1].slip)

    def one(carry: _Along) -> _Along:
        turn, by_end, _ = carry
        way = moved(by_end).way

        def end(
            varied: Any, t: Array, y: HybridState, direction: Array, ends: Array
        ) -> EndOf:
            motion = make.motion(varied)
            _, end, _, last = motion.stages(mode, direction, t, ends, y)
            return taken.at_end(motion, direction, ends, end, last, way)

        moving = picked(turn == _INPUTS, own, along_end)
        _, found = jvp(end, (varied, t, y, direction, ends), moving)
        return turn + 1, picked(turn == _INPUTS, by_end, found), found

    none = jnp.zeros(2, t.dtype), jax.tree.map(zeros, y), jax.tree.map(zeros, y)
    turn = jnp.where(taken.kind >= 0, 0, _INPUTS)
    more: Callable[[_Along], Array] = lambda carry: carry[0] <= _INPUTS
    _, by_end, found = jax.lax.while_loop(more, one, (turn, none, none))
    values, _, slid = found
    by = moved(by_end)
    shift = -by.value * values[taken.number] - dot(by.slip, slid.slip)
    shifted: Callable[[Array, Array], Array] = lambda x, rate: x + shift * rate
    after = jax.tree.map(shifted, slid, by_end[1])

    def behind(
        varied: Any, direction: Array, t: Array, y: HybridState
    ) -> tuple[OfPlace, OfPlace]:
        both = taken.behind(make.motion(varied), direction, t, y)
        return of_place(both[0]), of_place(both[1])

    at_end = varied, direction, ends, taken.y
    return jvp(behind, at_end, (tangents, dots[2], of_ends + shift, after))[1]
