"""Triangles for pictures: surfaces of the catalogue as meshes of points.

A mesh is drawn from the surface's own chart, evenly along its arc and its bends; no
other module decides where a surface is. Pictures only: no result depends on it.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..codegen.compile_effort import for_one_call
from ..dynamics.bodies import Body
from ..geometry.surfaces import (
    AbstractSurface,
    Cone,
    Cylinder,
    DiscEdge,
    Revolution,
    Ring,
    Torus,
)

_WIRE = 0.02  # thickness of a drawn wire, of its ring's radius


class Mesh(NamedTuple):
    """A surface as triangles.

    Attributes:
        points: [m], owner's axes, shape (n, 3).
        normals: Unit normals out of the material [1], shape (n, 3).
        marks: Place on the surface for a pattern, in [0, 1], shape (n, 2).
        triangles: Corners, anticlockwise seen from outside, shape (m, 3).
        cells: How many squares of a pattern suit each direction of ``marks``.
    """

    points: np.ndarray
    normals: np.ndarray
    marks: np.ndarray
    triangles: np.ndarray
    cells: tuple[int, int]


def surface_mesh(
    surface: AbstractSurface,
    touched: np.ndarray,
    outward: np.ndarray,
    size: float,
    counts: tuple[int, int] = (89, 45),
    within: np.ndarray | None = None,
) -> Mesh:
    """A surface, or as much of it as a motion uses.

    Args:
        surface: What to draw.
        touched: Some of its points, such as a contact's path [m], shape (k, 3), k > 0.
        outward: Unit normals out of the material there [1], shape (k, 3).
        size: Margin that is drawn around them where a surface has no end [m].
        counts: Points along the two directions of the chart.
        within: Lowest and highest corner of the box that it lies in where it has no end
            itself [m], shape (2, 3): of the body in which it is; None: no box.

    Returns:
        The mesh; places where the chart is not finite are left out (all of them:
        no triangles). A sharp rim is drawn as a thin disc, a wire as a thin torus.
    """
    if isinstance(surface, DiscEdge):
        return _disc(float(surface.radius), counts[0])
    if isinstance(surface, Ring):
        radius = float(surface.radius)
        surface = Torus(radius, _WIRE * radius)
    places, marks = _grid(surface, _domain(surface, touched, size, within), counts)
    points = places.reshape(-1, 3)
    triangles = _triangles(points, counts)
    normals = _normals(points, triangles)
    if _faces(points, normals, touched, outward) < 0:
        normals, triangles = -normals, triangles[:, ::-1]
    used, corners = np.unique(triangles, return_inverse=True)
    return Mesh(
        points[used],
        normals[used],
        marks[used],
        corners.reshape(-1, 3),
        _cells(places),
    )


def body_mesh(
    surface: AbstractSurface,
    touched: np.ndarray,
    outward: np.ndarray,
    size: float,
    within: np.ndarray | None = None,
) -> Mesh:
    """A body: :func:`surface_mesh`, or a plate where it is flat."""
    if surface.is_flat:
        return plate_mesh(touched, size)
    return surface_mesh(surface, touched, outward, size, within=within)


def plate_mesh(touched: np.ndarray, size: float) -> Mesh:
    """A plate whose upper face, z = 0, is the surface of a flat body.

    Args:
        touched: Points of the face that met the base [m], shape (k, 3), k > 0.
        size: Least half width [m].
    """
    low, high = touched[:, :2].min(axis=0), touched[:, :2].max(axis=0)
    middle, half = 0.5 * (low + high), np.maximum(0.5 * (high - low) + size / 4, size)
    middle = np.append(middle, -0.05 * size)
    half = np.append(half, 0.05 * size)
    square = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], dtype=float)
    faces: list[np.ndarray] = []
    normals: list[np.ndarray] = []
    for axis in range(3):
        for side in (1.0, -1.0):
            corners = np.insert(square if side > 0 else square[::-1], axis, side, 1)
            if axis == 1:  # (z, x) is the right-handed pair round y, not (x, z)
                corners = corners[::-1]
            faces.append(middle + half * corners)
            normals.append(np.tile(side * np.eye(3)[axis], (4, 1)))
    points = np.concatenate(faces)
    starts = 4 * np.arange(6)[:, None]
    halves = np.array([[0, 1, 2], [0, 2, 3]])
    triangles = np.concatenate([starts + half_face for half_face in halves])
    marks = 0.5 + 0.5 * ((points - middle) / half)[:, :2]
    return Mesh(points, np.concatenate(normals), marks, triangles, (8, 8))


def body_size(body: Body, touched: np.ndarray) -> float:
    """How large a body is, as far as its numbers tell [m].

    Args:
        body: The body.
        touched: Points of it that met the base [m], body axes, shape (k, 3).

    Returns:
        The larger of its reach from the mass centre and its radius of gyration.
    """
    reach = np.linalg.norm(touched - np.asarray(body.center_of_mass), axis=1)
    gyration = np.sqrt(0.5 * np.trace(np.asarray(body.inertia)) / float(body.mass))
    return float(max(np.max(reach, initial=0.0), 1.5 * gyration))


def _domain(
    surface: AbstractSurface,
    touched: np.ndarray,
    size: float,
    within: np.ndarray | None,
) -> np.ndarray:
    """Ranges of the chart to draw, shape (2, 2)."""
    domain = np.asarray(surface.chart_domain, dtype=float)
    low, high = touched.min(axis=0) - size, touched.max(axis=0) + size
    if within is not None:  # but all that was touched
        low = np.maximum(low, np.minimum(within[0], touched.min(axis=0)))
        high = np.minimum(high, np.maximum(within[1], touched.max(axis=0)))
    if isinstance(surface, Cone):
        reach = np.max(np.hypot(touched[:, 0], touched[:, 1])) + size
        domain = np.array([[0.0, reach], [-np.pi, np.pi]])
    elif surface.is_height:
        domain = np.stack([low[:2], high[:2]], axis=1)
    elif isinstance(surface, Cylinder):
        domain[1] = low[2], high[2]
    elif isinstance(surface, Revolution) and not any(surface.poles):
        domain[0] = _used(surface, domain[0], touched, size)
    return domain


def _used(
    surface: Revolution, s: np.ndarray, touched: np.ndarray, size: float
) -> np.ndarray:
    """The part of a meridian without ends that a motion uses."""
    first, last = float(s[0]), float(s[1])
    places = np.linspace(first - 2 * (last - first), last + 2 * (last - first), 501)
    height = chart_points(surface, np.stack([places, 0 * places], axis=1))[:, 2]
    within = (height > touched[:, 2].min() - size) & (
        height < touched[:, 2].max() + size
    )
    within |= (places >= first) & (places <= last)
    return np.array([places[within].min(), places[within].max()])


def chart_points(surface: AbstractSurface, q: np.ndarray) -> np.ndarray:
    """Points of a surface's chart.

    Args:
        surface: The surface.
        q: Chart coordinates, shape (n, 2).

    Returns:
        [m], owner's axes, shape (n, 3); NaN where the chart has none.
    """
    like = jax.tree.leaves(eqx.filter(surface, eqx.is_inexact_array))
    dtype = like[0].dtype if like else jnp.result_type(float)
    points = np.asarray(_on_chart(surface, jnp.asarray(q, dtype)), dtype=float)
    return np.where(np.isfinite(points), points, np.nan)


@for_one_call
def _on_chart(surface: AbstractSurface, q: Float[Array, "n 2"]) -> Float[Array, "n 3"]:
    return jax.vmap(surface.chart)(q)


def _grid(
    surface: AbstractSurface, domain: np.ndarray, counts: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """Points spread evenly, shape (n1, n2, 3), and their marks, shape (n1 n2, 2)."""
    lines = [
        np.linspace(float(low), float(high), count)
        for (low, high), count in zip(domain, counts, strict=True)
    ]
    for left in (2, 1, 0):
        q = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, 2)
        places = chart_points(surface, q).reshape(*counts, 3)
        if left:
            lines = [_evened(lines[a], np.moveaxis(places, a, 0)) for a in range(2)]
    marks = [np.linspace(0.0, 1.0, n) for n in counts]
    return places, np.stack(np.meshgrid(*marks, indexing="ij"), axis=-1).reshape(-1, 2)


def _evened(line: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Move the values of a coordinate to where arc and bend ask for them.

    Args:
        line: The coordinate's values, shape (n,).
        places: Points, the coordinate along the first axis, shape (n, m, 3).
    """
    step = np.diff(places, axis=0)
    length = np.linalg.norm(step, axis=-1)
    arc = np.nansum(length, axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        along = step / length[..., None]
    turn = np.zeros(len(line))
    turn[1:-1] = np.nansum(np.linalg.norm(np.diff(along, axis=0), axis=-1), axis=1)
    bend = 0.5 * (turn[1:] + turn[:-1])
    shares: list[np.ndarray] = [x / x.sum() for x in (arc, bend) if x.sum() > 0]
    if not shares:
        return line
    density = sum(shares)
    density = density + 0.05 * np.mean(density)
    reached = np.concatenate([[0.0], np.cumsum(density)])
    return np.interp(np.linspace(0.0, float(reached[-1]), len(line)), reached, line)


def _triangles(points: np.ndarray, counts: tuple[int, int]) -> np.ndarray:
    """Two triangles for each square of the grid, except those without an area."""
    number = np.arange(counts[0] * counts[1]).reshape(counts)
    a, b = number[:-1, :-1].ravel(), number[1:, :-1].ravel()
    c, d = number[1:, 1:].ravel(), number[:-1, 1:].ravel()
    corners = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    p = points[corners]
    area = np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1)
    whole = np.isfinite(area)
    return corners[whole & (area > 1e-9 * np.max(area[whole], initial=0.0))]


