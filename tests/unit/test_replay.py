"""Tangents and cotangents along recorded steps, against a plain loop over the steps.

Both ways: in C, and in XLA (for what is differentiated again, and where C cannot).
"""

import functools

import diffrax as dfx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from rollkane.codegen import (
    NoCompilerError,
    derivative_loops,
    ffi_call,
    runge_kutta_source,
)
from rollkane.codegen.tableau import weights_of
from rollkane.integration import replay
from rollkane.integration.differentiate import differentiable
from rollkane.integration.recorded_steps import Steps
from rollkane.integration.replay import Run
from rollkane.integration.step_control import Landings

from .test_native import OPERATIONS
from .test_native import rates as every_operation

WEIGHTS = weights_of(dfx.Bosh3(), "a test")
# of uneven length, with a jump behind the third step and a padded end
AT = 0.55
BEGINS = np.array([0.0, 0.1, 0.25, np.nextafter(AT, 1.0), 0.7, 1.0])
ENDS = np.array([0.1, 0.25, np.nextafter(AT, 0.0), 0.7, 1.0])
RECORD = jnp.asarray(np.append(BEGINS, [np.inf, np.inf]))
TIMES = jnp.asarray([0.0, 0.25, AT, 1.0])
JUMPS = Landings(
    jnp.asarray([0.25, np.nextafter(AT, 0.0), 1.0]),
    jnp.asarray([0.25, np.nextafter(AT, 1.0), 1.0]),
)
START, PULL = jnp.asarray([0.4, -0.3]), jnp.asarray([9.0, 0.7])
# a step's rounding, a few times over
ROUNDING = {"rtol": 1e-13, "atol": 1e-14}


def rates(t, y, start, pull):
    """A pendulum with friction, pushed more from the jump on."""
    del start
    push = jnp.where(t >= AT, 2.0, 1.0) * jnp.cos(3.0 * t)
    return jnp.stack([y[1], -pull[0] * jnp.sin(y[0]) - pull[1] * y[1] + push])


def states(start, pull, begins=BEGINS, ends=ENDS):
    """States behind every step."""
    y, found = start, [start]
    for begin, end in zip(begins, ends, strict=False):
        k = [rates(jnp.asarray(begin), y, start, pull)]
        for row, node in zip(WEIGHTS.rows[:-1], WEIGHTS.nodes, strict=False):
            t = end if node == 1.0 else begin + node * (end - begin)
            moved = y + (end - begin) * sum(a * b for a, b in zip(row, k, strict=True))
            k.append(rates(jnp.asarray(t), moved, start, pull))
        last = zip(WEIGHTS.rows[-1], k, strict=True)
        y = y + (end - begin) * sum(a * b for a, b in last)
        found.append(y)
    return jnp.stack(found)


EXACT = jax.jacfwd(lambda *x: states(*x)[jnp.array([0, 2, 3, 5])], (0, 1))(START, PULL)


def run_and_steps(count=5, times=TIMES, between=replay.STEPS_BETWEEN):
    run = Run(rates, lambda start, pull: 1.0 * start, [START, PULL], WEIGHTS)
    kept = states(START, PULL)[::between]
    return run, Steps.of(RECORD, jnp.asarray(count), kept, times, JUMPS)


BOTH = pytest.mark.parametrize("in_c", [True, False], ids=["C", "XLA"])


@functools.partial(jax.jit, static_argnums=1)
def tangents(moved, in_c):
    return replay.push(*run_and_steps(), moved, in_c)


@BOTH
@pytest.mark.parametrize("many", [1, 4, 9])
def test_tangents(many, in_c):
    # one, or four at once, along each of the four numbers; or more than a row holds
    unit = [jnp.eye(4)[:2], jnp.eye(4)[2:]]
    if many > 4:
        more = [jnp.tile(x, 3)[:, :many] for x in unit]
        shown, last = (x[..., 4:8] for x in tangents(more, in_c))
    elif many > 1:
        shown, last = tangents(unit, in_c)
    else:
        parts = [tangents([x[:, i : i + 1] for x in unit], in_c) for i in range(4)]
        shown, last = (jnp.concatenate(x, axis=-1) for x in zip(*parts, strict=True))
    np.testing.assert_allclose(shown, jnp.concatenate(EXACT, axis=-1), **ROUNDING)
    np.testing.assert_array_equal(last, shown[-1])


@BOTH
@pytest.mark.parametrize("between", [16, 3, 1])
def test_cotangents(between, in_c, monkeypatch):
    # all steps from the start, three and two, or every step from a state of its own
    monkeypatch.setattr(replay, "STEPS_BETWEEN", between)
    asked = jnp.asarray(np.random.default_rng(0).normal(size=(4, 2)))
    last = jnp.asarray([0.3, -0.8])
    run, steps = run_and_steps(between=between)
    found = jax.jit(lambda a, b: replay.pull(run, steps, a, b, in_c))(asked, last)
    for part, exact in zip(found, EXACT, strict=True):
        wanted = jnp.einsum("tn,tnp->p", asked.at[-1].add(last), exact)
        np.testing.assert_allclose(part, wanted, **ROUNDING)


