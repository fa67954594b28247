"""Programs that XLA knows before they are compiled."""

import threading

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from rollkane.codegen import NoCompilerError, ProgramsAwaited, targets
from rollkane.codegen.compiler import Program
from rollkane.codegen.ffi_call import XlaCall

from .test_call_interface import DOUBLE, needs_compiler

pytestmark = needs_compiler


@pytest.fixture(scope="module", autouse=True)
def slots_of_their_own():
    """Those of the process may have gone to programs of other tests: 128 of them."""
    few = 16
    entries = " ".join(f"ENTRY({i})" for i in range(few))
    head = f"#define SLOTS {few}\n#define ENTRIES {entries}"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(targets, "_SLOTS", few)
        patch.setattr(targets, "LATE", (head, "late_call.c"))
        late = targets._Late()
        patch.setattr(targets, "_made", lambda: late)
        yield


def call_of(text):
    """A function in C, of one array to another of its shape."""
    call = XlaCall(np.float64, 1, {}, (text,))
    return lambda x: call((x.shape,), x)[0]


def times(factor):
    return DOUBLE.replace("2 *", f"{factor} *")


def test_a_call_waits_for_its_program(monkeypatch):
    """XLA has compiled what calls it long before."""
    loaded, may_go = Program.loaded, threading.Event()
    traced = threading.Event()

    def slowly(self):
        assert may_go.wait(60.0)
        return loaded(self)

    call = jax.jit(call_of(times(3)))
    monkeypatch.setattr(Program, "loaded", slowly)
    x = jnp.arange(3.0)
    compiled = call.lower(x).compile()
    found = []

    def run():
        traced.set()
        found.append(np.asarray(compiled(x)))

    thread = threading.Thread(target=run)
    thread.start()
    assert traced.wait(60.0)
    thread.join(0.2)
    assert thread.is_alive()
    assert not found
    may_go.set()
    thread.join(60.0)
    np.testing.assert_array_equal(found[0], 3.0 * x)
    np.testing.assert_array_equal(compiled(2.0 * x), 6.0 * x)


def test_a_program_that_cannot_be_compiled_is_told_wherever_it_is_called():
    x = jnp.arange(3.0)
    with pytest.raises(jax.errors.JaxRuntimeError, match="the C compiler failed"):
        jax.block_until_ready(jax.jit(call_of("no C 1"))(x))
    for text in ("no C 1", "no C 2"):  # tried once more, and at first
        with (
            pytest.raises(NoCompilerError, match="the C compiler failed"),
            ProgramsAwaited(),
        ):
            jax.jit(call_of(text))(x)
    with ProgramsAwaited():  # nothing is left of it
        np.testing.assert_array_equal(jax.jit(call_of(times(5)))(x), 5.0 * x)


def test_a_program_that_failed_once_is_there_when_it_can_be(monkeypatch):
    def fails(self):
        raise NoCompilerError("the disk is full")

    x, call = jnp.arange(3.0), call_of(times(7))
    with monkeypatch.context() as patch:
        patch.setattr(Program, "loaded", fails)
        with (
            pytest.raises(NoCompilerError, match="the disk is full"),
            ProgramsAwaited(),
        ):
            jax.jit(lambda x: call(x))(x)
    np.testing.assert_array_equal(jax.jit(lambda x: call(x))(x), 7.0 * x)


def test_beyond_what_may_be_late_programs_are_waited_for(monkeypatch):
    monkeypatch.setattr(targets._late(), "_left", iter(()))
    x = jnp.arange(3.0)
    np.testing.assert_array_equal(jax.jit(call_of(times(9)))(x), 9.0 * x)
    with pytest.raises(NoCompilerError, match="the C compiler failed"):
        jax.jit(call_of("no C 3"))(x)
