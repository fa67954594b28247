"""Contact through former poles: the ends of axes, where charts by angles break."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk

from .. import problems

AXES = np.array([0.2, 0.14, 0.1])
MOMENTS = np.array([0.010, 0.014, 0.018])
TIMES = np.linspace(0.0, 0.4, 6)
# steps of rtol 1e-12 over 0.8 s (some 60) leave 1e-10; 1e-9 is the promise
PROMISE = 1e-9


def axis_down(axis: int, sign: int, beside: float):
    """Rotation with body axis ``sign * axis`` pointing down, tilted by ``beside``."""
    down = np.zeros(3)
    down[axis] = sign
    other, third = np.roll(np.eye(3), -axis, axis=0)[1:]
    down = np.cos(beside) * down + np.sin(beside) * (0.6 * other + 0.8 * third)
    side = np.cross(down, third)
    side /= np.linalg.norm(side)
    R = np.stack([side, np.cross(-down, side), -down])  # rows: fixed axes in the body
    return R


def through(surface, permutation, R, base=None, contact=(0.0, 0.0, 0.0)):
    """Backwards and forwards from the pole; positions and turns of the body."""
    P = np.eye(3)[list(permutation)]  # new body axes on old ones
    scene = rk.Scene(
        rk.Body(1.5, np.diag(P @ MOMENTS), surface, P @ [0.003, -0.004, 0.002]), base
    )
    q = problems.quaternion(R @ P.T)
    start = rk.place(scene, q, (2.0, 5.0, 0.5), contact)
    out = []
    for times in (TIMES, -TIMES):
        result = rk.simulate(scene, start, times, rtol=1e-12)
        assert bool(result.succeeded)
        rotation = np.stack(
            [problems.matrix(q) for q in np.asarray(result.orientation)]
        )
        out.append((np.asarray(result.position), rotation @ P))
        energy = np.asarray(result.energy)
        assert np.ptp(energy) < PROMISE * abs(energy[0])
    return out


CYCLES = [(0, 1, 2), (1, 2, 0)]


@pytest.mark.parametrize("beside", [0.0, 1e-6])
@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_end_of_every_axis(axis, sign, beside):
    """The motion does not depend on how the body's axes are called."""
    R = axis_down(axis, sign, beside)
    first, second = (
        through(rk.Ellipsoid(AXES[list(cycle)]), cycle, R) for cycle in CYCLES
    )
    for (x, turn), (x2, turn2) in zip(first, second, strict=True):
        assert np.abs(x - x2).max() < PROMISE
        assert np.abs(turn - turn2).max() < PROMISE


@pytest.mark.parametrize("beside", [0.0, pytest.param(1e-6, marks=pytest.mark.slow)])
@pytest.mark.slow
def test_bodies_that_carry_their_point(beside):
    """By a direction and as a level set, through the end of the last axis."""
    R = axis_down(2, 1, beside)

    def support(direction):
        stretched = jnp.asarray(AXES) ** 2 * direction
        return stretched / jnp.sqrt(jnp.sum(stretched * direction))

    exact = through(rk.Ellipsoid(AXES), CYCLES[0], R)
    for surface in (
        rk.Parametric(support, of_direction=True),
        rk.Implicit(lambda p: jnp.sum((p / jnp.asarray(AXES)) ** 2) - 1.0),
    ):
        for (x, turn), (x2, turn2) in zip(
            exact, through(surface, CYCLES[0], R), strict=True
        ):
            assert np.abs(x - x2).max() < PROMISE
            assert np.abs(turn - turn2).max() < PROMISE


@pytest.mark.parametrize("beside", [0.0, pytest.param(1e-6, marks=pytest.mark.slow)])
def test_poles_of_a_body_of_revolution(beside):
    """A meridian through the axis against the same spheroid by its normal."""
    R = axis_down(2, 1, beside)

    def meridian(s):
        return 0.2 * jnp.sin(s), -0.1 * jnp.cos(s)

    round_ = rk.Revolution(meridian)
    assert round_.poles == (True, True)
    exact = through(rk.Ellipsoid((0.2, 0.2, 0.1)), CYCLES[0], R)
    for (x, turn), (x2, turn2) in zip(
        exact, through(round_, CYCLES[0], R), strict=True
    ):
        assert np.abs(x - x2).max() < PROMISE
        assert np.abs(turn - turn2).max() < PROMISE


