"""Kane's method on the second source's examples, against closed forms."""

import functools

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import ellipj, ellipk

import rollkane as rk
from rollkane import kane
from tests.problems import load

# closed forms of order one to ten through a dozen roundings, and a linear solve
EXACT = 1e-12
DRAW = np.random.default_rng(20)


def test_free_body_equations():
    """[B] (2) and (3)."""
    m, I1, I2, I3 = 1.7, 0.3, 0.5, 0.7
    F, M = DRAW.standard_normal((2, 3))
    system = kane.free_rigid_body(
        m, np.diag([I1, I2, I3]), lambda t, q, u: F, lambda t, q, u: M
    )
    e = DRAW.standard_normal(4)
    e /= np.linalg.norm(e)
    v, w = DRAW.standard_normal((2, 3))
    q = jnp.asarray([*DRAW.standard_normal(3), *e])
    rates = kane.kane_derivative(system, 0.0, kane.KaneState(q, jnp.array([*v, *w])))
    expected = [
        *(F / m - np.cross(w, v)),
        (M[0] - (I3 - I2) * w[1] * w[2]) / I1,
        (M[1] - (I1 - I3) * w[2] * w[0]) / I2,
        (M[2] - (I2 - I1) * w[0] * w[1]) / I3,
    ]
    np.testing.assert_allclose(rates.u, expected, rtol=0, atol=EXACT)
    e1, e2, e3, e4 = e
    matrix = [[e4, -e3, e2], [e3, e4, -e1], [-e2, e1, e4], [-e1, -e2, -e3]]
    np.testing.assert_allclose(rates.q[3:], 0.5 * np.array(matrix) @ w, atol=EXACT)
    R = np.array(
        [
            [
                e1**2 - e2**2 - e3**2 + e4**2,
                2 * (e1 * e2 + e3 * e4),
                2 * (e1 * e3 - e2 * e4),
            ],
            [
                2 * (e1 * e2 - e3 * e4),
                -(e1**2) + e2**2 - e3**2 + e4**2,
                2 * (e2 * e3 + e1 * e4),
            ],
            [
                2 * (e1 * e3 + e2 * e4),
                2 * (e2 * e3 - e1 * e4),
                -(e1**2) - e2**2 + e3**2 + e4**2,
            ],
        ]
    )  # fixed to body axes
    np.testing.assert_allclose(rates.q[:3], R.T @ v, atol=EXACT)


def test_bar_equations():
    """[B] (5) and (6)."""
    m, L, d, M_phi, M_theta = 1.3, 0.9, 0.6, 0.4, -0.7
    system = kane.bar_on_frame(m, L, d, lambda t, q, u: M_phi, lambda t, q, u: M_theta)
    phi, theta, v, w2 = DRAW.standard_normal(4)
    state = kane.KaneState(jnp.array([phi, theta]), jnp.array([v, w2]))
    rates = kane.kane_derivative(system, 0.0, state)
    S, C = np.sin(theta), np.cos(theta)
    J = m * L**2 / 12
    turned = (M_phi + 2 * J / d * S * C * v * w2) / (m * d + J * C**2 / d)
    tilted = (M_theta - J / d**2 * S * C * v**2) / J
    np.testing.assert_allclose(rates.u, [turned, tilted], rtol=EXACT)
    np.testing.assert_allclose(rates.q, [v / d, w2], rtol=EXACT)


def jacobi(w1, times):
    """Angular velocity of the body with moments 1, 2, 3 from (w1, 5, 0)."""
    I, w = np.array([1.0, 2.0, 3.0]), np.array([w1, 5.0, 0.0])
    T2, L2 = (I * w**2).sum(), (I**2 * w**2).sum()
    low, high = T2 * I[2] - L2, L2 - T2 * I[0]
    size = np.sqrt(
        [
            low / (I[0] * (I[2] - I[0])),
            high / (I[1] * (I[1] - I[0])),
            high / (I[2] * (I[2] - I[0])),
        ]
    )
    n = np.sqrt((I[1] - I[0]) * low / I.prod())
    m = (I[2] - I[1]) * high / ((I[1] - I[0]) * low)
    sn, cn, dn, _ = ellipj(n * times + ellipk(m), m)
    return size * np.stack([dn, sn, cn], axis=1)


