"""Contact laws and loads: what is refused, and what each of them does by itself."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk
from rollkane.validation.checks import FieldError

UP, STILL = (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
BALL = rk.Body(2.0, 0.4 * 2.0 * 0.1**2 * np.eye(3), rk.Sphere(0.1))
SLIPPERY = rk.Scene(BALL, contact=rk.Slipping())
J = 1.4 * 2.0 * 0.1**2  # about the contact point


def started(scene=SLIPPERY, **more):
    return rk.place(scene, UP, STILL, STILL, **more)


REFUSED = {
    "a negative coefficient": (
        lambda: rk.CoulombFriction(-0.1),
        r"CoulombFriction.coefficient: must not be negative, got -0.1; give 0 or more",
    ),
    "no regularization": (
        lambda: rk.CoulombFriction(0.1, regularization=0.0),
        "CoulombFriction.regularization: must be",
    ),
    "text for a coefficient": (
        lambda: rk.ViscousFriction("oil"),
        "ViscousFriction.coefficient: must be made of numbers",
    ),
    "no friction law": (
        lambda: rk.Slipping(0.3),
        "Slipping.friction: cannot be a float.*CoulombFriction",
    ),
    "no contact law": (
        lambda: rk.Scene(BALL, contact="slipping"),
        "Scene.contact: cannot be a str.*RubberRolling",
    ),
    "a force of two components": (
        lambda: rk.Force((1.0, 2.0)),
        "Force.force: must have shape",
    ),
    "a force function of another shape": (
        lambda: rk.Force(lambda t, point: point.position[:2]),
        r"Force.force: returns shape \(2,\).*\(3,\)",
    ),
    "a force function of one argument": (
        lambda: rk.Force(lambda t: jnp.zeros(3)),
        r"Force.force: has a signature.*\(t, point\)",
    ),
    "a torque function of NumPy": (
        lambda: rk.Torque(lambda t, point: np.sin(np.asarray(point.position))),
        "Torque.torque: cannot be traced by JAX",
    ),
    "a potential that is a vector": (
        lambda: rk.Potential(lambda p: p),
        r"Potential.potential: returns shape \(3,\)",
    ),
    "a potential that is no function": (
        lambda: rk.Potential(3.0),
        "Potential.potential: must be a function",
    ),
    "a negative drag": (
        lambda: rk.Drag(quadratic=-1.0),
        "Drag.quadratic: must not be negative",
    ),
    "a negative resistance": (
        lambda: rk.RollingResistance(dry=-1.0),
        "RollingResistance.dry: must not be negative",
    ),
    "a velocity where the body rolls": (
        lambda: started(rk.Scene(BALL), velocity=(1.0, 0.0, 0.0)),
        "place.velocity: follows from the angular velocity.*Slipping",
    ),
    "a velocity off the base": (
        lambda: started(velocity=(1.0, 0.0, 0.5)),
        "place.velocity: would take the body off the base",
    ),
    "a rolling start in a slipping scene": (
        lambda: rk.simulate(SLIPPERY, started(rk.Scene(BALL)), [0.0, 1.0]),
        "simulate.start: is no state of a body that slips",
    ),
    "a slipping start in a rolling scene": (
        lambda: rk.simulate(rk.Scene(BALL), started(), [0.0, 1.0]),
        "simulate.start: is no state of a body that rolls",
    ),
    "the paper's equations for a body that slips": (
        lambda: rk.simulate(
            SLIPPERY, started(), [0.0, 1.0], formulation="euler_lagrange"
        ),
        'simulate.formulation: has rolling without slipping only.*use "rolling"',
    ),
    "the paper's coordinates for rubber": (
        lambda: rk.simulate(
            rk.Scene(BALL, contact=rk.RubberRolling()),
            started(rk.Scene(BALL)),
            [0.0, 1.0],
            coordinates="voronets",
        ),
        'simulate.coordinates: has rolling.*use "pole-free"',
    ),
}


@pytest.mark.parametrize(("make", "words"), REFUSED.values(), ids=list(REFUSED))
def test_refused(make, words):
    with pytest.raises(FieldError, match=words):
        make()


def turning(load, spin=STILL, t=0.0):
    """Angular acceleration of a ball on a plane without gravity, fixed axes."""
    scene = rk.Scene(BALL, loads=load)
    start = rk.place(scene, UP, spin, STILL)
    return np.asarray(rk.rolling_derivative(scene, jnp.asarray(t), start)
                      .angular_velocity)  # fmt: skip


def test_a_force_at_the_centre_rolls_the_ball():
    """J w' = r x F about the contact point."""
    found = turning(rk.Force((0.5, 0.2, 0.0)))
    np.testing.assert_allclose(found, [-0.1 * 0.2 / J, 0.1 * 0.5 / J, 0.0], atol=1e-14)


def test_a_force_at_a_point_has_its_arm():
    """At the top: twice the arm; beside: it spins the ball about the normal."""
    top = turning(rk.Force((0.5, 0.0, 0.0), point=(0.0, 0.0, 0.1)))
    np.testing.assert_allclose(top, [0.0, 0.2 * 0.5 / J, 0.0], atol=1e-14)
    beside = turning(rk.Force((0.5, 0.0, 0.0), point=(0.0, 0.1, 0.0)))
    own = 0.4 * 2.0 * 0.1**2
    expected = [0.0, 0.1 * 0.5 / J, -0.1 * 0.5 / own]
    np.testing.assert_allclose(beside, expected, atol=1e-13)


