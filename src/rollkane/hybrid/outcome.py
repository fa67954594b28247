"""What comes out of a run in modes, and why it ended."""

import dataclasses
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ..dynamics.clearance import code_of_touch, may_touch_twice
from ..dynamics.flight_ends import may_pass_an_end, passes_an_end
from ..dynamics.precision import at_precision
from ..dynamics.rolling import LEAST_MARGIN, painleve_margin
from ..dynamics.rolling_problem import at_an_edge, has_edges
from ..dynamics.scene import Scene
from ..integration.event_search import Happened
from ..integration.plans import without_derivative
from ..validation.codes import NO_FAULT, Code, is_stuck
from .mode_replay import Path, Place
from .modes import Mode, ModedState, Switches, as_it_is, slipping
from .step_trial import Allowed, Run
from .transitions import Motion
from .user_events import Kept


class HybridOutcome(eqx.Module):
    """What came out of a run in modes."""

    state: ModedState
    switches: Switches
    code: Array
    final_time: Array
    final_state: ModedState
    steps: Array
    rejected_steps: Array
    fault: Array  # number of the field that cannot be used
    kept: Kept | None = None  # events, as the loop left them
    happened: Happened | None = None  # with states

    @property
    def unknown(self) -> "HybridOutcome":
        """What of it has no derivative."""
        return without_derivative(self, ("final_time", "final_state"))


def ended(
    motion: Motion,
    c: Run,
    outputs: int,
    allowed: Allowed | None,
    fault: Int[Array, ""],
    code_of_fault: Int[Array, ""],
) -> HybridOutcome:
    """What came out of the loop, and why it ended."""
    code = jnp.where((c.code == 0) & (c.path.reached < outputs), Code.MAX_STEPS, c.code)
    stuck = (code == Code.STEP_TOO_SMALL) & (c.accepted == 0)
    code = jnp.where(stuck, Code.BAD_START, code)
    code = _explained(motion, allowed, code, c.place)
    many, rolls = code == Code.TOO_MANY_SWITCHES, motion.scenes.rolling
    if motion.lands and may_touch_twice(rolls):
        several = _at_several_places(c.path.switches)
        code = jnp.where(many & several, Code.SECOND_CONTACT, code)
    if rolls.contact.without_spin:
        between = _slips_on_and_on(c.path.switches)
        code = jnp.where(many & between, Code.NEITHER_GRIPS_NOR_SLIPS, code)
    good = fault == NO_FAULT
    code = jnp.where(good, code, code_of_fault)
    t, last, rejected = c.place.t, c.place.moded, c.tried - c.accepted
    found = outcome_of(c.path, t, last, code, c.accepted, rejected)
    states: Callable[[HybridOutcome], Any] = lambda s: (
        s.state,
        s.switches.state,
        s.final_state,
    )
    spoil: Callable[[Array], Array] = lambda x: (
        jnp.where(good, x, jnp.nan) if eqx.is_inexact_array(x) else x
    )
    found = eqx.tree_at(states, found, jax.tree.map(spoil, states(found)))
    left = None if c.watched is None else c.watched.left
    return dataclasses.replace(found, fault=fault, kept=left)


def _explained(
    motion: Motion, allowed: Allowed | None, code: Int[Array, ""], place: Place
) -> Array:
    """The code of a run, where it got stuck by what stopped it."""
    stuck = is_stuck(code)
    scene, mu = motion.scenes.rolling, motion.modes.friction
    touches = place.mode != Mode.FLYING
    if has_edges(scene):
        at_end = at_an_edge(scene, place.t, place.y.rolling())
        code = jnp.where(stuck & touches & at_end, Code.SURFACE_EDGE, code)
    if may_pass_an_end(scene):
        past = passes_an_end(scene, place.t, place.y.flying())
        code = jnp.where(stuck & ~touches & past, Code.SURFACE_EDGE, code)
    if mu is not None:
        slides = slipping(scene, mu, place.direction, place.y)
        margin = painleve_margin(slides, place.t, place.y.sliding())
        jams = (place.mode == Mode.SLIPPING) & (margin < LEAST_MARGIN)
        code = jnp.where(stuck & jams, Code.PAINLEVE, code)
    if allowed is None:
        return code
    touched: Callable[[Scene, Array, Any], Array] = lambda scene, t, y: code_of_touch(
        code, scene, t, y
    )
    return as_it_is(touched, scene, place.t, place.mode, place.y)


def _at_several_places(switches: Switches) -> Bool[Array, ""]:
    """Whether the last four changes were at one time, and not all at one place."""
    rows, at_once = _last_four(switches)
    places = switches.state.contact_on_base[rows]
    apart = jnp.max(places, axis=0) - jnp.min(places, axis=0)
    # by more than half of the digits
    half = float(np.finfo(places.dtype).eps) ** 0.5
    return at_once & jnp.any(apart > half * jnp.max(jnp.abs(places)))


def _slips_on_and_on(switches: Switches) -> Bool[Array, ""]:
    """Whether a slip ended and began four times at one time, the last ones."""
    rows, at_once = _last_four(switches)
    both = jnp.stack([switches.before[rows], switches.after[rows]])
    return at_once & jnp.all(both == Mode.SLIPPING)


def _last_four(switches: Switches) -> tuple[Int[Array, "4"], Bool[Array, ""]]:
    """The last four changes, and whether they were at one time.

    To touch at one place and be found to touch at the other takes twenty roundings
    (5e-15 s at 0.2 s, of a rod on two humps), and longer as it comes to rest: 1.3e-12 s
    for four of its 64 changes. The bound is a thousand times that, of any other rod's.
    """
    rows = jnp.maximum(switches.count - 4 + jnp.arange(4), 0)
    times = switches.time[rows]
    least = at_precision(1e-9, times) * (1.0 + jnp.abs(times[-1]))
    return rows, times[-1] - times[0] <= least


def outcome_of(
    path: Path,
    t: Float[Array, ""],
    last: ModedState,
    code: Any,
    steps: Any,
    rejected: Any,
) -> HybridOutcome:
    """Of a path, with nothing that is wrong with what was given."""
    none = jnp.asarray(NO_FAULT)
    parts = path.saved, path.switches, code, t, last, steps, rejected, none
    return HybridOutcome(*parts)
