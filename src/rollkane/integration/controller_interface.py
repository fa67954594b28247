"""diffrax's interface of step controllers, with what it is called with as one value."""

# equinox lets a property stand for an abstract field
# pyright: reportIncompatibleVariableOverride=false
# pyright: reportIncompatibleMethodOverride=false

import abc
from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias, cast

import diffrax as dfx
import numpy as np
from jaxtyping import Array

# What diffrax takes for a time, a length of one, or a tolerance.
Number: TypeAlias = float | Array | np.ndarray
# Direction of time: 1 or -1.
Sense: TypeAlias = int | Array | np.ndarray
Truth: TypeAlias = bool | Array | np.ndarray
# Whether a step stands, ends of the next, whether behind a jump, memory, result.
Adapted: TypeAlias = tuple[Truth, Number, Number, Truth, Any, dfx.RESULTS]


class RunStart(NamedTuple):
    """Arguments of a controller's ``init``, in diffrax's order and by its names."""

    terms: Any
    t0: Number
    t1: Number
    y0: Any
    dt0: Any
    args: Any
    func: Callable[..., Any]
    error_order: Number | None


class TriedStep(NamedTuple):
    """Arguments of a controller's ``adapt_step_size``, likewise."""

    t0: Number
    t1: Number
    y0: Any
    y1_candidate: Any
    args: Any
    y_error: Any
    error_order: Number
    controller_state: Any


class AbstractController(dfx.AbstractStepSizeController[Any, Any]):
    """A controller by two functions of one value each."""

    @abc.abstractmethod
    def first_step(self, start: RunStart) -> tuple[Number, Any]:
        """End of the first step, and the memory."""

    @abc.abstractmethod
    def adapted(self, step: TriedStep) -> Adapted:
        """Whether a step stands, and the next one."""

    def init(self, *arguments: Any, **named: Any) -> tuple[Number, Any]:
        """As diffrax calls it."""
        return self.first_step(RunStart(*arguments, **named))

    def adapt_step_size(self, *arguments: Any, **named: Any) -> Adapted:
        """As diffrax calls it."""
        return self.adapted(TriedStep(*arguments, **named))


class AbstractAround(
    AbstractController, dfx.AbstractAdaptiveStepSizeController[Any, Any]
):
    """With the tolerances of an adaptive controller that it goes round."""

    @property
    def _inner(self) -> Any:
        return cast(Any, self).controller

    @property
    def rtol(self) -> Number:
        """Of the controller; implicit methods solve to it."""
        return self._inner.rtol

    @property
    def atol(self) -> Number:
        """Of the controller."""
        return self._inner.atol

    @property
    def norm(self) -> Callable[[Any], Number]:
        """Of the controller."""
        return self._inner.norm
