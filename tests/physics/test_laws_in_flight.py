"""Functions of the user's that look at contact coordinates while the body flies."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk

from ..quick import slow_but

INERTIA = 4e-3
BALL = rk.Body(1.0, INERTIA * np.eye(3), rk.Sphere(0.1))
LEVEL, STILL = (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
END, GAIN, AHEAD = 0.6, 0.5, 1.0
# w_y is a parabola in time: steps of order 5 and more are exact. Some ten of them, each
# some roundings of numbers up to ten.
CLOSE = 1e-12


def law(t, state, gain):
    """A torque about y by the place of the contact, as docs/control.md has it."""
    x = state.contact_on_base[0]
    return jnp.stack([0.0 * x, -gain * (x - 0.2), 0.0 * x])


def thrown(scene):
    return rk.release(scene, LEVEL, STILL, (0.0, 0.0, 0.2), (AHEAD, 0.0, 3.0))


@pytest.mark.parametrize(
    "restitution", [pytest.param(0.5, marks=pytest.mark.slow), None]
)
@pytest.mark.parametrize("outputs", [2, pytest.param(7, marks=pytest.mark.slow)])
def test_a_law_sees_the_nearest_points_at_every_instant(restitution, outputs):
    """It saw those of the last step's end, and without landings those of the start."""
    times = np.linspace(0.0, END, outputs)
    modes = rk.Modes(friction=0.3, restitution=restitution)

    def turned(gain):
        scene = rk.with_feedback(rk.Scene(BALL), law, gain)
        run = rk.simulate(scene, thrown(scene), times, modes=modes)
        return run.angular_velocity[-1, 1]

    share = -(0.5 * AHEAD * END**2 - 0.2 * END) / INERTIA
    assert float(turned(GAIN)) == pytest.approx(GAIN * share, rel=CLOSE)
    for slope in (jax.grad(turned)(GAIN), jax.jacfwd(turned)(GAIN)):
        assert float(slope) == pytest.approx(share, rel=CLOSE)


def test_a_law_sees_them_over_a_bowl():
    """By the nearest points' normal, of a bowl whose search is one by Newton's method.

    Power is what its torque does, so that energy and its integral agree.
    """

    def pushing(t, state, gain):
        out = state.contact_on_base / jnp.linalg.norm(state.contact_on_base)
        return gain * jnp.stack([out[1], -out[0], 0.0])

    bowl = rk.Base(rk.Ellipsoid((0.5, 0.45, 0.4), inside=True))
    scene = rk.with_feedback(rk.Scene(BALL, bowl), pushing, 0.3)
    place, flight = (0.05, 0.03, -0.1), (0.4, -0.2, 0.5)
    start = rk.release(scene, LEVEL, (1.0, -2.0, 3.0), place, flight)
    modes = rk.Modes(friction=0.3, restitution=0.5)
    nodes, weights = np.polynomial.legendre.leggauss(24)
    last = 0.12  # before it lands
    times = np.concatenate([[0.0], 0.5 * last * (1.0 + nodes), [last]])
    run = rk.simulate(scene, start, times, modes=modes, rtol=1e-11)
    assert int(run.switches.count) == 0
    work = 0.5 * last * np.sum(weights * np.asarray(run.power)[1:-1])
    # the law turns smoothly over the flight: quadrature of order 48, and steps at 1e-11
    gained = float(run.energy[-1] - run.energy[0])
    assert abs(work) > 1e-3
    assert gained == pytest.approx(work, abs=1e-10)


@pytest.mark.parametrize("restitution", slow_but([None], [0.5, None]))
def test_an_event_by_contact_coordinates_is_found_in_flight(restitution):
    """Where the ball is over x = 0.25 m; its time moves with the ball's speed."""
    event = rk.Event(lambda scene, t, y: y.contact_on_base[0] - 0.25, name="over")
    scene, modes = rk.Scene(BALL), rk.Modes(friction=0.3, restitution=restitution)

    def when(speed):
        start = rk.release(scene, LEVEL, STILL, (0.0, 0.0, 0.2), (speed, 0.0, 3.0))
        run = rk.simulate(scene, start, (0.0, END), modes=modes, events=(event,))
        return run.events["over"].times[0]

    slope = jax.jacfwd(when)(jnp.asarray(AHEAD))
    assert float(when(AHEAD)) == pytest.approx(0.25 / AHEAD, rel=CLOSE)
    assert float(slope) == pytest.approx(-0.25 / AHEAD**2, rel=CLOSE)