def _normals(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Mean normals of the triangles round each point; seams and poles are closed."""
    finite = np.isfinite(points).all(axis=1)
    if not finite.any():
        return np.zeros_like(points)
    grain = 1e-6 * max(np.max(np.ptp(points[finite], axis=0)), 1e-300)
    keys = np.rint(points / grain)
    same = np.unique(keys, axis=0, return_inverse=True)[1].ravel()
    p = points[triangles]
    areas = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    sums = np.zeros((len(points), 3))
    for corner in range(3):
        np.add.at(sums, same[triangles[:, corner]], areas)
    normals = sums[same]
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return normals / np.where(length > 0, length, 1.0)


def _faces(
    points: np.ndarray, normals: np.ndarray, touched: np.ndarray, outward: np.ndarray
) -> float:
    """Whether normals agree with those at the contact: positive, or negative."""
    some = np.linspace(0, len(touched) - 1, min(len(touched), 64)).astype(int)
    finite = np.isfinite(points).all(axis=1)
    points, normals = points[finite], normals[finite]
    if not len(points):
        return 0.0
    gaps = np.linalg.norm(points[None] - touched[some][:, None], axis=-1)
    return float(np.sum(normals[np.argmin(gaps, axis=1)] * outward[some]))


def _cells(places: np.ndarray) -> tuple[int, int]:
    """Squares of a pattern along both directions, of about equal sides and even."""
    lengths: list[float] = []
    for axis in range(2):
        step = np.linalg.norm(np.diff(places, axis=axis), axis=-1)
        lengths.append(float(np.max(np.nansum(step, axis=axis))))
    longest = max(lengths)
    first, second = (
        int(np.clip(2 * round(8 * x / longest), 4, 16)) if longest > 0 else 4
        for x in lengths
    )
    return first, second


def _disc(radius: float, count: int) -> Mesh:
    """A thin lens whose edge is the sharp rim itself."""
    angle = np.linspace(-np.pi, np.pi, count)
    turn = (angle + np.pi) / (2 * np.pi)
    points: list[np.ndarray] = []
    normals: list[np.ndarray] = []
    marks: list[np.ndarray] = []
    triangles: list[np.ndarray] = []
    for side in (1.0, -1.0):
        # a flat face and a bevel: radii and heights of both ends, slope of the normal
        for r, z, lean in (
            ((0.0, 0.96), (0.008, 0.008), 0.0),
            ((0.96, 1.0), (0.008, 0.0), 0.2),
        ):
            band = [_round(radius * r[k], side * radius * z[k], angle) for k in (0, 1)]
            start = sum(len(p) for p in points)
            points.append(np.concatenate(band))
            normal = _round(lean, side, angle) / np.hypot(lean, 1.0)
            normals.append(np.tile(normal, (2, 1)))
            marks.append(np.stack([np.tile(turn, 2), np.repeat(r, count)], axis=1))
            corners = _triangles(points[-1], (2, count))
            triangles.append(start + (corners if side > 0 else corners[:, ::-1]))
    return Mesh(
        np.concatenate(points),
        np.concatenate(normals),
        np.concatenate(marks),
        np.concatenate(triangles),
        (16, 4),
    )


def _round(r: float, z: float, angle: np.ndarray) -> np.ndarray:
    """A circle of radius r at height z, shape (n, 3)."""
    return np.stack([r * np.cos(angle), r * np.sin(angle), np.full_like(angle, z)], 1)
