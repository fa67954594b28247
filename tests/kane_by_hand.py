"""An ellipsoid with a particle on it, on a hill, in Kane's terms by hand.

Nothing of the rolling core is used: Euler parameters (scalar last), the contact's place
on the hill, and the contact point of an ellipsoid from its normal.
"""

import jax
import jax.numpy as jnp
import numpy as np

import rollkane as rk
from rollkane import kane

AXES = np.array([1.0, 0.8, 0.7])
MOMENTS = 0.2 * np.array([AXES[1] ** 2 + AXES[2] ** 2, 0.0, 0.0])
MOMENTS[1:] = 0.2 * (AXES[0] ** 2 + AXES[[2, 1]] ** 2)
PARTICLE = np.array([0.3, 0.4, 0.5])
HILL = np.array([0.05, 0.08, 0.05, 2.0, 2.0])  # p1, p2 [1/m], s1 [m], s2, s3 [1/m]
SPIN = np.array([0.5, 1.0, 0.3])  # the ellipsoid stands upright at the start
AT = np.array([0.3, 0.2])


def hill(x, y, p):
    return p[0] * x**2 + p[1] * y**2 + p[2] * jnp.sin(p[3] * x) * jnp.sin(p[4] * y)


def with_the_core():
    """Scene and start."""
    body = rk.Body(1.0, np.diag(MOMENTS), rk.Ellipsoid(AXES))
    particle = rk.PointMasses(0.1, lambda t: jnp.asarray(PARTICLE)[None])
    scene = rk.Scene(body, rk.Base(rk.Graph(hill, HILL)), particle, (rk.Gravity(),))
    place = [*AT, float(hill(*AT, HILL))]
    return scene, rk.place(scene, [1.0, 0.0, 0.0, 0.0], SPIN, place)


def by_hand():
    """System and start, on FIXED axes; u is the angular velocity on BODY axes."""

    def ground(xy):
        gradient = jax.grad(lambda xy: hill(xy[0], xy[1], HILL))(xy)
        normal = jnp.concatenate([-gradient, jnp.ones(1)])
        return normal / jnp.sqrt(jnp.sum(normal**2))

    def touching(R, xy):
        """Contact point from the centre, body axes."""
        down = -R.T @ ground(xy)
        squares = jnp.asarray(AXES**2)
        return squares * down / jnp.sqrt(jnp.sum(squares * down**2))

    def turned(e, w):
        turn = 0.5 * (e[3] * w + jnp.cross(e[:3], w))
        return jnp.concatenate([turn, -0.5 * jnp.sum(e[:3] * w)[None]])

    def rotation(q):
        return kane.euler_parameters_to_rotation(q[:4])

    def kinematics(t, q, u):
        e, xy = q[:4], q[4:]
        e_dot = turned(e, u)
        # the contact moves equally far over both surfaces: R d(touching)/dt = d(place)
        on_body = lambda e, xy: touching(kane.euler_parameters_to_rotation(e), xy)
        R = rotation(q)
        driven = jax.jvp(lambda e: on_body(e, xy), (e,), (e_dot,))[1]
        by_place = R @ jax.jacfwd(on_body, 1)(e, xy)
        place = lambda xy: jnp.stack([xy[0], xy[1], hill(xy[0], xy[1], HILL)])
        rows = (jax.jacfwd(place)(xy) - by_place)[:2]
        (a, b), (c, d) = rows
        x, y, _ = R @ driven
        det = a * d - b * c
        return [*e_dot, (d * x - b * y) / det, (a * y - c * x) / det]

    def of_point(place):
        def velocity(t, q, u):
            R = rotation(q)
            return R @ jnp.cross(u, place - touching(R, q[4:]))

        return velocity

    def weight(mass):
        return lambda t, q, u: mass * jnp.array([0.0, 0.0, -9.81])

    spin = lambda t, q, u: u
    centre, particle = of_point(np.zeros(3)), of_point(PARTICLE)
    system = kane.KaneSystem(
        coordinates=6,
        speeds=3,
        kinematics=kinematics,
        parts=[
            kane.RigidBody(1.0, np.diag(MOMENTS), centre, spin),
            kane.Particle(0.1, particle),
        ],
        loads=[kane.Load(centre, weight(1.0)), kane.Load(particle, weight(0.1))],
    )
    start = kane.KaneState(
        jnp.concatenate([jnp.array([0.0, 0.0, 0.0, 1.0]), AT]), jnp.asarray(SPIN)
    )
    return system, start
