"""Two changes of stability between neighbouring points of a branch, by hand."""

import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk
from rollkane import kane

G = 9.81


def moving(count, force, parameters):
    """Particles of unit mass on lines of their own, under a force."""
    return kane.KaneSystem(
        count,
        count,
        lambda t, q, u: u,
        parts=[kane.Particle(1.0, lambda t, q, u: jnp.zeros(3).at[:count].set(u))],
        generalized_forces=force,
        parameters=parameters,
    )


def critical(system, count, vary, span):
    """Kinds and values along the family of rests at zero."""
    rest = kane.KaneState(jnp.zeros(count), jnp.zeros(count))
    motion = rk.steady_motion(system, rest)
    branch = rk.steady_family(system, motion, vary, span)
    assert len(branch.points) < 110
    return [c.kind for c in branch.critical], [c.value for c in branch.critical]


@pytest.mark.parametrize("low", [3.31, 1.005, 5.965])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_spring_that_pushes_in_a_window(low, sign):
    """Or holds in it; amid the span, and in its first and its last step of 0.05."""

    def pushes(t, q, u, p):
        return -p["sign"] * (p["W"] - p["low"]) * (p["W"] - p["low"] - 0.02) * q

    parameters = {"W": 1.0, "low": low, "sign": sign}
    system = moving(1, pushes, parameters)
    kinds, values = critical(system, 1, "parameters.W", (1.0, 6.0))
    assert kinds == ["zero crossing"] * 2
    np.testing.assert_allclose(values, [low, low + 0.02], rtol=1e-9)


@pytest.mark.parametrize("start", [0.0, 0.003])
def test_damping_that_is_negative_in_a_window(start):
    """A Hopf point at either side; one may be a point of the branch."""

    def damps(t, q, u, p):
        return -(p["mu"] - p["low"]) * (p["mu"] - p["low"] - 0.01) * u - q

    system = moving(1, damps, {"mu": -1.0, "low": start})
    kinds, values = critical(system, 1, "parameters.mu", (-1.0, 1.0))
    assert kinds == ["Hopf"] * 2
    np.testing.assert_allclose(values, [start, start + 0.01], atol=1e-10)


def test_flutter_in_a_window():
    """x'' = -2 x + c y, y'' = -b y - c x: frequencies meet at b = 2 - 2 c, 2 + 2 c."""

    def turns(t, q, u, p):
        return jnp.stack([-2.0 * q[0] + 0.003 * q[1], -p["b"] * q[1] - 0.003 * q[0]])

    system = moving(2, turns, {"b": 1.0})
    kinds, values = critical(system, 2, "parameters.b", (1.0, 3.02))
    assert kinds == ["collision"] * 2
    # where two meet they are known to the root of their rounding, and b to rounding
    np.testing.assert_allclose(values, [1.994, 2.006], rtol=1e-9)


def test_frequencies_that_cross_are_not_critical():
    """Nor come near each other without a meeting."""

    def apart(t, q, u, p):
        return jnp.stack([-2.0 * q[0] + p["c"] * q[1], -p["b"] * q[1] + p["c"] * q[0]])

    for c in (0.0, 0.003):
        system = moving(2, apart, {"b": 1.0, "c": c})
        assert critical(system, 2, "parameters.b", (1.0, 3.02)) == ([], [])


@pytest.mark.slow
def test_rest_in_a_spinning_bowl_that_is_nearly_of_revolution():
    """It is thrown out between Omega^2 = g k / (1 - k a) of both curvatures alone."""
    ball = rk.Body(1.0, 0.4 * 0.01 * np.eye(3), rk.Sphere(0.1))
    bowl = rk.Graph(lambda x, y: 0.5 * (1.01 * x**2 + y**2))
    scene = rk.Scene(ball, rk.Base(bowl, rk.Spin(2.0)))
    origin = (0.0, 0.0, 0.0)
    start = rk.place(scene, (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 2.0), origin)
    motion = rk.steady_motion(scene, start, ("spin about z",))
    branch = rk.steady_family(scene, motion, "base.motion.rate", (1.0, 6.0))
    assert branch.stable.all()  # none of its points lies in the window
    values = [c.value for c in branch.critical]
    wanted = [np.sqrt(G * k / (1.0 - 0.1 * k)) for k in (1.0, 1.01)]
    np.testing.assert_allclose(values, wanted, rtol=1e-10)
