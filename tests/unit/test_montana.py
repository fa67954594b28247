"""Contact kinematics of two surfaces: against charts by NumPy, and by definition."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk
from rollkane.geometry.rotations import rotation_matrix

from .test_surfaces import CHARTS, coordinates

NAMES = list(CHARTS)
# every surface rolls on another one, and another rolls on it
PAIRS = [(a, NAMES[(k + 7) % len(NAMES)]) for k, a in enumerate(NAMES)]
REST = [(a, b) for a in NAMES for b in NAMES if (a, b) not in PAIRS]
LONG = [("cylinder", "implicit"), ("implicit", "sphere")]
SLOW = [*LONG, *REST]
ALL = [
    pytest.param(*pair, marks=pytest.mark.slow) if pair in SLOW else pair
    for pair in PAIRS + REST
]
W, TURNED = np.array([0.8, -0.6, 1.1]), np.array([0.3, 0.5, -0.2])
SLIP = np.array([0.2, -0.1, 0.3])
ANGLE = 0.7


@functools.cache
def chart_of(name, seed):
    """Chart coordinates of a point, and the chart's first and second derivatives."""
    surface = CHARTS[name]
    u = inner(surface, seed)
    q = surface.chart_coordinates(u)
    first = jax.jacfwd(surface.chart)
    rho, rho_a, rho_ab = jax.jit(
        lambda q: (surface.chart(q), first(q), jax.jacfwd(first)(q))
    )(q)
    normal = np.asarray(surface.geometry(u).normal)
    if not surface.is_edge:  # of which the chart itself has none
        across = np.cross(*np.asarray(rho_a).T)
        normal = across / (np.linalg.norm(across) * np.sign(across @ normal))
    return u, *(np.asarray(x) for x in (q, rho, rho_a, rho_ab)), normal


def inner(surface, seed):
    """Coordinates of a point that is neither at an end nor at the edge of a chart."""
    for k in range(seed, 50):
        u = coordinates(surface, k)
        end = surface.extent(u)
        regular = surface.chart_geometry(surface.chart_coordinates(u)).regularity
        if (end is None or end > 0.1) and regular > 0.1:
            return u
    raise AssertionError


def forms(name, seed):
    """Frame, L, shape operator and gam by NumPy: theory (2.1), (2.2).

    By Gram-Schmidt; of longitude and latitude of a normal, e1 goes to the east.
    """
    _, q, _, rho_a, rho_ab, e3 = chart_of(name, seed)
    first = rho_a[:, 0]
    e1 = first / np.linalg.norm(first)
    gam = np.cross(e3, e1) @ rho_ab[:, 0, :] / np.linalg.norm(first)
    if CHARTS[name].is_by_normal:
        e1 = np.array([-np.sin(q[0]), np.cos(q[0]), 0.0])
        gam = np.array([np.sin(q[1]), 0.0])
    E = np.stack([e1, np.cross(e3, e1), e3], axis=1)
    L = E[:, :2].T @ rho_a
    h = np.einsum("m,mab->ab", e3, rho_ab)
    return E, L, np.linalg.inv(L).T @ h @ np.linalg.inv(L), gam


def relative_curvature(a, b):
    """Delta, and T, of which s = -1."""
    sin, cos = np.sin(ANGLE), np.cos(ANGLE)
    T = np.array([[-sin, cos], [cos, sin]])
    return forms(a, 0)[2] + T @ forms(b, 1)[2] @ T.T, T


def by_charts(a, b, w):
    """Rates of q, qc and theta: docs/theory.md, (3.1) to (3.3) for s = -1."""
    (E, L, _, gam), (_, L_c, _, gam_c) = forms(a, 0), forms(b, 1)
    Delta, T = relative_curvature(a, b)
    sigma, tau, n = E.T @ w
    u = np.linalg.solve(Delta, np.array([tau, -sigma]))
    rate_a, rate_b = np.linalg.solve(L, u), np.linalg.solve(L_c, T.T @ u)
    return rate_a, rate_b, -n - gam @ rate_a - gam_c @ rate_b


def fits(a, b):
    """Whether a pair's relative curvature is singular; sharp edges have none."""
    if "rim" in (a, b):
        return False  # its chart has no first form
    Delta, _ = relative_curvature(a, b)
    size = max(np.abs(forms(a, 0)[2]).max(), np.abs(forms(b, 1)[2]).max())
    return abs(np.linalg.det(Delta)) <= 1e-10 * size**2


