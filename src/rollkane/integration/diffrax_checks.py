"""What is asked of diffrax before it runs: parts of its kinds, and its own checks."""

import threading
from collections.abc import Generator
from contextlib import contextmanager
from typing import Any

import diffrax as dfx

from ..validation.checks import FieldError, is_traced

# of which kind an argument is, and an example of it
_KINDS: dict[str, tuple[type, str]] = {
    "solver": (dfx.AbstractSolver, "Dopri8"),
    "stepsize_controller": (dfx.AbstractStepSizeController, "PIDController"),
    "adjoint": (dfx.AbstractAdjoint, "RecursiveCheckpointAdjoint"),
    "saveat": (dfx.SaveAt, "SaveAt"),
    "progress_meter": (dfx.AbstractProgressMeter, "TextProgressMeter"),
}
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


def check_kinds(function: str, **given: Any) -> None:
    """Refuse what is none of diffrax's objects: a name, or a class not yet called.

    Args:
        function: Whose arguments they are, for the error.
        given: ``solver``, ``adjoint`` and so on by name; None was left out.

    Raises:
        FieldError: one that is of another kind.
    """
    for name, value in given.items():
        kind, example = _KINDS[name]
        if value is None or isinstance(value, kind):
            continue
        named = value if isinstance(value, str) else getattr(value, "__name__", "")
        meant = getattr(dfx, named, None) if named.isidentifier() else None
        if isinstance(meant, type) and issubclass(meant, kind):
            example = meant.__name__
        raise FieldError(
            f"{function}.{name}",
            value,
            "must be an object of diffrax, not its name or class",
            f"import diffrax and give {name}=diffrax.{example}(...), say",
        )
