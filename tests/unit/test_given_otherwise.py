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


def ball(q):
    u, v = q
    return 0.1 * jnp.stack(
        [jnp.cos(u) * jnp.cos(v), jnp.sin(u) * jnp.cos(v), jnp.sin(v)]
    )


def flat_tube(q):
    """A ring of 0.3 m whose tube is 0.1 m wide and 1 mm high."""
    u, v = q
    r = 0.3 + 0.05 * jnp.cos(v)
    return jnp.stack([r * jnp.cos(u), r * jnp.sin(u), 5e-4 * jnp.sin(v)])


def uneven(q):
    """Twice around, at a rate that is not even."""
    return ball(jnp.stack([2.0 * q[0] + 0.3 * jnp.sin(q[0]), q[1]]))


TURN, RISE = (-np.pi, np.pi), (-np.pi / 2, np.pi / 2)
TWO, THREE = (-2 * np.pi, 2 * np.pi), (-3 * np.pi, 3 * np.pi)


@pytest.mark.parametrize(
    ("chart", "domain"),
    [
        (ball, (TWO, RISE)),
        (ball, (THREE, RISE)),
        (uneven, (TURN, RISE)),
        (flat_tube, (TURN, TWO)),
    ],
)
def test_what_a_chart_covers_twice_has_no_mass_of_two(chart, domain):
    """It has the flux of a closed surface, twice, and had twice the mass."""
    with pytest.raises(rk.FieldError, match="is covered more than once by its chart"):
        rk.solid_body(RHO, rk.Parametric(chart, domain=domain))


@pytest.mark.parametrize(
    ("chart", "domain", "volume"),
    [
        (ball, (TURN, RISE), 4 / 3 * np.pi * 1e-3),
        # its faces are nearer to each other than samples of either
        (flat_tube, (TURN, TURN), 2 * np.pi**2 * 0.3 * 0.05 * 5e-4),
    ],
)
def test_what_a_chart_covers_once(chart, domain, volume):
    body = rk.solid_body(RHO, rk.Parametric(chart, domain=domain))
    np.testing.assert_allclose(body.mass, RHO * volume, **EXACT)


def test_a_density_is_positive():
    with pytest.raises(rk.FieldError, match=r"solid_body\.density"):
        rk.solid_body(0.0, rk.Sphere(0.1))
    with pytest.raises(rk.FieldError, match="must be a surface"):
        rk.solid_body(RHO, 0.1)


# -- bodies from CAD -------------------------------------------------------------------

CLOUD = np.random.default_rng(3)
WEIGHTS = CLOUD.uniform(10.0, 50.0, 40)  # g
PLACES = CLOUD.normal([120.0, -40.0, 15.0], [30.0, 20.0, 9.0], (40, 3))  # mm


def second_moments(weights, places):
    """Sum of m r r^T: the integrals of squares and products."""
    return np.einsum("k,ki,kj->ij", weights, places, places)


def tensor_of(second):
    return np.trace(second) * np.eye(3) - second


@pytest.mark.parametrize("about", ["origin", "center of mass"])
@pytest.mark.parametrize("products", ["tensor", "integrals"])
def test_mass_properties_of_a_cloud_of_points(about, products):
    """Forty masses in g and mm on the model's axes: summed there, and on the body's."""
    mass, center = WEIGHTS.sum(), WEIGHTS @ PLACES / WEIGHTS.sum()
    point = center if about == "center of mass" else np.zeros(3)
    printed = tensor_of(second_moments(WEIGHTS, PLACES - point))
    if products == "integrals":
        printed = 2.0 * np.diag(np.diag(printed)) - printed
    origin = np.array([100.0, -30.0, 10.0])
    turn = Rotation.from_euler("ZXZ", [0.3, 0.8, -0.5])
    body = rk.body_from_cad(
        mass,
        printed,
        rk.Ellipsoid((0.2, 0.15, 0.1)),
        center_of_mass=center,
        about=about,
        products=products,
        units=("g", "mm"),
        origin=origin,
        orientation=rk.orientation_from_matrix(turn.as_matrix()),
    )
    own = 1e-3 * turn.inv().apply(PLACES - origin)  # m, on the surface's axes
    kilograms = 1e-3 * WEIGHTS
    middle = kilograms @ own / kilograms.sum()
    wanted = tensor_of(second_moments(kilograms, own - middle))
    np.testing.assert_allclose(body.mass, kilograms.sum(), rtol=1e-14)
    # about the origin the tensor is some ten times larger than what is left of it
    np.testing.assert_allclose(body.center_of_mass, middle, rtol=0, atol=1e-14)
    np.testing.assert_allclose(
        body.inertia, wanted, rtol=0, atol=1e-13 * np.trace(wanted)
    )


