"""Uniform numbers of a study's members: plain, Latin hypercube and Sobol samples.

Member i of a seed has the same numbers, bit for bit, whichever block of members asks
for them: nothing is drawn in order.
"""

import abc
import hashlib
import threading
from typing import Any, cast

import numpy as np
from jaxtyping import Float, Int

from ..validation.checks import FieldError, whole
from .group_totals import COMPLETE

KINDS = ("plain", "latin", "sobol")
SETS = 16  # Latin sets of a study, at most; scrambles of a Sobol sequence
MOST_DIMENSIONS = 21201  # of which Joe and Kuo have direction numbers
_BITS = 52  # of every random number
# Of Sobol points, which is where SciPy can still advance by many; what is below is
# filled with random numbers, as a scramble of all digits would.
_SOBOL_BITS = 32
_WORDS = 4  # of 64 bits, that Philox makes at a time
_PLAIN, _LATIN, _SOBOL = 1, 2, 3  # streams of one seed that have nothing in common


class Sampler(abc.ABC):
    """Uniform numbers by member.

    Attributes:
        kind: ``"plain"``, ``"latin"`` or ``"sobol"``.
        dimension: Numbers of a member.
        seed: Of all of them.
        size: Of the study.
        note: What a user should know about this size; None: nothing.
    """

    kind: str
    note: str | None = None

    def __init__(self, dimension: int, seed: int, size: int):
        """Take what the numbers depend on; see :func:`sampler`."""
        self.dimension, self.seed, self.size = dimension, seed, size

    def __reduce__(self) -> tuple[Any, ...]:
        """As :func:`sampler` makes it: nothing that is kept travels."""
        return sampler, (self.kind, self.dimension, self.seed, self.size)

    @property
    @abc.abstractmethod
    def group_count(self) -> int | None:
        """How many groups are independent of each other; None: members are."""

    @abc.abstractmethod
    def groups(self, first: int, count: int) -> Int[np.ndarray, " count"]:
        """Group of each of a range of members; zeros where members are independent.

        Args:
            first: Number of the first member.
            count: How many follow it, itself included.
        """

    def uniforms(self, first: int, count: int) -> Float[np.ndarray, "count d"]:
        """Numbers of a range of members, strictly between 0 and 1 [1].

        Args:
            first: Number of the first member, from 0.
            count: How many members.

        Raises:
            FieldError: a range that is none.
        """
        first = whole("Sampler.uniforms.first", first, 0, "members count from 0")
        count = whole("Sampler.uniforms.count", count, 0, "give how many members")
        return self._uniforms(first, count)

    def spec(self) -> dict[str, Any]:
        """What identifies the numbers, as JSON has it.

        With the digest of the first members: SciPy's scrambles follow from random
        numbers of NumPy that another version of either may change.
        """
        first = np.ascontiguousarray(self.uniforms(0, SETS), dtype="<f8")
        return {
            "kind": self.kind,
            "dimension": self.dimension,
            "seed": self.seed,
            **({"size": self.size} if self.kind == "latin" else {}),
            "first members": hashlib.sha256(first.tobytes()).hexdigest(),
        }

    @abc.abstractmethod
    def _uniforms(self, first: int, count: int) -> np.ndarray: ...


class _Plain(Sampler):
    """Independent members: Philox's counter is at the member's place."""

    kind = "plain"

    @property
    def group_count(self) -> int | None:
        return None

    def groups(self, first: int, count: int) -> np.ndarray:
        del first
        return np.zeros(count, int)

    def _uniforms(self, first: int, count: int) -> np.ndarray:
        return _counted(_key(self.seed, _PLAIN), first, count, self.dimension)


