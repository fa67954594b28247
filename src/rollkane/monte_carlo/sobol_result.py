"""Sobol indices of a model's outputs, as :func:`rollkane.sobol_indices` gives them."""

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from ..validation.codes import reason_of
from .evaluation import entry_labels

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
        codes: How many motions failed, by their code.
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
    codes: dict[int, int]
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
        return sum(self.codes.values())

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
        yield f"WARNING: {self.failed} of {self.evaluations} motions FAILED"
        for code, count in self.codes.items():
            yield f"  {count}: {reason_of(code)}"
        for name, count in self.dropped.items():
            if count:
                part = 100.0 * count / self.rows
                yield f"  {name}: {count} rows ({part:.1f} %) were dropped whole"
        yield "  The indices are those of motions that complete. They are also those of"
        yield "  all motions if failing has nothing to do with what is drawn; if it has,"
        yield '  no more is known of them than "could be" says.'

    def _table(self, name: str) -> Iterator[str]:
        shape = self.first[name].shape[1:]
        labels = entry_labels(name, shape)
        wide = max(len("factor"), *map(len, self.names))
        # one axis of entries, whatever the shape
        flat = lambda x, count: x.reshape(*x.shape[:count], -1)
        first, total = flat(self.first[name], 1), flat(self.total[name], 1)
        parts = [self.first_interval, self.first_bounds]
        parts += [self.total_interval, self.total_bounds]
        around = [flat(x[name], 2) for x in parts]
        bounded = bool(self.dropped[name])
        percent = f"{100.0 * self.level:g} % interval"
        could = f"  {'could be':14}" if bounded else ""
        for e, label in enumerate(labels[:_MOST_SHOWN]):
            yield f"{label}:"
            head = f"{'first':>7}  {percent:16}{could}"
            yield f"  {'factor':{wide}}  {head}  {head.replace('first', 'total')}".rstrip()
            for i, factor in enumerate(self.names):
                cells: list[str] = []
                for value, (ends, far) in (
                    (first[i, e], (around[0][:, i, e], around[1][:, i, e])),
                    (total[i, e], (around[2][:, i, e], around[3][:, i, e])),
                ):
                    cell = f"{value:7.3f}  {_pair(ends):16}"
                    cells.append(cell + (f"  {_pair(far):14}" if bounded else ""))
                yield f"  {factor:{wide}}  {'  '.join(cells)}".rstrip()
        if len(labels) > _MOST_SHOWN:
            yield f"({len(labels) - _MOST_SHOWN} more numbers of {name})"


def _pair(ends: np.ndarray) -> str:
    return f"{ends[0]:.3f} to {ends[1]:.3f}"
