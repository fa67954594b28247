"""A function in C as a part of XLA's programs, by its foreign function interface."""

import ctypes
import functools
import re
import threading
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import ShapedArray
from jax.extend.core import Primitive
from jax.interpreters import batching, mlir
from jax.typing import DTypeLike
from jaxtyping import Array

from .compiler import NoCompilerError, Program, program_of
from .run_watch import follow

# XLA's structures that are read: their names here, their fields there and here. What
# the installed header does not know by these names is not compared.
_LAYOUT = {
    "XLA_FFI_Api_Version": (
        "ApiVersion",
        {"major_version": "major_version", "minor_version": "minor_version"},
    ),
    "XLA_FFI_Metadata": ("Metadata", {"api_version": "api_version"}),
    "XLA_FFI_Metadata_Extension": ("MetadataExtension", {"metadata": "metadata"}),
    "XLA_FFI_Buffer": ("XlaBuffer", {"data": "data", "rank": "rank", "dims": "dims"}),
    "XLA_FFI_Args": ("XlaBuffers", {"size": "size", "args": "items"}),
    "XLA_FFI_Rets": ("XlaBuffers", {"size": "size", "rets": "items"}),
    "XLA_FFI_CallFrame": (
        "CallFrame",
        {"extension_start": "extension_start", "args": "args", "rets": "rets"},
    ),
}
_NOTHING = """void *called_by_xla(const CallFrame *frame) {
    static const int axes[] = {0};
    Call call;
    if (!received(frame, axes, 0, &call)) return NULL;
    *wanted(&call, 0, 0) = *member(&call, 0, 0);
    return NULL;
}"""
_MAJOR = 0  # of the interface whose layout xla_call.h declares


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
    ):
        """Begin to compile it, beside what goes on until XLA needs it.

        Args:
            dtype: Of all numbers.
            lanes: How many a row holds.
            head: Names of whole numbers that the parts know.
            parts: Files and texts behind ``xla_call.h``; ``called_by_xla`` is in them.
            others: Those of further texts of the program, each compiled by itself.
            effort: Of the compiler; see :class:`rollkane.codegen.compiler.Program`.

        Raises:
            NoCompilerError: no C compiler.
        """
        self._dtype = dtype
        check_usable()
        known = tuple(head.items())
        self._target = _target(dtype, lanes, known, parts, others, effort)

    def __call__(
        self, shapes: tuple[tuple[int, ...], ...], *arrays: Array
    ) -> list[Array]:
        """Results of these shapes."""
        results = tuple(ShapedArray(shape, self._dtype) for shape in shapes)
        return cast(
            "list[Array]",
            _call_p.bind(*arrays, target=self._target, results=results),
        )


def in_one(arrays: list[Array], dtype: DTypeLike) -> Array:
    """All numbers of some arrays, in order."""
    return jnp.concatenate([jnp.zeros(0, dtype), *map(jnp.ravel, arrays)])


class Interface(NamedTuple):
    """XLA's call interface, of a release.

    Attributes:
        header: Its text.
        version: Major and minor.
    """

    header: str
    version: tuple[int, int]

    @staticmethod
    def of(header: str) -> "Interface":
        """The interface that a header declares.

        Raises:
            NoCompilerError: its version is not told, or has another layout.
        """
        told = [
            re.search(rf"#define\s+XLA_FFI_API_{name}\s+(\d+)", header)
            for name in ("MAJOR", "MINOR")
        ]
        major, minor = (None if found is None else int(found[1]) for found in told)
        if major != _MAJOR or minor is None:
            raise NoCompilerError(
                f"XLA's call interface has version {major}.{minor}, and compiled loops "
                f"know version {_MAJOR}: "
                'choose method="diffrax", or install a release of jaxlib that has it'
            )
        return Interface(header, (major, minor))

    @property
    def same_layout(self) -> str:
        """Assertions in C that its structures are those of ``xla_call.h``."""
        pairs: list[tuple[str, str]] = []
        for theirs, (ours, fields) in _LAYOUT.items():
            if not re.search(rf"\bstruct\s+{theirs}\s*\{{", self.header):
                continue
            if ours == "XlaBuffers":  # others follow it in the frame of a call
                pairs.append((f"sizeof({theirs})", f"sizeof({ours})"))
            pairs += [
                (f"offsetof({theirs}, {a})", f"offsetof({ours}, {b})")
                for a, b in fields.items()
            ]
        lines = (f'_Static_assert({a} == {b}, "{a}");' for a, b in pairs)
        return "\n".join(["#include <stddef.h>", *lines])


