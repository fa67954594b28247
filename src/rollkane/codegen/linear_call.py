"""A function that is linear in some arguments, with its transpose, as one equation.

Like ``jax.custom_derivatives.linear_call``, which has no batching rule.
"""

from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple, TypeAlias, cast

import jax
import jax.numpy as jnp
from jax.core import ShapedArray
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir
from jaxtyping import Array

# ``forward(residuals, operands)`` -> arrays; linear in the operands.
Along: TypeAlias = Callable[[Sequence[Array], Sequence[Array]], list[Array]]

LINEAR = "rollkane_linear"
_linear_p = Primitive(LINEAR)
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
        refuse: Raises where the transpose is asked for; None: there is one.
    """

    forward: Along
    backward: Along
    many: Along | None = None
    again: "Linear | None" = None
    refuse: Callable[[], None] | None = None

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
        return Linear(forward, over(self.backward), again=again, refuse=self.refuse)


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


def unchanged(residuals: Sequence[Array], operands: Sequence[Array]) -> list[Array]:
    """The operands: of a call that is there for its transpose."""
    del residuals
    return list(operands)


def shapes_of(arrays: Iterable[Any]) -> tuple[ShapedArray, ...]:
    """Shapes and types of arrays."""
    return tuple(ShapedArray(x.shape, x.dtype) for x in arrays)


@_linear_p.def_impl
def run_linear(
    *args: Array, linear: Linear, count: int, outputs: tuple[ShapedArray, ...]
) -> list[Array]:
    """What a call gives, of its equation's inputs and parameters."""
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
        run: Callable[..., list[Array]] = lambda *a: run_linear(*a, **parameters)
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
    if linear.refuse is not None:  # now: before what is transposed ahead of it
        linear.refuse()
    residuals, operands = args[:count], args[count:]
    filled = [
        jnp.zeros(s.shape, s.dtype) if isinstance(c, ad.Zero) else c
        for c, s in zip(cotangents, outputs, strict=True)
    ]
    sizes = shapes_of(a.aval for a in operands)
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
mlir.register_lowering(_linear_p, mlir.lower_fun(run_linear, multiple_results=True))
