"""Numbers of a model by their path: ``body.surface.semi_axes``, ``loads[1].linear``."""

import dataclasses
import difflib
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, cast

import equinox as eqx
import jax
import numpy as np

from ..validation.checks import FieldError
from ..validation.user_functions import UserFunction

Keys = tuple[str | int, ...]
_PART = re.compile(r"\.?([A-Za-z_][A-Za-z_0-9]*|[0-9]+)|\[([0-9]+(?:\s*,\s*[0-9]+)*)\]")


def keys_of(path: str) -> Keys:
    """Names and indices that a path is made of.

    Raises:
        FieldError: it is not a path.
    """
    remedy = 'write for example "body.mass" or "loads[1].linear"'
    if not isinstance(cast(object, path), str):
        raise FieldError("Free.path", path, "must be text", remedy)
    keys: list[str | int] = []
    position = 0
    while position < len(path):
        part = _PART.match(path, position)
        if part is None:
            break
        name, index = part.group(1), part.group(2)
        if index:  # [1, 2] as [1][2]
            keys += [int(number) for number in index.split(",")]
        else:
            keys.append(int(name) if name.isdigit() else name)
        position = part.end()
    if position < len(path) or not keys:
        raise FieldError("Free.path", path, "is not a path", remedy)
    return tuple(keys)


def child(tree: Any, key: str | int) -> Any:
    """What a model holds by one name or index.

    Raises:
        LookupError: nothing.
    """
    if isinstance(key, int) or isinstance(tree, Mapping):
        try:
            if isinstance(key, int):  # of an array beyond its end, JAX takes the last
                key = range(len(cast(Any, tree)))[key]
            return cast(Any, tree)[key]
        except (TypeError, KeyError, IndexError) as error:
            raise LookupError(key) from error
    names = {field.name for field in _fields(tree)}
    if key not in names:
        raise LookupError(key)
    return getattr(tree, key)


def plain(tree: Any, keys: Keys) -> Keys:
    """The path of parameters that an owner holds, by the name of one of its functions.

    ``supported[0].position.parameters.k`` is ``supported[0].parameters.k``.
    """
    for i, key in enumerate(keys[:-1]):
        try:
            part = child(tree, key)
        except LookupError:
            return keys
        held = isinstance(part, UserFunction) and part.parameters is not None
        if isinstance(part, UserFunction) and keys[i + 1] == "parameters" and not held:
            return (*keys[:i], *keys[i + 1 :])
        tree = part
    return keys


def found(tree: Any, keys: Keys) -> Any:
    """What a model holds at a path."""
    for key in plain(tree, keys):
        tree = child(tree, key)
    return tree


def replaced(tree: Any, keys: Keys, value: Any) -> Any:
    """The model with another value at a path, which may end inside of an array."""
    if not keys:
        return value
    keys = plain(tree, keys)
    owner = found(tree, keys[:-1])
    if isinstance(owner, (jax.Array, np.ndarray)):
        inner = jax.numpy.asarray(owner).at[keys[-1]].set(value)
        return replaced(tree, keys[:-1], inner)
    return eqx.tree_at(lambda t: found(t, keys), tree, value)


def is_floating(value: Any) -> bool:
    """Whether it is an array of floating numbers."""
    known = isinstance(value, (jax.Array, np.ndarray))
    return known and np.issubdtype(cast(Any, value).dtype, np.floating)


def floats(tree: Any, stem: str = "") -> Iterator[str]:
    """Paths of all floating arrays of a model."""
    if isinstance(tree, (jax.Array, np.ndarray)):
        if is_floating(tree) and tree.size:
            yield stem
    elif isinstance(tree, Mapping):
        for name, part in cast(Mapping[str, Any], tree).items():
            yield from floats(part, f"{stem}.{name}" if stem else str(name))
    elif isinstance(tree, (tuple, list)):
        for k, part in enumerate(cast(Sequence[Any], tree)):
            yield from floats(part, f"{stem}[{k}]")
    else:
        for field in _fields(tree):
            if not field.name.startswith("_"):
                part = getattr(tree, field.name)
                yield from floats(part, f"{stem}.{field.name}" if stem else field.name)


def _fields(tree: Any) -> tuple[dataclasses.Field[Any], ...]:
    return dataclasses.fields(tree) if dataclasses.is_dataclass(tree) else ()


def unknown(path: str, known: list[str]) -> FieldError:
    """The error of a path that leads nowhere, with the one that may be meant."""
    near = difflib.get_close_matches(path, known, n=1, cutoff=0.5)
    meant = f"did you mean {near[0]!r}? " if near else ""
    listed = ", ".join(known[:40]) + (", ..." if len(known) > 40 else "")
    problem = "is no number of the scene, the start or the record"
    return FieldError("Free.path", path, problem, f"{meant}these can be free: {listed}")
