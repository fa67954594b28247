"""Batches of runs in modes: plain steps in lanes, the others by the program of one.

What decides where a run in modes changes is one long program (``whole_program``),
which a batch takes member by member. Most steps need none of it. Those are taken in
lanes, by the right-hand side of their mode alone.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .compiler import lanes_of
from .compiler_shares import apart
from .ffi_call import XlaCall
from .jaxpr_types import Shaped
from .memory_walk import SMALL
from .right_hand_side import stages_source
from .runge_kutta_source import of_bearable_length, watched_attempt_source
from .scalar_source import Functions, literal
from .tableau import Weights
from .whole_program import Whole

_BOUNDS = "FAR", "FOLLOWED", "SMALLEST", "SETTLES", "NEARER"


class LaneMode(NamedTuple):
    """A mode whose plain steps lanes take.

    Attributes:
        stage: ``stage(t, y, *leaves)`` -> rates of the first numbers of a state, and
            what is seen: two values that are positive while the mode lasts. Of a slip
            three more numbers follow those of the state in ``y``: its direction.
        end: The same at the end of a step; of a slip its length times the rate of its
            turn [m/s^2] and the normal are seen, too: what it has along that is error.
        moved: How many numbers of a state the mode moves, the first ones.
        slips: Whether the last three of these are a slip.
    """

    stage: Callable[..., tuple[Array, Array]]
    end: Callable[..., tuple[Array, Array]]
    moved: int
    slips: bool

    @property
    def given(self) -> int:
        """How many numbers ``y`` has."""
        return self.moved + 3 * self.slips


class DipTables(NamedTuple):
    """By what a value that is seen at some places of a step may dip below zero between.

    Attributes:
        through_seen: Weights of four values in the cubic through them, at those
            places, shape (m, 4).
        bulge_seen: How a deviation is spread over the step, there, shape (m,).
        through_places: As the first, where the bound is looked at, shape (k, 4).
        bulge_places: As the second, shape (k,).
        safety: On deviations that are seen.
        rounding: Roundings of the largest value that are no dip.
    """

    through_seen: np.ndarray
    bulge_seen: np.ndarray
    through_places: np.ndarray
    bulge_places: np.ndarray
    safety: float
    rounding: float

    @property
    def text(self) -> str:
        """The tables, in C."""
        names = "through_seen", "bulge_seen", "through_places", "bulge_places"
        texts = [_table(name, x) for name, x in zip(names, self[:4], strict=True)]
        numbers = f"{literal(self.safety)})", f"{literal(self.rounding)})"
        texts += [f"#define SAFETY ({numbers[0]}", f"#define ROUNDING ({numbers[1]}"]
        return "\n".join(texts)


class Bounds(NamedTuple):
    """Numbers by which lanes know a step that is plain.

    Attributes:
        far: Values that stay above so many of their own ranges are far from zero.
        followed: A faster slip has its own direction [m/s].
        smallest: Slip of the law of friction [m/s].
        settles: Rate of a slip's turn times a step, most.
        nearer: Of the time until a slip ends, in one step.
        beside: Shares of a step at which its values are seen besides its stages, each
            with the weights of the rates to there.
        dips: Where values may dip below zero.
    """

    far: float
    followed: float
    smallest: float
    settles: float
    nearer: float
    beside: Sequence[tuple[float, np.ndarray]]
    dips: DipTables


class Told(NamedTuple):
    """What a member's program tells lanes.

    Attributes:
        lane: Number of the mode whose plain steps follow, from 1; 0: none, it ended.
        goal: When a step has to end next [s].
        most: Steps that may be tried.
        rtol: Relative tolerance of a step [1].
        atol: Absolute tolerance of each number of the state.
    """

    lane: Array
    goal: Array
    most: Array
    rtol: Array
    atol: Array


class Carried(NamedTuple):
    """Where the numbers that lanes change lie among those that a run carries."""

    time: int
    step: int
    state: np.ndarray
    direction: int
    values: int
    accepted: int
    tried: int


class MemberLanes:
    """A member's program, compiled together with loops over lanes."""

    def __init__(
        self,
        program: Whole,
        carried: tuple[int, Carried],
        modes: Sequence[LaneMode],
        weights: Weights,
        bounds: Bounds,
        leaves: Sequence[Shaped],
        own: list[bool],
    ):
        """Write the stages and compile all of it.

        Args:
            program: Of inputs and what is carried, to what is carried and
                :class:`Told`.
            carried: How many small numbers are carried, and where those of lanes are.
            modes: That have lanes.
            weights: Of an explicit Runge-Kutta pair.
            bounds: Of plain steps.
            leaves: Shapes and types of what the stages depend on, for one member.
            own: Which of them differ from member to member.

        Raises:
            NotElementwiseError: stages that are more than arithmetic.
            NoCompilerError: no C compiler.
        """
        self._program, self._own = program, own
        count, at = carried
        n = len(at.state)
        differing = zip(leaves, own, strict=True)
        taken, left = program.head["MOST_GIVEN"], program.head["MOST_RESULTS"]
        head = program.head | {
            "MOST_GIVEN": taken + 2,
            "PROGRAM_GIVEN": taken,
            "PROGRAM_LEFT": left,
            "SHARED_AT": taken,
            "OWN_AT": taken + 1,
            "OWN": sum(math.prod(x.shape) for x, differs in differing if differs),
            "CARRIED": count,
            "MODES": len(modes),
            "N": n,
            "SEEN": 6,  # two values; at the end of a slip its turn and the normal, too
            "STAGES": len(weights.rows) + 1,
            "ORDER": weights.order,
            "LOOKS": len(bounds.dips.bulge_seen),
            "PLACES": len(bounds.dips.bulge_places),
            "AT_TIME": at.time,
            "AT_STEP": at.step,
            "AT_DIRECTION": at.direction,
            "AT_VALUES": at.values,
            "AT_ACCEPTED": at.accepted,
            "AT_TRIED": at.tried,
            **{f"TOLD_{name.upper()}": i for i, name in enumerate(Told._fields)},
        }
        texts = [_constants(bounds), "lane_math.h", "member_lanes.c"]
        for number, mode in enumerate(modes):
            beside = [(share, list(row)) for share, row in bounds.beside]
            steps = watched_attempt_source(weights, number, beside)
            state = jax.ShapeDtypeStruct((mode.given,), program.dtype)
            known = state, leaves, own
            stages = stages_source(mode.stage, *known, f"_{number}")
            ends = stages_source(mode.end, *known, f"_end_{number}")
            texts += _of_mode(number, mode, at, (stages, ends), steps)
        names = ", ".join(f"run_{i}" for i in range(len(modes)))
        texts.append(f"static void (*const run_mode[])(Block *) = {{{names}}};")
        there, others = apart(of_bearable_length(tuple(texts)))
        parts = *program.parts, "threads.h", *there, "member_lanes_call.c"
        sizes = [math.prod(shape) for shape in program.taken]
        head["GIVEN_SMALL"] = sum(x for x in sizes if x <= SMALL)
        lanes = lanes_of(program.dtype)
        # with the care of a loop that runs long, whatever its program is worth
        others = *others, *program.further
        self._call = XlaCall(program.dtype, lanes, head, parts, others)

    def __call__(
        self, size: int, arrays: Sequence[Array], leaves: Sequence[Array]
    ) -> Any:
        """What the program's runs of a batch carry at their ends, and what is told.

        Args:
            size: Of the batch.
            arrays: The program's arguments, with an axis in front: of this size, or of
                one where they are the same for all.
            leaves: What the stages depend on, likewise.
        """
        flat = [self._flat(x) for x in arrays]
        small = [_for_all(x, size) for x in flat if x.shape[1] <= SMALL]
        large = [x for x in flat if x.shape[1] > SMALL]
        none = jnp.zeros((1, 0), self._program.dtype)
        parts = [self._flat(x) for x in leaves]
        pairs = list(zip(parts, self._own, strict=True))
        shared = jnp.concatenate([none, *(x for x, own in pairs if not own)], axis=1)
        theirs = [_for_all(x, size) for x in (none, *(x for x, own in pairs if own))]
        given = jnp.concatenate(small, axis=1), *large, shared
        shapes = tuple((size, *shape) for shape in self._program.shapes)
        left = self._call(shapes, *given, jnp.concatenate(theirs, axis=1))
        return self._program.result(left)

    def _flat(self, x: Array) -> Array:
        return x.astype(self._program.dtype).reshape(x.shape[0], -1)


