"""The statistics of many members as what JSON can hold."""

from typing import Any

import numpy as np

from .intervals import checked_level
from .statistics import Statistics

QUANTILES = (0.01, 0.05, 0.25, 0.5, 0.75, 0.95, 0.99)


def summary(statistics: Statistics, level: float = 0.95) -> dict[str, Any]:
    """Everything that is told of many members, as plain numbers, texts and lists.

    Args:
        statistics: What was kept of them.
        level: Of the intervals' confidence [1].

    Returns:
        ``members`` and ``failed``; ``numbers``, by name: ``mean``,
        ``standard_error``, ``interval``, ``standard_deviation``, ``minimum``,
        ``maximum``, ``missing``, and ``quantiles``, by their share as a text, each
        value, low and high [the unit of the value]; ``probabilities``, by name:
        ``probability``, ``standard_error``, ``interval``, ``bounds`` [1]. Values with
        axes are nested lists; what is not finite is None, and ``reason`` says why an
        interval is, ``note`` what that of a mean count supposes.

    Raises:
        FieldError: a level that is none.
    """
    level = checked_level(level)
    error, found = statistics.standard_error, statistics
    numbers = {
        name: {
            "mean": _plain(found.mean[name]),
            "standard_error": _plain(error[name]),
            "interval": _plain(*found.interval(name, level)),
            "standard_deviation": _plain(found.standard_deviation[name]),
            "minimum": _plain(found.minimum[name]),
            "maximum": _plain(found.maximum[name]),
            "missing": _plain(found.missing[name]),
            "quantiles": {
                f"{q:g}": _plain(*found.quantile(name, q, level)) for q in QUANTILES
            },
            "reason": found.reason(name),
            "note": found.note(name),
        }
        for name in found.numbers
    }
    probabilities = {
        name: {
            "probability": _plain(found.probability[name]),
            "standard_error": _plain(error[name]),
            "interval": _plain(*found.interval(name, level)),
            "bounds": _plain(*found.bounds(name)),
            "reason": found.reason(name),
        }
        for name in found.truths
    }
    return {
        "members": found.count + found.failed,
        "failed": found.failed,
        "level": level,
        "numbers": numbers,
        "probabilities": probabilities,
    }


def _plain(*values: Any) -> Any:
    """Arrays as nested lists, of numbers or None; of several a list."""
    found: list[Any] = []
    for value in values:
        array = np.asarray(value)
        plain = array.astype(object)
        plain[~np.isfinite(array)] = None
        found.append(plain.tolist())
    return found if len(found) > 1 else found[0]