def test_functions_see_the_moving_point():
    """F = p t v of the top of a ball that rolls at w: v = 2 r w."""
    given = rk.Force(
        lambda t, point, p: p * t * point.velocity, (0.0, 0.0, 0.1), parameters=3.0
    )
    found = turning(given, spin=(0.0, 2.0, 0.0), t=0.5)
    force = 3.0 * 0.5 * 0.4
    np.testing.assert_allclose(found, [0.0, 0.2 * force / J, 0.0], atol=1e-13)
    torque = rk.Torque(lambda t, origin: -0.1 * origin.angular_velocity)
    found = turning(torque, spin=(0.0, 2.0, 0.0))
    np.testing.assert_allclose(found, [0.0, -0.2 / J, 0.0], atol=1e-14)


def test_drag_is_smooth_at_rest():
    drag = rk.Drag(linear=0.1, quadratic=0.2, angular=0.05)
    found = turning(drag, spin=(0.0, 3.0, 0.0))
    force = (0.1 + 0.2 * 0.3) * 0.3
    np.testing.assert_allclose(found, [0.0, -(0.1 * force + 0.15) / J, 0.0], atol=1e-13)
    scene = rk.Scene(BALL, loads=drag)
    start = started(scene)
    slope = jax.jacfwd(
        lambda w: (
            rk.rolling_derivative(
                scene, jnp.zeros(()), dataclasses.replace(start, angular_velocity=w)
            ).angular_velocity
        )
    )(jnp.zeros(3))
    assert np.isfinite(slope).all()
    np.testing.assert_allclose(slope[1, 1], -(0.1 * 0.01 + 0.05) / J, rtol=1e-12)


def test_a_spring_keeps_the_energy():
    """A potential counts in the energy, and its wrench gives no power."""
    pull = rk.Potential(lambda p, k: 0.5 * k * jnp.sum(p[:2] ** 2), parameters=40.0)
    scene = rk.Scene(BALL, loads=(rk.Gravity(), pull))
    start = rk.place(scene, UP, (0.0, 5.0, 1.0), (0.2, 0.0, 0.0))
    run = rk.simulate(scene, start, np.linspace(0.0, 2.0, 11), rtol=1e-11)
    np.testing.assert_allclose(run.energy, run.energy[0], rtol=1e-10)
    np.testing.assert_allclose(run.power, 0.0, atol=1e-13)
    # a ball of J / r^2 on a spring
    rate = np.sqrt(40.0 / (J / 0.01))
    x = 0.2 * np.cos(rate * run.time) + 0.5 / rate * np.sin(rate * run.time)
    np.testing.assert_allclose(run.position[:, 0], x, atol=1e-9)


def end_of(coefficient):
    """Where a sliding ball is after half a second."""
    law = rk.Slipping(rk.CoulombFriction(coefficient, 1e-3))
    scene = rk.Scene(BALL, contact=law)
    start = started(scene, velocity=(3.0, 0.5, 0.0))
    return rk.simulate(scene, start, [0.0, 0.5], rtol=1e-10).position[-1, 0]


def test_slipping_has_derivatives():
    """x = v t - mu g t^2 / 2 while it slips."""
    expected = -0.5 * 9.81 * 0.25 * 3.0 / np.hypot(3.0, 0.5)
    forward = jax.jvp(end_of, (0.1,), (1.0,))[1]
    np.testing.assert_allclose(forward, expected, rtol=1e-6)  # (eps / U)^2


@pytest.mark.slow
def test_reverse_mode_is_forward_mode():
    forward = jax.jvp(end_of, (0.1,), (1.0,))[1]
    np.testing.assert_allclose(jax.grad(end_of)(0.1), forward, rtol=1e-9)


def test_a_batch_of_slipping_bodies():
    ends = jax.vmap(end_of)(jnp.array([0.0, 0.05, 0.1]))
    times = 0.5
    expected = 3.0 * times - 0.5 * 9.81 * times**2 * np.array([0.0, 0.05, 0.1]) * (
        3.0 / np.hypot(3.0, 0.5)
    )
    np.testing.assert_allclose(ends, expected, rtol=1e-6)


def test_a_slipping_run_is_seen_from_outside():
    run = rk.simulate(
        SLIPPERY, started(velocity=(1.0, 0.0, 0.0)), np.linspace(0.0, 1.0, 5)
    )
    assert run.succeeded
    np.testing.assert_allclose(run.slip, [[1.0, 0.0, 0.0]] * 5, atol=1e-12)
    np.testing.assert_allclose(run.position[:, 0], run.time, atol=1e-12)
    written = run.to_xarray()
    np.testing.assert_allclose(written["slip"], run.slip)
    assert written["slip"].attrs["units"] == "m/s"
    assert "power" in written
    assert "slips" in written.attrs["title"]
    rolling = rk.Scene(BALL)
    still = rk.simulate(rolling, started(rolling), [0.0, 1.0])
    np.testing.assert_array_equal(still.slip, np.zeros((2, 3)))


def test_who_takes_energy_is_not_said_to_keep_it():
    """The summary and the pictures ask a scene what it keeps."""
    takes = (
        rk.Drag(0.1),
        rk.Force(STILL),
        rk.Torque(STILL),
        rk.RollingResistance(0.1),
        rk.SpinningResistance(dry=0.1),
    )
    assert all(rk.Scene(BALL, loads=load).does_work for load in takes)
    assert SLIPPERY.does_work
    spring = rk.Potential(lambda p: jnp.sum(p * p))
    keeps = (rk.Scene(BALL), rk.Scene(BALL, loads=spring))
    assert not any(scene.does_work for scene in keeps)
    assert not rk.Scene(BALL, contact=rk.RubberRolling()).does_work
