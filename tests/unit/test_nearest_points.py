"""Nearest points of a body in flight: how they are found, and follow its place."""

import itertools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk
from rollkane.dynamics import nearest_anywhere, nearest_points
from rollkane.geometry.rotations import rotation_matrix
from rollkane.kinematics.coordinates import FlyingState

from ..quick import slow_but

WAVES = rk.Graph(lambda x, y: 0.1 * jnp.sin(3.0 * x) * jnp.cos(2.0 * y))
EGG = rk.Parametric(
    lambda n: jnp.stack([0.1 * n[0], 0.1 * n[1], 0.14 * n[2] + 0.02 * n[2] * n[2]]),
    of_direction=True,
)
TURNED = np.array([0.9, 0.3, -0.2, 0.1]) / np.sqrt(0.95)
PAIRS = {
    "ellipsoid, by its normal": (rk.Ellipsoid((0.2, 0.15, 0.1)), WAVES),
    "egg, by its coordinates": (EGG, WAVES),
    "egg over a ball": (EGG, rk.Sphere(0.5)),
}
MOVES = rk.BaseMotion(lambda t: jnp.stack([0.1 * t, 0.0 * t, 0.2 * t]))


def flying(name, moves=False):
    """A scene, and a body 0.4 m above the base's middle."""
    body, base = PAIRS[name]
    motion = MOVES if moves else None
    scene = rk.Scene(
        rk.Body(1.0, np.diag([0.01, 0.02, 0.03]), body), rk.Base(base, motion)
    )
    height = 0.9 if name.endswith("ball") else 0.4
    still = (0.0, 0.0, 0.0)
    return scene, rk.release(scene, TURNED, still, (0.1, 0.05, height), still)


@pytest.mark.parametrize("name", PAIRS)
def test_newtons_method_converges_quadratically(name):
    scene, state = flying(name, moves=True)
    t = jnp.asarray(0.3)  # the nearest points were those of t = 0: 0.07 m off
    improve = jax.jit(lambda state: nearest_points._improved(scene, t, state))
    left = []
    for _ in range(7):
        places, rest, _ = improve(state)
        state = eqx.tree_at(nearest_points.places_of, state, places)
        left.append(float(rest))
    # 1e-1, 1e-2, 1e-4, 1e-8, rounding: a slope that is a percent off would take as many
    # steps as digits are left over two
    assert left[0] > 1e-3
    assert left[5] < 64 * np.finfo(float).eps
    near = [x for x in left if 1e-12 < x < 1e-2]
    for before, after in itertools.pairwise(near):
        assert after < 30.0 * before**2  # curvatures of 10 / m, and two of them


@pytest.mark.parametrize("name", PAIRS)
def test_gap_and_nearest_points_follow_the_place(name):
    scene, state = flying(name)
    t = jnp.zeros(())

    def found(x):
        moved = state.position + x * jnp.array([0.6, -0.64, 0.48])
        flying = eqx.tree_at(lambda s: s.position, state, moved)
        distance, near = nearest_points.nearest(scene, t, flying)
        # directions have any length: what they lead to counts
        points = [scene.base.surface.point(near.contact_on_base)]
        if scene.has_contact_coordinates:
            points.append(scene.body.surface.point(near.contact_on_body))
        return [distance, *points]

    found = jax.jit(found)
    step = 1e-4
    slopes = jax.jvp(found, (jnp.zeros(()),), (jnp.ones(()),))[1]
    ahead, behind = found(jnp.asarray(step)), found(jnp.asarray(-step))
    for slope, a, b in zip(slopes, ahead, behind, strict=True):
        # third derivatives of 1e3, and a rounding of 64 eps over the step
        bound = 1e3 * step**2 / 6.0 + 64 * np.finfo(float).eps / step
        np.testing.assert_allclose(slope, (a - b) / (2.0 * step), rtol=0, atol=bound)


