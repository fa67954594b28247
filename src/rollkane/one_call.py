"""Functions compiled with little effort, for a few calls.

So that the user does not wait longer for the compiler than for the numbers.
"""

import functools
from collections.abc import Callable
from contextlib import nullcontext
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from .checks import is_traced

# LLVM's optimization, and XLA's own translation of fused loops (only some releases of
# jax know the name), take three quarters of the time of compiling.
_LITTLE_EFFORT = {
    "xla_backend_optimization_level": 0,
    "xla_cpu_use_fusion_emitters": False,
}


def for_one_call(function: Callable) -> Callable:
    """A function compiled with little effort where its arguments are known.

    With traced arguments it is the function itself, part of what is being traced.
    """
    compiled: Any = None

    @functools.wraps(function)
    def call(*arguments: Any) -> Any:
        nonlocal compiled
        if is_traced(arguments):
            return function(*arguments)
        # known arguments in the middle of a trace: outside of it all the same
        inside = is_traced(jnp.zeros(()))
        with jax.ensure_compile_time_eval() if inside else nullcontext():
            if compiled is None:
                options = _known_options()
                fast: Any = eqx.filter_jit  # its stub knows none of the options
                compiled = fast(function, compiler_options=options)
            return compiled(*arguments)

    return call


@functools.cache
def _known_options() -> dict[str, Any]:
    """Those options that this release of jax knows."""
    known = {}
    for name, value in _LITTLE_EFFORT.items():
        try:
            jax.jit(lambda: 0.0, compiler_options={name: value})()
        except RuntimeError:  # no such option
            continue
        known[name] = value
    return known
