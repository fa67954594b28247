"""Events that cannot be looked for: the field, the value and the remedy."""

import diffrax as dfx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk

BALL = rk.Body(1.0, 0.004 * np.eye(3), rk.Sphere(0.1))
SCENE = rk.Scene(BALL)
UP, STILL = (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
START = rk.place(SCENE, UP, (0.0, 1.0, 0.0), STILL)
clock = lambda scene, t, state: t - 0.5


@pytest.mark.parametrize(
    ("made", "said"),
    [
        (lambda: rk.Event(3.0), "Event.function: must be a function"),
        (lambda: rk.Event(lambda t: t), r"let it take \(scene, t, state\)"),
        (lambda: rk.Event(clock, 2), "Event.direction: is no direction, got 2"),
        (lambda: rk.Event(clock, True), "Event.direction: is no direction"),
        (lambda: rk.Event(clock, 0.5), "Event.direction: is no direction"),
        (lambda: rk.Event(clock, stop=1), "Event.stop: must be True or False"),
        (lambda: rk.Event(clock, name=3), "Event.name: must be a text"),
        (lambda: rk.Event(clock, most=0), "Event.most: must be a whole number"),
        (lambda: rk.Event(clock, most=10**6), "Event.most: is more than is kept"),
        (lambda: rk.Event.friction(-0.1), "coefficient: must not be negative"),
        (lambda: rk.Event.section(STILL), "normal: has no length"),
        (lambda: rk.Event.section((1.0, 0.0)), r"normal: must have shape \(3\)"),
    ],
)
def test_events_that_cannot_be(made, said):
    with pytest.raises(rk.FieldError, match=said):
        made()


WRONG = {
    "is no event, got 'lift'": {"stop": "lift"},
    r"give rollkane.Event.friction\(coefficient\)": {"stop": "friction"},
    r"give rollkane.Event.section\(normal\)": {"events": ("section",)},
    "is no event, got 3": {"events": 3},
    "is the name of several events, got 'a'": {
        "events": (rk.Event(clock, name="a"), rk.Event(clock, name="a"))
    },
    "gives ShapeDtypeStruct": {"events": rk.Event(lambda s, t, y: y.angular_velocity)},
    "gives a bool, which has no sign": {"events": rk.Event(lambda s, t, y: t > 1.0)},
    "cannot be traced by JAX": {"events": rk.Event(lambda s, t, y: y.nothing)},
    "simulate.adjoint: cannot be chosen with events": {
        "events": rk.Event(clock),
        "adjoint": dfx.DirectAdjoint(),
    },
}


@pytest.mark.parametrize("said", WRONG)
def test_runs_that_cannot_have_them(said):
    with pytest.raises(rk.FieldError, match=said):
        rk.simulate(SCENE, START, (0.0, 1.0), **WRONG[said])


def test_an_ensemble_names_itself():
    starts = jax.tree.map(lambda x: x[None], START)
    with pytest.raises(rk.FieldError, match=r"ensemble\.stop: is no event"):
        rk.ensemble(SCENE, starts, (0.0, 1.0), stop="lift")


def test_with_modes_an_event_fits_every_mode():
    slides = rk.Event(lambda s, t, y: y.slip[0] - 1.0, name="slides")
    how = {"modes": rk.Modes(friction=0.2)}
    with pytest.raises(rk.FieldError, match=r"cannot be traced by JAX.*slip"):
        rk.simulate(SCENE, START, (0.0, 1.0), events=slides, **how)

    def hidden(x):
        event = rk.Event(lambda s, t, y: t - x)
        return rk.simulate(SCENE, START, (0.0, 1.0), events=event, **how).final_time

    with pytest.raises(rk.FieldError, match="give an equinox module that holds"):
        jax.grad(hidden)(jnp.asarray(0.5))
