"""Step controllers: landing on output times, and replaying recorded steps."""

import diffrax as dfx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .small_linear import norm


class LandOn(dfx.AbstractStepSizeController):
    """Adaptive steps that end exactly on every output time.

    An output is then as accurate as the steps (diffrax's interpolants are of order 4
    and 5, below what an 8th-order method is used for). A step that would end just
    short of an output time is halved with the next one, and the step before a landing
    is remembered, so that a landing costs about one step.

    Attributes:
        controller: Chooses the steps.
        times: Output times after the first [s], in the direction of integration.
    """

    controller: dfx.PIDController
    times: Float[Array, " n"]

    def wrap(self, direction):
        """The controller for the direction of time in which diffrax works."""
        return LandOn(self.controller.wrap(direction), self.times * direction)

    def init(self, terms, t0, t1, y0, dt0, args, func, error_order):
        """First step, and the state: controller, next output, step wanted before."""
        t_next, inner = self.controller.init(
            terms, t0, t1, y0, dt0, args, func, error_order
        )
        wanted = t_next - t0
        return self._towards(self.times[0], t0, wanted), (inner, jnp.asarray(0), wanted)

    def _towards(self, goal, t, dt):
        left = goal - t
        halved = jnp.where(dt > 0.5 * left, t + 0.5 * left, t + dt)
        return jnp.where(dt >= 0.999 * left, goal, halved)

    def adapt_step_size(
        self, t0, t1, y0, y1_candidate, args, y_error, error_order, controller_state
    ):
        """Next step: the controller's, or the one wanted before the landing."""
        inner, index, wanted = controller_state
        keep, next_t0, next_t1, jump, inner, result = self.controller.adapt_step_size(
            t0, t1, y0, y1_candidate, args, y_error, error_order, inner
        )
        proposed = next_t1 - next_t0
        shortened = (t1 - t0) < 0.999 * wanted
        dt = jnp.where(keep & shortened, jnp.maximum(proposed, wanted), proposed)
        landed = keep & (t1 >= self.times[index])
        last = self.times.shape[0] - 1
        index = jnp.where(landed, jnp.minimum(index + 1, last), index)
        t_end = self._towards(self.times[index], next_t0, dt)
        return keep, next_t0, t_end, jump, (inner, index, dt), result


def landing_times(
    times: Float[Array, " T"], kinks: Float[Array, " k"] | None
) -> Float[Array, " n"]:
    """Output times after the first, with the kinks between them, in order.

    Args:
        times: Output times [s], increasing or decreasing.
        kinks: Times at which a derivative of the right-hand side jumps [s]; None: none.

    Returns:
        Times for :class:`LandOn`; what is left of the kinks is infinite, at the end.
    """
    if kinks is None:
        return times[1:]
    sign = jnp.where(times[-1] < times[0], -1.0, 1.0).astype(times.dtype)
    outputs = times * sign
    kinks = jax.lax.stop_gradient(kinks).astype(times.dtype) * sign
    # closer together than this, two landings would ask for a step without length
    near = 100 * jnp.finfo(times.dtype).eps * jnp.max(jnp.abs(outputs))
    after = jnp.clip(jnp.searchsorted(outputs, kinks), 1, outputs.shape[0] - 1)
    gap = jnp.minimum(
        jnp.abs(outputs[after] - kinks), jnp.abs(outputs[after - 1] - kinks)
    )
    between = (kinks > outputs[0]) & (kinks < outputs[-1]) & (gap > near)
    kinks = jnp.where(between, kinks, jnp.inf)
    landings = jnp.sort(jnp.concatenate([outputs[1:], kinks]))
    repeated = jnp.diff(landings) <= near
    landings = landings.at[1:].set(jnp.where(repeated, jnp.inf, landings[1:]))
    return jnp.sort(landings) * sign


class ReplaySteps(dfx.AbstractStepSizeController):
    """Steps to recorded times, all accepted; like ``diffrax.StepTo``, but padded.

    Attributes:
        times: Recorded times [s], the start first, padded with infinity.
    """

    times: Float[Array, " n"]

    def wrap(self, direction):
        """The record for the direction of time in which diffrax works."""
        return ReplaySteps(self.times * direction)

    def init(self, terms, t0, t1, y0, dt0, args, func, error_order):
        """First recorded step."""
        del terms, t0, y0, dt0, args, func, error_order
        return jnp.minimum(self.times[1], t1), 2

    def adapt_step_size(
        self, t0, t1, y0, y1_candidate, args, y_error, error_order, controller_state
    ):
        """Next recorded step; the run ends where its record does."""
        del t0, y0, y1_candidate, args, y_error, error_order
        following = self.times[controller_state]
        recorded = jnp.isfinite(following)
        result = dfx.RESULTS.where(
            recorded, dfx.RESULTS.successful, dfx.RESULTS.max_steps_reached
        )
        following = jnp.where(recorded, following, t1)
        return True, t1, following, False, controller_state + 1, result


def first_step(
    angular_velocity: Float[Array, "3"], span: Float[Array, ""]
) -> Float[Array, ""]:
    """A cautious first step [s]: a hundredth of a radian, or of the span at rest.

    The controller corrects it within a few steps; diffrax's own choice would evaluate,
    and so compile, the right-hand side twice more.
    """
    span = jnp.abs(span)
    return 0.01 * span / (1.0 + span * norm(angular_velocity))
