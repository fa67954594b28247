"""Derivatives of a solve that cannot be quietly wrong, in both modes.

An adaptive solve is differentiated along the steps that it took: the accepted times are
recorded once and replayed, so the step controller has no derivative at all. (Through
the controller a rounding error of the recomputed forward pass grows to about
1e-16/rtol times 10 to 1000.) Forward mode replays with tangents, reverse mode is its
transpose, replayed with diffrax's checkpointed adjoint.
"""

from collections.abc import Callable

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import ShapedArray
from jax.custom_derivatives import SymbolicZero
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir
from jaxtyping import Array, PyTree

Solve = Callable[..., tuple[PyTree, Array | None]]


def differentiable(solve: Solve, inputs: PyTree, checkpoints: int) -> PyTree:
    """Run a solve so that it can be differentiated in both modes.

    Args:
        solve: ``solve(inputs, replay, adjoint)`` gives its outputs and the accepted
            step times. With ``replay`` None it steps adaptively, recording only if
            ``adjoint`` is not None; else it takes the steps of ``replay``.
        inputs: Tree that the outputs depend on differentiably.
        checkpoints: States kept by reverse mode; with more steps than these, parts
            are recomputed.

    Returns:
        The outputs. Derivatives of integer outputs are zero, and those of outputs
        that are NaN (not reached) are NaN.
    """
    moving, fixed = eqx.partition(inputs, eqx.is_inexact_array)
    leaves, tree = jax.tree.flatten(moving)

    def run(leaves, replay, adjoint):
        moving = jax.tree.unflatten(tree, leaves)
        return solve(eqx.combine(moving, fixed), replay, adjoint)

    @jax.custom_jvp
    def call(*leaves):
        return run(leaves, None, None)[0]

    def call_jvp(primals, tangents):
        outputs, record = run(primals, None, dfx.ForwardMode())
        dynamic, static = eqx.partition(outputs, eqx.is_inexact_array)
        values, shape = jax.tree.flatten(dynamic)
        moves = tuple(not isinstance(t, SymbolicZero) for t in tangents)
        live = [t for t, moved in zip(tangents, moves, strict=True) if moved]
        if live:
            replay = _Replay(run, moves, checkpoints)
            unreached = [jnp.isnan(value) for value in values]
            residuals = [*primals, jax.lax.stop_gradient(record), *unreached]
            values_dot = linear_call(replay.forward, replay.backward, residuals, live)
        else:
            values_dot = [jnp.zeros_like(x) for x in values]
        outputs_dot = jax.tree.unflatten(shape, values_dot)
        return outputs, eqx.combine(outputs_dot, jax.tree.map(_no_tangent, static))

    call.defjvp(call_jvp, symbolic_zeros=True)
    return call(*leaves)


class _Replay:
    """Derivative of a solve along its recorded steps, and its transpose."""

    def __init__(self, run: Callable, moves: tuple[bool, ...], checkpoints: int):
        self.run, self.moves, self.checkpoints = run, moves, checkpoints

    def _prepare(self, residuals, adjoint):
        """Outputs as a function of the inputs that move, those inputs, NaN masks."""
        count = len(self.moves)
        inputs, record, *unreached = residuals[:count], *residuals[count:]

        def outputs_of(varied):
            varied = iter(varied)
            mixed = [
                next(varied) if moved else value
                for value, moved in zip(inputs, self.moves, strict=True)
            ]
            outputs = self.run(mixed, record, adjoint)[0]
            return jax.tree.leaves(eqx.filter(outputs, eqx.is_inexact_array))

        varied = [v for v, moved in zip(inputs, self.moves, strict=True) if moved]
        return outputs_of, varied, unreached

    def forward(self, residuals, tangents) -> list[Array]:
        outputs_of, varied, unreached = self._prepare(residuals, dfx.ForwardMode())
        moved = jax.jvp(outputs_of, (varied,), (list(tangents),))[1]
        return [jnp.where(u, jnp.nan, m) for u, m in zip(unreached, moved, strict=True)]

    def backward(self, residuals, cotangents) -> list[Array]:
        adjoint = dfx.RecursiveCheckpointAdjoint(checkpoints=self.checkpoints)
        outputs_of, varied, unreached = self._prepare(residuals, adjoint)
        # whoever asks for what was not reached gets NaN; who does not, loses nothing
        asked = jnp.zeros((), bool)
        known = []
        for missing, cotangent in zip(unreached, cotangents, strict=True):
            asked |= jnp.any(missing & (cotangent != 0))
            known.append(jnp.where(missing, 0.0, cotangent))
        moved = jax.vjp(outputs_of, varied)[1](known)[0]
        return [jnp.where(asked, jnp.nan, m) for m in moved]


