"""XLA's foreign function interface, of the release that is installed, seen from C."""

import functools
import re
from pathlib import Path
from typing import NamedTuple

import jax
from jax.typing import DTypeLike

from .compiler import NoCompilerError, program_of

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
    "XLA_FFI_Error_Create_Args": ("ErrorAsked", {"message": "message", "errc": "code"}),
    "XLA_FFI_Stream_Get_Args": ("StreamAsked", {"ctx": "context", "stream": "stream"}),
    "XLA_FFI_Api": (
        "Api",
        {"XLA_FFI_Error_Create": "error_create", "XLA_FFI_Stream_Get": "stream_get"},
    ),
    "XLA_FFI_CallFrame": (
        "CallFrame",
        {
            "extension_start": "extension_start",
            "api": "api",
            "ctx": "context",
            "args": "args",
            "rets": "rets",
        },
    ),
}
_MAJOR = 0  # of the interface whose layout xla_call.h declares


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
        pairs: list[tuple[str, str]] = []
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
def installed() -> Interface:
    """That of the release of jaxlib that is installed."""
    path = Path(jax.ffi.include_dir(), "xla", "ffi", "api", "c_api.h")
    try:
        return Interface.of(path.read_text())
    except OSError as error:
        raise NoCompilerError(f"XLA's call interface is not there ({error})") from error


def callable_program(
    interface: Interface,
    dtype: DTypeLike,
    lanes: int,
    head: dict[str, int],
    parts: tuple[str, ...],
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
    before = interface.header, "rows.h", "watch.h", "buffers.h", "xla_call.h"
    texts = *before, interface.same_layout, *parts
    return program_of(dtype, lanes, known, texts)
