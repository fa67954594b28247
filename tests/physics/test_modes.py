"""Runs that change between rolling, slipping and flight, against closed forms."""

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import rollkane as rk
from rollkane.dynamics.observables import friction_ratio
from rollkane.validation.checks import FieldError
from tests.problems import reference_case
from tests.quick import slow_but

UP, STILL = (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
G, R, MASS = 9.81, 0.11, 6.0
BALL = rk.Body(MASS, 0.4 * MASS * R**2 * np.eye(3), rk.Sphere(R))
LANE = rk.Scene(BALL)


def thrown(v, mu):
    """A ball that is put on the lane without turning."""
    law = rk.Slipping(rk.CoulombFriction(mu))
    velocity = jnp.stack([v, 0.0 * v, 0.0 * v])
    return rk.place(rk.Scene(BALL, contact=law), UP, STILL, STILL, velocity=velocity)


def grip(v, mu):
    """When it stops slipping, and where it is at a later time."""
    until = 2.0 * v / (7.0 * mu * G)
    at = v * until - 0.5 * mu * G * until**2
    return until, lambda t: at + 5.0 / 7.0 * v * (t - until)


def test_bowling_ball_grips():
    """The switch to 1e-12 s: friction is constant up to it, and so quadratic."""
    until, place = grip(8.0, 0.2)
    times = np.linspace(0.0, 2.0, 9)
    run = rk.simulate(
        LANE, thrown(8.0, 0.2), times, modes=rk.Modes(friction=0.2), rtol=1e-10
    )
    assert run.succeeded
    assert run.switches.count == 1
    np.testing.assert_allclose(run.switches.time[0], until, atol=1e-12)
    assert run.switches.before[0] == rk.Mode.SLIPPING
    assert run.switches.after[0] == rk.Mode.ROLLING
    np.testing.assert_array_equal(run.mode, np.where(times < until, 1, 0))
    later = times > until
    np.testing.assert_allclose(run.position[later, 0], place(times[later]), atol=1e-10)
    np.testing.assert_allclose(R * run.angular_velocity[-1, 1], 40.0 / 7.0, atol=1e-10)
    np.testing.assert_allclose(run.slip[later], 0.0, atol=0.0)


def far(v, mu):
    """Where the ball is after two seconds."""
    run = rk.simulate(
        LANE, thrown(v, mu), [0.0, 2.0], modes=rk.Modes(friction=mu), rtol=1e-10
    )
    return run.position[-1, 0]


@pytest.mark.slow
def test_derivatives_go_through_the_switch():
    exact = lambda v, mu: grip(v, mu)[1](2.0)
    derivatives = jax.jit(
        lambda a, b: jax.jvp(far, (jnp.asarray(8.0), jnp.asarray(0.2)), (a, b))[1]
    )
    found = derivatives(1.0, 0.0), derivatives(0.0, 1.0)
    expected = jax.grad(exact, (0, 1))(8.0, 0.2)
    np.testing.assert_allclose(found, expected, rtol=1e-8)


@pytest.mark.slow
def test_lanes_switch_at_different_times():
    speeds = jnp.array([2.0, 5.0, 8.0])
    ends = jax.vmap(lambda v: far(v, 0.2))(speeds)
    expected = [grip(float(v), 0.2)[1](2.0) for v in speeds]
    np.testing.assert_allclose(ends, expected, atol=1e-9)


def test_ball_leaves_a_sphere():
    """Case c24: when, to 1e-9 s; then a parabola."""
    scene, start, _ = reference_case("c24")
    run = rk.simulate(
        scene, start, np.linspace(0.0, 2.0, 11), modes=rk.Modes(), rtol=1e-12
    )
    left = run.switches.time[0]
    np.testing.assert_allclose(left, 1.43215549401, atol=1e-9)
    np.testing.assert_allclose(run.first_pull, left)
    assert run.switches.after[0] == rk.Mode.FLYING
    begun = run.switches.state
    since = run.time[-1] - left
    fall = jnp.array([0.0, 0.0, -0.5 * G]) * since**2
    expected = begun.position[0] + begun.velocity[0] * since + fall
    np.testing.assert_allclose(run.position[-1], expected, atol=1e-12)
    np.testing.assert_allclose(run.contact_force[-1], 0.0, atol=1e-13)
    np.testing.assert_allclose(run.energy, run.energy[0], rtol=1e-10)
    assert np.isnan(run.contact_on_base[-1]).all()


def test_bounces_fall_by_the_restitution():
    """Dropped on a plane: heights h e^2, times by the closed form; then it lies still.

    Rebounds below 1e-3 m/s stay: after 0.8^n sqrt(2 g h) < 1e-3.
    """
    h, e = 0.5, 0.8
    start = rk.release(LANE, UP, STILL, (0.0, 0.0, h + R), STILL)
    modes = rk.Modes(friction=0.3, restitution=e)
    run = rk.simulate(LANE, start, np.linspace(0.0, 4.0, 5), modes=modes, rtol=1e-10)
    assert run.succeeded
    fall = np.sqrt(2.0 * h / G)
    count = int(np.ceil(np.log(1e-3 / (G * fall)) / np.log(e)))
    assert run.switches.count == count
    hits = fall * (1.0 + 2.0 * np.cumsum([0.0, *(e ** np.arange(1, count))]))
    np.testing.assert_allclose(run.switches.time[:count], hits, atol=1e-10)
    assert run.switches.after[count - 1] == rk.Mode.ROLLING
    speeds = run.switches.state.velocity[: count - 1, 2]
    np.testing.assert_allclose(speeds, G * fall * e ** np.arange(1, count), rtol=1e-9)
    np.testing.assert_allclose(run.position[-1], [0.0, 0.0, R], atol=1e-12)


@pytest.mark.slow
def test_bounce_in_a_bowl_takes_its_share_of_the_energy():
    """Without friction only the normal velocity loses: (1 - e^2) of its energy."""
    bowl = rk.Scene(BALL, rk.Base(rk.Graph(lambda x, y: 0.5 * (x * x + y * y))))
    start = rk.release(bowl, UP, (0.0, 0.0, 3.0), (0.3, 0.1, 0.8), STILL)
    modes = rk.Modes(friction=0.0, restitution=0.8, switches=8)
    run = rk.simulate(bowl, start, [0.0, 0.34, 0.37], modes=modes, rtol=1e-11)
    assert run.switches.count == 1
    hit = run.switches.state
    before = np.array([0.0, 0.0, -G * run.switches.time[0]])
    change = np.asarray(hit.velocity[0]) - before
    N = change / np.linalg.norm(change)
    # the impulse is along the bowl's normal at the contact
    x, y = np.asarray(hit.contact_on_base[0, :2])
    slope = np.array([-x, -y, 1.0])
    np.testing.assert_allclose(N, slope / np.linalg.norm(slope), atol=1e-10)
    np.testing.assert_allclose(hit.velocity[0] @ N, -0.8 * before @ N, rtol=1e-10)
    lost = 0.5 * MASS * (1.0 - 0.64) * (before @ N) ** 2
    np.testing.assert_allclose(run.energy[0] - run.energy[-1], lost, rtol=1e-9)


@pytest.mark.slow
def test_a_pushed_ball_slips_and_grips():
    """A force that grows beyond what friction can pass on, and falls again.

    F at the centre needs the contact force 2/7 F; it slips from 2/7 F > mu m g.
    """
    mu, rise = 0.2, 100.0
    push = rk.Force(
        lambda t, point: jnp.stack([rise * jnp.minimum(t, 1.0 - t), 0.0 * t, 0.0 * t])
    )
    scene = rk.Scene(BALL, loads=(rk.Gravity(), push))
    start = rk.place(scene, UP, STILL, STILL)
    times = np.linspace(0.0, 1.0, 11)
    run = rk.simulate(scene, start, times, modes=rk.Modes(friction=mu), rtol=1e-10)
    slips = 3.5 * mu * MASS * G / rise
    assert run.succeeded
    np.testing.assert_allclose(run.switches.time[0], slips, atol=1e-10)
    assert list(run.switches.after[:2]) == [rk.Mode.SLIPPING, rk.Mode.ROLLING]
    assert run.switches.count == 2
    # m v' = F - mu m g and J w' = mu m g r; the slip ends where its integral vanishes
    friction = mu * MASS * G
    at = float(run.switches.time[1])
    assert at > 0.5
    impulse = rise * (0.25 - 0.5 * (slips**2 + (1.0 - at) ** 2))
    v = impulse - friction * (at - slips)
    turned = friction * (at - slips) / 0.4
    np.testing.assert_allclose(v, turned, rtol=1e-8)


def test_friction_put_in_is_that_of_sticking_too():
    """It breaks away from 2/7 F > mu m g, F = 40 t N, by the number that is there."""
    push = rk.Force(lambda t, point: jnp.stack([40.0 * t, 0.0 * t, 0.0 * t]))
    scene = rk.Scene(BALL, loads=(rk.Gravity(), push))
    start = rk.place(scene, UP, STILL, STILL)
    made = rk.Modes(friction=0.3)
    for mu in (0.1, 0.2):
        modes = eqx.tree_at(lambda m: m.friction, made, jnp.asarray(mu))
        run = rk.simulate(scene, start, [0.0, 2.5], modes=modes, rtol=1e-10)
        slips = 3.5 * mu * MASS * G / 40.0
        assert run.switches.count == 1
        # found to 1e-12 s; what the run is off by then is a thousandth of rtol
        np.testing.assert_allclose(run.switches.time[0], slips, atol=1e-10)


@pytest.mark.slow
def test_upright_disc_slips_and_grips():
    """Thrown along its heading, it stays upright: a balance that nothing disturbs.

    m v' = -mu m g, J w' = mu m g r with J = m r^2 / 2: it grips at
    v0 / (mu g (1 + m r^2 / J)).
    """
    r, m, mu, v = 0.25, 1.5, 0.3, 3.0
    disc = rk.Body(m, m * r**2 * np.diag([0.25, 0.25, 0.5]), rk.DiscEdge(r))
    law = rk.Slipping(rk.CoulombFriction(mu))
    # the disc's axis z lies along -y: heading x
    upright = (np.sqrt(0.5), np.sqrt(0.5), 0.0, 0.0)
    scene = rk.Scene(disc, contact=law)
    start = rk.place(scene, upright, STILL, STILL, velocity=(v, 0.0, 0.0))
    modes = rk.Modes(friction=mu)
    run = rk.simulate(rk.Scene(disc), start, [0.0, 0.2, 0.8], modes=modes, rtol=1e-10)
    grips = v / (mu * G * 3.0)
    assert run.succeeded
    assert list(run.switches.after[:2]) == [rk.Mode.ROLLING, -1]
    np.testing.assert_allclose(run.switches.time[0], grips, atol=1e-12)
    slid = v * grips - 0.5 * mu * G * grips**2
    rolled = 2.0 / 3.0 * v * (0.8 - grips)
    np.testing.assert_allclose(run.position[-1, 0], slid + rolled, atol=1e-10)
    np.testing.assert_allclose(run.slip[-1], 0.0, atol=0.0)


@pytest.mark.slow
def test_tilted_disc_slips_and_grips():
    """No closed form: what friction takes is the energy, and the grip is no jolt.

    The power of friction is -mu N |U|, integrated over the slip by Gauss-Legendre with
    40 nodes; it ends as a straight line does, and 1e-8 is left.
    """
    r, m, mu = 0.25, 1.5, 0.25
    disc = rk.Body(m, m * r**2 * np.diag([0.25, 0.25, 0.5]), rk.DiscEdge(r))
    law = rk.Slipping(rk.CoulombFriction(mu))
    scene = rk.Scene(disc, contact=law)
    tilted = (np.cos(0.75), np.sin(0.75), 0.0, 0.0)
    start = rk.place(scene, tilted, (2.0, -12.0, 3.0), STILL, slip=(1.5, 0.5, 0.0))
    modes = rk.Modes(friction=mu)
    simulate = lambda times: rk.simulate(
        rk.Scene(disc), start, times, modes=modes, rtol=1e-11
    )
    nodes, weights = np.polynomial.legendre.leggauss(40)
    first = simulate(np.linspace(0.0, 0.3, 42))
    assert list(first.switches.after[:1]) == [rk.Mode.ROLLING]
    grips = float(first.switches.time[0])
    times = np.concatenate([[0.0], 0.5 * grips * (nodes + 1.0), [grips + 1e-3]])
    run = simulate(times)
    assert run.succeeded
    power = -mu * run.normal_force * jnp.linalg.norm(run.slip, axis=1)
    work = 0.5 * grips * np.sum(weights * np.asarray(power)[1:-1])
    np.testing.assert_allclose(run.energy[-1] - run.energy[0], work, rtol=1e-8)
    # velocities on both sides of the grip: apart by their rates only
    beside = simulate(np.array([0.0, grips - 1e-9, grips + 1e-9]))
    change = beside.angular_velocity[2] - beside.angular_velocity[1]
    np.testing.assert_allclose(change, 0.0, atol=1e-6)


@pytest.mark.slow
def test_a_body_that_carries_its_point_lands():
    """A ball as a level set, dropped on a slope with spin, against the ball itself."""
    slope = rk.Base(rk.Graph(lambda x, y: 0.2 * x + 0.05 * y * y))
    given = (0.0, 3.0, 1.0), (0.3, 0.2, 0.5), (0.2, 0.0, 0.0)
    found = []
    level = rk.Implicit(lambda p: jnp.sum(p * p) - R**2, size=0.2)
    for surface in (rk.Sphere(R), level):
        scene = rk.Scene(rk.Body(MASS, BALL.inertia, surface), slope)
        start = rk.release(scene, UP, *given)
        modes = rk.Modes(friction=0.3, restitution=0.6, switches=8)
        run = rk.simulate(scene, start, [0.0, 0.4, 0.6], modes=modes, rtol=1e-11)
        assert run.succeeded
        found.append(run)
    ball, carries = found
    count = int(ball.switches.count)
    assert count > 0
    assert int(carries.switches.count) == count
    np.testing.assert_allclose(carries.switches.time, ball.switches.time, atol=1e-9)
    np.testing.assert_allclose(carries.position, ball.position, atol=1e-9)
    np.testing.assert_allclose(
        carries.angular_velocity, ball.angular_velocity, atol=1e-7
    )


def cliff(x, y):
    return 0.5 - 0.5 * jnp.tanh(3.0 * (x - 1.0) + 0.5 * y)


def over_the_cliff(x):
    """Where a ball first touches, that slides over an edge, falls, and lands.

    Args:
        x: Speed [m/s], spin [rad/s], friction, restitution [1], shape (4,).
    """
    speed, spin, mu, e = x
    at = -0.5, 0.0
    scene = rk.Scene(BALL, rk.Base(rk.Graph(cliff)))
    slips = rk.Scene(BALL, scene.base, contact=rk.Slipping(rk.CoulombFriction(mu)))
    slip = speed * jnp.array([1.0, 0.3, 0.0])
    turning = jnp.stack([0.0 * spin, spin, 0.5 * spin])
    start = rk.place(slips, UP, turning, (*at, cliff(*at)), slip=slip)
    modes = rk.Modes(friction=mu, restitution=e, switches=8)
    run = rk.simulate(scene, start, [0.0, 0.7, 1.2], modes=modes, rtol=1e-11)
    return run.switches, run.position[-1]


@pytest.mark.parametrize("inner", [jax.jacfwd, jax.grad])
def test_second_derivatives_are_refused(inner):
    """An event's time has its first derivative only: a second would be wrong."""
    scene = rk.Scene(BALL)
    start = rk.place(scene, UP, STILL, STILL)

    def spin(w):
        begun = eqx.tree_at(lambda s: s.angular_velocity, start, w * jnp.ones(3))
        run = rk.simulate(scene, begun, [0.0, 0.1], modes=rk.Modes(friction=0.3))
        return run.state.angular_velocity[-1, 0]

    with pytest.raises(rk.FieldError, match=r"simulate.modes: has no second"):
        jax.eval_shape(jax.jacfwd(inner(spin)), 0.5)


@pytest.mark.slow
def test_gradient_of_a_landing_point():
    """Through slip, flight and rebound, in both modes, against differences.

    Central differences of steps 1e-4 and 5e-5, extrapolated: error h^4 = 1e-16 over
    rounding 1e-11 / 1e-4.
    """
    at = jnp.array([4.0, 2.0, 0.1, 0.5])

    def seen(x):
        switches, end = over_the_cliff(x)
        point = switches.state.position[1, 0]
        return jnp.stack([point, switches.time[1], end[0]])

    switches, _ = over_the_cliff(at)
    assert list(switches.before[:2]) == [rk.Mode.SLIPPING, rk.Mode.FLYING]
    assert list(switches.after[:2]) == [rk.Mode.FLYING, rk.Mode.FLYING]
    run = jax.jit(seen)

    def difference(axis, h):
        step = h * jnp.eye(4)[axis]
        return (run(at + step) - run(at - step)) / (2.0 * h)

    fine = [(4.0 * difference(i, 5e-5) - difference(i, 1e-4)) / 3.0 for i in range(4)]
    expected = np.stack(fine, axis=1)
    pull = jax.jit(lambda ct: jax.vjp(seen, at)[1](ct)[0])
    push = jax.jit(lambda v: jax.jvp(seen, (at,), (v,))[1])
    reverse = np.stack([pull(row) for row in jnp.eye(3)])
    forward = np.stack([push(column) for column in jnp.eye(4)], axis=1)
    # the promise is 1e-5; the largest entry sets the size of a row
    size = np.abs(expected).max(axis=1, keepdims=True)
    assert (np.abs(reverse - expected) < 1e-6 * size).all()
    assert (np.abs(forward - reverse) < 1e-9 * size).all()


@pytest.mark.slow
def test_painleve_is_reported_in_modes():
    """The rod of test_contact_laws that jams, and the same pulled the other way."""
    rod = rk.Body(1.0, np.diag([1 / 3, 1e-3, 1 / 3]), rk.Sphere(0.01, (0, -1.0, 0)))
    upright = (np.cos(0.45), np.sin(0.45), 0.0, 0.0)
    slips = rk.Scene(rod, contact=rk.Slipping(rk.CoulombFriction(3.0)))
    modes = rk.Modes(friction=3.0)
    for way, code in ((1.0, rk.Code.COMPLETED), (-1.0, rk.Code.PAINLEVE)):
        start = rk.place(slips, upright, STILL, STILL, slip=(0.0, way, 0.0))
        run = rk.simulate(rk.Scene(rod), start, [0.0, 0.02], modes=modes)
        assert run.code == code


@pytest.mark.slow
def test_an_output_on_a_jump_of_the_base():
    """A plate that starts to move at 0.5 s with 1 m/s^2: the ball gets 2/7 of it."""
    late = lambda t: 0.5 * jnp.where(t > 0.5, (t - 0.5) ** 2, 0.0)
    motion = rk.BaseMotion(
        lambda t: jnp.stack([late(t), 0.0 * t, 0.0 * t]), kinks=[0.5]
    )
    scene = rk.Scene(BALL, rk.Base(rk.Plane(), motion))
    start = rk.place(scene, UP, STILL, STILL)
    times = np.array([0.0, 0.5, 1.0])
    run = rk.simulate(scene, start, times, modes=rk.Modes(friction=0.5), rtol=1e-10)
    assert run.succeeded
    np.testing.assert_allclose(
        run.position[:, 0], [0.0, 0.0, 0.125 * 2 / 7], atol=1e-12
    )


REFUSED = {
    "an option that is not used": (
        lambda: rk.simulate(LANE, None, [0.0, 1.0], modes=rk.Modes(), dt0=0.1),
        "simulate.dt0: cannot be chosen with modes",
    ),
    "a slip without friction": (
        lambda: rk.simulate(
            LANE, thrown(jnp.asarray(8.0), 0.2), [0.0, 1.0], modes=rk.Modes()
        ),
        "Modes.friction: is missing for a start that slips",
    ),
    "a solver that is not explicit": (
        lambda: rk.simulate(
            LANE,
            rk.place(LANE, UP, STILL, STILL),
            [0.0, 1.0],
            modes=rk.Modes(),
            solver=dfx.Kvaerno5(),
        ),
        "simulate.solver: cannot make the steps of a run with modes",
    ),
    "no modes": (
        lambda: rk.simulate(LANE, None, [0.0, 1.0], modes=0.3),
        "simulate.modes: must be Modes",
    ),
    "modes of several": (
        lambda: rk.simulate(
            LANE,
            rk.place(LANE, UP, STILL, STILL),
            [0.0, 1.0],
            modes=jax.vmap(lambda mu: rk.Modes(friction=mu))(jnp.array([0.1, 0.2])),
        ),
        "simulate.modes: has an axis of members",
    ),
    "backwards": (
        lambda: rk.simulate(
            LANE, rk.place(LANE, UP, STILL, STILL), [1.0, 0.0], modes=rk.Modes()
        ),
        "simulate.times: run backwards",
    ),
    "negative friction": (
        lambda: rk.Modes(friction=-0.1),
        "Modes.friction: must not be negative",
    ),
    "a body in its base": (
        lambda: rk.release(LANE, UP, STILL, (0.0, 0.0, 0.05), STILL),
        "release.position: is in the base",
    ),
}


@pytest.mark.parametrize(("make", "words"), REFUSED.values(), ids=list(REFUSED))
def test_refused(make, words):
    with pytest.raises(FieldError, match=words):
        make()


@pytest.mark.slow
def test_too_many_bounces_end_with_a_code():
    start = rk.release(LANE, UP, STILL, (0.0, 0.0, 0.5 + R), STILL)
    modes = rk.Modes(friction=0.3, restitution=0.8, switches=3)
    run = rk.simulate(LANE, start, [0.0, 4.0], modes=modes)
    assert run.code == rk.Code.TOO_MANY_SWITCHES
    assert "switches" in run.reason
    assert run.switches.count >= 3
    assert 0.0 < run.final_time < 4.0


def test_a_viscous_moment_that_lifts_a_body_off_is_named():
    """Of 4 N m at 20 rad/s: its mass centre, 5 cm behind the contact, falls faster.

    ``w' = 4 / (0.004 + 0.01 + 0.0025) = 242 rad/s^2``, times 0.05 m: 12 m/s^2 > g. In
    flight nothing turns it, and it falls back at once.
    """
    body = rk.Body(1.0, 0.004 * np.eye(3), rk.Sphere(0.1), (-0.05, 0.0, 0.0))
    loads = rk.Gravity(), rk.RollingResistance(viscous=0.2)
    scene = rk.Scene(body, loads=loads)
    start = rk.place(scene, UP, (0.0, 20.0, 0.0), STILL)
    run = rk.simulate(scene, start, [0.0, 0.1], modes=rk.Modes(restitution=0.0))
    assert run.code == rk.Code.TOO_MANY_SWITCHES
    assert run.final_time < 1e-3
    assert "viscous resistance" in run.reason
    assert "give dry=" in run.reason


def test_a_contact_that_may_pull_is_held_by_friction():
    """``lifts=False``: friction has the size of the force, whichever way it acts.

    A ball on a plate that falls at 2 g rests on it: pulled by m g, with nothing along.
    """
    falls = rk.BaseMotion(lambda t: jnp.stack([0.0 * t, 0.0 * t, -G * t * t]))
    scene = rk.Scene(BALL, rk.Base(rk.Plane(), falls))
    start = rk.place(scene, UP, STILL, STILL)
    modes = rk.Modes(friction=0.3, lifts=False)
    run = rk.simulate(scene, start, [0.0, 0.3], modes=modes, rtol=1e-9)
    assert run.succeeded
    assert run.switches.count == 0
    # 1e-12 of m g: the solution of a system of six, rounded
    np.testing.assert_allclose(run.normal_force, -MASS * G, rtol=1e-12)


@pytest.mark.parametrize("fall", [0.0, 2.0], ids=["pressed", "pulled"])
def test_a_contact_that_may_pull_begins_to_slip(fall):
    """A ball on a plate that falls, and is pushed along more and more, by j t.

    It rolls at 2/7 of that until friction needed, 2/7 m j t, is mu m g; then it slips
    by ``-j (t - t_1)^2 / 2``, whichever way the normal force acts.
    """
    mu, begins = 0.3, 0.1
    j = 3.5 * mu * G / begins
    moves = lambda t: jnp.stack([j * t**3 / 6.0, 0.0 * t, -0.5 * fall * G * t * t])
    scene = rk.Scene(BALL, rk.Base(rk.Plane(), rk.BaseMotion(moves)))
    times = np.array([0.0, 0.15, 0.3])
    modes = rk.Modes(friction=mu, lifts=False)
    start = rk.place(scene, UP, STILL, STILL)
    run = rk.simulate(scene, start, times, modes=modes, rtol=1e-10)
    assert run.succeeded
    assert run.switches.after[0] == rk.Mode.SLIPPING
    assert run.switches.count == 1
    np.testing.assert_allclose(run.normal_force, MASS * G * (1.0 - fall), rtol=1e-9)
    # 60 steps of 1e-10 of their states, of 1 m/s; of a time at which friction is short
    # by what grows as j t: as much of it
    np.testing.assert_allclose(run.switches.time[0], begins, atol=6e-9)
    slips = -0.5 * j * (times[1:] - begins) ** 2
    np.testing.assert_allclose(run.slip[1:, 0], slips, atol=6e-9 * (1.0 + j * 0.2))


def test_a_contact_whose_force_vanishes_slips_before_it_lifts():
    """Of a ball whose mass centre is off its middle, held ever better by friction.

    Where it lifts the friction that it needs has not vanished, so its grip is lost
    first, at the edge of the cone.
    """
    solid = rk.Body(1.0, 0.004 * np.eye(3), rk.Sphere(0.1), (0.0, 0.0, -0.06))
    scene = rk.Scene(solid)
    start = rk.place(scene, UP, (0.0, -30.0, 0.0), STILL)

    def first_change(spin, mu):
        spun = jnp.stack([0.0 * spin, -spin, 0.0 * spin])
        begin = eqx.tree_at(lambda s: s.angular_velocity, start, spun)
        modes = rk.Modes(friction=mu)
        run = rk.simulate(scene, begin, [0.0, 0.3], modes=modes, rtol=1e-9)
        changes = run.switches
        state = jax.tree.map(lambda x: x[0], changes.state)
        share = friction_ratio(scene, changes.time[0], state.rolling())
        return run.code, changes.before[0], changes.after[0], share

    # of 120 spins from 10 to 40 rad/s this one met its lift-off and lost its grip
    # in one step, which ended on the lift-off; and some around it
    spins = 38.48739495798319 + np.linspace(-1.0, 1.0, 21)
    spins, grips = np.meshgrid(spins, [1.0, 3.0, 6.0, 10.0, 30.0])
    run = jax.jit(jax.vmap(first_change))(spins.ravel(), grips.ravel())
    code, before, after, share = map(np.asarray, run)
    assert (code == rk.Code.COMPLETED).all()
    assert (before == rk.Mode.ROLLING).all()
    assert (after == rk.Mode.SLIPPING).all()
    # the grip is found to 1e-12 of what it was where the step began, 30 times 99 N at
    # most: to 4e-10 of the 7.6 N along the surface, the share to that over sqrt(2)
    np.testing.assert_allclose(share, grips.ravel(), rtol=3e-10)


@pytest.mark.parametrize("across", [2e-7, 9e-7, 3e-6])
def test_a_slip_that_turns_round_does_not_end(across):
    """Gravity turns a slip back at 1e-8 to 5e-7 m/s, with no place where it is zero.

    Friction alone acts on it: ``s' = g - 7/2 mu N s / |s|``. Of 1e-3 m/s, some 80
    steps may miss a billionth each.
    """
    mu, pull = 1e-3, (0.3, 0.0, -G)
    law = rk.Slipping(rk.CoulombFriction(mu))
    slides = rk.Scene(BALL, loads=(rk.Gravity(pull),), contact=law)
    first = (-1e-3, across, 0.0)
    start = rk.place(slides, UP, STILL, STILL, slip=first)
    scene = rk.Scene(BALL, loads=slides.loads)
    run = rk.simulate(scene, start, [0.0, 0.01], modes=rk.Modes(friction=mu))

    def rate(t, s):
        return np.array(pull[:2]) - 3.5 * mu * G * s / np.hypot(*s)

    known = solve_ivp(rate, (0, 0.01), first[:2], "DOP853", rtol=1e-12, atol=1e-20)
    assert run.succeeded
    assert run.switches.count == 0
    np.testing.assert_allclose(run.slip[-1, :2], known.y[:, -1], rtol=0, atol=8e-11)


def test_without_friction_a_ball_keeps_its_spin():
    """Nothing turns it, from its rolling start on: not where its slip begins either.

    Of the least friction it is turned by what is proportional to that.
    """
    uneven = rk.Base(rk.Graph(lambda x, y: 0.02 * jnp.sin(3.0 * x) * jnp.cos(2.0 * y)))
    scene = rk.Scene(BALL, uneven)
    spin, z = (1.0, 0.5, -0.9), 0.02 * np.sin(0.6) * np.cos(0.2)
    start = rk.place(scene, UP, spin, (0.2, 0.1, z))
    end = jax.jit(
        lambda mu: (
            rk.simulate(
                scene, start, (0.0, 0.6), modes=rk.Modes(friction=mu), rtol=1e-9
            ).final_state
        )
    )
    # 20 steps, each some ten roundings of 1 rad/s; and by friction at most
    # mu m g t r / I = mu * 9.81 * 0.6 / (0.4 * 0.11) rad/s
    for mu in (0.0, 1e-300, 1e-17, 1e-14, 1e-10, 1e-8):
        found = end(mu)
        assert found.mode == rk.Mode.SLIPPING
        turned = np.abs(np.asarray(found.parts.angular_velocity) - spin)
        assert np.max(turned) < 20 * 10 * 2.2e-16 + 134.0 * mu


def test_outputs_right_behind_a_landing():
    """One, three and a hundred numbers of the clock behind it: the run goes on.

    Times of the clock near 0.32 s are 5.6e-17 s apart; outputs closer than a hundred
    roundings are one.
    """
    h, e = 0.5, 0.8
    start = rk.release(LANE, UP, STILL, (0.0, 0.0, h + R), STILL)
    modes = rk.Modes(friction=0.3, restitution=e)
    run = jax.jit(lambda t: rk.simulate(LANE, start, t, modes=modes, rtol=1e-10))
    first = run(jnp.array([0.0, 0.4])).switches.time[0]
    for numbers in (1, 3, 100):
        at = float(first)
        for _ in range(numbers):
            at = np.nextafter(at, 1.0)
        found = run(jnp.array([0.0, at]))
        assert found.code == rk.Code.COMPLETED
        # it has turned: up by e times the speed of the fall, to the clock's 1e-14 s
        rises = found.state.parts.velocity[-1, 2]
        np.testing.assert_allclose(rises, e * np.sqrt(2.0 * G * h), rtol=1e-10)


def test_an_inconsistent_impact_by_newton_ends_with_a_code():
    """A slow slip of a rod's tip: Newton's friction would turn it and push on."""
    rod = rk.Body(1.0, np.diag([1 / 3, 1e-3, 1 / 3]), rk.Sphere(0.01, (0, -1.0, 0)))
    tilted = (np.cos(0.45), np.sin(0.45), 0.0, 0.0)
    scene = rk.Scene(rod)
    below = -np.sin(0.9) - 0.01
    for law, code in (
        ("newton", rk.Code.INCONSISTENT_IMPACT),
        ("energetic", rk.Code.COMPLETED),
    ):
        start = rk.release(
            scene, tilted, STILL, (0.0, 0.0, 0.05 - below), (0.0, 0.2, 0.0)
        )
        modes = rk.Modes(friction=0.3, restitution=0.9, impact=law)
        run = rk.simulate(scene, start, [0.0, 0.12], modes=modes)
        assert run.code == code, (law, run.reason)
        if code != rk.Code.COMPLETED:  # at the impact: times are events' to 1e-12 s
            fallen = np.sqrt(2.0 * 0.05 / G)
            np.testing.assert_allclose(run.final_time, fallen, rtol=0.0, atol=1e-12)
            state = run.final_state
            assert state.mode == rk.Mode.FLYING
            # not yet changed: it falls and moves along as it did; G times the time's
            velocity, falls = state.parts.velocity, [0.0, 0.2, -G * fallen]
            np.testing.assert_allclose(velocity, falls, rtol=0.0, atol=1e-11)
            assert run.switches.count == 0


def test_a_run_goes_on_from_its_final_state():
    """From the state of its mode; that of all modes was taken for one in contact."""
    ball = rk.Scene(rk.Body(1.0, 0.004 * np.eye(3), rk.Sphere(0.1)))
    modes = rk.Modes(friction=0.3, restitution=0.5)
    start = rk.release(ball, (1, 0, 0, 0), (0, 3, 1), (0, 0, 1.0), (1.0, 0, 0))
    run = lambda start, *times: rk.simulate(ball, start, times, modes=modes)
    first = run(start, 0.0, 0.2)
    assert first.final_state.mode == rk.Mode.FLYING
    second = run(first.final_state.in_its_mode, 0.2, 0.6)
    whole = run(start, 0.0, 0.6)
    # flight and the slip of a ball are parabolas, which any steps follow to roundings
    np.testing.assert_allclose(
        second.position[-1], whole.position[-1], rtol=0.0, atol=1e-12
    )
    for state in (first.final_state, first.final_state.parts):
        with pytest.raises(rk.FieldError, match=r"final_state\.in_its_mode"):
            run(state, 0.2, 0.6)
        with pytest.raises(rk.FieldError, match=r"final_state\.in_its_mode"):
            rk.simulate(ball, state, (0.2, 0.6))


# -- released in touch -----------------------------------------------------------------


def released(scene, gap, velocity, **how):
    """A ball that turns, let go so far above its base; where it is after a second."""
    spin = (0.0, 20.0, 0.0)
    start = rk.release(scene, UP, spin, (0.0, 0.0, R + gap), velocity)
    modes = rk.Modes(friction=0.3, restitution=0.5)
    return rk.simulate(scene, start, (0.0, 1.0), modes=modes, **how)


@pytest.mark.parametrize("method", slow_but(["native"], ["native", "diffrax"]))
@pytest.mark.parametrize("gap", [0.0, 1e-15, 1e-9])
def test_a_ball_let_go_in_touch_slips_until_it_rolls(gap, method):
    """Was stuck 2e-8 s behind its start for gaps below 1e-12 m."""
    run = released(LANE, gap, STILL, method=method)
    assert run.succeeded
    assert int(run.switches.count) == 2
    # it falls for sqrt(2 gap / g), or until it is down by the 64 roundings of 0.2 m
    # that a gap has: 3e-15 m, 2.5e-8 s, and twice that by its steps
    lands, rolls = run.switches.time[:2]
    assert lands < (2.0 * gap / G) ** 0.5 + 5e-8
    # its point slips at R w, and friction takes 3.5 mu g of that a second
    known = 20.0 * R / (3.5 * 0.3 * G)
    # by how long it fell, and what friction in the impact took: mu g times as long
    np.testing.assert_allclose(rolls, known, rtol=0, atol=2.0 * float(lands) + 1e-10)


def test_a_ball_in_touch_that_is_carried_away_flies():
    run = released(LANE, 0.0, (0.0, 0.0, 3.0))
    assert run.succeeded
    # 2 v / g, found to 1e-11 s
    np.testing.assert_allclose(run.switches.time[0], 6.0 / G, rtol=0, atol=1e-10)
    sinks = lambda t, a: jnp.stack([0.0 * t, 0.0 * t, -0.5 * a * t**2])
    falls = rk.BaseMotion(sinks, parameters=jnp.asarray(12.0))
    run = released(rk.Scene(BALL, rk.Base(rk.Plane(), falls)), 0.0, STILL)
    assert run.succeeded
    assert int(run.switches.count) == 0
    # the base falls by 12 m/s^2, the ball by 9.81
    np.testing.assert_allclose(run.position[-1, 2], R - 0.5 * G, rtol=0, atol=1e-9)
