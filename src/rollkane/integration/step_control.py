"""Step controllers: landing on outputs, replaying recorded steps."""

# equinox lets a property stand for an abstract field
# pyright: reportIncompatibleVariableOverride=false
# pyright: reportIncompatibleMethodOverride=false

from collections.abc import Callable
from typing import Any, NamedTuple, cast

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ..geometry.small_linear import norm
from ..validation.checks import is_traced
from ..validation.remembered import of_numbers
from .controller_interface import (
    AbstractAround,
    AbstractController,
    Adapted,
    Number,
    RunStart,
    Sense,
    TriedStep,
    Truth,
)


class AboveRounding(eqx.Module):
    """Size of a step's scaled error, less what rounding makes of it.

    Below the numbers' own rounding an error is noise, another on every machine; a step
    that was chosen by it would be, too.

    Attributes:
        rtol: Relative tolerance of a step [1].
    """

    rtol: Any

    def __call__(self, scaled: Float[Array, " n"]) -> Float[Array, ""]:
        """Root of the mean square, from the rounding on."""
        # an error of zero has no derivative, and steps are not differentiated
        scaled = jax.lax.stop_gradient(scaled)
        noise = np.finfo(scaled.dtype).eps / self.rtol
        size = jnp.sqrt(jnp.mean(jnp.square(scaled)))
        # of a state that overflows: NaN would make a step of no length, for ever
        size = jnp.where(jnp.isnan(size), jnp.inf, size)
        return jnp.maximum(size - jnp.asarray(noise, scaled.dtype), 0.0)


class Landings(NamedTuple):
    """Where steps have to end, in order, and where the next ones begin.

    They differ only round a jump of the right-hand side: some number before it, and one
    behind it. A stage evaluated on the jump itself would have either value.

    Attributes:
        ends: [s], shape (n,), some of them twice; infinite behind the last.
        behind: [s], shape (n,), none of them before its end; None: the ends themselves.
    """

    ends: Float[Array, " n"]
    behind: Float[Array, " n"] | None

    @property
    def starts(self) -> Float[Array, " n"]:
        """Where the next steps begin [s], shape (n,)."""
        return self.ends if self.behind is None else self.behind

    def turned(self, sense: Any) -> "Landings":
        """With the times of the other direction of time, where that is -1."""
        turn: Callable[[Array], Array] = lambda t: t * sense
        return jax.tree.map(turn, self)

    def end_before(
        self, start: Float[Array, ""]
    ) -> tuple[Float[Array, ""], Bool[Array, ""]]:
        """Where the step ends before one that begins at a time, and whether at a jump.

        Args:
            start: Where a step begins [s]; time runs forwards, here and in itself.
        """
        if self.behind is None:
            return start, jnp.asarray(False)
        i = jnp.searchsorted(self.behind, start)
        i = jnp.minimum(i, self.behind.shape[0] - 1)
        jumped = (self.behind[i] == start) & (self.ends[i] < start)
        return jnp.where(jumped, self.ends[i], start), jumped

    def following(self, t: Number) -> Int[Array, ""]:
        """Number of the first end behind a time [s]."""
        behind = jnp.searchsorted(self.ends, t, side="right")
        return jnp.minimum(behind, self.ends.shape[0] - 1).astype(int)


class Stops(NamedTuple):
    """Output times as a run stops on them.

    Attributes:
        time: Times [s], shape (T,): those within a step of the clock are the first of
            them, or the last one of all.
        last: Which output is shown at each of them, shape (T,); None: its own.
    """

    time: Any
    last: Any


def stops_of(times: Any, least: float = 0.0) -> Stops:
    """Outputs as stops of a run.

    Args:
        times: Output times [s], increasing or decreasing, shape (T,).
        least: What a loop tells apart at least [s], where that is coarser than the
            clock.
    """
    if is_traced(times):
        return _stops(times, least)
    return of_numbers(_stops, times, least)


def _stops(times: Any, least: float) -> Stops:
    traced = is_traced(times)
    library = cast(Any, jnp if traced else np)
    near = library.maximum(clock_step(times, library), times.dtype.type(least))
    if not traced and not (library.abs(library.diff(times)) <= near).any():
        return Stops(times, None)
    count = times.shape[0]
    index = library.arange(count)
    joins = _joins(times, near) if traced else _joins_known(times, near)
    own = library.where(joins, count, index)
    begins = library.where(library.append(False, joins[:-1]), 0, index)
    if traced:
        last = jax.lax.cummin(jnp.asarray(own), reverse=True)
        first = jax.lax.cummax(jnp.asarray(begins))
    else:
        last = np.minimum.accumulate(own[::-1])[::-1]
        first = np.maximum.accumulate(begins)
    # a run ends on its last time, and no step leads from the start to the start
    ends = (last == count - 1) & (first > 0)
    last = library.where(first == 0, 0, last)
    return Stops(times[library.where(ends, count - 1, first)], last)


