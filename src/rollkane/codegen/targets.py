"""Compiled programs as targets of XLA's calls, known to XLA before they are there.

XLA wants to know a handler when it compiles what calls it. A program in C is compiled
beside that: until then a handler of ``late_call.c`` stands for it, and a call waits.
"""

import contextlib
import ctypes
import functools
import threading
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import jax
import numpy as np
from jax.typing import DTypeLike

from .call_interface import callable_program, installed
from .compiler import NoCompilerError, Program, program_of
from .platforms import platform
from .run_watch import follow

_SLOTS = 128  # programs of a process that may be late; others are waited for
_ENTRIES = " ".join(f"ENTRY({i})" for i in range(_SLOTS))
LATE = f"#define SLOTS {_SLOTS}\n#define ENTRIES {_ENTRIES}", "late_call.c"
_Coming = Future[ctypes.CDLL]


@functools.cache
def check_usable() -> None:
    """Compile the handlers of what is late.

    Raises:
        NoCompilerError: no compiler, or one that cannot do this for XLA.
    """
    _late()


@functools.cache
def prepare_calls() -> None:
    """Begin to compile them beside what goes on, which then need not wait; once.

    Where numbers are on a device that nothing is compiled for, nothing is.
    """
    if platform() is None:
        return

    def made() -> None:
        with contextlib.suppress(NoCompilerError, OSError):  # said where it is needed
            _late()

    threading.Thread(target=made, daemon=True).start()


_MAKING = threading.Lock()


def _late() -> "_Late":
    with _MAKING:  # one waits for the other
        return _made()


@functools.cache
def _made() -> "_Late":
    return _Late()


class _Late:
    """Handlers for programs that are not there."""

    def __init__(self):
        source = callable_program(installed(), np.float64, 1, {}, LATE)
        # they wait and hand over: -O1 takes 0.15 s, -O3 0.53
        self._library = Program.of(source, effort="-O1").loaded()
        self._library.entry_of.restype = ctypes.c_void_p
        self._left = iter(range(_SLOTS))

    def slot(self) -> int | None:
        """One that is free, or None."""
        return next(self._left, None)

    def handler(self, slot: int) -> Any:
        """What XLA calls."""
        return ctypes.cast(self._library.entry_of(slot), ctypes.c_void_p)

    def await_program(self, slot: int) -> None:
        """Let calls wait."""
        self._library.settle(slot, None, b"")

    def settle(self, slot: int, coming: _Coming) -> None:
        """Let calls go on: to the program, or to the reason why there is none."""
        error = coming.exception()
        if error is not None:
            self._library.settle(slot, None, str(error).encode() or b"it failed")
            return
        handler = ctypes.cast(coming.result().called_by_xla, ctypes.c_void_p)
        self._library.settle(slot, handler, b"")


class Target:
    """A program that XLA will call."""

    def __init__(
        self,
        program: Program,
        platform: str = "cpu",
        image: Callable[[], bytes] | None = None,
    ):
        """Not yet compiled.

        Args:
            program: What XLA calls.
            platform: XLA's name of where.
            image: Compiles what the program hands on to a GPU; None: to none.
        """
        self.name = f"rollkane_{program.key}"
        self._program, self._platform, self._image = program, platform, image
        self._lock = threading.Lock()
        self._slot: int | None = None
        self._registered = False
        self._coming: _Coming | None = None

    def make_known(self) -> None:
        """Make it known to XLA, and compile it beside what goes on.

        Raises:
            NoCompilerError: it is waited for, and cannot be.
        """
        with self._lock:
            if self._coming is not None and not _failed(self._coming):
                _expected.programs.append(self._coming)
                return
            if not self._registered:
                self._slot = _late().slot()
            if self._slot is not None:
                _late().await_program(self._slot)
            beside = ThreadPoolExecutor(1)
            self._coming = beside.submit(self._loaded)
            beside.shutdown(wait=False)
            if self._slot is None:
                self._register(self._coming.result().called_by_xla)
                return
            settle = functools.partial(_late().settle, self._slot)
            self._coming.add_done_callback(settle)
            self._register(_late().handler(self._slot))
            _expected.programs.append(self._coming)

    def _loaded(self) -> ctypes.CDLL:
        if self._image is None:
            library = self._program.loaded()
            follow(library)
            return library
        with ThreadPoolExecutor(1) as beside:
            coming = beside.submit(self._program.loaded)
            image = self._image()
            library = coming.result()
        library.load_image.restype = ctypes.c_char_p
        why = library.load_image(image)
        if why is not None:
            raise NoCompilerError(why.decode())
        return library

    def _register(self, handler: Any) -> None:
        if not self._registered:
            capsule = jax.ffi.pycapsule(handler)
            jax.ffi.register_ffi_target(self.name, capsule, platform=self._platform)
            self._registered = True


def _failed(coming: _Coming) -> bool:
    return coming.done() and coming.exception() is not None


# Of each thread, what has been made known to XLA and may not be there.
class _Expected(threading.local):
    """Each thread's own."""

    def __init__(self):
        self.programs: list[_Coming] = []


_expected = _Expected()


class ProgramsAwaited:
    """At its end, programs that XLA compiles calls of in the meantime are there.

    Every call enters it, in less than half of the time that a generator takes.

    Raises:
        NoCompilerError: one of them cannot be compiled.
    """

    def __enter__(self) -> None:
        """Begin to note them."""
        self._before = len(_expected.programs)

    def __exit__(self, *_: object) -> None:
        """Wait for them; where XLA's call failed, the reason is there."""
        expected = _expected.programs
        own = expected[self._before :]
        del expected[self._before :]
        for coming in own:
            coming.result()


@functools.cache
def target_of(
    dtype: DTypeLike,
    lanes: int,
    head: tuple[tuple[str, int], ...],
    parts: tuple[str, ...],
    others: tuple[tuple[str, ...], ...],
    effort: str,
) -> Target:
    """What XLA knows a program by; see :class:`rollkane.codegen.ffi_call.XlaCall`."""
    source = callable_program(installed(), dtype, lanes, dict(head), parts)
    behind = (program_of(dtype, lanes, dict(head), other) for other in others)
    return Target(Program.of(source, *behind, effort=effort))
