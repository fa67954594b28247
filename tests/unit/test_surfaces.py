"""Every surface of the catalogue: closed forms, charts, pole-free coordinates."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk
from rollkane.geometry.local_geometry import travel
from rollkane.geometry.surfaces import AbstractPointSurface, Ball
from rollkane.geometry.surfaces.kinds import _FEW

# first and second derivatives of functions of order one: 1e-12 is 1e4 roundings
TIGHT = 1e-12


def ball(s):
    return jnp.stack([0.3 * jnp.sin(s), -0.3 * jnp.cos(s)])


SURFACES = {
    "plane": rk.Plane(),
    "sphere": rk.Sphere(0.3, (0.1, 0.2, 0.3)),
    "cavity": rk.Sphere(0.3, inside=True),
    "ellipsoid": rk.Ellipsoid((0.5, 0.3, 0.2), (0.1, 0.0, 0.0)),
    "ellipsoid cavity": rk.Ellipsoid((0.5, 0.3, 0.2), inside=True),
    "torus": rk.Torus(0.5, 0.2),
    "tube": rk.Torus(0.5, 0.2, inside=True),
    "cylinder": rk.Cylinder(0.4),
    "pipe": rk.Cylinder(0.4, inside=True),
    "cone": rk.Cone(0.7),
    "funnel": rk.Cone(0.7, inside=True),
    "graph": rk.Graph(lambda x, y, p: p * x * x + jnp.sin(y) * x, 0.3),
    "chart": rk.Parametric(
        lambda u, v: jnp.stack(
            [jnp.cos(u) * jnp.cos(v), jnp.sin(u) * jnp.cos(v), jnp.sin(v)]
        )
    ),
    "direction": rk.Parametric(
        lambda d: d * (1.0 + 0.2 * d[0] ** 2), of_direction=True
    ),
    "implicit": rk.Implicit(lambda x, y, z: x * x + 2 * y * y + 3 * z**4 - 0.1),
    "closed revolution": rk.Revolution(ball),
    "bowl": rk.Revolution(lambda s: (s, s * s), domain=(0.0, 1.0), inside=True),
    "dome": rk.Revolution(lambda s: (1.0 - s, s * (2.0 - s)), domain=(0.0, 1.0)),
    "diabolo": rk.Revolution(lambda s: (0.2 + 0.1 * s * s, s), domain=(-0.5, 0.5)),
}
CHARTS = {name: s for name, s in SURFACES.items()} | {"rim": rk.DiscEdge(0.3)}


def coordinates(surface, seed=0):
    samples = np.asarray(surface.samples())
    return jnp.asarray(samples[(7 * seed + 123) % len(samples)])


@pytest.mark.parametrize("name", SURFACES)
def test_position_moves_by_lengths_and_normal_by_frame_rates(name):
    """d rho = E L x and d e3 = -E W x along the coordinate rates of x."""
    surface = SURFACES[name]
    u = coordinates(surface)
    geometry = surface.geometry(u)
    for x in jnp.eye(2):
        rates = surface.coordinate_rates(u, geometry, x)
        moved = jax.jvp(surface.geometry, (u,), (rates,))[1]
        np.testing.assert_allclose(moved.position, travel(geometry, x), atol=TIGHT)
        turned = -geometry.frame[:, :2] @ (geometry.frame_rates @ x)
        np.testing.assert_allclose(moved.normal, turned, atol=10 * TIGHT)


@pytest.mark.parametrize("name", CHARTS)
def test_frames_are_right_handed_and_orthonormal(name):
    surface = CHARTS[name]
    found = [
        surface.geometry(coordinates(surface)),
        surface.chart_geometry(jnp.array([0.4, 0.3])),
    ]
    for geometry in found:
        E = np.asarray(geometry.frame)
        np.testing.assert_allclose(E.T @ E, np.eye(3), atol=TIGHT)
        np.testing.assert_allclose(np.linalg.det(E), 1.0, atol=TIGHT)


@pytest.mark.parametrize("name", CHARTS)
def test_chart_geometry_equals_its_definition(name):
    """L, W and gam of the chart against autodiff of the chart's own frame."""
    surface = CHARTS[name]
    q = jnp.array([0.4, 0.3])
    geometry = surface.chart_geometry(q)
    moves = jax.jacfwd(surface.chart_geometry)(q)
    E = geometry.frame
    np.testing.assert_allclose(moves.position, E[:, :2] @ geometry.lengths, atol=TIGHT)
    np.testing.assert_allclose(
        E[:, :2].T @ moves.frame[:, 2], -geometry.frame_rates, atol=10 * TIGHT
    )
    np.testing.assert_allclose(
        E[:, 1] @ moves.frame[:, 0], geometry.spin_rates, atol=10 * TIGHT
    )


