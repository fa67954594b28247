"""Where steps may end, told by a whole program: of lanes one after the other.

What looks over all of two surfaces has arrays and loops, which rows of lanes have not.
"""

import math
from collections.abc import Callable, Sequence

import jax
from jaxtyping import Array

from .jaxpr_types import Shaped
from .memory_walk import SMALL
from .right_hand_side import with_known_zeros
from .whole_program import Whole


class StepEnds:
    """The program that is asked at the end of each step, for the loop over lanes.

    Attributes:
        program: Of a time, a state and leaves, to a number above zero where a step may
            end.
    """

    def __init__(
        self,
        function: Callable[..., Array],
        state: Shaped,
        leaves: Sequence[Shaped],
        own: Sequence[bool],
        zeros: Sequence[bytes],
    ):
        """Write it.

        Args:
            function: ``function(t, y, *leaves)`` -> whether a step may end there; it
                closes over nothing that is traced.
            state: Shape and type of y.
            leaves: Shapes and types of the model's leaves for one motion.
            own: Which of them differ from motion to motion.
            zeros: Of each leaf, which numbers are zero for all.

        Raises:
            NotElementwiseError: an operation that is not written in C.
        """

        def told(t: Array, y: Array, *leaves: Array) -> Array:
            known = with_known_zeros(list(leaves), zeros)
            return function(t, y, *known).astype(y.dtype)

        time = jax.ShapeDtypeStruct((), state.dtype)
        like = [jax.ShapeDtypeStruct(x.shape, x.dtype) for x in leaves]
        self.program = Whole.of(told, time, state, *like)
        self._sizes = [
            (math.prod(x.shape), own) for x, own in zip(like, own, strict=True)
        ]

    @property
    def head(self) -> dict[str, int]:
        """Sizes that the loop over lanes has to know."""
        head = self.program.head
        small = sum(math.prod(x) for x in self.program.taken if math.prod(x) <= SMALL)
        return {"ENDS": 1, "WORKSPACE": head["WORKSPACE"], "ENDS_SMALL": small}

    @property
    def parts(self) -> tuple[str, ...]:
        """Files and texts before those of the loop."""
        return (*self.program.parts, self._given())

    def _given(self) -> str:
        """What the program is given, of a time, a state, and numbers of a queue."""
        sources = [("at", 0, 1), ("at", 1, self._state_size())]
        places = {"own": 0, "shared": 0}
        for size, differs in self._sizes:
            name = "own" if differs else "shared"
            sources.append((name, places[name], size))
            places[name] += size
        lines: list[str] = []
        small, large = 0, 1
        for name, first, size in sources:
            if size > SMALL:
                lines.append(f"frame->given[{large}] = {name} + {first};")
                large += 1
            elif size:
                to = f"small + {small}"
                lines.append(f"memcpy({to}, {name} + {first}, {size} * sizeof(real));")
                small += size
        body = "\n".join(lines)
        return (
            "static void given_at_end(Frame *frame, real *small, const real *at,\n"
            "                         const real *shared, const real *own) {\n"
            f"frame->given[0] = small;\n{body}\n}}"
        )

    def _state_size(self) -> int:
        return math.prod(self.program.taken[1])
