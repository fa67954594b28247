"""Meshes for pictures lie on their surfaces and face outwards."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk
from rollkane.pictures.mesh import Mesh, body_size, plate_mesh, surface_mesh


def _round(p):
    return jnp.sqrt(p[0] * p[0] + p[1] * p[1])


def _ellipsoid(p):
    return (p[0] / 0.2) ** 2 + (p[1] / 0.03) ** 2 + (p[2] / 0.02) ** 2 - 1.0


def _egg(s):
    return jnp.stack([0.1 * jnp.sin(s), 0.15 * jnp.cos(s)])


def _globe(u, v):
    r = 0.3 * jnp.cos(v)
    return jnp.stack([r * jnp.cos(u), r * jnp.sin(u), 0.3 * jnp.sin(v)])


class Case(NamedTuple):
    """A surface, its level function (growing out of the material), a point of it."""

    surface: rk.surfaces.AbstractSurface
    level: object
    touched: tuple[float, float, float]


CASES = {
    "plane": Case(rk.Plane(), lambda p: p[2], (0.3, 0.1, 0.0)),
    "sphere": Case(
        rk.Sphere(0.5, (0.1, 0.0, 0.0)),
        lambda p: (p[0] - 0.1) ** 2 + p[1] ** 2 + p[2] ** 2 - 0.25,
        (0.1, 0.0, 0.5),
    ),
    "cavity": Case(
        rk.Sphere(0.5, inside=True), lambda p: 0.25 - jnp.sum(p * p), (0, 0, -0.5)
    ),
    "ellipsoid": Case(rk.Ellipsoid((0.2, 0.03, 0.02)), _ellipsoid, (0, 0, 0.02)),
    "torus": Case(
        rk.Torus(0.5, 0.2),
        lambda p: (_round(p) - 0.5) ** 2 + p[2] ** 2 - 0.04,
        (0.7, 0.0, 0.0),
    ),
    "cylinder": Case(rk.Cylinder(0.2), lambda p: _round(p) - 0.2, (0.0, 0.2, 0.5)),
    "cone": Case(
        rk.Cone(0.5, inside=True), lambda p: p[2] - 0.5 * _round(p), (0.4, 0, 0.2)
    ),
    "graph": Case(
        rk.Graph(lambda x, y: x * x - y),
        lambda p: p[2] - p[0] ** 2 + p[1],
        (0.3, 0.1, -0.01),
    ),
    "revolution": Case(
        rk.Revolution(_egg),
        lambda p: (_round(p) / 0.1) ** 2 + (p[2] / 0.15) ** 2 - 1.0,
        (0.1, 0.0, 0.0),
    ),
    "vase": Case(
        rk.Revolution(
            lambda s: jnp.stack([0.3 + 0.1 * jnp.cos(s), 0.2 * s]), domain=(0.0, 4.0)
        ),
        lambda p: _round(p) - 0.3 - 0.1 * jnp.cos(p[2] / 0.2),
        (0.4, 0.0, 0.0),
    ),
    "parametric": Case(
        rk.Parametric(_globe), lambda p: jnp.sum(p * p) - 0.09, (0.3, 0.0, 0.0)
    ),
    "implicit": Case(rk.Implicit(_ellipsoid, size=0.3), _ellipsoid, (0, 0, 0.02)),
    "rim": Case(rk.DiscEdge(0.25), None, (0.25, 0.0, 0.0)),
}


@pytest.fixture(scope="module", params=CASES)
def drawn(request) -> tuple[Case, Mesh, np.ndarray]:
    case = CASES[request.param]
    touched = np.array([case.touched], dtype=float)
    if case.level is None:
        outward = touched / np.linalg.norm(touched)
    else:
        slope = np.asarray(jax.grad(case.level)(jnp.asarray(touched[0])))
        outward = (slope / np.linalg.norm(slope))[None]
    mesh = surface_mesh(case.surface, touched, outward, 0.1, (41, 21))
    return case, mesh, touched


def test_points_lie_on_the_surface(drawn):
    case, mesh, touched = drawn
    if case.level is None:  # the rim itself is met, the disc is decoration
        radius = np.hypot(mesh.points[:, 0], mesh.points[:, 1])
        assert np.max(radius) == pytest.approx(0.25, abs=1e-15)
        assert (mesh.points[radius > 0.2499, 2] == 0).all()
        return
    level, slope = eqx.filter_jit(jax.vmap(jax.value_and_grad(case.level)))(mesh.points)
    steepness = np.linalg.norm(slope, axis=1)
    away_from_tip = steepness > 0  # a cone's level has no slope at its tip
    gap = np.abs(level)[away_from_tip] / steepness[away_from_tip]
    assert np.max(gap) < 1e-12  # rounding of coordinates below a metre
    reach = np.linalg.norm(mesh.points - touched, axis=1)
    spacing = np.ptp(mesh.points, axis=0).max() / 10
    assert np.min(reach) < spacing


def test_normals_point_out_of_the_material(drawn):
    case, mesh, _ = drawn
    np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1.0, atol=1e-3)
    a, b, c = (mesh.points[mesh.triangles[:, k]] for k in range(3))
    faces = np.cross(b - a, c - a)
    corner = mesh.normals[mesh.triangles].mean(axis=1)
    assert (np.sum(faces * corner, axis=1) > 0).all()
    if case.level is None:
        return
    slope = np.asarray(eqx.filter_jit(jax.vmap(jax.grad(case.level)))(mesh.points))
    along = np.sum(slope * mesh.normals, axis=1)
    steepness = np.linalg.norm(slope, axis=1)
    finite = np.isfinite(steepness) & (np.hypot(*mesh.points[:, :2].T) > 1e-3)
    # the least is at the sharp ends of the stone, where one square turns by 20 degrees
    assert np.min((along / steepness)[finite]) > 0.9


def test_patterns_cover_the_surface(drawn):
    _, mesh, _ = drawn
    assert mesh.marks.min() >= 0
    assert mesh.marks.max() <= 1
    assert all(4 <= count <= 16 and count % 2 == 0 for count in mesh.cells)
    assert mesh.triangles.max() == len(mesh.points) - 1


def test_ends_are_drawn_where_the_motion_was():
    touched = np.array([[0.2, 0.0, -0.3], [0.2, 0.0, 2.0]])
    tube = surface_mesh(rk.Cylinder(0.2), touched, touched, 0.1, (9, 9))
    assert tube.points[:, 2].min() == pytest.approx(-0.4)
    assert tube.points[:, 2].max() == pytest.approx(2.1)


def test_a_surface_in_a_body_is_as_wide_as_the_body():
    """But all of it that was touched is drawn."""
    touched = np.array([[0.2, 0.0, -0.3], [0.2, 0.0, 0.4]])
    box = np.array([[-1.0, -1.0, -0.35], [1.0, 1.0, 0.3]])
    tube = surface_mesh(rk.Cylinder(0.2), touched, touched, 0.1, (9, 9), within=box)
    assert tube.points[:, 2].min() == pytest.approx(-0.35)  # not 0.1 further
    assert tube.points[:, 2].max() == pytest.approx(0.4)  # beyond the box


def test_places_without_a_point_are_left_out():
    bowl = rk.Graph(lambda x, y: -jnp.sqrt(0.25 - x * x - y * y))
    touched, up = np.array([[0.0, 0.0, -0.5]]), np.array([[0.0, 0.0, 1.0]])
    mesh = surface_mesh(bowl, touched, up, 0.5, (21, 21))
    assert np.isfinite(mesh.points).all()
    assert 100 < len(mesh.points) < 441
    nowhere = rk.Graph(lambda x, y: jnp.sqrt(-1.0 - x * x))
    assert surface_mesh(nowhere, touched, up, 0.5, (9, 9)).triangles.size == 0


def test_plate_is_a_box_below_its_face():
    plate = plate_mesh(np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]), 0.4)
    assert plate.points[:, 2].max() == pytest.approx(0.0, abs=1e-15)
    assert plate.points[:, 2].min() == pytest.approx(-0.04)
    a, b, c = (plate.points[plate.triangles[:, k]] for k in range(3))
    faces = np.cross(b - a, c - a)
    corner = plate.normals[plate.triangles].mean(axis=1)
    np.testing.assert_allclose(
        np.sum(faces * corner, axis=1), np.linalg.norm(faces, axis=1)
    )
    inside = np.array([0.5, 0.0, -0.02])
    assert (np.sum((a - inside) * corner, axis=1) > 0).all()


def test_size_of_a_body():
    body = rk.Body(2.0, np.diag([0.02, 0.02, 0.02]), rk.Sphere(0.3))
    assert body_size(body, np.array([[0.0, 0.0, -0.3]])) == pytest.approx(0.3)
    assert body_size(body, np.zeros((0, 3))) == pytest.approx(1.5 * np.sqrt(0.015))
