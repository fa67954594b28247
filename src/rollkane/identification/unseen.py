"""Directions that a record does not show, in words."""

import numpy as np

from .layout import Coordinates, Layout

REMEDY = "  Hold one of them, give a prior, or record what depends on it."
_INSIDE = 1e-4  # sine of the angle to the space of unseen directions
_MATTERS = 0.02  # of the largest weight: what is named in a combination


def described(directions: np.ndarray, layout: Layout, z: np.ndarray) -> tuple[str, ...]:
    """Sentences that span the unseen directions.

    First products of powers of whole parameters (a common factor of all masses), then
    single numbers, then what is left, as combinations of few.

    Args:
        directions: Rows, in coordinates, shape (D, P).
        layout: The parameters.
        z: Coordinates at which they are unseen.
    """
    if not directions.size:
        return ()
    rest = _orthonormal(directions / layout.scale)
    found: list[str] = []
    for direction, sentence in [*_powers(rest, layout, z), *_singles(layout, z)]:
        unit = direction / np.linalg.norm(direction)
        inside = unit @ rest.T
        if np.linalg.norm(inside) > 1.0 - _INSIDE:
            found.append(sentence)
            rest = _orthonormal(rest - np.outer(rest @ unit, unit), len(rest) - 1)
        if not len(rest):
            return tuple(found)
    found += [_combination(row, layout, z) for row in _sparse(rest)]
    return tuple(found)


def _orthonormal(rows: np.ndarray, rank: int | None = None) -> np.ndarray:
    """Rows that span the same, orthonormal."""
    _, values, basis = np.linalg.svd(rows, full_matrices=False)
    # rows are orthonormal, or project to nothing: between lies no rank of rounding
    count = int((values > 1e-8 * values[0]).sum()) if rank is None else rank
    return basis[:count]


def _growth(entry: Coordinates, layout: Layout, z: np.ndarray) -> np.ndarray | None:
    """Direction in scaled coordinates that multiplies a parameter; None without one."""
    known = entry.at(z)
    value = known.value.ravel()
    slope = known.slope * layout.scale[entry.where]
    own, *_ = np.linalg.lstsq(slope, value, rcond=None)
    size = np.linalg.norm(value)
    if size == 0.0 or np.linalg.norm(slope @ own - value) > 1e-8 * size:
        return None
    whole = np.zeros(layout.size)
    whole[entry.where] = own
    return whole


def _powers(
    unseen: np.ndarray, layout: Layout, z: np.ndarray
) -> list[tuple[np.ndarray, str]]:
    """Unseen products of powers of whole parameters."""
    known = [(e, _growth(e, layout, z)) for e in layout.entries]
    grows = [(e, g) for e, g in known if g is not None]
    if not grows:
        return []
    columns: np.ndarray = np.stack([g for _, g in grows], axis=1)
    outside = columns - unseen.T @ (unseen @ columns)
    size = np.linalg.norm(columns, axis=0)
    _, values, rows = np.linalg.svd(outside / size)
    values = np.concatenate([values, np.zeros(len(grows) - values.size)])
    inside = rows[values < _INSIDE]
    found: list[tuple[np.ndarray, str]] = []
    rows = _sparse(inside) if len(inside) else inside
    for k in range(len(rows)):
        powers = rows[k] / size
        powers = powers / np.abs(powers).max()
        powers[np.abs(powers) < _MATTERS] = 0.0
        found.append((columns @ powers, _of_powers(powers, [e for e, _ in grows])))
    return found


def _of_powers(powers: np.ndarray, entries: list[Coordinates]) -> str:
    involved = [(e.name, p) for e, p in zip(entries, powers, strict=True) if p]
    names = [name for name, _ in involved]
    numbers = [len(e.transform.labels()) for e in entries]
    if len(involved) == 1 and numbers[int(np.argmax(np.abs(powers)))] == 1:
        return f"{names[0]} is not seen"
    if len(involved) == 1:
        return f"{names[0]}: its size is not seen, only ratios of its numbers"
    listed = " and ".join([", ".join(names[:-1]), names[-1]])
    same = all(abs(p - involved[0][1]) < _MATTERS for _, p in involved)
    if same:
        ratio = "their ratio" if len(involved) == 2 else "their ratios"
        return f"{listed} only by {ratio}: a common factor is not seen"
    if len(involved) == 2 and abs(sum(p for _, p in involved)) < _MATTERS:
        return f"{listed} only by their product: a factor that one gives the other"
    shown = " ".join(f"{name}^{p:+.2g}" for name, p in involved)
    return f"{listed}: all of them together along {shown} is not seen"


def _singles(layout: Layout, z: np.ndarray) -> list[tuple[np.ndarray, str]]:
    """Each coordinate that is one named number by itself."""
    found: list[tuple[np.ndarray, str]] = []
    for entry in layout.entries:
        slope = entry.at(z).shown_slope
        for k in range(slope.shape[1]):
            changed = np.flatnonzero(np.abs(slope[:, k]) > 1e-12 * np.abs(slope).max())
            if changed.size == 1:
                direction = np.zeros(layout.size)
                direction[entry.where.start + k] = 1.0
                name = entry.name + entry.transform.labels()[int(changed[0])]
                found.append((direction, f"{name} is not seen"))
    return found


def _sparse(rows: np.ndarray) -> np.ndarray:
    """Rows that span the same, each with few entries (by elimination)."""
    rows = rows.copy()
    for k in range(len(rows)):
        below = np.abs(rows[k:])
        r, c = divmod(int(np.argmax(below)), below.shape[1])
        rows[[k, k + r]] = rows[[k + r, k]]
        rows[k] /= rows[k, c]
        for other in range(len(rows)):
            if other != k:
                rows[other] -= rows[other, c] * rows[k]
    return rows


def _combination(row: np.ndarray, layout: Layout, z: np.ndarray) -> str:
    """The named numbers that change along a direction, relative to their units."""
    parts: list[tuple[str, float]] = []
    direction = row * layout.scale
    for entry in layout.entries:
        _, value, _, slope = entry.at(z)
        change = slope @ direction[entry.where]
        unit = entry.transform.unit(value)
        labels = entry.transform.labels()
        parts += [
            (entry.name + label, c / unit)
            for label, c in zip(labels, change, strict=True)
        ]
    most = max(abs(c) for _, c in parts)
    kept = [(n, c / most) for n, c in parts if abs(c) > _MATTERS * most]
    shown = ", ".join(f"{name} {c:+.2f}" for name, c in kept)
    return f"a combination is not seen: {shown}"