@functools.cache
def spinning(w1):
    start = kane.KaneState(jnp.eye(7)[6], jnp.array([0.0, 0.0, 0.0, w1, 5.0, 0.0]))
    system = kane.free_rigid_body(1.0, np.diag([1.0, 2.0, 3.0]))
    times = np.asarray(load("k01")["times"])
    return times, kane.simulate(system, start, times, rtol=1e-14)


def test_flips_follow_jacobi_functions():
    """16 flips in 40 s; at rtol 1e-14 rounding is what is left (some 1e-11)."""
    times, run = spinning(0.5)
    assert (np.diff(np.sign(run.u[:, 4])) != 0).sum() == 16
    np.testing.assert_allclose(run.u[:, 3:], jacobi(0.5, times), atol=1e-10)


def test_flips_next_to_the_separatrix():
    """k01 starts 1e-3 from the separatrix.

    A body in the middle of a flip has angular velocities of order 5, of which
    D = L^2 - 2 T I_2 = -1e-6 is what is left of terms of order 100: rounding the state
    once, even with no further error, changes D by eps L^2 / |D| of itself, which shifts
    every later flip by half of that over the rate n of the departure. (The next test
    has the speeds that avoid it.)
    """
    reference = load("k01")
    times, run = spinning(1e-3)
    error = np.abs(run.u[:, 3:] - np.asarray(reference["reference"]["omega_body"]))
    first = times < 6.0  # through the first flip, at 3.43 s
    assert error[first].max() < 1e-10
    rounding = np.finfo(float).eps * 100.0 / 1e-6
    n, fastest = 5.0 / np.sqrt(3.0), 25.0 / np.sqrt(3.0)  # [rad/s], [rad/s^2]
    flips, roundings = 6, 10  # a flip takes some hundred steps: 10 in the mean square
    assert error.max() < flips * roundings * rounding / (2 * n) * fastest
    norm = np.sqrt((np.asarray(run.q[:, 3:]) ** 2).sum(axis=1))
    np.testing.assert_allclose(norm, 1.0, atol=1e-13)  # 1500 steps of rounding


def test_k01_through_all_flips():
    """Speeds and integrals next to the separatrix, as Kane's method lets one choose.

    D = L^2 - 2 T I_2 = -(p r) with p = w1 - k w3 and r = w1 + k w3: one of them is some
    1e-7 in a flip, and is known to rounding as a speed of its own. Where steps end on
    the p r of the start, nothing of D is lost.
    """
    reference = load("k01")
    times = np.asarray(reference["times"])
    expected = np.asarray(reference["reference"]["omega_body"])
    k = np.sqrt(3.0)

    def spin(t, q, u):
        return 0.5 * jnp.stack([u[0] + u[2], 2.0 * u[1], (u[2] - u[0]) / k])

    def kinematics(t, q, u):
        e, w = q[:3], spin(t, q, u)
        return [*(0.5 * (q[3] * w + jnp.cross(e, w))), -0.5 * jnp.sum(e * w)]

    w = expected[0]
    start = jnp.array([w[0] - k * w[2], w[1], w[0] + k * w[2]])
    product = float(start[0] * start[2])

    def keep(state):
        p, _, r = state.u
        first = jnp.abs(p) < jnp.abs(r)  # the smaller follows from the larger
        large = jnp.where(first, r, p)
        small = product / large
        ends = jnp.where(first, small, large), jnp.where(first, large, small)
        return kane.KaneState(state.q, jnp.stack([ends[0], state.u[1], ends[1]]))

    moments = np.diag([1.0, 2.0, 3.0])
    at_rest = lambda t, q, u: 0.0 * u
    part = kane.RigidBody(1.0, moments, at_rest, spin)
    system = kane.KaneSystem(4, 3, kinematics, [part])
    run = kane.simulate(
        system,
        kane.KaneState(jnp.eye(4)[3], start),
        times,
        rtol=1e-14,
        solver=rk.Keeping(diffrax.Dopri8(), keep),
    )
    found = jax.vmap(lambda u: spin(0.0, None, u))(run.u)
    assert (np.diff(np.sign(expected[:, 1])) != 0).sum() == 6
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-10)


