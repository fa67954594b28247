"""What is asked of diffrax before it runs: parts of its kinds, and its own checks."""

import threading
from collections.abc import Generator
from contextlib import contextmanager
from typing import Any, cast, get_origin

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


def _check_fits(field: str, value: Any) -> None:
    """Refuse an object of diffrax's that cannot integrate one vector field here."""
    problem = remedy = ""
    if isinstance(value, dfx.AbstractSolver):
        solver = cast("dfx.AbstractSolver[Any]", value)
        terms = getattr(solver, "term_structure", dfx.AbstractTerm)
        terms = get_origin(terms) or terms
        if not (isinstance(terms, type) and issubclass(dfx.ODETerm, terms)):
            problem = "is for several terms, and a motion has one right-hand side"
            remedy = "use Kvaerno5 (implicit) or Dopri8 (explicit), or leave it out"
    elif isinstance(value, (dfx.BacksolveAdjoint, dfx.ImplicitAdjoint)):
        problem = "works from the last state alone, and a run has outputs besides"
        remedy = "leave it out, or use RecursiveCheckpointAdjoint or DirectAdjoint"
    elif isinstance(value, dfx.SaveAt) and value.dense:
        problem = "asks for an interpolant, which a trajectory does not keep"
        remedy = "give the times at which the motion is wanted, or SaveAt(steps=True)"
    if problem:
        raise FieldError(field, value, problem, remedy)


def check_kinks(kinks: Any, controller: Any) -> None:
    """Refuse a controller of the user's beside kinks, of which it knows nothing.

    Args:
        kinks: Of the scene or the system; None: none.
        controller: The user's; None: none.

    Raises:
        FieldError: there are both.
    """
    if kinks is None or controller is None:
        return
    raise FieldError(
        "simulate.stepsize_controller",
        type(controller).__name__,
        "does not end its steps on kinks, and pulses between may be missed",
        "leave it out, or leave out kinks and give "
        "diffrax.ClipStepSizeController(controller, jump_ts=times)",
    )


def check_kinds(function: str, **given: Any) -> None:
    """Refuse what is none of diffrax's objects, or one that no run here can take.

    A name, or a class not yet called; a solver for several terms, an adjoint that
    integrates back, dense output.

    Args:
        function: Whose arguments they are, for the error.
        given: ``solver``, ``adjoint`` and so on by name; None was left out.

    Raises:
        FieldError: one that is of another kind, or cannot be taken.
    """
    for name, value in given.items():
        kind, example = _KINDS[name]
        if value is None:
            continue
        if isinstance(value, kind):
            _check_fits(f"{function}.{name}", value)
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
