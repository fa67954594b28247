"""Tangents and cotangents of a run along the steps that it took.

An explicit Runge-Kutta step is arithmetic on rates, so its derivative is the same step
for the tangents, and its transpose the same step backwards. Written out, both cost a
fraction of what differentiating the integrator's loop costs.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias, TypeVar, cast

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..codegen import CotangentLoop, NoCompilerError, Rates, TangentLoop, platform
from ..codegen.scalar_program import NotElementwiseError
from ..codegen.tableau import Weights, stage_sum
from .recorded_steps import Steps, most

_Carry = TypeVar("_Carry")
# Numbers of a state, and their changes along tangents with an axis behind.
_Pair: TypeAlias = tuple[Array, Array]
# Cotangents of a function's arguments, from those of its value.
_Pull: TypeAlias = Callable[[Array], list[Array]]
# ``field(t, state)`` -> rates of a tree of numbers, as such a tree.
_Field: TypeAlias = Callable[[Array, Any], Any]
# The next output on the way back, cotangents of the state and of what is varied.
_Back: TypeAlias = tuple[Array, Array, list[Array]]

# Steps of one part of the way back: from a recorded state they are taken again, and
# their stages are kept: 1 kB a step of Dopri8, so that they fit the first cache.
STEPS_BETWEEN = 16


def _if_any(flag: Array, change: Callable[[Array], Array], x: Array) -> Array:
    """An array, changed where a flag of the batch is set; ``change`` minds its own."""
    some = most(flag.astype(int)) > 0
    return cast(Array, jax.lax.cond(some, change, lambda x: x, x))


class Run(NamedTuple):
    """What is differentiated.

    Attributes:
        rates: ``rates(t, y, *varied)`` -> rates of the numbers of a state, shape (n,).
        start: ``start(*varied)`` -> numbers of the state at the first time.
        varied: What both depend on.
        weights: Of the method.
    """

    rates: Callable[..., Array]
    start: Callable[..., Array]
    varied: list[Array]
    weights: Weights

    def stages(self, steps: Steps, i: Array) -> "_Stages":
        """The stages of a step."""
        begin, end, _ = steps.span(i)
        rows, nodes = self.weights.padded  # the last stage is the end
        share = jnp.asarray(nodes[:-1], begin.dtype)
        times = jnp.where(share == 1.0, end, begin + share * (end - begin))
        length = steps.sense * (end - begin)
        weights = jnp.asarray(rows[:, :-1], begin.dtype)
        return _Stages(steps.sense * times, length * weights)

    @property
    def count(self) -> int:  # pyright: ignore[reportIncompatibleMethodOverride]
        """How many rates a step is made of."""
        return len(self.weights.rows)


class _Stages(NamedTuple):
    """Times of a step's stages, and weights times its length, those of its end last."""

    times: Float[Array, " s"]
    weights: Float[Array, "s+1 s"]


def push(
    run: Run, steps: Steps, tangents: list[Array], once: bool = True
) -> tuple[Array, Array]:
    """Changes of the states along some tangents.

    Args:
        run: What is differentiated.
        steps: That it took.
        tangents: Of what is varied, each with an axis of length P behind.
        once: Whether they are not differentiated again.

    Returns:
        Changes of the states at the outputs, shape (T, n, P), NaN where no step ended
        on them, and of the last state, shape (n, P).
    """
    state = _pushed(run.start, run.varied, tangents)
    if once and (loop := _in_c(TangentLoop, run, *state)):
        return loop(steps.way, *state, tangents)

    def field(t: Array, state: _Pair) -> _Pair:
        primals, dots = [state[0], *run.varied], [state[1], *tangents]
        return _pushed(functools.partial(run.rates, t), primals, dots)

    def one(i: Array, carry: tuple[Array, _Pair, Array]) -> tuple[Array, _Pair, Array]:
        output, state, shown = carry
        state = _where(
            i < steps.count, _stepped(field, run.stages(steps, i), state), state
        )
        shows = steps.shows(i, output)
        at = steps.last_of(output)

        def put(shown: Array) -> Array:
            return shown.at[at].set(jnp.where(shows, state[1], shown[at]))

        return jnp.where(shows, at + 1, output), state, _if_any(shows, put, shown)

    size = steps.outputs.shape[0], *state[1].shape
    shown = jnp.full(size, jnp.nan, state[1].dtype).at[0].set(state[1])
    first = steps.last_of(jnp.asarray(0)) + 1
    _, state, shown = _counted(steps.turns, one, (first, state, shown))
    return shown, state[1]


