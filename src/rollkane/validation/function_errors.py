"""What is wrong with a user's function, in words."""

from collections.abc import Callable, Iterable, Mapping
from typing import Any, cast

import numpy as np

from .checks import FieldError


class ReturnedShapeError(FieldError):
    """A function whose value has another shape than it must.

    Attributes:
        shape: Of the value; None: it is no array.
    """

    def __init__(self, field: str, function: Any, value: Any, remedy: str):
        """Say what it returned (see the class)."""
        self.shape: tuple[int, ...] | None = getattr(value, "shape", None)
        super().__init__(field, function, f"returns {_form(value)}", remedy)


class MissingEntryError(LookupError):
    """A key that a function asks for, and that what it is given does not have.

    Attributes:
        key: Of the entry.
        known: Keys that there are; None: it was given nothing.
    """

    def __init__(self, key: Any, known: list[Any] | None):
        """Name both (see the class)."""
        self.key, self.known = key, known
        super().__init__(f"asks for {key!r}, and there {_listed(known or [])}")


def called(function: Callable[..., Any], *arguments: Any) -> Any:
    """The value of a function whose last argument may be a mapping, by key.

    Raises:
        MissingEntryError: it asks for a key that this one does not have, or it is None.
    """
    last = arguments[-1] if arguments else None
    try:
        return function(*arguments)
    except TypeError as error:
        if last is None and "NoneType" in str(error):
            raise MissingEntryError("entries", None) from error
        raise
    except KeyError as error:
        if isinstance(last, Mapping):
            entries = cast("Mapping[Any, Any]", last)
            if error.args and error.args[0] not in entries:
                raise MissingEntryError(error.args[0], [*entries]) from error
        raise


def refuse_complex(field: str, function: Any, values: Iterable[Any]) -> None:
    """Refuse a function one of whose values is complex: its imaginary part is lost.

    Args:
        field: Name used in the error.
        function: The user's.
        values: What it returns, or what is known of it.
    """
    kinds = (getattr(x, "dtype", None) for x in values)
    if any(
        kind is not None and np.issubdtype(kind, np.complexfloating) for kind in kinds
    ):
        problem = "returns complex numbers"
        remedy = "let it return real ones: jnp.real of it, if that is meant"
        raise FieldError(field, function, problem, remedy)


def untraceable(
    field: str,
    function: Any,
    error: Exception,
    remedy: str,
    source: str = "parameters",
) -> FieldError:
    """The refusal of a function that raises an error where JAX traces it.

    Args:
        field: Name used in the error.
        function: The user's.
        error: What it raises.
        remedy: What to do, where it is not for want of an entry.
        source: Where entries of its last argument come from.
    """
    if not isinstance(error, MissingEntryError):
        problem = f"cannot be traced by JAX ({error})"
        return FieldError(field, function, problem, remedy)
    if error.known is None:
        problem = f"asks for entries of `{source}`, and there is none"
        return FieldError(field, function, problem, f"give `{source}`")
    known = _listed(error.known)
    problem = f"asks for the entry {error.key!r} of `{source}`, where there {known}"
    remedy = f"give `{source}` that entry, or ask for one that is there"
    return FieldError(field, function, problem, remedy)


def _listed(keys: list[Any]) -> str:
    if len(keys) < 2:
        return f"is {keys[0]!r} alone" if keys else "is nothing"
    return "are " + ", ".join(repr(key) for key in keys)


def _form(value: Any) -> str:
    """What a user's function returned instead of one array, in words."""
    if hasattr(value, "shape"):
        return f"shape {value.shape}"
    kind = type(value).__name__
    if isinstance(value, list | tuple):
        return f"a {kind} of {len(cast('list[Any]', value))} values"
    return f"a {kind}"