@pytest.mark.parametrize("name", SURFACES)
def test_chart_and_coordinates_describe_one_surface(name):
    """Same point, outward normal, curvatures: found again by locate."""
    surface = SURFACES[name]
    by_chart = surface.chart_geometry(jnp.array([0.4, 0.3]))
    found = surface.geometry(surface.locate(by_chart.position))
    np.testing.assert_allclose(found.position, by_chart.position, atol=1e-10)
    np.testing.assert_allclose(found.normal, by_chart.normal, atol=1e-9)
    np.testing.assert_allclose(
        found.principal_curvatures, by_chart.principal_curvatures, atol=1e-7
    )


@pytest.mark.parametrize(
    ("surface", "point", "normal", "curvatures"),
    [
        (rk.Sphere(0.5), (0.5, 0, 0), (1, 0, 0), (-2, -2)),
        (rk.Sphere(0.5, inside=True), (0.5, 0, 0), (-1, 0, 0), (2, 2)),
        # at the end of axis a: a/b^2 and a/c^2
        (rk.Ellipsoid((0.5, 0.4, 0.2)), (0.5, 0, 0), (1, 0, 0), (-12.5, -3.125)),
        (rk.Cylinder(0.5), (0, 0.5, 3.0), (0, 1, 0), (-2, 0)),
        (rk.Cylinder(0.5, inside=True), (0, 0.5, 3.0), (0, -1, 0), (0, 2)),
        (rk.Torus(0.5, 0.1), (0.6, 0, 0), (1, 0, 0), (-10, -1 / 0.6)),
        (rk.Torus(0.5, 0.1), (0.4, 0, 0), (-1, 0, 0), (-10, 1 / 0.4)),
        (rk.Plane(), (3.0, 2.0, 0), (0, 0, 1), (0, 0)),
        (rk.Graph(lambda x, y: x * x - y * y), (0, 0, 0), (0, 0, 1), (-2, 2)),
        # a funnel of slope 1 from above: curved once, by cos(45)/r towards the axis
        (
            rk.Cone(1.0, inside=True),
            (1.0, 0, 1.0),
            (-(0.5**0.5), 0, 0.5**0.5),
            (0, 0.5**0.5),
        ),
        (rk.Cone(1.0), (1.0, 0, 1.0), (0.5**0.5, 0, -(0.5**0.5)), (-(0.5**0.5), 0)),
        (SURFACES["closed revolution"], (0.3, 0, 0), (1, 0, 0), (-1 / 0.3, -1 / 0.3)),
        (SURFACES["bowl"], (0, 0, 0), (0, 0, 1), (2, 2)),
        (SURFACES["dome"], (0, 0, 1.0), (0, 0, 1), (-2, -2)),
        (SURFACES["diabolo"], (0.2, 0, 0), (1, 0, 0), (-5, 0.2)),
        (
            rk.Implicit(lambda p: jnp.sum(p * p) - 0.25),
            (0, 0.5, 0),
            (0, 1, 0),
            (-2, -2),
        ),
    ],
)
def test_closed_forms(surface, point, normal, curvatures):
    point = jnp.asarray(point, float)
    geometry = surface.geometry(surface.locate(point))
    np.testing.assert_allclose(geometry.position, point, atol=1e-10)
    np.testing.assert_allclose(geometry.normal, normal, atol=1e-10)
    np.testing.assert_allclose(geometry.principal_curvatures, curvatures, atol=1e-8)


