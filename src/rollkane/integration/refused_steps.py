"""Step controllers of which some steps are refused, and tried again, shorter."""

# equinox lets a property stand for an abstract field
# pyright: reportIncompatibleVariableOverride=false
# pyright: reportIncompatibleMethodOverride=false

from collections.abc import Callable
from typing import Any, TypeAlias, cast

import diffrax as dfx
import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array

from .controller_interface import (
    AbstractAround,
    AbstractController,
    Adapted,
    Number,
    RunStart,
    Sense,
    TriedStep,
)

# ``holds(model, t0, y0, t1, y1, rtol)`` -> whether a step may stand.
Holds: TypeAlias = Callable[[Any, Number, Array, Number, Array, Number], Array]


class _Refusing(AbstractController):
    """A controller of which some steps are refused: tried again, shorter.

    Where even the shortest is refused, or the controller cannot shorten it, the run
    ends.

    Attributes:
        controller: Any.
        holds: ``holds(model, t0, y0, t1, y1, rtol)`` -> whether a step may stand; the
            model is what diffrax calls args.
        sense: Direction of time in which diffrax works.
    """

    controller: dfx.AbstractStepSizeController[Any, Any]
    holds: Holds = eqx.field(static=True)
    sense: Any = 1.0

    def wrap(self, direction: Sense) -> Any:
        """The controller for the direction of time in which diffrax works."""
        parts = cast(Any, self.controller).wrap(direction), direction
        return eqx.tree_at(lambda c: (c.controller, c.sense), self, parts)

    def first_step(self, start: RunStart) -> tuple[Number, Any]:
        """As the controller."""
        return self.controller.init(*start)

    def adapted(self, step: TriedStep) -> Adapted:
        """As the controller, to which a refused step has a large error."""
        t0, t1, error = step.t0, step.t1, step.y_error
        begin, end = t0 * self.sense, t1 * self.sense
        rtol = getattr(self, "rtol", 0.0)  # not every controller has tolerances
        holds = self.holds(step.args, begin, step.y0, end, step.y1_candidate, rtol)
        if error is not None:
            error = jnp.where(holds, error, jnp.asarray(jnp.inf, error.dtype))
        keep, next_t0, next_t1, jump, memory, result = self.controller.adapt_step_size(
            *step._replace(y_error=error)
        )
        stuck = keep & ~holds
        # the run ends where its state is, not at the end of what was refused
        next_t0 = jnp.where(stuck, t0, next_t0)
        result = dfx.RESULTS.where(stuck, dfx.RESULTS.dt_min_reached, result)
        return keep & holds, next_t0, next_t1, jump, memory, result


class _RefusingAdaptive(_Refusing, AbstractAround):
    """With the controller's tolerances, to which implicit methods solve."""


def refusing(
    controller: dfx.AbstractStepSizeController[Any, Any], holds: Holds
) -> dfx.AbstractStepSizeController[Any, Any]:
    """A controller of which some steps are refused.

    Args:
        controller: Any.
        holds: ``holds(model, t0, y0, t1, y1, rtol)`` -> whether a step may stand.
    """
    if isinstance(controller, dfx.AbstractAdaptiveStepSizeController):
        # its tolerances are the controller's, which diffrax declares as fields
        return _RefusingAdaptive(controller, holds)  # pyright: ignore[reportCallIssue]
    return _Refusing(controller, holds)
