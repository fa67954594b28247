"""Derivatives, outside of ``jit``, of what is compiled with an effort of its own."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from rollkane.codegen.compile_effort import around_a_loop, for_one_call
from rollkane.codegen.linear_call import Linear, is_asked_for, linear_call, shapes_of
from rollkane.codegen.outer_derivatives import OuterDerivatives
from rollkane.validation.checks import is_traced

A, B = jnp.array([0.1, 1.1, 2.1]), jnp.asarray(2.0)


def several(a, b, whole, name):
    """Floats, whole numbers, and what is no number."""
    return {
        "sine": jnp.sin(a) * b + whole[1].astype(float),
        "sum": jnp.cumsum(a) * 2.0,
        "count": whole + 1,
        "name": name,
        "still": jnp.ones(3),
    }


QUICK = {
    "one call": for_one_call(several),
    "a loop": around_a_loop(several, functools.partial(eqx.filter_jit)),
}


def misfit(function, a, b):
    found = function(a, b, np.arange(2), "x")
    assert found["name"] == "x"
    return jnp.sum(found["sine"] ** 2) + jnp.sum(found["sum"]) + found["still"][0]


def pulled_in_jit(f):
    return lambda a, b: jax.jit(jax.vjp(f, a, b)[1])(jnp.ones(()))


def pushed_in_a_loop(f):
    def run(a, b):
        push = jax.linearize(f, a, b)[1]
        return jax.lax.map(lambda t: push(t, b), jnp.stack([a, 2.0 * a]))

    return run


WAYS = {
    "grad": lambda f: jax.grad(f, (0, 1)),
    "jvp": lambda f: lambda a, b: jax.jvp(f, (a, b), (b * a, b)),
    "of one": lambda f: lambda a, b: jax.grad(lambda b: f(a, b))(b),
    "jacfwd": lambda f: jax.jacfwd(f, (0, 1)),
    "jacrev": lambda f: jax.jacrev(f, (0, 1)),
    "forward over reverse": jax.hessian,
    "reverse over reverse": lambda f: jax.jacrev(jax.jacrev(f)),
    "reverse over forward": lambda f: jax.jacrev(jax.jacfwd(f)),
    "grad of each": lambda f: (
        lambda a, b: jax.vmap(jax.grad(f), (0, None))(jnp.stack([a, b * a]), b)
    ),
    "grad of all": lambda f: (
        lambda a, b: jax.grad(
            lambda b: jnp.sum(jax.vmap(f, (0, None))(jnp.stack([a, b * a]), b))
        )(b)
    ),
    "grad in jit": lambda f: jax.jit(jax.grad(f)),
    "pulled in jit": pulled_in_jit,
    "pushed in a loop": pushed_in_a_loop,
    "remembered less": lambda f: jax.grad(jax.checkpoint(f)),
}


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("quick", QUICK)
def test_derivatives_are_those_of_the_function(quick, way):
    found = WAYS[way](functools.partial(misfit, QUICK[quick]))(A, B)
    right = WAYS[way](functools.partial(misfit, several))(A, B)
    # some ten roundings of numbers up to 70, in another order
    rounding = lambda x, y: np.testing.assert_allclose(x, y, rtol=0, atol=1e-12)
    jax.tree.map(rounding, found, right)


@pytest.mark.parametrize("quick", QUICK)
@pytest.mark.parametrize("derivative", [jax.grad, jax.jacfwd])
def test_whole_numbers_are_known_within_a_derivative(quick, derivative):
    def first(a):
        found = QUICK[quick](a, B, np.arange(2), "x")
        assert found["count"].tolist() == [1, 2]
        return found["sum"][0]

    assert derivative(first)(A).tolist() == [2.0, 0.0, 0.0]


def known_programs(called):
    """What compiles functions, and says which were called, with known numbers alone."""

    def compiled(function):
        name = getattr(function, "func", function).__name__
        jitted = eqx.filter_jit(function)

        def call(*arguments):
            assert not is_traced(arguments)
            called.append(name)
            return jitted(*arguments)

        return call

    return compiled


@pytest.mark.parametrize(
    ("derivative", "programs"),
    [
        (jax.grad, ["_linearized", "_pulled"]),
        (lambda f: lambda x: jax.jvp(f, (x,), (x,)), ["_along"]),
        (lambda f: lambda x: jax.linearize(f, x)[1](x), ["_linearized", "_pushed"]),
    ],
)
def test_parts_are_programs_of_known_numbers(derivative, programs):
    called = []
    cube = OuterDerivatives(lambda x, y: x**3 + y, known_programs(called))
    derivative(lambda x: cube(x, 1.0))(jnp.asarray(2.0))
    assert called == programs


def test_a_derivative_by_a_python_number_is_known():
    cube = for_one_call(lambda x, y: x**3 + y)
    assert jax.grad(lambda x: cube(x, 1.0))(2.0) == 12.0


def test_backwards_only_what_is_used_is_asked_for():
    asked = []

    def backward(residuals, cotangents):
        asked.append([is_asked_for(c) for c in cotangents])
        return [sum(c for c in cotangents if is_asked_for(c))]

    both = Linear(lambda residuals, x: [x[0], x[0]], backward)
    twice = for_one_call(lambda x: linear_call(both, [], [x], shapes_of([x, x])))
    assert jax.grad(lambda x: 3.0 * twice(x)[1])(2.0) == 3.0
    assert asked == [[False, True]]


@pytest.mark.parametrize("quick", [for_one_call, lambda f: around_a_loop(f, jax.jit)])
def test_what_is_traced_among_known_numbers_goes_by_jax(quick):
    """Constants are known there, so that it does not look like within ``jit``."""
    cube = quick(lambda x: x**3)

    def known(x):
        with jax.ensure_compile_time_eval():
            return cube(x)

    assert jax.jit(known)(2.0) == 8.0
    assert jax.jit(jax.grad(known))(2.0) == 12.0