def test_forms_of_a_chart():
    """First and second form of a torus in its angles: closed forms, both signs."""
    q = jnp.array([0.3, 0.8])
    ring = 0.5 + 0.2 * np.cos(0.8)
    geometry = rk.Torus(0.5, 0.2).chart_geometry(q)
    np.testing.assert_allclose(
        geometry.first_form, np.diag([ring**2, 0.04]), atol=TIGHT
    )
    second = np.diag([-ring * np.cos(0.8), -0.2])
    np.testing.assert_allclose(geometry.second_form, second, atol=TIGHT)
    inside = rk.Torus(0.5, 0.2, inside=True).chart_geometry(q)
    np.testing.assert_allclose(inside.second_form, -second, atol=TIGHT)


def test_rim_is_a_front():
    """Theory 8.1: L = diag(a cos q2 / cos q2, 0) in the rim's chart; W regular."""
    q = jnp.array([0.7, 0.4])
    geometry = rk.DiscEdge(0.3).chart_geometry(q)
    np.testing.assert_allclose(geometry.lengths, np.diag([0.3, 0.0]), atol=TIGHT)
    np.testing.assert_allclose(
        geometry.frame_rates, np.diag([-np.cos(0.4), -1.0]), atol=TIGHT
    )
    np.testing.assert_allclose(geometry.spin_rates, [np.sin(0.4), 0.0], atol=TIGHT)


@pytest.mark.parametrize(
    "name", [n for n, s in SURFACES.items() if isinstance(s, AbstractPointSurface)]
)
def test_point_with_a_given_normal_is_found(name):
    surface = SURFACES[name]
    wanted = surface.geometry(coordinates(surface, 3)).normal
    found = jax.jit(lambda n: surface.geometry(surface.find_normal(n)).normal)(wanted)
    np.testing.assert_allclose(found, wanted, atol=1e-9)


@pytest.mark.parametrize("name", ["chart", "direction", "implicit"])
def test_searches_that_leave_nothing_have_derivatives(name):
    """From a sample on: of the nearest point across, of the normal that is asked."""
    surface = SURFACES[name]
    place = surface.geometry(coordinates(surface, 3))
    across = jnp.eye(3) - jnp.outer(place.normal, place.normal)

    def nearest(p):
        return surface.geometry(surface.locate(p)).position

    def facing(n):
        found = surface.find_normal(n / jnp.linalg.norm(n))
        return surface.geometry(found).normal

    # what a search leaves, 1e-9, by curvatures of at most 20 / m
    moved = jax.jit(jax.jacfwd(nearest))(place.position)
    np.testing.assert_allclose(moved, across, atol=2e-8)
    turned = jax.jit(jax.jacrev(facing))(place.normal)
    np.testing.assert_allclose(turned, across, atol=2e-8)


@pytest.mark.parametrize("place", [(0.0, 0.0, -1.0), (0.0, 0.0, 1.0), (0.6, 0.0, 0.8)])
def test_points_of_an_egg_move_with_their_direction(place):
    """Also at its poles, whose meridians all begin alike."""
    egg = rk.Revolution(lambda s: (0.1 * jnp.sin(s), -0.12 * jnp.cos(s)))
    moved = jax.jacfwd(egg.point)(jnp.asarray(place))
    # (0.1, 0.1, -0.12) times the direction, of which what is across it counts
    across = np.eye(3) - np.outer(place, place)
    np.testing.assert_allclose(
        moved, np.diag([0.1, 0.1, -0.12]) @ across, rtol=0, atol=1e-15
    )


