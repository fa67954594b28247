"""Neighbouring points of a branch, and what changes of stability are told by."""

from collections.abc import Callable
from typing import Generic, NamedTuple, Protocol, TypeAlias, TypeVar

import numpy as np


class Followed(Protocol):
    """A point of a branch of steady motions or of a family of periodic ones."""

    @property
    def exponents(self) -> np.ndarray:
        """Eigenvalues, or logarithms of multipliers, which decide, shape (k,)."""
        ...

    @property
    def errors(self) -> np.ndarray:
        """How far rounding may move each, shape (k,)."""
        ...

    @property
    def unstable(self) -> int:
        """How many grow, beyond what rounding explains."""
        ...

    @property
    def determinants(self) -> tuple[tuple[complex, float], ...]:
        """Places of the axis that a single one passes, and what is zero if it does."""
        ...

    @property
    def turning(self) -> float:
        """Change of what is varied along the way, zero at a fold."""
        ...


P = TypeVar("P", bound=Followed)
# The point a way along the tangent of another, either way; None: it is not found.
Way: TypeAlias = Callable[[P, float], P | None]


class Segment(NamedTuple, Generic[P]):
    """Two neighbouring points of a branch.

    Attributes:
        first: With the tangent that leads to the other.
        last: The other.
        far: How far along the tangent it lies.
        base: Whose tangent that is; None: the first one's.
        near: How far along it the first one lies.
    """

    first: P
    last: P
    far: float
    base: P | None = None
    near: float = 0.0


class Passing(NamedTuple, Generic[P]):
    """What is critical on a segment.

    Attributes:
        kind: "fold", "zero crossing", "Hopf" or "collision", as of ``Critical``.
        point: There.
        exponent: That passes or meets.
    """

    kind: str
    point: P
    exponent: complex
