"""Waiting for a long computation: its share and the time left, and Ctrl-C.

What is computed is computed in a thread of its own, as no signal reaches Python while a
compiled loop has the thread that would hear it.
"""

import math
import os
import sys
import threading
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import click

INTERRUPTED = 130  # exit code, as a shell says of Ctrl-C
_FIRST = 1.0  # nothing is told of what takes no longer [s]
_BETWEEN = 0.2  # one line and the next [s]
_PATIENCE = 10.0  # with a loop that cannot be ended, or is being compiled [s]
_TWICE = 1.0  # in which a signal that comes again is the same one [s]
_WIDTH = 60


class Waited(NamedTuple):
    """What a computation came to.

    Attributes:
        result: What it gave.
        interrupted: Whether Ctrl-C ended it.
    """

    result: Any
    interrupted: bool


def waited(
    work: Callable[[Any], Any], share: Callable[[Any], float], quiet: bool
) -> Waited:
    """Compute something, and tell how far it is where somebody looks.

    Nothing is told in the first second, nor where standard error is no terminal. At
    Ctrl-C compiled loops end where they are, and what they have reached is the result;
    where they do not within ten seconds, or at another Ctrl-C, the process ends with
    exit code 130.

    Args:
        work: ``work(watch)`` -> the result; ``watch.ends`` says whether it is to end.
        share: ``share(watch)`` -> how much of it is done, 0 to 1 [1], NaN: not known.
        quiet: Whether nothing is told.
    """
    from ..codegen.run_watch import watched_run

    found: list[Any] = []
    failed: list[BaseException] = []
    done = threading.Event()  # an interrupted join takes its thread for ended

    def compute() -> None:
        try:
            found.append(work(watch))
        except BaseException as error:  # raised again, where it can be answered
            failed.append(error)
        finally:
            done.set()

    line = _Line(hidden=quiet or not sys.stderr.isatty())
    with watched_run() as watch:
        threading.Thread(target=compute, daemon=True).start()
        interrupted = False
        try:
            while not done.wait(_BETWEEN):
                line.tell(share(watch))
        except KeyboardInterrupt:
            interrupted = True
            watch.ends = 1
            _await_end(done)
        finally:
            line.clear()
    if failed:
        raise failed[0]
    return Waited(found[0], interrupted)


def _await_end(done: threading.Event) -> None:
    """Wait for a loop that was told to end; not for ever, and not twice."""
    told = time.monotonic()
    while not done.is_set():
        try:
            done.wait(_PATIENCE - (time.monotonic() - told))
        except KeyboardInterrupt:
            if time.monotonic() - told < _TWICE:
                continue
        if not done.is_set():
            text = "stopped: nothing was kept of a run that cannot be ended"
            click.echo(text, err=True)
            sys.stdout.flush()
            os._exit(INTERRUPTED)  # the thread would hold an ordinary exit up


class _Line:
    """One line on standard error, written over and over."""

    def __init__(self, hidden: bool):
        self._hidden, self._shown = hidden, False
        self._began = time.monotonic()
        self._moved: tuple[float, float] | None = None

    def tell(self, share: float) -> None:
        """How much is done, and how long the rest will take at that pace."""
        now = time.monotonic()
        passed = now - self._began
        if self._hidden or passed < _FIRST:
            return
        text = f"compiling or running for {passed:.0f} s"
        if math.isfinite(share) and share > 0:
            if self._moved is None:  # what was compiled before is not its pace
                self._moved = now, share
            begun, first = self._moved
            text = f"{100 * share:3.0f} %"
            if share > first:
                left = (1 - share) * (now - begun) / (share - first)
                text += f", {_spoken(left)} left"
        click.echo(f"\r{text:<{_WIDTH}}", err=True, nl=False)
        self._shown = True

    def clear(self) -> None:
        """Leave nothing of it."""
        if self._shown:
            click.echo(f"\r{'':<{_WIDTH}}\r", err=True, nl=False)


def _spoken(seconds: float) -> str:
    whole = math.ceil(seconds)
    if whole < 120:
        return f"{whole} s"
    return f"{whole // 60} min" if whole < 7200 else f"{whole / 3600:.1f} h"
