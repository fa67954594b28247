"""Options of the runs that a study makes."""

from typing import NamedTuple


class RunOptions(NamedTuple):
    """How runs are made: arguments of :func:`rollkane.simulate`, by its names."""

    rtol: float | None = None
    atol: float | None = None
    max_steps: int | None = None
    method: str = "auto"
