"""Which of many like cases run in ``make test``; the others in ``make test-all``."""

from collections.abc import Iterable

import pytest

# built-in scenes that have every kind of part between them
A_FEW = ("rattleback", "isolator", "ellipsoid-on-six-axis-table", "shells-in-shells")


def slow_but(quick: Iterable[str], names: Iterable[str]) -> list:
    """Parameters of a test, of which all but a few are marked as slow.

    Args:
        quick: Those that are not.
        names: All of them.
    """
    names, quick = list(names), set(quick)
    assert quick <= set(names), quick - set(names)
    slow = pytest.mark.slow
    return [n if n in quick else pytest.param(n, marks=slow) for n in names]