def _set_size(size: int) -> int:
    """Members of a Latin set: about a sixteenth; of the last set all, or half or more.

    Intervals leave out a set of less than half, whose few members are as good as plain
    ones: the error of the mean would be theirs, and not be told.
    """
    found = max(2, -(-size // SETS))
    while 0 < size % found < COMPLETE * found:
        found += 1
    return found


class _Latin(Sampler):
    """Sets of members, each of them a Latin hypercube, independent of each other."""

    kind = "latin"

    def __init__(self, dimension: int, seed: int, size: int):
        super().__init__(dimension, seed, size)
        self.set_size = _set_size(size)
        self._last: tuple[int, np.ndarray] | None = None
        if size % self.set_size:
            self.note = (
                f"the last Latin set has {size % self.set_size} of "
                f"{self.set_size} members; sizes of {SETS} n have none that is cut"
            )

    @property
    def group_count(self) -> int | None:
        return -(-self.size // self.set_size)

    def groups(self, first: int, count: int) -> np.ndarray:
        return np.arange(first, first + count) // self.set_size

    def _uniforms(self, first: int, count: int) -> np.ndarray:
        length = self.set_size
        # where in its stratum: as plain members, but of another stream
        found = _counted(_key(self.seed, _LATIN), first, count, self.dimension)
        for one in range(first // length, -(-(first + count) // length)):
            begin, end = (
                max(first, one * length),
                min(first + count, (one + 1) * length),
            )
            strata = self._strata(one)[begin - one * length : end - one * length]
            part = found[begin - first : end - first]
            # rounding must not carry a number into the next stratum
            within = np.minimum(strata + part, np.nextafter(strata + 1.0, 0.0))
            found[begin - first : end - first] = within / length
        return np.minimum(found, np.nextafter(1.0, 0.0))

    def _strata(self, one: int) -> np.ndarray:
        """Strata of a set's members, shape (L, d): each column a permutation."""
        kept = self._last
        if kept is None or kept[0] != one:
            shape = self.set_size, self.dimension
            words = np.random.Philox(key=_key(self.seed, _LATIN, one + 1))
            # by sorting, as how NumPy permutes may change from version to version
            keys = words.random_raw(shape[0] * shape[1]).reshape(shape)
            kept = one, np.argsort(keys, axis=0, kind="stable").astype(float)
            self._last = kept
        return kept[1]


class _Sobol(Sampler):
    """Scrambles of one Sobol sequence, of which members take points in turn."""

    kind = "sobol"

    def __init__(self, dimension: int, seed: int, size: int):
        super().__init__(dimension, seed, size)
        if dimension > MOST_DIMENSIONS:
            problem = f"is more than the {MOST_DIMENSIONS} that Sobol sequences have"
            remedy = 'take "latin" or "plain" samples'
            raise FieldError("sampler.dimension", dimension, problem, remedy)
        if size > SETS << _SOBOL_BITS:
            problem, remedy = "is more than Sobol points can tell", 'take "plain" ones'
            raise FieldError("sampler.size", size, problem, remedy)
        _engine_type()
        self._engines: dict[int, Any] = {}
        self._lock = threading.Lock()
        if size % SETS or (size // SETS) & (size // SETS - 1):
            self.note = (
                f"Sobol samples are balanced at {SETS} times a power of two; "
                f"near {size} these are {_balanced(size)} and {2 * _balanced(size)}"
            )

    @property
    def group_count(self) -> int | None:
        return SETS

    def groups(self, first: int, count: int) -> np.ndarray:
        return np.arange(first, first + count) % SETS

    def _uniforms(self, first: int, count: int) -> np.ndarray:
        # what is below the digits of the points
        below = _counted(_key(self.seed, _SOBOL), first, count, self.dimension)
        found = np.empty((count, self.dimension))
        for offset in range(min(SETS, count)):
            point, scramble = divmod(first + offset, SETS)
            length = len(range(offset, count, SETS))
            with self._lock:
                found[offset::SETS] = self._points(scramble, point, length)
        step = 0.5**_SOBOL_BITS
        return np.minimum(found + step * below, np.nextafter(found + step, 0.0))

    def _points(self, scramble: int, first: int, count: int) -> np.ndarray:
        """Points of one scramble, which is kept where it ended."""
        engine = self._engines.get(scramble)
        if engine is None:
            stream = np.random.SeedSequence(self.seed, spawn_key=(_SOBOL, scramble))
            random = np.random.Generator(np.random.Philox(stream))
            engine = _scrambled(self.dimension, random)
            self._engines[scramble] = engine
        if engine.num_generated > first:
            engine.reset()
        if engine.num_generated < first:
            engine.fast_forward(first - engine.num_generated)
        parts: list[np.ndarray] = []
        if first == 0:  # the very first by itself: SciPy warns of odd counts there
            parts.append(engine.random(1))
            count -= 1
        if count:
            parts.append(engine.random(count))
        return np.concatenate(parts)


def sampler(kind: str, dimension: int, seed: int, size: int) -> Sampler:
    """Uniform numbers of a study's members.

    Args:
        kind: ``"plain"``: independent members. ``"latin"``: sets of ``size / 16``
            members or a few more, each a Latin hypercube; of the last one half or more
            are there. ``"sobol"``: 16 scrambles of a Sobol sequence, of which member i
            is point ``i // 16`` of scramble ``i % 16``.
        dimension: Numbers of a member.
        seed: Of all of them; a whole number.
        size: Members of the study. Plain and Sobol members do not depend on it.

    Raises:
        FieldError: an unknown kind, numbers that are not whole, more dimensions than
            Sobol sequences have.
        ImportError: Sobol samples without SciPy.

    Source: Salmon et al., Parallel random numbers: as easy as 1, 2, 3 (2011); McKay,
    Beckman and Conover, Technometrics 21 (1979); Joe and Kuo, SIAM J. Sci. Comput. 30
    (2008), scrambled by Matousek, J. Complexity 14 (1998).
    """
    kinds: dict[str, type[Sampler]] = {"plain": _Plain, "latin": _Latin}
    kinds["sobol"] = _Sobol
    if kind not in kinds:
        raise FieldError("sampler.kind", kind, "is not known", f"use one of {KINDS}")
    dimension = whole("sampler.dimension", dimension, 1, "give numbers of a member")
    seed = whole("sampler.seed", seed, 0, "give a whole number")
    size = whole("sampler.size", size, 1, "give how many members")
    return kinds[kind](dimension, seed, size)


def _key(seed: int, *stream: int) -> np.ndarray:
    """Philox's key of a stream."""
    sequence = np.random.SeedSequence(seed, spawn_key=stream)
    return sequence.generate_state(2, np.uint64)


def _counted(key: np.ndarray, first: int, count: int, dimension: int) -> np.ndarray:
    """Uniform numbers of members, each at its own place of the counter."""
    steps = -(-dimension // _WORDS)
    words = np.random.Philox(key=key, counter=first * steps)
    raw = words.random_raw(count * steps * _WORDS).reshape(count, steps * _WORDS)
    kept = raw[:, :dimension] >> np.uint64(64 - _BITS)
    return (kept.astype(float) + 0.5) * 0.5**_BITS


def _balanced(size: int) -> int:
    """The largest 16 times a power of two that is not more than a size, or 16."""
    return SETS << max(0, (size // SETS).bit_length() - 1)


def _engine_type() -> Any:
    try:
        from scipy.stats import qmc  # pyright: ignore[reportMissingTypeStubs]
    except ImportError as error:
        raise ImportError(
            "Sobol samples need scipy: pip install 'rollkane[study]'"
        ) from error
    return cast(Any, qmc).Sobol


def _scrambled(dimension: int, random: np.random.Generator) -> Any:
    """SciPy's sequence, whose argument for random numbers changed its name in 1.15."""
    try:
        return _engine_type()(dimension, scramble=True, bits=_SOBOL_BITS, rng=random)
    except TypeError:
        return _engine_type()(dimension, scramble=True, bits=_SOBOL_BITS, seed=random)