def _joins_known(times: np.ndarray, near: Any) -> np.ndarray:
    """Which outputs are one with the next: all that are near to the first of them.

    Of many that follow each other closely, no more than that become one.
    """
    joins = np.zeros(times.shape[0], bool)
    first = times[0]
    for i, time in enumerate(times[1:]):
        joins[i] = abs(time - first) <= near
        first = first if joins[i] else time
    return joins


def _joins(times: Array, near: Array) -> Bool[Array, " T"]:
    """The same of traced times."""

    def turn(first: Array, time: Array) -> tuple[Array, Array]:
        joins = jnp.abs(time - first) <= near
        return jnp.where(joins, first, time), joins

    _, joins = jax.lax.scan(turn, times[0], times[1:])
    return jnp.append(joins, False)


def clock_step(times: Any, library: Any = jnp) -> Any:
    """Below this, times are not told apart by steps [s]: a hundred roundings."""
    return 100 * np.finfo(times.dtype).eps * library.max(library.abs(times))


class LandOn(AbstractAround):
    """Adaptive steps that end exactly on every output time.

    An output is then as accurate as the steps (diffrax's interpolants are of order 4
    and 5, below what an 8th-order method is used for). A step that would end just
    short of an output time is halved with the next one, and the step before a landing
    is remembered, so that a landing costs about one step.

    Attributes:
        controller: Chooses the steps.
        landings: Where steps have to end.
    """

    controller: dfx.PIDController
    landings: Landings

    def wrap(self, direction: Sense) -> "LandOn":
        """The controller for the direction of time in which diffrax works."""
        parts = self.controller.wrap(direction), self.landings.turned(direction)
        return eqx.tree_at(lambda c: (c.controller, c.landings), self, parts)

    def first_step(self, start: RunStart) -> tuple[Number, Any]:
        """First step, and the memory: controller, next output, step wanted before."""
        t_next, inner = self.controller.init(*start)
        wanted = t_next - start.t0
        index = self.landings.following(start.t0)
        first = self._towards(self.landings.ends[index], start.t0, wanted)
        return first, (inner, index, wanted)

    def _towards(self, goal: Array, t: Number, dt: Number) -> Float[Array, ""]:
        left = goal - t
        halved = jnp.where(dt > 0.5 * left, t + 0.5 * left, t + dt)
        return jnp.where(dt >= 0.999 * left, goal, halved)

    def adapted(self, step: TriedStep) -> Adapted:
        """Next step: the controller's, or the one wanted before the landing."""
        t0, t1 = step.t0, step.t1
        inner, index, wanted = step.controller_state
        keep, next_t0, next_t1, jump, inner, result = self.controller.adapt_step_size(
            *step._replace(controller_state=inner)
        )
        proposed = next_t1 - next_t0
        shortened = (t1 - t0) < 0.999 * wanted
        dt = jnp.where(keep & shortened, jnp.maximum(proposed, wanted), proposed)
        ends, starts = self.landings.ends, self.landings.starts
        landed = keep & (t1 >= ends[index])
        if self.landings.behind is not None:
            next_t0 = jnp.where(landed, starts[index], next_t0)
            jump = jump | (landed & (starts[index] > ends[index]))
        index = jnp.where(landed, self.landings.following(t1), index)
        t_end = self._towards(ends[index], next_t0, dt)
        return keep, next_t0, t_end, jump, (inner, index, dt), result


def landings(times: Any, kinks: Any, away: int = 0) -> Landings:
    """Output times after the first, with the kinks between them, in order.

    Args:
        times: Of :class:`Stops` [s], increasing or decreasing, shape (T,).
        kinks: Times at which the right-hand side has a corner [s], shape (k,); None:
            none.
        away: How many numbers before and behind them steps end and begin, as it may
            jump there; 0: they end on them.

    Returns:
        Where :class:`LandOn` ends its steps; of known times as arrays of NumPy's.
    """
    if kinks is None:
        return Landings(times[1:], None)
    if is_traced((times, kinks)):
        kinks = jax.lax.stop_gradient(kinks).astype(times.dtype)
        return _landings(times, kinks, away, jnp)
    # XLA would find them, too, while it compiles, and take a second for a thousand
    known, kinks = np.asarray(times), np.asarray(kinks, times.dtype)
    return of_numbers(_known_landings, np.append(known, kinks), known.size, away)


def _known_landings(numbers: Any, count: int, away: int) -> Landings:
    """Of times, so many, and kinks one behind the other."""
    with np.errstate(invalid="ignore"):  # how far infinite ones are apart
        return _landings(numbers[:count], numbers[count:], away, np)