def at(a, b):
    return {"contact_on_a": chart_of(a, 0)[0], "angle": ANGLE}


def rolled(a, b, w=W, **more):
    on_b = chart_of(b, 1)[0]
    where = at(a, b) | more
    return rk.rolling_kinematics(CHARTS[a], CHARTS[b], on_b, w, **where)


@pytest.mark.parametrize(("a", "b"), ALL)
def test_maps(a, b):
    """Rates of the charts by NumPy; and what rolling is, along the rates."""
    if fits(a, b):
        with pytest.raises(rk.FieldError, match="fits the other surface"):
            rolled(a, b)
        return
    if (a, b) == ("torus", "plane"):  # at a point of its inner half
        with pytest.raises(rk.FieldError, match="a plane cannot touch"):
            rolled(a, b)
        return
    found = rolled(a, b)
    small = 1e-10  # 1e6 roundings: second derivatives, divided by small curvatures
    if "rim" not in (a, b):
        charts = found.in_charts
        rate_a, rate_b, turn = by_charts(a, b, W)
        size = max(np.abs(rate_a).max(), np.abs(rate_b).max(), abs(turn), 1.0)
        np.testing.assert_allclose(charts.on_a_rate, rate_a, rtol=0, atol=small * size)
        np.testing.assert_allclose(charts.on_b_rate, rate_b, rtol=0, atol=small * size)
        np.testing.assert_allclose(charts.angle_rate, turn, rtol=0, atol=small * size)
        np.testing.assert_allclose(
            np.cos(charts.angle - ANGLE), 1.0, rtol=0, atol=small
        )
    rolls_by_definition(found)


def rolls_by_definition(found):
    """The pose's derivative along the rates is that of a material point with slip."""
    A, B = found.surface_a, found.surface_b

    @jax.jit
    def pose(q, on_a, on_b):
        shell, ground, R = A.geometry(on_a), B.geometry(on_b), rotation_matrix(q)
        return ground.position - R @ shell.position, R @ shell.normal, ground.normal

    places = found.orientation, found.contact_on_a, found.contact_on_b
    rates = (
        found.orientation_rate,
        found.contact_on_a_rate,
        found.contact_on_b_rate,
    )
    (r, n_a, n_b), (v, n_a_dot, n_b_dot) = jax.jvp(pose, places, rates)
    size = max(float(jnp.abs(x).max()) for x in (*rates, found.velocity))
    close = functools.partial(np.testing.assert_allclose, rtol=0, atol=1e-10 * size)
    R = rotation_matrix(found.orientation)
    close(r, found.position)
    close(n_a, -n_b)
    close(v, found.velocity)
    close(n_a_dot, -n_b_dot)
    spoke = jnp.cross(found.angular_velocity, found.point_on_a)
    close(found.velocity + R @ spoke, found.slip)


PAIR = ("torus", "ellipsoid")


@pytest.mark.slow
def test_with_slip_and_without_spin():
    normal = rolled(*PAIR).normal
    R = np.asarray(rolled(*PAIR).rotation)
    slip = SLIP - R @ normal * (R @ normal @ SLIP)
    found = rolled(*PAIR, slip=SLIP)
    rolls_by_definition(found)
    np.testing.assert_allclose(found.slip, slip, rtol=0, atol=1e-14)
    still = rolled(*PAIR, without_spin=True)
    rolls_by_definition(still)
    assert abs(float(still.spin)) < 1e-15
    across = W - normal * (normal @ W)
    np.testing.assert_allclose(still.angular_velocity, across, rtol=0, atol=1e-14)


