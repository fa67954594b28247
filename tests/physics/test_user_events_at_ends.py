"""Events on and beside ends of runs and of steps, and values that stay zero."""

import functools

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk

from ..quick import slow_but

UP, STILL = (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
SCENE = rk.Scene(rk.Body(1.0, 0.004 * np.eye(3), rk.Sphere(0.1)))
START = rk.place(SCENE, UP, (0.0, 1.0, 0.0), STILL)
EPS = float(np.finfo(float).eps)
WAYS = {
    "native": {"method": "native"},
    "diffrax": {"method": "diffrax"},
    "implicit": {"solver": dfx.Kvaerno5(), "rtol": 1e-6},
    "modes": {"modes": rk.Modes(friction=0.2)},
}
EACH = slow_but(["native", "diffrax", "modes"], WAYS)


class At(eqx.Module):
    """What a clock is short of a moment [s]."""

    moment: jax.Array

    def __call__(self, scene, t, state):
        return t - self.moment


@functools.cache
def clocked(way, stop):
    """A run with an event at a moment, of traced times."""

    def run(times, moment):
        event = rk.Event(At(moment), name="at", stop=stop)
        how = {"events": event, "max_steps": 500, **WAYS[way]}
        return rk.simulate(SCENE, START, times, **how)

    return jax.jit(run)


def check_clocked(run, moment, last, stop):
    assert int(run.code) == (rk.Code.STOPPED if stop else rk.Code.COMPLETED)
    found = run.events["at"]
    assert int(found.count) == 1
    # four roundings of the clock and the step, each of the longer time, 1.7 s
    assert abs(found.times[0] - moment) <= 2 * 4 * EPS * 1.7
    # the run's last step and the one to the event: five tries each at most
    assert int(run.rejected_steps) <= 10
    assert run.final_time == (found.times[0] if stop else last)
    if not stop:
        assert np.isfinite(np.asarray(run.position)).all()


# On the last time; within the hundred roundings in which diffrax halves what is left;
# within those in which it does not
BEFORE_THE_END = (0.0, EPS, 1e-15, 1e-14, 1e-13, 1e-12)


@pytest.mark.parametrize("stop", [False, True])
@pytest.mark.parametrize("way", EACH)
def test_an_event_at_the_end_of_a_run_ends_it_no_later(way, stop):
    run = clocked(way, stop)
    times = np.linspace(0.0, 1.7, 4)
    for short in BEFORE_THE_END:
        moment = 1.7 - short
        check_clocked(run(times, moment), moment, 1.7, stop)
        if way != "modes":  # they do not run backwards
            check_clocked(run(times[::-1], short), short, 0.0, stop)


@pytest.mark.parametrize("way", EACH)
def test_an_event_on_an_output_is_found_there_and_the_run_goes_on(way):
    times = np.linspace(0.0, 1.7, 4)
    for output in times[1:3]:
        for moment in (np.nextafter(output, 0.0), output, np.nextafter(output, 2.0)):
            run = clocked(way, False)(times, moment)
            check_clocked(run, moment, 1.7, False)


# -- values that stay zero -------------------------------------------------------------


def above(t, moment):
    return jnp.maximum(t - moment, 0.0)


def below(t, moment):
    return jnp.maximum(moment - t, 0.0)


# What it is of time, and when it happens; outputs lie on both sides of every change
RESTING = {
    "it comes to zero": (lambda t: below(t, 1.03), [1.03]),
    "from below": (lambda t: -below(t, 1.03), [1.03]),
    "by jumps": (lambda t: jnp.floor(2.0 * t) - 1.0, [0.5]),
    # the same crossing, counted where it began
    "on to the other side": (lambda t: below(t, 0.43) - above(t, 1.21), [0.43]),
    # no crossing
    "back": (lambda t: below(t, 0.43) + above(t, 1.21), [0.43]),
    "back and through": (
        lambda t: below(t, 0.43) + above(t, 0.9) - 3.0 * above(t, 1.3),
        [0.43, 1.5],
    ),
    # where it begins there: no event, until it crosses later
    "from the start": (lambda t: above(t, 0.7), []),
    "later": (lambda t: above(t, 0.3) - 2.0 * above(t, 0.9), [1.5]),
}


@functools.cache
def rested(way, direction=0):
    events = [
        rk.Event(lambda s, t, y, f=f: f(t), direction, name=name)
        for name, (f, _) in RESTING.items()
    ]
    times = np.arange(0.0, 2.05, 0.2)
    how = {"events": events, "max_steps": 500, **WAYS[way]}
    return rk.simulate(SCENE, START, times, **how)


@pytest.mark.parametrize("name", RESTING)
@pytest.mark.parametrize("way", EACH)
def test_a_value_that_stays_zero_is_one_event(way, name):
    run = rested(way)
    assert int(run.code) == rk.Code.COMPLETED
    found = run.events[name]
    # four roundings of the clock and the step, each of 2 s at most
    known = RESTING[name][1]
    np.testing.assert_allclose(found.times, known, rtol=0, atol=2 * 4 * EPS * 2)


@pytest.mark.parametrize("way", slow_but(["native"], ["native", "modes"]))
def test_values_at_rest_have_the_direction_in_which_they_came(way):
    falling, rising = rested(way, -1), rested(way, 1)
    both = rested(way)
    for name in RESTING:
        came_from_below = name in ("from below", "by jumps")
        counts = [int(run.events[name].count) for run in (rising, falling)]
        whole = int(both.events[name].count)
        assert counts == ([whole, 0] if came_from_below else [0, whole])


def test_a_value_that_rests_through_a_change_of_contact_is_one_event():
    """It slides until t = 2/7 v / (mu g) = 0.44 s, and is zero before and behind."""
    slides = rk.Scene(SCENE.body, contact=rk.Slipping(rk.CoulombFriction(0.2)))
    start = rk.place(slides, UP, STILL, STILL, velocity=(3.0, 0.0, 0.0))
    rests = rk.Event(lambda s, t, y: below(t, 0.2), name="rests")
    how = {"modes": rk.Modes(friction=0.2), "events": rests, "max_steps": 500}
    run = rk.simulate(SCENE, start, (0.0, 0.1, 1.0), **how)
    assert int(run.switches.count) == 1
    found = run.events["rests"].times
    # four roundings of the clock and the step
    np.testing.assert_allclose(found, [0.2], rtol=0, atol=8 * EPS)


@pytest.mark.parametrize("way", ["native", "modes"])
def test_a_value_that_touches_zero_on_an_output_is_found_there(way):
    touch = rk.Event(lambda s, t, y: (t - 0.8) ** 2, name="touch")
    how = {"events": touch, "max_steps": 500, **WAYS[way]}
    run = rk.simulate(SCENE, START, (0.0, 0.8, 2.0), **how)
    assert int(run.code) == rk.Code.COMPLETED
    np.testing.assert_array_equal(run.events["touch"].times, [0.8])


# -- at a change of the contact --------------------------------------------------------


class Height(eqx.Module):
    """Of the ball above a place [m]."""

    least: float

    def __call__(self, scene, t, state):
        return rk.contact_of(scene, t, state).position[2] - self.least


def test_an_event_that_a_landing_makes_has_no_derivative():
    """Not even one that looks well: its state moves with the landing."""
    down, half = [rk.Event(Height(least), name=str(least)) for least in (0.1, 0.3)]

    def times_of(height):
        place = jnp.stack([0.0 * height, 0.0 * height, 0.1 + height])
        start = rk.release(SCENE, UP, STILL, place, STILL)
        modes = rk.Modes(friction=0.2, restitution=0.5)
        how = {"modes": modes, "events": half, "stop": down, "max_steps": 500}
        run = rk.simulate(SCENE, start, (0.0, 1.0), **how)
        found = [run.events[event.name].times[0] for event in (half, down)]
        return jnp.stack([*found, run.final_time, run.switches.time[0]])

    times, moves = jax.jvp(times_of, (jnp.asarray(0.5),), (jnp.asarray(1.0),))
    fall, first = (2.0 * 0.5 / 9.81) ** 0.5, (2.0 * 0.3 / 9.81) ** 0.5
    # free flight is exact, a landing is found to some roundings of 1 s and 3 m/s
    known = [first, fall, fall, fall]
    np.testing.assert_allclose(times, known, rtol=0, atol=1e-12)
    # t = sqrt(2 (h - z) / g), and (h - z) / h' = 1 / (g t)
    known = [1.0 / (9.81 * first), np.nan, np.nan, 1.0 / (9.81 * fall)]
    np.testing.assert_allclose(moves, known, rtol=1e-10)
    # backwards, too, and it leaves what is known alone
    _, pull = jax.vjp(times_of, jnp.asarray(0.5))
    rows = [pull(row)[0] for row in jnp.eye(4)]
    np.testing.assert_allclose(rows, known, rtol=1e-10)


@pytest.mark.parametrize("stop", [True, False])
def test_a_lift_off_moves_with_the_change_that_it_is(stop):
    """Off a ball, with modes and without: there the event has a derivative itself."""
    scene = rk.Scene(SCENE.body, rk.Base(rk.Sphere(1.0)))
    how = {"stop" if stop else "events": "lift-off", "rtol": 1e-11}

    def ends(angle, **modes):
        x, z = jnp.sin(angle), jnp.cos(angle)
        start = rk.place(scene, UP, STILL, jnp.stack([x, 0.0 * x, z]))
        run = rk.simulate(scene, start, (0.0, 0.8), **how, **modes)
        found = run.events["lift-off"]
        spin = found.states.parts if modes else found.states
        parts = found.times[0], spin.angular_velocity[0, 1], run.final_time
        return jnp.stack(parts)

    def with_modes(angle):
        return ends(angle, modes=rk.Modes())

    wanted, moves = jax.jvp(ends, (0.3,), (1.0,))
    found, other = jax.jvp(with_modes, (0.3,), (1.0,))
    # of a tolerance of 1e-11, over some tens of steps
    np.testing.assert_allclose(found, wanted, rtol=1e-9)
    np.testing.assert_allclose(other, moves, rtol=1e-9)
    np.testing.assert_allclose(jax.jacrev(with_modes)(0.3), moves, rtol=1e-9)
