"""A function in C as a part of XLA's programs, by its foreign function interface."""

import functools
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array

from .compiler import compiled, program_of


class XlaCall:
    """A compiled function that XLA calls, in a batch once for all members."""

    def __init__(
        self,
        dtype: Any,
        lanes: int,
        head: dict[str, int],
        parts: tuple[str, ...],
    ):
        """Compile it, and make it known to XLA.

        Args:
            dtype: Of all numbers.
            lanes: How many a row holds.
            head: Names of whole numbers that the parts know.
            parts: Files and texts behind ``xla_call.h``; ``called_by_xla`` is in them.

        Raises:
            NoCompilerError: no C compiler.
        """
        self._dtype = dtype
        self._name = _registered(dtype, lanes, tuple(head.items()), parts)

    def __call__(self, shapes: tuple, *arrays: Array) -> list[Array]:
        """Results of these shapes."""
        results = [jax.ShapeDtypeStruct(shape, self._dtype) for shape in shapes]
        call = jax.ffi.ffi_call(self._name, results, vmap_method="expand_dims")
        return list(call(*arrays))


def in_one(arrays: list[Array], dtype: Any) -> Array:
    """All numbers of some arrays, in order."""
    return jnp.concatenate([jnp.zeros(0, dtype), *map(jnp.ravel, arrays)])


@functools.cache
def _interface() -> str:
    """XLA's own header, of the release that is installed."""
    return Path(jax.ffi.include_dir(), "xla", "ffi", "api", "c_api.h").read_text()


@functools.cache
def _registered(dtype: Any, lanes: int, head: tuple, parts: tuple[str, ...]) -> str:
    """The name under which XLA knows it."""
    known = _interface(), "rows.h", "xla_call.h"
    library = compiled(program_of(dtype, lanes, dict(head), (*known, *parts)))
    name = f"rollkane_{Path(library._name).stem}"
    capsule = jax.ffi.pycapsule(library.called_by_xla)
    jax.ffi.register_ffi_target(name, capsule, platform="cpu")
    return name
