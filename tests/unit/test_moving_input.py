"""Moving bases, records and carried parts: what is refused, and in which words."""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk
from rollkane.integration.step_control import landings
from rollkane.validation.checks import FieldError
from tests import paper

UP, STILL = (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
BODY = rk.Body(1.0, 0.01 * np.eye(3), rk.Sphere(0.1))
SLIDE = lambda a: a[0] * jnp.ones((1, 3))
RECORD = rk.RecordedMotion(0.01 * np.arange(101), np.zeros(101))


def started(scene=None):
    scene = rk.Scene(BODY) if scene is None else scene
    rest = np.zeros(scene.coordinate_count)
    return rk.place(scene, UP, STILL, STILL, alpha=rest, alpha_dot=rest)


REFUSED = {
    "a rotation that grows": (
        lambda: rk.BaseMotion(rotation=lambda t: (1.0 + t) * jnp.eye(3)),
        "BaseMotion.rotation: is not a rotation at 0.001",
    ),
    "a reflection": (
        lambda: rk.BaseMotion(rotation=lambda t: jnp.diag(jnp.array([1.0, 1.0, -1.0]))),
        "BaseMotion.rotation: is not a rotation",
    ),
    "a rotation of another shape": (
        lambda: rk.BaseMotion(rotation=lambda t: jnp.ones(4)),
        r"BaseMotion.rotation: returns shape \(4,\)",
    ),
    "no function": (
        lambda: rk.BaseMotion(position=(0.0, 0.0, 1.0)),
        "BaseMotion.position: must be a function",
    ),
    "a spin of two numbers": (
        lambda: rk.Spin((1.0, 2.0)),
        "Spin.rate: must have shape",
    ),
    "a tilt that is no rotation": (
        lambda: rk.Spin(1.0, orientation=(1.0, 1.0, 0.0, 0.0)),
        "Spin.orientation: must be a quaternion of unit length",
    ),
    "unequal steps": (
        lambda: rk.RecordedMotion([0.0, 1.0, 2.0, 4.0], np.zeros(4)),
        r"RecordedMotion.time: must grow by equal steps \(the step after 2 s is 2 s",
    ),
    "times that fall": (
        lambda: rk.RecordedMotion([1.0, 0.5, 0.0], np.zeros(3)),
        "RecordedMotion.time: is out of order",
    ),
    "a gap in the times": (
        lambda: rk.RecordedMotion([0.0, np.nan, 2.0], np.zeros(3)),
        "RecordedMotion.time: must be finite",
    ),
    "a gap in the samples": (
        lambda: rk.RecordedMotion([0.0, 1.0, 2.0], [0.0, np.nan, 1.0]),
        "RecordedMotion.acceleration: must be finite",
    ),
    "too few samples": (
        lambda: rk.RecordedMotion([0.0, 1.0, 2.0], np.zeros(2)),
        "must hold one row for each of the 3 sample times",
    ),
    "four components": (
        lambda: rk.RecordedMotion([0.0, 1.0, 2.0], np.zeros((3, 4))),
        "of one to three components",
    ),
    "a base moved by a number": (
        lambda: rk.Base(motion=3.0),
        "Base.motion: must be a motion",
    ),
    "mass that is negative": (
        lambda: rk.PointMasses((-1.0,), SLIDE),
        "PointMasses.mass: must be positive",
    ),
    "places of another shape": (
        lambda: rk.PointMasses((1.0, 2.0), SLIDE),
        r"PointMasses.position: returns shape \(1, 3\)",
    ),
    "a carried body whose rotation is none": (
        lambda: rk.SupportedBody(
            1.0,
            np.eye(3),
            lambda a: a[0] * jnp.ones(3),
            lambda a: (1.0 + a[0]) * jnp.eye(3),
        ),
        "SupportedBody.rotation: is not a rotation at 0.3",
    ),
    "a prescribed motion of two coordinates": (
        lambda: rk.Prescribed(rk.PointMasses((1.0,), SLIDE), lambda t: jnp.zeros(2)),
        r"Prescribed.motion: returns shape \(2,\)",
    ),
    "something else that is carried": (
        lambda: rk.Scene(BODY, supported=(3.0,)),
        r"Scene.supported\[0\]: cannot be a float",
    ),
    "alpha of the wrong length": (
        lambda: rk.place(
            rk.Scene(BODY, supported=rk.PointMasses((1.0,), SLIDE)),
            UP,
            STILL,
            STILL,
            alpha=[1.0, 2.0],
            alpha_dot=[0.0],
        ),
        r"place.alpha: must have shape \(1\), not \(2,\)",
    ),
    "alpha that is missing": (
        lambda: rk.place(
            rk.Scene(BODY, supported=rk.PointMasses((1.0,), SLIDE)), UP, STILL, STILL
        ),
        "place.alpha: must have shape",
    ),
    "a start of another scene": (
        lambda: rk.simulate(
            rk.Scene(BODY, supported=rk.PointMasses((1.0,), SLIDE)),
            started(),
            (0.0, 1.0),
        ),
        "simulate.start.alpha: must have shape",
    ),
    "a coordinate that moves no mass": (
        lambda: started(
            rk.Scene(BODY, supported=rk.PointMasses((1.0,), lambda a: 0.0 * SLIDE(a)))
        ),
        "Scene.supported: makes the mass matrix singular",
    ),
    "times before a record": (
        lambda: rk.simulate(
            rk.Scene(BODY, rk.Base(motion=RECORD)), started(), (-0.5, 0.5)
        ),
        "simulate.times: must stay within the record of Base.motion, which is known "
        "from 0 to 1 s",
    ),
    "times behind a record": (
        lambda: rk.simulate(
            rk.Scene(BODY, rk.Base(motion=RECORD)), started(), (0.0, 2.0)
        ),
        "simulate.times: must stay within the record",
    ),
    "unknown equations": (
        lambda: rk.euler_lagrange_derivative(
            rk.Scene(BODY), jnp.zeros(()), started(), "2.7"
        ),
        "euler_lagrange_derivative.equations: is not known, got '2.7'",
    ),
    "a sign that is none": (
        lambda: rk.to_voronets(rk.Scene(BODY), started(), 0.0, 2),
        r"to_voronets.sign: must be -1 or \+1",
    ),
    "unknown coordinates": (
        lambda: rk.simulate(rk.Scene(BODY), started(), (0.0, 1.0), coordinates="polar"),
        "simulate.coordinates: is not known",
    ),
    "an unknown formulation": (
        lambda: rk.simulate(
            rk.Scene(BODY), started(), (0.0, 1.0), formulation="newton"
        ),
        "simulate.formulation: is not known",
    ),
}


@pytest.mark.parametrize("what", REFUSED)
def test_bad_input_is_refused(what):
    make, words = REFUSED[what]
    with pytest.raises(FieldError, match=words):
        make()


def test_a_chart_askew_is_refused_where_a_principal_one_is_asked_for():
    """The ellipsoid of section 10 passes in its own lines, but not in sheared ones."""
    scene, state = paper.scene_and_state(1)
    contact = rk.contact_of(scene, jnp.zeros(()), state)
    assert rk.paper_quantities(contact, principal=True).R.shape == ()
    straight = paper.curvature_chart(paper.BODY_AXES)
    sheared = lambda q: straight(jnp.stack([q[0] + 0.1 * q[1], q[1]]))
    domain = ((0.95, 1.6), (0.5, 0.95))
    body = rk.Body(1.0, np.eye(3), rk.Parametric(sheared, domain=domain))
    askew = rk.Scene(body, scene.base, scene.supported)
    contact = rk.contact_of(askew, jnp.zeros(()), state)
    assert np.isfinite(rk.paper_quantities(contact).R)
    with pytest.raises(FieldError, match="body"):
        rk.paper_quantities(contact, principal=True)


def test_in_a_batch_the_lane_that_leaves_its_record_fails_alone():
    scene = rk.Scene(BODY, rk.Base(motion=RECORD))
    start = rk.place(scene, UP, (1.0, 0.0, 0.0), STILL)
    ends = jnp.array([0.5, 2.0])
    lanes = jax.vmap(
        lambda end: rk.simulate(scene, start, jnp.stack([0.0 * end, end]))
    )(ends)
    assert lanes.code.tolist()[0] == 0
    assert lanes.code.tolist()[1] != 0
    alone = rk.simulate(scene, start, (0.0, 0.5))
    np.testing.assert_allclose(lanes.position[0], alone.position, atol=1e-12)


def stops(times, kinks, away=0):
    """Ends and begins of each stop, once."""
    found = (np.asarray(x) for x in landings(times, kinks, away) if x is not None)
    return [list(dict.fromkeys(x[np.isfinite(x)].tolist())) for x in found]


def test_landings_hold_outputs_and_kinks_in_order():
    times, kinks = jnp.array([0.0, 1.0, 2.0]), jnp.array([-1.0, 1.5, 0.25, 1.0, 7.0])
    assert stops(times, kinks) == [[0.25, 1.0, 1.5, 2.0]]
    assert stops(-times, -kinks) == [[-0.25, -1.0, -1.5, -2.0]]
    assert landings(times, None).ends.tolist() == [1.0, 2.0]


@pytest.mark.parametrize("jump", [False, True])
def test_landings_of_known_times_are_those_a_program_finds(jump):
    """By NumPy ahead of it, or as it runs: the same numbers."""
    program = jax.jit(landings, static_argnums=2)
    random = np.random.default_rng(5)
    grid = np.linspace(0.0, 1.0, 21)
    for sign in (1.0, -1.0):
        times = np.unique(np.append(random.choice(grid, 6), random.uniform(0, 1, 3)))
        kinks = np.concatenate([random.choice(grid, 9), random.uniform(-0.5, 1.5, 9)])
        # some repeat, some lie beside another by a rounding
        kinks = np.append(kinks, np.nextafter(kinks[:4], 2.0 * random.integers(0, 2)))
        for dtype in (np.float64, np.float32):
            given = (sign * times).astype(dtype), kinks.astype(dtype) * dtype(sign)
            known, found = landings(*given, jump), program(*given, jump)
            assert (known.behind is None) == (found.behind is None) == (not jump)
            for one, other in zip(*map(jax.tree.leaves, (known, found)), strict=True):
                assert one.dtype == dtype
                np.testing.assert_array_equal(one, other)


def test_steps_end_before_a_jump_and_begin_behind_it():
    times, kinks = jnp.array([0.0, 1.0, 2.0]), jnp.array([0.25, 1.0, 2.0])
    for sign in (1.0, -1.0):
        ends, starts = stops(sign * times, sign * kinks, away=1)
        at = sign * np.array([0.25, 1.0, 2.0])
        before, behind = np.nextafter(at, 0.0), np.nextafter(at, 9.0 * sign)
        assert ends == [before[0], before[1], at[2]]
        assert starts == [behind[0], behind[1], at[2]]


@pytest.mark.parametrize("jump", [False, True])
def test_kinks_that_repeat_are_one_stop_with_the_output_beside_them(jump):
    """Of two records at the same times, say, that differ by rounding."""
    first = np.nextafter(0.3, 0.0)
    kinks = jnp.array([first, 0.3, 0.6, np.nextafter(0.6, 1.0), 0.0, 1.0])
    for output in (np.nextafter(first, 0.0), 0.3, np.nextafter(0.3, 1.0)):
        ends, *behind = stops(jnp.array([0.0, output, 1.0]), kinks, jump)
        for found in (ends, *behind):
            assert len(found) == 3
            # kinks and output lie two roundings off at most, and steps end one before
            # or behind them: three, of 1.1e-16 at 0.6
            np.testing.assert_allclose(found, [0.3, 0.6, 1.0], rtol=0, atol=3.4e-16)
            assert found[-1] == 1.0


def test_an_output_beside_a_kink_is_on_both_sides_of_it():
    """By its rounding alone: steps end before the two, and begin behind them."""
    for off in (-3, 3):
        output = 0.3 + off * 5.6e-17
        assert 0 < abs(output - 0.3) < 2e-16
        found = landings(jnp.array([0.0, output, 1.0]), jnp.array([0.3]), away=1)
        ends, starts = (float(x[0]) for x in found)
        first, last = sorted([output, 0.3])
        assert ends == np.nextafter(first, 0.0)
        assert starts == np.nextafter(last, 1.0)


def test_kinks_of_a_user_s_motion_are_landed_on():
    """A base that is at rest, then moves on steadily faster."""

    def place(t):
        late = jnp.maximum(t - 0.3, 0.0)
        return jnp.stack([0.5 * late**2, 0.0 * t, 0.0 * t])

    def error(kinks):
        motion = rk.BaseMotion(position=place, kinks=kinks)
        scene = rk.Scene(BODY, rk.Base(motion=motion))
        result = rk.simulate(scene, started(scene), (0.0, 1.0), rtol=1e-9)
        # about the contact point: I / (I + m r^2) of the base's motion is taken on
        share = 0.01 / (0.01 + 1.0 * 0.1**2)
        tried = int(result.steps + result.rejected_steps)
        return abs(float(result.position[-1, 0]) - share * 0.5 * 0.7**2), tried

    told, few = error((0.3,))
    _, many = error(None)  # the controller finds the jump by rejecting steps
    # some ten steps, each wrong by rtol of positions of 0.1 m
    assert told < 1e-9
    assert few < 20
    assert many > 3 * few


@pytest.mark.slow
def test_derivatives_are_right_across_a_jump():
    """Along the recorded steps, which end before the jump and begin behind it."""

    def end(push, solver):
        def place(t, p):
            late = jnp.maximum(t - 0.3, 0.0)
            return jnp.stack([0.5 * p * late**2, 0.0 * t, 0.0 * t])

        motion = rk.BaseMotion(position=place, parameters=push, kinks=(0.3,))
        scene = rk.Scene(BODY, rk.Base(motion=motion))
        start = rk.place(scene, UP, STILL, STILL)
        run = rk.simulate(scene, start, (0.0, 0.3, 1.0), rtol=1e-9, solver=solver)
        return run.position[-1, 0]

    for solver in (diffrax.Tsit5(), diffrax.Dopri8()):
        # half of the base's motion; linear in the push
        slope = jax.grad(end)(2.0, solver)
        assert float(slope) == pytest.approx(0.25 * 0.7**2, abs=1e-9)


def test_own_steps_are_taken():
    scene = rk.Scene(BODY)
    start = rk.place(scene, UP, (1.0, 2.0, 3.0), STILL)
    steps = diffrax.StepTo(jnp.linspace(0.0, 1.0, 33))
    result = rk.simulate(scene, start, (0.0, 1.0), stepsize_controller=steps)
    assert int(result.steps) == 32
    plain = rk.simulate(scene, start, (0.0, 1.0), rtol=1e-12)
    # steps of a tenth of a radian by a method of order 8
    np.testing.assert_allclose(result.position, plain.position, atol=1e-10)
