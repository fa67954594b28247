"""Events of the user's own: where they are found, and how they move.

A ball rolls on a plane under a constant field along x: ``x = v t + 5/14 g t^2`` (the
acceleration of a homogeneous ball is 5/7 of the field's), ``y = w t``.
"""

import functools
import warnings

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk
from rollkane.dynamics.observables import energy

from ..quick import slow_but

UP, STILL = (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
RADIUS = 0.1
BALL = rk.Body(1.0, 0.4 * RADIUS**2 * np.eye(3), rk.Sphere(RADIUS))
EPS = float(np.finfo(float).eps)
METHODS = ("native", "diffrax")


def place_of(scene, t, state):
    return rk.contact_of(scene, t, state).position


class Passes(eqx.Module):
    """Where a coordinate of the ball's centre reaches a place [m]."""

    axis: int = eqx.field(static=True)
    place: jax.Array

    def __call__(self, scene, t, state):
        return place_of(scene, t, state)[self.axis] - self.place


def at(moment, scale=1.0):
    """Where a clock reads a time; it falls for a negative scale."""
    return lambda scene, t, state: scale * (t - moment)


def tilted(pull=1.4, v=0.0, w=0.3):
    """A ball on a plane with a field along x, and its start."""
    field = rk.Gravity(jnp.stack([jnp.asarray(pull), 0.0, -9.81]))
    scene = rk.Scene(BALL, loads=(field,))
    spin = jnp.stack([-w / RADIUS, jnp.asarray(v) / RADIUS, 0.0])
    return scene, rk.place(scene, UP, spin, STILL)


ORDER = (
    rk.Event(Passes(0, jnp.asarray(0.5)), name="x"),
    rk.Event(Passes(1, jnp.asarray(0.15)), 1, name="y"),
    rk.Event(Passes(1, jnp.asarray(0.15)), -1, name="y, falling"),
    rk.Event(at(0.613), name="first"),
    rk.Event(at(0.613 + 1e-9), name="second"),
    rk.Event(at(0.613), name="same as first"),
    rk.Event(at(0.25), name="at an output"),
    rk.Event(at(0.0), name="start"),
    rk.Event(at(4e-17), name="start, to rounding"),
    rk.Event(lambda s, t, y: jnp.sin(40.0 * t), 1, name="rising", most=3),
    rk.Event(lambda s, t, y: (t - 0.3) ** 3, name="flat"),
    rk.Event(lambda s, t, y: jnp.where(t > 0.41, 1.0, -2.0), name="jump"),
)


@functools.cache
def ordered(method):
    scene, start = tilted()
    return rk.simulate(
        *(scene, start, (0.0, 0.25, 1.5)), rtol=1e-11, events=ORDER, method=method
    )


@pytest.mark.parametrize("method", METHODS)
def test_events_are_found_where_they_are(method):
    run = ordered(method)
    assert run.succeeded
    with pytest.warns(RuntimeWarning, match='"rising" happened 9 times.*3 are kept'):
        events = run.events
    found = {name: np.asarray(e.times) for name, e in events.items()}
    # a step ends within four roundings of time and step; x and y have those of some 30
    # steps of lengths of order one, and an error of 30 rtol, over a rate of 0.3 or more
    exact, moved = 8 * EPS, 30 * 1e-11 / 0.3
    np.testing.assert_allclose(found["x"], [1.0], rtol=0, atol=moved)
    np.testing.assert_allclose(found["y"], [0.5], rtol=0, atol=moved)
    np.testing.assert_allclose(found["first"], [0.613], rtol=0, atol=exact)
    np.testing.assert_allclose(found["second"], [0.613 + 1e-9], rtol=0, atol=exact)
    np.testing.assert_allclose(found["same as first"], [0.613], rtol=0, atol=exact)
    np.testing.assert_allclose(found["at an output"], [0.25], rtol=0, atol=exact)
    np.testing.assert_allclose(found["jump"], [0.41], rtol=0, atol=exact)
    # sin rises through zero at k pi / 20; not at the start
    k = np.arange(1, 4)
    np.testing.assert_allclose(found["rising"], k * np.pi / 20, rtol=0, atol=exact)
    # a cube has no slope there, and a bracket that is closed
    np.testing.assert_allclose(found["flat"], [0.3], rtol=0, atol=exact)
    for name in ("y, falling", "start", "start, to rounding"):
        assert found[name].size == 0
    assert int(events["rising"].count) == 9


def quiet(run):
    """Events, of which more may have happened than are kept."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return run.events


def test_values_at_events_are_zero_to_rounding():
    run = ordered("native")
    for event in ORDER[:2]:
        found = quiet(run)[event.name]
        state = jax.tree.map(lambda x: x[0], found.states)
        value = event(run.scene, found.times[0], state)
        # it changes by 1.4 m/s at most, in four roundings of time and step (2 s), and
        # is the difference of numbers of 0.5 m
        assert abs(value) <= 1.4 * 4 * EPS * 2 + 4 * EPS


def test_both_loops_take_the_same_steps():
    one, other = map(ordered, METHODS)
    assert (one.method, other.method) == METHODS
    assert int(one.steps) == int(other.steps)
    # the same steps: their rounding
    np.testing.assert_allclose(one.position, other.position, rtol=0, atol=1e-13)
    same = one.event_record.time, other.event_record.time
    np.testing.assert_allclose(*same, rtol=0, atol=1e-13)


def test_a_smooth_event_is_found_in_five_further_tries():
    scene, start = tilted()
    reached = lambda scene, t, state: place_of(scene, t, state)[0] ** 3 - 0.1
    run = rk.simulate(scene, start, (0.0, 3.0), events=(rk.Event(reached, stop=True),))
    assert run.code == rk.Code.STOPPED
    # interpolation through all ends of tries multiplies their distances from the zero:
    # of a step 1/2, 1/2, 1/4, then 2^-4, 2^-8, 2^-15, 2^-29, 2^-56 at worst, which is
    # the fifth after the first; one more is refused by its error
    assert int(run.rejected_steps) <= 6


def test_a_run_with_events_that_never_come_is_the_run_without():
    """The same steps, and no more of them than without."""
    scene, start = tilted()
    how = {"rtol": 1e-9, "method": "native"}
    times = (0.0, 0.4, 0.9, 1.5)
    plain = rk.simulate(scene, start, times, **how)
    never = rk.Event(Passes(0, jnp.asarray(9.0)))
    watched = rk.simulate(scene, start, times, events=never, **how)
    assert int(plain.steps) == int(watched.steps)
    assert int(plain.rejected_steps) == int(watched.rejected_steps)
    np.testing.assert_array_equal(plain.position, watched.position)
    assert plain.events == {}
    assert watched.events["event 0"].times.size == 0


# -- how they move ---------------------------------------------------------------------


def crossing(x, method):
    """Time and state where x = d, of pull, speed and d, and the run's end there."""
    pull, v, d = x
    scene, start = tilted(pull, v)
    stop = rk.Event(Passes(0, d), 1, name="there")
    how = {"rtol": 1e-12, "stop": stop, "method": method}
    run = rk.simulate(scene, start, (0.0, 1.0, 3.0), **how)
    found = run.events["there"]
    state = jax.tree.map(lambda x: x[0], found.states)
    place = place_of(scene, found.times[0], state)
    last = place_of(scene, run.final_time, run.final_state)
    times = jnp.stack([found.times[0], run.final_time])
    return jnp.concatenate([times, place[:2], last[:2], energy_of(run, found)])


def energy_of(run, found):
    """At an event, from its state."""
    each = jax.vmap(energy, in_axes=(None, 0, 0))
    return each(run.scene, found.times, found.states)[:1]


def known_crossing(x):
    pull, v, d = x
    a = 5.0 / 7.0 * pull
    t = (jnp.sqrt(v * v + 2.0 * a * d) - v) / a
    place, speed = jnp.stack([d, 0.3 * t]), v + a * t
    stored = 0.7 * (speed**2 + 0.09) - pull * d + 9.81 * RADIUS
    return jnp.concatenate([jnp.stack([t, t]), place, place, stored[None]])


POINT = jnp.array([1.1, 0.2, 0.7])


@pytest.mark.parametrize("method", slow_but(["native"], METHODS))
def test_events_move_as_their_closed_form(method):
    """Times and states at events, and the end of a run that one stops."""
    f = functools.partial(crossing, method=method)
    every = jax.jit(lambda x: (f(x), jax.jacfwd(f)(x), jax.jacrev(f)(x)))
    found, forward, backward = every(POINT)
    exact, known = known_crossing(POINT), jax.jacfwd(known_crossing)(POINT)
    # some 30 steps of rtol 1e-12 of lengths and energies of one, over a rate of 1.2
    np.testing.assert_allclose(found, exact, rtol=0, atol=1e-10)
    # tangents of the same steps, of order one
    np.testing.assert_allclose(forward, known, rtol=0, atol=1e-9)
    # the same numbers in another order: roundings of 30 steps of 13 stages
    np.testing.assert_allclose(backward, forward, rtol=0, atol=1e-11)


def test_second_derivatives_of_events_are_refused():
    f = lambda x: crossing(x, "native")[0]
    with pytest.raises(rk.FieldError, match="has no second derivatives"):
        jax.hessian(f)(POINT)


# -- a ball leaves a ball --------------------------------------------------------------

BIG = 1.0
ON_TOP = rk.Scene(BALL, rk.Base(rk.Sphere(BIG)))


def beside_top(angle):
    """At rest, so far from the top [rad]."""
    where = BIG * jnp.stack([jnp.sin(angle), 0.0 * angle, jnp.cos(angle)])
    return rk.place(ON_TOP, UP, STILL, where)


def leaving(angle):
    stop = "lift-off"
    return rk.simulate(ON_TOP, beside_top(angle), (0.0, 10.0), rtol=1e-12, stop=stop)


def angle_of(run):
    x, _, z = place_of(ON_TOP, run.final_time, run.final_state)
    return jnp.arctan2(x, z)


def test_a_ball_leaves_a_ball_at_the_known_angle():
    """7/10 v^2 = g (R + r) (cos a_0 - cos a); N = 0 at v^2 = g (R + r) cos a."""
    angle = jnp.asarray(1e-6)
    run = leaving(angle)
    assert int(run.code) == rk.Code.STOPPED
    assert run.reason.endswith('"lift-off"')
    exact = jnp.arccos(10.0 / 17.0 * jnp.cos(angle))
    # energy is kept to some 80 steps of rtol 1e-12; N is found to rounding
    assert abs(angle_of(run) - exact) < 1e-10
    # the start is 1e-6 off the top: the limit is 4e-13 away, which the run resolves
    assert abs(angle_of(run) - jnp.arccos(10.0 / 17.0)) < 1e-10
    # the last output is not reached
    assert np.isnan(np.asarray(run.position)[1]).all()
    np.testing.assert_array_equal(run.events["lift-off"].times, run.final_time[None])


# Central differences of order h^8, over h
EIGHTH = np.array([1 / 280, -4 / 105, 1 / 5, -4 / 5, 4 / 5, -1 / 5, 4 / 105, -1 / 280])
AWAY = np.array([-4.0, -3.0, -2.0, -1.0, 1.0, 2.0, 3.0, 4.0])


def test_derivative_of_a_time_of_lift_off():
    """Against differences of the run, and of the angle against its closed form."""
    ends = lambda x: jnp.stack([(run := leaving(x)).final_time, angle_of(run)])
    angle, h = jnp.asarray(0.05), 1e-3
    of_time = jax.grad(lambda x: leaving(x).final_time)
    every = jax.jit(lambda x, y: (jax.jacfwd(ends)(x), of_time(x), jax.vmap(ends)(y)))
    first, backward, values = every(angle, angle + h * AWAY)
    # t = -ln(a) / k + ... with k = 2.5 / s: h^8 8! / (k a^9) / 630 = 1e-11; runs differ
    # by 1e-12 of roundings and steps, over h
    assert abs(EIGHTH @ values[:, 0] / h - first[0]) < 1e-8
    assert abs(backward - first[0]) < 1e-10 * abs(first[0])
    c, s = jnp.cos(angle), jnp.sin(angle)
    exact = 10.0 / 17.0 * s / jnp.sqrt(1.0 - (10.0 / 17.0 * c) ** 2)
    # tangents of 70 steps of rtol 1e-12, which grow by 1 / angle
    assert abs(first[1] - exact) < 1e-8


# -- many runs, and traced ones --------------------------------------------------------

HEIGHT = rk.Event.section((0.0, 0.0, 1.0), 1.0, -1, name="lower")
ANGLES = jnp.linspace(0.05, 0.4, 21)


@functools.cache
def many():
    starts = jax.vmap(beside_top)(ANGLES)
    how = {"rtol": 1e-9, "events": HEIGHT, "stop": "lift-off"}
    return rk.ensemble(ON_TOP, starts, (0.0, 0.6, 1.2), **how)


def alone(angle):
    how = {"rtol": 1e-9, "events": HEIGHT, "stop": "lift-off"}
    return rk.simulate(ON_TOP, beside_top(angle), (0.0, 0.6, 1.2), **how)


def test_members_of_an_ensemble_stop_alone():
    found = many()
    assert found.method == "native"
    stopped = np.asarray(found.code) == rk.Code.STOPPED
    assert 0 < stopped.sum() < ANGLES.size
    ends = found.events["lift-off"]
    assert ends.times.shape == (ANGLES.size, 1)
    np.testing.assert_array_equal(ends.count, stopped)
    np.testing.assert_array_equal(ends.times[stopped, 0], found.final_time[stopped])
    assert np.isnan(np.asarray(ends.times)[~stopped]).all()
    assert found.events["lower"].times.shape == (ANGLES.size, 16)
    assert sum(found.reasons.values()) == ANGLES.size
    assert any(reason.endswith('"lift-off"') for reason in found.reasons)
    # outputs behind the end are not reached
    late = np.asarray(found.final_time)[:, None] < np.asarray(found.time)
    lost = np.isnan(np.asarray(found.state.angular_velocity)).all(-1)
    np.testing.assert_array_equal(late, lost)


def test_runs_alone_in_batches_and_in_ensembles_are_the_same():
    batch = jax.jit(jax.vmap(alone))(ANGLES)
    found = many()
    assert batch.events["lower"].times.shape == (ANGLES.size, 16)
    for name, own in found.events.items():
        other = batch.events[name]
        np.testing.assert_array_equal(own.count, other.count)
        # the same steps in lanes of the same loop
        np.testing.assert_allclose(own.times, other.times, rtol=0, atol=1e-14)
    one = alone(ANGLES[-1])
    assert int(one.steps) == int(found.steps[-1])
    ends = one.events["lift-off"]
    # a lane's roots of errors are another's to rounding, and so are steps and states
    np.testing.assert_allclose(ends.times, found.final_time[-1:], rtol=0, atol=1e-11)
    assert ends.times.shape == (1,)


# -- what cannot be known --------------------------------------------------------------


def test_a_run_goes_as_far_as_its_events_are_known():
    scene, start = tilted(pull=1.4)
    hidden = lambda s, t, y: jnp.sqrt(0.5 - place_of(s, t, y)[0]) + 1.0
    before = lambda s, t, y: jnp.sqrt(0.5 - place_of(s, t, y)[0]) - 0.1
    events = (rk.Event(hidden, name="hidden"), rk.Event(before, name="before"))
    run = rk.simulate(scene, start, (0.0, 2.0), events=events)
    assert int(run.code) == rk.Code.EVENT_NOT_FINITE
    assert run.reason.endswith('"hidden"')
    # x = t^2 / 2 = 0.5; steps become as short as the clock tells, 10 roundings of 2 s,
    # one in five of which is left; the run's own error is 30 rtol of it, 3e-8
    assert abs(run.final_time - 1.0) < 1e-7
    # x = 0.49
    assert abs(run.events["before"].times[0] - 0.98**0.5) < 1e-7
    blind = rk.Event(lambda s, t, y: jnp.log(-1.0 - t), name="blind")
    lost = rk.simulate(scene, start, (0.0, 2.0), events=blind)
    assert int(lost.code) == rk.Code.EVENT_NOT_FINITE
    assert lost.final_time == 0.0
    assert lost.reason.endswith('"blind"')


def test_two_zeros_within_a_step_are_missed_and_outputs_find_them():
    """What is found are changes of the sign between the ends of steps."""
    scene, start = tilted()
    dip = rk.Event(lambda s, t, y: (t - 1.0) ** 2 - 1e-6, name="dip")
    seldom = rk.simulate(scene, start, (0.0, 2.0), events=dip)
    assert int(seldom.events["dip"].count) == 0
    often = rk.simulate(scene, start, (0.0, 1.0, 2.0), events=dip)
    found = np.asarray(often.events["dip"].times)
    # roundings of values of 1e-6 over a rate of 2e-3, of two halves of the time's
    np.testing.assert_allclose(found, [0.999, 1.001], rtol=0, atol=8 * EPS)


def test_derivatives_of_what_only_touches_zero_are_not_known():
    scene, start = tilted()

    def touching(x):
        event = rk.Event(lambda s, t, y: (t - 1.0) ** 2 * x, name="touch")
        run = rk.simulate(scene, start, (0.0, 1.0, 2.0), events=event)
        return run.events["touch"].times[0]

    time, moved = jax.jvp(touching, (jnp.asarray(1.0),), (jnp.asarray(1.0),))
    assert time == 1.0
    assert np.isnan(moved)


def test_what_only_touches_zero_leaves_other_events_alone_in_reverse():
    scene, start = tilted()

    def times_of(x):
        touch = rk.Event(lambda s, t, y: (t - 1.0) ** 2 * x, name="touch")
        crosses = rk.Event(at(0.613 * x), name="crosses")
        run = rk.simulate(scene, start, (0.0, 1.0, 2.0), events=(touch, crosses))
        return jnp.stack([run.events[name].times[0] for name in run.events])

    times, pull = jax.vjp(times_of, jnp.asarray(1.0))
    # a root of a clock that is certain to four roundings, of rate one
    np.testing.assert_allclose(times, [1.0, 0.613], rtol=0, atol=8 * EPS)
    rows = [pull(row)[0] for row in jnp.eye(2)]
    np.testing.assert_allclose(rows, [np.nan, 0.613], rtol=8 * EPS)


def test_backwards_an_event_is_found_in_the_order_of_the_run():
    scene, start = tilted(pull=0.0, v=1.0)
    how = [{"direction": way, "name": f"{way}"} for way in (-1, 0, 1)]
    events = [rk.Event(Passes(0, jnp.asarray(-0.7)), **way) for way in how]
    run = rk.simulate(scene, start, (2.0, 0.0), events=events)
    # a uniform motion: its roundings over a rate of one
    for name in ("-1", "0"):
        times = run.events[name].times
        np.testing.assert_allclose(times, [1.3], rtol=0, atol=32 * EPS)
    assert run.events["1"].times.size == 0


# -- with changes of the contact -------------------------------------------------------

MU, G, SPEED = 0.2, 9.81, 3.0
SLIDES = rk.Scene(BALL, contact=rk.Slipping(rk.CoulombFriction(MU)))
MODES = rk.Modes(friction=MU)
EARLY, LATE = rk.Event(Passes(0, jnp.asarray(0.5)), name="early"), Passes(0, 2.0)


def bowled(speed):
    """It slides by ``v t - mu g t^2 / 2`` until it rolls at 5/7 v."""
    velocity = jnp.stack([speed, 0.0 * speed, 0.0 * speed])
    start = rk.place(SLIDES, UP, STILL, STILL, velocity=velocity)
    stop = rk.Event(LATE, name="late")
    how = {"modes": MODES, "events": EARLY, "stop": stop, "rtol": 1e-11}
    return rk.simulate(rk.Scene(BALL), start, (0.0, 0.7, 2.0), **how)


def known_bowl(speed):
    early = (speed - jnp.sqrt(speed**2 - 2.0 * MU * G * 0.5)) / (MU * G)
    rolls = 2.0 * speed / (7.0 * MU * G)
    at = speed * rolls - 0.5 * MU * G * rolls**2
    return jnp.stack([early, rolls + (2.0 - at) / (5.0 / 7.0 * speed)])


def seen_of(run):
    """Times of both events, and the end."""
    times = [run.events[name].times[0] for name in ("early", "late")]
    return jnp.stack([*times, run.final_time])


def test_events_while_a_ball_slides_and_rolls():
    run = bowled(jnp.asarray(SPEED))
    assert run.method == "native"
    assert int(run.code) == rk.Code.STOPPED
    early, late = known_bowl(jnp.asarray(SPEED))
    # some 100 steps of rtol 1e-11 of lengths of 2 m, over 2 m/s
    np.testing.assert_allclose(seen_of(run), [early, late, late], rtol=0, atol=1e-9)
    modes = [int(run.events[name].states.mode[0]) for name in ("early", "late")]
    assert modes == [rk.Mode.SLIPPING, rk.Mode.ROLLING]
    assert np.isnan(np.asarray(run.position)[2]).all()
    assert int(run.switches.count) == 1


@pytest.mark.slow
def test_events_move_through_changes_of_the_contact():
    f = lambda speed: seen_of(bowled(speed))
    speed = jnp.asarray(SPEED)
    early, late = jax.jacfwd(known_bowl)(speed)
    # tangents of the same steps, of order one
    known = [early, late, late]
    np.testing.assert_allclose(jax.jacfwd(f)(speed), known, rtol=0, atol=1e-8)
    np.testing.assert_allclose(jax.jacrev(f)(speed), known, rtol=0, atol=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_values_that_jump_at_impacts_and_lift_offs_are_found_there(method):
    vertical = lambda s, t, y: y.velocity[2] if hasattr(y, "velocity") else 0.0 * t
    events = [rk.Event(vertical, way, name=name) for way, name in BOUNCING.items()]
    dropped = rk.release(rk.Scene(BALL), UP, STILL, (0.0, 0.0, 1.0 + RADIUS), STILL)
    modes = rk.Modes(friction=MU, restitution=0.5)
    how = {"modes": modes, "events": events, "method": method}
    run = rk.simulate(rk.Scene(BALL), dropped, (0.0, 2.0), **how)
    first = (2.0 / G) ** 0.5
    found = run.events["hit"].times
    hits = np.asarray(run.switches.time)[: int(run.switches.count)]
    np.testing.assert_array_equal(found, hits)
    # it rises and falls by half of the speed before
    hops = first * (1.0 + np.array([0.0, 1.0, 1.5]))
    # free flight is exact, impacts are found within 1e-12 of it
    np.testing.assert_allclose(found[:3], hops, rtol=0, atol=1e-10)
    middles = first * np.array([1.5, 2.25])
    np.testing.assert_allclose(run.events["top"].times[:2], middles, rtol=0, atol=1e-10)
    how = {"modes": rk.Modes(), "method": method}
    run = lambda **more: rk.simulate(
        ON_TOP, beside_top(jnp.asarray(0.05)), (0.0, 3.0), **how, **more
    )
    leaves, flies = run(stop="lift-off"), run()
    assert int(leaves.code) == rk.Code.STOPPED
    # both look for the zero of one force, each to the rounding of its own steps: the
    # run may stop before the contact has changed or behind it
    lifted = float(flies.switches.time[0])
    np.testing.assert_allclose(leaves.final_time, lifted, rtol=0, atol=1e-11)


BOUNCING = {-1: "top", 1: "hit"}


# -- where an event and a change of the contact are one --------------------------------

# m/s: before, at and just behind the change, by less and more than rounding
OFFSETS = np.concatenate(
    [np.zeros(32), 10.0 ** np.linspace(-17, -7, 32), -(10.0 ** np.linspace(-9, -7, 32))]
)
SPEEDS = np.random.default_rng(3).uniform(1.0, 5.0, OFFSETS.size)


class FastFor(eqx.Module):
    """By how much a ball is faster than it would roll, less an offset [m/s]."""

    offset: jax.Array

    def __call__(self, scene, t, state):
        spin = rk.dynamics.observables.angular_velocity(scene, t, state)[1]
        speed = rk.dynamics.observables.velocity(scene, t, state)[0]
        return speed - RADIUS * spin - self.offset


@functools.cache
def gripped(way, stops):
    """Many balls that slip until they roll, with and without events there."""

    def both(speed, offset):
        velocity = jnp.stack([speed, 0.0 * speed, 0.0 * speed])
        start = rk.place(SLIDES, UP, STILL, STILL, velocity=velocity)
        event = rk.Event(FastFor(offset), way, stop=stops, name="grip")
        how = {"modes": MODES, "rtol": 1e-10, "max_steps": 2000}
        run = lambda **more: rk.simulate(
            rk.Scene(BALL), start, (0.0, 1.0, 4.0), **how, **more
        )
        plain, watched = run(), run(events=event)
        found = watched.events["grip"]
        shown = [(x.code, x.position, x.switches.time[0]) for x in (plain, watched)]
        return *shown, found.times[0], found.count

    return jax.jit(jax.vmap(both))(SPEEDS, OFFSETS)


@pytest.mark.parametrize("way", [-1, 0])
def test_an_event_where_a_slip_ends_leaves_the_run_as_it_is(way):
    plain, watched, time, count = gripped(way, False)
    np.testing.assert_array_equal(plain[0], 0)
    np.testing.assert_array_equal(watched[0], 0)
    # 4 s of 5 m/s, by other steps: some 100 of rtol 1e-10 would be 2e-7; a constant
    # force is followed to rounding, and the change found to 1e-11 s of it
    np.testing.assert_allclose(watched[1], plain[1], rtol=0, atol=5e-11)
    np.testing.assert_allclose(watched[2], plain[2], rtol=0, atol=1e-11)
    # it never comes where the offset is behind the slip's end, by more than rounding
    np.testing.assert_array_equal(count, OFFSETS >= 0.0)
    known = (2.0 * SPEEDS / 7.0 - OFFSETS / 3.5) / (MU * G)
    # to four roundings of the clock and the step, or to 4e-12 of 5 m/s at a change,
    # over a rate of 3.5 mu g = 7 m/s^2
    comes = OFFSETS >= 0.0
    np.testing.assert_allclose(time[comes], known[comes], rtol=0, atol=1e-11)


def test_an_event_where_a_slip_ends_may_stop_the_run():
    _, watched, time, count = gripped(-1, True)
    comes = OFFSETS >= 0.0
    np.testing.assert_array_equal(watched[0] == rk.Code.STOPPED, comes)
    np.testing.assert_array_equal(watched[0] == 0, ~comes)
    np.testing.assert_array_equal(count, comes)
    known = (2.0 * SPEEDS / 7.0 - OFFSETS / 3.5) / (MU * G)
    np.testing.assert_allclose(time[comes], known[comes], rtol=0, atol=1e-11)


@functools.cache
def lifted():
    """Many balls that leave a ball, with and without an event there."""
    angles = np.linspace(0.02, 0.3, 96)

    def both(angle):
        how = {"modes": rk.Modes(), "rtol": 1e-10, "max_steps": 2000}
        run = lambda **more: rk.simulate(
            ON_TOP, beside_top(angle), (0.0, 3.0), **how, **more
        )
        event = rk.Event(rk.Event.lift_off().function, name="lifts")
        plain, watched = run(), run(events=event)
        found = watched.events["lifts"]
        shown = [(x.code, x.position, x.switches.time[0]) for x in (plain, watched)]
        return *shown, found.times[0], found.count

    return jax.jit(jax.vmap(both))(angles)


def test_an_event_at_a_lift_off_leaves_the_run_as_it_is():
    plain, watched, time, count = lifted()
    np.testing.assert_array_equal(plain[0], 0)
    np.testing.assert_array_equal(watched[0], 0)
    # the same steps until the change, which is found to 1e-11 s, at 3 m/s; and 3 s of
    # flight behind it
    np.testing.assert_allclose(watched[1], plain[1], rtol=0, atol=1e-10)
    np.testing.assert_allclose(watched[2], plain[2], rtol=0, atol=1e-11)
    # once: in flight the force stays zero
    np.testing.assert_array_equal(count, 1)
    np.testing.assert_allclose(time, plain[2], rtol=0, atol=1e-11)


def test_a_tangent_may_be_a_float_of_python():
    """Of a number that a base moves by, in a run with an event."""

    def falls_at(size):
        moves = lambda t, a: jnp.stack([0 * t, 0 * t, a * jnp.sin(14.0 * t)])
        plate = rk.Base(rk.Plane(), rk.BaseMotion(moves, parameters=size))
        scene = rk.Scene(rk.Body(1.0, 0.004 * np.eye(3), rk.Sphere(0.1)), plate)
        still = (0.0, 0.0, 0.0)
        start = rk.place(scene, (1.0, 0.0, 0.0, 0.0), still, still)
        return rk.simulate(scene, start, (0.0, 0.1), stop="lift-off").final_time

    found, moved = jax.jvp(falls_at, (0.08,), (1.0,))
    # N = g - a w^2 sin(w t) is zero at sin(w t) = g / (a w^2)
    share = 9.81 / (0.08 * 14.0**2)
    np.testing.assert_allclose(found, np.arcsin(share) / 14.0, rtol=1e-12)
    slope = -share / 0.08 / np.sqrt(1.0 - share**2) / 14.0
    np.testing.assert_allclose(moved, slope, rtol=1e-9)
