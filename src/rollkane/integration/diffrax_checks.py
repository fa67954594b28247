"""Diffrax without its own checks of traced numbers, which are made before it."""

import threading
from collections.abc import Generator
from contextlib import contextmanager
from typing import Any

import diffrax as dfx

from ..validation.checks import is_traced

_TRACING = threading.RLock()


class _WithoutCallbacks:
    """equinox's internal functions, but that traced checks leave no host callback."""

    def __init__(self, checked: Any):
        self._checked = checked

    def __getattr__(self, name: str) -> Any:
        return getattr(self._checked, name)

    def error_if(self, x: Any, pred: Any, message: str) -> Any:
        """The value; refused at once where it is known to be bad."""
        return x if is_traced(x, pred) else self._checked.error_if(x, pred, message)


@contextmanager
def checked_before(saveat: dfx.SaveAt | None) -> Generator[None, None, None]:
    """Trace diffrax without its checks of times and first step, which are made here.

    It has no way to leave them out, and as callbacks to the host they would keep
    programs out of the persistent compilation cache. A ``SaveAt`` of the user's keeps
    them.
    """
    module: Any = getattr(dfx, "_integrate", None)
    if saveat is not None or not hasattr(module, "eqxi"):
        yield
        return
    with _TRACING:
        checked = module.eqxi
        module.eqxi = _WithoutCallbacks(checked)
        try:
            yield
        finally:
            module.eqxi = checked
