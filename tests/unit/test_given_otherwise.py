"""Bodies by their density, orientations of other programs, scenes compared and kept."""

import copy
import pickle

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import rollkane as rk
from rollkane.files.scene_files import builtin_scenes, load_scene
from rollkane.geometry.numpy_rotations import rotated

from ..quick import A_FEW, slow_but

RHO = 1200.0
# Sums of 16,384 products round by 1e-14 at most; Gauss-Legendre with 64 points in each
# half is exact to rounding for these charts.
EXACT = {"rtol": 1e-12, "atol": 0.0}


def sphere(r):
    mass = RHO * 4 / 3 * np.pi * r**3
    return mass, 0.4 * mass * r**2 * np.ones(3)


def ellipsoid(a, b, c):
    mass = RHO * 4 / 3 * np.pi * a * b * c
    return mass, mass / 5 * np.array([b**2 + c**2, a**2 + c**2, a**2 + b**2])


def torus(R, r):
    mass = RHO * 2 * np.pi**2 * R * r**2
    across = mass * (R**2 / 2 + 5 * r**2 / 8)
    return mass, np.array([across, across, mass * (R**2 + 3 * r**2 / 4)])


@pytest.mark.parametrize(
    ("surface", "closed_form"),
    [
        (rk.Sphere(0.3), sphere(0.3)),
        (rk.Ellipsoid((0.2, 0.3, 0.1)), ellipsoid(0.2, 0.3, 0.1)),
        (rk.Torus(0.3, 0.1), torus(0.3, 0.1)),
    ],
)
def test_closed_forms(surface, closed_form):
    body = rk.solid_body(RHO, surface)
    mass, moments = closed_form
    np.testing.assert_allclose(body.mass, mass, **EXACT)
    np.testing.assert_allclose(np.diag(body.inertia), moments, **EXACT)
    off = np.asarray(body.inertia)[~np.eye(3, dtype=bool)]
    assert not np.any(off)
    assert not np.any(body.center_of_mass)
    assert body.surface is surface


def shifted(q):
    """An ellipsoid about another point than the origin, turned about z."""
    u, v = q
    point = jnp.stack(
        [0.2 * jnp.cos(v) * jnp.cos(u), 0.3 * jnp.cos(v) * jnp.sin(u), 0.1 * jnp.sin(v)]
    )
    c, s = jnp.cos(0.4), jnp.sin(0.4)
    turned = jnp.stack(
        [c * point[0] - s * point[1], s * point[0] + c * point[1], point[2]]
    )
    return turned + jnp.array([0.05, -0.02, 0.03])


def test_a_body_off_its_origin_and_axes():
    half = np.pi / 2
    surface = rk.Parametric(shifted, domain=((-np.pi, np.pi), (-half, half)))
    body = rk.solid_body(RHO, surface)
    mass, moments = ellipsoid(0.2, 0.3, 0.1)
    np.testing.assert_allclose(body.mass, mass, **EXACT)
    np.testing.assert_allclose(body.center_of_mass, [0.05, -0.02, 0.03], rtol=1e-11)
    R = Rotation.from_euler("z", 0.4).as_matrix()
    np.testing.assert_allclose(
        body.inertia, R @ np.diag(moments) @ R.T, rtol=0, atol=1e-12 * moments.max()
    )


def test_it_is_differentiable():
    mass, slope = jax.value_and_grad(lambda r: rk.solid_body(RHO, rk.Sphere(r)).mass)(
        0.3
    )
    np.testing.assert_allclose(slope, 3 * mass / 0.3, **EXACT)  # mass goes by r^3


@pytest.mark.parametrize(
    "surface", [rk.Plane(), rk.Cylinder(0.1), rk.DiscEdge(0.1), rk.Ring(0.1)]
)
def test_what_is_not_closed_has_no_volume(surface):
    with pytest.raises(rk.FieldError, match="is not closed, and has no volume"):
        rk.solid_body(RHO, surface)


def test_a_density_is_positive():
    with pytest.raises(rk.FieldError, match=r"solid_body\.density"):
        rk.solid_body(0.0, rk.Sphere(0.1))
    with pytest.raises(rk.FieldError, match="must be a surface"):
        rk.solid_body(RHO, 0.1)


# -- orientations ----------------------------------------------------------------------


def same(quaternion, rotation):
    """Whether a quaternion is a rotation of SciPy's, but for its sign."""
    wanted = rotation.as_quat(scalar_first=True)
    assert abs(np.dot(np.asarray(quaternion), wanted)) == pytest.approx(1.0, abs=1e-14)


