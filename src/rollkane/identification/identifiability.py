"""Which parameters a record can tell, before anything is fitted."""

import dataclasses
from collections.abc import Sequence
from os import PathLike
from typing import Any

import numpy as np

from ..dynamics.scene import Scene
from ..hybrid.modes import Modes
from ..kinematics.coordinates import State
from ..simulation.run_options import RunOptions
from . import uncertainty
from .estimates import expected_errors
from .fitting import check_usable, problem_of
from .parameters import Free, Tied
from .records import Record
from .unseen import REMEDY, described

_POORLY = 1.0  # relative error above which a direction is known in name only


@dataclasses.dataclass(frozen=True, eq=False)
class Identifiability:
    """What a record can tell at the model's values.

    Attributes:
        names: Of the numbers.
        singular_values: Of the misfits' derivatives by relative changes of the
            coordinates, over the noise [1], decreasing, shape (P,).
        condition: Largest over smallest; infinite where something is not seen.
        unseen: What cannot be told, in words.
        poorly_seen: Directions known to no better than 100 %, in words.
        standard_errors: Expected ones by path, infinite for what is not seen.
    """

    names: tuple[str, ...]
    singular_values: np.ndarray
    condition: float
    unseen: tuple[str, ...]
    poorly_seen: tuple[str, ...]
    standard_errors: dict[str, np.ndarray]

    def __str__(self) -> str:
        """The report."""
        values = ", ".join(f"{s:.3g}" for s in self.singular_values)
        lines = [
            "Identifiability",
            f"  condition number   {self.condition:.3g}",
            f"  singular values    {values} (of relative changes, over the noise)",
        ]
        if self.unseen:
            lines += ["Cannot be told from the records:", *_listed(self.unseen)]
            lines.append(REMEDY)
        if self.poorly_seen:
            lines += ["Known no better than to 100 %:", *_listed(self.poorly_seen)]
        if not (self.unseen or self.poorly_seen):
            lines.append("All parameters can be told from the records.")
        return "\n".join(lines)

    def plot(self, path: str | PathLike[str] | None = None, title: str = "") -> Any:
        """Draw singular values (extra ``plot``).

        Args:
            path: File to write, .png, .svg or .pdf; None for none.
            title: Above the figure.

        Returns:
            The matplotlib figure, or None where a file was written.
        """
        from ..pictures.plot_indices import plot_identifiability

        return plot_identifiability(self, path, title)


def _listed(sentences: tuple[str, ...]) -> list[str]:
    return [f"  {sentence}" for sentence in sentences]


def identifiability(
    scene: Scene,
    start: State | Sequence[State],
    record: Record | Sequence[Record],
    free: Free | Tied | Sequence[Free | Tied],
    *,
    modes: Modes | None = None,
    rtol: float | None = None,
    method: str = "auto",
) -> Identifiability:
    """Which combinations of parameters a record can tell, at the model's values.

    From the singular values of the misfits' derivatives; of the samples only their
    times and noise matter. Channels without sigma count with a hundredth of their size.

    Args:
        scene: The model.
        start: State at each record's ``start_time``; of several records, a list.
        record: Times and channels, or a list of records.
        free: Parameters.
        modes: How the contact may change in the runs.
        rtol: Relative tolerance of the runs [1].
        method: Of the runs.

    Returns:
        What is seen, and what is not, in words.

    Raises:
        FieldError: records or parameters that do not fit each other.
    """
    options = RunOptions(rtol, None, None, method)
    problem = problem_of(scene, start, record, free, modes, options)
    layout = problem.layout
    z = layout.start
    at = problem.evaluate(z)
    check_usable(at)
    parts = uncertainty.spectrum(at, layout.scale)
    unseen = uncertainty.unseen_directions(at, layout)
    weak = parts.seen & (parts.values < 1.0 / _POORLY)
    return Identifiability(
        names=uncertainty.names_of(layout),
        singular_values=parts.values,
        condition=parts.condition,
        unseen=described(unseen, layout, z),
        poorly_seen=tuple(
            sentence.replace("not seen", "poorly seen")
            for sentence in described(parts.directions[weak] * parts.scale, layout, z)
        ),
        standard_errors=expected_errors(problem, at, z),
    )
