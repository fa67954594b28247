"""Triangles as pixels, hidden ones behind those in front: pictures without a browser.

All triangles of a mesh at once, by NumPy: those of about one size in the picture are
laid out on patches of pixels, and of all that meet in a pixel the nearest is
kept (z-buffer).
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

_LARGE = 48  # px; larger triangles are few, and laid out one by one
_LARGEST = 16  # powers of two that sides of patches may be [px]
_MOST = 1_000_000  # pixels that are looked at in one go
_NEAR = 1e-3  # of the camera's distance: nothing nearer is drawn


class Camera(NamedTuple):
    """Where a picture is taken from.

    Attributes:
        eye: [m], fixed axes, shape (3,).
        axes: Right, up and towards the eye [1], rows, shape (3, 3).
        focus: Pixels of a length that is as large as its distance.
        distance: Of the eye from what it looks at [m].
        shape: Height and width [px].
    """

    eye: np.ndarray
    axes: np.ndarray
    focus: float
    distance: float
    shape: tuple[int, int]

    def seen(self, points: np.ndarray) -> np.ndarray:
        """Column, row [px] and depth [m] of points, shape (n, 3)."""
        x, y, behind = self.axes @ (points - self.eye).T
        depth = np.maximum(-behind, _NEAR * self.distance)
        height, width = self.shape
        column = 0.5 * width + self.focus * x / depth
        return np.stack([column, 0.5 * height - self.focus * y / depth, depth], axis=1)


class Picture(NamedTuple):
    """A picture under way.

    Attributes:
        color: Red, green, blue, 0 to 255, shape (height, width, 3).
        depth: Of what is nearest [m], shape (height, width); infinite where nothing is.
    """

    color: np.ndarray
    depth: np.ndarray

    def copy(self) -> "Picture":
        """Another one that looks alike."""
        return Picture(self.color.copy(), self.depth.copy())


def empty(camera: Camera, color: tuple[int, int, int]) -> Picture:
    """A picture of nothing."""
    height, width = camera.shape
    filled = np.tile(np.array(color, dtype=np.float32), (height, width, 1))
    return Picture(filled, np.full((height, width), np.inf, dtype=np.float32))


def draw(
    picture: Picture,
    seen: np.ndarray,
    triangles: np.ndarray,
    marks: np.ndarray,
    pattern: np.ndarray,
    light: np.ndarray,
    opacity: float = 1.0,
) -> None:
    """Draw a mesh into a picture.

    Args:
        picture: Is changed.
        seen: Columns, rows and depths of the mesh's points, shape (n, 3).
        triangles: Corners, shape (m, 3).
        marks: Places in the pattern of the points, in [0, 1], shape (n, 2).
        pattern: Colours of its squares, shape (columns, rows, 3).
        light: Brightness of each point [1], shape (n,).
        opacity: 1, or less where what is behind shows through; then depths stay.
    """
    height, width = picture.depth.shape
    found = list(_fragments(seen, triangles, (height, width)))
    if not found:
        return
    pixel, which, first, second = (np.concatenate(x) for x in zip(*found, strict=True))
    numbers = triangles.T.astype(np.int32)
    within = _Within(numbers[0][which], numbers[1][which], numbers[2][which])
    share = first, second, 1 - first - second
    depth = within.mean(share, seen[:, 2])
    nearest = picture.depth.reshape(-1).copy()
    np.minimum.at(nearest, pixel, depth)
    front = np.flatnonzero(depth == nearest[pixel])
    pixel, within = pixel[front], _Within(*(x[front] for x in within))
    share = share[0][front], share[1][front], share[2][front]
    columns, rows = pattern.shape[:2]
    column = (within.mean(share, marks[:, 0]) * columns).astype(np.int32)
    row = (within.mean(share, marks[:, 1]) * rows).astype(np.int32)
    square = np.clip(column, 0, columns - 1) * rows + np.clip(row, 0, rows - 1)
    colors = pattern.reshape(-1, 3).astype(np.float32)
    color = colors[square] * within.mean(share, light)[:, None]
    np.minimum(color, 255.0, out=color)
    flat = picture.color.reshape(-1, 3)
    if opacity == 1.0:
        flat[pixel] = color
        picture.depth.reshape(-1)[pixel] = nearest[pixel]
    else:
        flat[pixel] = opacity * color + (1.0 - opacity) * flat[pixel]


class _Within(NamedTuple):
    """Corners of the triangles in which pixels are, three numbers of points each."""

    a: np.ndarray
    b: np.ndarray
    c: np.ndarray

    def mean(
        self, share: tuple[np.ndarray, np.ndarray, np.ndarray], values: np.ndarray
    ) -> np.ndarray:
        """Values of the points, by the corners' shares."""
        known = values.astype(np.float32)
        found = share[0] * known[self.a]
        found += share[1] * known[self.b]
        found += share[2] * known[self.c]
        return found


