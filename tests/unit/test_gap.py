"""Nearest points of a body in flight: how they are found, and follow its place."""

import itertools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk
from rollkane.dynamics import gap

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
    improve = jax.jit(lambda state: gap._improved(scene, t, state))
    left = []
    for _ in range(7):
        places, rest, _ = improve(state)
        state = eqx.tree_at(gap._places, state, places)
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
        distance, near = gap.nearest(scene, t, flying)
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


@pytest.mark.parametrize("base", FAR)
@pytest.mark.parametrize("body", [rk.Torus(0.4, 0.12), EGG], ids=["torus", "egg"])
def test_gap_is_that_of_the_nearest_of_all_places(body, base):
    """Of bodies anywhere near a base, beside distances of many of their points.

    A search from a place without a low sample once ended at points that look away from
    each other, metres in the base.
    """
    make, distance, place = FAR[base]
    scene = rk.Scene(rk.Body(1.0, np.eye(3), body), rk.Base(make()))
    draw = np.random.default_rng(3)
    turned = draw.normal(size=(60, 4))
    turned /= np.linalg.norm(turned, axis=1)[:, None]
    at = np.stack([place(*draw.uniform(-1.0, 1.0, 2)) for _ in turned])
    slope = np.stack(
        [(distance(at + e) - distance(at - e)) / 2e-6 for e in 1e-6 * np.eye(3)], 1
    )
    at = at + draw.uniform(0.6, 1.5, 60)[:, None] * slope
    still = (0.0, 0.0, 0.0)
    release = lambda q, r: rk.release(scene, q, still, r, still)
    find = lambda q, r: gap.nearest_anywhere(scene, jnp.asarray(0.0), release(q, r))[0]
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


def _matrix(q):
    w, v = q[0], q[1:]
    cross = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
    return np.eye(3) + 2.0 * (w * cross + cross @ cross)