def _landings(times: Any, kinks: Any, away: int, library: Any) -> Landings:
    """The same by JAX or by NumPy."""
    sign = library.where(times[-1] < times[0], -1.0, 1.0).astype(times.dtype)
    outputs = times * sign
    kinks = library.sort(kinks * sign)
    # closer together than this, two landings would ask for a step without length
    near = clock_step(times, library)
    between = (kinks > outputs[0] + near) & (kinks < outputs[-1])
    kinks = library.where(between, _apart(kinks, near, library), library.inf)
    # what is near to one of the others now is beside it, when all are in order
    ends = library.concatenate([_apart(outputs[1:], near, library), kinks])
    ends, of_kink = _in_order(ends, np.arange(ends.shape[0]) >= outputs.shape[0] - 1)
    close, none = library.diff(ends) <= near, np.zeros(1, bool)
    follows, leads = library.append(none, close), library.append(close, none)
    # a kink beside an output is one stop with it, which steps pass at once
    beside = of_kink & (follows | leads)
    one_with: Callable[[Any], Any] = lambda x: library.where(
        beside, library.where(follows, library.roll(x, 1), library.roll(x, -1)), x
    )
    if not away:
        return Landings(one_with(ends) * sign, None)
    # the run itself ends on its last time, whatever is there
    jumps = (of_kink | follows | leads) & (ends < outputs[-1])
    # an output may be beside it by its rounding
    first = library.where(follows, library.roll(ends, 1), ends)
    last = library.where(leads, library.roll(ends, -1), ends)
    # numbers lie an eps apart at most, and what is beside zero a hair
    more = (away - 1) * float(np.finfo(ends.dtype).eps) * library.abs(ends)
    before, behind = first - more, last + more
    before = library.where(jumps, library.nextafter(before, -library.inf), ends)
    behind = library.where(jumps, library.nextafter(behind, library.inf), ends)
    return Landings(one_with(before) * sign, one_with(behind) * sign)


def _in_order(ends: Any, of_kink: Any) -> tuple[Any, Any]:
    """Times in order, each with what is said of it; equal ones as they stand."""
    if is_traced(ends):
        return cast(Any, jax.lax.sort((ends, jnp.asarray(of_kink)), num_keys=1))
    order = np.argsort(ends, stable=True)
    return ends[order], of_kink[order]


def _apart(x: Any, near: Any, library: Any) -> Any:
    """Numbers in order, those infinite that are near to the one before."""
    behind = library.where(library.diff(x) <= near, library.inf, x[1:])
    return library.concatenate([x[:1], behind])


class ReplaySteps(AbstractController, dfx.AbstractAdaptiveStepSizeController[Any, Any]):
    """Steps from recorded times, all accepted; like ``diffrax.StepTo``, but padded.

    Attributes:
        times: Where recorded steps began [s], padded with infinity.
        landings: Where steps had to end, and the next ones to begin.
        rtol: Relative tolerance to which implicit methods solve [1].
        atol: Absolute tolerance [unit of the state].
        norm: Of what is left of their equations.
    """

    times: Float[Array, " n"]
    landings: Landings
    rtol: Any
    atol: Any
    norm: Callable[[Any], Number] = cast(
        Any, dfx.PIDController(rtol=1.0, atol=1.0)
    ).norm

    def wrap(self, direction: Sense) -> "ReplaySteps":
        """The record for the direction of time in which diffrax works."""
        parts = self.times * direction, self.landings.turned(direction)
        return eqx.tree_at(lambda c: (c.times, c.landings), self, parts)

    def _end(self, index: int | Int[Array, ""]) -> tuple[Float[Array, ""], Truth]:
        """Where the step ends whose successor is recorded; whether at a jump."""
        return self.landings.end_before(self.times[index])

    def first_step(self, start: RunStart) -> tuple[Number, Any]:
        """First recorded step."""
        return jnp.minimum(self._end(1)[0], start.t1), 1

    def adapted(self, step: TriedStep) -> Adapted:
        """Next recorded step; the run ends where its record does."""
        t1, number = step.t1, step.controller_state
        _, jumped = self._end(number)
        start = t1 if self.landings.behind is None else self.times[number]
        following, _ = self._end(number + 1)
        recorded = jnp.isfinite(following)
        result = dfx.RESULTS.where(
            recorded, dfx.RESULTS.successful, dfx.RESULTS.max_steps_reached
        )
        following = jnp.where(recorded, following, t1)
        return True, start, following, jumped, number + 1, result


def coarse(size: Array) -> Array:
    """A size within 2^-17: which one is chosen by it must not hang on its last bits.

    Processors and GPUs, which round sums otherwise, so take the same steps.
    """
    exponent = cast(int, jnp.finfo(size.dtype).nexp)
    return jax.lax.reduce_precision(size, exponent_bits=exponent, mantissa_bits=16)


def first_step(
    angular_velocity: Float[Array, "3"], span: Float[Array, ""]
) -> Float[Array, ""]:
    """A cautious first step [s]: a hundredth of a radian, or of the span at rest.

    The controller corrects it within a few steps; diffrax's own choice would evaluate,
    and so compile, the right-hand side twice more.
    """
    span = jnp.abs(span)
    return 0.01 * span / (1.0 + span * norm(angular_velocity))
