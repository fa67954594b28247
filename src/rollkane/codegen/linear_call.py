"""A function that is linear in some arguments, with its transpose, as one equation.

Like ``jax.custom_derivatives.linear_call``, which has no batching rule.
"""

import itertools
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple, TypeAlias, cast

import jax
import numpy as np
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
        backward: ``backward(residuals, cotangents)``, its transpose; a cotangent that
            nothing asks for is an array of NumPy's, of zeros (:func:`is_asked_for`).
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

    def transpose(
        self, asked: Sequence[bool], outputs: Sequence[ShapedArray]
    ) -> "Linear":
        """The transpose, which is pulled one at a time, for some cotangents alone.

        Args:
            asked: Which they are.
            outputs: Shapes and types of all.
        """

        def back(residuals: Sequence[Array], given: Sequence[Array]) -> list[Array]:
            left = iter(given)
            none: Callable[[ShapedArray], Any] = lambda x: np.zeros(x.shape, x.dtype)
            pairs = zip(asked, outputs, strict=True)
            filled: list[Any] = [
                next(left) if is_asked else none(x) for is_asked, x in pairs
            ]
            return self.backward(residuals, filled)

        def forth(residuals: Sequence[Array], operands: Sequence[Array]) -> list[Array]:
            return list(itertools.compress(self.forward(residuals, operands), asked))

        again = None if self.again is None else self.again.transpose(asked, outputs)
        return Linear(back, forth, again=again)

    def mapped(self, axes: list[int | None]) -> "Linear":
        """For residuals with these axes, and operands with one in front."""

        def over(function: Along) -> Along:
            def run(residuals: Sequence[Array], given: Sequence[Array]) -> list[Array]:
                # what nothing asks for is known to be so for each
                none = [None if is_asked_for(x) else x[0, ...] for x in given]
                asked = [x for x in given if is_asked_for(x)]

                def one(r: list[Array], x: list[Array]) -> list[Array]:
                    left = iter(x)
                    filled: Any = [next(left) if n is None else n for n in none]
                    return list(function(r, filled))

                return jax.vmap(one, in_axes=(axes, 0))(list(residuals), asked)

            return run

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


def is_asked_for(cotangent: Any) -> bool:
    """Whether a cotangent of ``Linear.backward`` may be other than zero."""
    return not isinstance(cotangent, np.ndarray)


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
    asked = [not isinstance(c, ad.Zero) for c in cotangents]
    given = list(itertools.compress(cotangents, asked))
    sizes = shapes_of(a.aval for a in operands)
    back = linear.transpose(asked, outputs)
    return [None] * count + linear_call(back, residuals, given, sizes)


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
