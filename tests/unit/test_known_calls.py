"""Calls that were checked before are not checked again, and no other call is."""

import gc
import weakref

import equinox as eqx
import jax
import numpy as np
import pytest

import rollkane as rk
from rollkane.codegen import NoCompilerError
from rollkane.simulation import run as run_module
from rollkane.simulation.known_calls import calls_of
from rollkane.validation.checks import FieldError

BALL = rk.Body(2.0, 0.008 * np.eye(3), rk.Sphere(0.1))
UP, TIMES = (1.0, 0.0, 0.0, 0.0), (0.0, 0.1)


def rolls(spin=1.0):
    scene = rk.Scene(BALL)
    return scene, rk.place(scene, UP, (0.0, spin, 0.0), (0.0, 0.0, 0.0))


@pytest.fixture
def checks(monkeypatch):
    """How often a call's scene and start have been checked."""
    seen = []
    check = run_module.check_law
    monkeypatch.setattr(
        run_module, "check_law", lambda *known: seen.append(1) or check(*known)
    )
    return seen


@pytest.mark.parametrize("modes", [None, rk.Modes(friction=0.3)], ids=["law", "modes"])
def test_a_call_is_checked_once(checks, modes):
    scene, start = rolls()
    other = rolls(2.0)[1]
    first = rk.simulate(scene, start, TIMES, modes=modes)
    again = rk.simulate(scene, start, np.array(TIMES), modes=modes)
    faster = rk.simulate(scene, other, list(TIMES), modes=modes)
    assert len(checks) == 1
    assert eqx.tree_equal(first.state, again.state)
    np.testing.assert_array_equal(faster.position[0], first.position[0])
    assert faster.position[-1, 0] > 1.9 * first.position[-1, 0]
    rk.simulate(rk.Scene(BALL), start, TIMES, modes=modes)
    assert len(checks) == 2


def test_other_options_are_checked(checks):
    scene, start = rolls()
    for k, options in enumerate(
        [{}, {"rtol": 1e-7}, {"atol": 1e-8}, {"max_steps": 50}, {"dt0": 1e-3}]
        + [{"modes": rk.Modes(friction=mu)} for mu in (0.2, 0.3)]
    ):
        rk.simulate(scene, start, TIMES, **options)
        assert len(checks) == k + 1
        rk.simulate(scene, start, TIMES, **options)
        assert len(checks) == k + 1
    rk.simulate(scene, start, (0.0, 0.2))
    assert len(checks) == k + 2


def test_what_equals_a_good_option_but_is_none_is_refused_all_the_same():
    scene, start = rolls()
    rk.simulate(scene, start, TIMES, max_steps=1000, rtol=0.1)
    rk.simulate(scene, start, TIMES, max_steps=1)
    for wrong in ({"max_steps": True}, {"rtol": True}, {"second_contact": 0}):
        with pytest.raises(FieldError):
            rk.simulate(scene, start, TIMES, **wrong)


def test_numbers_that_a_user_may_still_change_are_read_each_time():
    scene, start = rolls()
    gravity = np.array([0.0, 0.0, -9.81])
    changes = eqx.tree_at(lambda s: s.loads[0].acceleration, scene, gravity)
    asked = np.array(TIMES)
    still = rk.simulate(changes, start, asked)
    gravity[0], asked[1] = 1.0, 0.2
    falls = rk.simulate(changes, start, asked)
    # a uniform ball rolls down with 5/7 of gravity
    moved = falls.position[-1, 0] - 2.0 * still.position[-1, 0]
    np.testing.assert_allclose(moved, 0.5 * 5.0 / 7.0 * 0.2**2, rtol=1e-9)
    np.testing.assert_allclose(falls.time, [0.0, 0.2], rtol=0.0)


def test_modes_that_a_user_may_still_change_are_read_each_time():
    scene = rk.Scene(BALL)
    slides = rk.Scene(BALL, contact=rk.Slipping(rk.CoulombFriction(0.1)))
    start = rk.place(slides, UP, np.zeros(3), np.zeros(3), velocity=(3.0, 0.0, 0.0))
    friction = np.array(0.1)
    changes = eqx.tree_at(lambda m: m.friction, rk.Modes(friction=0.1), friction)
    first = rk.simulate(scene, start, TIMES, modes=changes).velocity[-1, 0]
    friction[...] = 0.2
    second = rk.simulate(scene, start, TIMES, modes=changes).velocity[-1, 0]
    np.testing.assert_allclose([first, second], 3.0 - 9.81 * 0.1 * np.array([0.1, 0.2]))


def test_a_call_is_forgotten_with_its_scene():
    scene, start = rolls()
    for modes in (None, rk.Modes(friction=0.3)):
        rk.simulate(scene, start, TIMES, modes=modes)
    assert len(calls_of(scene)) == 2
    alive = weakref.ref(scene)
    del scene
    gc.collect()
    assert alive() is None


def test_not_more_calls_are_kept_than_are_worth_it():
    scene, start = rolls()
    for end in np.linspace(0.1, 0.2, 200):
        rk.simulate(scene, start, (0.0, end))
    assert 0 < len(calls_of(scene)) <= 64


def test_a_call_known_from_within_a_trace_serves_outside():
    scene, start = rolls()
    for modes in (None, rk.Modes(friction=0.3)):
        last = jax.jit(
            lambda s, modes=modes: rk.simulate(scene, s, TIMES, modes=modes).position
        )
        inside = last(start)
        outside = rk.simulate(scene, start, TIMES, modes=modes).position
        np.testing.assert_allclose(inside, outside, rtol=0.0, atol=1e-15)


def test_a_warning_names_the_line_that_called(monkeypatch):
    monkeypatch.setattr("rollkane.integration.integrate._warned", set())
    monkeypatch.setattr("rollkane.integration.backends._unusable", {})

    def fails(*_, **__):
        raise NoCompilerError("there is none")

    monkeypatch.setattr("rollkane.integration.prepared.around_loop", fails)
    scene, start = rolls()
    with pytest.warns(RuntimeWarning, match="there is none") as seen:
        rk.simulate(scene, start, TIMES)
    assert seen[0].filename == __file__
