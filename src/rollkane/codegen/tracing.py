"""How functions are traced: once for many places, and for which target."""

import functools
import gc
import threading
from collections.abc import Callable, Generator
from contextlib import contextmanager
from typing import Any, TypeVar, cast

import equinox as eqx
import jax

_F = TypeVar("_F", bound=Callable[..., Any])


def traced_once(function: _F) -> _F:
    """``jax.jit``, with the function's own type, for a part of many programs.

    JAX traces, differentiates and transposes it once for arguments of some shapes; a
    call of it is then one equation: a vector product a twentieth of the time, its
    transpose a tenth. Where programs are compiled it is what it would be in line.
    """
    return cast(_F, jax.jit(function))


def shared_in_c(function: _F) -> _F:
    """A long part of many programs, of which one in C has one function.

    Args:
        function: Of trees; what of them is no array is hashable.
    """
    shared = eqx.filter_jit(function)

    @functools.wraps(function)
    def call(*arguments: Any, **named: Any) -> Any:
        return (shared if becomes_c() else function)(*arguments, **named)

    return cast(_F, call)


class _Target(threading.local):
    """Of each thread, whether what it traces becomes C, or runs once."""

    def __init__(self):
        self.is_c = False
        self.is_once = False


_target = _Target()


@contextmanager
def becoming_c() -> Generator[None, None, None]:
    """What is traced within becomes a program in C."""
    before, _target.is_c = _target.is_c, True
    try:
        yield
    finally:
        _target.is_c = before


def becomes_c() -> bool:
    """Whether what is traced does."""
    return _target.is_c


@contextmanager
def running_once() -> Generator[None, None, None]:
    """What is traced within runs once for a motion, not at every step.

    It had better compile soon than run soon.
    """
    before, _target.is_once = _target.is_once, True
    try:
        yield
    finally:
        _target.is_once = before


def runs_once() -> bool:
    """Whether what is traced runs once, and not in C."""
    return _target.is_once and not _target.is_c


@contextmanager
def not_collecting() -> Generator[None, None, None]:
    """Within, Python looks for no cycles among what is dropped.

    Tracing makes hundreds of thousands of objects that stay: to look among them takes
    a tenth of its time.
    """
    collects = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collects:
            gc.enable()
