"""Where JAX computes, as far as programs are compiled for it here."""

import functools
import sys
from typing import Any, cast

import jax
from jax.extend import backend


def platform() -> str | None:
    """That of JAX's default device: ``"cpu"``, ``"cuda"``, or None for any other."""
    name = jax.default_backend()
    if name == "cpu":
        return name
    return "cuda" if name == "gpu" and _is_cuda() else None


@functools.cache
def _is_cuda() -> bool:
    # AMD's GPUs are "gpu", too
    known: Any = backend
    told = str(known.get_backend().platform_version)
    return sys.platform == "linux" and "cuda" in told.lower()


@functools.cache
def architecture() -> str:
    """Of the GPUs at hand, of several the one that all of them run: ``"sm_90"``."""
    devices = cast("list[Any]", jax.local_devices(backend="cuda"))
    known = [str(x.compute_capability) for x in devices]
    least = min(known, key=lambda x: [int(part) for part in x.split(".")])
    return f"sm_{least.replace('.', '')}"