FAR = {
    "a tyre": (
        lambda: rk.Torus(3.0, 1.0),
        lambda p: np.hypot(np.hypot(p[..., 0], p[..., 1]) - 3.0, p[..., 2]) - 1.0,
        lambda a, b: np.array([3.0 + np.cos(b), 0.0, np.sin(b)]),
    ),
    "a roller": (
        lambda: rk.Cylinder(1.5),
        lambda p: np.hypot(p[..., 0], p[..., 1]) - 1.5,
        lambda a, b: np.array([1.5 * np.cos(a), 1.5 * np.sin(a), b]),
    ),
    "a ball": (
        lambda: rk.Sphere(2.0),
        lambda p: np.linalg.norm(p, axis=-1) - 2.0,
        lambda a, b: 2.0 * np.array([np.cos(a), np.sin(a), 0.0]),
    ),
}


def placed_near(base, seed, least):
    """Orientations, and places from so far over the base on [m]."""
    _, distance, place = FAR[base]
    draw = np.random.default_rng(seed)
    turned = draw.normal(size=(60, 4))
    turned /= np.linalg.norm(turned, axis=1)[:, None]
    at = np.stack([place(*draw.uniform(-1.0, 1.0, 2)) for _ in turned])
    slope = np.stack(
        [(distance(at + e) - distance(at - e)) / 2e-6 for e in 1e-6 * np.eye(3)], 1
    )
    return turned, at + draw.uniform(least, 1.5, 60)[:, None] * slope


@pytest.mark.parametrize("base", slow_but(["a ball", "a tyre"], FAR))
@pytest.mark.parametrize(
    "body",
    [rk.Torus(0.4, 0.12), pytest.param(EGG, marks=pytest.mark.slow)],
    ids=["torus", "egg"],
)
def test_gap_is_that_of_the_nearest_of_all_places(body, base):
    """Of bodies anywhere near a base, beside distances of many of their points.

    A search from a place without a low sample once ended at points that look away from
    each other, metres in the base.
    """
    make, distance, _ = FAR[base]
    scene = rk.Scene(rk.Body(1.0, np.eye(3), body), rk.Base(make()))
    turned, at = placed_near(base, 3, 0.6)
    still = (0.0, 0.0, 0.0)
    release = lambda q, r: rk.release(scene, q, still, r, still)
    anywhere = lambda y: nearest_anywhere.nearest_anywhere(scene, jnp.asarray(0.0), y)
    find = lambda q, r: anywhere(release(q, r))[0]
    found = np.asarray(jax.jit(jax.vmap(find))(turned, at))
    a, b = (x.ravel() for x in np.meshgrid(*[np.linspace(-np.pi, np.pi, 201)] * 2))
    u = np.stack([a, b], 1)
    if body is EGG:
        u = np.stack([np.cos(a) * np.cos(b), np.sin(a) * np.cos(b), np.sin(b)], 1)
    points = np.asarray(jax.vmap(body.point)(u))
    for q, r, nearest in zip(turned, at, found, strict=True):
        least = distance(r + points @ _matrix(q).T).min()
        # a point of the grid is within pi / 200 of the nearest in both angles: within
        # 0.52 m of that, and 0.12 m, on a torus that bends by 1 / 0.4 and 1 / 0.12 from
        # a base that bends by 1 at most: 3.5 (8.2e-3)^2 / 2 + 9.4 (1.9e-3)^2 / 2; the
        # egg is smaller
        assert -1.4e-4 < nearest - least < 1e-12


WIRES = {
    "ring over ball": (rk.Ring(0.4), rk.Sphere(2.0, (0.0, 0.0, -2.0))),
    "ring over tyre": (rk.Ring(0.4), rk.Torus(3.0, 1.0)),
    "ball over hoop": (rk.Sphere(0.3), rk.Ring(1.5)),
    "ellipsoid over hoop": (rk.Ellipsoid((0.35, 0.3, 0.25)), rk.Ring(1.5)),
    "torus over hoop": (rk.Torus(0.3, 0.1), rk.Ring(1.5)),
}


