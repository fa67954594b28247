"""When a contact would first have to pull."""

from collections.abc import Callable
from typing import Any, NamedTuple, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ..codegen.compile_effort import for_one_call
from ..dynamics.events import Event
from ..dynamics.rolling import rolling_derivative
from ..dynamics.rolling_problem import corners, error_sizes
from ..dynamics.scene import Scene
from ..hybrid.modes import ModedState
from ..integration.backends import run_by, without_native
from ..integration.integrate import Outcome
from ..integration.plans import Problem
from ..integration.prepared import prepared
from ..kinematics.base_motion import BESIDE_JUMPS
from ..validation.checks import FieldError
from .samples import Axis, Samples, over_axes
from .unreached_outputs import of_reached

_Press = Callable[[Scene, Array, Any], Array]
# Roundings of the clock from a jump to where the force is looked at beside it: four
# times as far as runs stay away from one.
_BESIDE = 4.0 * BESIDE_JUMPS


def first_pull_of(samples: Samples, press: _Press) -> Any:
    """When a normal force would first have to pull [s], by motion; NaN: it never does.

    Args:
        samples: Of a motion or of many.
        press: The force [N], of a scene, a time and a state.

    Raises:
        FieldError: states at one time, or of runs with modes.
    """
    if not samples.axes[-1].of_times:
        problem, remedy = "asks for motions", "ask the ensemble itself"
        raise FieldError("first_pull", "ends alone", problem, remedy)
    if isinstance(samples.state, ModedState):
        problem = "asks for motions that go on where the contact would have to pull"
        remedy = "look at the runs' modes, or leave modes out"
        raise FieldError("first_pull", "runs with modes", problem, remedy)
    return samples.as_given(first_pull(press, *samples))


class _Pulling(eqx.Module):
    """A scene, and a normal force that is followed along its motion.

    Attributes:
        scene: What moves.
        press: The force [N], of a scene, a time and a state.
    """

    scene: Scene
    press: _Press = eqx.field(static=True)

    def along(
        self, t: Float[Array, ""], state: Any
    ) -> tuple[Any, Float[Array, ""], Float[Array, ""]]:
        """Rates of the state; the force [N] and its rate [N/s]."""
        rates = rolling_derivative(self.scene, t, state)
        force: Callable[[Array, Any], Array] = lambda t, s: self.press(self.scene, t, s)
        values = jax.jvp(force, (t, state), (jnp.ones_like(t), rates))
        return rates, *cast(tuple[Array, Array], values)


class _Pressed(eqx.Module):
    """A state, and a normal force, integrated so that no step is longer than it bears.

    A force that a shaken base changes need not move the body.
    """

    state: Any
    press: Float[Array, ""]


def _rates(pulling: _Pulling, t: Array, at: _Pressed) -> _Pressed:
    rates, _, slope = pulling.along(t, at.state)
    return _Pressed(rates, slope)


def _sizes(at: _Pressed) -> _Pressed:
    size = jnp.abs(at.press)
    return _Pressed(error_sizes(at.state), jnp.where(size > 0.0, size, 1.0))


def _corners(pulling: _Pulling) -> tuple[Any, int]:
    return corners(pulling.scene)


def _spin_of_state(at: _Pressed) -> Array:
    return cast(Array, at.state.angular_velocity)


def _spin(state: Any) -> Array:
    return cast(Array, state.angular_velocity)


def _freely(pulling: _Pulling, t: Array, state: Any) -> Any:
    return rolling_derivative(pulling.scene, t, state)


_FOLLOWED = Problem(_rates, _spin_of_state, _sizes, _corners)
_FREELY = Problem(_freely, _spin, error_sizes, _corners)


def _force(pulling: _Pulling, t: Array, at: _Pressed) -> Array:
    return pulling.press(pulling.scene, t, at.state)


def _slope(pulling: _Pulling, t: Array, at: _Pressed) -> Array:
    return pulling.along(t, at.state)[2]


# Where it falls through zero; and where it is least, which is where steps end, so that
# it cannot fall and rise again within one.
_EVENTS = Event(_force, -1, True), Event(_slope, 1, most=1)


@for_one_call
def first_pull(
    press: _Press, scene: Scene, time: Array, state: Any, axes: tuple[Axis, ...]
) -> Array:
    """When a normal force is first not positive [s]; NaN where it never is.

    Found by runs from each output to the next, along which the force is followed.

    Args:
        press: The force [N], of a scene, a time and a state.
        scene: What moved.
        time: [s].
        state: States at the times.
        axes: Of them, as of :class:`Samples`; the last is that of the times.
    """

    def of_one(scene: Scene, time: Array, state: Any) -> Array:
        return cast(Any, _of_motion)(_Pulling(scene, press), time, state)

    axes, count = axes[:-1], state.angular_velocity.ndim - 2
    return over_axes(of_one, scene, axes, count)(scene, jnp.asarray(time), state)


@eqx.filter_custom_jvp
def _of_motion(pulling: _Pulling, time: Float[Array, " T"], state: Any) -> Array:
    return _searched(pulling, time, state).time


