"""A function in C as a part of XLA's programs, by its foreign function interface."""

import functools
import re
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .compiler import NoCompilerError, compiled, program_of

# XLA's structures that are read: their names here, their fields there and here. What
# the installed header does not know by these names is not compared.
_LAYOUT = {
    "XLA_FFI_Api_Version": (
        "ApiVersion",
        {"major_version": "major_version", "minor_version": "minor_version"},
    ),
    "XLA_FFI_Metadata": ("Metadata", {"api_version": "api_version"}),
    "XLA_FFI_Metadata_Extension": ("MetadataExtension", {"metadata": "metadata"}),
    "XLA_FFI_Buffer": ("XlaBuffer", {"data": "data", "rank": "rank", "dims": "dims"}),
    "XLA_FFI_Args": ("XlaBuffers", {"size": "size", "args": "items"}),
    "XLA_FFI_Rets": ("XlaBuffers", {"size": "size", "rets": "items"}),
    "XLA_FFI_CallFrame": (
        "CallFrame",
        {"extension_start": "extension_start", "args": "args", "rets": "rets"},
    ),
}
_NOTHING = """void *called_by_xla(const CallFrame *frame) {
    static const int axes[] = {0};
    Call call;
    if (!received(frame, axes, 0, &call)) return NULL;
    *wanted(&call, 0, 0) = *member(&call, 0, 0);
    return NULL;
}"""
_MAJOR = 0  # of the interface whose layout xla_call.h declares


class XlaCall:
    """A compiled function that XLA calls, in a batch once for all members."""

    def __init__(
        self,
        dtype: Any,
        lanes: int,
        head: dict[str, int],
        parts: tuple[str, ...],
        others: tuple[tuple[str, ...], ...] = (),
        effort: str = "",
    ):
        """Compile it, and make it known to XLA.

        Args:
            dtype: Of all numbers.
            lanes: How many a row holds.
            head: Names of whole numbers that the parts know.
            parts: Files and texts behind ``xla_call.h``; ``called_by_xla`` is in them.
            others: Those of further texts of the program, each compiled by itself.
            effort: See :func:`rollkane.native.compiler.compiled`.

        Raises:
            NoCompilerError: no C compiler.
        """
        self._dtype = dtype
        known = tuple(head.items())
        self._name = _registered(dtype, lanes, known, parts, others, effort)

    def __call__(self, shapes: tuple, *arrays: Array) -> list[Array]:
        """Results of these shapes."""
        results = [jax.ShapeDtypeStruct(shape, self._dtype) for shape in shapes]
        call = jax.ffi.ffi_call(self._name, results, vmap_method="expand_dims")
        return list(call(*arrays))


def in_one(arrays: list[Array], dtype: Any) -> Array:
    """All numbers of some arrays, in order."""
    return jnp.concatenate([jnp.zeros(0, dtype), *map(jnp.ravel, arrays)])


class Interface(NamedTuple):
    """XLA's call interface, of a release.

    Attributes:
        header: Its text.
        version: Major and minor.
    """

    header: str
    version: tuple[int, int]

    @staticmethod
    def of(header: str) -> "Interface":
        """The interface that a header declares.

        Raises:
            NoCompilerError: its version is not told, or has another layout.
        """
        told = [
            re.search(rf"#define\s+XLA_FFI_API_{name}\s+(\d+)", header)
            for name in ("MAJOR", "MINOR")
        ]
        major, minor = (None if found is None else int(found[1]) for found in told)
        if major != _MAJOR or minor is None:
            raise NoCompilerError(
                f"XLA's call interface has version {major}.{minor}, and compiled loops "
                f"know version {_MAJOR}: "
                'choose method="diffrax", or install a release of jaxlib that has it'
            )
        return Interface(header, (major, minor))

    @property
    def same_layout(self) -> str:
        """Assertions in C that its structures are those of ``xla_call.h``."""
        pairs = []
        for theirs, (ours, fields) in _LAYOUT.items():
            if not re.search(rf"\bstruct\s+{theirs}\s*\{{", self.header):
                continue
            if ours == "XlaBuffers":  # others follow it in the frame of a call
                pairs.append((f"sizeof({theirs})", f"sizeof({ours})"))
            pairs += [
                (f"offsetof({theirs}, {a})", f"offsetof({ours}, {b})")
                for a, b in fields.items()
            ]
        lines = (f'_Static_assert({a} == {b}, "{a}");' for a, b in pairs)
        return "\n".join(["#include <stddef.h>", *lines])


@functools.cache
def _installed() -> Interface:
    """That of the release of jaxlib that is installed."""
    path = Path(jax.ffi.include_dir(), "xla", "ffi", "api", "c_api.h")
    try:
        return Interface.of(path.read_text())
    except OSError as error:
        raise NoCompilerError(f"XLA's call interface is not there ({error})") from error


@functools.cache
def check_usable() -> None:
    """Compile and register a function that does nothing.

    Raises:
        NoCompilerError: no compiler, or one that cannot do this for XLA.
    """
    _registered(np.dtype(np.float64), 1, (), (_NOTHING,), (), "")


def callable_program(
    interface: Interface, dtype: Any, lanes: int, head: dict, parts: tuple[str, ...]
) -> str:
    """A program whose ``called_by_xla`` an XLA of this interface can call.

    Args:
        interface: XLA's.
        dtype: Of all numbers.
        lanes: How many a row holds.
        head: Names of whole numbers that the parts know.
        parts: Files and texts behind ``xla_call.h``.
    """
    major, minor = interface.version
    known = head | {"API_MAJOR": major, "API_MINOR": minor}
    before = interface.header, "rows.h", "xla_call.h", interface.same_layout
    return program_of(dtype, lanes, known, (*before, *parts))


@functools.cache
def _registered(
    dtype: Any,
    lanes: int,
    head: tuple,
    parts: tuple[str, ...],
    others: tuple[tuple[str, ...], ...],
    effort: str,
) -> str:
    """The name under which XLA knows it."""
    source = callable_program(_installed(), dtype, lanes, dict(head), parts)
    behind = (program_of(dtype, lanes, dict(head), other) for other in others)
    library, key = compiled(source, *behind, effort=effort)
    name = f"rollkane_{key}"
    capsule = jax.ffi.pycapsule(library.called_by_xla)
    jax.ffi.register_ffi_target(name, capsule, platform="cpu")
    return name