@pytest.mark.parametrize("product", ["tensor", "integrals"])
def test_a_cylinder_in_pounds_and_inches(product):
    mass, r, h = 3.0, 2.0, 5.0  # lb, in
    across = mass * (3 * r * r + h * h) / 12
    closed = np.diag([across, across, 0.5 * mass * r * r])
    body = rk.body_from_cad(
        mass,
        closed,
        rk.DiscEdge(2.0 * 0.0254),
        center_of_mass=(0, 0, 0),
        about="center of mass",
        products=product,
        units=("lb", "in"),
    )
    unit = 0.45359237 * 0.0254**2
    np.testing.assert_allclose(body.inertia, unit * closed, rtol=1e-14)
    assert not np.any(np.asarray(body.inertia)[~np.eye(3, dtype=bool)])


GIVEN = {
    "mass": 1.0,
    "inertia": np.diag([2.0, 3.0, 4.0]),
    "surface": rk.Sphere(0.5),
    "center_of_mass": (0.0, 0.0, 0.0),
    "about": "center of mass",
    "products": "tensor",
}
SKEW = [[2.0, 0.5, 0.0], [0.4, 3.0, 0.0], [0.0, 0.0, 4.0]]
OFF = {"center_of_mass": (0.0, 0.0, 1.0), "about": "origin"}


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        ({"about": "centroid"}, r"about: is not known.*center of mass\" or \"origin"),
        ({"products": "positive"}, r"products: is not known.*tensor.*integrals"),
        ({"units": ("kg", "parsec")}, r"units: are not known.*kg, g, t, lb and one of"),
        ({"units": "SI"}, "units: are not known"),
        ({"mass": 0.0}, r"body_from_cad\.mass"),
        ({"inertia": SKEW}, "must be symmetric"),
        ({"inertia": np.diag([2.0, 3.0, 6.0])}, "triangle inequality"),
        ({"inertia": np.diag([-2.0, 3.0, 4.0])}, "must be positive definite"),
        # about the centre of mass, but told to be about the origin, 1 m away
        (OFF | {"inertia": np.diag([0.9, 0.9, 0.2])}, "must be positive definite"),
        ({"orientation": (1.0, 1.0, 0.0, 0.0)}, "unit length"),
        ({"center_of_mass": (0.0, 0.0)}, r"center_of_mass.*shape \(3\)"),
        ({"surface": 0.1}, "must be a surface"),
    ],
)
def test_impossible_mass_properties_are_refused(changed, says):
    with pytest.raises(rk.FieldError, match=says):
        rk.body_from_cad(**(GIVEN | changed))


def test_mass_properties_are_differentiable():
    """By the centre of mass c, about the origin: of I_xx = I_O - m c^2 it is -2 m c."""

    def moment(c):
        far = OFF | {"center_of_mass": jnp.stack([0.0 * c, 0.0 * c, c])}
        return rk.body_from_cad(**(GIVEN | far)).inertia[0, 0]

    assert jax.grad(moment)(0.3) == pytest.approx(-0.6, rel=1e-14)


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
