"""Bodies, scenes, placing and simulating: what is accepted, what is refused and how."""

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk
from rollkane.dynamics.bodies import inertia_about
from rollkane.dynamics.rolling import contact_of

from .. import problems

LEVEL = (1.0, 0.0, 0.0, 0.0)
STILL = (0.0, 0.0, 0.0)
ORIGIN = (0.0, 0.0, 0.0)
INERTIA = np.diag([0.01, 0.02, 0.025])


def body(**changes):
    given = {"mass": 1.0, "inertia": INERTIA, "surface": rk.Ellipsoid((0.3, 0.2, 0.1))}
    return rk.Body(**(given | changes))


BAD_BODIES = {
    "mass zero": ({"mass": 0.0}, "Body.mass", "positive"),
    "mass negative": ({"mass": -2.0}, "Body.mass", "positive"),
    "mass NaN": ({"mass": np.nan}, "Body.mass", "finite"),
    "mass text": ({"mass": "1 kg"}, "Body.mass", "numbers"),
    "mass vector": ({"mass": [1.0]}, "Body.mass", "shape"),
    "com short": ({"center_of_mass": (0.0, 1.0)}, "Body.center_of_mass", "shape"),
    "com inf": ({"center_of_mass": (0, 0, np.inf)}, "Body.center_of_mass", "finite"),
    "inertia shape": ({"inertia": [1.0, 1.0, 1.0]}, "Body.inertia", "shape"),
    "inertia ragged": ({"inertia": [[1.0], [1.0, 2.0]]}, "Body.inertia", "numbers"),
    "asymmetric": (
        {"inertia": INERTIA + np.diag([1e-3, 0.0], 1)},
        "Body.inertia",
        "symmetric",
    ),
    "not positive": (
        {"inertia": np.diag([0.01, 0.02, -0.01])},
        "Body.inertia",
        "positive",
    ),
    "triangle": ({"inertia": np.diag([0.01, 0.01, 0.03])}, "Body.inertia", "triangle"),
    "surface": ({"surface": 0.1}, "Body.surface", "surface"),
}


@pytest.mark.parametrize("name", BAD_BODIES)
def test_bad_bodies(name):
    changes, field, word = BAD_BODIES[name]
    with pytest.raises(rk.FieldError, match=word) as caught:
        body(**changes)
    assert caught.value.field == field


def test_a_flat_disc_is_at_the_limit_and_allowed():
    """Its largest principal moment is the sum of the others, and may not be more."""
    disc = body(inertia=np.diag([0.0225, 0.0225, 0.045]))
    np.testing.assert_array_equal(disc.inertia, np.diag([0.0225, 0.0225, 0.045]))
    start = rk.place(rk.Scene(disc), LEVEL, [0.3, 0.2, 1.0], ORIGIN)
    assert np.isfinite(
        rk.rolling_derivative(rk.Scene(disc), 0.0, start).orientation
    ).all()
    with pytest.raises(rk.FieldError, match="inertia"):
        body(inertia=np.diag([0.0225, 0.0225, 0.04501]))


BAD_SCENES = {
    "motion": (lambda: rk.Base(rk.Plane(), motion=lambda t: t), "Base.motion"),
    "base": (lambda: rk.Scene(body(), rk.Plane()), "Scene.base"),
    "base surface": (lambda: rk.Base("plane"), "Base.surface"),
    "body": (lambda: rk.Scene(rk.Sphere(1.0)), "Scene.body"),
    "load": (lambda: rk.Scene(body(), loads=(9.81,)), "Scene.loads[0]"),
    "gravity": (lambda: rk.Gravity(9.81), "Gravity.acceleration"),
    "supported": (lambda: rk.Scene(body(), supported=(1,)), "Scene.supported[0]"),
    "contact": (lambda: rk.Scene(body(), contact="rolling"), "Scene.contact"),
}


@pytest.mark.parametrize("name", BAD_SCENES)
def test_bad_scenes(name):
    make, field = BAD_SCENES[name]
    with pytest.raises(rk.FieldError) as caught:
        make()
    assert caught.value.field == field


ON_SIDE = (0.5**0.5, 0.0, 0.5**0.5, 0.0)  # body axis z horizontal


def disc_flat():
    return rk.Scene(body(surface=rk.DiscEdge(0.2))), LEVEL, ORIGIN


def cylinder_on_plane():
    scene = rk.Scene(body(surface=rk.Cylinder(0.2)))
    return scene, ON_SIDE, ORIGIN


