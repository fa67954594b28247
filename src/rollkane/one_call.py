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
    """A function compiled with little effort, wherever it is not part of a program.

    Inside of ``jit`` it is the function itself. Where ``vmap`` or a derivative is taken
    outside of it, what they make of it is compiled as one program.
    """
    compiled: Any = None
    plain: Any = eqx.filter_jit(function)

    @functools.wraps(function)
    def call(*arguments: Any) -> Any:
        nonlocal compiled
        traced, inside = is_traced(arguments), is_traced(jnp.zeros(()))
        if traced and inside:
            return function(*arguments)
        if traced and not _only_mapped(arguments):
            return plain(*arguments)  # derivatives take no options of the compiler
        # known arguments in the middle of a trace: outside of it all the same
        with jax.ensure_compile_time_eval() if inside else nullcontext():
            if compiled is None:
                options = _known_options()
                fast: Any = eqx.filter_jit  # its stub knows none of the options
                compiled = fast(function, compiler_options=options)
            return compiled(*arguments)

    return call


def _only_mapped(arguments: Any) -> bool:
    """Whether what is traced is a batch of known numbers."""
    for x in jax.tree.leaves(arguments):
        # JAX offers no public name for it; without one, compiling takes longer
        while type(x).__name__ == "BatchTracer":
            x = x.val
        if is_traced(x):
            return False
    return True


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
