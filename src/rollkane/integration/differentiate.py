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
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array

from ..codegen.linear_call import (
    Linear,
    is_asked_for,
    linear_call,
    shapes_of,
    unchanged,
)
from ..validation.checks import FieldError

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
    # whole numbers, too: what JAX keeps of a derivative must close over none of a trace
    arrays, fixed = cast(_Two, eqx.partition(inputs, eqx.is_array))
    leaves, tree = cast(_Flat, jax.tree.flatten(arrays))

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
            values_dot = linear_call(linear, residuals, live, shapes_of(values))
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
    def linear(self) -> Linear:
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
        return self._checked(
            jnp.where(u[None], jnp.nan, m)
            for u, m in zip(unreached, tangents_out, strict=True)
        )

    def forward(
        self, residuals: Sequence[Array], tangents: Sequence[Array]
    ) -> list[Array]:
        if self.push is not None:
            one = self.forward_many(residuals, [t[None] for t in tangents])
            return [tangents_out[0] for tangents_out in one]
        inputs_of, varied, record, unreached = self.known.read(residuals)
        outputs_of = self._outputs(inputs_of, record, dfx.ForwardMode())
        tangents_out = jax.jvp(outputs_of, (varied,), (list(tangents),))[1]
        return self._checked(
            jnp.where(u, jnp.nan, m)
            for u, m in zip(unreached, tangents_out, strict=True)
        )

    def backward(
        self, residuals: Sequence[Array], cotangents: Sequence[Array]
    ) -> list[Array]:
        inputs_of, varied, record, unreached = self.known.read(residuals)
        # whoever asks for what was not reached gets NaN; who does not, loses nothing
        misses = jnp.zeros((), bool)
        known: list[Array] = []
        for missing, cotangent in zip(unreached, cotangents, strict=True):
            if not is_asked_for(cotangent):
                known.append(cotangent)
                continue
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
        return self._checked(jnp.where(misses, jnp.nan, m) for m in pulled)

    def _checked(self, moved: Iterable[Array]) -> list[Array]:
        """A derivative; one that is differentiated again only goes forwards."""
        moved = list(moved)
        if self.once:
            return moved
        return linear_call(_FORWARDS, (), moved, shapes_of(moved))

    def _outputs(
        self, inputs_of: InputsOf, record: Any, adjoint: dfx.AbstractAdjoint
    ) -> Callable[[list[Array]], list[Array]]:
        def outputs_of(varied: list[Array]) -> list[Array]:
            outputs = self.solve(inputs_of(varied), record, adjoint)[0]
            return jax.tree.leaves(eqx.filter(outputs, eqx.is_inexact_array))

        return outputs_of


def _refuse_backwards() -> None:
    problem = "has no derivative in reverse mode of one along the steps that it took"
    remedy = (
        "take the outer derivative forwards, as jax.jacfwd(jax.grad(f)) or "
        "jax.hessian(f), or give adjoint=diffrax.DirectAdjoint()"
    )
    raise FieldError("simulate", "reverse mode over a derivative", problem, remedy)


_FORWARDS = Linear(unchanged, unchanged, refuse=_refuse_backwards)


def _no_tangent(x: Any) -> np.ndarray:
    return np.zeros(jnp.shape(x), jax.dtypes.float0)


def _fixed(x: Any) -> Array | np.ndarray:
    """The tangent of what does not change."""
    return jnp.zeros_like(x) if eqx.is_inexact_array(x) else _no_tangent(x)