def _no_tangent(x):
    return np.zeros(jnp.shape(x), jax.dtypes.float0)


# -- a function that is linear in some arguments, with its transpose given ------------
# (jax.custom_derivatives.linear_call has no batching rule)

_linear_p = Primitive("rollkane_linear")
_linear_p.multiple_results = True


def linear_call(forward, backward, residuals, operands) -> list[Array]:
    """Call ``forward(residuals, operands)``, linear in the operands.

    ``backward(residuals, cotangents)`` is its transpose.
    """
    return _linear_p.bind(
        *residuals,
        *operands,
        forward=forward,
        backward=backward,
        count=len(residuals),
    )


@_linear_p.def_impl
def _run(*args, forward, backward, count):
    del backward
    return list(forward(args[:count], args[count:]))


@_linear_p.def_abstract_eval
def _shapes(*args, **parameters):
    structs = [jax.ShapeDtypeStruct(a.shape, a.dtype) for a in args]
    outputs = jax.eval_shape(lambda *a: _run(*a, **parameters), *structs)
    return [ShapedArray(o.shape, o.dtype) for o in outputs]


def _jvp(primals, tangents, *, forward, backward, count):
    parameters = {"forward": forward, "backward": backward, "count": count}
    outputs = _linear_p.bind(*primals, **parameters)
    moved = any(not isinstance(t, ad.Zero) for t in tangents[:count])
    tangents = [ad.instantiate_zeros(t) for t in tangents]
    if moved:  # a second derivative: differentiate the replay itself
        return jax.jvp(lambda *a: _run(*a, **parameters), primals, tuple(tangents))
    linear = _linear_p.bind(*primals[:count], *tangents[count:], **parameters)
    return outputs, linear


def _transpose(cotangents, *args, forward, backward, count):
    residuals, operands = args[:count], args[count:]
    shapes = jax.eval_shape(
        forward,
        residuals,
        [jax.ShapeDtypeStruct(a.aval.shape, a.aval.dtype) for a in operands],
    )
    filled = [
        jnp.zeros(s.shape, s.dtype) if isinstance(c, ad.Zero) else c
        for c, s in zip(cotangents, shapes, strict=True)
    ]
    result = _linear_p.bind(
        *residuals, *filled, forward=backward, backward=forward, count=count
    )
    return [None] * count + list(result)


def _batch(args, axes, *, forward, backward, count):
    size = next(a.shape[d] for a, d in zip(args, axes, strict=True) if d is not None)
    operands = [
        batching.bdim_at_front(a, d, size)
        for a, d in zip(args[count:], axes[count:], strict=True)
    ]
    in_axes = (list(axes[:count]), 0)
    outputs = _linear_p.bind(
        *args[:count],
        *operands,
        forward=_mapped(forward, in_axes),
        backward=_mapped(backward, in_axes),
        count=count,
    )
    return outputs, [0] * len(outputs)


def _mapped(function, in_axes):
    mapped = jax.vmap(lambda r, x: list(function(r, x)), in_axes=in_axes)
    return lambda residuals, operands: mapped(list(residuals), list(operands))


ad.primitive_jvps[_linear_p] = _jvp
ad.primitive_transposes[_linear_p] = _transpose
batching.primitive_batchers[_linear_p] = _batch
mlir.register_lowering(_linear_p, mlir.lower_fun(_run, multiple_results=True))