def test_babyboot():
    """Chaotic: the error at 10 s falls with the tolerance; 8 digits, then more."""
    reference, start = (
        load("k02"),
        kane.KaneState(jnp.array([np.pi / 2, np.pi / 180]), jnp.zeros(2)),
    )
    times = np.asarray(reference["times"])
    end = np.array([reference["reference"][k][-1] for k in ("qA", "qB")])
    published = reference["published_at_10s"]
    errors = []
    for rtol in (1e-9, 1e-11, 1e-13):
        run = kane.simulate(kane.babyboot(), start, times, rtol=rtol)
        errors.append(np.abs(run.q[-1] - end))
    relative = np.array(errors) / np.abs(end)
    assert (relative[2] < 0.5e-8).all()
    assert (relative[2] < 0.1 * relative[1]).all()
    assert (relative[1] < 0.1 * relative[0]).all()
    degrees = np.degrees(run.q[-1])
    np.testing.assert_allclose(
        degrees, [published["qA_deg"], published["qB_deg"]], rtol=1e-7
    )


@pytest.fixture(scope="module")
def discs():
    times = np.linspace(0.0, 5.0, 51)
    q, rates = [0.0, 0.0, 0.3, 0.4, 0.0], [1.2, 0.3, 4.0]
    return {
        speeds: kane.simulate(
            kane.rolling_disc(2.0, 0.5, (0.125, 0.25), speeds),
            kane.disc_state(q, rates, speeds),
            times,
            rtol=1e-12,
        )
        for speeds in kane.DISC_SPEEDS
    }


@pytest.mark.slow
def test_three_choices_of_speeds_are_one_disc(discs):
    """5 s, 350 steps of 1e-12, an unstable motion: some 1e-11."""
    plain, *others = (np.asarray(run.q) for run in discs.values())
    for other in others:
        np.testing.assert_allclose(other, plain, atol=1e-10)


def test_disc_keeps_its_energy(discs):
    one = jax.tree.map(lambda x: x[7], discs["body axes"].state)
    kinetic = kane.kinetic_energy(discs["body axes"].system, 0.0, one)
    np.testing.assert_allclose(discs["body axes"].kinetic_energy[7], kinetic, EXACT)
    for run in discs.values():
        energy = run.kinetic_energy + 2.0 * 9.81 * 0.5 * jnp.cos(run.q[:, 3])
        np.testing.assert_allclose(energy, energy[0], rtol=1e-11)  # 350 steps of 1e-12


def test_steady_precession_of_the_disc():
    """Moment balance about the contact point, disc upright at lean 0, heading rate p.

    The angular momentum A p cos(lean) along the disc's upper radius and (C + m r^2) w
    along its axle, w = spin' + p sin(lean), turn with the heading; for that the weight
    has to give p cos (A p sin - (C + m r^2) w) = m g r sin.
    """
    m, r, A, C, lean, p = 2.0, 0.5, 0.125, 0.25, 0.4, 3.0
    S, K = np.sin(lean), np.cos(lean)
    w = (A * p**2 * S * K - m * 9.81 * r * S) / ((C + m * r**2) * p * K)
    state = kane.disc_state([0.0, 0.0, 0.7, lean, 1.0], [p, 0.0, w - p * S])
    u_dot = kane.kane_derivative(kane.rolling_disc(m, r, (A, C)), 0.0, state).u
    np.testing.assert_allclose(u_dot, 0.0, atol=EXACT * p**2)


def test_reactions_of_a_pendulum_are_its_rod_force():
    """By an auxiliary speed along the rod: m (g cos q + L u^2)."""
    m, L, g = 0.8, 1.3, 9.81

    def velocity(t, q, u):
        along = jnp.stack([jnp.sin(q[0]), -jnp.cos(q[0])])
        across = jnp.stack([jnp.cos(q[0]), jnp.sin(q[0])])
        plane = L * u[0] * across + u[1] * along
        return jnp.concatenate([plane, jnp.zeros(1)])

    weight = kane.Load(velocity, lambda t, q, u: jnp.array([0.0, -m * g, 0.0]))
    system = kane.KaneSystem(
        1, 1, lambda t, q, u: u[:1], [kane.Particle(m, velocity)], [weight], auxiliary=1
    )
    state = kane.KaneState(jnp.array([0.6]), jnp.array([2.0]))
    pull = kane.reactions(system, 0.0, state)
    expected = -m * (g * np.cos(0.6) + L * 4.0)  # towards the hinge
    np.testing.assert_allclose(pull, [expected], rtol=EXACT)
    np.testing.assert_allclose(
        kane.kane_derivative(system, 0.0, state).u, [-g / L * np.sin(0.6)], rtol=EXACT
    )
