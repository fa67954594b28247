"""Derivatives of a plain run along its steps, which are replayed."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array

from ..codegen.tableau import weights_of
from . import replay
from .differentiate import InputsOf, Pull, Push
from .event_times import Moments
from .plans import Plan, Rates, Record, Solution
from .recorded_steps import Steps
from .replay import Run


def by_steps_of(plan: Plan, rates: Rates) -> tuple[Push, Pull]:
    """Derivatives of a plain run along its steps.

    See :func:`rollkane.integration.differentiate.differentiable`.
    """
    weights = weights_of(plan.solver, "a run")

    def run_of(
        inputs_of: InputsOf, varied: list[Array], record: Record
    ) -> tuple[Run, Steps, Moments | None]:
        def along(t: Array, y: Array, *varied: Array) -> Array:
            return rates(t, y, inputs_of(varied)[0])

        def start(*varied: Array) -> Array:
            return inputs_of(varied)[1]

        _, _, times, where, *_ = inputs_of(varied)
        begun, count, kept, *events = record
        moments = Moments.of(times, events[0]) if events else None
        shown = times if moments is None else moments.time
        steps = Steps.of(begun, count, kept, shown, where)
        return Run(along, start, varied, weights), steps, moments

    def push(
        inputs_of: InputsOf,
        varied: list[Array],
        record: Record,
        tangents: list[Array],
        once: bool,
    ) -> list[Array]:
        run, steps, moments = run_of(inputs_of, varied, record)
        behind = [jnp.moveaxis(x, 0, -1) for x in tangents]
        y, final_y = (
            jnp.moveaxis(x, -1, 0) for x in replay.push(run, steps, behind, once)
        )
        time = jnp.zeros(y.shape[:2], y.dtype)
        if moments is None:
            return [time, y, time[:, 0], final_y]  # as in Solution
        y, of_events = y[:, moments.outputs], y[:, moments.events]
        time, none = time[:, : y.shape[1]], time[:, : of_events.shape[1]]
        return [time, y, time[:, 0], final_y, none, of_events]

    def pull(
        inputs_of: InputsOf,
        varied: list[Array],
        record: Record,
        cotangents: Solution,
        once: bool,
    ) -> list[Array]:
        run, steps, moments = run_of(inputs_of, varied, record)
        known: Callable[[Any], Array] = lambda x: jnp.asarray(x)
        cotangents = jax.tree.map(known, cotangents)  # asked for or not
        y, found = cotangents.y, cotangents.happened
        if moments is not None and found is not None:
            y = moments.together(y, found.y)
        return replay.pull(run, steps, y, cotangents.final_y, once)

    return push, pull
