"""Compiling with little effort changes no result and no transformation."""

import functools

import jax
import jax.numpy as jnp

from rollkane.codegen import compile_effort
from rollkane.codegen.compile_effort import for_one_call, with_little_effort

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


def test_options_that_a_release_does_not_know_are_left_out(monkeypatch):
    monkeypatch.setattr(
        compile_effort, "_LITTLE_EFFORT", {"no_such_option_of_xla": True}
    )
    triple = with_little_effort(functools.partial(jax.jit, lambda x: 3.0 * x))
    assert triple(jnp.asarray(2.0)) == 6.0
    assert compile_effort._LITTLE_EFFORT == {}
