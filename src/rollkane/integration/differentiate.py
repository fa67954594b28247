"""Derivatives of a solve that cannot be quietly wrong, in both modes.

An adaptive solve is differentiated along the steps that it took: the accepted times are
recorded once and replayed, so the step controller has no derivative at all. (Through
the controller a rounding error of the recomputed forward pass grows to about
1e-16/rtol times 10 to 1000.) Forward mode replays with tangents, reverse mode is its
transpose; both as the solve's own functions for them do it, or by differentiating the
replay, backwards with diffrax's checkpointed adjoint.
"""

from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple, TypeAlias, cast

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import ShapedArray
from jax.custom_derivatives import SymbolicZero
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir
from jaxtyping import Array

# A tree in two parts, and a tree as its leaves and its structure.
_Two: TypeAlias = tuple[Any, Any]
_Flat: TypeAlias = tuple[list[Array], Any]
Solve: TypeAlias = Callable[..., tuple[Any, Any]]
# Inputs of a solve, of those that vary.
InputsOf: TypeAlias = Callable[[Sequence[Array]], Any]
# ``push(inputs_of, varied, record, tangents, once)``; see :func:`differentiable`.
Push: TypeAlias = Callable[[InputsOf, list[Array], Any, list[Array], bool], list[Array]]
# ``pull(inputs_of, varied, record, cotangents, once)``, likewise.
Pull: TypeAlias = Callable[[InputsOf, list[Array], Any, Any, bool], list[Array]]
# ``forward(residuals, operands)`` -> arrays; linear in the operands.
Along: TypeAlias = Callable[[Sequence[Array], Sequence[Array]], list[Array]]


def differentiable(
    solve: Solve,
    inputs: Any,
    checkpoints: int = 0,
    push: Push | None = None,
    pull: Pull | None = None,
    twice: Callable[..., Any] | None = None,
    unknown: Callable[[Any], Any] | None = None,
) -> Any:
    """Run a solve so that it can be differentiated in both modes.

    Args:
        solve: ``solve(inputs, replay, adjoint)`` gives its outputs and a record of the
            accepted steps. With ``replay`` None it steps adaptively, recording only if
            ``adjoint`` is not None; else it takes the steps of ``replay``.
        inputs: Tree that the outputs depend on differentiably.
        checkpoints: States kept by reverse mode; with more steps than these, parts
            are recomputed.
        push: ``push(inputs_of, varied, record, tangents, once)`` -> those of the
            outputs' floats, in order, along tangents of the list ``varied``, of which
            ``inputs_of`` makes the inputs; all tangents have an axis of one length in
            front. ``once``: they are not differentiated again. None: those of the
            replay.
        pull: ``pull(inputs_of, varied, record, cotangents, once)`` -> cotangents of the
            list ``varied``; None: those of the replay by diffrax's adjoint.
        twice: Called, with any arguments, where a derivative is differentiated, to
            refuse it; None: it can be.
        unknown: ``unknown(outputs)`` -> a tree like them, of truth values: what of them
            has no derivative; None: what is NaN.

    Returns:
        The outputs. Derivatives of integer outputs are zero, and those of outputs
        that are NaN (not reached), or unknown, are NaN.
    """
    moving, fixed = cast(_Two, eqx.partition(inputs, eqx.is_inexact_array))
    leaves, tree = cast(_Flat, jax.tree.flatten(moving))

    def inputs_of(leaves: Sequence[Array]) -> Any:
        return eqx.combine(jax.tree.unflatten(tree, leaves), fixed)

    def changes(
        primals: Sequence[Array], tangents: Sequence[Any], outputs: Any, record: Any
    ) -> Any:
        """Of the outputs, along the recorded steps."""
        dynamic, static = cast(_Two, eqx.partition(outputs, eqx.is_inexact_array))
        values, shape = cast(_Flat, jax.tree.flatten(dynamic))
        moves = tuple(not isinstance(t, SymbolicZero) for t in tangents)
        live = [t for t, moved in zip(tangents, moves, strict=True) if moved]
        if live:
            taken = jax.lax.stop_gradient(record)
            rows, row_shape = cast(_Flat, jax.tree.flatten(taken))
            known = _Known(inputs_of, moves, row_shape, shape)
            linear = _Replay(solve, known, checkpoints, push, pull).linear
            if twice is not None:
                linear = linear._replace(again=Linear(twice, twice))
            masks: Any = jax.tree.map(jnp.isnan, dynamic)
            if unknown is not None:
                of_floats = jax.tree.map(eqx.is_inexact_array, outputs)
                masks = cast(Any, eqx.filter(unknown(outputs), of_floats))
            unreached = jax.tree.leaves(masks)
            residuals = [*primals, *rows, *unreached]
            values_dot = linear_call(linear, residuals, live, _sizes(values))
        else:
            values_dot = [jnp.zeros_like(x) for x in values]
        outputs_dot = jax.tree.unflatten(shape, values_dot)
        return eqx.combine(outputs_dot, jax.tree.map(_no_tangent, static))

    @jax.custom_jvp
    def call(*leaves: Array) -> Any:
        return solve(inputs_of(leaves), None, None)[0]

    @jax.custom_jvp
    def recorded(*leaves: Array) -> tuple[Any, Any]:
        return solve(inputs_of(leaves), None, dfx.ForwardMode())

    def call_jvp(primals: Sequence[Array], tangents: Sequence[Any]) -> tuple[Any, Any]:
        outputs, record = recorded(*primals)
        return outputs, changes(primals, tangents, outputs, record)

    def recorded_jvp(
        primals: Sequence[Array], tangents: Sequence[Any]
    ) -> tuple[Any, Any]:  # of a second derivative: the same steps
        outputs, record = recorded(*primals)
        moved = changes(primals, tangents, outputs, record)
        return (outputs, record), (moved, jax.tree.map(_fixed, record))

    call.defjvp(call_jvp, symbolic_zeros=True)
    recorded.defjvp(recorded_jvp, symbolic_zeros=True)
    return call(*leaves)


