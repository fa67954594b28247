"""The statistics of many members as text."""

from collections.abc import Iterable
from typing import Any

import numpy as np

_ENTRIES = 12  # of one name, that are shown
_QUANTILES = (0.05, 0.5, 0.95)


def table(found: Any) -> str:
    """Counts, a row for each entry, and what has to be said beside it.

    Args:
        found: :class:`~rollkane.uncertainty.statistics.Statistics`.
    """
    lines = [_heading(found)]
    numbers = [row for name in found.numbers for row in _number_rows(found, name)]
    if numbers:
        quantiles = [f"{100 * q:g} %" for q in _QUANTILES]
        head = ("", "mean", "95 % interval", "deviation", "minimum")
        lines += ["", *_aligned([(*head, *quantiles, "maximum"), *numbers])]
    truths = [row for name in found.truths for row in _truth_rows(found, name)]
    if truths:
        head = ["", "probability", "95 % interval"]
        if found.failed:
            head.append("if all that failed were false, or true")
        lines += ["", *_aligned([head, *truths])]
    notes = [*_notes(found)]
    return "\n".join([*lines, *([""] if notes else []), *notes])


def _heading(found: Any) -> str:
    total = found.count + found.failed
    if not found.failed:
        return f"{total:,} members, none failed"
    share = 100.0 * found.failed / total
    return (
        f"{total:,} members, of which {found.failed:,} FAILED ({share:.3g} %) "
        "and are left out"
    )


def _number_rows(found: Any, name: str) -> Iterable[list[str]]:
    low, high = found.interval(name)
    columns = [
        found.mean[name],
        low,
        high,
        found.standard_deviation[name],
        found.minimum[name],
        *(found.quantile(name, q)[0] for q in _QUANTILES),
        found.maximum[name],
    ]
    for label, entry in _entries(found, name, columns):
        mean, first, last, *others = entry
        told = _together(mean, first, last)
        yield [label, told[0], f"{told[1]} to {told[2]}", *(f"{x:.5g}" for x in others)]
    yield from _more(found, name, len(columns))


def _truth_rows(found: Any, name: str) -> Iterable[list[str]]:
    columns = [found.probability[name], *found.interval(name), *found.bounds(name)]
    for label, entry in _entries(found, name, columns):
        share, low, high = _together(*entry[:3])
        row = [label, share, f"{low} to {high}"]
        if found.failed:
            least, most = _together(*entry[3:])
            row.append(f"{least} to {most}")
        yield row
    yield from _more(found, name, 4 if found.failed else 3)


def _entries(
    found: Any, name: str, columns: list[Any]
) -> Iterable[tuple[str, list[float]]]:
    flat = [np.asarray(x, float).reshape(-1)[:_ENTRIES].tolist() for x in columns]
    names = found.labels(name)[:_ENTRIES]
    return zip(names, map(list, zip(*flat, strict=True)), strict=True)


def _more(found: Any, name: str, columns: int) -> Iterable[list[str]]:
    more = len(found.labels(name)) - _ENTRIES
    if more > 0:
        yield [f"{name}: {more} more", *[""] * (columns - 1)]


def _together(*numbers: float) -> list[str]:
    """With the digits that tell them apart, and two more."""
    finite = [x for x in numbers if np.isfinite(x)]
    size, apart = max(map(abs, finite), default=0.0), np.ptp(finite or [0.0])
    digits = 5
    if apart > 0.0:
        digits = min(max(int(np.ceil(np.log10(size / apart))) + 2, 4), 16)
    return [f"{x:.{digits}g}" for x in numbers]


def _aligned(rows: Iterable[Iterable[str]]) -> list[str]:
    table = [list(row) for row in rows]
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    lines: list[str] = []
    for first, *others in table:
        cells = (f"{x:>{width}}" for x, width in zip(others, widths[1:], strict=True))
        lines.append("  ".join([f"{first:<{widths[0]}}", *cells]).rstrip())
    return lines


def _notes(found: Any) -> Iterable[str]:
    for name, missing in found.missing.items():
        most = int(np.max(missing, initial=0))
        if most:
            yield f"{name}: not finite in {most:,} members, which are left out of it"
    reasons: dict[str, list[str]] = {}
    for name in (*found.numbers, *found.truths):
        if reason := found.reason(name) or found.note(name):
            reasons.setdefault(reason, []).append(name)
    for reason, names in reasons.items():
        yield f"{', '.join(names)}: {reason}"
