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