class _Known(NamedTuple):
    """How flat residuals and outputs are to be read."""

    inputs_of: InputsOf
    moves: tuple[bool, ...]  # which inputs have a tangent
    record: Any  # structures
    outputs: Any

    def read(
        self, residuals: Sequence[Array]
    ) -> tuple[InputsOf, list[Array], Any, Sequence[Array]]:
        """Inputs as a function of those that move, these, the record, NaN masks."""
        behind = len(self.moves)
        last = behind + self.record.num_leaves
        values, unreached = residuals[:behind], residuals[last:]
        record = jax.tree.unflatten(self.record, residuals[behind:last])

        def inputs_of(varied: Iterable[Array]) -> Any:
            varied = iter(varied)
            mixed = [
                next(varied) if varies else value
                for value, varies in zip(values, self.moves, strict=True)
            ]
            return self.inputs_of(mixed)

        varied = [v for v, varies in zip(values, self.moves, strict=True) if varies]
        return inputs_of, varied, record, unreached


class _Replay(NamedTuple):
    """Derivative of a solve along its recorded steps, and its transpose."""

    solve: Solve
    known: _Known
    checkpoints: int
    push: Push | None
    pull: Pull | None
    once: bool = True

    @property
    def linear(self) -> "Linear":
        """Both, and how they are differentiated."""
        many = None if self.push is None else self.forward_many
        again = self._replace(once=False).linear if self.once else None
        return Linear(self.forward, self.backward, many, again)

    def forward_many(
        self, residuals: Sequence[Array], tangents: Sequence[Array]
    ) -> list[Array]:
        """Along tangents with an axis in front."""
        assert self.push is not None
        inputs_of, varied, record, unreached = self.known.read(residuals)
        tangents_out = self.push(inputs_of, varied, record, list(tangents), self.once)
        return [
            jnp.where(u[None], jnp.nan, m)
            for u, m in zip(unreached, tangents_out, strict=True)
        ]

    def forward(
        self, residuals: Sequence[Array], tangents: Sequence[Array]
    ) -> list[Array]:
        if self.push is not None:
            one = self.forward_many(residuals, [t[None] for t in tangents])
            return [tangents_out[0] for tangents_out in one]
        inputs_of, varied, record, unreached = self.known.read(residuals)
        outputs_of = self._outputs(inputs_of, record, dfx.ForwardMode())
        tangents_out = jax.jvp(outputs_of, (varied,), (list(tangents),))[1]
        return [
            jnp.where(u, jnp.nan, m)
            for u, m in zip(unreached, tangents_out, strict=True)
        ]

    def backward(
        self, residuals: Sequence[Array], cotangents: Sequence[Array]
    ) -> list[Array]:
        inputs_of, varied, record, unreached = self.known.read(residuals)
        # whoever asks for what was not reached gets NaN; who does not, loses nothing
        misses = jnp.zeros((), bool)
        known: list[Array] = []
        for missing, cotangent in zip(unreached, cotangents, strict=True):
            misses |= jnp.any(missing & (cotangent != 0))
            known.append(jnp.where(missing, 0.0, cotangent))
        if self.pull is None:
            adjoint = dfx.RecursiveCheckpointAdjoint(checkpoints=self.checkpoints)
            outputs_of = self._outputs(inputs_of, record, adjoint)
            back = cast("Callable[..., Any]", jax.vjp(outputs_of, varied)[1])
            pulled = back(known)[0]
        else:
            tree = jax.tree.unflatten(self.known.outputs, known)
            pulled = self.pull(inputs_of, varied, record, tree, self.once)
        return [jnp.where(misses, jnp.nan, m) for m in pulled]

    def _outputs(
        self, inputs_of: InputsOf, record: Any, adjoint: dfx.AbstractAdjoint
    ) -> Callable[[list[Array]], list[Array]]:
        def outputs_of(varied: list[Array]) -> list[Array]:
            outputs = self.solve(inputs_of(varied), record, adjoint)[0]
            return jax.tree.leaves(eqx.filter(outputs, eqx.is_inexact_array))

        return outputs_of


def _no_tangent(x: Any) -> np.ndarray:
    return np.zeros(jnp.shape(x), jax.dtypes.float0)