def test_accelerations_are_those_of_a_motion():
    """By differences along a motion that is stepped by its rates (Runge-Kutta)."""
    a, b = CHARTS["torus"], CHARTS["ellipsoid"]
    first = rolled(*PAIR)

    @jax.jit
    def rates(t, q, on_a, on_b):
        w = W + TURNED * t + 0.4 * TURNED * t * t
        now = rk.rolling_kinematics(a, b, on_b, w, orientation=q, contact_on_a=on_a)
        return now.orientation_rate, now.contact_on_a_rate, now.contact_on_b_rate, now

    start = first.orientation, first.contact_on_a, first.contact_on_b
    h, points = 0.01, {}

    def step(t, y, h):
        def f(t, y):
            return rates(t, *y)[:3]

        def plus(y, k, h):
            return tuple(x + h * dx for x, dx in zip(y, k, strict=True))

        k1 = f(t, y)
        k2 = f(t + h / 2, plus(y, k1, h / 2))
        k3 = f(t + h / 2, plus(y, k2, h / 2))
        k4 = f(t + h, plus(y, k3, h))
        mean = [
            (p + 2 * q + 2 * r + s) / 6
            for p, q, r, s in zip(k1, k2, k3, k4, strict=True)
        ]
        return plus(y, mean, h)

    for sign in (1.0, -1.0):
        t, y = 0.0, start
        for k in range(1, 5):
            for _ in range(4):
                y = step(t, y, sign * h / 4)
                t += sign * h / 4
            points[int(sign * k)] = rates(t, *y)[3]
    weights = {1: 4 / 5, 2: -1 / 5, 3: 4 / 105, 4: -1 / 280}  # eighth order

    def slope(name):
        terms = [
            c * (getattr(points[k], name) - getattr(points[-k], name))
            for k, c in weights.items()
        ]
        return sum(terms) / h

    found = rolled(*PAIR, angular_acceleration=TURNED)
    # the steps of h/4 are wrong by (h/4)^5 = 1e-13, four of them and divided by h
    # 4e-11, times derivatives of order a hundred; the differences by h^8 = 1e-16
    for name, of in {
        "acceleration": "velocity",
        "contact_acceleration": "contact_velocity",
        "angular_acceleration": "angular_velocity",
        "contact_on_a_acceleration": "contact_on_a_rate",
        "contact_on_b_acceleration": "contact_on_b_rate",
    }.items():
        np.testing.assert_allclose(
            getattr(found, name), slope(of), rtol=0, atol=1e-8, err_msg=name
        )


@pytest.mark.parametrize("on", ["a", "b"])
def test_maps_inverted(on):
    found = rolled(*PAIR, angular_acceleration=TURNED)
    spin_rate = (
        found.normal @ found.angular_acceleration
        + found.angular_velocity
        @ (
            jax.jvp(
                lambda u: found.surface_a.geometry(u).normal,
                (found.contact_on_a,),
                (found.contact_on_a_rate,),
            )[1]
        )
    )
    again = rk.rolling_along(
        found.surface_a,
        found.surface_b,
        found.contact_on_b,
        getattr(found, f"contact_on_{on}_rate"),
        on=on,
        contact_on_a=found.contact_on_a,
        orientation=found.orientation,
        spin=found.spin,
        contact_acceleration=getattr(found, f"contact_on_{on}_acceleration"),
        spin_rate=spin_rate,
    )
    # a few hundred roundings of numbers of order ten
    for name in ("angular_velocity", "angular_acceleration", "acceleration"):
        np.testing.assert_allclose(
            getattr(again, name), getattr(found, name), rtol=0, atol=1e-12
        )


def test_a_ball_taken_once_round_a_circle():
    """Without spin; its rotation after one round in closed form."""
    r, c, T = 0.3, 0.5, 2 * np.pi

    def circle(t):
        return c * jnp.stack([jnp.cos(t), jnp.sin(t)])

    times = np.linspace(0.0, T, 9)
    path = rk.rolling_path(
        rk.Sphere(r), rk.Plane(), circle, times, orientation=[1.0, 0.0, 0.0, 0.0]
    )
    small = 1e-8  # a hundred times the relative tolerance of a step
    np.testing.assert_allclose(
        path.position[:, :2], jax.vmap(circle)(times), atol=small
    )
    np.testing.assert_allclose(path.spin, 0.0, atol=1e-13)
    # seen from axes that turn with the radius the ball's angular velocity is constant,
    # z x v / r - z; after one round these axes are back
    v = np.array([0.0, c, 0.0])
    w = np.cross([0.0, 0.0, 1.0], v) / r - np.array([0.0, 0.0, 1.0])
    expected = _turn(w * T)
    np.testing.assert_allclose(path.rotation[-1], expected, atol=small)


