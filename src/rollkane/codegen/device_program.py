"""A call's program on a GPU: written, compiled, and known to XLA."""

import functools
import hashlib
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jax.typing import DTypeLike

from .call_interface import callable_program, installed
from .compiler import Program, program_of
from .nvrtc import image_of
from .platforms import architecture
from .targets import Target

_DRIVER = '#define CUDA_DRIVER "libcuda.so.1"'
# Threads that share what is prepared for them: with 64, 128 and 256 of them discs,
# rattlebacks and isolators a second (of a million) are within 15 % of one another
_BLOCK = 128
# Members that are worth sorting, which XLA compiles for 2 s: 10^5 gain nothing, half of
# them being under way at once, of 10^6 there are 24 (rattleback) to 67 % more a second
_WORTH_SORTING = 2**19
_BEGUN = 16  # bytes of what device_runs.c has ahead of a member's stops


class Kernel(NamedTuple):
    """What a GPU runs for a call, and how XLA's buffers are spread on its threads.

    Attributes:
        dtype: Of all numbers.
        head: Names of whole numbers that the parts know.
        parts: Files and texts with the functions ``work`` and, if any, ``before``.
        axes: How many axes each argument has, of one member of a batch.
        results: How many there are.
        result_axes: The first one's.
        spread: An argument, and by how many of its numbers a member has a thread.
        stops: The argument with the ends of steps, for which there is a workspace;
            None: there is none, and no ``before``.
        by_members: Whether the members of a batch have blocks of threads of their own.
        shortest: The argument by whose numbers many motions are sorted, the shortest
            first steps first. Their order is one more argument. None: none are.
    """

    dtype: DTypeLike
    head: tuple[tuple[str, int], ...]
    parts: tuple[str, ...]
    axes: tuple[int, ...]
    results: int
    result_axes: int
    spread: tuple[int, int]
    stops: int | None = None
    by_members: bool = False
    shortest: int | None = None

    @property
    def text(self) -> str:
        """The program, for NVRTC."""
        head = {
            "BLOCK": _BLOCK,
            "SORTED": int(self.shortest is not None),
            **dict(self.head),
            **self._sizes,
        }
        before = "device.h", "rows.h", "buffers.h", "device_call.h"
        return program_of(self.dtype, 1, head, (*before, *self.parts))

    @property
    def launcher(self) -> str:
        """What XLA calls, in C."""
        head = self._sizes | {
            "BLOCK": _BLOCK,
            "GIVEN": len(self.axes),
            "RESULT_AXES": self.result_axes,
            "SPREAD_AT": self.spread[0],
            "SPREAD_BY": self.spread[1],
            "WORKSPACE_AT": -1 if self.stops is None else self.results,
            "BY_MEMBERS": int(self.by_members),
            "HAS_BEFORE": int(self.stops is not None),
        }
        own = hashlib.sha256(self.text.encode()).hexdigest()
        texts = [
            f"/* of {own}: a library of its own */",
            f"#define AXES {', '.join(map(str, self.axes))}",
            _DRIVER,
        ]
        parts = *texts, "device_call.h", "device_launch.c"
        return callable_program(installed(), self.dtype, 1, head, parts)

    def for_members(self, shapes: Sequence[tuple[int, ...]]) -> "Kernel":
        """The one for arguments of these shapes, sorted or not."""
        if self.shortest is None or shapes[self.shortest][-1] < _WORTH_SORTING:
            return self._replace(shortest=None)
        return self._replace(axes=(*self.axes, 1))

    def workspace(self, shapes: Sequence[tuple[int, ...]]) -> int:
        """Numbers of a member's workspace; ``shapes`` are the arguments'."""
        assert self.stops is not None
        size = np.dtype(self.dtype).itemsize
        stops = shapes[self.stops][-1] + 1
        return (_BEGUN + stops * (8 + 2 * size)) // size

    @property
    def _sizes(self) -> dict[str, int]:
        known = dict(self.head)
        return {name: known[name] for name in ("MOST_GIVEN", "MOST_RESULTS")}


@functools.cache
def device_target(kernel: Kernel) -> Target:
    """What XLA knows a kernel by; see :class:`rollkane.codegen.ffi_call.XlaCall`."""
    program = Program.of(kernel.launcher, effort="-O1")
    image = lambda: image_of(kernel.text, architecture())
    return Target(program, "CUDA", image)
