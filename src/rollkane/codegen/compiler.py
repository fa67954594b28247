"""A C compiler, the system's or one from pip: found, and asked."""

import ctypes
import functools
import hashlib
import importlib.util
import os
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from importlib.resources import files
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jax.typing import DTypeLike

from .cache import UnusableError, loaded, private_folder

# sqrt need not set errno, which a loop over lanes could not do in one instruction;
# products and sums are fused where the text says so (fused.py)
_FLAGS = (
    *("-std=gnu11", "-O3", "-fno-math-errno", "-ffp-contract=off"),
    *("-fPIC", "-shared", "-pthread"),
)
# C's names of other numbers than double, and how it calls its functions for them
_REALS = {
    np.dtype(np.float32): ("float", "name##f"),
    np.dtype(np.longdouble): ("long double", "name##l"),
}
# for the processor at hand, by the compilers' different names; else for any
_PROCESSOR = (("-march=native",), ("-mcpu=native",), ())
_PATIENCE = 300.0  # of a compiler that hangs [s]


class NoCompilerError(RuntimeError):
    """There is no C compiler, or it cannot compile for this machine."""


class _Compiler(NamedTuple):
    """A command, and what tells it and this machine's processor from others."""

    command: tuple[str, ...]
    flags: tuple[str, ...]  # the user's, behind all others
    machine: str
    vector: int  # bytes of those that it is fastest with


def _at_hand() -> _Compiler:
    return _compiler(os.environ.get("CC"), os.environ.get("ROLLKANE_CFLAGS", ""))


@functools.cache
def _compiler(chosen: str | None, wanted: str) -> _Compiler:
    try:
        flags = tuple(shlex.split(wanted))
    except ValueError as error:
        raise NoCompilerError(
            f"ROLLKANE_CFLAGS={wanted} is no list of flags ({error}): unset it, or "
            'choose method="diffrax"'
        ) from error
    names = filter(None, (chosen, "cc", "gcc", "clang"))
    found = [(path,) for path in map(shutil.which, names) if path is not None][:1]
    if not found and importlib.util.find_spec("ziglang") is not None:
        found = [(sys.executable, "-m", "ziglang", "cc")]
    if not found:
        raise NoCompilerError(
            "no C compiler was found (CC, cc, gcc, clang, ziglang): install one, or "
            '`pip install "rollkane[compiler]"`, or choose method="diffrax"'
        )
    (words,) = found
    for processor in _PROCESSOR:
        command = (*words, *_FLAGS, *processor)
        asked = (*command, *flags, "-E", "-dM", "-x", "c", os.devnull)
        own = None if len(words) == 1 else private_folder()
        told = _run(asked, places=None if own is None else _places(own, own))
        if told.returncode == 0:
            machine = hashlib.sha256(told.stdout).hexdigest()
            return _Compiler(command, flags, machine, _vector_of(told.stdout))
    remedy = "set ROLLKANE_CFLAGS to others" if flags else "set CC to gcc or clang"
    raise NoCompilerError(
        f"{' '.join(words)} does not know {' '.join((*_FLAGS, *flags))}: {remedy}, "
        'or choose method="diffrax"'
    )


def _vector_of(macros: bytes) -> int:
    """Bytes of vectors, by what a compiler says of itself and of the processor.

    Twice as wide as the processor's they hide what its operations wait for. GCC alone
    keeps the parts of such ones in memory: with AVX2 batches then take 2.1 (a disc) to
    2.6 times (a rattleback) as long.
    """
    has: Callable[[bytes], bool]
    has = lambda name: b"#define " + name + b" " in macros
    halves = has(b"__AVX__") and not has(b"__AVX512F__") and not has(b"__clang__")
    return 32 if halves else 64


def compiler_command() -> tuple[str, ...]:
    """The command that programs are compiled with.

    Raises:
        NoCompilerError: there is none that works.
    """
    compiler = _at_hand()
    return (*compiler.command, *compiler.flags)


def lanes_of(dtype: DTypeLike) -> int:
    """How many numbers a vector holds with which the compiler makes the fastest loops.

    Raises:
        NoCompilerError: there is none that works.
    """
    return _at_hand().vector // np.dtype(dtype).itemsize


