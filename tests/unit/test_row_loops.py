"""Operations on the rows of arrays in C: one loop where they follow one another.

Each operation is XLA's, on the same numbers: results differ by a rounding of each.
"""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from rollkane.codegen import Whole, in_one_program

MANY = jnp.sin(1.0 + jnp.arange(120.0) ** 1.5).reshape(40, 3)
TURN = jnp.array([[0.6, -0.8, 0.0], [0.8, 0.6, 0.1], [0.0, 0.1, 1.0]])


def loops_of(function, *arguments):
    """How many loops over 40 rows its program has."""
    whole = Whole.of(function, *arguments)
    text = "\n".join([*whole.parts, *("\n".join(x) for x in whole.further)])
    return len(re.findall(r"for \(long i\d+ = 0; i\d+ < 40;", text))


def agrees(function, *arguments):
    wanted = jax.jit(function)(*arguments)
    found = jax.jit(lambda *x: in_one_program(function, *x))(*arguments)
    # sums of 40 numbers, each with a rounding of what is largest, twice
    known = 80.0 * 2.0**-53 * np.abs(wanted).max()
    np.testing.assert_allclose(found, wanted, rtol=0, atol=known)


def height(place, turn, shift):
    """Of a point that is turned and moved, over a wave."""
    x, y, z = turn[0] * place[0] + turn[1] * place[1] + turn[2] * place[2] + shift
    size = jnp.sqrt(x * x + y * y + z * z)
    return jnp.where(z > 0.0, z / size, jnp.sin(x)) - 0.1 * size


def test_a_function_of_each_row_is_one_loop():
    def heights(places, turn, shift):
        return jax.vmap(lambda place: height(place, turn, shift))(places)

    arguments = MANY, TURN, jnp.array([0.1, 0.2, -0.3])
    agrees(heights, *arguments)
    assert loops_of(heights, *arguments) == 1


def test_long_rows_are_looped_over_together():
    def along(x):
        y = jnp.sin(x) * x
        return jnp.where(y > 0.3, y - x, 2.0 * x + 0.1)

    wide = MANY[:, None] * jnp.linspace(0.5, 1.0, 9)[None, :, None]
    agrees(along, wide)
    assert loops_of(along, wide) == 1


def test_sums_and_greatest_numbers_of_rows_are_of_the_same_loop():
    def of_rows(x):
        y = x * x + 0.5
        both = jnp.stack([jnp.sum(y, axis=1), jnp.max(x, axis=1)], axis=1)
        none = jnp.any(x > 0.9, axis=1)
        return jnp.where(none[:, None], both, jnp.min(y, axis=1)[:, None])

    agrees(of_rows, MANY)
    assert loops_of(of_rows, MANY) == 1


@pytest.mark.parametrize(
    "other",
    [
        lambda y: y[::-1],  # rows that the loop has still to write, or has changed
        lambda y: jnp.broadcast_to(y[39], y.shape),
        lambda y: jnp.roll(y, 1, axis=0),
        lambda y: jnp.cumsum(y, axis=0),
        lambda y: y.at[3].set(2.0),
        lambda y: jnp.concatenate([y[20:], y[:20]]),
        lambda y: jnp.broadcast_to(jnp.sum(y, axis=0), y.shape),
        lambda y: y[:, ::-1],
        lambda y: jnp.repeat(y[:, :1], 3, axis=1),
        lambda y: (y.T * 2.0).T,
    ],
)
def test_what_other_rows_hold_is_read_when_it_is_there(other):
    def mixed(x):
        y = 2.0 * x + 1.0
        return y * other(y) - other(x)

    agrees(mixed, MANY)


def test_single_numbers_between_rows():
    """What stands between two loops may read what the first one wrote."""

    def mixed(x, a):
        y = x * a
        first = y[7, 1] + a
        z = y + first
        return z * jnp.sum(z[3]), first

    wanted = jax.jit(mixed)(MANY, 0.3)
    found = jax.jit(lambda *x: in_one_program(mixed, *x))(MANY, 0.3)
    for a, b in zip(found, wanted, strict=True):
        # a dozen roundings of numbers of order one
        np.testing.assert_allclose(a, b, rtol=0, atol=12.0 * 2.0**-53)


def test_rows_that_a_loop_carries():
    def turned(x):
        def turn(_, y):
            z = y * y
            return jnp.where(z > 0.2, jnp.sin(y - z), 0.5 * y[::-1] + 0.1 * z)

        return jax.lax.fori_loop(0, 5, turn, x)

    agrees(turned, MANY)


def test_whole_numbers_and_truths_of_rows():
    def mixed(x):
        count = jnp.floor(10.0 * x).astype(int)
        even = count % 2 == 0
        return jnp.where(even & (count > -3), count, -count), even ^ (x > 0.0)

    wanted = jax.jit(mixed)(MANY)
    found = jax.jit(lambda x: in_one_program(mixed, x))(MANY)
    for a, b in zip(found, wanted, strict=True):
        np.testing.assert_array_equal(a, b)


def test_what_nobody_reads_is_not_written():
    whole = Whole.of(lambda x: jnp.sum(jnp.cos(x * x), axis=1), MANY)
    text = "\n".join(whole.parts)
    written = re.findall(r"^\s*(?:m|o)\d+\[[^\]]*\] = ", text, re.MULTILINE)
    assert len(written) == 1
