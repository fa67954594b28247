"""Tangents and cotangents of a run along the steps that it took.

An explicit Runge-Kutta step is arithmetic on rates, so its derivative is the same step
for the tangents, and its transpose the same step backwards. Written out, both cost a
fraction of what differentiating the integrator's loop costs.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ..codegen import CotangentLoop, NoCompilerError, Rates, TangentLoop, Way
from ..codegen.scalar_program import NotElementwiseError
from ..codegen.tableau import Weights

# Steps of one part of the way back: from a recorded state they are taken again, and
# their stages are kept: 1 kB a step of Dopri8, so that they fit the first cache.
STEPS_BETWEEN = 16


class Steps(NamedTuple):
    """Recorded steps; time runs forwards in them.

    Attributes:
        record: Where steps began, and the last one ended [s], shape (n,); any numbers
            behind.
        count: How many there are.
        sense: 1, or -1 where the run went backwards in time.
        outputs: Times of outputs [s], in order, shape (T,); of those at one time only
            the last is shown.
        jumps: Times of jumps [s] before which steps end, behind which they begin; None
            for none.
        kept: States where every 16th step began, the first included, shape (m, n).
    """

    record: Float[Array, " n"]
    count: Array
    sense: Array
    outputs: Float[Array, " T"]
    jumps: Float[Array, " k"] | None
    kept: Float[Array, "m n"]

    @staticmethod
    def of(record: Float[Array, " n"], count: Array, kept, times, jumps) -> "Steps":
        """Of what was recorded, the times of outputs and of jumps [s]."""
        sense = jnp.where(times[-1] < times[0], -1.0, 1.0).astype(times.dtype)
        jumps = None if jumps is None else sense * jumps
        return Steps(record, count, sense, sense * times, jumps, kept)

    def span(self, i: Array) -> tuple[Array, Array, Array]:
        """Where a step begins, where it ends and where the next one begins [s]."""
        begin, following = self.sense * self.record[i], self.sense * self.record[i + 1]
        if self.jumps is None:
            return begin, following, following
        at = jnp.nextafter(following, -jnp.inf)
        end = jnp.nextafter(at, -jnp.inf)
        return begin, jnp.where(jnp.any(at == self.jumps), end, following), following

    def shows(self, i: Array, output: Array) -> Bool[Array, ""]:
        """Whether an output lies at the end of a step."""
        last = self.outputs.shape[0] - 1
        time = self.outputs[jnp.clip(output, 0, last)]
        _, end, following = self.span(i)
        lies = (end <= time) & (time <= following)
        return lies & (output >= 0) & (output <= last) & (i < self.count)

    def last_of(self, output: Array) -> Array:
        """Of outputs at one time, the last: only it is shown."""
        return self._among(output, "right") - 1

    def before(self, output: Array) -> Array:
        """The last output at an earlier time."""
        return self._among(output, "left") - 1

    def _among(self, output: Array, side: str) -> Array:
        time = self.outputs[jnp.clip(output, 0, self.outputs.shape[0] - 1)]
        return jnp.searchsorted(self.outputs, time, side=side).astype(int)

    @property
    def way(self) -> Way:
        """The same for the compiled loop."""
        none = self.outputs[:0]
        jumps = none if self.jumps is None else self.jumps
        count = self.count.astype(self.record.dtype)
        return Way(self.record, count, self.sense, self.outputs, jumps)

    @property
    def turns(self) -> Array:
        """How many steps a loop takes: the same for all lanes of a batch.

        One that is done stands still until the others are. So the loop's counter is
        one number, and writing a row of an array does not become a scatter.
        """
        return _most(self.count)


@jax.custom_batching.custom_vmap
def _most(x: Array) -> Array:
    """A whole number, in a batch the largest."""
    return x


@_most.def_vmap
def _most_of_batch(size, batched, x):
    del size
    return _most(jnp.max(x) if batched[0] else x), False


def _if_any(flag: Array, change: Callable, x: Array) -> Array:
    """An array, changed where a flag of the batch is set; ``change`` minds its own."""
    return jax.lax.cond(_most(flag.astype(int)) > 0, change, lambda x: x, x)


class Run(NamedTuple):
    """What is differentiated.

    Attributes:
        rates: ``rates(t, y, *varied)`` -> rates of the numbers of a state, shape (n,).
        start: ``start(*varied)`` -> numbers of the state at the first time.
        varied: What both depend on.
        weights: Of the method.
    """

    rates: Callable
    start: Callable
    varied: list[Array]
    weights: Weights

    def stages(self, steps: Steps, i: Array) -> "_Stages":
        """The stages of a step."""
        begin, end, _ = steps.span(i)
        nodes = np.concatenate([[0.0], self.weights.nodes])[: self.count]
        share = jnp.asarray(nodes, begin.dtype)
        times = jnp.where(share == 1.0, end, begin + share * (end - begin))
        rows = np.zeros((self.count + 1, self.count))
        for m, row in enumerate(self.weights.rows, start=1):
            rows[m, :m] = row
        length = steps.sense * (end - begin)
        return _Stages(steps.sense * times, length * jnp.asarray(rows, begin.dtype))

    @property
    def count(self) -> int:
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

    def field(t, state):
        primals, dots = [state[0], *run.varied], [state[1], *tangents]
        return _pushed(lambda y, *varied: run.rates(t, y, *varied), primals, dots)

    def one(i, carry):
        output, state, shown = carry
        state = _where(
            i < steps.count, _stepped(field, run.stages(steps, i), state), state
        )
        shows = steps.shows(i, output)
        at = steps.last_of(output)
        put = lambda shown: shown.at[at].set(jnp.where(shows, state[1], shown[at]))
        return jnp.where(shows, at + 1, output), state, _if_any(shows, put, shown)

    size = steps.outputs.shape[0], *state[1].shape
    shown = jnp.full(size, jnp.nan, state[1].dtype).at[0].set(state[1])
    first = steps.last_of(jnp.asarray(0)) + 1
    _, state, shown = _counted(steps.turns, one, (first, state, shown))
    return shown, state[1]


def _in_c(kind: Callable, run: Run, *like: Any) -> Any:
    """A compiled loop; None where there can be none, and XLA's programs serve."""
    if jax.default_backend() != "cpu":
        return None
    try:
        return kind(Rates(run.rates, run.varied, run.weights), *like)
    except (NotElementwiseError, NoCompilerError):
        return None