def _in_c(kind: Callable[..., Any], run: Run, *like: Any) -> Any:
    """A compiled loop; None where there can be none, and XLA's programs serve."""
    if platform() is None:
        return None
    try:
        return kind(Rates(run.rates, run.varied, run.weights), *like)
    except (NotElementwiseError, NoCompilerError):
        return None


def _pushed(
    function: Callable[..., Array], primals: list[Array], tangents: list[Array]
) -> _Pair:
    """A function's value, and its changes along tangents with an axis behind."""

    def one(dots: list[Array]) -> _Pair:
        return jax.jvp(function, primals, dots)

    return jax.vmap(one, in_axes=-1, out_axes=(None, -1))(tangents)


def _where(flag: Array, new: Any, old: Any) -> Any:
    return jax.tree.map(functools.partial(jnp.where, flag), new, old)


def _stepped(field: _Field, stages: _Stages, state: Any) -> Any:
    """Behind a step."""

    def moved(y: Array, k: Array) -> Array:
        return y + stage_sum(stages.weights[-1], k)

    return jax.tree.map(moved, state, _rates(field, stages, state))


def _rates(field: _Field, stages: _Stages, state: Any) -> Any:
    """Rates at all stages of a step."""
    count = stages.times.shape[0]

    def stage(m: Array, rates: Any) -> Any:
        row = stages.weights[m]

        def moved(y: Array, k: Array) -> Array:
            return y + stage_sum(row, k)

        def put(k: Array, f: Array) -> Array:
            return k.at[m].set(f)

        dots = jax.tree.map(moved, state, rates)
        found = field(stages.times[m], dots)
        return jax.tree.map(put, rates, found)

    def empty(y: Array) -> Array:
        return jnp.zeros((count, *y.shape), y.dtype)

    none = jax.tree.map(empty, state)
    return cast(Any, jax.lax.fori_loop(0, count, stage, none))


def pull(
    run: Run, steps: Steps, cotangents: Array, last_cotangent: Array, once: bool = True
) -> list[Array]:
    """Cotangents of what is varied.

    Args:
        run: What is differentiated.
        steps: That it took.
        cotangents: Cotangents of the states at the outputs, shape (T, n).
        last_cotangent: Of the last state, shape (n,).
        once: Whether they are not differentiated again.

    Returns:
        A cotangent for each of what is varied; NaN if one is cotangents of an output on
        which no step ended.
    """
    if once and (loop := _in_c(CotangentLoop, run, last_cotangent, STEPS_BETWEEN)):
        back, of_varied = loop(steps.way, steps.kept, cotangents, last_cotangent)
    else:
        # recorded states do not move with what is varied, as a second derivative asks
        steps = steps if once else steps._replace(kept=_taken_again(run, steps))
        back, of_varied = _pulled(run, steps, cotangents, last_cotangent)
    through = cast(_Pull, jax.vjp(run.start, *run.varied)[1])
    own = through(back + cotangents[0])
    return [a + b for a, b in zip(of_varied, own, strict=True)]


def _taken_again(run: Run, steps: Steps) -> Array:
    """States where every 16th step begins, from the start on."""
    field: _Field = lambda t, y: run.rates(t, y, *run.varied)

    def one(i: Array, carry: tuple[Array, Array]) -> tuple[Array, Array]:
        y, kept = carry
        at = i // STEPS_BETWEEN
        kept = kept.at[at].set(jnp.where(i % STEPS_BETWEEN == 0, y, kept[at]))
        ahead = _stepped(field, run.stages(steps, i), y)
        return jnp.where(i < steps.count, ahead, y), kept

    start = run.start(*run.varied)
    return _counted(steps.turns, one, (start, jnp.zeros_like(steps.kept)))[1]


