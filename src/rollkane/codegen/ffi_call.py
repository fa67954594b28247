"""A function in C as a part of XLA's programs, by its foreign function interface."""

import functools
from collections.abc import Callable, Sequence
from typing import Any, cast

import jax
import jax.numpy as jnp
from jax.core import ShapedArray
from jax.extend.core import Primitive
from jax.interpreters import batching, mlir
from jax.typing import DTypeLike
from jaxtyping import Array

from .compiler import NoCompilerError
from .device_program import Kernel, device_target
from .nvrtc import nvrtc_version
from .platforms import platform
from .targets import Target, check_usable, target_of


class XlaCall:
    """A compiled function that XLA calls, in a batch once for all members."""

    def __init__(
        self,
        dtype: DTypeLike,
        lanes: int,
        head: dict[str, int],
        parts: tuple[str, ...],
        others: tuple[tuple[str, ...], ...] = (),
        effort: str = "",
        kernel: Callable[[], Kernel] | None = None,
    ):
        """Write it; it is compiled when XLA needs it, beside what goes on.

        Args:
            dtype: Of all numbers.
            lanes: How many a row holds.
            head: Names of whole numbers that the parts know.
            parts: Files and texts behind ``xla_call.h``; ``called_by_xla`` is in them.
            others: Those of further texts of the program, each compiled by itself.
            effort: Of the compiler; see :class:`rollkane.codegen.compiler.Program`.
            kernel: The same for a GPU; None: it runs on processors alone.

        Raises:
            NoCompilerError: no C compiler, or none for the GPU at hand.
        """
        self._dtype = dtype
        check_usable()
        self._kernel = None
        if platform() == "cuda":
            if kernel is None:
                raise NoCompilerError("programs of this kind run on processors alone")
            nvrtc_version()  # there is one
            self._kernel = kernel()
        known = tuple(head.items())
        self._target = target_of(dtype, lanes, known, parts, others, effort)

    def __call__(
        self, shapes: tuple[tuple[int, ...], ...], *arrays: Array
    ) -> list[Array]:
        """Results of these shapes."""
        results = tuple(ShapedArray(shape, self._dtype) for shape in shapes)
        return cast(
            "list[Array]",
            _call_p.bind(
                *arrays, target=self._target, kernel=self._kernel, results=results
            ),
        )


def in_one(arrays: list[Array], dtype: DTypeLike) -> Array:
    """All numbers of some arrays, in order."""
    return jnp.concatenate([jnp.zeros(0, dtype), *map(jnp.ravel, arrays)])


# -- jax.ffi.ffi_call, for targets that are made known where XLA's program is made -----

_call_p = Primitive("rollkane_native")
_call_p.multiple_results = True

_Results = tuple[ShapedArray, ...]


def _called(
    *arrays: Array, target: Target, kernel: Kernel | None, results: _Results
) -> list[Array]:
    del kernel
    target.make_known()
    shapes = [jax.ShapeDtypeStruct(x.shape, x.dtype) for x in results]
    return list(jax.ffi.ffi_call(target.name, shapes)(*arrays))


def _called_on_gpu(
    *arrays: Array, target: Target, kernel: Kernel | None, results: _Results
) -> list[Array]:
    del target
    assert kernel is not None
    kernel = kernel.for_members([x.shape for x in arrays])
    on_gpu = device_target(kernel)
    on_gpu.make_known()
    shapes = [jax.ShapeDtypeStruct(x.shape, x.dtype) for x in results]
    if kernel.stops is not None:
        first = results[0]
        batch = first.shape[: first.ndim - kernel.result_axes]
        numbers = kernel.workspace([x.shape for x in arrays])
        shapes.append(jax.ShapeDtypeStruct((*batch, numbers), first.dtype))
    if kernel.shortest is not None:
        order = jnp.argsort(arrays[kernel.shortest], axis=-1)
        arrays = *arrays, order.astype(jnp.int32)
    return list(jax.ffi.ffi_call(on_gpu.name, shapes)(*arrays))[: len(results)]


@_call_p.def_impl
def _call_alone(*arrays: Array, **parameters: Any) -> list[Array]:
    return _as_program(tuple(parameters.items()))(*arrays)


@functools.cache
def _as_program(parameters: tuple[tuple[str, Any], ...]) -> Callable[..., list[Array]]:
    return jax.jit(functools.partial(_call_p.bind, **dict(parameters)))


@_call_p.def_abstract_eval
def _shapes(
    *arrays: ShapedArray, results: _Results, **parameters: Any
) -> list[ShapedArray]:
    del arrays, parameters
    return list(results)


def _batch(
    arrays: Sequence[Array],
    axes: Sequence[int | None],
    *,
    target: Target,
    kernel: Kernel | None,
    results: _Results,
) -> tuple[list[Array], list[int]]:
    """An axis in front of all: of one, where something is the same for all members."""
    size = next(x.shape[i] for x, i in zip(arrays, axes, strict=True) if i is not None)
    pairs = zip(arrays, axes, strict=True)
    arrays = [x[None] if i is None else jnp.moveaxis(x, i, 0) for x, i in pairs]
    results = tuple(ShapedArray((size, *x.shape), x.dtype) for x in results)
    known: dict[str, Any] = {"target": target, "kernel": kernel, "results": results}
    many = cast("list[Array]", _call_p.bind(*arrays, **known))
    return many, [0] * len(many)


batching.primitive_batchers[_call_p] = _batch
mlir.register_lowering(_call_p, mlir.lower_fun(_called, multiple_results=True))
mlir.register_lowering(
    _call_p, mlir.lower_fun(_called_on_gpu, multiple_results=True), platform="cuda"
)