def _pushed(function: Callable, primals: list[Array], tangents: list[Array]) -> Any:
    """A function's value, and its changes along tangents with an axis behind."""
    one = lambda dots: jax.jvp(function, primals, dots)
    return jax.vmap(one, in_axes=-1, out_axes=(None, -1))(tangents)


def _where(flag: Array, new: Any, old: Any) -> Any:
    return jax.tree.map(lambda a, b: jnp.where(flag, a, b), new, old)


def _stepped(field: Callable, stages: _Stages, state: Any) -> Any:
    """Behind a step."""
    rates = _rates(field, stages, state)
    return jax.tree.map(lambda y, k: y + _mixed(stages.weights[-1], k), state, rates)


def _rates(field: Callable, stages: _Stages, state: Any) -> Any:
    """Rates at all stages of a step."""
    count = stages.times.shape[0]

    def stage(m, rates):
        row = stages.weights[m]
        dots = jax.tree.map(lambda y, k: y + _mixed(row, k), state, rates)
        found = field(stages.times[m], dots)
        return jax.tree.map(lambda k, f: k.at[m].set(f), rates, found)

    empty = lambda y: jnp.zeros((count, *y.shape), y.dtype)
    return jax.lax.fori_loop(0, count, stage, jax.tree.map(empty, state))


