"""Sobol indices of a model's outputs, as :func:`rollkane.sobol_indices` gives them."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from os import PathLike
from typing import Any

import numpy as np

from ..identification.transforms import entries

_MOST_SHOWN = 12  # numbers of an output


def _empty() -> dict[str, np.ndarray]:
    return {}


@dataclass(frozen=True)
class SobolIndices:
    """First-order and total indices [1] of k factors, by output.

    Arrays have the factors in front of the output's own shape; intervals and bounds
    have their two ends in front of that. Estimates may be below 0 or above 1 by their
    error; indices are not.

    Attributes:
        names: Of the factors.
        level: Probability with which an interval covers its index [1].
        rows: Of the design; each has k + 2 motions.
        reasons: How many motions failed, by the sentence that says why.
        first: First-order indices [1], shapes (k, ...).
        total: Total indices [1], shapes (k, ...).
        first_interval: Their intervals [1], shapes (2, k, ...).
        total_interval: Their intervals [1], shapes (2, k, ...).
        first_bounds: What indices could be, whatever failed motions would have given
            within ``limits``, with the interval's error at both ends [1], shapes (2, k,
            ...); the intervals where nothing failed.
        total_bounds: As ``first_bounds``, shapes (2, k, ...).
        dropped: Rows that were dropped, by output.
        limits: Least and most that failed outputs were taken to be [unit of the
            output], where something failed.
    """

    names: tuple[str, ...]
    level: float
    rows: int
    reasons: dict[str, int]
    first: dict[str, np.ndarray] = field(default_factory=_empty)
    total: dict[str, np.ndarray] = field(default_factory=_empty)
    first_interval: dict[str, np.ndarray] = field(default_factory=_empty)
    total_interval: dict[str, np.ndarray] = field(default_factory=_empty)
    first_bounds: dict[str, np.ndarray] = field(default_factory=_empty)
    total_bounds: dict[str, np.ndarray] = field(default_factory=_empty)
    dropped: dict[str, int] = field(default_factory=dict[str, int])
    limits: dict[str, tuple[np.ndarray, np.ndarray]] = field(
        default_factory=dict[str, tuple[np.ndarray, np.ndarray]]
    )

    @property
    def evaluations(self) -> int:
        """How many motions were run."""
        return self.rows * (len(self.names) + 2)

    @property
    def failed(self) -> int:
        """How many of them ended with another code than success."""
        return sum(self.reasons.values())

    def __str__(self) -> str:
        """The indices with their intervals, and what failed."""
        lines = [f"Sobol indices from {self.evaluations} motions ({self.rows} rows)"]
        lines += self._failures()
        for name in self.first:
            lines += self._table(name)
        return "\n".join(lines)

    def _failures(self) -> Iterator[str]:
        if not any(self.dropped.values()):
            return
        failed = f"{self.failed} of {self.evaluations} motions FAILED"
        yield f"WARNING: {failed}" if self.failed else "WARNING: outputs that are NaN"
        yield from (f"  {count}: {why}" for why, count in self.reasons.items())
        for name, count in self.dropped.items():
            if count:
                part = 100.0 * count / self.rows
                yield f"  {name}: {count} rows ({part:.1f} %) were dropped whole"
        yield "  The indices are those of the motions that are left: those of all"
        yield "  only if failing has nothing to do with what is drawn; else no more is"
        yield '  known of these than "could be" says.'

    def _table(self, name: str) -> Iterator[str]:
        labels = [name + index for index in entries(self.first[name].shape[1:])]
        for number, label in enumerate(labels[:_MOST_SHOWN]):
            rows = [self._row(name, number, i) for i in range(len(self.names))]
            heads = self._heads(name)
            wide = [max(map(len, column)) for column in zip(heads, *rows, strict=True)]
            yield f"{label}:"
            for row in (heads, *rows):
                cells = [f"{x:<{w}}" for x, w in zip(row, wide, strict=True)]
                yield ("  " + "  ".join(cells)).rstrip()
        if len(labels) > _MOST_SHOWN:
            yield f"({len(labels) - _MOST_SHOWN} more numbers of {name})"

    def _heads(self, name: str) -> list[str]:
        around = [f"{100.0 * self.level:g} % interval"]
        around += ["could be"] if self.dropped[name] else []
        return ["factor", "first", *around, "total", *around]

    def _row(self, name: str, number: int, factor: int) -> list[str]:
        """One factor's indices of one number of an output."""
        cells = [self.names[factor]]
        for values, intervals, bounds in (
            (self.first, self.first_interval, self.first_bounds),
            (self.total, self.total_interval, self.total_bounds),
        ):
            cells.append(f"{_flat(values[name], 1)[factor, number]:.3f}")
            around = [intervals[name], *([bounds[name]] if self.dropped[name] else [])]
            for ends in around:
                low, high = _flat(ends, 2)[:, factor, number]
                cells.append(f"{low:.3f} to {high:.3f}")
        return cells

    def plot(self, path: str | PathLike[str] | None = None, title: str = "") -> Any:
        """Draw indices with their intervals (extra ``plot``).

        Args:
            path: File to write, .png, .svg or .pdf; None for none.
            title: Above the figure.

        Returns:
            The matplotlib figure, or None where a file was written.
        """
        from ..pictures.plot_indices import plot_sobol

        return plot_sobol(self, path, title)


def _flat(x: np.ndarray, kept: int) -> np.ndarray:
    """With one axis for the output's own shape."""
    return x.reshape(*x.shape[:kept], -1)
