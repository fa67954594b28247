"""Functions whose globals or attributes have changed since they were last given."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk
from rollkane.simulation.ensemble_members import members_of

FORCE = np.array([1.0, 0.0, 0.0])
SPINS = np.array([1.0, 2.0])
SCENE = rk.Scene(rk.Body(1.0, 0.004 * np.eye(3), rk.Sphere(0.1)))
START = rk.place(SCENE, (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


def constant(t, point):
    del t, point
    return jnp.asarray(FORCE)


def slope(x, y):
    del y
    return FORCE[0] * x


class Spring:
    """An object that holds a number, which is no array of JAX's."""

    def __init__(self, k):
        self.k = k

    def force(self, t, point):
        del t
        return -self.k * point.position


def spinning(i):
    w = jnp.stack([0.0, 1.0, 0.0]) * jnp.asarray(SPINS)[i]
    return rk.place(SCENE, (1.0, 0.0, 0.0, 0.0), w, (0.0, 0.0, 0.0))


def test_a_new_scene_sees_what_a_function_reads_now(monkeypatch):
    """Was: 1 m/s twice, as the function is the same object."""

    def speed():
        scene = rk.Scene(SCENE.body, loads=(rk.Force(constant),))
        return float(rk.simulate(scene, START, [0.0, 1.0]).velocity[-1, 0])

    # 5/7 F t / m, to a run's tolerance of 1e-9
    np.testing.assert_allclose(speed(), 5 / 7, rtol=1e-8)
    monkeypatch.setitem(globals(), "FORCE", 2.0 * FORCE)
    np.testing.assert_allclose(speed(), 10 / 7, rtol=1e-8)


def test_what_a_function_reads_tells_it_from_itself(monkeypatch):
    same = lambda a, b: jax.tree.structure(a) == jax.tree.structure(b)
    first, height = rk.Force(constant), rk.Graph(slope)
    spring = Spring(2.0)
    pulled, method = rk.Force(spring.force), spring.force
    assert same(first, rk.Force(constant))
    assert same(height, rk.Graph(slope))
    assert same(pulled, rk.Force(method))
    monkeypatch.setitem(globals(), "FORCE", 2.0 * FORCE)
    spring.k = 3.0
    assert not same(first, rk.Force(constant))
    assert not same(height, rk.Graph(slope))
    assert not same(pulled, rk.Force(method))


def test_members_are_made_by_what_their_function_reads_now(monkeypatch):
    spins = lambda members: members.block(0, 2)[1].angular_velocity[:, 1]
    first = members_of(SCENE, spinning, 2)
    assert members_of(SCENE, spinning, 2).starts is first.starts  # compiled once
    np.testing.assert_array_equal(spins(first), [1.0, 2.0])
    monkeypatch.setitem(globals(), "SPINS", np.array([10.0, 20.0]))
    np.testing.assert_array_equal(spins(members_of(SCENE, spinning, 2)), [10.0, 20.0])
    np.testing.assert_array_equal(spins(first), [1.0, 2.0])


def test_functions_of_others_can_be_given():
    """Of a surface, a motion, a Kane system; with parameters of theirs, or others."""
    u = jnp.asarray([1.0, 2.0])
    height = lambda graph: graph.point(u)[2]
    bare = rk.Graph(lambda x, y: 0.1 * x * x)
    graph = rk.Graph(lambda x, y, p: p * x * x, parameters=0.3)
    assert height(rk.Graph(bare.f)) == height(bare) == 0.1
    assert height(rk.Graph(graph.f)) == height(graph) == 0.3
    assert height(rk.Graph(graph.f, parameters=0.5)) == 0.5
    with pytest.raises(rk.FieldError, match="signature that does not fit"):
        rk.Graph(bare.f, parameters=0.5)
    moves = rk.BaseMotion(lambda t: jnp.stack([jnp.sin(t), 0.0 * t, 0.0 * t]))
    again = rk.BaseMotion(moves.position)
    t = jnp.asarray(0.3)
    np.testing.assert_array_equal(again.at(t).position, moves.at(t).position)
    free = rk.kane.free_bodies([1.0], [0.004 * np.eye(3)]).system
    same = rk.kane.KaneSystem(7, 6, free.kinematics, free.parts, free.loads)
    q = jnp.asarray([0.1, 0.2, 0.3, 1.0, 0.0, 0.0, 0.0])
    given = t, q, jnp.arange(6.0), None
    np.testing.assert_array_equal(same.kinematics(*given), free.kinematics(*given))