def program_of(
    dtype: DTypeLike, lanes: int, head: Mapping[str, int], parts: Iterable[str]
) -> str:
    """A C program for some numbers in a row.

    Args:
        dtype: Of the numbers.
        lanes: How many a row holds.
        head: Names of whole numbers that the parts know.
        parts: Names of files beside this one, or texts.
    """
    dtype = np.dtype(dtype)
    double = dtype == np.float64
    kind, named = ("double", "name") if double else _REALS[dtype]
    lines = [f"typedef {kind} real;", f"#define C(name) {named}"]
    known = {
        "REAL_IS_DOUBLE": int(double),
        "BYTES": lanes * dtype.itemsize,
        "ONE_LANE": int(lanes == 1),
        **head,
    }
    lines += [f"#define {name} {value}" for name, value in known.items()]
    folder = files("rollkane.codegen")
    is_file: Callable[[str], bool]
    is_file = lambda part: part.endswith((".c", ".h"))
    lines += [folder.joinpath(x).read_text() if is_file(x) else x for x in parts]
    return "\n".join(lines)


class Program(NamedTuple):
    """A C program, not yet compiled.

    Attributes:
        command: Of the compiler.
        sources: Its texts, each compiled by itself.
        key: Differs for all that differs in text, compiler, flags and processor.
    """

    command: tuple[str, ...]
    sources: tuple[str, ...]
    key: str

    @staticmethod
    def of(*sources: str, effort: str = "") -> "Program":
        """A program for the compiler at hand.

        Args:
            sources: Texts in C.
            effort: Of the compiler, where it is another than for a loop that runs long.

        Raises:
            NoCompilerError: no C compiler.
        """
        compiler = _at_hand()
        own = (effort,) if effort else ()
        command = (*compiler.command, *own, *compiler.flags)
        told = "\n".join((*command, compiler.machine, *sources))
        return Program(command, sources, hashlib.sha256(told.encode()).hexdigest()[:32])

    def loaded(self) -> ctypes.CDLL:
        """The library, compiled where it is not kept.

        Raises:
            NoCompilerError: a compiler that fails on it, or no place for its work.
        """
        make = functools.partial(_compile, self.command, self.sources)
        try:
            return loaded(self.key, make)
        except UnusableError as error:
            if isinstance(error.__cause__, _FailedError):
                raise NoCompilerError(str(error.__cause__)) from error
            raise NoCompilerError(
                "no folder serves for compiled loops, neither the cache folder nor a "
                f"private one for temporary files ({error}): set ROLLKANE_CACHE to a "
                'folder that only you can write, or choose method="diffrax"'
            ) from error


class _FailedError(OSError):
    """The compiler failed: on the text, or for lack of space in this folder."""


def _compile(compiler: tuple[str, ...], sources: tuple[str, ...], target: Path) -> None:
    """Compile to a file, with the compiler's own temporary files beside it."""
    if len(sources) == 1:
        _ask((*compiler, "-x", "c", "-", "-o", str(target), "-lm"), sources[0], target)
        return
    alone = tuple(word for word in compiler if word != "-shared")
    parts = [target.with_name(f"part{i}.o") for i in range(len(sources))]

    def translate(source: str, part: Path) -> None:
        _ask((*alone, "-c", "-x", "c", "-", "-o", str(part)), source, target)

    with ThreadPoolExecutor(len(sources)) as pool:
        list(pool.map(translate, sources, parts))
    _ask((*compiler, *map(str, parts), "-o", str(target), "-lm"), "", target)


def _ask(command: tuple[str, ...], source: str, target: Path) -> None:
    done = _run(command, source, _places(target.parent, target.parent.parent))
    if done.returncode == 0:
        return
    told = done.stderr.decode(errors="replace").strip()
    lines = [x.strip() for x in told.splitlines()] or [f"exit status {done.returncode}"]
    first = next((x for x in lines if "error" in x), lines[0])
    failed = _FailedError(f"the C compiler failed ({command[0]}): {first}")
    failed.add_note(told)
    raise failed


def _places(own: Path, kept: Path) -> dict[str, str]:
    """Where a compiler has its files, and Zig what it makes of the C library."""
    return {
        "TMPDIR": str(own),
        "ZIG_LOCAL_CACHE_DIR": str(own),
        "ZIG_GLOBAL_CACHE_DIR": str(kept / "zig"),
    }


def _run(
    command: tuple[str, ...], text: str = "", places: dict[str, str] | None = None
) -> subprocess.CompletedProcess[bytes]:
    """Ask a compiler, and wait for its answer."""
    environment = None if places is None else os.environ | places
    try:
        return subprocess.run(
            command,
            input=text.encode(),
            capture_output=True,
            timeout=_PATIENCE,
            check=False,
            env=environment,
        )
    except subprocess.TimeoutExpired as error:
        problem = f"did not end within {_PATIENCE:.0f} s"
        cause = error
    except OSError as error:
        problem = f"does not start: {error.strerror}"
        cause = error
    raise NoCompilerError(
        f'the C compiler {command[0]} {problem}; set CC, or choose method="diffrax"'
    ) from cause
