"""What is found out once of each value, for as long as it lives."""

import functools
import weakref
from collections.abc import Callable
from contextlib import suppress
from typing import Any, TypeVar

import jax
import numpy as np
from numpy.typing import NDArray

# Bytes of an array that is not remembered: 512 of them are 32 MB at most.
_MANY = 2**16

_Found = TypeVar("_Found")


def remembered(
    is_fixed: Callable[[Any], bool],
) -> Callable[[Callable[[Any], _Found]], Callable[[Any], _Found]]:
    """A function of one value, asked once of each value that does not change.

    Values are told apart by identity: to compare them would take as long as to ask.

    Args:
        is_fixed: Whether a value, with all that it holds, stays what it is.
    """

    def decorated(function: Callable[[Any], _Found]) -> Callable[[Any], _Found]:
        known: dict[int, tuple[weakref.ref[Any], _Found]] = {}

        @functools.wraps(function)
        def ask(value: Any) -> _Found:
            key = id(value)
            seen = known.get(key)
            if seen is not None and seen[0]() is value:
                return seen[1]
            found = function(value)
            if is_fixed(value):
                with suppress(TypeError):  # to a tuple nothing refers weakly
                    ref = weakref.ref(value, lambda _: known.pop(key, None))
                    known[key] = ref, found
            return found

        return ask

    return decorated


def holds_no_numpy(tree: Any) -> bool:
    """Whether no number of a tree can be changed in its place."""
    return not any(isinstance(x, np.ndarray) for x in jax.tree.leaves(tree))


def of_numbers(
    function: Callable[..., Any], numbers: NDArray[Any], *further: Any
) -> Any:
    """``function(numbers, ...)``, not asked again of numbers that were there before.

    Args:
        function: Of an array that it does not change.
        numbers: The array.
        further: Hashable.
    """
    if numbers.nbytes > _MANY:
        return function(numbers, *further)
    form = numbers.dtype, numbers.shape
    return _of_known(function, numbers.tobytes(), *form, further)


@functools.lru_cache(512)
def _of_known(
    function: Callable[..., Any],
    numbers: bytes,
    dtype: np.dtype[Any],
    shape: tuple[int, ...],
    further: tuple[Any, ...],
) -> Any:
    return function(np.frombuffer(numbers, dtype).reshape(shape), *further)
