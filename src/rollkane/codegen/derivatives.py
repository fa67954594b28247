"""``jax.jvp`` and ``jax.vjp``, in programs that become C without JAX's tracing of them.

There a function is traced once, by itself; its derivative is written by
:mod:`.forward_mode` or :mod:`.reverse_mode`, for a third to a tenth of the time. Where
such a program is run by XLA after all, it is JAX's.
"""

import functools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp
from jax.core import ShapedArray
from jax.extend import core
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir
from jaxtyping import Array

from .called_programs import DERIVED
from .forward_mode import Moves, with_tangents
from .jaxpr_types import ClosedJaxpr
from .new_programs import NewJaxpr, NewProgram
from .reverse_mode import with_cotangents
from .tracing import becomes_c


def jvp(
    function: Callable[..., Any], primals: tuple[Any, ...], tangents: tuple[Any, ...]
) -> tuple[Any, Any]:
    """Value and tangent of a function, as ``jax.jvp`` gives them.

    Args:
        function: Of trees of floats, to a tree of floats.
        primals: Its arguments.
        tangents: Theirs.
    """
    if not becomes_c():
        return jax.jvp(function, primals, tangents)
    part = _Part.of(function, primals)
    derived, moved = with_tangents(part.program, part.moves)
    plain = functools.partial(_by_jvp, part.alone, len(part.consts), moved)
    found = part.bound(derived, jax.tree.leaves(tangents), plain)
    count = part.outs.num_leaves
    values, dots = found[:count], iter(found[count:])
    pairs = zip(values, moved, strict=True)
    changes = [next(dots) if moves else jnp.zeros_like(x) for x, moves in pairs]
    return part.outs.unflatten(values), part.outs.unflatten(changes)


def pulled(
    function: Callable[..., Any], primals: tuple[Any, ...], cotangents: Any
) -> tuple[Any, ...]:
    """``jax.vjp(function, *primals)[1](cotangents)``.

    Args:
        function: Of trees of floats, to a tree of floats.
        primals: Its arguments.
        cotangents: Of what it gives.

    Raises:
        NotElementwiseError: there is no way back, in a program that becomes C.
    """
    if not becomes_c():
        return cast(Any, jax.vjp(function, *primals)[1])(cotangents)
    part = _Part.of(function, primals)
    ends = (True,) * part.outs.num_leaves
    derived = with_cotangents(part.program, part.moves, ends)
    plain = functools.partial(_by_vjp, part.alone, len(part.consts), len(part.moves))
    found = part.bound(derived, jax.tree.leaves(cotangents), plain)
    return cast("tuple[Any, ...]", jax.tree.unflatten(part.form, found))


class _Part(NamedTuple):
    """A function that is differentiated, traced.

    Attributes:
        program: Its own.
        consts: Arrays that it closes over.
        leaves: Of its arguments.
        form: Structure of these.
        outs: Structure of what it gives.
        alone: It, of the arrays that it closes over and of the leaves.
    """

    program: ClosedJaxpr
    consts: list[Array]
    leaves: list[Array]
    form: Any
    outs: Any
    alone: Callable[..., Sequence[Array]]

    @staticmethod
    def of(function: Callable[..., Any], primals: tuple[Any, ...]) -> "_Part":
        """Of a function."""
        program, like = jax.make_jaxpr(function, return_shape=True)(*primals)
        leaves, form = cast("tuple[list[Array], Any]", jax.tree.flatten(primals))
        jaxpr = program.jaxpr
        both = [*jaxpr.constvars, *jaxpr.invars]
        lifted = core.ClosedJaxpr(jaxpr.replace(constvars=[], invars=both), [])
        alone = cast(Any, core.jaxpr_as_fun)(lifted)
        known = cast(ClosedJaxpr, program)
        outs = cast(Any, jax.tree.structure(like))
        return _Part(known, list(program.consts), leaves, form, outs, alone)

    @property
    def moves(self) -> Moves:
        """All of its arguments do."""
        return (True,) * len(self.leaves)

    def bound(
        self, derived: NewProgram, more: list[Array], plain: Callable[..., Any]
    ) -> list[Array]:
        """Results of its derivative: of its arrays, and tangents or cotangents."""
        jaxpr = derived.jaxpr
        both = [*jaxpr.constvars, *jaxpr.invars]
        program = NewProgram(NewJaxpr([], both, jaxpr.outvars, jaxpr.eqns), [])
        arrays = *self.consts, *self.leaves, *more
        bind = cast("Callable[..., list[Array]]", _derived_p.bind)
        return bind(*arrays, program=program, plain=plain)


def _by_jvp(
    function: Callable[..., Any], closed: int, moved: Moves, *arrays: Array
) -> list[Array]:
    consts, rest = arrays[:closed], arrays[closed:]
    primals, tangents = rest[: len(rest) // 2], rest[len(rest) // 2 :]
    own = functools.partial(function, *consts)
    values, changes = jax.jvp(own, primals, tangents)
    return [*values, *(x for x, shown in zip(changes, moved, strict=True) if shown)]


def _by_vjp(
    function: Callable[..., Any], closed: int, count: int, *arrays: Array
) -> list[Array]:
    consts, primals = arrays[:closed], arrays[closed : closed + count]
    own = functools.partial(function, *consts)
    back = cast("Callable[..., Any]", jax.vjp(own, *primals)[1])
    return list(back(list(arrays[closed + count :])))


# -- a derivative as one equation ------------------------------------------------------

_derived_p = Primitive(DERIVED)
_derived_p.multiple_results = True


@_derived_p.def_impl
def _run(*arrays: Array, program: NewProgram, plain: Callable[..., Any]) -> list[Array]:
    del program
    return list(plain(*arrays))


@_derived_p.def_abstract_eval
def _shapes(
    *arrays: Any, program: NewProgram, plain: Callable[..., Any]
) -> list[ShapedArray]:
    del arrays, plain
    return [ShapedArray(x.shape, x.dtype) for x in program.out_avals]


def _batch(
    arrays: Sequence[Array], axes: Sequence[int | None], **parameters: Any
) -> tuple[list[Array], list[int]]:
    many = jax.vmap(functools.partial(_run, **parameters), in_axes=tuple(axes))
    found = many(*arrays)
    return found, [0] * len(found)


def _jvp(
    primals: Sequence[Array], tangents: Sequence[Any], **parameters: Any
) -> tuple[Any, Any]:
    known = tuple(cast(Any, ad.instantiate_zeros)(x) for x in tangents)
    return jax.jvp(functools.partial(_run, **parameters), tuple(primals), known)


ad.primitive_jvps[_derived_p] = _jvp
batching.primitive_batchers[_derived_p] = _batch
mlir.register_lowering(_derived_p, mlir.lower_fun(_run, multiple_results=True))