@BOTH
def test_lanes_of_a_batch_take_their_own_steps(in_c):
    asked = jnp.zeros((4, 2)).at[1].set(1.0)
    longer = jnp.asarray([2, 5])

    def one(count):
        run, steps = run_and_steps(count)
        last = jnp.asarray([1.0, 0.0])
        moved = [jnp.eye(4)[:2, :1], jnp.eye(4)[2:, :1]]
        back = replay.pull(run, steps, asked, last, in_c)
        return back, replay.push(run, steps, moved, in_c)

    together = jax.jit(jax.vmap(one))(longer)
    for i, count in enumerate((2, 5)):
        alone = jax.jit(one)(jnp.asarray(count))
        for a, b in zip(*map(jax.tree.leaves, (together, alone)), strict=True):
            np.testing.assert_allclose(a[i], b, **ROUNDING)


@BOTH
def test_an_output_between_two_steps_has_no_quiet_derivative(in_c):
    times = TIMES.at[1].set(0.3)
    run, steps = run_and_steps(times=times)
    shown, last = replay.push(run, steps, [jnp.ones((2, 1)), jnp.ones((2, 1))], in_c)
    assert jnp.all(jnp.isnan(shown[1]))
    assert jnp.all(jnp.isfinite(last))
    asked = jnp.zeros((4, 2))
    for row, lost in ((1, True), (0, False)):
        asked_last = jnp.zeros(2)
        found = replay.pull(run, steps, asked.at[row].set(1.0), asked_last, in_c)
        assert bool(jnp.all(jnp.isnan(found[0]))) is lost


@BOTH
def test_backwards_in_time(in_c):
    # the way back of a recorded run: its steps in reverse order, without the jump
    record = RECORD[:6][::-1].at[2].set(AT)
    run = Run(rates, lambda start, pull: 1.0 * start, [START, PULL], WEIGHTS)
    times = jnp.asarray([1.0, 0.0])
    steps = Steps.of(
        record, jnp.asarray(5), START[None], times, Landings(times[1:], None)
    )
    exact = jax.jacfwd(lambda x: states(x, PULL, record[:-1], record[1:])[-1])(START)
    asked = jnp.zeros((2, 2)), jnp.asarray([1.0, 0.0])
    found = replay.pull(run, steps, *asked, in_c)[0]
    np.testing.assert_allclose(found, exact[0], **ROUNDING)


@pytest.mark.parametrize("why", ["compiler", "device", "length"])
def test_without_c(why, monkeypatch):
    """Then XLA takes the same steps."""
    if why == "compiler":

        def none(*arguments):
            raise NoCompilerError("no C compiler was found")

        monkeypatch.setattr(ffi_call, "target_of", none)
    elif why == "device":
        monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    else:
        monkeypatch.setattr(runge_kutta_source, "_MOST_STATEMENTS", 3)
    run, steps = run_and_steps()
    unit = [jnp.eye(4)[:2], jnp.eye(4)[2:]]
    assert replay._in_c(derivative_loops.TangentLoop, run, START, jnp.eye(2)) is None
    assert replay._in_c(derivative_loops.CotangentLoop, run, START, 16) is None
    shown, _ = replay.push(run, steps, unit)
    np.testing.assert_allclose(shown, jnp.concatenate(EXACT, axis=-1), **ROUNDING)


@pytest.mark.parametrize(
    "dtype", [np.float64, pytest.param(np.float32, marks=pytest.mark.slow)]
)
def test_every_operation_has_its_derivatives(dtype):
    """In C what they are in XLA, in rows of one and of eight, and backwards."""
    random = np.random.default_rng(5)
    n = len(OPERATIONS)
    some = lambda *shape: jnp.asarray(random.uniform(-0.5, 0.5, shape), dtype)
    varied = [some(2, 2), some(2), some(n)]
    along = lambda t, y, shared, own, start: every_operation(t, y, shared, own)
    run = Run(along, lambda shared, own, start: 1.0 * start, varied, WEIGHTS)
    record = jnp.asarray([0.0, 0.1, 0.3, np.inf], dtype)
    times = jnp.asarray([0.0, 0.3], dtype)
    steps = Steps.of(
        record, jnp.asarray(2), varied[2][None], times, Landings(times[1:], None)
    )
    assert replay._in_c(derivative_loops.TangentLoop, run, varied[2], some(n, 8))
    asked, moved = (some(2, n), some(n)), [some(*x.shape, 8) for x in varied]
    both = [
        jax.jit(
            lambda moved, asked, in_c=in_c: [
                replay.push(run, steps, [x[..., :1] for x in moved], in_c),
                replay.push(run, steps, moved, in_c),
                replay.pull(run, steps, *asked, in_c),
            ]
        )(moved, asked)
        for in_c in (True, False)
    ]
    # some hundred roundings of derivatives of one to ten
    close = {"rtol": 1e3 * np.finfo(dtype).eps, "atol": 1e3 * np.finfo(dtype).eps}
    for a, b in zip(*map(jax.tree.leaves, both), strict=True):
        assert a.dtype == dtype
        np.testing.assert_allclose(a, b, **close)


def test_a_truth_of_one_trace_is_not_kept_for_the_next():
    """JAX keeps a jitted function's derivative, with all that it closes over."""

    def solve(inputs, replay, adjoint):
        x, squares = inputs
        end = jnp.where(squares, x * x, x)
        return end, None if replay is None and adjoint is None else jnp.zeros(1)

    run = jax.jit(lambda x, squares: differentiable(solve, (x, squares), checkpoints=4))
    for squares, slope in ((True, 6.0), (False, 1.0)):
        fresh = jax.jit(lambda x, squares: jax.grad(run)(x, squares))
        assert fresh(jnp.asarray(3.0), jnp.asarray(squares)) == slope