def _pulled(
    run: Run, steps: Steps, cotangents: Array, last_cotangent: Array
) -> tuple[Array, list[Array]]:
    """Cotangents of the first state and of what is varied, by XLA."""
    field: _Field = lambda t, y: run.rates(t, y, *run.varied)
    turns = steps.turns
    segments = (turns + STEPS_BETWEEN - 1) // STEPS_BETWEEN

    def segment(n: Array, carry: _Back) -> _Back:
        s = segments - 1 - n
        first = s * STEPS_BETWEEN
        here = jnp.minimum(STEPS_BETWEEN, turns - first)

        def again(j: Array, carry: tuple[Array, ...]) -> tuple[Array, ...]:
            y, states, rates = carry
            stages = run.stages(steps, first + j)
            found = _rates(field, stages, y)
            ahead = y + stage_sum(stages.weights[-1], found)
            return ahead, states.at[j].set(y), rates.at[j].set(found)

        size = last_cotangent.shape
        states = jnp.zeros((STEPS_BETWEEN, *size), last_cotangent.dtype)
        rates = jnp.zeros((STEPS_BETWEEN, run.count, *size), last_cotangent.dtype)
        _, states, rates = _counted(here, again, (steps.kept[s], states, rates))

        def one(j: Array, carry: _Back) -> _Back:
            output, back, of_varied = carry
            j = here - 1 - j
            shows = steps.shows(first + j, output)
            back = back + jnp.where(shows, cotangents[output], 0.0)
            stages = run.stages(steps, first + j)
            before, own = _pulled_step(run, stages, states[j], rates[j], back)
            own = jax.tree.map(jnp.add, of_varied, own)
            taken = first + j < steps.count
            back, of_varied = _where(taken, (before, own), (back, of_varied))
            return jnp.where(shows, steps.before(output), output), back, of_varied

        return _counted(here, one, carry)

    none = [jnp.zeros_like(x) for x in run.varied]
    end = steps.span(jnp.maximum(steps.count - 1, 0))[2]
    last_output = jnp.sum(steps.outputs <= end) - 1
    carry = jnp.maximum(last_output, 0), last_cotangent, none
    left, back, of_varied = _counted(segments, segment, carry)
    passed = jnp.arange(cotangents.shape[0])
    passed = (passed > 0) & (passed <= left)
    lost = jnp.any(passed[:, None] & (cotangents != 0.0))

    def known(x: Array) -> Array:
        return jnp.where(lost, jnp.nan, x)

    return jax.tree.map(known, (back, of_varied))


def _counted(count: Array, body: Callable[..., _Carry], carry: _Carry) -> _Carry:
    """A loop over the first so many whole numbers."""
    more: Callable[[Any], Array] = lambda c: c[0] < count
    step: Callable[[Any], tuple[Any, _Carry]] = lambda c: (c[0] + 1, body(*c))
    return jax.lax.while_loop(more, step, (jnp.asarray(0), carry))[1]


def _pulled_step(
    run: Run, stages: _Stages, y: Array, rates: Array, back: Array
) -> tuple[Array, list[Array]]:
    """Cotangents of a step's beginning and of what is varied.

    With rates ``k_m = f(y + sum_j a_mj k_j)`` and the end ``y + sum_m b_m k_m``, the
    one of a rate is ``b_m back + sum_j a_jm g_j``, where ``g_j`` is that of the stage
    j behind it; the one of y is the sum of all ``g`` and ``back``.
    """
    count = run.count

    def stage(n: Array, carry: tuple[Array, list[Array]]) -> tuple[Array, list[Array]]:
        found, of_varied = carry
        m = count - 1 - n
        t = stages.times[m]
        cotangents = stages.weights[-1, m] * back + stage_sum(
            stages.weights[:-1, m], found
        )
        place = y + stage_sum(stages.weights[m], rates)
        function = functools.partial(run.rates, t)
        through = cast(_Pull, jax.vjp(function, place, *run.varied)[1])
        g, *own = through(cotangents)
        return found.at[m].set(g), [a + b for a, b in zip(of_varied, own, strict=True)]

    none = [jnp.zeros_like(x) for x in run.varied]
    carry = jnp.zeros_like(rates), none
    ended = cast("tuple[Array, list[Array]]", jax.lax.fori_loop(0, count, stage, carry))
    found, of_varied = ended
    return back + jnp.sum(found, axis=0), of_varied