@functools.cache
def _installed() -> Interface:
    """That of the release of jaxlib that is installed."""
    path = Path(jax.ffi.include_dir(), "xla", "ffi", "api", "c_api.h")
    try:
        return Interface.of(path.read_text())
    except OSError as error:
        raise NoCompilerError(f"XLA's call interface is not there ({error})") from error


@functools.cache
def check_usable() -> None:
    """Compile and register a function that does nothing.

    Raises:
        NoCompilerError: no compiler, or one that cannot do this for XLA.
    """
    _target(np.dtype(np.float64), 1, (), (_NOTHING,), (), "").await_known()


def callable_program(
    interface: Interface,
    dtype: DTypeLike,
    lanes: int,
    head: dict[str, int],
    parts: tuple[str, ...],
) -> str:
    """A program whose ``called_by_xla`` an XLA of this interface can call.

    Args:
        interface: XLA's.
        dtype: Of all numbers.
        lanes: How many a row holds.
        head: Names of whole numbers that the parts know.
        parts: Files and texts behind ``xla_call.h``.
    """
    major, minor = interface.version
    known = head | {"API_MAJOR": major, "API_MINOR": minor}
    before = interface.header, "rows.h", "watch.h", "xla_call.h"
    texts = *before, interface.same_layout, *parts
    return program_of(dtype, lanes, known, texts)


class _Target:
    """A program that XLA will call."""

    def __init__(self, program: Program):
        """Begin to compile it."""
        self.name = f"rollkane_{program.key}"
        self._program = program
        self._known = False
        self._lock = threading.Lock()
        beside = ThreadPoolExecutor(1)
        self._coming: Future[ctypes.CDLL] | None = beside.submit(program.loaded)
        beside.shutdown(wait=False)

    def await_known(self) -> None:
        """Make it known to XLA, when it is compiled.

        Raises:
            NoCompilerError: it cannot be; another call tries once more.
        """
        with self._lock:
            if self._known:
                return
            coming, self._coming = self._coming, None
            library = self._program.loaded() if coming is None else coming.result()
            follow(library)
            capsule = jax.ffi.pycapsule(library.called_by_xla)
            jax.ffi.register_ffi_target(self.name, capsule, platform="cpu")
            self._known = True


@functools.cache
def _target(
    dtype: DTypeLike,
    lanes: int,
    head: tuple[tuple[str, int], ...],
    parts: tuple[str, ...],
    others: tuple[tuple[str, ...], ...],
    effort: str,
) -> _Target:
    """What XLA knows it by."""
    source = callable_program(_installed(), dtype, lanes, dict(head), parts)
    behind = (program_of(dtype, lanes, dict(head), other) for other in others)
    return _Target(Program.of(source, *behind, effort=effort))


# -- jax.ffi.ffi_call, for a target that is waited for where XLA's program is made -----

_call_p = Primitive("rollkane_native")
_call_p.multiple_results = True

_Results = tuple[ShapedArray, ...]


@_call_p.def_impl
def _called(*arrays: Array, target: _Target, results: _Results) -> list[Array]:
    target.await_known()
    shapes = [jax.ShapeDtypeStruct(x.shape, x.dtype) for x in results]
    return list(jax.ffi.ffi_call(target.name, shapes)(*arrays))


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
    target: _Target,
    results: _Results,
) -> tuple[list[Array], list[int]]:
    """An axis in front of all: of one, where something is the same for all members."""
    size = next(x.shape[i] for x, i in zip(arrays, axes, strict=True) if i is not None)
    pairs = zip(arrays, axes, strict=True)
    arrays = [x[None] if i is None else jnp.moveaxis(x, i, 0) for x, i in pairs]
    results = tuple(ShapedArray((size, *x.shape), x.dtype) for x in results)
    many = cast("list[Array]", _call_p.bind(*arrays, target=target, results=results))
    return many, [0] * len(many)


batching.primitive_batchers[_call_p] = _batch
mlir.register_lowering(_call_p, mlir.lower_fun(_called, multiple_results=True))