BAD_PLACES = {
    "quaternion": (
        lambda: (rk.Scene(body()), (1.0, 1.0, 0.0, 0.0), ORIGIN),
        "orientation",
        "unit",
    ),
    "off the base": (
        lambda: (rk.Scene(body()), LEVEL, (0.0, 0.0, 0.1)),
        "contact_on_base",
        "off",
    ),
    "flat disc": (disc_flat, "orientation", "cannot touch"),
    "line contact": (cylinder_on_plane, "contact_on_base", "fit each other"),
    "upright cylinder": (
        lambda: (rk.Scene(body(surface=rk.Cylinder(0.2))), LEVEL, ORIGIN),
        "orientation",
        "cannot touch",
    ),
    "conforming": (
        lambda: (
            rk.Scene(
                body(surface=rk.Sphere(0.2)), rk.Base(rk.Sphere(0.2, inside=True))
            ),
            LEVEL,
            (0.0, 0.0, -0.2),
        ),
        "contact_on_base",
        "fit each other",
    ),
    "too large": (
        lambda: (
            rk.Scene(
                body(surface=rk.Sphere(0.3)), rk.Base(rk.Sphere(0.2, inside=True))
            ),
            LEVEL,
            (0.0, 0.0, -0.2),
        ),
        "contact_on_base",
        "cut into",
    ),
    "pole of a chart": (
        lambda: (
            rk.Scene(
                body(
                    surface=rk.Parametric(
                        lambda u, v: (
                            0.1
                            * jnp.stack(
                                [
                                    jnp.cos(u) * jnp.cos(v),
                                    jnp.sin(u) * jnp.cos(v),
                                    jnp.sin(v),
                                ]
                            )
                        )
                    )
                )
            ),
            LEVEL,
            ORIGIN,
        ),
        "contact_on_base",
        "singular",
    ),
    "tip": (
        lambda: (rk.Scene(body(), rk.Base(rk.Cone(-1.0, inside=True))), LEVEL, ORIGIN),
        "contact_on_base",
        "singular",
    ),
    "graph that faces elsewhere": (
        lambda: (
            rk.Scene(body(surface=rk.Graph(lambda x, y: -(x**2) - y**2))),
            LEVEL,
            ORIGIN,
        ),
        "orientation",
        "cannot touch",
    ),
}


@pytest.mark.parametrize("name", BAD_PLACES)
def test_bad_places(name):
    make, field, word = BAD_PLACES[name]
    scene, orientation, contact = make()
    with pytest.raises(rk.FieldError, match=word) as caught:
        rk.place(scene, orientation, STILL, contact)
    assert caught.value.field in (f"place.{field}", field)
    assert caught.value.remedy


def test_wrong_lengths_when_placing():
    scene = rk.Scene(body())
    for arguments in (
        ((1.0, 0.0, 0.0), STILL, ORIGIN),
        (LEVEL, (0.0, 1.0), ORIGIN),
        (LEVEL, STILL, 0.0),
    ):
        with pytest.raises(rk.FieldError, match="shape"):
            rk.place(scene, *arguments)
    with pytest.raises(rk.FieldError, match=r"alpha.*shape"):
        rk.place(scene, LEVEL, STILL, ORIGIN, alpha=(1.0,))


def test_placing_on_a_sharp_base():
    """A ball on a rim: the fan of normals needs one of them."""
    rim = rk.Base(rk.DiscEdge(1.0))
    scene = rk.Scene(body(surface=rk.Sphere(0.2)), rim)
    normal = np.array([0.6, 0.0, 0.8])
    start = rk.place(scene, LEVEL, (0.0, 1.0, 0.0), (1.0, 0.0, 0.0), base_normal=normal)
    position = np.asarray(contact_of(scene, jnp.zeros(()), start).position)
    np.testing.assert_allclose(position, [1.12, 0.0, 0.16], atol=1e-14)


