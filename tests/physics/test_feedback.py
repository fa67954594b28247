"""Control laws inside of runs, and the equations that controllers are made from."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk
from rollkane.dynamics.observables import power
from rollkane.geometry.rotations import rotation_matrix
from rollkane.validation.checks import FieldError

from ..outputs_alone import FIRST
from ..random_pairs import Pairs

LEVEL, STILL = (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
EGG = rk.Body(
    1.0, np.diag([0.01, 0.012, 0.015]), rk.Ellipsoid((0.2, 0.15, 0.1)), (0.0, 0.0, 0.01)
)
TIMES = np.linspace(0.0, 1.0, 5)


def braking(t, state, gain):
    """A torque against turning, on body axes."""
    del t
    return -gain * state.angular_velocity


def braking_torque(t, origin, gain):
    """The same on fixed axes."""
    del t
    return -gain * origin.angular_velocity


def test_a_torque_by_feedback_is_a_torque():
    scene = rk.Scene(EGG)
    start = rk.place(scene, LEVEL, (0.5, 2.0, 1.0), STILL)
    driven = rk.with_feedback(scene, braking, 0.02)
    twin = rk.Scene(
        EGG, loads=(rk.Gravity(), rk.Torque(braking_torque, parameters=0.02))
    )
    one = rk.simulate(driven, start, TIMES, rtol=1e-11)
    assert one.method == "native"
    other = rk.simulate(twin, start, TIMES, rtol=1e-11)
    # 1e-11 a step, some hundred steps
    np.testing.assert_allclose(one.position, other.position, atol=1e-9)
    np.testing.assert_allclose(one.power, other.power, atol=1e-9)
    assert np.ptp(one.energy) > 1e-2


def pushing(t, state, gains):
    """On everything: the body, a particle, a rolling body, and what that carries."""
    inner = state.supported[0]
    forces = [
        -gains[0] * state.angular_velocity,
        jnp.sin(t)[None] * gains[1] * jnp.ones_like(inner.angular_velocity),
        -gains[2] * inner.alpha_dot,
    ]
    return jnp.concatenate(forces)


def test_power_of_feedback_on_all_quasi_velocities():
    pairs = Pairs("ellipsoid in bowl in bowl", 5)
    scene = rk.with_feedback(pairs.scene, pushing, np.array([0.05, 0.02, 0.1]))
    assert scene.does_work
    step = 1e-3
    times = np.concatenate([[0.0], 0.3 + step * np.arange(-4, 5)])
    run = rk.simulate(scene, pairs.start, times, rtol=1e-13)
    change = np.tensordot(FIRST / step, run.energy[1:], axes=1)
    # rounding of some 30 J over the stencil, twice, and (20 * 1e-3)^8 * 20 / 630
    assert abs(change - run.power[5]) < 1e-10 * 30.0
    assert abs(run.power[5]) > 1e-3


def test_matrices_are_the_equations():
    """M u' = f + q gives the rates; names tell what is what."""
    pairs = Pairs("egg in a rocking cavity", 3)
    scene, start, t = pairs.scene, pairs.start, jnp.asarray(0.4)
    found = rk.equations_of_motion(scene, t, start)
    assert found.names == (
        *("w x", "w y", "w z"),
        *("alpha'[0]", "alpha'[1]", "alpha'[2]"),
        *("rolling[0] u x", "rolling[0] u y", "rolling[0] u z"),
    )
    q = np.linspace(-0.1, 0.2, 9)
    driven = rk.with_feedback(scene, lambda t, state, q: q + 0.0 * t, q)
    rates = rk.rolling_derivative(driven, t, start)
    own = rates.supported[0]
    known = [rates.angular_velocity, rates.alpha_dot, own.angular_velocity]
    solved = np.linalg.solve(found.mass_matrix, np.asarray(found.force) + q)
    # the condition of M, below 1e5, times roundings
    size = np.abs(solved).max()
    np.testing.assert_allclose(np.concatenate(known), solved, atol=1e-10 * size)
    assert np.linalg.eigvalsh(found.mass_matrix).min() > 0
    u = [start.angular_velocity, start.alpha_dot, start.supported[0].angular_velocity]
    # copies, but for the rounding of an alignment of normals
    np.testing.assert_allclose(found.velocities, np.concatenate(u), atol=1e-14)


def drive(t, own):
    """A torque of the carrier on a body in it, on that body's axes."""
    return jnp.stack([0.02, -0.01 * t, 0.03 + 0.1 * own.angular_velocity[0]])


def spring(t, alpha, alpha_dot):
    return 0.3 * jnp.sin(t) - 5.0 * alpha - 0.1 * alpha_dot


def driven_inside(t, state):
    own = state.supported[0]
    inner = spring(t, own.alpha, own.alpha_dot)
    return jnp.concatenate([jnp.zeros(3), drive(t, own), inner])


def rubber_ball_in_shell(torque=None, force=None):
    """A shell, in it a rubber ball with a mass on a spring."""
    ball = rk.Body(0.7, 2.8e-3 * np.eye(3), rk.Sphere(0.1))
    along = lambda alpha: jnp.stack([jnp.stack([0.02, alpha[0], 0.03])])
    mass = rk.PointMasses(0.2, along, force, coordinates=1)
    hollow = rk.Sphere(0.29, inside=True)
    rubber = rk.RubberRolling()
    inner = rk.RollingBody(ball, hollow, mass, rubber, torque=torque)
    shell = rk.Body(1.0, 0.05 * np.eye(3), rk.Sphere(0.3))
    return rk.Scene(shell, supported=inner), inner


