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


def test_what_moves_with_a_known_number_is_the_same_inside():
    by_mass = lambda m, spin: end(scene(mass=m), spin)
    value, tangent = jax.jvp(by_mass, (2.0, 2.0), (1.0, 0.5))
    inside = jax.jit(lambda: jax.jvp(by_mass, (2.0, 2.0), (1.0, 0.5)))()
    # the same program in C; XLA, in what stands around it, may fuse one more product
    np.testing.assert_allclose(inside[0], value, rtol=1e-15)
    np.testing.assert_allclose(inside[1], tangent, rtol=1e-14)