@pytest.mark.parametrize("off", [-0.2, 0.1, 0.5])
@pytest.mark.parametrize("kind", ["chart", "revolution"])
def test_the_nearest_point_moves_as_its_curvatures_say(kind, off):
    """Of a point off the surface: by 1 / (1 + off * curvature) along each of them."""
    if kind == "chart":
        egg = rk.Parametric(
            lambda q: jnp.stack(
                [
                    jnp.cos(q[1]) * jnp.cos(q[0]),
                    jnp.cos(q[1]) * jnp.sin(q[0]),
                    0.8 * jnp.sin(q[1]),
                ]
            )
        )
    else:
        egg = rk.Revolution(lambda s: (jnp.sin(s), -0.8 * jnp.cos(s)))
    s = 2.4  # parameter of the meridian: (sin s, -0.8 cos s) in the plane y = 0
    place = jnp.asarray([np.sin(s), 0.0, -0.8 * np.cos(s)])
    speed = np.hypot(np.cos(s), 0.8 * np.sin(s))
    along = np.array([np.cos(s), 0.0, 0.8 * np.sin(s)]) / speed
    normal = np.array([0.8 * np.sin(s), 0.0, -np.cos(s)]) / speed
    # an ellipse's own, and the share of 1 / radius that its normal leaves (Meusnier)
    bent = 0.8 / speed**3, normal[0] / np.sin(s)
    ways = along, np.array([0.0, 1.0, 0.0])
    shares = (1.0 / (1.0 + off * k) for k in bent)
    known = sum(x * np.outer(e, e) for x, e in zip(shares, ways, strict=True))
    nearest = lambda p: egg.geometry(egg.locate(p)).position
    moved = jax.jit(jax.jacfwd(nearest))(place + off * normal)
    # roundings, over 1 + off * curvature >= 0.6
    np.testing.assert_allclose(moved, known, rtol=0, atol=1e-13)


@pytest.mark.parametrize("height", [-1.0, 1.0])
def test_a_normal_at_a_pole_is_found_with_its_derivative(height):
    """An egg on either end: its point moves by the radius of curvature, a^2 / c."""
    egg = rk.Revolution(lambda s: (0.1 * jnp.sin(s), -0.12 * jnp.cos(s)))

    def touched(n):
        return egg.geometry(egg.find_normal(n / jnp.linalg.norm(n))).position

    moved = jax.jit(jax.jacfwd(touched))(jnp.array([0.0, 0.0, height]))
    # the search ends within 1e-9
    np.testing.assert_allclose(moved, np.diag([1.0, 1.0, 0.0]) / 12.0, atol=1e-9)


def test_a_search_from_a_place_stays_on_its_line():
    """Of a cylinder a whole line has a normal: the place on it is that of the seed."""
    normal = jnp.array([np.cos(0.7), np.sin(0.7), 0.0])
    search = lambda u: rk.Cylinder(0.1).find_normal_from(normal, u)
    seed = search(jnp.array([0.2, 0.3]))
    point = rk.Cylinder(0.1).geometry(seed)
    # Newton's method to rounding
    np.testing.assert_allclose(point.normal, normal, rtol=0, atol=1e-14)
    slopes = np.asarray(jax.jacfwd(search)(seed))
    moved = np.asarray(jax.jacfwd(lambda u: rk.Cylinder(0.1).point(search(u)))(seed))
    # along the line the place moves as its seed, across it not at all; slack of 1e-14
    assert np.linalg.matrix_rank(slopes, tol=1e-6) == 1
    assert np.abs(moved[2]).max() > 0.99
    np.testing.assert_allclose(moved[:2], 0.0, rtol=0, atol=1e-12)


