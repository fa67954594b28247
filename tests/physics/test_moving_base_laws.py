"""Exact laws of motion on moving bases and with masses inside."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk
from rollkane.dynamics import observables, rolling
from rollkane.geometry.rotations import rotation_matrix

from .. import problems
from ..paper import moving_base

G = 9.81
RTOL = 1e-11
# Between 500 and 4000 steps, each wrong by at most rtol of its state: 4e-8 of the
# largest number. Centres move by up to 1 m; spins reach 150 rad/s.
SMALL = 4e-8
LEVEL = (1.0, 0.0, 0.0, 0.0)
RADIUS = 0.0254


def ball(mass=0.11, radius=RADIUS, **rest):
    inertia = 0.4 * mass * radius**2 * np.eye(3)
    return rk.Body(mass, inertia, rk.Sphere(radius), **rest)


def run(scene, start, end, count=81, **options):
    result = rk.simulate(
        scene, start, np.linspace(0.0, end, count), rtol=RTOL, **options
    )
    assert bool(result.succeeded), result.reason
    return result


def velocity(result):
    """Of the body origin: of the base at the contact, and the turn about it."""

    def of(scene, t, state):
        contact = rk.contact_of(scene, t, state)
        slow = jnp.cross(contact.body_point, contact.angular_velocity)
        if contact.base_velocity is not None:
            slow = slow + contact.base_velocity
        return contact.rotation @ slow

    return np.asarray(result.each(of))


@pytest.mark.parametrize("case", ["c01", "c22", "c31"])
def test_reference_cases(case):
    if case == "c22" and not problems.RECORDS.is_dir():
        pytest.skip("its records may not be redistributed; the law is tested below")
    scene, start, given = problems.moving_case(case)
    result = rk.simulate(scene, start, np.array(given["times"]), rtol=RTOL)
    assert bool(result.succeeded)
    exact, error = given["reference"], given["reference_error"]
    w = np.array(exact["omega_inertial"])
    steps = int(result.steps)
    # rtol per step and component, of the largest of each; and the references' errors
    promised = steps * RTOL
    speed = np.abs(w).max()
    position = np.array(exact["position"])
    own = 10 * error["position"]
    assert (
        np.abs(result.position - position).max()
        < promised * (np.abs(position).max() + RADIUS * speed) + own
    )
    off = problems.quaternion_error(result.orientation, exact["quaternion"])
    # the quaternion turns at half the speed of the body, for the whole time
    assert off.max() < promised * speed + 10 * error["quaternion"]
    spun = np.abs(np.asarray(result.angular_velocity) - w).max()
    assert spun < promised * speed + 10 * error["omega"]
    if case == "c31":
        found = np.concatenate([result.alpha, result.alpha_dot], axis=1)
        off = np.abs(found - np.array(exact["internal_state"])).max()
        assert off < promised * np.abs(found).max() + 10 * error["internal_state"]
    if case != "c01":  # its forces turn with a phase of 3000 rad
        force = np.array(exact["contact_force_inertial"])
        off = np.abs(np.asarray(result.contact_force) - force).max()
        assert off < promised * np.abs(force).max() * speed + 1e-9


def test_circle_on_a_turntable():
    """A ball goes round at 2/7 of the table's rate (Earnshaw 1844; Routh 1905)."""
    Omega = 4.0
    scene = rk.Scene(ball(), rk.Base(rk.Plane(), rk.Spin(Omega)))
    start = rk.place(scene, LEVEL, (3.0, -5.0, 2.0), (0.21, -0.07, 0.0))
    result = run(scene, start, 10.0)
    p, v = np.asarray(result.position), velocity(result)
    rate = 2.0 / 7.0 * Omega
    centre = p[0] + np.cross([0.0, 0.0, 1.0], v[0]) / rate
    t = np.asarray(result.time)
    c, s = np.cos(rate * t), np.sin(rate * t)
    x, y = (p[0] - centre)[:2]
    circle = centre[:2] + np.stack([c * x - s * y, s * x + c * y], axis=1)
    np.testing.assert_allclose(p[:, :2], circle, atol=SMALL)
    kept = np.asarray(result.moving_energy)
    # of the largest energy that goes in and out
    assert np.ptp(kept) < SMALL * np.abs(np.asarray(result.energy)).max() + 1e-12
    assert np.ptp(np.asarray(result.energy)) > 0.01


