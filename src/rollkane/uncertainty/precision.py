"""When a study is precise enough to stop."""

from typing import Any

import numpy as np

from ..validation.checks import FieldError, positive
from .intervals import checked_level
from .statistics import Statistics

# Of fewer members that did not fail nobody knows how they scatter.
LEAST = 64


class Precision:
    """How precise a mean or a probability shall be: a rule to stop.

    Looking at intervals again and again until one is short enough makes it miss a
    little more often than its level says; with members doubled between looks, and
    errors wanted that take many, that is less than the level's own rounding (Glynn and
    Whitt, The asymptotic validity of sequential stopping rules for stochastic
    simulations, Annals of Applied Probability 2, 1992).

    Attributes:
        name: Of a number or a truth value; of its entries all have to be precise.
        absolute: Largest half width of the interval [the unit of the value, or 1].
        relative: Largest half width over the size of the value [1].
        level: Of the interval's confidence [1].
    """

    def __init__(
        self,
        name: str,
        absolute: float | None = None,
        relative: float | None = None,
        level: float = 0.95,
    ):
        """Say what is wanted; both, if both are given.

        Args:
            name: What shall be precise.
            absolute: Largest half width of the interval [the unit of the value, or 1].
            relative: Largest half width over the size of the value [1].
            level: Of the interval's confidence [1].

        Raises:
            FieldError: neither is given, or one is not positive.
        """
        if not isinstance(name, str):  # pyright: ignore[reportUnnecessaryIsInstance]
            remedy = "give the name of what is observed"
            raise FieldError("Precision.name", name, "must be a text", remedy)
        if absolute is None and relative is None:
            problem, remedy = "must be given, or relative", "give one of the two"
            raise FieldError("Precision.absolute", None, problem, remedy)
        self.name = name
        self.absolute = _width("absolute", absolute)
        self.relative = _width("relative", relative)
        self.level = checked_level(level)

    def half_width(self, statistics: Statistics) -> np.ndarray:
        """Half width of the interval, NaN where there is none [the value's unit]."""
        low, high = statistics.interval(self.name, self.level)
        return 0.5 * (np.asarray(high) - np.asarray(low))

    def reached(self, statistics: Statistics) -> bool:
        """Whether it is that precise, with at least 64 members that did not fail.

        Raises:
            FieldError: nothing of this name is observed.
        """
        half = self.half_width(statistics)
        if statistics.count < LEAST:
            return False
        return bool(np.all(half <= self._most(statistics)))

    def missed(self, statistics: Statistics) -> str:
        """What to say where members ended before it was reached; else nothing."""
        if self.reached(statistics):
            return ""
        half = np.ravel(self.half_width(statistics))
        if statistics.count < LEAST or not np.isfinite(half).all():
            told = "is not known from so few members"
        else:
            most = np.broadcast_to(np.ravel(self._most(statistics)), half.shape)
            # of all entries the one that is farthest from what is wanted
            worst = int(np.argmax(half / np.maximum(most, np.finfo(float).tiny)))
            told = f"is {half[worst]:.3g}, not {most[worst]:.3g}"
        return (
            f"the precision of {self.name} was not reached: half its interval {told}; "
            "raise size"
        )

    def _most(self, statistics: Statistics) -> np.ndarray:
        """Half width that is enough, of each entry [the value's unit]."""
        middle = {**statistics.mean, **statistics.probability}[self.name]
        most = np.full(np.shape(middle), np.inf)
        if self.absolute is not None:
            most = np.minimum(most, self.absolute)
        if self.relative is not None:
            most = np.minimum(most, self.relative * np.abs(middle))
        return most

    def spec(self) -> dict[str, Any]:
        """What identifies it, for provenance: plain numbers and texts."""
        return {
            "name": self.name,
            "absolute": self.absolute,
            "relative": self.relative,
            "level": self.level,
        }


def _width(field: str, value: Any) -> float | None:
    if value is None:
        return None
    positive(f"Precision.{field}", value, (), "a half width above zero")
    return float(value)
