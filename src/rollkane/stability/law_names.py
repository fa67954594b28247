"""Names of affine laws of coordinates, each another one."""

from collections import Counter

import numpy as np

_SAME = 1e-6  # of one: a coefficient that is told as one, as it is printed


def named(rows: np.ndarray, n: int) -> tuple[str, ...]:
    """Names by the coordinates that laws shift and turn; the same twice is numbered.

    Args:
        rows: Shifts, then coefficients row by row, shape (K, n + n^2).
        n: Number of the coordinates.
    """
    names = [_name(row, n) for row in rows]
    count, seen = Counter(names), Counter[str]()
    found: list[str] = []
    for name in names:
        seen[name] += 1
        found.append(f"{name} ({seen[name]})" if count[name] > 1 else name)
    return tuple(found)


def _name(row: np.ndarray, n: int) -> str:
    moved = [k for k in range(n) if row[k]]
    shifts = [f"q[{k}]" for k in moved]
    if len(moved) > 1:
        shifts = [
            f"q[{k}]" if abs(row[k] - 1.0) < _SAME else f"{row[k]:.6g} q[{k}]"
            for k in moved
        ]
    turned = [f"q[{k}]" for k in range(n) if np.any(row[n + n * k : n + n * k + n])]
    name = " + ".join(shifts)
    if not turned:
        return name
    return (f"{name} with " if name else "linear in ") + " and ".join(turned)
