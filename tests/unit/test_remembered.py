"""What is asked once of each value."""

import gc

import equinox as eqx
import jax.numpy as jnp
import numpy as np

import rollkane as rk
from rollkane.codegen import zeros_in
from rollkane.validation.remembered import remembered


class Value:
    """Something that can be referred to weakly."""


def test_each_value_is_asked_once_and_only_while_it_lives():
    asked = []

    @remembered(lambda value: not isinstance(value, list))
    def ask(value):
        asked.append(value if isinstance(value, list) else None)
        return len(asked)

    one, other = Value(), Value()
    assert [ask(one), ask(other), ask(one), ask(other)] == [1, 2, 1, 2]
    changes = [1]
    assert [ask(changes), ask(changes)] == [3, 4]
    pair = one, other  # nothing refers weakly to a tuple
    assert [ask(pair), ask(pair)] == [5, 6]
    del one
    gc.collect()
    fresh = [Value() for _ in range(100)]  # one of them where the old one was
    assert [ask(value) for value in fresh] == list(range(7, 107))


def test_zeros_that_a_user_may_still_change_are_looked_at_each_time():
    kept, changes = rk.Gravity(jnp.zeros(3)), np.zeros(3)
    assert zeros_in(kept) is zeros_in(kept)
    held = eqx.tree_at(lambda gravity: gravity.acceleration, kept, changes)
    assert zeros_in(held) == (b"\x01\x01\x01",)
    changes[0] = 1.0
    assert zeros_in(held) == (b"\x00\x01\x01",)
