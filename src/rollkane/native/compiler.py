"""The system's C compiler: found, asked, and its work kept for the next process."""

import ctypes
import hashlib
import os
import shutil
import subprocess
import tempfile
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

# sqrt need not set errno, which a loop over lanes could not do in one instruction
_FLAGS = ("-std=gnu11", "-O3", "-fno-math-errno", "-fPIC", "-shared")
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
    machine: str


@cache
def _compiler(chosen: str | None) -> _Compiler:
    names = filter(None, (chosen, "cc", "gcc", "clang"))
    found = next(filter(None, map(shutil.which, names)), None)
    if found is None:
        raise NoCompilerError(
            "no C compiler was found (CC, cc, gcc, clang): install one, or choose "
            'method="diffrax"'
        )
    for processor in _PROCESSOR:
        command = (found, *_FLAGS, *processor)
        asked = [*command, "-E", "-dM", "-x", "c", os.devnull]
        told = subprocess.run(
            asked, capture_output=True, timeout=_PATIENCE, check=False
        )
        if told.returncode == 0:
            return _Compiler(command, hashlib.sha256(told.stdout).hexdigest())
    raise NoCompilerError(
        f"{found} does not know {' '.join(_FLAGS)}: set CC to gcc or clang, or choose "
        'method="diffrax"'
    )


def cache_folder() -> Path:
    """Where compiled loops are kept: ``ROLLKANE_CACHE``, or the user's cache folder."""
    chosen = os.environ.get("ROLLKANE_CACHE")
    if chosen:
        return Path(chosen)
    home = os.environ.get("XDG_CACHE_HOME")
    return (Path(home) if home else Path.home() / ".cache") / "rollkane"


def program_of(dtype: Any, lanes: int, head: dict[str, int], parts: Any) -> str:
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
    folder = files("rollkane.native")
    named = lambda part: part.endswith((".c", ".h"))
    lines += [folder.joinpath(x).read_text() if named(x) else x for x in parts]
    return "\n".join(lines)


def compiled(source: str) -> ctypes.CDLL:
    """A C program as a loaded library.

    Args:
        source: C text.

    Raises:
        NoCompilerError: no compiler, or one that fails on it.
    """
    compiler = _compiler(os.environ.get("CC"))
    told = "\n".join((*compiler.command, compiler.machine, source))
    key = hashlib.sha256(told.encode())
    name = f"{key.hexdigest()[:32]}.so"
    told = ""
    for folder in (cache_folder(), Path(tempfile.gettempdir()) / f"rollkane-{_user()}"):
        try:
            folder.mkdir(parents=True, exist_ok=True, mode=0o700)
            target = folder / name
            if not target.exists():
                _compile(compiler.command, source, target)
            return ctypes.CDLL(str(target))
        except OSError as error:  # it cannot be written, or nothing loaded from there
            told = str(error)
    raise NoCompilerError(
        "compiled loops can be kept neither in the cache folder nor in the folder for "
        f"temporary files ({told}): set ROLLKANE_CACHE to a folder of yours, or choose "
        'method="diffrax"'
    )


def _user() -> str:
    return str(os.getuid()) if hasattr(os, "getuid") else "user"


def _compile(compiler: tuple[str, ...], source: str, target: Path) -> None:
    """Compile to a file of its own, which takes the target's place when complete."""
    with tempfile.TemporaryDirectory(dir=target.parent) as folder:
        made = Path(folder) / "lanes.so"
        command = [*compiler, "-x", "c", "-", "-o", str(made), "-lm"]
        done = subprocess.run(
            command,
            input=source.encode(),
            capture_output=True,
            timeout=_PATIENCE,
            check=False,
        )
        if done.returncode:
            told = done.stderr.decode(errors="replace").strip()
            raise NoCompilerError(f"the C compiler failed ({compiler[0]}): {told}")
        made.replace(target)