def _fragments(
    seen: np.ndarray, triangles: np.ndarray, shape: tuple[int, int]
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
    """Pixels in triangles: their numbers, the triangles, shares of two corners."""
    height, width = shape
    corners = seen[triangles][..., :2]
    low = np.floor(corners.min(axis=1)).astype(int)
    high = np.ceil(corners.max(axis=1)).astype(int)
    edge = np.array([width, height])
    inside = np.all((high > 0) & (low < edge), axis=1)
    low, high = np.maximum(low, 0), np.minimum(high, edge)
    extent = high - low
    slopes = _shares(corners, low)
    drawn = inside & np.isfinite(slopes).all(axis=(1, 2)) & np.all(extent > 0, axis=1)
    large = drawn & np.any(extent > _LARGE, axis=1)
    for k in np.flatnonzero(large):
        sides = int(extent[k, 0]), int(extent[k, 1])
        yield _in_patch(slopes, low, np.array([k]), sides, shape)
    # patches of the others are as wide and as high as the next powers of two
    powers = np.ceil(np.log2(np.maximum(extent, 2))).astype(int)
    number = powers @ np.array([_LARGEST, 1])
    drawn &= ~large
    for kind in np.unique(number[drawn]):
        across, down = (2**power for power in divmod(int(kind), _LARGEST))
        chosen = np.flatnonzero(drawn & (number == kind))
        for part in np.array_split(chosen, 1 + len(chosen) * across * down // _MOST):
            if part.size:
                yield _in_patch(slopes, low, part, (across, down), shape)


def _shares(corners: np.ndarray, low: np.ndarray) -> np.ndarray:
    """Shares of the first two corners of triangles, linear in the pixels' numbers.

    Returns:
        Value at the middle of the patch's first pixel, change from column to column
        and from row to row [1], shape (n, 2, 3); not finite where there is no area.
    """
    a, b, c = np.moveaxis(corners - (low + 0.5)[:, None], 1, 0)
    twice = _across(b - a, c - a)[:, None]
    known: list[np.ndarray] = []
    with np.errstate(divide="ignore", invalid="ignore"):
        for u, v in ((b, c), (c, a)):
            parts = _across(u, v), u[:, 1] - v[:, 1], v[:, 0] - u[:, 0]
            known.append(np.stack(parts, axis=1) / twice)
    return np.stack(known, axis=1).astype(np.float32)


def _in_patch(
    slopes: np.ndarray,
    low: np.ndarray,
    part: np.ndarray,
    sides: tuple[int, int],
    shape: tuple[int, int],
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """As of ``_fragments``, of triangles on patches of one size."""
    height, width = shape
    x, y = (np.arange(side, dtype=np.float32) for side in sides)
    at, right, below = np.moveaxis(slopes[part], 2, 0)[..., None, None]
    first, second = np.moveaxis(at + right * x + below * y[:, None], 1, 0)
    held = (first >= 0) & (second >= 0) & (first + second <= 1)
    which, row, column = np.nonzero(held)
    one, two = first[which, row, column], second[which, row, column]
    owner = part[which]
    row, column = row + low[owner, 1], column + low[owner, 0]
    pixel = row * width + column
    within = (row < height) & (column < width)
    if within.all():
        return pixel, owner, one, two
    return pixel[within], owner[within], one[within], two[within]


def _across(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    return u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]
