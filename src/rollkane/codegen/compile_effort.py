"""Programs that XLA compiles with little effort.

So that the user does not wait longer for the compiler than for the numbers: functions
of a few calls, and what stands around a loop in C.
"""

import functools
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import count
from typing import Any, NamedTuple, TypeAlias, cast

import equinox as eqx
import jax
import jax.extend.core
import jax.numpy as jnp
from jax.core import eval_context

from ..validation.checks import is_traced
from ..validation.remembered import holds_no_numpy, remembered
from .evaluation import evaluated
from .outer_derivatives import OuterDerivatives, with_no_numpy
from .scalar_program import NotElementwiseError
from .tracing import not_collecting

# LLVM's optimization, and XLA's own translation of fused loops (only some releases of
# jax know the name), take three quarters of the time of compiling.
_Effort: TypeAlias = Mapping[str, int | bool]
_LITTLE: _Effort = {
    "xla_backend_optimization_level": 0,
    "xla_cpu_use_fusion_emitters": False,
}
# Without that translation programs over many numbers are as fast (0.5 to 1.4 of the
# time), and compiled in half of the time
_SOME: _Effort = {"xla_cpu_use_fusion_emitters": False}
_unknown: set[str] = set()  # to this release of jax


def for_one_call(
    function: Callable[..., Any], jit: Callable[..., Any] = eqx.filter_jit
) -> Callable[..., Any]:
    """A function compiled with little effort, wherever it is not part of a program.

    Inside of ``jit`` it is the function itself. Where ``vmap`` or a derivative is taken
    outside of it, what they make of it is compiled as one program.

    Args:
        function: Of arguments by their places.
        jit: By which it is compiled on its own; it takes ``compiler_options``.
    """
    return _on_its_own(function, jit, _LITTLE)


def for_few_operations(function: Callable[..., Any]) -> Callable[..., Any]:
    """As :func:`for_one_call`, of some hundred operations on single numbers.

    What it gives of known arguments inside of ``jit`` is found without a compiler.
    """
    return _on_its_own(function, eqx.filter_jit, _LITTLE, short=True)


def for_many_numbers(function: Callable[..., Any]) -> Callable[..., Any]:
    """As :func:`for_one_call`, of arrays so long that a faster program is worth it."""
    return _on_its_own(function, eqx.filter_jit, _SOME)


def _on_its_own(
    function: Callable[..., Any],
    jit: Callable[..., Any],
    effort: _Effort,
    short: bool = False,
) -> Callable[..., Any]:
    """The function, compiled with an effort where it is a program of its own."""
    function = not_collecting()(function)
    compiled = _with_effort(functools.partial(jit, function), effort)
    plain: Any = eqx.filter_jit(function)
    differentiated = _differentiated(function, effort)
    outside: Any = None  # how JAX's state looks where nothing is traced, once known
    long: set[Fixed] = set()  # forms of arguments of which it is not so short

    @functools.wraps(function)
    def call(*arguments: Any) -> Any:
        nonlocal outside
        now = None if _state is None else _state()
        # what is known already is known in a hundredth of the time
        if now is not None and now == outside:
            try:
                return compiled(*arguments)
            except ValueError as error:
                if "compiler_options" not in str(error):
                    raise
                # within a derivative, of nothing that had a tangent then
        traced, inside = is_traced(arguments), is_traced(jnp.zeros(()))
        outside = None if traced or inside else now
        if traced and inside:
            return function(*arguments)
        if traced and not _only_mapped(arguments):
            moves = _is_differentiated(arguments)
            return differentiated(*arguments) if moves else plain(*arguments)
        if not inside:
            return compiled(*arguments)
        # known arguments in the middle of a trace: outside of it all the same, as a
        # whole (jax.ensure_compile_time_eval would also evaluate, one by one, what in
        # the function is known)
        with eval_context():
            if short and (form := parted(arguments)[0]) not in long:
                try:
                    return evaluated(function, *arguments)
                except NotElementwiseError:
                    long.add(form)
            return compiled(*arguments)

    return call


class Fixed(NamedTuple):
    """Values less their arrays: leaves and their types, of an array None and None."""

    tree: Any
    leaves: tuple[tuple[Any, Any], ...]


def parted(values: Any) -> tuple[Fixed, list[Any]]:
    """What of a tree of values is part of a program, hashable, and its arrays."""
    leaves, tree = cast(tuple[list[Any], Any], jax.tree.flatten(values))
    arrays: list[Any] = []
    rest: list[tuple[Any, Any]] = []
    for x in leaves:
        known = bool(eqx.is_array(x))
        arrays += [x] if known else []
        kind = x.__class__
        rest.append((None, None) if known else (kind, x))
    return _one_of_equals(Fixed(tree, tuple(rest))), arrays


@functools.lru_cache(maxsize=256)
def _one_of_equals(fixed: Fixed) -> Fixed:
    """The first of them: to be found equal to itself takes no time."""
    return fixed


def joined(fixed: Fixed, arrays: Sequence[Any]) -> Any:
    """The values of which these are the parts."""
    left = iter(arrays)
    leaves = [next(left) if kind is None else x for kind, x in fixed.leaves]
    return jax.tree.unflatten(fixed.tree, leaves)