@pytest.mark.parametrize("name", WIRES)
def test_nearest_points_of_a_wire_look_at_each_other(name):
    """A wire has every normal across it: its nearest points are so with two of them.

    By the other one a body landed half a metre beside where it was.
    """
    body, base = WIRES[name]
    scene = rk.Scene(rk.Body(1.0, np.eye(3), body), rk.Base(base))
    draw = np.random.default_rng(4)
    turned = draw.normal(size=(60, 4))
    turned /= np.linalg.norm(turned, axis=1)[:, None]
    around = draw.uniform(-3.0, 3.0, 60)
    out = np.stack([np.cos(around), np.sin(around), 0.0 * around], 1)
    lean = draw.uniform(-3.0, 3.0, 60)[:, None]
    way = np.cos(lean) * out + np.sin(lean) * np.array([0.0, 0.0, 1.0])
    far = draw.uniform(0.45, 0.7, 60)[:, None]
    at = 1.5 * out + far * way
    if body.is_edge:
        at = way * 2.5 + [0, 0, -2.0] if "ball" in name else 3.0 * out + way * 1.5
    still = (0.0, 0.0, 0.0)

    def found(q, r):
        state = rk.release(scene, q, still, r, still)
        distance, near = nearest_anywhere.nearest_anywhere(
            scene, jnp.asarray(0.0), state
        )
        out = scene.base.surface.geometry(near.contact_on_base).normal
        if scene.has_contact_coordinates:
            inwards = scene.body.surface.geometry(near.contact_on_body).normal
            return distance, out, rotation_matrix(q) @ inwards
        return distance, out, -out

    gaps, outs, inwards = (np.asarray(x) for x in jax.jit(jax.vmap(found))(turned, at))
    # a search ends at 1e-9 of a metre, of normals of bodies that bend by 1 / 0.1 m
    assert np.abs(outs + inwards).max() < 1e-8
    angle = np.linspace(-np.pi, np.pi, 20001)
    circle = np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], 1)
    for q, r, nearest in zip(turned, at, gaps, strict=True):
        R = _matrix(q)
        if body.is_edge:
            least = _of_points(base, r + 0.4 * circle @ R.T)
        else:
            least = _of_points(body, (1.5 * circle - r) @ R)
        # points 4.8e-4 m apart at most, on a circle and a surface apart by more than
        # 0.05 m: (2.4e-4)^2 / 2 (1 / 0.05 + 1 / 0.4); an ellipsoid's own search, 1e-9
        assert -6.5e-7 < nearest - least < 1e-8


def _of_points(surface, points):
    """The least distance of a surface from points, of an ellipsoid by bisection."""
    if isinstance(surface, rk.Ellipsoid):
        axes = np.asarray(surface.semi_axes)
        low, high = np.zeros((2, len(points), 1))
        high += 4.0  # m^2, more than any of these
        for _ in range(60):  # the foot of a perpendicular is at a^2 p / (a^2 + f)
            f = 0.5 * (low + high)
            out = ((axes * points / (axes**2 + f)) ** 2).sum(1, keepdims=True) > 1.0
            low, high = np.where(out, f, low), np.where(out, high, f)
        return np.linalg.norm(points * f / (axes**2 + f), axis=1).min()
    return float(jnp.min(jax.vmap(surface.signed_distance)(jnp.asarray(points))))


def _matrix(q):
    w, v = q[0], q[1:]
    cross = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
    return np.eye(3) + 2.0 * (w * cross + cross @ cross)


DISC = 0.4  # m, its radius


def disc_over(base):
    """A scene, and the gap at an orientation and a place; wherever a search begins."""
    disc = rk.Body(1.0, np.diag([0.04, 0.04, 0.08]), rk.DiscEdge(DISC))
    scene, none = rk.Scene(disc, rk.Base(base)), jnp.zeros(0)

    def gap(e, r):
        still = jnp.zeros(3)
        state = FlyingState(e, still, base.locate(r), none, none, none, r, still)
        return nearest_anywhere.nearest_anywhere(scene, jnp.zeros(()), state)[0]

    return scene, gap


def gap_to_ball(e, r, radius):
    """Of a disc and a ball at the origin, in closed form."""
    across, height = centre_from(e, r)
    return jnp.hypot(jnp.maximum(across - DISC, 0.0), height) - radius


def centre_from(e, r):
    """Of the ball, from the disc's centre: in its plane, and along its axis."""
    x, y, height = -rotation_matrix(e).T @ r
    return jnp.hypot(x, y), height


