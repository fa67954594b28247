"""Events of a run: what is looked for, and what was found, by name."""

import warnings
from collections.abc import Sequence
from typing import Any, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..codegen.event_layout import Layout
from ..dynamics.events import Event, bound, known_event, refuse_closure
from ..hybrid.modes import HybridScene, of, slipping
from ..integration.event_search import Happened, layout_of
from ..validation.checks import FieldError, is_traced


class Crossings(eqx.Module):
    """Where one event happened, in the order of the run.

    Of one run with known numbers there are as many as happened; where they are traced,
    or of many runs, as many as are kept, unused ones NaN.

    Attributes:
        times: [s], shape (k,).
        states: States there, every array with a leading k.
        count: How often it happened [1], those that are not kept as well.
    """

    times: Float[Array, "*B k"]
    states: Any
    count: Int[Array, "*B"]


class EventRecord(eqx.Module):
    """Events of one run or of many, with the batch in front.

    Attributes:
        time: [s], shape (R,): those of each event in order, one event behind the other.
        state: States there, every array with a leading R; unused ones NaN.
        number: How often each happened, shape (E,).
        by: Which one ended the run; -1: none.
        names: Of each.
        layout: Of the places.
    """

    time: Float[Array, "*B R"]
    state: Any
    number: Int[Array, "*B E"]
    by: Int[Array, "*B"]
    names: tuple[str, ...] = eqx.field(static=True)
    layout: Layout = eqx.field(static=True)

    def by_name(self) -> dict[str, Crossings]:
        """What was found of each event.

        Warns:
            RuntimeWarning: more of one run than is kept.
        """
        of_each = zip(self.names, self.layout.firsts, self.layout.mosts, strict=True)
        return {
            name: self._of(i, name, first, most)
            for i, (name, first, most) in enumerate(of_each)
        }

    def _of(self, i: int, name: str, first: int, most: int) -> Crossings:
        count, axis = self.number[..., i], self.time.ndim - 1
        kept = most
        if not is_traced(self.time, count) and not axis:
            kept = min(int(count), most)
            if int(count) > most:
                warnings.warn(
                    f'the event "{name}" happened {int(count)} times, of which the '
                    f"first {most} are kept: give Event(most=) more",
                    RuntimeWarning,
                    stacklevel=4,
                )
        places = (slice(None),) * axis + (slice(first, first + kept),)

        def own(x: Any) -> Any:
            if is_traced(x):
                return x[places]
            return jnp.asarray(np.asarray(x)[places])  # compiles nothing

        return Crossings(own(self.time), jax.tree.map(own, self.state), count)

    def name_of_end(self, by: int) -> str:
        """Of the event that ended a run; nothing where none did."""
        return self.names[by] if by >= 0 else ""


def record_of(events: Sequence[Event], happened: Happened) -> EventRecord:
    """What was found, of events that were looked for; ``y`` has states."""
    parts = happened.time, happened.y, happened.number, happened.by
    return EventRecord(*parts, tuple(e.name for e in events), layout_of(events))


def events_of(
    given: Any, stop: Any, scene: Any, t: Any, state: Any, where: str = "simulate"
) -> tuple[Event, ...]:
    """The events of a run, each with a name of its own.

    Args:
        given: Events, or ready ones by their names.
        stop: What ends the run: one or several of the like, or None.
        scene: Of the run.
        t: A time [s].
        state: A state.
        where: Name of what was called, for errors.

    Raises:
        FieldError: no events, or two of one name.
    """
    found = _named(given, stop, where)
    if not found:  # making an array takes as long as a short run
        return ()
    at = jnp.asarray(t)
    return tuple(bound(event, field, scene, at, state) for field, event in found)


def events_in_modes(
    given: Any,
    stop: Any,
    scene: HybridScene,
    t: Array,
    start: Any,
    where: str = "simulate",
) -> tuple[Event, ...]:
    """The events of a run that rolls, slips and flies; each fits all of its modes.

    Raises:
        FieldError: as :func:`events_of`.
    """
    found = _named(given, stop, where)
    if not found:
        return ()

    def in_each(scene: HybridScene, start: Any) -> list[Any]:
        scenes, state, mu = scene.in_modes, of(start), scene.modes.friction
        kinds: list[Any] = [(scenes.rolling, state.rolling())]
        kinds.append((scenes.flying, state.flying()))
        if mu is not None:
            slides = slipping(scenes.rolling, mu, state.slip, state)
            kinds.append((slides, state.sliding()))
        return kinds

    for field, event in found:
        for own, state in cast("list[Any]", jax.eval_shape(in_each, scene, start)):
            refuse_closure(event, field, own, t, state)
    return tuple(event for _, event in found)


def _named(given: Any, stop: Any, where: str) -> list[tuple[str, Event]]:
    """Events with names of their own, each with the field that it was given in."""
    found: list[tuple[str, Event]] = []
    for field, wanted, stops in (
        (f"{where}.events", given, False),
        (f"{where}.stop", stop, True),
    ):
        for i, one in enumerate(_listed(wanted)):
            event = known_event(field, one)
            stopping = stops or event.stop
            name = event.name or f"event {len(found)}"
            most = 1 if stopping else event.most
            event = Event(event.function, event.direction, stopping, name, most)
            found.append((f"{field}[{i}].function", event))
    names = [event.name for _, event in found]
    for name in names:
        if names.count(name) > 1:
            problem, remedy = "is the name of several events", "give each name= its own"
            raise FieldError(f"{where}.events", name, problem, remedy)
    return found


def _listed(given: Any) -> list[Any]:
    if given is None:
        return []
    if isinstance(given, (str, Event)):
        return [given]
    try:
        return list(cast("Sequence[Any]", given))
    except TypeError:
        return [given]  # said to be none where it is looked at
