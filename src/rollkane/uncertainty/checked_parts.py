"""Parts of a scene in which numbers vary, made again so that they are checked again."""

import inspect
from collections.abc import Iterable
from typing import Any, TypeVar

import equinox as eqx

from ..identification import paths

_Model = TypeVar("_Model")


def checked_parts(model: Any, varied: Iterable[paths.Keys]) -> list[paths.Keys]:
    """Where modules are that vary, and that their constructors can make again.

    Those can that have their constructor's arguments as attributes, and come out as
    they were; innermost first.

    Args:
        model: A tree of modules, whose numbers are known.
        varied: Paths of the numbers that vary.
    """
    owners = {keys[:n] for keys in varied for n in range(1, len(keys))}
    return [
        keys
        for keys in sorted(owners, key=lambda keys: (-len(keys), str(keys)))
        if _comes_out_again(paths.found(model, keys))
    ]


def checked(model: _Model, parts: Iterable[paths.Keys]) -> _Model:
    """The model with parts made again: NaN where a constructor refuses a number.

    Args:
        model: With numbers that JAX traces.
        parts: Of :func:`checked_parts`.
    """
    for keys in parts:
        model = paths.replaced(model, keys, _again(paths.found(model, keys)))
    return model


def _again(part: Any) -> Any:
    kind = part.__class__
    wanted = inspect.signature(kind).parameters
    return kind(**{name: getattr(part, name) for name in wanted})


def _comes_out_again(part: Any) -> bool:
    if not isinstance(part, eqx.Module):
        return False
    try:
        return bool(eqx.tree_equal(part, _again(part)))
    except Exception:  # one that is made of something else
        return False