def _for_all(x: Array, size: int) -> Array:
    return jnp.broadcast_to(x, (size, *x.shape[1:]))


def _of_mode(
    number: int,
    mode: LaneMode,
    at: Carried,
    made: tuple[Functions, Functions],
    steps: str,
) -> list[str]:
    """The loop over lanes of one mode, in C."""
    stages, ends = made
    sizes = {
        "MODE": number,
        "GIVEN": mode.given,
        "ACTIVE": mode.moved,
        "SLIP": mode.moved - 3 if mode.slips else -1,
        "NUMBERS": stages.numbers,
        "ROWS": stages.rows,
        "END_NUMBERS": ends.numbers,
        "END_ROWS": ends.rows,
    }
    names = ", ".join(f"{name}_{number} = {size}" for name, size in sizes.items())
    places = ", ".join(str(i) for i in at.state[: mode.moved])
    return [
        f"enum {{ {names} }};",
        f"static const int AT_{number}[] = {{{places}}};",
        stages.text,
        ends.text,
        steps,
        f"#undef P\n#define P(name) name##_{number}",
        f"#undef P_SLIPS\n#define P_SLIPS {int(mode.slips)}",
        "plain_steps.c",
    ]


def _constants(bounds: Bounds) -> str:
    """Of the loops, in C."""
    numbers = [float(getattr(bounds, name.lower())) for name in _BOUNDS]
    names = zip(_BOUNDS, numbers, strict=True)
    texts = [f"#define {name} ({literal(x)})" for name, x in names]
    return "\n".join([*texts, bounds.dips.text])


def _table(name: str, numbers: np.ndarray) -> str:
    """A table of numbers in C."""
    sizes = "".join(f"[{n}]" for n in numbers.shape)
    texts = ", ".join(literal(float(x)) for x in numbers.reshape(-1))
    return f"static const real {name}{sizes} = {{{texts}}};"