def test_drift_on_a_tilted_turntable():
    """The circle drifts across the slope at (5/2) g sin(angle)/Omega."""
    Omega, angle = 5.0, 0.1
    tilt = problems.turn(0, np.rad2deg(angle))
    table = rk.Spin(Omega, orientation=tilt)
    scene = rk.Scene(ball(), rk.Base(rk.Plane(), table))
    start = rk.place(scene, LEVEL, (1.0, 2.0, 0.5), (0.1, 0.05, 0.0))
    period = 2 * np.pi / (2.0 / 7.0 * Omega)
    result = run(scene, start, 2 * period, 3)
    p = np.asarray(result.position)
    # steady: (2/7) Omega n x v + (5/7) g_t = 0, so v = (5/2) n x g / Omega
    normal = problems.matrix(tilt) @ [0.0, 0.0, 1.0]
    drift = 2.5 / Omega * np.cross(normal, [0.0, 0.0, -G])
    assert abs(np.linalg.norm(drift) - 2.5 * G * np.sin(angle) / Omega) < 1e-12
    np.testing.assert_allclose(p[1] - p[0], drift * period, atol=SMALL)
    np.testing.assert_allclose(p[2] - p[1], drift * period, atol=SMALL)


def spun_up(t, p):
    """Angle of a table whose rate changes: 2 t + 0.8 sin t."""
    angle = p["rate"] * t + p["swing"] * jnp.sin(t)
    c, s, o, i = jnp.cos(angle), jnp.sin(angle), jnp.zeros_like(t), jnp.ones_like(t)
    return jnp.stack(
        [jnp.stack([c, -s, o]), jnp.stack([s, c, o]), jnp.stack([o, o, i])]
    )


def test_any_turntable_rate():
    """v - (2/7) Omega(t) n x r stays constant whatever Omega does."""
    parameters = {"rate": 2.0, "swing": 0.8}
    motion = rk.BaseMotion(rotation=spun_up, parameters=parameters)
    scene = rk.Scene(ball(), rk.Base(rk.Plane(), motion))
    start = rk.place(scene, LEVEL, (1.0, 3.0, -1.0), (0.2, 0.1, 0.0))
    result = run(scene, start, 8.0)
    Omega = 2.0 + 0.8 * np.cos(np.asarray(result.time))
    p = np.asarray(result.position)
    swirl = np.stack([-p[:, 1], p[:, 0], 0.0 * Omega], axis=1)
    kept = velocity(result) - 2.0 / 7.0 * Omega[:, None] * swirl
    np.testing.assert_allclose(kept, np.broadcast_to(kept[0], kept.shape), atol=SMALL)
    assert np.ptp(velocity(result)[:, 0]) > 0.1


def test_shaken_plate():
    """x - (2/7) X_base is linear in t, for a rough record of both components."""
    record = np.random.default_rng(7).standard_normal((201, 2))
    time = 0.05 * np.arange(201)
    motion = rk.RecordedMotion(time, record, (0.1, -0.2, 0.0), (0.0, 0.3, 0.0))
    scene = rk.Scene(ball(), rk.Base(rk.Plane(), motion))
    start = rk.place(scene, LEVEL, (0.5, 0.0, 1.0), (0.0, 0.0, 0.0))
    result = run(scene, start, 10.0)
    own = np.asarray(result.position) - 2.0 / 7.0 * np.asarray(result.base_position)
    t = np.asarray(result.time)[:, None]
    line = own[0] + (own[-1] - own[0]) * t / t[-1]
    np.testing.assert_allclose(own, line, atol=SMALL)
    assert np.ptp(np.asarray(result.base_position)[:, 0]) > 0.5


