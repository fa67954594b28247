"""The same motion in Voronets and in pole-free coordinates; where charts end."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk

from .. import problems
from ..random_scenes import height

# Two runs at rtol 1e-12 of at most 3000 steps each differ by less than
# 2 * 3000 * 1e-12 = 6e-9 of the largest numbers in the worst case, and by the square
# root of the number of steps less as a rule: 1e-10.
SAME = 1e-9
RTOL = 1e-12
TIMES = np.linspace(0.0, 5.0, 26)


def swaying(t):
    return jnp.stack([0.1 * jnp.sin(2.0 * t), 0.0 * t, 0.05 * jnp.sin(3.0 * t)])


def rocking(t):
    angle = 0.1 * jnp.sin(1.5 * t)
    c, s, o, i = jnp.cos(angle), jnp.sin(angle), jnp.zeros_like(t), jnp.ones_like(t)
    rows = (i, o, o), (o, c, -s), (o, s, c)
    return jnp.stack([jnp.stack(row) for row in rows])


def body(surface):
    return rk.Body(1.2, np.diag([0.01, 0.012, 0.014]), surface, (0.01, -0.02, 0.015))


def in_bowl():
    """An ellipsoid rocking near its equator in a bowl that sways and rocks."""
    bowl = rk.Graph(height, {"a": 0.5, "b": 0.02})
    base = rk.Base(bowl, rk.BaseMotion(swaying, rocking))
    scene = rk.Scene(body(rk.Ellipsoid((0.2, 0.15, 0.18))), base)
    q = problems.product(problems.turn(0, 80.0), problems.turn(2, 30.0))
    z = float(bowl.f(jnp.array([0.1, 0.05])))
    return scene, rk.place(scene, q, (0.3, 0.2, 1.0), (0.1, 0.05, z))


def upright_disc():
    """A sharp rim on a plane, above its critical speed."""
    return problems.disc()


def ball_in_sphere():
    """A ball with a pendulum rolls round inside a large sphere."""
    arm = lambda a: (
        0.05 * jnp.stack([jnp.stack([jnp.sin(a[0]), 0.0 * a[0], jnp.cos(a[0])])])
    )
    pendulum = rk.PointMasses([0.2], arm, lambda t, a, a_dot: -0.05 * a - 0.01 * a_dot)
    base = rk.Base(rk.Sphere(1.0, inside=True))
    scene = rk.Scene(body(rk.Sphere(0.15)), base, pendulum)
    q = problems.turn(0, 90.0)
    contact = np.array([np.cos(-0.9), 0.0, np.sin(-0.9)])
    start = rk.place(scene, q, (2.0, 1.0, -3.0), contact, (0.3,), (0.0,))
    return scene, start


SCENES = {"bowl": in_bowl, "disc": upright_disc, "sphere": ball_in_sphere}


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.slow
def test_same_motion(name):
    scene, start = SCENES[name]()
    free = rk.simulate(scene, start, TIMES, rtol=RTOL)
    charts = rk.simulate(scene, start, TIMES, rtol=RTOL, coordinates="voronets")
    assert bool(free.succeeded), free.reason
    assert bool(charts.succeeded), charts.reason
    assert isinstance(charts.state, rk.VoronetsState)
    for field in (
        "position",
        "orientation",
        "angular_velocity",
        "contact_on_base",
        "contact_on_body",
        "contact_force",
        "energy",
        "alpha",
    ):
        found, exact = (
            np.asarray(getattr(charts, field)),
            np.asarray(getattr(free, field)),
        )
        if field == "orientation":
            assert problems.quaternion_error(found, exact).max() < SAME
            steps = np.sum(found[1:] * found[:-1], axis=1)
            assert (steps > 0).all()  # continuous in sign
            continue
        size = max(1.0, np.abs(exact).max(initial=0.0))
        np.testing.assert_allclose(found, exact, atol=SAME * size)


@pytest.mark.slow
def test_both_signs_and_the_paper_formulation_move_alike():
    scene, start = ball_in_sphere()
    times = np.linspace(0.0, 1.0, 3)
    lower = rk.simulate(scene, start, times, rtol=RTOL, coordinates="voronets")
    upper = rk.simulate(
        scene,
        rk.to_voronets(scene, start, sign=1),
        times,
        rtol=RTOL,
        coordinates="voronets",
    )
    assert upper.state.sign == 1
    paper, free = (
        rk.simulate(
            scene,
            start,
            times,
            rtol=RTOL,
            formulation="euler_lagrange",
            coordinates=coordinates,
        )
        for coordinates in ("voronets", "pole-free")
    )
    for other in (upper, paper, free):
        assert bool(other.succeeded)
        np.testing.assert_allclose(other.position, lower.position, atol=SAME)
        np.testing.assert_allclose(other.alpha, lower.alpha, atol=SAME)


@pytest.mark.parametrize("name", SCENES)
def test_conversions_return(name):
    scene, start = SCENES[name]()
    there = rk.to_voronets(scene, start)
    back = rk.to_pole_free(scene, there)
    assert rk.to_pole_free(scene, start) is start
    assert rk.to_voronets(scene, there) is there
    for field in ("angular_velocity", "contact_on_base", "contact_on_body", "alpha"):
        found, exact = getattr(back, field), getattr(start, field)
        if found.shape == (3,) and field != "angular_velocity":  # a direction
            found, exact = (x / jnp.linalg.norm(x) for x in (found, exact))
        np.testing.assert_allclose(found, exact, atol=1e-14)
    off = problems.quaternion_error(back.orientation[None], start.orientation[None])
    assert off.max() < 1e-14
    over = rk.to_voronets(scene, there, sign=1)
    again = rk.to_voronets(scene, over)
    np.testing.assert_allclose(again.angle, there.angle, atol=1e-13)


STRETCH = jnp.array([25.0, 16.0, 30.0])
SURFACES = {
    "plane": rk.Plane(),
    "torus": rk.Torus(0.3, 0.1),
    "cylinder": rk.Cylinder(0.3),
    "cone": rk.Cone(0.7, inside=True),
    "graph": rk.Graph(lambda x, y: 0.1 * x * y),
    "implicit": rk.Implicit(
        lambda p: jnp.sum(p**2 * jnp.array([25.0, 16.0, 30.0])) - 1
    ),
    "vase": rk.Revolution(lambda s: (0.2 + 0.1 * jnp.cos(s), s), domain=(0.0, 1.0)),
    "cap": rk.Revolution(lambda s: (jnp.sin(s), 1 - jnp.cos(s)), domain=(0.0, 1.5)),
    "egg": rk.Revolution(lambda s: (jnp.sin(s), -2.0 * jnp.cos(s))),
    "direction": rk.Parametric(
        lambda n: n * jnp.array([0.2, 0.3, 0.1]), of_direction=True
    ),
    "sphere": rk.Sphere(0.4, (0.1, 0.0, 0.2)),
}


@pytest.mark.parametrize("name", SURFACES)
def test_charts_and_coordinates_name_the_same_point(name):
    surface = SURFACES[name]
    q = jnp.array([0.4, 0.3])
    u = surface.chart_inverse(q)
    np.testing.assert_allclose(surface.chart_coordinates(u), q, atol=1e-12)
    np.testing.assert_allclose(
        surface.geometry(u).position, surface.chart_geometry(q).position, atol=1e-12
    )
    np.testing.assert_allclose(
        surface.geometry(u).normal, surface.chart_geometry(q).normal, atol=1e-12
    )


def test_the_edge_of_a_chart_says_so_and_how_to_go_on():
    """A ball rolls closely past the pole of its base's longitude and latitude."""
    ball = rk.Body(1.0, 0.01 * np.eye(3), rk.Sphere(0.15))
    scene = rk.Scene(ball, rk.Base(rk.Sphere(1.0)), loads=())
    contact = np.array([np.cos(0.8), 0.0, np.sin(0.8)])
    # 5e-4 rad beside the great circle through the pole
    turning = (2e-3 * np.cos(0.8), -4.0, 2e-3 * np.sin(0.8))
    start = rk.place(scene, problems.turn(0, 90.0), turning, contact)
    times = np.linspace(0.0, 5.0, 6)
    stopped = rk.simulate(scene, start, times, rtol=1e-9, coordinates="voronets")
    assert int(stopped.code) == rk.Code.CHART_EDGE
    assert "pole-free" in stopped.reason
    assert "final_state" in stopped.reason
    end = float(stopped.final_time)
    assert 0.0 < end < 5.0
    assert np.isnan(np.asarray(stopped.position)[-1]).all()
    # as it says: go on from there
    on = rk.simulate(scene, stopped.final_state, (end, 5.0), rtol=1e-9)
    whole = rk.simulate(scene, start, (0.0, 5.0), rtol=1e-9)
    assert bool(on.succeeded)
    # near the edge the rates are a thousand times larger than elsewhere
    np.testing.assert_allclose(on.position[-1], whole.position[-1], atol=1e-5)
    # a start at the pole itself is refused when it is converted, not quietly moved
    top = rk.place(scene, problems.turn(0, 90.0), (0.0, -4.0, 0.0), (0.0, 0.0, 1.0))
    with pytest.raises(rk.FieldError, match=r"edge of a chart.*pole-free"):
        rk.to_voronets(scene, top)


@pytest.mark.slow
def test_gradients_in_voronets_coordinates():
    scene, start = ball_in_sphere()

    def reach(spin, coordinates):
        turned = jax.tree.map(lambda x: x, start)
        moved = rk.State(
            turned.orientation,
            start.angular_velocity + spin * jnp.array([0.1, 0.2, 0.3]),
            turned.contact_on_base,
            turned.contact_on_body,
            turned.alpha,
            turned.alpha_dot,
        )
        times = (0.0, 0.5)
        result = rk.simulate(scene, moved, times, rtol=1e-11, coordinates=coordinates)
        return result.position[-1, 0]

    slopes = [
        jax.jvp(functools.partial(reach, coordinates=c), (0.0,), (1.0,))[1]
        for c in ("pole-free", "voronets")
    ]
    assert abs(float(slopes[0] - slopes[1])) < 1e-9
    assert abs(float(slopes[0])) > 1e-3
