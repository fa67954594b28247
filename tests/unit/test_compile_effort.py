"""Compiling with little effort changes no result and no transformation."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from rollkane.codegen import compile_effort
from rollkane.codegen.compile_effort import (
    around_a_loop,
    for_one_call,
    joined,
    parted,
    with_little_effort,
)

double = for_one_call(lambda x: 2.0 * x)


def test_known_arguments_are_compiled():
    assert double(jnp.asarray(3.0)) == 6.0


def test_traced_arguments_go_through():
    assert jax.grad(double)(3.0) == 2.0
    assert (jax.vmap(double)(jnp.arange(3.0)) == jnp.array([0.0, 2.0, 4.0])).all()
    assert jax.jit(double)(3.0) == 6.0


def test_known_arguments_inside_a_trace_stay_known():
    three = jnp.asarray(3.0)

    @jax.jit
    def times_six(x):
        return float(double(three)) * x

    assert times_six(2.0) == 12.0


@pytest.mark.parametrize("first", [jax.jit, jax.grad])
def test_around_a_loop_in_every_order(first):
    """First inside of a trace, or of a derivative of something else, then outside."""
    three = jnp.asarray(3.0)
    times = around_a_loop(lambda x: 2.0 * x, jax.jit)
    assert first(lambda x: times(three) * x)(three) in (18.0, 6.0)
    assert jax.grad(lambda x: times(three) * times(x))(three) == 12.0
    assert times(three) == 6.0
    assert jax.grad(times)(three) == 2.0
    assert (jax.vmap(times)(jnp.arange(2.0)) == jnp.array([0.0, 2.0])).all()
    assert jax.jit(times)(three) == 6.0
    assert times(three) == 6.0


@pytest.mark.parametrize("derivative", [jax.grad, jax.jacfwd])
def test_what_is_first_differentiated_is_not_traced_without(derivative):
    traced = []

    @jax.custom_jvp
    def square(x):
        traced.append(x)
        return x * x

    @square.defjvp
    def _(primals, tangents):
        (x,), (x_dot,) = primals, tangents
        return x * x, 2.0 * x * x_dot

    squared = around_a_loop(lambda x, y: square(x) + y[0], jax.jit)
    known = np.array([1.0, 2.0])
    slope = jax.jit(derivative(lambda x: squared(x, known)))
    assert slope(3.0) == 6.0
    assert not traced
    several = lambda x: squared(x, known) * squared(x + 1.0, known)
    assert jax.jit(derivative(several))(1.0) == 2.0 * 5.0 + 2.0 * 4.0
    assert jax.jit(jax.vmap(slope))(jnp.arange(2.0)).tolist() == [0.0, 2.0]
    assert squared(3.0, known) == 10.0


@pytest.mark.parametrize("first", [jax.jit, jax.grad])
def test_for_one_call_in_every_order(first):
    """Once it has seen that nothing is traced, it still sees when something is."""
    three = jnp.asarray(3.0)
    twice = for_one_call(lambda x: 2.0 * x)
    assert first(lambda x: twice(three) * x)(three) in (18.0, 6.0)
    assert jax.grad(lambda x: twice(three) * twice(x))(three) == 12.0
    for _ in range(2):
        assert twice(three) == 6.0
        assert jax.grad(twice)(three) == 2.0
        assert (jax.vmap(twice)(jnp.arange(2.0)) == jnp.array([0.0, 2.0])).all()
        assert jax.jit(twice)(three) == 6.0


def test_parts_are_joined_to_what_they_were_of():
    whole = {"a": jnp.arange(2.0), "b": (1, "c", None), "d": np.ones(3)}
    fixed, arrays = parted(whole)
    assert [x.shape for x in arrays] == [(2,), (3,)]
    again = joined(fixed, arrays)
    assert again["b"] == whole["b"]
    assert again["d"] is whole["d"]
    other, _ = parted(whole | {"a": jnp.zeros(2)})  # other numbers, the same program
    assert other is fixed


@pytest.mark.parametrize("other", [1.0, True, 2])
def test_equal_numbers_of_another_type_make_another_program(other):
    assert parted((other,))[0] != parted((1,))[0]


def test_options_that_a_release_does_not_know_are_left_out(monkeypatch):
    monkeypatch.setattr(compile_effort, "_LITTLE", {"no_such_option_of_xla": True})
    monkeypatch.setattr(compile_effort, "_unknown", set())
    triple = with_little_effort(functools.partial(jax.jit, lambda x: 3.0 * x))
    assert triple(jnp.asarray(2.0)) == 6.0
    assert compile_effort._unknown == {"no_such_option_of_xla"}