@pytest.mark.slow
def test_moving_energy_of_an_unsymmetric_body():
    """E - Omega J_z for an ellipsoid with its mass off centre."""
    body = rk.Body(
        0.5,
        np.diag([4.0e-4, 5.0e-4, 7.0e-4]),
        rk.Ellipsoid((0.06, 0.05, 0.04)),
        (0.004, -0.003, 0.005),
    )
    scene = rk.Scene(body, rk.Base(rk.Plane(), rk.Spin(3.0)))
    start = rk.place(scene, problems.turn(0, 30.0), (1.0, 2.0, 4.0), (0.05, 0.1, 0.0))
    result = run(scene, start, 5.0)
    kept, energy = np.asarray(result.moving_energy), np.asarray(result.energy)
    J = np.asarray(result.angular_momentum)[:, 2]
    np.testing.assert_allclose(kept, energy - 3.0 * J, atol=1e-13)
    assert np.ptp(kept) < SMALL * np.abs(energy).max()
    assert np.ptp(energy) > 0.01


def test_shell_with_a_frictionless_pendulum():
    """I w + r e_z x P is constant: the pendulum pulls through the centre only."""
    arm = 0.08

    def bob(a):  # two hinges at the centre
        s, c = jnp.sin(a), jnp.cos(a)
        return arm * jnp.stack([jnp.stack([s[0] * c[1], s[1], -c[0] * c[1]])])

    shell = rk.Body(0.8, 0.00768 * np.eye(3), rk.Sphere(0.12))
    scene = rk.Scene(shell, supported=rk.PointMasses([0.5], bob))
    start = rk.place(
        scene, LEVEL, (0.3, 0.8, 0.4), (0.0, 0.0, 0.0), (0.5, 0.3), (0.2, -0.4)
    )
    result = run(scene, start, 6.0)
    P, w = np.asarray(result.momentum), np.asarray(result.angular_velocity)
    kept = 0.00768 * w + 0.12 * np.cross([0.0, 0.0, 1.0], P)
    # numbers of about 0.01 kg m^2/s, made of terms of 0.1
    np.testing.assert_allclose(kept, np.broadcast_to(kept[0], kept.shape), atol=1e-10)
    energy = np.asarray(result.energy)
    assert np.ptp(energy) < SMALL * np.abs(energy).max()
    assert np.ptp(P[:, 0]) > 0.01


@pytest.mark.slow
def test_power_of_a_damped_slider():
    """A slider with spring and damper: the energy falls by exactly what it takes."""
    slider = rk.PointMasses(
        [0.2],
        lambda a: jnp.stack([jnp.stack([a[0], 0.02 + 0 * a[0], 0.01 + 0 * a[0]])]),
        lambda t, a, a_dot: -0.3 * a_dot,
        potential=lambda a: 4.0 * a[0] ** 2,
    )
    body = rk.Body(0.5, np.diag([4e-4, 5e-4, 7e-4]), rk.Ellipsoid((0.06, 0.05, 0.04)))
    scene = rk.Scene(body, supported=slider)
    start = rk.place(scene, LEVEL, (3.0, 1.0, 2.0), (0.0, 0.0, 0.0), (0.02,), (0.0,))
    result = run(scene, start, 4.0)
    np.testing.assert_allclose(
        result.power, -0.3 * np.asarray(result.alpha_dot)[:, 0] ** 2, rtol=1e-12
    )

    def rate(scene, t, state):
        rates = rk.rolling_derivative(scene, t, state)
        energy = lambda t, s: observables.energy(scene, t, s)
        return jax.jvp(energy, (t, state), (jnp.ones_like(t), rates))[1]

    rates, power = np.asarray(result.each(rate)), np.asarray(result.power)
    # cancelling flows of energy of about 1 W
    np.testing.assert_allclose(rates, power, atol=1e-12)
    # and in the large: the integral of the power, by Gauss-Legendre on 40 pieces
    nodes, weights = np.polynomial.legendre.leggauss(8)
    edges = np.linspace(0.0, 4.0, 41)
    half = 0.5 * np.diff(edges)[:, None]
    times = (edges[:-1, None] + half * (1 + nodes)).ravel()
    fine = rk.simulate(scene, start, np.concatenate([[0.0], times, [4.0]]), rtol=RTOL)
    inside = np.asarray(fine.power)[1:-1].reshape(40, 8)
    work = np.sum(half * weights * inside)
    energy = np.asarray(result.energy)
    assert abs(energy[-1] - energy[0] - work) < 1e-9 * abs(energy[0])
    assert work < -1e-3