@_of_motion.def_jvp
def _moved(primals: tuple[Any, ...], tangents: tuple[Any, ...]) -> tuple[Array, Array]:
    """By a run from the output before it, and one step of Newton's at its end.

    That run needs no derivative of the force's rate, which has second ones of surfaces
    and loads.
    """
    found = _searched(*primals)
    take: Callable[[Array], Array] = lambda x: x[found.after]
    last: Callable[[Array], Array] = lambda x: x[-1]

    def moved(pulling: _Pulling, time: Float[Array, " T"], state: Any) -> Array:
        start = jax.tree.map(take, state)
        begins, never = time[found.after], jnp.isnan(found.time)
        unknown = never | found.jumps | found.at_once
        ends: Array = time[jnp.minimum(found.after + 1, time.shape[0] - 1)]
        when = jax.lax.stop_gradient(jnp.where(unknown, ends, found.time))
        end = _run(_FREELY, pulling, jnp.stack([begins, when]), start, ()).state
        at_end = jax.tree.map(last, end)
        force = pulling.press(pulling.scene, when, at_end)
        slope = jax.lax.stop_gradient(pulling.along(when, at_end)[2])
        # a force that jumps through zero has no derivative there
        loose = np.sqrt(np.finfo(when.dtype).eps) * jnp.abs(slope * (ends - begins))
        moves = (jnp.abs(force) <= loose) & ~found.jumps
        still = never | found.at_once
        share = jnp.where(still, 0.0, jnp.where(moves, 1.0, jnp.nan))
        by_force = -force / jnp.where(slope == 0.0, 1.0, slope) * share
        return jnp.where(found.at_once, begins, by_force)

    along = cast(Any, eqx.filter_jvp)(moved, primals, tangents)
    return found.time, along[1]


class _Found(NamedTuple):
    """When a force falls to zero [s], NaN: never; behind which output, and how.

    Attributes:
        time: [s].
        after: Number of the output before it, or on which it is.
        at_once: Whether it is the first of all.
        jumps: Whether it falls by a jump on an output.
    """

    time: Float[Array, ""]
    after: Int[Array, ""]
    at_once: Bool[Array, ""]
    jumps: Bool[Array, ""]


def _searched(pulling: _Pulling, time: Float[Array, " T"], state: Any) -> _Found:
    scene, press = pulling.scene, pulling.press
    one: Callable[[tuple[Array, Any]], Array] = lambda x: press(scene, *x)
    way = jnp.sign(time[-1] - time[0])
    near = (_BESIDE * np.finfo(time.dtype).eps) * (1.0 + jnp.abs(time))
    beside = time + way * near

    def force(state: Any) -> tuple[Array, Array]:
        """On outputs, and right behind them."""
        # one state after the other: mapped over all, it compiles four times as long
        on = cast(Array, jax.lax.map(one, (time, state)))
        return on, cast(Array, jax.lax.map(one, (beside, state)))

    values, behind = cast(tuple[Array, Array], of_reached(force, state))
    pulls, jumps = values <= 0.0, (values > 0.0) & (behind <= 0.0)

    def between(start: Any, value: Array, ends: Array) -> Array:
        found = _run(_FOLLOWED, pulling, ends, _Pressed(start, value), _EVENTS)
        assert found.happened is not None
        return found.happened.time[0]

    first: Callable[[Array], Array] = lambda x: x[:-1]
    # a run that ends on a jump does not see what was before it: as far before its end
    # as looks go behind its start, where two of each are between them
    far = jnp.abs(time[1:] - time[:-1]) > 4.0 * near[1:]
    before = jnp.where(far, time[1:] - way * near[1:], time[1:])
    ends = jnp.stack([time[:-1], before], axis=1)
    found = jax.vmap(between)(jax.tree.map(first, state), values[:-1], ends)
    known = jnp.isfinite(found) & jnp.isfinite(values[1:])
    # what is behind the first is not looked at: an output at which it pulls is the end
    # of its interval at the latest
    times = jnp.where(known, found, jnp.where(pulls[1:], time[1:], jnp.nan))
    times = jnp.where(jumps[:-1], time[:-1], times)
    falls = jnp.isfinite(times)
    after = jnp.argmax(falls)
    never = ~pulls[0] & ~jnp.any(falls)
    when = jnp.where(pulls[0], time[0], times[after])
    return _Found(jnp.where(never, jnp.nan, when), after, pulls[0], jumps[after])


def _run(
    problem: Problem,
    pulling: _Pulling,
    times: Float[Array, "2"],
    start: Any,
    events: tuple[Event, ...],
) -> Outcome:
    """A run from one time to another."""
    ready = prepared(
        problem,
        pulling,
        times,
        rtol=None,
        atol=None,
        solver=None,
        stepsize_controller=None,
        adjoint=None,
        saveat=None,
        dt0=None,
        max_steps=None,
        progress_meter=None,
        events=events,
    )
    run: Callable[[bool], Outcome] = lambda native: ready(start, native=native)
    kind = "first pull", bool(events)
    model = pulling, start, events
    return cast(
        Outcome, run_by("auto", without_native(None, {}), kind, model, run).outcome
    )
