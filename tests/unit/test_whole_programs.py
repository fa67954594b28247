"""Programs with loops, branches and larger arrays in C, against XLA's of the same.

Where the operations are the same in the same order, so are the numbers; sums of many
may be in another order, and products fused into them: a few roundings a sum.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from rollkane.codegen import Whole, in_one_program, in_one_program_or_not
from rollkane.codegen.known_numbers import of_known
from rollkane.codegen.scalar_program import NotElementwiseError
from rollkane.geometry.small_linear import components

from ..whole_numbers import NARROW, least_and_most, noise, wrapping

X = jnp.array([0.3, -0.5, 0.9])
MANY = jnp.sin(1.0 + jnp.arange(60.0) ** 1.5)
ROUNDING = 1e-14


def compare(function, *arguments, rtol=ROUNDING):
    """Results of a function by both, for one and in a batch."""
    wanted = jax.jit(function)(*arguments)
    found = jax.jit(lambda *a: in_one_program(function, *a))(*arguments)
    same(found, wanted, rtol)
    return found


def same(found, wanted, rtol):
    assert jax.tree.structure(found) == jax.tree.structure(wanted)
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(wanted), strict=True):
        assert (a.shape, a.dtype) == (b.shape, b.dtype)
        finite = np.abs(np.where(np.isfinite(b), b, 0))
        size = np.max(finite, initial=0)
        np.testing.assert_allclose(a, b, rtol=rtol, atol=rtol * size)


def wandering(x, turns):
    """A loop of unknown length with branches, small and large arrays."""

    def turn(carry):
        i, y, kept = carry
        y = jax.lax.cond(y[0] > 0.3, lambda: jnp.cos(2.0 * y), lambda: jnp.roll(y, 1))
        y = jax.lax.switch(
            i % 3, [lambda: y + 0.5, lambda: y * y, lambda: -y + jnp.sin(y[1])]
        )
        return i + 1, y, kept.at[i].set(y)

    begun = jnp.asarray(0), x, jnp.full((40, 3), jnp.nan)
    return jax.lax.while_loop(lambda c: c[0] < turns, turn, begun)


@jax.jit
def winding(x, turns, sense):
    """A long program that may be called at many places."""
    for k in range(12):
        x = x * jnp.cos(x[k % 3]) + jnp.roll(x, 1) / (2.0 + x[0] * x[0])
        x = jnp.where(sense, x, -x)
    return (
        x,
        turns + 1,
        jnp.zeros(2),
        jax.lax.fori_loop(0, turns, lambda i, a: a / 2, x),
    )


def test_a_program_called_at_many_places_is_one_function():
    def often(x, turns):
        first, more, none, half = winding(x, turns, turns > 2)
        second, more, *_ = jax.lax.cond(
            first[0] > 0.0,
            lambda: winding(first, more, jnp.asarray(True)),
            lambda: winding(half, more, turns < 0),
        )
        others = [winding((k + 2) * second, more, turns > 2)[0] for k in range(3)]
        # of another form: inputs that are known
        known = winding(jnp.ones(3), turns, jnp.asarray(False))
        return second, more, none, others, known

    compare(often, X, jnp.asarray(3))
    written = Whole.of(often, X, jnp.asarray(3))
    text = "\n".join((*written.parts, *(x for more in written.further for x in more)))
    functions = text.replace("static void run", "OF_THE_PROGRAM").split(
        "OF_THE_PROGRAM"
    )
    long = [x for x in functions if x.count("\n") > 150]
    # signs that are known or not: two, for six calls; of known numbers little is left
    assert len(long) == 2


def test_loops_with_branches():
    compare(wandering, X, 30)
    # writing behind the end is dropped, as it is by XLA
    compare(wandering, X, 45)


def test_in_a_batch_each_has_its_own_turns():
    xs, turns = X[None] * jnp.linspace(0.2, 1.0, 9)[:, None], jnp.arange(9) * 4
    both = jax.vmap(wandering)
    own = jax.vmap(lambda x, n: in_one_program(wandering, x, n))
    same(jax.jit(own)(xs, turns), jax.jit(both)(xs, turns), ROUNDING)
    again = jax.vmap(lambda x: in_one_program(wandering, x, 7))
    twice = jax.jit(jax.vmap(again))(jnp.stack([xs, 2.0 * xs]))
    wanted = jax.vmap(jax.vmap(lambda x: wandering(x, 7)))(jnp.stack([xs, 2.0 * xs]))
    same(twice, wanted, ROUNDING)


def test_a_batch_inside_of_a_loop():
    def roots(a):
        grows = lambda q: (q[0] * (1.2 + 0.1 * jnp.sin(a)) + a, q[1] + 1)
        return jax.lax.while_loop(lambda q: q[0] < 3.0, grows, (0.1 * a, 0))

    compare(lambda a: jax.vmap(roots)(a), jnp.linspace(0.1, 2.0, 50))
    compare(lambda a: jax.vmap(roots)(a), jnp.linspace(0.1, 2.0, 5))


def test_scans():
    def step(total, row):
        total = total + row @ jnp.ones(3)
        return total, (total * row, total > 1.0)

    rows = jnp.reshape(MANY, (20, 3))
    compare(lambda rows: jax.lax.scan(step, 0.0, rows), rows)
    compare(lambda rows: jax.lax.scan(step, 0.0, rows, reverse=True), rows)
    compare(lambda x: jax.lax.scan(step, 0.0, jnp.stack([x, -x])), X)
    compare(lambda x: jax.lax.fori_loop(0, 7, lambda i, y: y * 0.5 + i, x), X)


def swapped(a, b):
    """Two arrays that change places, and one that is read after it was written."""

    def turn(i, carry):
        a, b, seen = carry
        first = a[0]
        written = a.at[i].set(b[i] + first)
        seen = seen + a[i] + written[i]
        return b, written, seen

    return jax.lax.fori_loop(0, 9, turn, (a, b, 0.0)), a


def test_what_no_turn_changes_is_computed_once():
    """Ahead of the loop, and each turn begins with it anew."""

    def searched(x, many):
        def table(scale):
            return jnp.sin(scale * many).at[3].set(scale)

        def turn(y, row):
            spoiled = table(x[0]).at[jnp.asarray(jnp.abs(y) * 10, int)].add(row)
            return y + jnp.min(spoiled - table(x[1])) / 50.0, jnp.sum(spoiled)

        return jax.lax.scan(turn, x[2], many[:40])

    def again(x, many):
        def turn(carry):
            i, y = carry
            y, sums = searched(y, many)
            return i + 1, x + y + jnp.max(sums) / 1e3

        return jax.lax.while_loop(lambda c: c[0] < 3, turn, (0, x))

    compare(searched, X, MANY)
    compare(again, X, MANY)
    program = Whole.of(searched, X, MANY)
    text = program.parts[-1]
    ahead, loop = text.split("< 40;", 1)
    assert ahead.count("sin_one(") == 2
    assert "sin_one(" not in loop


def test_arrays_are_values():
    compare(swapped, MANY, 2.0 * MANY)

    def kept(a):
        before = a[::2]
        turned = jnp.reshape(a, (6, 10)).T
        after = a.at[3].set(7.0)
        last = jax.lax.cond(after[0] > 0.0, lambda: after.at[4].add(1.0), lambda: after)
        return before, turned, after, last, last.at[5].add(2.0)[5]

    compare(kept, MANY)
    compare(kept, -MANY)

    def spread(x):
        many, rows = jnp.full(60, x[0]), jnp.broadcast_to(x, (20, 3))
        turn = lambda i, c: (c[0].at[i].add(1.0), c[1].at[i].set(c[0][:3]))
        return (
            many.at[3].set(1.0),
            rows.at[2].set(4.0),
            jax.lax.fori_loop(0, 5, turn, (jnp.full(60, x[1]), rows + 0.0 * x[2])),
        )

    compare(spread, X)


SORTED = jnp.sort(MANY)


def looked_up(x, i):
    return (
        *(x[i], x[i + 70], x.at[i].add(x[1]), x.at[-1].set(9.0)),
        *(jnp.take(x, jnp.array([1, 0, 5]) + i, mode="fill"), x[jnp.array([2, 1]) * i]),
        jax.lax.dynamic_slice(x, (i,), (4,)),
        jax.lax.dynamic_update_slice(x, x[:2], (i,)),
        jnp.searchsorted(SORTED, x[i]),
        jnp.reshape(x, (12, 5))[i, 2],
        jnp.reshape(x, (12, 5)).at[i].set(x[:5]),
        jax.vmap(lambda k: x[k])(jnp.array([2, 1, 70]) * i),
        jax.vmap(lambda k: jnp.reshape(x, (12, 5))[k])(jnp.array([2, 1]) * i),
    )


@pytest.mark.parametrize("i", [0, 3, 58, -2])
def test_indices_that_are_not_known(i):
    compare(looked_up, MANY, i)


def test_small_arrays_by_unknown_indices():
    small = lambda x, i: (x[i], x.at[i].set(5.0), jnp.array([1, 2, 4, 8, 16])[i])
    for i in (0, 2, -1, 7):
        compare(small, X, i)


def summed(x):
    rows = jnp.reshape(x, (4, 15))
    return (
        *(jnp.sum(rows), jnp.max(rows, axis=1), jnp.min(rows, axis=0), jnp.prod(rows)),
        *(jnp.argmin(rows, axis=1), jnp.argmax(x), jnp.argmax(x > 0.99)),
        *(jnp.any(rows > 0.999, axis=1), jnp.all(x < 2.0)),
        *(jnp.cumsum(x), jnp.cumprod(rows, axis=1), jax.lax.cummin(x, reverse=True)),
        jax.lax.top_k(x, 5),
        rows @ rows.T,
        jnp.einsum("bij,bj->bi", jnp.reshape(x, (3, 4, 5)), jnp.ones((3, 5)) * x[0]),
    )


def test_sums_and_orders():
    # 60 numbers of one and less: their sums are off by 60 roundings at most
    compare(summed, MANY, rtol=1e-13)
    # what is not a number is the first of all
    compare(lambda x: (jnp.argmin(x), jax.lax.top_k(x, 3)), MANY.at[7].set(jnp.nan))
    ties = jnp.repeat(jnp.array([1.0, 3.0, 3.0, 2.0]), 12)
    compare(lambda x: (jnp.argmax(x), jnp.argmin(x), jax.lax.top_k(x, 30)), ties)
    compare(lambda x: (jnp.argmax(x), jax.lax.cummax(x), jnp.cumsum(x)), X)


def in_order(x):
    rows = jnp.reshape(x, (5, 3, 4))
    return jnp.sort(x), *(jnp.sort(rows, axis=axis) for axis in range(3))


def test_sorts():
    compare(in_order, MANY)
    compare(in_order, MANY.at[jnp.array([3, 41])].set(jnp.nan).at[7].set(-jnp.inf))
    compare(lambda x: jnp.sort(x), X)
    whole = lambda x: jnp.sort((1e3 * x).astype(int) % 17)
    compare(lambda x: (whole(x), jnp.sort(x > 0.5)), MANY)
    rows = lambda x: jnp.reshape((1e3 * x).astype(int) % 5, (5, 12))
    compare(lambda x: (jnp.argsort(x), jnp.argsort(rows(x), axis=0)), MANY)


def moved(x):
    rows = jnp.reshape(x, (4, 15))
    return (
        *(rows.T, rows[::-1, 2:9:3], jnp.concatenate([rows, -rows]), jnp.pad(x, 2)),
        *(jnp.stack([rows, rows], axis=1), jnp.split(rows, 3, axis=1), jnp.flip(x)),
        *(jnp.broadcast_to(x, (3, 60)), jnp.tile(x, 2), jnp.reshape(rows.T, (6, 10))),
        *(jnp.where(rows > 0.0, rows, X[0]), jnp.arange(60.0) * x, rows * rows[:, :1]),
        jnp.roll(rows, 4, axis=1),
        *(jnp.stack(components(x)[:7]), jnp.stack(components(rows)[1:3])),
    )


def test_larger_arrays_change_places():
    compare(moved, MANY)


def numbered(i, j):
    return (
        *(i // j, i % j, jax.lax.div(i, j), jax.lax.rem(i, j), jnp.abs(i), -j),
        *(
            i & j,
            i | j,
            i ^ j,
            i << 2,
            jnp.sign(i),
            jnp.maximum(i, j),
            jnp.clip(i, -1, 1),
        ),
        *((i * 1.5).astype(int), i > j, ~(i > j), i.astype(float) / 3.0),
    )


def test_whole_numbers():
    for i, j in ((7, 2), (-7, 2), (7, -2), (-8, -3), (5, 0), (0, 4)):
        if j:
            compare(numbered, jnp.asarray(i), jnp.asarray(j))
    # the least of all is what is read outside of an array
    outside = lambda i: jnp.take(jnp.array([3, 4]), i, mode="fill")
    compare(lambda i: outside(jnp.stack([i, i + 2])) < 0, jnp.asarray(1))
    largest = jnp.array([jnp.nan, jnp.inf, -jnp.inf, 1e300, -2.7, 2.7])
    compare(lambda x: x.astype(int), largest)


@pytest.mark.parametrize("kind", [*NARROW, "int64"])
def test_whole_numbers_wrap_as_in_xla(kind):
    compare(lambda x: wrapping(x, kind, 300.0), jnp.asarray(0.37))
    found = compare(lambda x: wrapping(x, kind, 300.0), jnp.asarray(-0.43))
    assert np.ptp(found) > 0.5


def test_whole_numbers_of_reals_and_noise():
    compare(least_and_most, jnp.asarray(0.3))
    first, second = (compare(noise, jnp.asarray(x)) for x in (0.3, 0.301))
    assert first != second


def test_numbers_that_c_does_not_have_are_refused():
    for f in (lambda x: jnp.sqrt(x + 0j).real, lambda x: x.astype(jnp.uint64) * 2):
        with pytest.raises(NotElementwiseError):
            in_one_program(f, jnp.asarray(2.0))


def test_numbers_that_are_none():
    odd = jnp.array([jnp.nan, jnp.inf, -jnp.inf, 0.0, -0.0])
    compare(
        lambda x: (
            *(jnp.maximum(x, 1.0), jnp.minimum(x, 1.0), jnp.clip(x, -1.0, 1.0)),
            *(jnp.isfinite(x), jnp.isnan(x), jnp.sign(x), 1.0 / x, jnp.max(x)),
            *(jnp.nextafter(x, 2.0), jnp.sqrt(x), x == x, x != x, x < 1.0),
        ),
        odd,
    )


def test_single_precision():
    x = MANY.astype(jnp.float32)
    turn = lambda i, y: jnp.where(y > 0.3, jnp.cos(y), y * y - 0.1)
    loop = lambda x: jax.lax.fori_loop(0, 5, turn, x)
    # 60 sums, each of a rounding of 6e-8
    compare(lambda x: (jnp.cumsum(x), loop(x), loop(x[:3])), x, rtol=4e-6)


@pytest.mark.slow
def test_long_branches_are_functions_of_their_own():
    def long(x):
        for k in range(120):
            x = jnp.sin(x) * (1.0 + 0.01 * k) + jnp.roll(x, 1) * 0.1
        return x

    def both(x, n):
        y = jax.lax.cond(n > 2, lambda: long(x), lambda: x)
        turn = lambda i, c: (long(c[0]) + i, c[0])
        return y, jax.lax.fori_loop(0, n, turn, (x, y))

    compare(both, X, 3, rtol=1e-12)  # contracts; off by rounding of 300 operations
    compare(both, X, 1, rtol=1e-12)


def test_derivatives_are_programs_too():
    def ends(x):
        step = lambda c, k: (0.6 * jnp.sin(c + 0.1 * k) + 0.1 * c[0], c[1])
        last, seen = jax.lax.scan(step, x, jnp.arange(30.0))
        chosen = jax.lax.cond(last[0] > 0.5, lambda: last**2, lambda: -last)
        return jnp.sum(chosen) + jnp.sum(seen[::3])

    compare(lambda x: jax.jvp(ends, (x,), (jnp.ones(3),)), X, rtol=1e-12)
    compare(jax.grad(ends), X, rtol=1e-12)


def test_what_is_closed_over():
    @jax.jit
    def run(x, y):
        found = in_one_program(lambda x: x + y * MANY[:3], x)
        return found, x + y * MANY[:3]

    found, wanted = run(X, jnp.asarray(3.0))
    np.testing.assert_allclose(found, wanted, rtol=ROUNDING)


def test_what_is_not_written_in_c():
    sorts = lambda x: jnp.lexsort((x, x > 0.5))
    with pytest.raises(NotElementwiseError, match="sort"):
        in_one_program(sorts, MANY)
    np.testing.assert_array_equal(in_one_program_or_not(sorts, MANY), sorts(MANY))
    mixed = lambda x: jnp.sum(x.astype(jnp.float32) * 2.0)
    with pytest.raises(NotElementwiseError, match="float32"):
        in_one_program(mixed, MANY)


@pytest.mark.parametrize("kind", ["int64", "uint32"])
@pytest.mark.parametrize("name", ["div", "rem"])
def test_known_whole_numbers_are_divided_as_xla_does(kind, name):
    for a in (-7, -6, -1, 0, 1, 6, 7):
        if a < 0 and kind[0] == "u":
            continue
        operands = [np.dtype(kind).type(x) for x in (a, 3)]
        found = of_known(name, {}, operands, np.dtype(kind))
        assert found.dtype == kind
        assert found == getattr(jax.lax, name)(*map(jnp.asarray, operands))