@pytest.mark.parametrize("beside", [0.0, pytest.param(1e-6, marks=pytest.mark.slow)])
@pytest.mark.slow
def test_poles_of_the_base(beside):
    """A ball over the top of a sphere: as a normal and as a meridian through it."""
    top = np.array([2.0 * np.sin(beside), 0.0, 2.0 * np.cos(beside)])
    bases = (
        rk.Sphere(2.0),
        rk.Revolution(lambda s: (2.0 * jnp.sin(s), -2.0 * jnp.cos(s))),
        rk.Implicit(lambda p: jnp.sum(p * p) - 4.0, size=3.0),
    )
    R = axis_down(0, 1, 0.3)
    first, *others = (
        through(rk.Ellipsoid(AXES), CYCLES[0], R, rk.Base(base), top) for base in bases
    )
    for other in others:
        for (x, turn), (x2, turn2) in zip(first, other, strict=True):
            assert np.abs(x - x2).max() < PROMISE
            assert np.abs(turn - turn2).max() < PROMISE


def test_gradient_at_a_pole():
    """Derivatives of a run from the very pole, by its spin and by its tilt."""
    q0 = jnp.asarray(problems.quaternion(axis_down(2, 1, 0.0)))

    def end(surface, given):
        spin, first, second = given
        scene = rk.Scene(rk.Body(1.5, np.diag(MOMENTS), surface))
        omega = jnp.stack([spin, jnp.asarray(5.0), jnp.asarray(0.5)])
        w, x, y, z = q0
        # tilted about axes of the body's rim, to first order: (0, first, second, 0) / 2
        by_first, by_second = jnp.stack([-x, w, z, -y]), jnp.stack([-y, -z, w, x])
        q = q0 + 0.5 * (first * by_first + second * by_second)
        start = rk.place(scene, q / jnp.sqrt(q @ q), omega, (0.0, 0.0, 0.0))
        return rk.simulate(scene, start, (0.0, 0.4), rtol=1e-12).final_state.orientation

    round_ = rk.Revolution(lambda s: (0.2 * jnp.sin(s), -0.1 * jnp.cos(s)))
    at = jnp.array([2.0, 0.0, 0.0])
    exact = jax.jit(jax.jacfwd(lambda x: end(rk.Ellipsoid((0.2, 0.2, 0.1)), x)))(at)
    found = jax.jit(jax.jacfwd(lambda x: end(round_, x)))(at)
    np.testing.assert_allclose(found, exact, atol=1e-8)


def by_angles(a, b):
    return jnp.stack([jnp.cos(a) * jnp.cos(b), jnp.sin(a) * jnp.cos(b), jnp.sin(b)])


ROUND = rk.Body(1.0, 0.004 * np.eye(3), rk.Sphere(0.1))
BALL = rk.Parametric(lambda a, b: 0.1 * by_angles(a, b))
DOWN = (np.cos(np.pi / 2 + 0.3), np.sin(np.pi / 2 + 0.3), 0.0, 0.0)


def with_a_ball_inside(shell):
    inner = rk.RollingBody(rk.Body(0.2, 1e-4 * np.eye(3), rk.Sphere(0.05)), shell)
    body = rk.Body(1.0, 0.03 * np.eye(3), rk.Sphere(0.3))
    return rk.Scene(body, supported=(inner,)), inner


def beside_a_pole(kind, surface):
    """A scene, and ``start(sideways)`` through the pole or beside it."""
    still = (0.0, 0.0, 0.0)
    if kind == "body":
        scene = rk.Scene(rk.Body(1.0, 0.004 * np.eye(3), surface))
        return scene, lambda x: rk.place(scene, DOWN, (2.6, x, 0.0), still)
    if kind == "base":
        scene = rk.Scene(ROUND, rk.Base(surface))
        at = (0.0, -np.sin(0.5), -np.cos(0.5))
        return scene, lambda x: rk.place(scene, (1, 0, 0, 0), (0.0, 10 * x, 0.0), at)
    scene, inner = with_a_ball_inside(surface)
    at = (0.0, 0.3 * np.sin(0.6), -0.3 * np.cos(0.6))
    turned = lambda x: inner.place((1, 0, 0, 0), (0.0, 10 * x, 0.0), at)
    return scene, lambda x: rk.place(
        scene, (1, 0, 0, 0), still, still, supported=turned(x)
    )


