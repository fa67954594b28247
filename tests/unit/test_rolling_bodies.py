"""What rolling bodies are refused for, and what refuses them."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk
from rollkane.validation.checks import FieldError

LEVEL = (1.0, 0.0, 0.0, 0.0)
STILL = (0.0, 0.0, 0.0)
BALL = rk.Body(0.7, 2.8e-3 * np.eye(3), rk.Sphere(0.1))
SHELL = rk.Body(1.0, 0.05 * np.eye(3), rk.Sphere(0.3))
INSIDE = rk.RollingBody(BALL, rk.Sphere(0.29, inside=True))
SCENE = rk.Scene(SHELL, supported=INSIDE)


@pytest.fixture(scope="module")
def own():
    return INSIDE.place(LEVEL, STILL, (0.0, 0.0, -0.29))


@pytest.fixture(scope="module")
def start(own):
    return rk.place(SCENE, LEVEL, (1.0, 0.0, 0.5), STILL, supported=own)


@pytest.mark.parametrize(
    ("options", "field"),
    [
        ({"body": 1.0}, "RollingBody.body"),
        ({"on": "bowl"}, "RollingBody.on"),
        ({"supported": (1.0,)}, "RollingBody.supported"),
        ({"contact": rk.Slipping()}, "RollingBody.contact"),
        ({"position": (0.0, 1.0)}, "RollingBody.position"),
        ({"rotation": (1.0, 1.0, 0.0, 0.0)}, "RollingBody.rotation"),
        ({"torque": lambda t, state: jnp.zeros(2)}, "RollingBody.torque"),
        ({"torque": 3.0}, "RollingBody.torque"),
    ],
)
def test_what_no_rolling_body_can_have(options, field):
    given = {"body": BALL, "on": rk.Sphere(0.29, inside=True)} | options
    with pytest.raises(FieldError) as refused:
        rk.RollingBody(**given)
    assert refused.value.field.startswith(field)


def test_a_body_that_does_not_fit_into_its_cavity():
    large = rk.RollingBody(BALL, rk.Sphere(0.09, inside=True))
    with pytest.raises(FieldError, match="would cut into the base"):
        large.place(LEVEL, STILL, (0.0, 0.0, -0.09))
    equal = rk.RollingBody(BALL, rk.Sphere(0.1, inside=True))
    with pytest.raises(FieldError, match="fit"):
        equal.place(LEVEL, STILL, (0.0, 0.0, -0.1))


@pytest.mark.parametrize("supported", [(), 3])
def test_a_place_without_its_states(own, supported):
    given = (own,) * supported if supported else ()
    with pytest.raises(FieldError, match="for each RollingBody"):
        rk.place(SCENE, LEVEL, STILL, STILL, supported=given)


TORUS = rk.Body(0.5, 1e-3 * np.eye(3), rk.Torus(0.08, 0.03))
FOREIGN = {
    "of a body with contact coordinates": (
        lambda own: rk.Scene(
            SHELL, supported=rk.RollingBody(TORUS, rk.Sphere(0.29, inside=True))
        ),
        lambda own: own,
        "[0].contact_on_body",
        (0,),
    ),
    "with a body of its own inside": (
        lambda own: SCENE,
        lambda own: eqx.tree_at(lambda s: s.supported, own, (own,)),
        "[0].supported",
        "1 states",
    ),
    "that lacks what rolls inside": (
        lambda own: rk.Scene(
            rk.Body(9.0, 2.0 * np.eye(3), rk.Sphere(0.9)),
            supported=rk.RollingBody(
                SHELL, rk.Sphere(0.8, inside=True), supported=INSIDE
            ),
        ),
        lambda own: own,
        "[0].supported",
        "0 states",
    ),
    "in a batch": (
        lambda own: SCENE,
        lambda own: jax.tree.map(lambda x: jnp.stack([x, x]), own),
        "[0].angular_velocity",
        (2, 3),
    ),
    "that slips": (
        lambda own: SCENE,
        lambda own: rk.place(
            rk.Scene(BALL, contact=rk.Slipping()), LEVEL, STILL, STILL
        ),
        "[0]",
        None,
    ),
    "in flight": (
        lambda own: SCENE,
        lambda own: rk.release(rk.Scene(BALL), LEVEL, STILL, (0.0, 0.0, 1.0), STILL),
        "[0]",
        None,
    ),
    "that is not finite": (
        lambda own: SCENE,
        lambda own: jax.tree.map(lambda x: x * np.nan, own),
        "[0]",
        None,
    ),
    "that is a number": (lambda own: SCENE, lambda own: (1.0,), "[0]", 1.0),
    "none": (lambda own: SCENE, lambda own: None, "", None),
}


@pytest.mark.parametrize("name", FOREIGN)
def test_a_place_with_a_state_of_another_scene(own, name):
    """Named by its field, before a contact is looked for."""
    scene, supported, field, value = (
        x(own) if callable(x) else x for x in FOREIGN[name]
    )
    with pytest.raises(FieldError) as refused:
        rk.place(scene, LEVEL, STILL, STILL, supported=supported)
    assert refused.value.field == f"place.supported{field}"
    assert "scene.supported[0].place(...)" in refused.value.remedy
    if value is not None:
        assert refused.value.value == value


def test_a_place_with_a_state_where_nothing_rolls_inside(own):
    with pytest.raises(FieldError, match="leave it out: no RollingBody") as refused:
        rk.place(rk.Scene(SHELL), LEVEL, STILL, STILL, supported=own)
    assert refused.value.field == "place.supported"


def test_a_start_of_another_scene(start):
    bare = rk.Scene(SHELL)
    with pytest.raises(FieldError) as refused:
        rk.simulate(bare, start, [0.0, 1.0])
    assert refused.value.field == "simulate.start.supported"
    with pytest.raises(FieldError) as refused:
        rk.simulate(SCENE, rk.place(bare, LEVEL, STILL, STILL), [0.0, 1.0])
    assert refused.value.field == "simulate.start.supported"
    other = rk.RollingBody(TORUS, rk.Sphere(0.29, inside=True))
    with pytest.raises(FieldError) as refused:
        rk.simulate(rk.Scene(SHELL, supported=other), start, [0.0, 1.0])
    assert refused.value.field == "simulate.start.supported[0].contact_on_body"


def test_what_cannot_have_rolling_bodies(start):
    times = [0.0, 1.0]
    refusing = {
        "simulate.modes": lambda: rk.simulate(
            SCENE, start, times, modes=rk.Modes(friction=0.3)
        ),
        "ensemble.modes": lambda: rk.ensemble(
            SCENE,
            jax.tree.map(lambda x: jnp.stack([x, x]), start),
            times,
            modes=rk.Modes(friction=0.3),
        ),
        "simulate.formulation": lambda: rk.simulate(
            SCENE, start, times, formulation="euler_lagrange"
        ),
        "simulate.coordinates": lambda: rk.simulate(
            SCENE, start, times, coordinates="voronets"
        ),
        "to_voronets.scene": lambda: rk.to_voronets(SCENE, start),
        "symmetries.scene": lambda: rk.symmetries(SCENE),
        "keeping_energy.scene": lambda: rk.keeping_energy(SCENE, start),
        "scene": lambda: rk.lyapunov_exponents(SCENE, start, 1.0),
    }
    for field, call in refusing.items():
        with pytest.raises(FieldError, match="roll on the rolling body") as refused:
            call()
        assert refused.value.field == field


def test_paths_of_results(start):
    run = rk.simulate(SCENE, start, [0.0, 0.1])
    assert run.rolling_body().path == (0,)
    for path in ((1,), (0, 0), (-1,)):
        with pytest.raises(FieldError, match="not there"):
            run.rolling_body(*path)


def test_a_slip_of_the_outer_body_changes_what_the_ball_feels(own):
    """The outer body may slip: without friction, gravity moves no mass sideways."""
    scene = rk.Scene(SHELL, supported=INSIDE, contact=rk.Slipping())
    start = rk.place(
        scene, LEVEL, (0.3, 0.2, 0.0), STILL, supported=own, velocity=STILL
    )
    run = rk.simulate(scene, start, [0.0, 0.5, 1.0], rtol=1e-11)
    sideways = np.asarray(run.momentum)[:, :2]
    # 1e-11 a step, some hundred steps, of a momentum of 0.1 kg m/s
    np.testing.assert_allclose(sideways - sideways[0], 0.0, atol=1e-10)
    moved = np.abs(run.rolling_body(0).angular_velocity[-1]).max()
    assert moved > 0.01


def test_bad_numbers_of_an_inner_state_are_named(start):
    bad = eqx.tree_at(
        lambda s: s.supported[0].angular_velocity, start, jnp.full(3, jnp.nan)
    )
    run = rk.simulate(SCENE, bad, [0.0, 0.1])
    assert run.code == rk.Code.BAD_START
    assert "supported[0].angular_velocity" in run.reason