def placed_discs(radius):
    """Orientations and places all round a ball."""
    draw = np.random.default_rng(0)
    unit = lambda x: x / np.linalg.norm(x, axis=1)[:, None]
    turned, out = unit(draw.normal(size=(2000, 4))), unit(draw.normal(size=(2000, 3)))
    away = out * (radius + draw.uniform(0.0, 1.5, (2000, 1)))
    apart = jax.vmap(lambda e, r: gap_to_ball(e, r, radius))(turned, away) > 0.0
    return turned[apart], away[apart]


@pytest.mark.parametrize("radius", [0.1, 0.7, 3.0])
def test_a_disc_is_nearest_by_its_face_or_its_rim(radius):
    """Its gap to a ball is known; a search once found nothing below its face."""
    turned, away = placed_discs(radius)
    _, gap = disc_over(rk.Sphere(radius))
    found = jax.jit(jax.vmap(gap))(turned, away)
    wanted = jax.vmap(lambda e, r: gap_to_ball(e, r, radius))(turned, away)
    across, _ = jax.vmap(centre_from)(turned, away)
    assert 10 < np.sum(across < DISC) < len(away) - 10
    # sums of a few numbers of that size
    tolerance = 16 * np.finfo(float).eps * (radius + 2.0)
    np.testing.assert_allclose(found, wanted, rtol=0.0, atol=tolerance)


def test_the_gap_of_a_disc_passes_from_rim_to_face():
    """In derivatives, too: where the foot of the perpendicular passes the rim."""
    _, gap = disc_over(rk.Sphere(0.7))
    e, height = jnp.array([1.0, 0.0, 0.0, 0.0]), 1.1
    at = lambda x: jnp.array([x, 0.0, height])
    turned = lambda s: jnp.array([jnp.cos(s), 0.3 * jnp.sin(s), jnp.sin(s), 0.0])
    slopes = jax.jit(jax.vmap(lambda x, s: (
        jax.jvp(lambda x: gap(e, at(x)), (x,), (jnp.ones(()),)),
        jax.jvp(lambda s: gap(turned(s), at(x)), (s,), (jnp.ones(()),)),
    )))  # fmt: skip
    known = jax.vmap(lambda x, s: (
        jax.jvp(lambda x: gap_to_ball(e, at(x), 0.7), (x,), (jnp.ones(()),)),
        jax.jvp(lambda s: gap_to_ball(turned(s), at(x), 0.7), (s,), (jnp.ones(()),)),
    ))  # fmt: skip
    beside = DISC + np.array([-0.3, -1e-3, -1e-6, -1e-9, 1e-9, 1e-6, 1e-3, 0.3])
    tilts = np.array([0.1, 0.0, 1e-3, 1e-9, 1e-9, 1e-3, 0.0, 0.1])
    found, wanted = slopes(beside, tilts), known(beside, tilts)
    # where the rim takes over the nearest point is known to sqrt(eps) of the radius
    tolerance = 2.0 * np.sqrt(np.finfo(float).eps)
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(wanted), strict=True):
        np.testing.assert_allclose(a, b, rtol=0.0, atol=tolerance)


@pytest.mark.parametrize("base", FAR)
def test_gap_of_a_disc_is_that_of_the_nearest_of_its_points(base):
    make, distance, _ = FAR[base]
    _, gap = disc_over(make())
    turned, at = placed_near(base, 4, 0.5)
    found = np.asarray(jax.jit(jax.vmap(gap))(turned, at))
    radius, angle = np.meshgrid(
        np.linspace(0.0, DISC, 101), np.linspace(-np.pi, np.pi, 401)
    )
    flat = [radius * np.cos(angle), radius * np.sin(angle), 0.0 * angle]
    points = np.stack([x.ravel() for x in flat], axis=1)
    for q, r, nearest in zip(turned, at, found, strict=True):
        least = distance(r + points @ _matrix(q).T).min()
        # a point of the grid is within 2 mm along a radius and 3.2 mm along a circle:
        # farther from a base that bends by 1 by 3.5 (3.2e-3)^2 / 2 + (2e-3)^2 / 2
        assert -2e-5 < nearest - least < 1e-12