# halves of turns about x after which the contact's normal, on the ball's axes, points
# up and down, and about which its third component changes its sign
@pytest.mark.parametrize("half", [0.3, 1.2, np.pi / 4 - 1e-9, np.pi / 4 + 1e-9])
def test_feedback_on_what_rolls_without_spin_is_a_torque(half):
    """As the torque of the carrier: on the ball's axes, less what the normal takes."""
    scene, inner = rubber_ball_in_shell()
    twin, _ = rubber_ball_in_shell(drive, spring)
    more = {"alpha": [0.01], "alpha_dot": [0.2]}
    turn, low = [np.cos(half), np.sin(half), 0.0, 0.0], [0.0, 0.0, -0.29]
    own = inner.place(turn, [0.4, 0.3, 0.0], low, **more)
    start, t = rk.place(scene, LEVEL, (0.5, 0.2, 0.1), STILL, supported=own), 0.4
    found = rk.rolling_derivative(rk.with_feedback(scene, driven_inside), t, start)
    expected = rk.rolling_derivative(twin, t, start)
    pairs = zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True)
    for one, other in pairs:
        # a few hundred roundings of accelerations of some ten
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-12)
    assert np.abs(expected.supported[0].angular_velocity).max() > 1.0
    powers = [
        power(each, jnp.asarray(t), start)
        for each in (rk.with_feedback(scene, driven_inside), twin)
    ]
    np.testing.assert_allclose(*powers, rtol=0, atol=1e-14)
    assert abs(powers[0]) > 1e-3


def test_what_feedback_is_refused_for():
    scene = rk.Scene(EGG)
    start = rk.place(scene, LEVEL, (0.5, 2.0, 1.0), STILL)
    with pytest.raises(FieldError, match="returns shape"):
        rk.with_feedback(scene, lambda t, state: jnp.zeros(4))
    rubber, _ = rubber_ball_in_shell()
    with pytest.raises(FieldError, match=r"returns shape \(6,\).*\(7,\)"):
        rk.with_feedback(rubber, lambda t, state: jnp.zeros(6))
    with pytest.raises(FieldError, match="must be a function"):
        rk.with_feedback(scene, 1.0)
    with pytest.raises(FieldError, match="must be a Scene"):
        rk.with_feedback(EGG, braking, 1.0)
    driven = rk.with_feedback(scene, braking, 0.02)
    with pytest.raises(FieldError, match="generalized forces"):
        rk.simulate(driven, start, TIMES, formulation="euler_lagrange")
    turned = (np.cos(0.3), np.sin(0.3), 0.0, 0.0)
    in_charts = rk.to_voronets(scene, rk.place(scene, turned, STILL, STILL))
    with pytest.raises(FieldError, match="generalized forces"):
        rk.euler_lagrange_derivative(driven, jnp.asarray(0.0), in_charts)
    rubber = rk.Scene(EGG, contact=rk.RubberRolling())
    with pytest.raises(FieldError, match="multipliers"):
        rk.equations_of_motion(rubber, 0.0, rk.place(rubber, LEVEL, STILL, STILL))


def hovering(t, state, gains):
    """A torque on what flies and rolls alike: no slip or place is asked for."""
    turn = rotation_matrix(state.orientation)
    return -gains * state.angular_velocity + 0.0 * turn[0] * t


def test_feedback_in_a_run_with_modes():
    """A ball that is thrown, bounces and rolls under a torque by its state."""
    ball = rk.Scene(rk.Body(0.5, 1e-3 * np.eye(3), rk.Sphere(0.1)))
    scene = rk.with_feedback(ball, hovering, np.full(3, 1e-4))
    start = rk.release(ball, LEVEL, (0.0, 5.0, 9.0), (0.0, 0.0, 0.3), (0.3, 0.0, 0.0))
    modes = rk.Modes(friction=0.3, restitution=0.5)
    run = rk.simulate(scene, start, np.linspace(0.0, 1.0, 11), modes=modes, rtol=1e-10)
    assert run.code == rk.Code.COMPLETED
    w = np.asarray(run.angular_velocity)[:, 2]
    # about the vertical only the torque acts on a ball: I w' = -c w
    expected = 9.0 * np.exp(-1e-4 / 1e-3 * run.time)
    # rtol 1e-10 a step of 9 rad/s, some dozen steps
    np.testing.assert_allclose(w, expected, atol=1e-8)


def test_gains_have_derivatives():
    scene = rk.Scene(EGG)
    start = rk.place(scene, LEVEL, (0.5, 2.0, 1.0), STILL)

    def spin(gain):
        driven = rk.with_feedback(scene, braking, gain)
        run = rk.simulate(driven, start, TIMES, rtol=1e-12)
        return run.state.angular_velocity[-1, 2]

    slope = jax.grad(spin)(jnp.asarray(0.02))
    h = 1e-4
    at = lambda k: spin(jnp.asarray(0.02 + k * h))
    off = (8 * (at(1) - at(-1)) - (at(2) - at(-2))) / (12 * h)
    # h^4 / 30 of a fifth derivative below 1e9, and steps' 1e-11 / h
    assert abs(slope - off) < 1e-6