@pytest.mark.parametrize("sequence", ["ZXZ", "zxz", "ZYX", "zyx", "XYX", "yz", "X"])
def test_euler_angles_are_scipy_s(sequence):
    angles = [0.3, -1.1, 2.0][: len(sequence)]
    same(
        rk.orientation_from_euler(sequence, angles),
        Rotation.from_euler(sequence, angles),
    )
    degrees = np.degrees(angles)
    found = rk.orientation_from_euler(sequence, degrees, degrees=True)
    same(found, Rotation.from_euler(sequence, angles))


def test_matrices_and_other_orders_are_scipy_s():
    for seed in range(5):
        rotation = Rotation.random(rng=np.random.default_rng(seed))
        same(rk.orientation_from_matrix(rotation.as_matrix()), rotation)
        same(rk.orientation_from_xyzw(rotation.as_quat()), rotation)
        same(rk.orientation_from_scipy(rotation), rotation)


def test_columns_are_the_body_axes():
    rotation = Rotation.from_euler("ZXZ", [0.3, 0.4, 0.5])
    quaternion = np.asarray(rk.orientation_from_matrix(rotation.as_matrix()))
    x = rotated(quaternion, np.array([1.0, 0.0, 0.0]))
    np.testing.assert_allclose(x, rotation.as_matrix()[:, 0], atol=1e-15)


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: rk.orientation_from_matrix(2 * np.eye(3)), "is no rotation matrix"),
        (lambda: rk.orientation_from_matrix(-np.eye(3)), "is no rotation matrix"),
        (lambda: rk.orientation_from_matrix(np.eye(2)), "3 x 3"),
        (lambda: rk.orientation_from_xyzw((1, 1, 0, 0)), "of unit length"),
        (lambda: rk.orientation_from_scipy((0, 0, 0, 1)), "is no rotation of SciPy"),
        (
            lambda: rk.orientation_from_scipy(Rotation.identity(3)),
            "are several rotations",
        ),
        (lambda: rk.orientation_from_euler("ZxZ", (0, 0, 0)), "no sequence of axes"),
        (lambda: rk.orientation_from_euler("abc", (0, 0, 0)), "no sequence of axes"),
        (lambda: rk.orientation_from_euler("ZXZ", (0, 0)), "3 angles in radians"),
    ],
)
def test_what_is_no_orientation_is_refused(call, says):
    with pytest.raises(rk.FieldError, match=says):
        call()


def test_they_are_differentiable():
    turn = lambda angle: rk.orientation_from_euler("Z", angle)
    slope = jax.jacfwd(turn)(0.8)
    np.testing.assert_allclose(slope, [-0.5 * np.sin(0.4), 0, 0, 0.5 * np.cos(0.4)])
    matrix = jax.jit(rk.orientation_from_matrix)(jnp.eye(3))
    np.testing.assert_array_equal(np.abs(matrix), [1.0, 0.0, 0.0, 0.0])


# -- scenes and results as values ------------------------------------------------------


@pytest.mark.parametrize("name", slow_but(A_FEW, builtin_scenes()))
def test_scenes_and_starts_are_values(name):
    one, two = load_scene(name), load_scene(name)
    for a, b in ((one.scene, two.scene), (one.start, two.start)):
        assert a == b
        assert pickle.loads(pickle.dumps(a)) == a
        assert copy.deepcopy(a) == a
    heavier = load_scene(name, {"body.mass": "77.0"}).scene
    assert heavier != one.scene


def test_results_are_values():
    file = load_scene("ball-on-plane")
    times = [0.0, 0.1, 0.2]
    run = rk.simulate(file.scene, file.start, times)
    many = rk.ensemble(file.scene, [file.start, file.start], times)
    for result in (run, many):
        again = pickle.loads(pickle.dumps(result))
        assert again == result
        np.testing.assert_array_equal(again.position, result.position)
    assert rk.simulate(file.scene, file.start, [0.0, 0.1, 0.3]) != run


@pytest.mark.parametrize("name", slow_but(A_FEW, builtin_scenes()))
def test_a_scene_describes_itself(name):
    file = load_scene(name)
    text = file.scene.describe()
    assert f"{float(file.scene.body.mass):.4g} kg" in text
    assert type(file.scene.body.surface).__name__ in text
    assert "at rest" in text or "moving by" in text
    assert "object at 0x" not in text
    assert text.count("\n") >= 4