def _turn(v):
    """Rotation by a vector, Rodrigues."""
    angle = np.linalg.norm(v)
    k = v / angle
    K = np.array([[0, -k[2], k[1]], [k[2], 0, -k[0]], [-k[1], k[0], 0]])
    return np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K


def test_a_path_on_the_rolling_surface_is_followed():
    """The spin is as given, and the contact stays on the curve."""
    tube = rk.Torus(1.0, 0.3)
    path = rk.rolling_path(
        tube,
        rk.Ellipsoid((0.5, 0.3, 0.2)),
        lambda t: jnp.stack([t, 0.3 * t + 0.2]),
        [0.0, 0.5, 1.0],
        on="a",
        contact=[0.3, 0.2, 0.7],
        angle=0.4,
        spin=lambda t: 0.3 * t,
    )
    np.testing.assert_allclose(path.spin, [0.0, 0.15, 0.3], atol=1e-12)
    np.testing.assert_allclose(path.contact_on_a[:, 0], [0.0, 0.5, 1.0], atol=1e-15)
    last = jax.tree.map(lambda x: x[-1], path)
    rolls_by_definition(last)


def test_batches_and_gradients():
    """Mapped over angular velocities; the derivative by a radius, by differences."""
    many = jax.vmap(lambda w: rolled("sphere", "plane", w).contact_on_b_rate)
    ws = np.stack([W, 2 * W, -W])
    one = rolled("sphere", "plane").contact_on_b_rate
    np.testing.assert_allclose(many(ws), np.outer([1, 2, -1], one), rtol=1e-14)

    def rate(r):
        ball = rk.Sphere(r)
        there = [0.1, 0.2]
        q = [1.0, 0.2, 0.3, 0.4]
        now = rk.rolling_kinematics(ball, rk.Plane(), there, W, orientation=q)
        return now.contact_on_b_rate

    # r (w x n): linear in r
    np.testing.assert_allclose(jax.jacrev(rate)(0.3) * 0.3, rate(0.3), rtol=1e-14)


def test_bad_input_is_refused_by_name():
    ball, plane = rk.Sphere(0.1), rk.Plane()
    q = [1.0, 0.0, 0.0, 0.0]

    def refused(match, a, b, on_b, **more):
        with pytest.raises(rk.FieldError, match=match):
            rk.rolling_kinematics(a, b, on_b, W, **more)

    refused("surface_a: is no surface", 3, plane, [0.0, 0.0], orientation=q)
    refused(r"contact_on_b: must have shape \(2\)", ball, plane, [0.0], orientation=q)
    refused("orientation: is not given", ball, plane, [0.0, 0.0])
    refused("say the same", ball, plane, [0.0, 0.0], orientation=q, angle=0.1)
    refused(
        "contact_on_a: is not given",
        rk.Torus(0.5, 0.1),
        ball,
        [0, 0, 1.0],
        orientation=q,
    )
    refused(
        "leaves 2.0e.00 rad",
        ball,
        plane,
        [0.0, 0.0],
        orientation=q,
        contact_on_a=[0, 0, 1.0],
    )
    bowl = CHARTS["bowl"]
    refused(
        "contact_on_b: is no point",
        ball,
        bowl,
        [0.0, 5.0, 0.0][: bowl.coordinate_count],
        orientation=q,
    )
    level = CHARTS["implicit"]
    refused("contact_on_b: is no point", ball, level, [5.0, 5.0, 5.0], orientation=q)
    cavity = rk.Sphere(0.1, inside=True)
    refused("surface_b: fits", ball, cavity, [0.0, 0.0, 1.0], orientation=q)

    @jax.jit
    def traced(r):
        cavity = rk.Sphere(r, inside=True)
        return rk.rolling_kinematics(
            ball, cavity, [0, 0, 1.0], W, orientation=q
        ).velocity

    assert np.isnan(traced(0.1)).all()
    assert np.isfinite(traced(0.2)).all()
    with pytest.raises(rk.FieldError, match=r"along\.surface_a: is a sharp edge"):
        rk.rolling_along(rk.DiscEdge(0.1), plane, [0, 0.0], [1, 0.0], orientation=q)
    with pytest.raises(rk.FieldError, match=r"along\.on: must be 'a' or 'b'"):
        rk.rolling_along(ball, plane, [0, 0.0], [1, 0.0], orientation=q, on="c")
