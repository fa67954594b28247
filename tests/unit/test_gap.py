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
