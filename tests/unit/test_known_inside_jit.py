"""What is known stays known inside of ``jit``: checked by name, and found once."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk
from rollkane import FieldError

from ..house.test_cost import counted

INERTIA = 0.008 * np.eye(3)
UP, TIMES = (1.0, 0.0, 0.0, 0.0), (0.0, 0.1)


def scene(mass=2.0, inertia=INERTIA, radius=0.1):
    return rk.Scene(rk.Body(mass, inertia, rk.Sphere(radius)))


def end(scene, spin):
    turn = jnp.stack([0.0 * spin, spin, 0.0 * spin])
    start = rk.place(scene, UP, turn, np.zeros(3))
    return rk.simulate(scene, start, TIMES).position[-1]


WRONG = {
    "Body.mass": lambda: scene(mass=-2.0),
    "Body.inertia": lambda: scene(inertia=np.diag([0.008, 0.008, 0.017])),
    "Sphere.radius": lambda: scene(radius=-0.1),
    "Modes.restitution": lambda: rk.Modes(restitution=1.1),
    "CoulombFriction.coefficient": lambda: rk.CoulombFriction(-0.1),
}


@pytest.mark.parametrize("field", WRONG)
def test_what_is_impossible_is_refused_by_name(field):
    """It became NaN, as if it were traced."""

    def made(x):
        return x + jnp.sum(jnp.stack(jax.tree.leaves(WRONG[field]())[:1]))

    with pytest.raises(FieldError, match=field):
        jax.jit(made)(1.0)


def test_a_scene_made_inside_adds_nothing_to_the_program():
    """Its checks, moments of inertia among them, were computed in every call."""
    made = scene()
    spin = jnp.asarray(2.0)
    inside = jax.make_jaxpr(lambda spin: end(scene(), spin))(spin)
    outside = jax.make_jaxpr(lambda spin: end(made, spin))(spin)
    assert counted(inside) == counted(outside)


def test_an_overlap_of_known_places_is_not_looked_for_in_every_call():
    """The search stood in the program, 0.5 s to compile, as the speed is traced."""
    bowl = rk.Base(rk.Graph(lambda x, y: 0.5 * (x * x + y * y)))
    egg = rk.Body(1.0, 0.004 * np.eye(3), rk.Ellipsoid((0.1, 0.1, 0.14)))
    placed = lambda spin, allow: rk.place(
        rk.Scene(egg, bowl), UP, spin, np.zeros(3), allow_overlap=allow
    )
    looks = jax.make_jaxpr(lambda spin: placed(spin, False))(jnp.ones(3))
    allows = jax.make_jaxpr(lambda spin: placed(spin, True))(jnp.ones(3))
    # what an overlap would spoil, where the search was hundreds of equations
    assert counted(looks) <= counted(allows) + 20


def test_what_moves_with_a_known_number_is_the_same_inside():
    by_mass = lambda m, spin: end(scene(mass=m), spin)
    value, tangent = jax.jvp(by_mass, (2.0, 2.0), (1.0, 0.5))
    inside = jax.jit(lambda: jax.jvp(by_mass, (2.0, 2.0), (1.0, 0.5)))()
    # the same program in C; XLA, in what stands around it, may fuse one more product
    np.testing.assert_allclose(inside[0], value, rtol=1e-15)
    np.testing.assert_allclose(inside[1], tangent, rtol=1e-14)


MADE = {
    "profile": lambda: rk.Revolution(lambda s: (0.1 * jnp.sin(s), -0.14 * jnp.cos(s))),
    "profile of a parameter": lambda: rk.Revolution(
        lambda s, p: (p["a"] * jnp.sin(s), -0.14 * jnp.cos(s)), parameters={"a": 0.1}
    ),
    "places": lambda: rk.PointMasses(
        [1.0, 2.0], lambda a: 0.1 * jnp.eye(2, 3) + a[0] * jnp.eye(2, 3)[::-1]
    ),
    "section": lambda: rk.Event.section((0.0, 0.0, 1.0), 0.2).function,
    "rolling body": lambda: in_a_shell().place(UP, np.zeros(3), (0.0, 0.0, -0.09)),
}


def in_a_shell():
    ball = rk.Body(0.1, 1e-5 * np.eye(3), rk.Sphere(0.02))
    return rk.RollingBody(ball, rk.Sphere(0.09, inside=True))


def same(one, other):
    """Whether two of them have the same numbers, in the same places."""
    a, b = jax.tree.leaves(one), jax.tree.leaves(other)
    return len(a) == len(b) and all(map(np.array_equal, a, b))


@pytest.mark.parametrize("name", MADE)
def test_what_is_found_out_about_known_parts_is_found_inside(name):
    """It was refused, as if it were traced, or could not be told by Python."""
    found = []
    jax.jit(lambda x: found.append(MADE[name]()) or x)(1.0)
    assert not any(isinstance(x, jax.core.Tracer) for x in jax.tree.leaves(found))
    assert same(found[0], MADE[name]())


def test_what_a_profile_holds_may_be_traced():
    def made(a):
        shape = rk.Revolution(
            lambda s: (a * jnp.sin(s), -0.14 * jnp.cos(s)),
            poles=(True, True),
            rising=True,
        )
        return shape.point(shape.locate(jnp.asarray([a, 0.0, 0.0])))

    found = jax.jit(made)(0.1)
    # on the equator, to some roundings
    np.testing.assert_allclose(found, [0.1, 0.0, 0.0], atol=1e-14)
    refused = lambda a: rk.Revolution(lambda s: (a * jnp.sin(s), -jnp.cos(s))) and a
    with pytest.raises(FieldError, match=r"Revolution.poles: cannot be found while"):
        jax.jit(refused)(0.1)
