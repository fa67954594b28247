"""Which loop takes a run: the one in C where it can, else diffrax's; and why."""

import os
from collections.abc import Callable, Hashable
from typing import Any, NamedTuple, cast

import diffrax as dfx
import jax

from ..codegen import NoCompilerError, ProgramsAwaited, platform, prepare_calls
from ..codegen.compiler import compiler_command
from ..codegen.scalar_program import NotElementwiseError
from ..codegen.tableau import PLAIN, is_plain
from ..validation.checks import FieldError
from .integrate import warn_without_compiler

METHODS = ("auto", "native", "diffrax")
_CHOSEN = 'method="diffrax" was chosen'
# What finds a compiler and a place for its work.
_MACHINE = (
    *("CC", "ROLLKANE_CFLAGS", "ROLLKANE_CACHE"),
    *("PATH", "HOME", "XDG_CACHE_HOME", "TMPDIR"),
)
# Why the loop in C did not take runs of a form, and why none on this machine: found by
# tracing and by asking the compiler, which is not done again.
_refusals: dict[Hashable, str] = {}
_unusable: dict[Hashable, str] = {}


class Taken(NamedTuple):
    """A run, and how it was made.

    Attributes:
        outcome: What the run gave.
        method: ``"native"`` or ``"diffrax"``.
        why: Why it is not the loop in C, in a sentence; empty where it is.
    """

    outcome: Any
    method: str
    why: str


class NotNativeError(FieldError):
    """The loop in C cannot do what is asked of it."""

    def __init__(self, problem: str):
        """Say why."""
        remedy = 'use method="diffrax", or "auto"'
        super().__init__("simulate.method", "native", problem, remedy)


def check_method(method: Any) -> None:
    """Refuse what is no method.

    Raises:
        FieldError: another word.
    """
    if method not in METHODS:
        problem, remedy = "is not known", f"use one of {METHODS}"
        raise FieldError("simulate.method", method, problem, remedy)


def may_go_natively(method: str) -> bool:
    """Whether runs may be made by the loop in C, as far as the machine tells."""
    if method == "diffrax" or platform() is None:
        return False
    try:
        compiler_command()
    except NoCompilerError:
        return False
    return True


def without_native_modes() -> str | None:
    """Why the loop in C cannot make a run with modes; None: it may."""
    if platform() == "cuda":
        return "runs with modes go natively on processors alone, not on a GPU"
    return without_native(None, {})


def without_native(
    solver: dfx.AbstractSolver[Any] | None, given: dict[str, bool]
) -> str | None:
    """Why the loop in C cannot make a run, as far as its options tell; None: it may.

    Args:
        solver: Of the user's choice.
        given: Whether arguments are given that only diffrax's loop has, by name.
    """
    for name, is_given in given.items():
        if is_given:
            return f"{name} goes by diffrax's loop"
    if solver is not None and not is_plain(solver):
        known = ", ".join(kind.__name__ for kind in PLAIN)
        return f"{type(solver).__name__} is none of {known}"
    if platform() is None:
        return f"it runs on no {jax.default_backend()} of this kind, JAX's default here"
    return None


def run_by(
    method: str,
    refusal: str | None,
    kind: Hashable,
    model: Any,
    run: Callable[..., Any],
) -> Taken:
    """A run by the method that was asked for.

    Args:
        method: One of ``METHODS``.
        refusal: Why the loop in C cannot make it; None: it may.
        kind: Of the motion: what tells one function for the rates from another.
        model: What it depends on.
        run: ``run(native=...)``.

    Returns:
        The run; by diffrax's loop, with a warning once, where no compiler serves.

    Raises:
        NotNativeError: the loop in C was asked for, and cannot.
    """
    if method == "diffrax":
        return Taken(run(native=False), method, _CHOSEN)
    if refusal is None and _refusals:
        refusal = _refusals.get((kind, _form_of(model)))
    unusable = None
    if refusal is None and _unusable:
        unusable = _unusable.get(_machine())
    if refusal is None and unusable is None:
        prepare_calls()
        try:
            with ProgramsAwaited():
                return Taken(run(native=True), "native", "")
        except NotElementwiseError as error:
            refusal = f"the rates are more than arithmetic: {error}"
            _refusals[kind, _form_of(model)] = refusal
        except NoCompilerError as error:
            unusable = _unusable[_machine()] = str(error)
    if unusable is not None:
        warn_without_compiler(unusable)
    elif method == "native":
        raise NotNativeError(f"cannot do this: {refusal}")
    return Taken(run(native=False), "diffrax", unusable or refusal or "")


def _machine() -> Hashable:
    return tuple(map(os.environ.get, _MACHINE))


def _form_of(model: Any) -> Hashable:
    """What a compiled program depends on of a model."""
    leaves, tree = cast("tuple[list[Any], Any]", jax.tree.flatten(model))
    return tree, tuple((jax.numpy.shape(x), jax.numpy.result_type(x)) for x in leaves)
