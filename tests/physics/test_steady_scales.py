"""Steady motions of any size: zeros, growth and signs do not depend on units."""

import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk
from rollkane import kane

G = 9.81
UPRIGHT, ORIGIN = (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)


def saddle(x, y, p):
    return 0.5 * p["k"] * (1.3 * y**2 - x**2)


def on_saddle(r, k, inside=()):
    body = rk.Body(1.0, 0.4 * r * r * np.eye(3), rk.Sphere(r))
    base = rk.Base(rk.Graph(saddle, {"k": k}))
    return rk.Scene(body, base, supported=inside)


def growth(r, k):
    return np.sqrt(5.0 / 7.0 * G * k / (1.0 + k * r))


@pytest.mark.parametrize(
    ("r", "k"),
    [(0.1, 1.0), (1e-4, 1e3), (1e-7, 1e6), (1e-5, 1.0), (1e4, 1e-5), (1e6, 1e-7)],
)
def test_a_ball_leaves_a_saddle_of_any_size(r, k):
    scene = on_saddle(r, k)
    motion = rk.steady_motion(scene, rk.place(scene, UPRIGHT, ORIGIN, ORIGIN))
    assert not motion.stable
    # two tilts and two velocities; three turns of the ball and its spin on the spot
    assert motion.eigenvalues.size == 4
    assert motion.clear
    # some 1e3 roundings, times the condition of a few
    np.testing.assert_allclose(motion.growth, growth(r, k), rtol=1e-11)


def bob(alpha):
    return jnp.stack([alpha[0], 0.0 * alpha[0], 0.0 * alpha[0] - 0.02])[None]


def spring(alpha, stiffness):
    return 0.5 * stiffness * alpha[0] ** 2


@pytest.mark.parametrize("rate", [1e2, 1e5, 1e6])
def test_a_stiff_spring_inside_hides_no_slow_growth(rate):
    """A bob h above the contact, d below the middle, that a stiff spring holds there.

    Of the tilt: ``((1.4 r^2 + m h^2) s^2 + g ((1 + m) c r^2 + m d)) = 0``, with the
    curvature c of the middle's path, -1 / (1 + r). The bob gives way by its weight and
    its acceleration, ``(g + h s^2) / rate^2`` of the tilt, which softens the tilt.
    """
    inside = rk.PointMasses(
        [0.3], bob, potential=spring, parameters=0.3 * rate**2, coordinates=1
    )
    scene = on_saddle(0.1, 1.0, inside)
    at = rk.place(scene, UPRIGHT, ORIGIN, ORIGIN, alpha=[0.0], alpha_dot=[0.0])
    motion = rk.steady_motion(scene, at)
    assert not motion.stable
    assert motion.eigenvalues.size == 6
    r, m, d, h = 0.1, 0.3, 0.02, 0.08
    steep = G * ((1.0 + m) * r**2 / (1.0 + r) - m * d)
    square = steep / (1.4 * r**2 + m * h**2)
    soft = m * (G + h * square) ** 2 / rate**2 / (2.0 * steep)
    np.testing.assert_allclose(motion.growth, np.sqrt(square), rtol=soft + 1e-10)


def beside(length, rate):
    """An inverted pendulum, and a mass on a spring that knows nothing of it."""

    def swing(t, q, u, p):
        v = p["l"] * u[0]
        return [v * jnp.cos(q[0]), 0.0, -v * jnp.sin(q[0])]

    def along(t, q, u):
        return [0.0, u[1], 0.0]

    def weight(t, q, u):
        return [0.0, 0.0, -G]

    def pull(t, q, u, p):
        return [0.0, -(p["w"] ** 2) * q[1], 0.0]

    return kane.KaneSystem(
        coordinates=2,
        speeds=2,
        kinematics=lambda t, q, u: u,
        parts=[kane.Particle(1.0, swing), kane.Particle(1.0, along)],
        loads=[kane.Load(swing, weight), kane.Load(along, pull)],
        parameters={"l": length, "w": rate},
    )


@pytest.mark.parametrize(("length", "rate"), [(1.0, 1e6), (1e3, 1e5), (1e-12, 1.0)])
def test_an_inverted_pendulum_falls_whatever_is_beside_it(length, rate):
    system = beside(length, rate)
    motion = rk.steady_motion(system, kane.KaneState(jnp.zeros(2), jnp.zeros(2)))
    assert not motion.stable
    assert motion.family == 0
    # rounding of some 1e2 operations
    np.testing.assert_allclose(motion.growth, np.sqrt(G / length), rtol=1e-13)


def sleeping(L, M):
    a, c = 0.2 * L, 0.3 * L
    moments = 0.2 * M * np.array([a * a + c * c, a * a + c * c, 2.0 * a * a])
    body = rk.Body(M, np.diag(moments), rk.Ellipsoid((a, a, c)))
    return rk.Scene(body), 40.0


def rattleback(L, M):
    inertia = [[2e-4, -2e-5, 0.0], [-2e-5, 1.6e-3, 0.0], [0.0, 0.0, 1.7e-3]]
    surface = rk.Ellipsoid((0.2 * L, 0.03 * L, 0.02 * L))
    body = rk.Body(M, M * L * L * np.array(inertia), surface, (0.0, 0.0, -0.01 * L))
    return rk.Scene(body), 3.0


def routh(L, M):
    inertia = M * L * L * np.diag([0.004, 0.004, 0.003])
    return rk.Scene(rk.Body(M, inertia, rk.Sphere(0.1 * L), (0.0, 0.0, 0.02 * L))), 60.0


@pytest.mark.parametrize("made", [sleeping, rattleback, routh])
def test_similar_scenes_have_similar_motions(made):
    """Froude's law: of lengths L and the same gravity times go as the root of L."""
    told = []
    for L, M in ((1.0, 1.0), (0.05, 1e-4), (1e-6, 1e-15), (1e3, 1e9), (1e6, 1e12)):
        scene, spin = made(L, M)
        at = rk.place(scene, UPRIGHT, (0.0, 0.0, spin / np.sqrt(L)), ORIGIN)
        motion = rk.steady_motion(scene, at, ("spin",))
        told.append((motion, motion.eigenvalues * np.sqrt(L)))
    first, values = told[0]
    for motion, scaled in told[1:]:
        assert (motion.stable, motion.family) == (first.stable, first.family)
        assert list(motion.zeros) == list(first.zeros)
        order = np.argsort(scaled.imag), np.argsort(values.imag)
        # single ones, rounding of some 1e3 operations and conditions up to 1e2
        np.testing.assert_allclose(scaled[order[0]], values[order[1]], atol=1e-9)
        sign, known = motion.energy_sign, first.energy_sign
        assert sign[2:6] == known[2:6]
        assert sign.reason == known.reason
    assert not (first.energy_sign.definite and first.growth > first.errors.max())