@pytest.mark.slow
def test_a_galilean_glide_changes_nothing():
    """A base that glides steadily moves its body as one at rest does."""
    v = np.array([0.7, -0.4, 0.2])
    body = rk.Body(0.5, np.diag([4e-4, 5e-4, 7e-4]), rk.Ellipsoid((0.06, 0.05, 0.04)))
    plane = rk.Plane()
    still, gliding = (
        rk.Scene(body, rk.Base(plane, motion))
        for motion in (None, rk.BaseMotion(lambda t, p: p * t, parameters=v))
    )
    given = (problems.turn(0, 20.0), (1.0, 2.0, 4.0), (0.05, 0.1, 0.0))
    at_rest = run(still, rk.place(still, *given), 3.0)
    moved = run(gliding, rk.place(gliding, *given), 3.0)
    shift = np.asarray(moved.time)[:, None] * v
    np.testing.assert_allclose(moved.position - shift, at_rest.position, atol=SMALL)
    np.testing.assert_allclose(moved.contact_force, at_rest.contact_force, atol=1e-6)


def test_a_prescribed_motion_is_one_that_a_motor_makes():
    """A mass driven as sin(3 t) moves the shell as a coordinate that does so."""
    arm = 0.08
    bob = lambda a: (
        arm * jnp.stack([jnp.stack([jnp.sin(a[0]), 0 * a[0], -jnp.cos(a[0])])])
    )
    pendulum = rk.PointMasses([0.5], bob)
    shell = rk.Body(0.8, 0.00768 * np.eye(3), rk.Sphere(0.12), (0.01, 0.0, 0.02))
    drive = rk.Prescribed(pendulum, lambda t: 0.4 * jnp.sin(3.0 * t)[None])
    scene = rk.Scene(shell, supported=drive)
    start = rk.place(scene, LEVEL, (0.3, 0.8, 0.4), (0.0, 0.0, 0.0))
    rates = rk.rolling_derivative(scene, jnp.asarray(0.3), start)
    # the same by a free coordinate: its own equation's force makes it follow
    t = 0.3
    at = rk.place(
        rk.Scene(shell, supported=pendulum),
        LEVEL,
        (0.3, 0.8, 0.4),
        (0.0, 0.0, 0.0),
        (0.4 * np.sin(3 * t),),
        (1.2 * np.cos(3 * t),),
    )
    wanted = -3.6 * np.sin(3 * t)

    def with_motor(torque):
        motor = rk.PointMasses([0.5], bob, lambda t, a, a_dot: torque + 0 * a)
        driven = rk.Scene(shell, supported=motor)
        return rk.rolling_derivative(driven, jnp.asarray(t), at)

    zero, one = (with_motor(x).alpha_dot[0] for x in (0.0, 1.0))
    torque = (wanted - zero) / (one - zero)
    expected = with_motor(torque).angular_velocity
    np.testing.assert_allclose(rates.angular_velocity, expected, atol=1e-10)
    power = observables.power(scene, jnp.asarray(t), start)
    # the motor's torque times the rate of its joint
    assert abs(float(power) - float(torque) * 1.2 * np.cos(3 * t)) < 1e-10
    rate_of = lambda t, s: observables.energy(scene, t, s)
    now = jnp.asarray(t)
    rate = jax.jvp(rate_of, (now, start), (jnp.ones_like(now), rates))[1]
    assert abs(float(rate) - float(power)) < 1e-10