def test_placed_state_reproduces_what_was_asked():
    scene = rk.Scene(
        body(center_of_mass=(0.01, 0.02, -0.01)),
        rk.Base(rk.Graph(lambda x, y: 0.2 * x * x + 0.1 * y)),
    )
    q = problems.product(problems.turn(0, 35.0), problems.turn(2, 80.0))
    contact = np.array([0.5, -0.3, 0.2 * 0.25 - 0.03])
    start = rk.place(scene, q, (1.0, 2.0, 3.0), contact)
    result = rk.simulate(scene, start, (0.0, 1e-3))
    np.testing.assert_allclose(result.orientation[0], q, atol=1e-14)
    np.testing.assert_allclose(result.angular_velocity[0], [1.0, 2.0, 3.0], atol=1e-14)
    np.testing.assert_allclose(result.contact_on_base[0], contact, atol=1e-14)
    # the contact point of the body lies on that of the base
    rotation = problems.matrix(q)
    on_body = result.position[0] + rotation @ np.asarray(result.contact_on_body[0])
    np.testing.assert_allclose(on_body, contact, atol=1e-14)


def test_inertia_about_a_point():
    arm = jnp.array([0.1, -0.2, 0.3])
    rows = inertia_about(jnp.asarray(2.0), arm, jnp.asarray(INERTIA))
    c = np.asarray(arm)
    full = INERTIA + 2.0 * (c @ c * np.eye(3) - np.outer(c, c))
    for i in range(3):
        for j in range(i + 1):
            assert abs(float(rows[i][j]) - full[i, j]) < 1e-15


BAD_CALLS = {
    "times text": ({"times": "now"}, "simulate.times"),
    "one time": ({"times": [0.0]}, "simulate.times"),
    "not sorted": ({"times": [0.0, 2.0, 1.0]}, "simulate.times"),
    "NaN time": ({"times": [0.0, np.nan]}, "simulate.times"),
    "rtol": ({"rtol": -1e-9}, "simulate.rtol"),
    "rtol too tight": ({"rtol": 1e-17}, "simulate.rtol"),
    "atol": ({"atol": 0.0}, "simulate.atol"),
    "formulation": ({"formulation": "lagrange"}, "simulate.formulation"),
    "coordinates": ({"coordinates": "euler"}, "simulate.coordinates"),
    "start": ({"start": 3.0}, "simulate.start"),
    "other scene": (
        {"scene": rk.Scene(body(), rk.Base(rk.Sphere(1.0)))},
        "simulate.start.contact_on_base",
    ),
}


@pytest.mark.parametrize("name", BAD_CALLS)
def test_bad_calls(name):
    changes, field = BAD_CALLS[name]
    scene, start = problems.disc()
    given = {"scene": scene, "start": start, "times": [0.0, 1.0]} | changes
    with pytest.raises(rk.FieldError) as caught:
        rk.simulate(**given)
    assert caught.value.field == field


def test_a_lane_fails_alone():
    """One bad lane of a batch is marked; the others are right."""
    scene, start = problems.disc()
    bad = eqx.tree_at(lambda s: s.angular_velocity, start, jnp.full(3, jnp.nan))
    starts = jax.tree.map(lambda *x: jnp.stack(x), start, bad, start)
    times = (0.0, 0.5, 1.0)
    batch = jax.vmap(lambda s: rk.simulate(scene, s, times))(starts)
    alone = rk.simulate(scene, start, times)
    assert batch.code.tolist() == [
        rk.Code.COMPLETED,
        rk.Code.BAD_START,
        rk.Code.COMPLETED,
    ]
    assert np.isnan(np.asarray(batch.position[1, 1:])).all()
    for lane in (0, 2):
        # the same steps in another order of operations: 1e-9 is the tolerance
        np.testing.assert_allclose(batch.position[lane], alone.position, atol=1e-11)
        np.testing.assert_allclose(batch.energy[lane], alone.energy, rtol=1e-9)


def test_a_lane_that_cannot_be_placed_fails_alone():
    scene, _ = problems.disc()
    q = jnp.asarray(problems.turn(0, 70.0))

    def end(height):
        contact = jnp.stack([jnp.zeros(()), jnp.zeros(()), height])
        start = rk.place(scene, q, (0.0, 0.0, 1.0), contact)
        return rk.simulate(scene, start, (0.0, 0.2)).code

    codes = jax.vmap(end)(jnp.array([0.0, 0.3, 0.0]))
    assert codes.tolist() == [rk.Code.COMPLETED, rk.Code.BAD_START, rk.Code.COMPLETED]


def test_running_out_of_steps_keeps_what_was_reached():
    scene, start = problems.disc()
    times = np.linspace(0.0, 5.0, 26)
    short = rk.simulate(scene, start, times, max_steps=60)
    full = rk.simulate(scene, start, times)
    assert int(short.code) == rk.Code.MAX_STEPS
    assert "max_steps" in short.reason
    reached = float(short.final_time)
    known = times <= reached
    assert 1 < known.sum() < len(times)
    np.testing.assert_allclose(short.position[known], full.position[known], atol=1e-12)
    assert np.isnan(np.asarray(short.position[~known])).all()


