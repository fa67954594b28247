"""A function that is linear in some arguments: its transpose, asked in part."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from rollkane.codegen.linear_call import Linear, is_asked_for, linear_call, shapes_of

K, X = jnp.array([2.0, 3.0, 5.0]), jnp.array([0.5, -1.0, 7.0])
asked: list[list[bool]] = []


def forward(residuals, operands):
    (k,), (x,) = residuals, operands
    return [k * x, jnp.sum(k * x), x[::-1]]


def backward(residuals, cotangents):
    """The transpose of ``forward``; what is not asked for is left out."""
    asked.append([is_asked_for(c) for c in cotangents])
    (k,), (a, b, c) = residuals, cotangents
    found = jnp.zeros_like(k)
    for cotangent, own in (
        (a, lambda: k * a),
        (b, lambda: k * b),
        (c, lambda: c[::-1]),
    ):
        if is_asked_for(cotangent):
            found = found + own()
        else:
            assert cotangent.shape in ((3,), ())
            assert not cotangent.any()
    return [found]


def called(k, x):
    shapes = shapes_of([x, jnp.zeros(()), x])
    return linear_call(Linear(forward, backward), [k], [x], shapes)


def last_and_sum(k, x):
    _, total, turned = called(k, x)
    return 3.0 * total + turned[0]


# by hand: d/dx of 3 k . x + x_3
SLOPE = 3.0 * K + jnp.array([0.0, 0.0, 1.0])


@pytest.fixture(autouse=True)
def _nothing_asked():
    asked.clear()


def test_a_gradient_asks_for_what_its_function_uses_alone():
    np.testing.assert_array_equal(jax.grad(last_and_sum, 1)(K, X), SLOPE)
    assert asked == [[False, True, True]]
    np.testing.assert_array_equal(jax.grad(lambda x: called(K, x)[0][1])(X), [0, 3, 0])
    assert asked[1:] == [[True, False, False]]


@pytest.mark.parametrize("axes", [(None, 0), (0, 0), (0, None)])
def test_in_a_batch_too(axes):
    """A batch of gradients, and the gradient of a batch."""
    ks = K if axes[0] is None else jnp.stack([K, 2.0 * K])
    xs = X if axes[1] is None else jnp.stack([X, -X])
    own = [SLOPE, SLOPE if axes[0] is None else SLOPE + 3.0 * K]
    gradients = jax.jit(jax.vmap(jax.grad(last_and_sum, 1), axes))(ks, xs)
    np.testing.assert_array_equal(gradients, own)
    many = lambda x: jnp.sum(jax.vmap(last_and_sum, axes)(ks, x))
    whole = np.sum(own, axis=0) if axes[1] is None else own
    np.testing.assert_array_equal(jax.grad(many)(xs), whole)
    first = lambda x: jnp.sum(jax.vmap(lambda k, x: called(k, x)[0], axes)(ks, x))
    jax.grad(first)(xs)
    assert asked.pop() == [True, False, False]
    assert asked
    assert all(x == [False, True, True] for x in asked)


def test_the_transpose_of_what_was_asked_is_the_function_again():
    """A gradient is linear in what it is asked with: its own gradient by that."""
    weighed = lambda w: jnp.dot(jax.grad(lambda x: w * last_and_sum(K, x))(X), K)
    np.testing.assert_array_equal(jax.grad(weighed)(2.0), jnp.dot(SLOPE, K))
