"""Random scenes with everything at once, for comparing formulations.

Two surfaces, a base that translates and turns, an offset mass centre, three carried
masses with two coordinates, springs, dampers, gravity, and drag on the body.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

import rollkane as rk
from rollkane.dynamics.loads import AbstractLoad
from rollkane.geometry.small_linear import matvec_transposed

from .paper import moving_base


class Damping(AbstractLoad):
    """A constant force and moment, and a moment against the body's turning."""

    force: Array
    moment: Array
    rate: Array

    def wrench(self, t, body, contact):
        del t, body
        turn = lambda vector: matvec_transposed(contact.rotation, vector)
        resist = -self.rate * contact.angular_velocity
        return turn(self.force), turn(self.moment) + resist


def places(a, p):
    """Three masses on curved tracks, each moved by both coordinates."""
    x, y = a[0], a[1]
    first = p["a"] * jnp.stack([jnp.cos(x), jnp.sin(x + 0.3 * y), y * y])
    second = p["b"] * jnp.stack([x * y, jnp.cos(y), jnp.sin(x)])
    third = p["c"] + 0.2 * jnp.stack([x - y, x * x, jnp.exp(0.3 * y)])
    return jnp.stack([first, second, third])


def driving(t, a, a_dot, p):
    """Springs, a damper with cross terms, and a motor."""
    return -p["k"] * a - p["d"] * a_dot[::-1] + 0.4 * jnp.sin(3.0 * t) * jnp.ones(2)


def height(x, y, p):
    return p["a"] * x**2 + p["b"] * jnp.sin(x + 2.0 * y)


def vase(s, p):
    return p["r"] + 0.3 * jnp.sin(s), p["h"] * s


# surfaces of body and base, from random numbers
PAIRS = {
    "ellipsoid on plane": (
        lambda u: rk.Ellipsoid(0.5 + u[:3]),
        lambda u: rk.Plane(),
    ),
    "ellipsoid in ellipsoid": (
        lambda u: rk.Ellipsoid(0.5 + 0.5 * u[:3]),
        lambda u: rk.Ellipsoid(3.0 + u[:3], inside=True),
    ),
    "torus on graph": (
        lambda u: rk.Torus(1.0 + u[0], 0.2 + 0.3 * u[1]),
        lambda u: rk.Graph(height, {"a": 0.1 * u[0], "b": 0.1 * u[1]}),
    ),
    "rim on cylinder": (
        lambda u: rk.DiscEdge(0.5 + u[0]),
        lambda u: rk.Cylinder(2.0 + u[0]),
    ),
    "revolution on torus": (
        lambda u: rk.Revolution(
            vase,
            {"r": 0.8 + 0.2 * u[0], "h": 0.7 + u[1]},
            domain=(0.2, 2.0),
            poles=(False, False),
            rising=True,
        ),
        lambda u: rk.Torus(4.0 + u[0], 1.5 + 0.5 * u[1]),
    ),
}


def random_scene(pair: str, sign: int, seed: int):
    """A scene, a time and a state in Voronets coordinates; the same tree for a pair."""
    draw = np.random.default_rng(1000 * sorted(PAIRS).index(pair) + seed)
    uniform, normal = draw.random, draw.standard_normal
    make_body, make_base = PAIRS[pair]
    square = normal((3, 3))
    cloud = square @ square.T + np.eye(3)
    inertia = np.trace(cloud) * np.eye(3) - cloud
    body = rk.Body(1.0 + uniform(), inertia, make_body(uniform(3)), 0.2 * normal(3))
    motion = moving_base(*(normal(3) for _ in range(4)))
    parameters = {
        "a": 0.5 * jnp.asarray(normal(3)),
        "b": 0.5 * jnp.asarray(normal(3)),
        "c": jnp.asarray(normal(3)),
        "k": jnp.asarray(uniform(2)),
        "d": jnp.asarray(uniform(2)),
    }
    masses = rk.PointMasses(
        0.2 + uniform(3), places, driving, parameters=parameters, coordinates=2
    )
    drag = Damping(*(jnp.asarray(normal(3)) for _ in range(2)), jnp.asarray(uniform()))
    scene = rk.Scene(
        body,
        rk.Base(make_base(uniform(3)), motion),
        masses,
        (rk.Gravity(normal(3)), drag),
    )
    state = rk.VoronetsState(
        contact_on_body=jnp.asarray(0.3 + uniform(2)),
        contact_on_base=jnp.asarray(0.3 + uniform(2)),
        angle=jnp.asarray(6.0 * uniform()),
        angular_velocity=jnp.asarray(normal(3)),
        alpha=jnp.asarray(normal(2)),
        alpha_dot=jnp.asarray(normal(2)),
        sign=sign,
    )
    return scene, jnp.asarray(0.1 * uniform()), state


def stacked(pair: str, sign: int, count: int):
    """Scenes, times and states of several seeds, with the seed in front."""
    drawn = [random_scene(pair, sign, seed) for seed in range(count)]
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *drawn)
