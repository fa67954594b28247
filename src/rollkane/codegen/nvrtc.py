"""NVIDIA's compiler for its GPUs, from the package that JAX's own brings with it."""

import ctypes
import functools
import hashlib
import sys
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from .cache import UnusableError, read
from .compiler import NoCompilerError

# Contents of the headers that other texts include: all but these names is built in.
_HEADERS = {
    "math.h": "",
    "stdlib.h": "",
    "string.h": "",
    "stdint.h": """
typedef signed char int8_t; typedef unsigned char uint8_t;
typedef short int16_t; typedef unsigned short uint16_t;
typedef int int32_t; typedef unsigned uint32_t;
typedef long long int64_t; typedef unsigned long long uint64_t;
#define INT64_C(x) x##LL
#define INT64_MAX 0x7fffffffffffffffLL
#define INT64_MIN (-INT64_MAX - 1)
#define NAN __int_as_float(0x7fffffff)
#define INFINITY __int_as_float(0x7f800000)
""",
}
# C texts have no marks of where a function runs; products and sums are fused there
_OPTIONS = (
    *("--device-as-default-execution-space", "--std=c++20", "--disable-warnings"),
    "--fmad=false",
)
_NAMES = "libnvrtc.so.13", "libnvrtc.so.12", "libnvrtc.so"


def image_of(text: str, architecture: str) -> bytes:
    """A program for a GPU, kept for the next process.

    Args:
        text: In C as C++ has it, behind the words of ``device.h``.
        architecture: As compilers call it: ``"sm_90"``.

    Raises:
        NoCompilerError: no NVRTC, or it fails on the text.
    """
    version = nvrtc_version()
    told = "\n".join((*_OPTIONS, *_HEADERS.values(), architecture, version, text))
    key = hashlib.sha256(told.encode()).hexdigest()[:32]

    def make(target: Path) -> None:
        target.write_bytes(compiled(text, architecture)[0])

    try:
        return read(key, make)
    except UnusableError:  # no folder to keep it in
        return compiled(text, architecture)[0]


def compiled(text: str, architecture: str, *more: str) -> tuple[bytes, str]:
    """A program for a GPU, and what the compiler says of it.

    Args:
        text: In C as C++ has it, behind the words of ``device.h``.
        architecture: As compilers call it: ``"sm_90"``.
        more: Further options.

    Raises:
        NoCompilerError: no NVRTC, or it fails on the text.
    """
    nvrtc = _library()
    program = ctypes.c_void_p()
    texts, names = (
        (ctypes.c_char_p * len(_HEADERS))(*(x.encode() for x in part))
        for part in (_HEADERS.values(), _HEADERS)
    )
    about = text.encode(), b"rollkane.cu", len(_HEADERS), texts, names
    _check(nvrtc.nvrtcCreateProgram(ctypes.byref(program), *about))
    try:
        words = f"--gpu-architecture={architecture}", *_OPTIONS, *more
        options = (ctypes.c_char_p * len(words))(*(x.encode() for x in words))
        status = nvrtc.nvrtcCompileProgram(program, len(words), options)
        log = _filled(nvrtc, "ProgramLog", program).rstrip(b"\0").decode()
        if status:
            errors = [line for line in log.splitlines() if "error" in line]
            first = (errors or log.splitlines() or [f"status {status}"])[0]
            failed = NoCompilerError(f"the GPU's compiler (NVRTC) failed: {first}")
            failed.add_note(log)
            raise failed
        return _filled(nvrtc, "CUBIN", program), log
    finally:
        nvrtc.nvrtcDestroyProgram(ctypes.byref(program))


@functools.cache
def nvrtc_version() -> str:
    """Of the compiler.

    Raises:
        NoCompilerError: there is none.
    """
    major, minor = ctypes.c_int(), ctypes.c_int()
    _check(_library().nvrtcVersion(ctypes.byref(major), ctypes.byref(minor)))
    return f"{major.value}.{minor.value}"


@functools.cache
def _library() -> ctypes.CDLL:
    for place in (*_in_packages(), *_NAMES):
        try:
            return ctypes.CDLL(str(place))
        except OSError:
            continue
    raise NoCompilerError(
        "NVIDIA's compiler for GPUs (NVRTC) was not found: "
        '`pip install "jax[cuda13]"` brings it; or choose method="diffrax"'
    )


def _in_packages() -> list[Path]:
    """Where pip puts it."""
    if not sys.platform.startswith("linux"):
        return []
    found = find_spec("nvidia")
    folders = [] if found is None else [*(found.submodule_search_locations or [])]
    places = [p for x in folders for p in Path(x).glob("*/lib/libnvrtc.so.*")]
    return sorted(places, reverse=True)  # the newest first


def _filled(nvrtc: ctypes.CDLL, what: str, program: ctypes.c_void_p) -> bytes:
    size = ctypes.c_size_t()
    ask: Callable[[str], Any] = lambda name: getattr(nvrtc, f"nvrtcGet{name}")
    _check(ask(f"{what}Size")(program, ctypes.byref(size)))
    filled = ctypes.create_string_buffer(size.value)
    _check(ask(what)(program, filled))
    return filled.raw


def _check(status: int) -> None:
    if status:
        raise NoCompilerError(f"the GPU's compiler (NVRTC) fails with status {status}")
