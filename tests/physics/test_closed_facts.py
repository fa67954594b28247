"""Facts that hold at machine precision, on the right-hand side alone."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk
from rollkane.dynamics.rolling import contact_force, contact_of
from rollkane.geometry.rotations import rotation_matrix

from .. import problems
from ..quick import slow_but

# a right-hand side is some 400 operations on numbers of order one, and the smallest
# moment is 1/50 of the largest: 1e-12 is 1e4 roundings
NOW = jnp.zeros(())
ROUNDING = 1e-12


def disc_accelerations(I, J, m, a, g, tilt, w):
    """Theory 8.1, on the node axes (e1' horizontal, e3' the axis of the disc)."""
    w1, w2, w3 = w
    cot = np.cos(tilt) / np.sin(tilt)
    one = (I * w2**2 * cot - (J + m * a**2) * w2 * w3 - m * g * a * np.cos(tilt)) / (
        I + m * a**2
    )
    two = (-I * w1 * w2 * cot + J * w1 * w3) / I
    three = m * a**2 * w1 * w2 / (J + m * a**2)
    # the node axes turn with (w1, w2, w2 cot), the components above are on them
    return np.array([one, two, three]), np.array([w1, w2, w2 * cot])


@pytest.mark.parametrize("tilt", [0.3, 1.1, 2.0])
def test_rolling_disc_equations(tilt):
    m, a, I, J, g = 0.7, 0.3, 0.011, 0.031 * 0.7, 9.81
    scene = rk.Scene(rk.Body(m, np.diag([I, I, J]), rk.DiscEdge(a)))
    node = np.array([0.4, -0.9, 2.3])
    # node axes: R = Rx(tilt), then a spin of 0.8 about the axis, a turn of 0.5 about z
    q = problems.product(
        problems.product(problems.turn(2, 30.0), problems.turn(0, np.rad2deg(tilt))),
        problems.turn(2, 50.0),
    )
    spin = problems.matrix(problems.turn(2, 50.0))  # body -> node axes
    fixed = problems.matrix(q) @ spin.T @ node
    contact = [0.1, -0.2, 0.0]
    start = rk.place(scene, q, fixed, contact)
    rates = rk.rolling_derivative(scene, NOW, start)
    found = spin @ np.asarray(rates.angular_velocity)
    dots, frame = disc_accelerations(I, J, m, a, g, tilt, node)
    exact = dots + np.cross(frame, node)  # absolute derivative on the node axes
    np.testing.assert_allclose(
        found, exact, rtol=0, atol=ROUNDING * np.abs(exact).max()
    )


def test_torus_converges_to_the_sharp_rim():
    """Rates differ by O(r): the tube radius over the radius of the disc."""
    q = problems.turn(0, 70.0)

    def acceleration(surface):
        scene = rk.Scene(rk.Body(1.0, np.diag([0.0156, 0.0156, 0.0312]), surface))
        start = rk.place(scene, q, (0.3, -4.0, 1.0), (0.0, 0.0, 0.0))
        rates = rk.rolling_derivative(scene, NOW, start)
        return np.asarray(rates.angular_velocity)

    rim = acceleration(rk.DiscEdge(0.25))
    gaps = [
        np.abs(acceleration(rk.Torus(0.25, r)) - rim).max() for r in (1e-2, 1e-4, 1e-6)
    ]
    assert gaps[0] < 1.0
    for wide, narrow in itertools.pairwise(gaps):
        assert 0.9e-2 < narrow / wide < 1.1e-2


SEMI_AXES = jnp.array([0.2, 0.13, 0.09])


def support_point(direction, axes):
    stretched = axes**2 * direction
    return stretched / jnp.sqrt(jnp.sum(stretched * direction))


DESCRIPTIONS = {
    "direction": rk.Parametric(support_point, SEMI_AXES, of_direction=True),
    "chart": rk.Parametric(
        lambda u, v, s: (
            s
            * jnp.stack([jnp.cos(v) * jnp.cos(u), jnp.cos(v) * jnp.sin(u), jnp.sin(v)])
        ),
        SEMI_AXES,
    ),
    "implicit": rk.Implicit(lambda p, s: jnp.sum((p / s) ** 2) - 1.0, SEMI_AXES),
}

BASES = {
    "plane": (rk.Plane(), (0.3, -0.2, 0.0)),
    "graph": (rk.Graph(lambda x, y: 0.4 * x**2 + 0.2 * x * y), (0.3, -0.2, 0.024)),
    "cavity": (rk.Sphere(1.5, inside=True), (0.9, 0.0, -1.2)),
    "torus": (rk.Torus(1.0, 0.3), (1.18, 0.0, 0.24)),
}


@pytest.mark.parametrize("base", slow_but(["plane"], BASES))
@pytest.mark.parametrize("description", DESCRIPTIONS)
def test_three_descriptions_of_one_ellipsoid(base, description):
    """A catalogue, a parametric and an implicit ellipsoid move alike."""
    surface, contact = BASES[base]
    q = problems.product(problems.turn(0, 40.0), problems.turn(1, -25.0))

    def all_of(shape):
        scene = rk.Scene(
            rk.Body(1.2, np.diag([0.01, 0.012, 0.02]), shape, (0.01, -0.02, 0.03)),
            rk.Base(surface),
        )
        start = rk.place(scene, q, (1.0, -2.0, 3.0), contact)
        seen = contact_of(scene, NOW, start)
        rates = rk.rolling_derivative(scene, NOW, start)
        return (
            seen.body_point,
            seen.velocity,
            seen.position,
            rates.angular_velocity,
            rates.contact_on_base,
            contact_force(scene, NOW, start),
        )

    for found, exact in zip(
        all_of(DESCRIPTIONS[description]), all_of(rk.Ellipsoid(SEMI_AXES)), strict=True
    ):
        size = float(jnp.max(jnp.abs(exact)))
        np.testing.assert_allclose(found, exact, rtol=0, atol=10 * ROUNDING * size)


def test_rates_move_the_contact_along_both_surfaces():
    """Moving all coordinates by their rates keeps normals opposed: no slip, no gap."""
    surface, contact = BASES["graph"]
    scene = rk.Scene(
        rk.Body(1.2, 0.01 * np.eye(3), DESCRIPTIONS["implicit"], (0.01, 0.0, 0.0)),
        rk.Base(surface),
    )
    start = rk.place(scene, (1.0, 0.0, 0.0, 0.0), (1.0, -2.0, 3.0), contact)
    rates = rk.rolling_derivative(scene, NOW, start)

    def normals(state):
        seen = contact_of(scene, NOW, state)
        ground = scene.base.surface.geometry(state.contact_on_base)
        rotation = rotation_matrix(state.orientation)
        shell = scene.body.surface.geometry(state.contact_on_body)
        return rotation @ shell.normal + ground.normal, seen.position

    moved, velocity = jax.jvp(normals, (start,), (rates,))[1]
    assert float(jnp.max(jnp.abs(moved))) < ROUNDING * 10
    # velocity of the body origin: that of the contact point is zero, so w x (-rho)
    seen = contact_of(scene, NOW, start)
    arm = seen.rotation @ seen.body_point
    np.testing.assert_allclose(
        velocity, -jnp.cross(jnp.array([1.0, -2.0, 3.0]), arm), atol=10 * ROUNDING
    )


def test_theory_test_values_at_rest():
    """Section 10 of the equations, s = -1, for a base at rest without masses."""
    a = jnp.array([1.3, 1.0, 0.7])
    A = np.asarray(a) ** 2
    u, v = 1.35, 0.8
    x = np.sqrt(A[0] * (A[0] - u) * (A[0] - v) / ((A[0] - A[1]) * (A[0] - A[2])))
    y = np.sqrt(A[1] * (A[1] - u) * (A[1] - v) / ((A[1] - A[0]) * (A[1] - A[2])))
    z = np.sqrt(A[2] * (A[2] - u) * (A[2] - v) / ((A[2] - A[0]) * (A[2] - A[1])))
    rho = np.array([x, y, z])
    np.testing.assert_allclose(
        rho, [0.785891598037, 0.446004649941, 0.462011091172], atol=1e-11
    )
    ellipsoid = rk.Ellipsoid(a)
    geometry = ellipsoid.geometry(ellipsoid.locate(jnp.asarray(rho)))
    # principal curvatures k = b / a of the printed forms; e3 outwards
    k1, k2 = -1.176486099152 / 1.813806918116, -2.181978749316 / 1.993475897064
    np.testing.assert_allclose(geometry.principal_curvatures, [k2, k1], atol=1e-11)
    np.testing.assert_allclose(
        geometry.normal, [0.407197830739, 0.390543038800, 0.825630705271], atol=1e-11
    )
