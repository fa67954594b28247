"""Derivatives of runs that end early: exact where used, NaN of what was not reached."""

import diffrax as dfx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk

from ..quick import slow_but

LEVEL, ORIGIN = (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
TIMES = np.array([0.0, 0.5, 1.0])


def pushed(m):
    """A ball of radius 0.1, 0.4 m r^2, with 1 N: it speeds up by 1 / (1.4 m)."""
    body = rk.Body(m, 0.4 * m * 0.01 * jnp.eye(3), rk.Sphere(0.1))
    push = rk.Force(lambda t, p: jnp.stack([1.0 + 0.0 * t, 0.0 * t, 0.0 * t]))
    return rk.Scene(body, loads=(push,))


def far(scene, t, state):
    return rk.contact_of(scene, t, state).position[0] - 0.2


def stopped(m):
    """A ball that is at 0.2 m after 0.75 s, and has gone 0.09 m in half a second."""
    scene = pushed(m)
    start = rk.place(scene, LEVEL, ORIGIN, ORIGIN)
    return rk.simulate(scene, start, TIMES, stop=rk.Event(far, name="far"))


READ = {
    "position": lambda run: run.position[..., 0],
    "energy": lambda run: run.energy,
    "sensor": lambda run: run.each(lambda s, t, y: rk.contact_of(s, t, y).position[0]),
}


@pytest.mark.parametrize("name", slow_but(["position", "sensor"], READ))
def test_outputs_that_were_not_reached_spoil_no_others(name):
    read = READ[name]

    def middle(m):
        return read(stopped(m))[1]

    exact = {"position": -0.125 / 1.4, "sensor": -0.125 / 1.4, "energy": -0.125 / 1.4}
    # rtol of a run, 1e-8, with some room
    np.testing.assert_allclose(jax.grad(middle)(1.0), exact[name], rtol=1e-7)
    np.testing.assert_allclose(jax.jacfwd(middle)(1.0), exact[name], rtol=1e-7)


@pytest.mark.parametrize("derivative", slow_but([jax.jacrev], [jax.jacfwd, jax.jacrev]))
def test_outputs_that_were_not_reached_have_no_derivative(derivative):
    """Also of what depends on the state alone, and of what would cancel."""

    def last(m):
        run = stopped(m)
        apart = run.position[-1, 0] - run.velocity[-1, 0]
        return jnp.stack([run.energy[-1], run.angular_velocity[-1, 1], apart])

    assert np.isnan(last(1.0)).all()
    assert np.isnan(derivative(last)(1.0)).all()


def test_a_member_with_a_bad_start_spoils_no_others():
    spins = jnp.array([[0.0, 1.0, 0.0], [0.0, jnp.nan, 0.0], [0.0, 3.0, 0.0]])

    def total(m):
        scene = pushed(m)
        place = lambda w: rk.place(scene, LEVEL, w, ORIGIN)
        runs = rk.ensemble(scene, jax.vmap(place)(spins), TIMES)
        return jnp.sum(jnp.where(runs.code == 0, runs.position[:, -1, 0], 0.0) ** 2)

    # ends at 0.1 w + 1 / (2.8 m), whose derivative at 1 kg is -1 / 2.8
    exact = -2.0 / 2.8 * (0.1 + 0.3 + 2.0 / 2.8)
    np.testing.assert_allclose(jax.grad(total)(1.0), exact, rtol=1e-7)


def test_truth_values_and_whole_numbers_are_those_of_no_state():
    run = stopped(1.0)
    goes = run.each(lambda scene, t, y: (y.angular_velocity[1] >= 0.0, y.orientation))
    np.testing.assert_array_equal(goes[0], [True, True, False])
    np.testing.assert_array_equal(np.isnan(goes[1])[:, 0], [False, False, True])
    np.testing.assert_array_equal(run.mode, [0, 0, 0])


@pytest.mark.parametrize("channel", [rk.Position, rk.Orientation])
def test_likelihoods_of_runs_that_end_early(channel):
    """Reverse mode as forward mode, of misfits that are linear and that are not."""
    values = np.array([[0.0, 0.0, 0.1]] * 3)
    if channel is rk.Orientation:
        values = np.array([[0.9, 0.1, 0.3, 0.1]] * 3) / np.sqrt(0.92)
    record = rk.Record(TIMES, {"seen": channel(values, 0.01)})

    def likelihood(m):
        scene = pushed(m)
        start = rk.place(scene, LEVEL, ORIGIN, ORIGIN)
        return rk.negative_log_likelihood(scene, start, record, max_steps=3)

    ahead, back = jax.jacfwd(likelihood)(1.0), jax.grad(likelihood)(1.0)
    # one rule and its transpose along the same steps: roundings
    np.testing.assert_allclose(back, ahead, rtol=1e-10)
    assert np.isfinite(back)


def test_a_run_with_modes_is_followed_for_as_many_steps_as_are_asked_for():
    """A leaning hoop, by a method of so low an order that it takes 21,000 steps."""
    hoop = rk.Scene(rk.Body(1.0, 0.09 * np.diag([0.5, 0.5, 1.0]), rk.DiscEdge(0.3)))
    leaning = (np.cos(0.6), np.sin(0.6), 0.0, 0.0)

    def spin_and_code(spin, **how):
        omega = jnp.stack([0.0 * spin, spin, 0.3 + 0.0 * spin])
        start = rk.place(hoop, leaning, omega, ORIGIN)
        modes = rk.Modes(friction=0.9)
        run = rk.simulate(hoop, start, np.array([0.0, 6.0]), modes=modes, **how)
        return run.final_state.parts.angular_velocity[1], (run.code, run.steps)

    def slope(**how):
        there = jax.value_and_grad(lambda x: spin_and_code(x, **how), has_aux=True)
        (_, (code, steps)), found = there(5.0)
        return int(code), int(steps), found

    many = {"rtol": 1e-10, "solver": dfx.Bosh3()}
    code, _, found = slope(**many)
    assert code == rk.Code.MAX_STEPS
    assert np.isnan(found)
    code, steps, found = slope(**many, max_steps=30_000)
    assert code == rk.Code.COMPLETED
    assert steps > 2**14
    # as many errors of a step, each of rtol
    np.testing.assert_allclose(found, slope(rtol=1e-10)[2], rtol=steps * 1e-10)