def test_poles_of_a_meridian_are_regular():
    """At and beside each pole the curvatures are those of the sphere."""
    surface = SURFACES["closed revolution"]
    for u in ([0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [1e-6, 0.0, -1.0], [0.0, 1e-12, 1.0]):
        geometry = surface.geometry(jnp.array(u))
        # beside a pole sin(s) is known to 1e-16 / 1e-6 relative
        np.testing.assert_allclose(
            geometry.principal_curvatures, [-1 / 0.3, -1 / 0.3], rtol=1e-8
        )


@pytest.mark.parametrize("name", ["closed revolution", "bowl", "dome"])
def test_derivatives_at_the_very_pole(name):
    """Moving off the pole changes point and normal as L and W say."""
    surface = SURFACES[name]
    u = jnp.array([0.0, 0.0, 1.0]) if surface.coordinate_count == 3 else jnp.zeros(2)
    geometry = surface.geometry(u)
    for x in jnp.eye(2):
        rates = surface.coordinate_rates(u, geometry, x)
        moved = jax.jvp(surface.geometry, (u,), (rates,))[1]
        np.testing.assert_allclose(moved.position, travel(geometry, x), atol=TIGHT)
        turned = -geometry.frame[:, :2] @ (geometry.frame_rates @ x)
        np.testing.assert_allclose(moved.normal, turned, atol=TIGHT)
        # and the frame stays one
        across = geometry.frame.T @ moved.frame
        np.testing.assert_allclose(across + across.T, 0.0, atol=TIGHT)
        np.testing.assert_allclose(across[2, :2], geometry.frame_rates @ x, atol=TIGHT)


BAD = {
    "negative radius": (lambda: rk.Sphere(-1.0), "Sphere.radius"),
    "text": (lambda: rk.Sphere("1.0"), "Sphere.radius"),
    "truth": (lambda: rk.Sphere(True), "Sphere.radius"),
    "NaN": (lambda: rk.DiscEdge(float("nan")), "DiscEdge.radius"),
    "complex": (lambda: rk.Cylinder(1j), "Cylinder.radius"),
    "two axes": (lambda: rk.Ellipsoid((1.0, 2.0)), "Ellipsoid.semi_axes"),
    "centre": (lambda: rk.Sphere(1.0, (0.0, 0.0)), "Sphere.center"),
    "inside": (lambda: rk.Sphere(1.0, inside=1), "Sphere.inside"),
    "spindle": (lambda: rk.Torus(0.1, 0.2), "Torus.minor_radius"),
    "flat cone": (lambda: rk.Cone(0.0), "Cone.slope"),
    "no function": (lambda: rk.Graph(3.0), "Graph.f"),
    "signature": (lambda: rk.Graph(lambda: 0.0), "Graph.f"),
    "vector": (lambda: rk.Graph(lambda x, y: jnp.stack([x, y])), "Graph.f"),
    "math.sin": (lambda: rk.Graph(lambda x, y: __import__("math").sin(x)), "Graph.f"),
    "pair": (
        lambda: rk.Parametric(lambda u, v: jnp.stack([u, v])),
        "Parametric.position",
    ),
    "domain": (
        lambda: rk.Graph(lambda x, y: x, domain=((1.0, -1.0), (0.0, 1.0))),
        "Graph.domain",
    ),
    "size": (lambda: rk.Implicit(lambda p: p[0], size=-1.0), "Implicit.size"),
    "meridian": (lambda: rk.Revolution(lambda s: s), "Revolution.profile"),
    "poles": (
        lambda: rk.Revolution(ball, poles=(1, 0), rising=True),
        "Revolution.poles",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_input_names_field_value_and_remedy(name):
    make, field = BAD[name]
    with pytest.raises(rk.FieldError) as caught:
        make()
    error = caught.value
    assert error.field == field
    assert error.remedy
    assert "got" in str(error)


@pytest.mark.parametrize("radius", [0.1, 3.0])  # few samples are near, and most are
def test_distances_of_points_in_a_ball_are_those_of_all_samples(radius):
    bent = lambda p, q: jnp.stack([p, q, 0.2 * jnp.sin(3.0 * p) * jnp.cos(2.0 * q)])
    surface = rk.Parametric(bent, domain=((-2.0, 2.0), (-2.0, 2.0)))
    draw = np.random.default_rng(3)
    center = np.array([0.4, -0.7, 0.3])
    away = draw.normal(size=(200, 3))
    # in the ball, many of them next to its surface
    lengths = radius * draw.uniform(size=(200, 1)) ** (1 / 9)
    away = away / np.linalg.norm(away, axis=1, keepdims=True) * lengths
    points = jnp.asarray(center + away)
    samples = np.asarray(jax.vmap(surface.point)(jnp.asarray(surface.samples())))
    far = np.linalg.norm(samples - center, axis=1)
    assert (np.sum(far <= far.min() + 2.0 * radius) <= _FEW) == (radius < 1.0)
    within = Ball(jnp.asarray(center), jnp.asarray(radius))
    near = jax.vmap(surface.distances(points.dtype, within))(points)
    assert (near == jax.vmap(surface.distances(points.dtype))(points)).all()
