"""XLA's call interface: what compiled loops depend on, in every version of it."""

import shutil
import subprocess
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from rollkane.codegen import NoCompilerError, check_usable
from rollkane.codegen.call_interface import Interface, callable_program
from rollkane.codegen.ffi_call import XlaCall
from rollkane.codegen.targets import LATE

HEADERS = sorted((Path(__file__).parents[1] / "data" / "call_interface").glob("*.h"))
CC = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
needs_compiler = pytest.mark.skipif(CC is None, reason="there is no C compiler")
# a function that reads and writes a buffer, as all compiled loops do
DOUBLE = """void *called_by_xla(const CallFrame *frame) {
    static const int axes[] = {1};
    Call call;
    if (!received(frame, axes, 1, &call)) return NULL;
    for (long b = 0; b < call.batch; b++)
        for (long i = 0; i < size_of(&call.given[0]); i++)
            wanted(&call, 0, b)[i] = 2 * member(&call, 0, b)[i];
    return NULL;
}"""


def compiles(header: str) -> str:
    """What the compiler says of a loop for an XLA with this header; nothing is good."""
    parts = DOUBLE, *LATE
    source = callable_program(Interface.of(header), np.float64, 1, {}, parts)
    flags = ["-std=gnu11", "-Wall", "-Werror", "-fsyntax-only", "-x", "c", "-"]
    asked = [str(CC), *flags]
    done = subprocess.run(asked, input=source, text=True, capture_output=True)
    return done.stderr


def test_there_are_fixtures_of_five_versions():
    versions = [Interface.of(path.read_text()).version for path in HEADERS]
    assert versions == [(0, minor) for minor in (1, 2, 3, 4, 5)]


@needs_compiler
@pytest.mark.parametrize("path", HEADERS, ids=lambda path: path.stem)
def test_every_version_compiles(path):
    assert compiles(path.read_text()) == ""


@needs_compiler
@pytest.mark.parametrize("path", HEADERS, ids=lambda path: path.stem)
def test_names_that_nobody_knows_yet_compile(path):
    """The next release may call its extensions by a third name."""
    text = path.read_text()
    for known in ("XLA_FFI_Extension_Base", "XLA_FFI_InternalExtension"):
        text = text.replace(known, "XLA_FFI_SomethingElse")
    assert "SomethingElse" in text
    assert compiles(text) == ""


@needs_compiler
@pytest.mark.parametrize(
    ("structure", "field"),
    [
        ("XLA_FFI_Buffer", "void* data;"),
        ("XLA_FFI_Args", "int64_t size;"),
        ("XLA_FFI_CallFrame", "XLA_FFI_Args args;"),
        ("XLA_FFI_Metadata", "XLA_FFI_Api_Version api_version;"),
    ],
)
def test_another_layout_does_not_compile(structure, field):
    """Then XLA's own programs serve; memory is never read by a wrong layout."""
    text = HEADERS[-1].read_text()
    head, tail = text.split(f"struct {structure} {{", 1)
    assert field in tail
    moved = tail.replace(field, f"int64_t added; {field}", 1)
    told = compiles(f"{head}struct {structure} {{{moved}")
    assert "static assertion failed" in told


def test_another_major_version_is_refused_in_a_sentence():
    text = HEADERS[-1].read_text().replace("API_MAJOR 0", "API_MAJOR 1")
    with pytest.raises(NoCompilerError, match=r"has version 1\.5, and compiled"):
        Interface.of(text)
    with pytest.raises(NoCompilerError, match=r"has version None\.None"):
        Interface.of("")


@needs_compiler
def test_the_installed_release_calls_a_function():
    """In a batch once for all members, and of members that share a buffer."""
    check_usable()
    call = XlaCall(np.float64, 1, {}, (DOUBLE,))
    twice = lambda x: call((x.shape,), x)[0]
    x = jnp.arange(6.0).reshape(2, 3)
    np.testing.assert_array_equal(jax.jit(twice)(x[0]), 2.0 * x[0])
    np.testing.assert_array_equal(jax.jit(jax.vmap(twice))(x), 2.0 * x)