class Known:
    """A hashable value, told from another by which it is: see :func:`known`."""

    def __init__(self, value: Any):
        """Hold it."""
        self.value = value


@functools.lru_cache(4096)  # as many as JAX keeps programs
def known(value: Any) -> Known:
    """The one holder of all equal values: a static argument found in no time.

    JAX takes several microseconds a call to compare a scene's structure or a solver.
    """
    return Known(value)


def stays_as_it_is(tree: Any) -> bool:
    """Whether a tree's numbers can be remembered for as long as it lives."""
    # an array's only leaf is itself, held for ever; a tracer would hold its trace
    return isinstance(tree, eqx.Module) and holds_no_numpy(tree) and not is_traced(tree)


@remembered(stays_as_it_is)
def taken_apart(tree: Any) -> tuple[Known, list[Any]]:
    """A tree's structure and its leaves: in place of it arguments of a short call."""
    leaves, structure = cast("tuple[list[Any], Any]", jax.tree.flatten(tree))
    return known(structure), leaves


def around_a_loop(
    function: Callable[..., Any], jit: Callable[..., Any] = eqx.filter_jit
) -> Callable[..., Any]:
    """``jit(function)``, with little effort where it is a program of its own.

    For what does little beside a loop in C; ``jit`` takes ``compiler_options``. Where
    it is first differentiated inside of another program, that traces ``function``
    itself: JAX would trace a jitted one without its derivative first, for nothing.
    """
    function = not_collecting()(function)
    plain = jit(function)
    differentiated = _differentiated(function, _LITTLE)
    quick = with_little_effort(functools.partial(jit, function))

    # of each form, how often it was differentiated inside of another program
    @functools.lru_cache(256)
    def times(form: Any) -> Iterator[int]:
        return count()

    outside: Any = None  # how JAX's state looks where nothing is traced, once known

    def call(*arguments: Any) -> Any:
        nonlocal outside
        now = None if _state is None else _state()
        # what is known already is known in a twentieth of the time
        if now is None or now != outside:
            inside, traced = is_traced(jnp.zeros(())), is_traced(arguments)
            moves = traced and _is_differentiated(arguments)
            if moves and not inside:
                return differentiated(*arguments)
            # a second time JAX remembers what the jitted one was
            if moves and not next(times(_form_of(arguments))):
                return function(*with_no_numpy(arguments))
            if inside or (traced and not _only_mapped(arguments)):
                return plain(*arguments)
            outside = None if traced else now
        try:
            return quick(*arguments)
        except ValueError as error:
            if "compiler_options" not in str(error):
                raise
            outside = None  # within a derivative, of nothing that had a tangent then
            return plain(*arguments)

    return call


# Of what JAX traces now; not in all of its releases.
_state = getattr(jax.extend.core, "get_opaque_trace_state", None)


def with_little_effort(jit: Callable[..., Callable[..., Any]]) -> Callable[..., Any]:
    """``jit(compiler_options=...)``, with those options that this release of jax knows.

    To be called outside of ``jit`` and of derivatives.
    """
    return _with_effort(jit, _LITTLE)


def _differentiated(function: Callable[..., Any], effort: _Effort) -> OuterDerivatives:
    """The function within a derivative outside of ``jit``, its parts with an effort."""
    return OuterDerivatives(function, lambda f: _on_its_own(f, eqx.filter_jit, effort))


def _with_effort(
    jit: Callable[..., Callable[..., Any]], effort: _Effort
) -> Callable[..., Any]:
    compiled: Any = None

    def call(*arguments: Any) -> Any:
        nonlocal compiled
        while True:
            if compiled is None:
                # on a GPU they save little, and slow down what it runs
                some = jax.default_backend() == "cpu"
                known = {k: x for k, x in effort.items() if some and k not in _unknown}
                compiled = jit(compiler_options=known)
            try:
                return compiled(*arguments)
            except RuntimeError as error:
                unknown = [x for x in effort if x not in _unknown and x in str(error)]
                if not unknown:
                    raise
                _unknown.add(unknown[0])
                compiled = None

    return call


# JAX offers no public names for them; without, it takes longer as it did before
_OF_DERIVATIVES = "JVPTracer", "LinearizeTracer"


def _is_differentiated(arguments: Any) -> bool:
    leaves = jax.tree.leaves(arguments)
    return any(type(x).__name__ in _OF_DERIVATIVES for x in leaves)


def _form_of(arguments: Any) -> Any:
    """What JAX compiles anew for."""
    leaves, tree = cast("tuple[list[Any], Any]", jax.tree.flatten(arguments))
    arrays = [eqx.is_array(x) for x in leaves]
    return tree, tuple(
        (x.shape, x.dtype) if is_array else x
        for x, is_array in zip(leaves, arrays, strict=True)
    )


def _only_mapped(arguments: Any) -> bool:
    """Whether what is traced is a batch of known numbers."""
    for x in jax.tree.leaves(arguments):
        # JAX offers no public name for it; without one, compiling takes longer
        while type(x).__name__ == "BatchTracer":
            x = x.val
        if is_traced(x):
            return False
    return True
