"""How events of a run are laid out, and how closely they are found, in C and by XLA."""

from typing import NamedTuple

import numpy as np

# Roundings of the clock: a step that ends so near to a zero ends on it
CLOSE = 4.0
# Roundings of the step in which it was seen: so near to the zero before, or to the
# start, it is that one. Values at a start have some ten roundings of what they are
# made of, and change by a hundredth of that in a step
START = 1e4
# Of the mean rate over the step: a value that is flatter at its zero is not known to be
# near it by a secant, but by a bracket as short as that
FLAT = 1e-3
# From this try on every second one is the bracket's middle: an interpolation converges
# in seven
HALVES_FROM = 10
# How many ends of tries an interpolation goes through: with five, the number of right
# digits nearly doubles from try to try
TRIES = 5


class Layout(NamedTuple):
    """Of each event, what does not change from run to run.

    Attributes:
        ways: 1: it is found where it rises, -1: where it falls, 0: both.
        stops: Whether it ends the run.
        mosts: How often it is kept.
    """

    ways: tuple[int, ...]
    stops: tuple[bool, ...]
    mosts: tuple[int, ...]

    @property
    def firsts(self) -> tuple[int, ...]:
        """Where the places of each event begin."""
        return tuple(int(x) for x in np.cumsum((0, *self.mosts[:-1])))

    @property
    def capacity(self) -> int:
        """Places of all."""
        return sum(self.mosts)

    @property
    def head(self) -> dict[str, int]:
        """What the loop in C has to know, of whole numbers."""
        return {
            "EVENTS": len(self.ways),
            "EVENT_CAPACITY": self.capacity,
            "EVENT_CLOSE": int(CLOSE),
            "EVENT_START": int(START),
            "EVENT_FLAT": round(1.0 / FLAT),
            "EVENT_HALVES": HALVES_FROM,
            "EVENT_TRIES": TRIES,
        }

    @property
    def text(self) -> str:
        """What it has to know of each, in C."""
        listed = {
            "real event_way": self.ways,
            "int event_ends": map(int, self.stops),
            "int64_t event_most": self.mosts,
            "long event_first": self.firsts,
        }
        return "\n".join(
            f"static const {name}[] = {{{', '.join(map(str, numbers))}}};"
            for name, numbers in listed.items()
        )