CHARTS = {
    "body": (BALL, rk.Sphere(0.1)),
    "base": (rk.Parametric(by_angles, inside=True), rk.Sphere(1.0, inside=True)),
    "carrier": (
        rk.Parametric(lambda a, b: 0.3 * by_angles(a, b), inside=True),
        rk.Sphere(0.3, inside=True),
    ),
}


@pytest.mark.parametrize("kind", CHARTS)
def test_no_step_goes_over_the_pole_of_a_users_chart(kind):
    """The normal, d1 x d2, turned over there, and the body with it: "completed"."""
    chart, sphere = CHARTS[kind]
    scene, start = beside_a_pole(kind, chart)
    for rtol in (1e-3, 1e-6, 1e-9):
        for sideways in (0.0, 1e-9):
            run = rk.simulate(scene, start(sideways), (0.0, 1.5), rtol=rtol)
            assert run.code == rk.Code.SURFACE_EDGE
            assert run.final_time < 1.2  # poles are at 0.2 to 1 s
    same, begun = beside_a_pole(kind, sphere)
    run = rk.simulate(scene, start(0.1), (0.0, 1.5), rtol=1e-11)
    other = rk.simulate(same, begun(0.1), (0.0, 1.5), rtol=1e-11)
    assert run.succeeded
    # some 100 steps of 1e-11, of angles that grow no errors by more than ten
    np.testing.assert_allclose(run.position, other.position, rtol=0.0, atol=1e-8)


@pytest.mark.parametrize("modes", [None, rk.Modes(friction=0.5, restitution=0.3)])
def test_poles_of_charts_by_every_loop(modes):
    scene, start = beside_a_pole("body", BALL)
    begun = start(0.0)
    run = lambda s, method="auto": rk.simulate(
        scene, s, (0.0, 1.0), modes=modes, method=method
    )
    by_diffrax = run(begun, "diffrax")
    assert by_diffrax.code == run(begun).code == rk.Code.SURFACE_EDGE
    # at 2.6 rad/s and steps that halve: where the chart's circles are 1e-8 of its size
    np.testing.assert_allclose(by_diffrax.final_time, run(begun).final_time, atol=1e-7)
    turned = lambda x: eqx.tree_at(
        lambda s: s.angular_velocity, begun, x * begun.angular_velocity
    )
    codes = jax.vmap(lambda x: run(turned(x)).code)(jnp.array([0.3, 0.5, 1.0, 1.5]))
    assert codes.tolist() == [0, 0, rk.Code.SURFACE_EDGE, rk.Code.SURFACE_EDGE]
    slope = jax.grad(lambda x: run(turned(x)).angular_velocity[-1, 0])
    assert np.isfinite(slope(0.5))
    assert np.isnan(slope(1.0))


def _of_points(height):
    points = lambda x, y: jnp.stack([x, y, height(x, y)])
    return rk.Parametric(points, domain=((-0.9, 0.9), (-0.9, 0.9)))


@pytest.mark.parametrize("of", [rk.Graph, _of_points])
def test_a_chart_that_becomes_upright_is_not_gone_along(of):
    """x stood still there, and the body with it, up to 2 mm behind: "completed"."""
    hemisphere = of(lambda x, y: 1.0 - jnp.sqrt(1.0 - x * x - y * y))
    scene = rk.Scene(ROUND, rk.Base(hemisphere), loads=())
    start = rk.place(scene, (1, 0, 0, 0), (0.0, 45.0, 0.0), (0.0, 0.0, 0.0))
    upright = np.pi / 10.0  # s, at 4.5 m/s on a path of radius 0.9 m
    before = rk.simulate(scene, start, (0.0, upright - 1e-3), rtol=1e-11)
    assert before.succeeded
    angle = 5.0 * float(before.final_time)
    wanted = np.array([0.9 * np.sin(angle), 0.0, 1.0 - 0.9 * np.cos(angle)])
    # slopes of 200: roundings and errors of steps, 1e-11 each, by that
    np.testing.assert_allclose(before.position[-1], wanted, atol=1e-8)
    for rtol in (1e-5, 1e-9):
        for behind in (2e-6, 2e-5, 0.1):
            asked = (0.0, upright + behind)
            run = rk.simulate(scene, start, asked, rtol=rtol, max_steps=5000)
            assert not run.succeeded
            assert run.final_time < upright