def test_a_function_that_turns_nan_stops_the_run():
    """The place is said, what was reached is kept, and nothing hangs."""
    cliff = rk.Graph(lambda x, y: x * jnp.where(x < 0.9, 0.0, jnp.nan))
    ball = rk.Body(1.0, 4e-5 * np.eye(3), rk.Sphere(0.01))
    scene = rk.Scene(ball, rk.Base(cliff))
    start = rk.place(scene, LEVEL, (0.0, 40.0, 0.0), ORIGIN)
    result = rk.simulate(scene, start, np.linspace(0.0, 10.0, 101))
    assert int(result.code) == rk.Code.STEP_TOO_SMALL
    # it rolls at 0.4 m/s, and an evaluation meets the cliff at 2.25 s at the earliest
    assert 2.0 < float(result.final_time) <= 2.25
    assert float(result.final_state.contact_on_base[0]) < 0.9
    assert np.isfinite(np.asarray(result.position[:20])).all()


def test_cylinder_lying_on_a_ball():
    """The normal fixes the generator; the place on it is chosen, or asked for."""
    scene = rk.Scene(body(surface=rk.Cylinder(0.2)), rk.Base(rk.Sphere(1.0)))
    middle = rk.place(scene, ON_SIDE, STILL, (0.0, 0.0, 1.0))
    assert abs(float(middle.contact_on_body[1])) < 1e-12
    asked = rk.place(
        scene, ON_SIDE, STILL, (0.0, 0.0, 1.0), near_on_body=(0.2, 0.0, 0.52)
    )
    assert abs(float(asked.contact_on_body[1]) - 0.52) < 1e-9
    assert bool(rk.simulate(scene, middle, (0.0, 0.3)).succeeded)


def test_diffrax_objects_are_used_as_they_are():
    scene, start = problems.disc()
    exact = rk.simulate(scene, start, (0.0, 1.0), rtol=1e-11).position[-1]
    steps = rk.simulate(
        scene,
        start,
        (0.0, 1.0),
        solver=diffrax.Dopri5(),
        stepsize_controller=diffrax.ConstantStepSize(),
        dt0=1e-3,
        saveat=diffrax.SaveAt(ts=jnp.array([0.25, 0.5, 1.0])),
        adjoint=diffrax.RecursiveCheckpointAdjoint(),
        max_steps=4096,
    )
    assert steps.time.tolist() == [0.25, 0.5, 1.0]
    assert int(steps.steps) == 1000
    # order 5 at h = 1e-3 with rates of 10/s: 1e-10
    np.testing.assert_allclose(steps.position[-1], exact, atol=1e-9)


def test_results_are_jitted_and_batched_alike():
    scene, start = problems.disc()
    times = (0.0, 0.3, 0.6)
    plain = rk.simulate(scene, start, times)
    jitted = jax.jit(lambda s: rk.simulate(scene, s, times))(start)
    # another program of the same formulas: rounding, times the steps
    np.testing.assert_allclose(jitted.position, plain.position, atol=1e-13)
    np.testing.assert_allclose(jitted.contact_force, plain.contact_force, atol=1e-11)
    assert jitted.reason == "completed"


def test_where_it_touches_is_found_once_where_only_speeds_are_traced():
    scene, start = problems.rattleback()
    spin, turn = jnp.array([0.1, 0.2, 3.0]), start.orientation
    of_spin = lambda spin: rk.place(scene, turn, spin, ORIGIN)
    of_turn = lambda turn: rk.place(scene, turn, spin, ORIGIN)
    program = lambda of, at: str(jax.make_jaxpr(of)(at))
    # of what tells whether the surfaces can touch there
    assert "determinant_4x4" in program(of_turn, turn)
    assert "determinant_4x4" not in program(of_spin, spin)
    # another program of the same formulas: some roundings
    states = jax.jit(of_spin)(spin), of_spin(spin)
    for a, b in zip(*map(jax.tree.leaves, states), strict=True):
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-14)
    # and what is wrong there spoils the state
    nowhere = lambda spin: rk.place(scene, turn, spin, (0.0, 0.0, 1.0))
    assert np.all(np.isnan(jax.jit(nowhere)(spin).orientation))
