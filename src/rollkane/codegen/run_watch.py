"""Memory through which a thread looks at compiled loops that another one waits for.

The loops read it every few steps: who sets ``ends`` gets what they have reached so far,
as if it were their largest number of steps; while ``looks`` is set, a single run writes
the time that it has come to.
"""

import contextlib
import ctypes
from collections.abc import Generator


class RunWatch(ctypes.Structure):
    """``Watch`` of xla_call.h.

    Attributes:
        time: That a single motion has come to [s], NaN before its first step.
        looks: Whether ``time`` is written.
        ends: Whether runs are to end where they are.
    """

    time: float
    looks: int
    ends: int
    _fields_ = (
        ("time", ctypes.c_double),
        ("looks", ctypes.c_int32),
        ("ends", ctypes.c_int32),
    )


_WATCH = RunWatch(float("nan"), 0, 0)


def follow(library: ctypes.CDLL) -> None:
    """Let the loops of a library read the memory, before it is called first."""
    pointer = ctypes.c_void_p.in_dll(library, "rollkane_watch")
    pointer.value = ctypes.addressof(_WATCH)


@contextlib.contextmanager
def watched_run() -> Generator[RunWatch, None, None]:
    """The memory, for one run at a time; clean before and after it."""
    _WATCH.time, _WATCH.looks, _WATCH.ends = float("nan"), 1, 0
    try:
        yield _WATCH
    finally:
        _WATCH.looks = _WATCH.ends = 0
