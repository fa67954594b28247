"""Laws that break a symmetry far from the origin, or in a narrow place, are seen.

Of the linear model about a rest all is known in closed form: a homogeneous ball rolls
with 7/5 of its mass under the forces of a potential.
"""

import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk
from rollkane.stability.symmetries import symmetries_at

BALL = rk.Body(1.0, 0.004 * np.eye(3), rk.Sphere(0.1))
UPRIGHT, STILL = (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
FLAT = {"translation x", "translation y", "turn about z"}
# Newton's method ends at 1e-10 of a step; eigenvalues are as exact
EXACT = 1e-8


def rest(scene, *place, **carried):
    return rk.place(scene, UPRIGHT, STILL, place, **carried)


def magnet(X, width, strength, across=1.0):
    """A hill of energy at (X, 0), or a ridge along y where nothing acts across."""

    def energy(p, q):
        square = (p[0] - q["X"]) ** 2 + q["across"] * p[1] ** 2
        return q["A"] * jnp.exp(-square / q["w"] ** 2)

    numbers = {"X": X, "w": width, "A": strength, "across": across}
    loads = rk.Gravity(), rk.Potential(energy, parameters=numbers)
    return rk.Scene(BALL, loads=loads)


@pytest.mark.parametrize(
    ("X", "width", "strength"), [(3.0, 0.2, 0.5), (0.0, 0.05, 1e-3), (0.0, 5e-3, 1e-3)]
)
def test_a_ball_on_a_magnet_that_repels_it_falls_off(X, width, strength):
    scene = magnet(X, width, strength)
    motion = rk.steady_motion(scene, rest(scene, X, 0.0, 0.0))
    growth = np.sqrt(10.0 / 7.0 * strength) / width
    assert not motion.stable
    np.testing.assert_allclose(np.real(motion.eigenvalues[:2]), growth, rtol=EXACT)
    assert not motion.energy_sign.definite
    # it is symmetric under turns about the magnet, and about nothing else
    names = set(motion.generator)
    assert not FLAT - {"turn about z"} & names
    assert sum("turn about z" in name for name in names) == 1


def test_a_ridge_leaves_its_own_direction():
    scene = magnet(3.0, 0.2, 0.5, across=0.0)
    motion = rk.steady_motion(scene, rest(scene, 3.0, 0.0, 0.0))
    assert FLAT & set(motion.generator) == {"translation y"}
    assert np.sum(np.real(motion.eigenvalues) > EXACT) == 1


def test_a_family_that_loses_its_symmetries_is_refused():
    """Without the magnet all places are alike; with it, they are not."""
    scene = magnet(3.0, 0.2, 0.0)
    hold = {"translation x": 0.0, "translation y": 0.0, "spin about z": 0.0}
    motion = rk.steady_motion(scene, rest(scene, 3.0, 0.0, 0.0), hold)
    with pytest.raises(rk.FieldError, match=r"no symmetry 'translation x'"):
        rk.steady_family(scene, motion, "loads[1].parameters.A", (0.0, 0.5), points=2)


def wall(X):
    def energy(p, q):
        return 50.0 * jnp.maximum(p[0] - q["X"], 0.0) ** 2

    push = rk.Potential(energy, parameters={"X": X})
    return rk.Scene(BALL, loads=(rk.Gravity((1.0, 0.0, -9.81)), push))


def test_a_ball_leans_on_a_wall_far_off():
    scene = wall(50.0)
    state = rest(scene, 50.01, 0.0, 0.0)
    rate = np.sqrt(5.0 / 7.0 * 100.0)
    modes = rk.normal_modes(scene, state)
    np.testing.assert_allclose(modes.frequencies, [rate], rtol=EXACT)
    motion = rk.normal_mode_motion(scene, state, 1e-3)
    assert "translation x" not in motion.group
    assert "translation y" in motion.group
    # of a linear force, up to the error of the runs
    np.testing.assert_allclose(motion.period, 2.0 * np.pi / rate, rtol=EXACT)


def test_symmetries_hold_near_all_given_states():
    scene = wall(50.0)
    near, far = rest(scene, 0.0, 0.0, 0.0), rest(scene, 50.01, 0.0, 0.0)
    assert "translation x" in rk.symmetries(scene, near)
    assert "translation x" not in rk.symmetries(scene, far)
    stacked = rk.State(
        *(np.stack(pair) for pair in zip(*map(_numbers, (near, far)), strict=True))
    )
    found = symmetries_at(scene, np.zeros(2), stacked)
    assert "translation x" not in found
    assert "translation y" in found


def orbit(rho, strength):
    """Of a ball round a bowl, z = rho^2 / 2, with a magnet on the other side of it.

    A point on a path of radius c at the slope rho is held by g rho; the ball spins
    about no axis but that of its path.
    """

    def energy(p, q):
        square = (p[0] + q["c"]) ** 2 + p[1] ** 2
        return q["A"] * jnp.exp(-square / 0.03**2)

    normal = np.array([-rho, 0.0, 1.0]) / np.hypot(1.0, rho)
    c = rho + 0.1 * normal[0]
    magnet_ = rk.Potential(energy, parameters={"A": strength, "c": c})
    bowl = rk.Graph(lambda x, y: 0.5 * (x * x + y * y))
    scene = rk.Scene(BALL, rk.Base(bowl), loads=(rk.Gravity(), magnet_))
    w = np.cross(normal, [0.0, np.sqrt(9.81 * rho * c), 0.0]) / 0.1
    return scene, rk.place(scene, UPRIGHT, tuple(w), (rho, 0.0, 0.5 * rho**2))


@pytest.mark.slow
def test_an_orbit_round_a_bowl_is_found():
    """From the guess that the next test takes; it turns by 2.8 rad/s or so."""
    scene, start = orbit(0.5, 0.0)
    motion = rk.steady_motion(scene, start)
    assert motion.generator["turn about z"] == pytest.approx(2.8, rel=0.1)
    assert motion.stable


def test_an_orbit_through_a_magnet_on_its_other_side_is_none():
    """Runs meet it after half a turn; without the symmetry there is no orbit."""
    scene, start = orbit(0.5, 0.5)
    assert "turn about z" in rk.symmetries(scene, start)
    with pytest.raises(rk.FieldError, match="has no steady motion near it"):
        rk.steady_motion(scene, start)


def _numbers(state):
    names = "orientation", "angular_velocity", "contact_on_base", "contact_on_body"
    return [getattr(state, name) for name in (*names, "alpha", "alpha_dot")]


@pytest.mark.slow
def test_a_hump_outside_of_a_graph_s_samples():
    def hump(x, y, p):
        return 1e-3 * jnp.exp(-((x - p["x"]) ** 2 + y**2) / 0.01)

    scene = rk.Scene(BALL, rk.Base(rk.Graph(hump, {"x": 2.0})))
    state = rest(scene, 2.0, 0.0, 1e-3)
    motion = rk.steady_motion(scene, state)
    # the centre goes on a sphere whose curvature is k / (1 + r k)
    k = 0.2
    growth = np.sqrt(5.0 / 7.0 * 9.81 * k / (1.0 + 0.1 * k))
    assert not motion.stable
    np.testing.assert_allclose(np.real(motion.eigenvalues[:2]), growth, rtol=EXACT)
    zeros = rk.lyapunov_exponents(scene, state, 0.1).zeros
    assert not {"translation x", "translation y"} & set(zeros)


@pytest.mark.parametrize("depth", [0.01, pytest.param(0.0, marks=pytest.mark.slow)])
def test_a_detent_of_a_rotor(depth):
    """Which is 10 mrad wide; of no depth, it is none, and the rotor turns freely."""
    mass = rk.SupportedBody(
        0.1,
        1e-4 * np.eye(3),
        lambda a: jnp.zeros(3) + 0.0 * a[0],
        lambda a: jnp.array(
            [
                [jnp.cos(a[0]), -jnp.sin(a[0]), 0.0],
                [jnp.sin(a[0]), jnp.cos(a[0]), 0.0],
                [0.0, 0.0, 1.0],
            ]
        ),
        potential=lambda a, q: -q["depth"] * jnp.exp(-((a[0] / 0.01) ** 2)),
        parameters={"depth": depth},
    )
    scene = rk.Scene(BALL, supported=mass)
    state = rest(scene, 0.0, 0.0, 0.0, alpha=[0.0], alpha_dot=[0.0])
    modes = rk.normal_modes(scene, state)
    assert ("alpha[0]" in rk.symmetries(scene, state)) == (depth == 0.0)
    # stiffness 2 depth / 0.01^2, against the rotor and the ball that turns back
    inertia = 1.0 / (1.0 / 1e-4 + 1.0 / 0.004)
    rates = [np.sqrt(2.0 * depth / 1e-4 / inertia)] if depth else []
    np.testing.assert_allclose(modes.frequencies, rates, rtol=EXACT)


def test_a_saddle_far_off_has_its_multipliers():
    def energy(p, q):
        x, y = p[0] - q["X"], p[1]
        fades = jnp.exp(-(((x**2 + y**2) / 0.25) ** 4))
        return 2.0 * (x**2 - 0.2 * y**2) * fades

    hill = rk.Potential(energy, parameters={"X": 30.0})
    scene = rk.Scene(BALL, loads=(rk.Gravity(), hill))
    period = 2.0 * np.pi / np.sqrt(20.0 / 7.0)
    motion = rk.periodic_motion(scene, rest(scene, 30.05, 0.0, 0.0), period)
    growth = np.exp(np.sqrt(4.0 / 7.0) * period)
    assert not motion.stable
    assert not FLAT & set(motion.group)
    # the hill fades by (0.05^2 / 0.25)^4 = 1e-8 at the turning points
    wanted = [growth, 1.0 / growth]
    np.testing.assert_allclose(np.real(motion.multipliers), wanted, rtol=1e-6)


def bob(radius):
    def place(a, p):
        down = p["R"] - jnp.sqrt(p["R"] ** 2 - a[0] ** 2)
        return jnp.stack([a[0], 0.0 * a[0], down - 0.05])[None]

    mass = rk.PointMasses([0.3], place, parameters={"R": radius})
    return rk.Scene(rk.Body(1.0, 0.006 * np.eye(3), rk.Sphere(0.1)), supported=mass)


def test_a_short_rail_on_which_no_random_state_is():
    """Where a slider at a metre has no place, not time but that is to blame."""
    scene = bob(0.02)
    with pytest.raises(rk.FieldError, match=r"none of 16 random states.*give a state"):
        rk.symmetries(scene)
    state = rest(scene, 0.0, 0.0, 0.0, alpha=[0.0], alpha_dot=[0.0])
    motion = rk.steady_motion(scene, state)
    assert set(motion.generator) >= FLAT
    assert motion.stable
    # coupled by the tilt, and rocking across the rail alone
    arm, total = 0.05, 0.006 + 0.01 + 0.3 * 0.05**2
    M = np.array([[total, 0.3 * arm], [0.3 * arm, 0.3]])
    K = 0.3 * 9.81 * np.array([[arm, -1.0], [-1.0, 1.0 / 0.02]])
    squares = [*np.linalg.eigvals(np.linalg.solve(M, K)), K[0, 0] / total]
    told = np.sort(np.abs(np.imag(motion.eigenvalues)))[::2]
    np.testing.assert_allclose(told, np.sqrt(np.sort(squares)), rtol=EXACT)


def test_a_state_without_finite_rates_is_refused():
    scene = bob(0.02)
    state = rest(scene, 0.0, 0.0, 0.0, alpha=[0.0], alpha_dot=[0.0])
    lost = rk.State(*_numbers(state)[:-2], jnp.asarray([9.0]), state.alpha_dot)
    with pytest.raises(rk.FieldError, match=r"symmetries\.state: has no finite rates"):
        rk.symmetries(scene, lost)
