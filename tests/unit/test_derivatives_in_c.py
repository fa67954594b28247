"""Forward and reverse mode on traced programs in C, against JAX's own of the same.

Derivatives of the same operations by the same rules: they differ by a few roundings a
sum, as values do.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from rollkane.codegen import in_one_program
from rollkane.codegen.derivatives import jvp, pulled
from rollkane.codegen.scalar_program import NotElementwiseError
from rollkane.codegen.tracing import traced_once
from rollkane.geometry.rotations import multiply, quaternion_rates, rotation_matrix
from rollkane.geometry.small_linear import (
    cross,
    inverse_sqrt,
    matmul,
    matvec,
    matvec_transposed,
    safe_norm,
    solve_2x2,
    solve_4x4,
)

X = jnp.array([0.3, -0.5, 0.9])
M = jnp.array([[1.2, 0.3, -0.4], [0.2, 0.9, 0.5], [-0.1, 0.4, 1.1]])
Q = jnp.array([0.8, -0.2, 0.5, 0.3])
MANY = jnp.sin(1.0 + jnp.arange(60.0) ** 1.5)
ROUNDING = 1e-13


@jax.custom_jvp
def kinked(x):
    return x * jnp.abs(x)


@kinked.defjvp
def _kinked(primals, tangents):
    return kinked(*primals), 2.0 * jnp.abs(primals[0]) * tangents[0]


@jax.custom_vjp
def doubled(x):
    return x * x


doubled.defvjp(lambda x: (x * x, x), lambda x, g: (2.0 * x * g,))


@traced_once
def folded(x):
    """Called at several places, of itself a call."""
    return cross(x, jnp.sin(x)) + matvec(M, x) * x[0]


def branched(x):
    y = lax.cond(x[0] > 0.0, lambda: jnp.cos(x), lambda: x * x)
    return lax.switch(
        jnp.int32(x[2] > 0.0) + 1,
        [lambda: y, lambda: -y, lambda: y * x, lambda: 3.0 * x],
    )


def scanned(x):
    rows = jnp.stack([x, 2.0 * x, x * x, jnp.ones(3)])

    def turn(carry, row):
        y, fixed = carry
        y = jnp.sin(y) * row + x
        return (y, fixed), (y[0] * row, fixed)

    (y, _), left = lax.scan(turn, (x, jnp.arange(3.0)), rows, reverse=True)
    return y, left[0], left[1]


def searched(x):
    """A loop whose end does not move, then a step that does: an implicit function."""
    fixed = lax.stop_gradient(x)
    going = lambda c: jnp.abs(c * c - fixed[2]) > 1e-13
    root = lax.while_loop(going, lambda c: c - 0.5 * (c - fixed[2] / c), fixed[2])
    return root - (root * root - x[2]) / (2.0 * lax.stop_gradient(root))


FUNCTIONS = {
    "arithmetic": lambda x: (x + 1.0) * x / (2.0 + x * x) - 3.0 / x + (-x) - x[0] * x,
    "scalars": lambda x: x[0] * x[1] / x[2] - 2.0 * (x[0] - 1.5) + x[0] ** 3,
    "one and many": lambda x: x * x[0] - x[1] / x + (x + x[2]) + (x[0] - x),
    "functions": lambda x: (
        jnp.sqrt(x * x + 1.0) + jnp.sin(x) * jnp.cos(x) + jnp.exp(x) + jnp.tanh(x)
    ),
    "more functions": lambda x: (
        jnp.log(jnp.abs(x)) + jnp.arctan2(x, 2.0 + x[::-1]) + lax.rsqrt(x * x)
    ),
    "powers": lambda x: x**2 + x**5 + (x * x) ** 1.7 + x**-2 + lax.square(x),
    "largest of two": lambda x: (
        jnp.maximum(x, x[::-1]) + jnp.minimum(x, 0.2) + jnp.maximum(x[0], x)
    ),
    "clipped": lambda x: jnp.clip(x, -0.4, 0.4) + jnp.sign(x) * x + jnp.floor(x),
    "chosen": lambda x: (
        jnp.where(x > 0.0, x * x, 3.0 * x) + jnp.where(x[0] > 0, x, 1.0)
    ),
    "sums": lambda x: (
        jnp.sum(x), jnp.sum(jnp.outer(x, x), axis=1), jnp.max(x), jnp.prod(x)
    ),
    "products": lambda x: (x @ x, M @ x, jnp.outer(x, x) @ M, jnp.tensordot(x, M, 1)),
    "places": lambda x: (
        jnp.stack([x, x * x], axis=1), x[::-1], x[1:], jnp.roll(x, 1),
        jnp.concatenate([x, x[:2]]), jnp.pad(x * x, (1, 2)), jnp.tile(x, 2),
        jnp.outer(x, x).T, x.reshape(3, 1), jnp.split(x * x, [1]), x[None] * M,
        jnp.broadcast_to(x, (2, 3)), jnp.outer(x, x)[::2, 1:],
    ),
    "indexed": lambda x: (
        x.at[1].set(x[0] * x[2]), x.at[jnp.argmax(x)].add(x[0]), x[jnp.argmin(x)],
        lax.dynamic_slice(x * x, (jnp.argmax(x) - 1,), (2,)),
        lax.dynamic_update_slice(x * x, x[:2], (jnp.argmin(x),)),
        MANY.at[jnp.argmax(x)].set(x[0])[:4],
    ),
    "a sum as it grows": lambda x: (jnp.cumsum(x * x), jnp.cumprod(x)),
    "custom rules": lambda x: kinked(x) + inverse_sqrt(x * x + 0.1),
    "branches": branched,
    "calls": lambda x: folded(x) + folded(folded(x)) * folded(2.0 * x),
    "vectors": lambda x: (
        cross(x, M[0]) + matvec_transposed(M, x), matmul(M * x[0], jnp.outer(x, x)),
        safe_norm(x), solve_2x2(M[:2, :2] * x[0], x[:2]),
        solve_4x4(jnp.eye(4) + 0.1 * jnp.outer(Q, Q) * x[0], Q * x[1]),
    ),
    "rotations": lambda x: (
        rotation_matrix(Q * x[0]), multiply(Q * x[1], Q),
        quaternion_rates(Q * x[0], x),
    ),
    "loops of known length": scanned,
    "what does not move": lambda x: (
        lax.stop_gradient(x) * x, jnp.ones(3), x * jnp.ceil(10.0 * x), 0.0 * x[0],
    ),
    "an implicit function": searched,
    "larger arrays": lambda x: (
        jnp.sum(MANY * x[0] + jnp.sin(MANY * x[1])), (MANY * x[2])[::-1][:5],
        jnp.concatenate([MANY * x[0], x])[-4:],
    ),
    "what it closes over": None,
}  # fmt: skip


def grown(x):
    """A loop of unknown length whose end moves."""

    def turn(carry):
        i, y, total, still = carry
        return i + 1, 0.9 * y + 0.1 * jnp.sin(total), total + y, still

    begun = jnp.asarray(0), x, jnp.ones(3), jnp.zeros(2)
    return lax.while_loop(lambda c: (c[0] < 30) & (c[1][2] > 0.3), turn, begun)[1:]


FORWARD = FUNCTIONS | {"loops of unknown length": grown}
BACK = FUNCTIONS | {"a rule for the way back": lambda x: doubled(x) * x}


def close(found, wanted):
    assert jax.tree.structure(found) == jax.tree.structure(wanted)
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(wanted), strict=True):
        assert (a.shape, a.dtype) == (b.shape, b.dtype)
        size = np.max(np.abs(b), initial=1.0)
        np.testing.assert_allclose(a, b, rtol=ROUNDING, atol=ROUNDING * size)


def with_closure(x):
    """Of a function that closes over what is traced."""
    other = jnp.sin(x[::-1])
    return lambda y: other * y + x[0] * y[1]


@pytest.mark.parametrize("name", FORWARD)
def test_tangents_are_those_of_jax(name):
    tangent = jnp.array([0.7, 0.2, -1.1])

    def by(rule):
        def along(x, t):
            function = FORWARD[name] or with_closure(x)
            return rule(function, (x,), (t,))

        return along

    wanted = jax.jit(by(jax.jvp))(X, tangent)
    found = jax.jit(lambda *a: in_one_program(by(jvp), *a))(X, tangent)
    close(found, wanted)


@pytest.mark.parametrize("name", BACK)
def test_cotangents_are_those_of_jax(name):
    function = BACK[name] or with_closure(X)
    like = jax.eval_shape(function, X)
    numbers = iter(np.sin(np.arange(1.0, 400.0)))
    draw = lambda x: jnp.array([next(numbers) for _ in range(x.size)]).reshape(x.shape)
    given = jax.tree.map(draw, like)

    def by(rule):
        def back(x, given):
            function = BACK[name] or with_closure(x)
            return rule(function, (x,), given)

        return back

    wanted = jax.jit(by(lambda f, x, g: jax.vjp(f, *x)[1](g)))(X, given)
    found = jax.jit(lambda *a: in_one_program(by(pulled), *a))(X, given)
    close(found, wanted)


def test_a_derivative_in_a_branch_of_a_loop():
    """As runs with modes take them: inside of loops, of what the turn has."""

    def run(x):
        def turn(carry):
            i, y = carry
            push = lambda y: jvp(lambda z: jnp.sin(z) * x, (y,), (0.1 * y,))[1]
            back = lambda y: pulled(lambda z: folded(z) * x, (y,), y)[0]
            return i + 1, lax.cond(i % 2 == 0, push, back, y) + 0.3 * y

        return lax.while_loop(lambda c: c[0] < 7, turn, (0, x))[1]

    close(jax.jit(lambda x: in_one_program(run, x))(X), jax.jit(run)(X))


def test_no_way_back_through_a_loop_of_unknown_length():
    moving = lambda x: lax.while_loop(lambda c: c[0] < 1.0, lambda c: c * 1.5, x + 0.1)
    back = lambda x: pulled(moving, (x,), x)
    with pytest.raises(NotElementwiseError, match="unknown length"):
        in_one_program(back, X)


def test_by_xla_it_is_jax():
    """A part that was traced for C and is a part of XLA's program after all."""

    @traced_once
    def changed(x):
        return jvp(folded, (x,), (x * x,))[1] + pulled(folded, (x,), x)[0]

    in_one_program(changed, X)  # traced for C
    direct = jax.jvp(folded, (X,), (X * X,))[1] + jax.vjp(folded, X)[1](X)[0]
    close(jax.jit(changed)(X), direct)
    close(jax.vmap(changed)(X[None] * jnp.arange(1.0, 3.0)[:, None])[0], direct)
    step = 1e-6
    slope = (changed(X + step * X) - changed(X - step * X)) / (2.0 * step)
    # differences: step^2 and rounding / step
    np.testing.assert_allclose(jax.jvp(changed, (X,), (X,))[1], slope, rtol=1e-8)