def _fixed(x: Any) -> Array | np.ndarray:
    """The tangent of what does not change."""
    return jnp.zeros_like(x) if eqx.is_inexact_array(x) else _no_tangent(x)


# -- a function that is linear in some arguments, with its transpose given ------------
# (jax.custom_derivatives.linear_call has no batching rule)

_linear_p = Primitive("rollkane_linear")
_linear_p.multiple_results = True
_bind = cast("Callable[..., Any]", _linear_p.bind)


class Linear(NamedTuple):
    """A function that is linear in its operands.

    Attributes:
        forward: ``forward(residuals, operands)`` -> arrays.
        backward: ``backward(residuals, cotangents)``, its transpose.
        many: ``forward`` for operands with an axis in front, if it knows them.
        again: The same functions in a form that can be differentiated by the residuals;
            None: as they are.
    """

    forward: Along
    backward: Along
    many: Along | None = None
    again: "Linear | None" = None

    @property
    def transpose(self) -> "Linear":
        """The transpose, which is pulled one at a time."""
        again = None if self.again is None else self.again.transpose
        return Linear(self.backward, self.forward, again=again)

    def mapped(self, axes: list[int | None]) -> "Linear":
        """For residuals with these axes, and operands with one in front."""

        def over(function: Along) -> Along:
            def one(r: list[Array], x: list[Array]) -> list[Array]:
                return list(function(r, x))

            return lambda residuals, operands: jax.vmap(one, in_axes=(axes, 0))(
                list(residuals), list(operands)
            )

        shared = all(axis is None for axis in axes)
        forward = self.many if self.many and shared else over(self.forward)
        again = None if self.again is None else self.again.mapped(axes)
        return Linear(forward, over(self.backward), again=again)


def linear_call(
    linear: Linear,
    residuals: Sequence[Array],
    operands: Sequence[Array],
    outputs: tuple[ShapedArray, ...],
) -> list[Array]:
    """Call a function that is linear in the operands.

    ``outputs`` are the shapes and dtypes of what it gives, so that nothing is traced to
    find them.
    """
    parameters = {"linear": linear, "count": len(residuals), "outputs": outputs}
    return _bind(*residuals, *operands, **parameters)


def _sizes(arrays: Iterable[Any]) -> tuple[ShapedArray, ...]:
    return tuple(ShapedArray(x.shape, x.dtype) for x in arrays)


@_linear_p.def_impl
def _run(
    *args: Array, linear: Linear, count: int, outputs: tuple[ShapedArray, ...]
) -> list[Array]:
    del outputs
    return list(linear.forward(args[:count], args[count:]))


@_linear_p.def_abstract_eval
def _shapes(
    *args: Any, outputs: tuple[ShapedArray, ...], **parameters: Any
) -> list[ShapedArray]:
    del args, parameters
    return list(outputs)


def _jvp(
    primals: Sequence[Array],
    tangents: Sequence[Any],
    *,
    linear: Linear,
    count: int,
    outputs: tuple[ShapedArray, ...],
) -> tuple[Any, Any]:
    parameters: dict[str, Any] = {"linear": linear, "count": count, "outputs": outputs}
    moved = any(not isinstance(t, ad.Zero) for t in tangents[:count])
    tangents = [ad.instantiate_zeros(t) for t in tangents]
    if moved:  # a second derivative: differentiate the replay itself
        parameters["linear"] = linear.again or linear
        run: Callable[..., list[Array]] = lambda *a: _run(*a, **parameters)
        return jax.jvp(run, primals, tuple(tangents))
    changes = _bind(*primals[:count], *tangents[count:], **parameters)
    return _bind(*primals, **parameters), changes


def _transpose(
    cotangents: Sequence[Any],
    *args: Any,
    linear: Linear,
    count: int,
    outputs: tuple[ShapedArray, ...],
) -> list[Array | None]:
    residuals, operands = args[:count], args[count:]
    filled = [
        jnp.zeros(s.shape, s.dtype) if isinstance(c, ad.Zero) else c
        for c, s in zip(cotangents, outputs, strict=True)
    ]
    sizes = _sizes(a.aval for a in operands)
    result = linear_call(linear.transpose, residuals, filled, sizes)
    return [None] * count + list(result)


def _batch(
    args: Sequence[Array],
    axes: Sequence[int | None],
    *,
    linear: Linear,
    count: int,
    outputs: tuple[ShapedArray, ...],
) -> tuple[list[Array], list[int]]:
    size = next(a.shape[d] for a, d in zip(args, axes, strict=True) if d is not None)
    operands = [
        cast(Any, batching).bdim_at_front(a, d, size)
        for a, d in zip(args[count:], axes[count:], strict=True)
    ]
    batched = tuple(ShapedArray((size, *o.shape), o.dtype) for o in outputs)
    mapped = linear.mapped(list(axes[:count]))
    results = linear_call(mapped, args[:count], operands, batched)
    return results, [0] * len(results)


ad.primitive_jvps[_linear_p] = _jvp
ad.primitive_transposes[_linear_p] = _transpose
batching.primitive_batchers[_linear_p] = _batch
mlir.register_lowering(_linear_p, mlir.lower_fun(_run, multiple_results=True))
