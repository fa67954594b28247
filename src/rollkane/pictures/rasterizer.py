"""Triangles as pixels, hidden ones behind those in front: pictures without a browser.

All triangles of a mesh at once, by NumPy: those of about one size in the picture are
laid out on square patches of pixels, and of all that meet in a pixel the nearest is
kept (z-buffer).
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

_PATCHES = (2, 4, 8, 16, 32, 64, 128, 256, 512, 1024, 2048)  # sides of patches [px]
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
    pixel, which, share = (np.concatenate(x) for x in zip(*found, strict=True))
    corners = triangles[which]
    depth = np.sum(share * seen[corners, 2], axis=1, dtype=np.float32)
    nearest = picture.depth.reshape(-1).copy()
    np.minimum.at(nearest, pixel, depth)
    front = depth == nearest[pixel]
    pixel, corners, share = pixel[front], corners[front], share[front]
    place = np.einsum("nk,nkc->nc", share, marks[corners])
    cells = np.array(pattern.shape[:2])
    square = np.clip((place * cells).astype(int), 0, cells - 1)
    bright = np.einsum("nk,nk->n", share, light[corners])
    color = np.clip(pattern[square[:, 0], square[:, 1]] * bright[:, None], 0.0, 255.0)
    flat = picture.color.reshape(-1, 3)
    flat[pixel] = opacity * color + (1.0 - opacity) * flat[pixel]
    if opacity == 1.0:
        picture.depth.reshape(-1)[pixel] = nearest[pixel]


def _fragments(
    seen: np.ndarray, triangles: np.ndarray, shape: tuple[int, int]
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Pixels in triangles: their numbers, the triangles, shares of the corners."""
    height, width = shape
    corners = seen[triangles][..., :2]
    low = np.floor(corners.min(axis=1)).astype(int)
    high = np.ceil(corners.max(axis=1)).astype(int)
    edge = np.array([width, height])
    inside = np.all((high > 0) & (low < edge), axis=1)
    low, high = np.maximum(low, 0), np.minimum(high, edge)
    extent = np.max(high - low, axis=1)
    a, b, c = np.moveaxis(corners, 1, 0)
    twice = _across(b - a, c - a)
    drawn = inside & (np.abs(twice) > 1e-9) & (extent > 0)
    kinds = np.searchsorted(_PATCHES, extent)
    for kind in np.unique(kinds[drawn]):
        side = _PATCHES[kind]
        chosen = np.flatnonzero(drawn & (kinds == kind))
        for part in np.array_split(chosen, 1 + len(chosen) * side * side // _MOST):
            if part.size:
                yield _in_patch(corners, low, twice, part, side, shape)


def _in_patch(
    corners: np.ndarray,
    low: np.ndarray,
    twice: np.ndarray,
    part: np.ndarray,
    side: int,
    shape: tuple[int, int],
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """As of ``_fragments``, of triangles on patches of one size."""
    height, width = shape
    steps = np.stack(np.meshgrid(np.arange(side), np.arange(side)), axis=-1)
    at = low[part, None] + steps.reshape(-1, 2)
    middle = at + 0.5
    a, b, c = (corners[part, k, None] for k in range(3))
    area = twice[part, None]
    first = _across(b - middle, c - middle) / area
    second = _across(c - middle, a - middle) / area
    third = 1.0 - first - second
    held = (first >= 0) & (second >= 0) & (third >= 0)
    held &= (at[..., 0] < width) & (at[..., 1] < height)
    which, where = np.nonzero(held)
    pixel = at[which, where, 1] * width + at[which, where, 0]
    share = np.stack([x[which, where] for x in (first, second, third)], axis=1)
    return pixel, part[which], share


def _across(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    return u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]
