"""Colours of films and models: those of the viewer's page."""

from typing import NamedTuple

import numpy as np


def _rgb(text: str) -> tuple[int, int, int]:
    return int(text[1:3], 16), int(text[3:5], 16), int(text[5:7], 16)


class _Colors(NamedTuple):
    """Red, green and blue, 0 to 255.

    Attributes:
        body: Of the squares of a body, in turn.
        marked: Of those of its first sector, so that a turn about an axis of symmetry
            is seen.
        base: Of squares of the base, in turn.
        mass: Of carried masses.
        contact: Of the contact point.
        path: Of its path on the base.
        sky: Behind all.
        veil: How opaque what is seen through is [1].
    """

    body: tuple[tuple[int, int, int], tuple[int, int, int]]
    marked: tuple[tuple[int, int, int], tuple[int, int, int]]
    base: tuple[tuple[int, int, int], tuple[int, int, int]]
    mass: tuple[int, int, int]
    contact: tuple[int, int, int]
    path: tuple[int, int, int]
    sky: tuple[int, int, int]
    veil: float


COLORS = _Colors(
    body=(_rgb("#f4efe6"), _rgb("#d9783c")),
    marked=(_rgb("#cfe0f2"), _rgb("#2f6aa8")),
    base=(_rgb("#e9edf2"), _rgb("#d3dae3")),
    mass=_rgb("#5b2d8e"),
    contact=_rgb("#d11f2f"),
    path=_rgb("#1b4f91"),
    sky=_rgb("#ffffff"),
    veil=0.45,
)


def checks(kind: str, cells: tuple[int, int]) -> np.ndarray:
    """Colours of a pattern's squares, shape (columns, rows, 3).

    Args:
        kind: Of a part, as :class:`rollkane.pictures.motion_parts.Part` has it.
        cells: Squares along both directions of the mesh's marks.
    """
    if kind in ("mass", "contact"):
        return np.array([[getattr(COLORS, kind)]])
    columns, rows = cells
    turn = np.add.outer(np.arange(columns), np.arange(rows)) % 2
    found = np.array(COLORS.base if kind == "base" else COLORS.body)[turn]
    if kind in ("body", "inside"):
        found[:2] = np.array(COLORS.marked)[turn[:2]]
    return found
