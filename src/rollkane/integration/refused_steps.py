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

from .step_control import Adapted, Number, Sense

# ``holds(model, t0, y0, t1, y1)`` -> whether a step may stand.
Holds: TypeAlias = Callable[[Any, Number, Array, Number, Array], Array]


class _Refusing(eqx.Module):
    """A controller of which some steps are refused: tried again, shorter.

    Where even the shortest is refused, or the controller cannot shorten it, the run
    ends.

    Attributes:
        controller: Any.
        holds: ``holds(model, t0, y0, t1, y1)`` -> whether a step may stand; the model
            is what diffrax calls args.
        sense: Direction of time in which diffrax works.
    """

    controller: dfx.AbstractStepSizeController[Any, Any]
    holds: Holds = eqx.field(static=True)
    sense: Any = 1.0

    def wrap(self, direction: Sense) -> Any:
        """The controller for the direction of time in which diffrax works."""
        parts = cast(Any, self.controller).wrap(direction), direction
        return eqx.tree_at(lambda c: (c.controller, c.sense), self, parts)

    def init(
        self,
        terms: Any,
        t0: Number,
        t1: Number,
        y0: Any,
        dt0: Any,
        args: Any,
        func: Callable[..., Any],
        error_order: Number | None,
    ) -> tuple[Number, Any]:
        """As the controller."""
        return self.controller.init(terms, t0, t1, y0, dt0, args, func, error_order)

    def adapt_step_size(
        self,
        t0: Number,
        t1: Number,
        y0: Any,
        y1_candidate: Any,
        args: Any,
        y_error: Any,
        error_order: Number,
        controller_state: Any,
    ) -> Adapted:
        """As the controller, to which a refused step has a large error."""
        holds = self.holds(args, t0 * self.sense, y0, t1 * self.sense, y1_candidate)
        if y_error is not None:
            y_error = jnp.where(holds, y_error, jnp.asarray(jnp.inf, y_error.dtype))
        keep, next_t0, next_t1, jump, memory, result = self.controller.adapt_step_size(
            t0, t1, y0, y1_candidate, args, y_error, error_order, controller_state
        )
        stuck = keep & ~holds
        # the run ends where its state is, not at the end of what was refused
        next_t0 = jnp.where(stuck, t0, next_t0)
        result = dfx.RESULTS.where(stuck, dfx.RESULTS.dt_min_reached, result)
        return keep & holds, next_t0, next_t1, jump, memory, result


class _RefusingFixed(_Refusing, dfx.AbstractStepSizeController[Any, Any]):
    pass


class _RefusingAdaptive(_Refusing, dfx.AbstractAdaptiveStepSizeController[Any, Any]):
    """With the controller's tolerances, to which implicit methods solve."""

    @property
    def rtol(self) -> Number:
        return cast(Any, self.controller).rtol

    @property
    def atol(self) -> Number:
        return cast(Any, self.controller).atol

    @property
    def norm(self) -> Callable[[Any], Number]:
        return cast(Any, self.controller).norm


def refusing(
    controller: dfx.AbstractStepSizeController[Any, Any], holds: Holds
) -> dfx.AbstractStepSizeController[Any, Any]:
    """A controller of which some steps are refused.

    Args:
        controller: Any.
        holds: ``holds(model, t0, y0, t1, y1)`` -> whether a step may stand.
    """
    if isinstance(controller, dfx.AbstractAdaptiveStepSizeController):
        # its tolerances are the controller's, which diffrax declares as fields
        return _RefusingAdaptive(controller, holds)  # pyright: ignore[reportCallIssue]
    return _RefusingFixed(controller, holds)
