"""Rolling contacts between bodies of a system, against closed forms and multipliers."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import ellipj, ellipk

import rollkane as rk
from rollkane import kane

from ..quick import slow_but
from ..rolling_contact_models import (
    BICYCLE,
    FLIPPED,
    G,
    at_rest,
    ball_bearing,
    ball_in_tube,
    between_plates,
    bicycle,
    bicycle_height_energy,
    carriage,
    carriage_height_energy,
    cylinder_in_pipe,
    cylinder_in_tube,
    plate,
)


def kept(rolling, run, bound=1e-12):
    """Slip and gap of every contact; roundings of lengths and speeds below ten."""
    assert run.succeeded, run.reason
    assert float(jnp.max(rolling.gaps(run.time, run.state))) < bound
    assert float(jnp.max(rolling.slips(run.time, run.state))) < bound


@pytest.mark.slow
def test_ball_between_plates():
    """Half the speed of a plate; round both plates' axes, the mean of their rates.

    With w the same above and below, 2 v = V + rates x (x - axes). Errors of a hundred
    steps at rtol 1e-11.
    """
    r, V, c = 0.3, 0.8, 0.5
    flat, q, spun = np.eye(3), [0.1, 0.2, 0.31], [0, 0, 0, 0, 0, 2.0]
    below = plate(0.0, 0.0, np.zeros(3), flat)
    above = plate(V, 0.0, [0.0, 0.0, 2 * r], FLIPPED)
    rolling = between_plates(below, above, r, q, spun)
    assert rolling.redundant == ("above: velocity along z",)
    assert rolling.undetermined == (
        "below: velocity along z",
        "above: velocity along z",
    )
    times = np.linspace(0.0, 5.0, 6)
    run = kane.simulate(rolling.system, rolling.start, times, rtol=1e-11)
    assert run.method == "native" or "compiler" in run.why
    kept(rolling, run)
    moved = np.stack([0.1 + V / 2 * times, 0.2 + 0 * times, r + 0 * times], axis=1)
    np.testing.assert_allclose(run.q[:, :3], moved, rtol=0, atol=1e-10)
    # nothing accelerates along the plates; of the weight each carries what it may
    force = rolling.forces(run.time, run.state).force
    np.testing.assert_allclose(force[:, :, :2], 0.0, atol=1e-9)
    np.testing.assert_allclose(force[:, :, 2].sum(axis=1), 2.0 * G, atol=1e-9)

    slow, fast = 0.7, 1.9
    below = plate(0.0, slow, np.zeros(3), flat)
    above = plate(0.0, fast, [c, 0.0, 2 * r], FLIPPED)
    rolling = between_plates(below, above, r, q, spun)
    run = kane.simulate(rolling.system, rolling.start, times, rtol=1e-11)
    kept(rolling, run)
    rate, middle = 0.5 * (slow + fast), np.array([c * fast / (slow + fast), 0.0])
    start = np.array([0.1, 0.2]) - middle
    cos, sin = np.cos(rate * times), np.sin(rate * times)
    x = middle[0] + cos * start[0] - sin * start[1]
    y = middle[1] + sin * start[0] + cos * start[1]
    np.testing.assert_allclose(run.q[:, 0], x, rtol=0, atol=1e-9)
    np.testing.assert_allclose(run.q[:, 1], y, rtol=0, atol=1e-9)


@pytest.mark.slow
def test_cylinder_in_a_pipe_is_a_pendulum():
    """Of length 3 (R - r) / 2, at any amplitude; two rims, one velocity too many.

    It stands still at the start, where the pipe pushes with m g cos and holds with
    m g sin / 3. 300 steps at rtol 1e-12, whose errors add up to a phase.
    """
    m, r, R, angle = 2.0, 0.1, 0.4, 1.2
    rolling = cylinder_in_pipe(m, r, R, 0.15, angle)
    assert rolling.redundant == ("other end: velocity along y",)
    times = np.linspace(0.0, 5.0, 21)
    run = kane.simulate(rolling.system, rolling.start, times, rtol=1e-12)
    kept(rolling, run)
    w, k = np.sqrt(2 * G / (3 * (R - r))), np.sin(angle / 2)
    swung = 2 * np.arcsin(k * ellipj(ellipk(k * k) - w * times, k * k)[0])
    found = np.arctan2(run.q[:, 0], -run.q[:, 2])
    np.testing.assert_allclose(found, swung, rtol=0, atol=1e-9)
    first = jax.tree.map(lambda x: x[0], run.state)
    force = rolling.forces(0.0, first).force.sum(axis=0)
    out = np.array([np.sin(angle), 0.0, -np.cos(angle)])
    along = np.array([np.cos(angle), 0.0, np.sin(angle)])
    # roundings of forces, through the inverse of an inertia a thousandth of the mass
    expected = m * G * (-np.cos(angle) * out + np.sin(angle) / 3 * along)
    np.testing.assert_allclose(force, expected, rtol=0, atol=1e-9)


TUBE = {"M": 1.5, "a": 0.5, "m": 0.7, "r": 0.12, "half": 0.3}


@pytest.mark.slow
def test_ball_in_a_tube_that_rolls():
    """Its frequency, with the tube pushed to and fro: g (2 M + 7 m / 5) / (14 M l / 5).

    The kinetic energy is M s^2 + 7 m (s + l phi')^2 / 10 for the tube's speed s, whose
    momentum is kept; l = a - r. Three contacts, one velocity too many.
    """
    rolling = ball_in_tube(**TUBE, angle=0.0, speeds=np.zeros(12))
    assert rolling.redundant == ("contacts[1]: velocity along y",)
    rest = rolling.eliminated_state(rolling.start)
    modes = np.linalg.eigvals(
        np.asarray(kane.linearize(rolling.eliminated, 0.0, rest).A)
    )
    M, m, long = TUBE["M"], TUBE["m"], TUBE["a"] - TUBE["r"]
    square = G * (2 * M + 1.4 * m) / (2.8 * M * long)
    # a simple pair: roundings of a matrix of order a hundred
    np.testing.assert_allclose(np.abs(modes.imag).max(), np.sqrt(square), rtol=1e-11)


@pytest.mark.slow
def test_cylinder_in_a_tube_that_rolls():
    """The same with a solid cylinder, on two rims: g (2 M + 3 m / 2) / (3 M l).

    T = M s^2 + 3 m (s + l phi')^2 / 4 by the inertia m r^2 / 2. Four contacts; neither
    rim can slip along the axis without the other.
    """
    rolling = cylinder_in_tube(**TUBE)
    assert rolling.redundant == (
        "contacts[1]: velocity along y",
        "contacts[3]: velocity along y",
    )
    rest = rolling.eliminated_state(rolling.start)
    modes = np.linalg.eigvals(
        np.asarray(kane.linearize(rolling.eliminated, 0.0, rest).A)
    )
    M, m, long = TUBE["M"], TUBE["m"], TUBE["a"] - TUBE["r"]
    square = G * (2 * M + 1.5 * m) / (3 * M * long)
    # as above
    np.testing.assert_allclose(np.abs(modes.imag).max(), np.sqrt(square), rtol=1e-11)


@pytest.mark.slow
@pytest.mark.parametrize("last", [100.0, 1000.0])
def test_contacts_hold_for_long(last):
    """Slip and gap of every contact of the tube and the ball, rolling askew.

    The ball goes slowly along the tube, so that its lever stays of order one.
    """
    speeds = np.array([0.3, 0, 0, 0, 0.3, 0, 0.3, 0.001, 0, 0, 0.3, 0])
    rolling = ball_in_tube(**TUBE, angle=0.5, speeds=speeds)
    run = kane.simulate(rolling.system, rolling.start, np.linspace(0.0, last, 101))
    kept(rolling, run)


@pytest.mark.slow
def test_a_ball_between_turning_plates_for_long():
    below = plate(0.0, 0.7, np.zeros(3), np.eye(3))
    above = plate(0.0, 1.9, [0.5, 0.0, 0.6], FLIPPED)
    rolling = between_plates(below, above, 0.3, [0.1, 0.2, 0.3], [0, 0, 0, 0, 0, 2.0])
    times = np.linspace(0.0, 100.0, 6)
    run = kane.simulate(rolling.system, rolling.start, times, rtol=1e-11)
    kept(rolling, run)


def two_balls(q, u, sizes, masses, bowl):
    """A ball in a bowl and one on top of it: Newton and Euler with both forces."""
    (r1, r2), (m1, m2) = sizes, masses
    c1, v1, w1 = q[:3], u[:3], u[3:6]
    c2, v2, w2 = q[7:10], u[6:9], u[9:12]
    up = (c2 - c1) / (r1 + r2)
    s1, s12, s2 = r1 * c1 / np.linalg.norm(c1), r1 * up, -r2 * up
    path1 = bowl / (bowl - r1) * v1
    path2 = v1 + r1 * (v2 - v1) / (r1 + r2)
    g = np.array([0.0, 0.0, -G])

    def residual(x):
        a1, b1, a2, b2, F1, F2 = x.reshape(6, 3)
        rows = [
            m1 * a1 - m1 * g - F1 + F2,
            0.4 * m1 * r1**2 * b1 - np.cross(s1, F1) + np.cross(s12, F2),
            m2 * a2 - m2 * g - F2,
            0.4 * m2 * r2**2 * b2 - np.cross(s2, F2),
            a1 + np.cross(b1, s1) + np.cross(w1, path1 - v1),
            (a2 + np.cross(b2, s2) + np.cross(w2, path2 - v2))
            - (a1 + np.cross(b1, s12) + np.cross(w1, path2 - v1)),
        ]
        return np.concatenate(rows)

    free = residual(np.zeros(18))
    columns = [residual(e) - free for e in np.eye(18)]
    return np.linalg.solve(np.stack(columns, axis=1), -free)


@pytest.mark.slow
def test_two_balls_against_multipliers():
    """Accelerations and both forces of a ball on a ball in a bowl."""
    (r1, r2), (m1, m2), bowl = (0.3, 0.2), (2.0, 0.9), 1.5
    inertias = [0.4 * m * r * r * np.eye(3) for m, r in ((m1, r1), (m2, r2))]
    bodies = kane.free_bodies([m1, m2], inertias)
    low, high = bodies.frames
    hollow = rk.Sphere(bowl, inside=True)
    c1 = (bowl - r1) * np.array([0.3, -0.2, -np.sqrt(1 - 0.13)])
    c2 = c1 + (r1 + r2) * np.array([0.1, 0.2, np.sqrt(1 - 0.05)])
    contacts = [
        kane.RollingContact(low, rk.Sphere(r1), kane.ground, hollow, near=1.2 * c1),
        kane.RollingContact(high, rk.Sphere(r2), low, rk.Sphere(r1)),
    ]
    turn = [0.8, 0.3, -0.4, 0.2]
    speeds = np.random.default_rng(0).standard_normal(12)
    rolling = kane.rolling_contacts(
        bodies.system, contacts, [*c1, *turn, *c2, *turn[::-1]], speeds
    )
    q, u = np.asarray(rolling.start.q), np.asarray(rolling.start.u)
    found = kane.kane_derivative(rolling.system, 0.0, rolling.start)
    expected = two_balls(q, u, (r1, r2), (m1, m2), bowl)
    # a thousand roundings of accelerations of order a hundred
    np.testing.assert_allclose(found.u, expected[:12], rtol=0, atol=1e-11)
    force = rolling.forces(0.0, rolling.start).force
    np.testing.assert_allclose(force.reshape(6), expected[12:], rtol=0, atol=1e-11)
    assert not rolling.redundant
    assert not rolling.undetermined


V = 5.0
# rows of lean and steer of SymPy's own test of the benchmark, as in test_bicycle.py
LEAN = [9.48977444677355, -0.891197738059089 * V**2 - 0.571523173729245,
        -0.105522449805691 * V, -0.330515398992311 * V]  # fmt: skip
STEER = [11.7194768719633, -1.97171508499972 * V**2 + 30.9087533932407,
         3.67680523332152 * V, -3.08486552743311 * V]  # fmt: skip


def rows_of(rolling):
    state = rolling.eliminated_state(rolling.start)
    return kane.linearize(rolling.eliminated, 0.0, state, (4, 6), (4, 6)).A[2:]


@pytest.mark.slow
def test_bicycle_by_its_contacts():
    """Sharp wheels on a plane: the published model, to the digits of its numbers."""
    rolling = bicycle(V, rk.Plane())
    assert not rolling.redundant
    np.testing.assert_allclose(rows_of(rolling), [LEAN, STEER], rtol=0, atol=1e-10)


MASSES = np.array([[80.81722, 2.31941332208709], [2.31941332208709, 0.29784188199686]])


@pytest.mark.slow
@pytest.mark.parametrize("tyre", [1e-3, 0.05])
def test_bicycle_with_toroidal_wheels(tyre):
    """The published model, and what tyres of a radius add to it, derived by hand.

    A wheel that leans by p stands on a point that lies tyre p beside that of a sharp
    one, on the side to which it leans. The velocity of its material at the road is, to
    first order, that of a sharp wheel's lowest point, so that masses and gyroscopic
    terms stay; of the forces there only the load N of the wheel gets a moment, -N tyre
    p about the path. That is a stiffness N tyre p^2 / 2, of the rear wheel with
    p = lean, of the front wheel with p = lean + steer sin(tilt).
    """
    b = BICYCLE
    masses = np.array([b.rear_mass, b.frame_mass, b.fork_mass, b.front_mass])
    along = [0.0, b.frame_mass_center[0], b.fork_mass_center[0], b.wheel_base]
    front = b.gravity * masses @ along / b.wheel_base
    rear = b.gravity * masses.sum() - front
    leans = np.array([1.0, 0.0]), np.array([1.0, np.sin(b.steer_tilt)])
    stiff = tyre * sum(
        N * np.outer(p, p) for N, p in zip((rear, front), leans, strict=True)
    )
    expected = np.array([LEAN, STEER])
    expected[:, :2] -= np.linalg.solve(MASSES, stiff)
    found = rows_of(bicycle(V, rk.Plane(), tyre))
    # fifteen digits of the published numbers, through the inverse of a matrix whose
    # eigenvalues are as 350 to 1
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-11)


@pytest.mark.slow
def test_bicycle_on_hills_keeps_its_energy():
    """20 s at rtol 1e-11: of the energy that goes up and down, 1e-10."""
    hills = rk.Graph(lambda x, y: 0.03 * jnp.cos(0.4 * x) * jnp.cos(0.3 * y))
    rolling = bicycle(V, hills, lean_rate=0.1)
    times = np.linspace(0.0, 20.0, 101)
    run = kane.simulate(rolling.system, rolling.start, times, rtol=1e-12)
    kept(rolling, run)
    high = jax.vmap(bicycle_height_energy)(run.q)
    energy = run.kinetic_energy + high
    assert np.ptp(np.asarray(high)) > 10.0
    assert np.abs(np.asarray(run.q[:, 4])).max() > 0.01
    assert np.ptp(np.asarray(energy)) < 1e-10 * float(energy[0])


@pytest.mark.slow
def test_carriage_on_curved_ground_keeps_its_energy():
    """Two wheels on one axle: on a plane one of their constraints is redundant."""
    q, u = [0.3, 0.2, 0.35, 0.4, 0.1, 0.2, 0, 0], [1.0, 0.3, 0, 0.1, 0, 0, 3, 3]
    bumps = lambda x, y: 0.1 * jnp.sin(x) * jnp.cos(0.7 * y) + 0.05 * x * y
    rolling = carriage(rk.Graph(bumps), q, u)
    assert not rolling.redundant
    times = np.linspace(0.0, 3.0, 31)
    run = kane.simulate(rolling.system, rolling.start, times, rtol=1e-12)
    kept(rolling, run)
    high = np.asarray(jax.vmap(carriage_height_energy)(run.q))
    assert np.ptp(high) > 1.0
    # some thousand steps of 1e-12, of an energy of some 50 J
    energy = np.asarray(run.kinetic_energy) + high
    assert np.ptp(energy) < 1e-9 * np.abs(energy).max()


@pytest.mark.slow
def test_carriage_on_a_plane_has_a_redundant_constraint():
    level = [0, 0, 0.3, 0.4, 0, 0.2, 0, 0]
    rolling = carriage(rk.Plane(), level, [1.0, 0.3, 0, 0.1, 0, 0, 3, 3])
    assert len(rolling.redundant) == 1
    assert "velocity along" in rolling.redundant[0]


@pytest.mark.slow
def test_four_balls_of_a_bearing():
    """A free ring on four balls: they go round with half of its speed at the inside."""
    inner, ball, rate = 0.05, 0.01, 20.0
    rolling = ball_bearing(inner, ball, rate)
    # a ring on three balls is where it is; each further one repeats what is known
    assert len(rolling.redundant) == 2
    times = np.linspace(0.0, 1.0, 11)
    run = kane.simulate(rolling.system, rolling.start, times, rtol=1e-11)
    kept(rolling, run)
    for k in range(4):
        x, y = np.asarray(run.q[:, 7 * (k + 1)]), np.asarray(run.q[:, 7 * (k + 1) + 1])
        gone = np.unwrap(np.arctan2(y, x))
        orbit = 0.5 * rate * inner / (inner + ball)
        # some hundred steps of 1e-11
        np.testing.assert_allclose(gone - gone[0], orbit * times, rtol=0, atol=1e-9)
    np.testing.assert_allclose(run.u[:, 5], rate, rtol=1e-9)


@pytest.mark.slow
def test_derivatives_of_a_closed_motion():
    """The end of a swing in the pipe by its start, against differences."""
    rolling = cylinder_in_pipe(2.0, 0.1, 0.4, 0.15, 1.2)

    def end(push):
        u = rolling.start.u + push * jnp.array([0.3, 0, 0.1, 0, 1.0, 0])
        start = kane.KaneState(rolling.start.q, u)
        return kane.simulate(rolling.system, start, [0.0, 0.7], rtol=1e-12).q[-1, :3]

    h = 1e-3
    found = jax.jacfwd(end)(0.2)
    back = jax.jacrev(end)(0.2)
    far, near = ((end(0.2 + x) - end(0.2 - x)) / (2 * x) for x in (2 * h, h))
    # differences of fourth order: h^4 = 1e-12, roundings and steps 1e-12 / h = 1e-9
    np.testing.assert_allclose(found, (4 * near - far) / 3, rtol=0, atol=1e-8)
    np.testing.assert_allclose(back, found, rtol=0, atol=1e-10)


def squeezed(rises):
    """A ball on the ground, below a plate that is drawn along y, down by ``rises``."""
    r, V = 0.3, 0.8
    above = kane.Frame(
        lambda t, q, u: jnp.stack([0.0 * t, V * t, 2 * r + 0.0 * t]),
        lambda t, q, u: jnp.asarray(FLIPPED) + 0.0 * t,
    )
    bodies = kane.free_bodies([1.0], [0.4 * r * r * np.eye(3)])
    (ball,) = bodies.frames
    contacts = [
        kane.RollingContact(ball, rk.Sphere(r), kane.ground, rk.Plane()),
        kane.RollingContact(
            ball, rk.Sphere(r), above, rk.Graph(lambda x, y: rises(y)), name="above"
        ),
    ]
    q, u = [0, 0, r, 1, 0, 0, 0], [0, V / 2, 0, 0, 0, 0]
    return kane.rolling_contacts(bodies.system, contacts, q, u)


def flat_for_a_while():
    """For 0.1 m, over which the contact goes at 0.4 m/s."""
    return squeezed(lambda y: jnp.where(y > 0.1, (y - 0.1) ** 4, 0.0))


@pytest.mark.parametrize("rtol", slow_but([], ["1e-9", "1e-2"]))
def test_a_run_ends_where_a_constraint_is_no_longer_redundant(rtol):
    """Loosely, too.

    Behind the flat the slip along z grows as 0.4 m/s times the slope, 4 y^3, to 1e-9 of
    two to four units at y = 1.3 mm, 3.2 ms later.
    """
    rolling, times = flat_for_a_while(), np.linspace(0.0, 1.0, 11)
    assert rolling.redundant == ("above: velocity along z",)
    run = kane.simulate(rolling.system, rolling.start, times, rtol=float(rtol))
    assert run.method == "native" or "compiler" in run.why
    assert run.code == rk.Code.NO_LONGER_REDUNDANT
    assert '"above: velocity along z"' in run.reason
    assert 0.25 < float(run.final_time) < 0.2535
    np.testing.assert_array_equal(np.isnan(run.q[:, 0]), times > 0.25)
    # roundings of lengths and speeds below one
    assert float(jnp.max(rolling.gaps(times, run.state)[:3])) < 1e-12
    assert float(jnp.max(rolling.slips(times, run.state)[:3])) < 1e-12


@pytest.mark.slow
def test_members_of_a_batch_end_where_their_own_constraints_do():
    """Half a metre before the end of the flat none does within a second.

    Natively and by diffrax. The ball is carried by half of the way, wherever it starts.
    """
    rolling = flat_for_a_while()
    start = rolling.start
    # along y: on the ground as the ball, on the flipped plate against it
    moved = jnp.zeros(11).at[jnp.array([1, 8, 10])].set(jnp.array([1.0, 1.0, -1.0]))

    def last(y, method):
        at = kane.KaneState(start.q + y * moved, start.u)
        run = kane.simulate(rolling.system, at, [0.0, 1.0], method=method)
        return run.q[-1, 1], run.code

    for method in ("auto", "diffrax"):
        both = jax.vmap(lambda y, method=method: last(y, method))
        place, code = both(jnp.array([0.0, 0.5]))
        assert code.tolist() == [rk.Code.NO_LONGER_REDUNDANT, rk.Code.COMPLETED]
        assert np.isnan(place[0])
        np.testing.assert_allclose(place[1], 0.9, rtol=0, atol=1e-12)
    slope = jax.grad(lambda y: last(y, "auto")[0])(0.5)
    np.testing.assert_allclose(slope, 1.0, rtol=0, atol=1e-12)


def test_a_start_whose_redundancy_is_chance_is_refused_by_its_row():
    """At the lowest line of a plate, or on a crest, where slopes are all the same."""
    row = "start.q: .* by chance.*above: velocity along z.*another start"
    with pytest.raises(rk.FieldError, match=row):
        squeezed(lambda y: y**2)


@pytest.mark.slow
def test_a_carriage_that_starts_on_a_crest_is_refused_by_its_row():
    """Whether it turns, or goes straight on, where the row would go on to follow.

    No name in the error is one that users of contacts never wrote.
    """
    hills = rk.Graph(lambda x, y: 0.15 * jnp.cos(x) + 0.0 * y)
    q = [0, 0, 0.45, 0, 0, 0.2, 0, 0]
    for turning in (0.5, 0.0):
        u = [1.0, 0, 0, turning, 0, 0, 1.0 / 0.3, 1.0 / 0.3]
        with pytest.raises(rk.FieldError, match="right: velocity along y") as refused:
            carriage(hills, q, u)
        assert "KaneSystem" not in str(refused.value)


@pytest.mark.parametrize("tilt", [0.15, 1.2])
@pytest.mark.parametrize("r", [0.1, 10.0])
def test_a_start_that_closes_stays_where_it_is(r, tilt):
    """A disc on its rim, which rolls: nearest to it is itself, wherever a search began.

    It is off by the roundings of its own numbers: some of its size and of its speed.
    """
    c, s = np.cos(tilt), np.sin(tilt)
    lowest = r * np.array([0.0, -c, -s])
    q = [0.2, -0.1, r * s, np.cos(tilt / 2), np.sin(tilt / 2), 0.0, 0.0]
    turns = np.array([1.0, 2.0, 3.0])
    u = [*np.cross(lowest, turns), *turns]
    free = kane.free_bodies([1.0], [r**2 * np.diag([0.25, 0.25, 0.5])])
    rim = kane.RollingContact(free.frames[0], rk.DiscEdge(r), kane.ground, rk.Plane())
    start = kane.rolling_contacts(free.system, [rim], q, u).start
    few = 16.0 * np.finfo(float).eps * max(r, 1.0)
    np.testing.assert_allclose(start.q[:7], q, rtol=0, atol=few)
    np.testing.assert_allclose(start.u[:6], u, rtol=0, atol=10.0 * few)


def test_bad_contacts_are_refused_by_name():
    flat, q, still = np.eye(3), [0.1, 0.2, 0.3], np.zeros(6)
    below = plate(0.0, 0.0, np.zeros(3), flat)
    apart = kane.free_bodies([1.0], [np.eye(3)])
    (ball,) = apart.frames

    def refused(match, *contacts, q=(0.0, 0.0, 0.3, 1, 0, 0, 0), u=still):
        with pytest.raises(rk.FieldError, match=match):
            kane.rolling_contacts(apart.system, contacts, q, u)

    solid = rk.Sphere(0.3)

    def on(surface, body=kane.ground, a=solid, **more):
        return kane.RollingContact(ball, a, body, surface, **more)

    refused("contacts: are none")
    refused("body_b: is no body", on(rk.Plane(), body=3))
    refused("surface_b: is no surface", on(3))
    line = on(rk.Plane(), a=rk.Cylinder(0.3), near=[0.0, 0.0, 0.0], name="roller")
    lying = (0.0, 0.0, 0.3, np.sqrt(0.5), np.sqrt(0.5), 0.0, 0.0)
    refused("surface_b of roller: fits the other surface", line, q=lying)
    far = at_rest(FLIPPED)
    refused(
        "contact open that cannot be closed.* lid: gap along z",
        on(rk.Plane()),
        kane.RollingContact(
            ball,
            rk.Sphere(0.3),
            kane.Frame(lambda t, q, u: jnp.array([0, 0, 0.9]), far.rotation),
            rk.Plane(),
            name="lid",
        ),
    )
    # a lid that rises: the ball would have to follow both
    rising = kane.Frame(
        lambda t, q, u: jnp.stack([0.0 * t, 0.0 * t, 0.6 + t]), far.rotation
    )
    refused(
        "cannot all hold: their 6 .* rank 5", on(rk.Plane()), on(rk.Plane(), rising)
    )
    stuck = on(rk.Plane(), without_spin=True)
    lid = kane.Frame(lambda t, q, u: jnp.array([0.0, 0.0, 0.6]), far.rotation)
    refused("leave nothing that can move: .* rank 6", stuck, on(rk.Plane(), lid))
    above = plate(0.0, 0.0, [0, 0, 0.6], FLIPPED)
    rolling = between_plates(below, above, 0.3, q, still)
    with pytest.raises(rk.FieldError, match=r"linearize\.system: .* by multipliers"):
        kane.linearize(rolling.system, 0.0, rolling.start)