def _mixed(weights: Float[Array, " s"], rates: Array) -> Array:
    """A sum over stages; a product of matrices would be a call to a library."""
    spread = weights.reshape(-1, *[1] * (rates.ndim - 1))
    return jnp.sum(spread * rates, axis=0)


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
    own = jax.vjp(run.start, *run.varied)[1](back + cotangents[0])
    return [a + b for a, b in zip(of_varied, own, strict=True)]


def _taken_again(run: Run, steps: Steps) -> Array:
    """States where every 16th step begins, from the start on."""
    field = lambda t, y: run.rates(t, y, *run.varied)

    def one(i, carry):
        y, kept = carry
        at = i // STEPS_BETWEEN
        kept = kept.at[at].set(jnp.where(i % STEPS_BETWEEN == 0, y, kept[at]))
        ahead = _stepped(field, run.stages(steps, i), y)
        return jnp.where(i < steps.count, ahead, y), kept

    start = run.start(*run.varied)
    return _counted(steps.turns, one, (start, jnp.zeros_like(steps.kept)))[1]


def _pulled(
    run: Run, steps: Steps, cotangents: Array, last_cotangent: Array
) -> tuple[Any, Any]:
    """Cotangents of the first state and of what is varied, by XLA."""
    field = lambda t, y: run.rates(t, y, *run.varied)
    turns = steps.turns
    segments = (turns + STEPS_BETWEEN - 1) // STEPS_BETWEEN

    def segment(n, carry):
        s = segments - 1 - n
        first = s * STEPS_BETWEEN
        here = jnp.minimum(STEPS_BETWEEN, turns - first)

        def again(j, carry):
            y, states, rates = carry
            stages = run.stages(steps, first + j)
            found = _rates(field, stages, y)
            ahead = y + _mixed(stages.weights[-1], found)
            return ahead, states.at[j].set(y), rates.at[j].set(found)

        size = last_cotangent.shape
        states = jnp.zeros((STEPS_BETWEEN, *size), last_cotangent.dtype)
        rates = jnp.zeros((STEPS_BETWEEN, run.count, *size), last_cotangent.dtype)
        _, states, rates = _counted(here, again, (steps.kept[s], states, rates))

        def one(j, carry):
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
    return jax.tree.map(lambda x: jnp.where(lost, jnp.nan, x), (back, of_varied))


def _counted(count: Array, body: Callable, carry: Any) -> Any:
    """A loop over the first so many whole numbers."""
    more = lambda c: c[0] < count
    step = lambda c: (c[0] + 1, body(*c))
    return jax.lax.while_loop(more, step, (jnp.asarray(0), carry))[1]


def _pulled_step(run: Run, stages: _Stages, y: Array, rates: Array, back: Array):
    """Cotangents of a step's beginning and of what is varied.

    With rates ``k_m = f(y + sum_j a_mj k_j)`` and the end ``y + sum_m b_m k_m``, the
    one of a rate is ``b_m back + sum_j a_jm g_j``, where ``g_j`` is that of the stage
    j behind it; the one of y is the sum of all ``g`` and ``back``.
    """
    count = run.count

    def stage(n, carry):
        found, of_varied = carry
        m = count - 1 - n
        t = stages.times[m]
        cotangents = stages.weights[-1, m] * back + _mixed(
            stages.weights[:-1, m], found
        )
        place = y + _mixed(stages.weights[m], rates)
        function = lambda y, *varied: run.rates(t, y, *varied)
        g, *own = jax.vjp(function, place, *run.varied)[1](cotangents)
        return found.at[m].set(g), [a + b for a, b in zip(of_varied, own, strict=True)]

    none = [jnp.zeros_like(x) for x in run.varied]
    carry = jnp.zeros_like(rates), none
    found, of_varied = jax.lax.fori_loop(0, count, stage, carry)
    return back + jnp.sum(found, axis=0), of_varied