def test_a_frozen_supported_body_is_part_of_the_body():
    """A carried body that cannot move adds its mass and inertia, and no more."""
    turn = problems.matrix(problems.turn(0, 40.0))
    place = np.array([0.01, 0.02, -0.015])
    own = np.diag([1e-4, 2e-4, 2.5e-4])
    carried = rk.SupportedBody(
        0.3, own, lambda a: jnp.asarray(place), lambda a: jnp.asarray(turn)
    )
    assert carried.count == 0
    shell = rk.Body(0.8, 0.00768 * np.eye(3), rk.Sphere(0.12))
    scene = rk.Scene(shell, supported=carried)
    centre = 0.3 * place / 1.1
    steiner = lambda m, d: m * (d @ d * np.eye(3) - np.outer(d, d))
    inertia = 0.00768 * np.eye(3) + steiner(0.8, centre) + turn @ own @ turn.T
    inertia = inertia + steiner(0.3, place - centre)
    whole = rk.Scene(rk.Body(1.1, inertia, rk.Sphere(0.12), centre))
    given = (problems.turn(1, 50.0), (1.0, -2.0, 3.0), (0.0, 0.0, 0.0))
    rates = [
        rk.rolling_derivative(s, jnp.zeros(()), rk.place(s, *given)).angular_velocity
        for s in (scene, whole)
    ]
    np.testing.assert_allclose(rates[0], rates[1], rtol=1e-12)


@pytest.mark.slow
def test_a_supported_body_is_its_cloud_of_points():
    """Six points on the axes of a carried body have its mass and inertia."""
    half = np.array([0.02, 0.03, 0.015])
    points = np.concatenate([np.diag(half), -np.diag(half)])
    mass = 0.05
    second = 2 * mass * np.diag(half**2)
    own = np.trace(second) * np.eye(3) - second

    def rotation(a):
        quaternion = jnp.stack([jnp.ones_like(a[0]), a[1], 0.5 * a[2], 0.3 + a[0]])
        return rotation_matrix(quaternion)

    def centre(a):
        return jnp.stack([0.02 * a[0], 0.01 * a[1] ** 2, 0.03 * a[0] * a[2]])

    cloud = lambda a: centre(a)[None] + points @ rotation(a).T
    force = lambda t, a, a_dot: -0.01 * a - 0.02 * a_dot
    shell = rk.Body(0.8, 0.00768 * np.eye(3), rk.Sphere(0.12), (0.01, 0.0, 0.02))
    base = rk.Base(rk.Plane(), moving_base(*np.random.default_rng(3).random((4, 3))))
    parts = (
        rk.SupportedBody(6 * mass, own, centre, rotation, force, coordinates=3),
        rk.PointMasses(np.full(6, mass), cloud, force, coordinates=3),
    )
    given = (problems.turn(1, 50.0), (1.0, -2.0, 3.0), (0.0, 0.0, 0.0))
    alpha = (0.4, -0.3, 0.6), (1.0, 2.0, -0.5)
    found = []
    for part in parts:
        scene = rk.Scene(shell, base, part)
        start = rk.place(scene, *given, *alpha)
        rates = rk.rolling_derivative(scene, jnp.zeros(()), start)
        found.append(
            [
                np.concatenate([rates.angular_velocity, rates.alpha_dot]),
                rolling.contact_force(scene, jnp.zeros(()), start),
                observables.angular_momentum(scene, jnp.zeros(()), start),
                observables.energy(scene, jnp.zeros(()), start),
            ]
        )
    for one, other in zip(*found, strict=True):
        scale = np.abs(np.asarray(other)).max()
        np.testing.assert_allclose(one, other, atol=1e-11 * scale)
