"""Relative periodic motions: closed forms, Floquet multipliers, families, refusals."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import ellipk

import rollkane as rk
from rollkane.files.scene_files import load_scene
from rollkane.stability.floquet import floquet
from rollkane.stability.independent_coordinates import IndependentCoordinates
from rollkane.stability.variational import divergence

G, r, R = 9.81, 0.1, 1.0
STILL = (0.0, 0.0, 0.0)
UPRIGHT = (1.0, 0.0, 0.0, 0.0)
BALL = rk.Body(1.0, 0.4 * r * r * np.eye(3), rk.Sphere(r))
BOWL = rk.Scene(BALL, rk.Base(rk.Sphere(R, inside=True)))


def pendulum_period(energy):
    """Of a homogeneous ball that rolls in a plane through the bottom of a bowl.

    A pendulum of length 7 (R - r) / 5, by the complete elliptic integral of the angle
    that the energy (1 kg) reaches.
    """
    reach = 0.5 * (energy / (G * (R - r)) + 1.0)
    return 4.0 * np.sqrt(7.0 * (R - r) / (5.0 * G)) * ellipk(reach)


def height(x, y, p):
    return 0.5 * (p["a"] * x**2 + p["b"] * y**2)


def two_bowls(a, b):
    return rk.Scene(BALL, rk.Base(rk.Graph(height, {"a": a, "b": b})))


def rate(curvature):
    """``omega^2`` of small vibrations where the base has a curvature [1/m]."""
    return 5.0 * G / 7.0 * curvature / (1.0 - curvature * r)


@pytest.fixture(scope="module")
def swing():
    rest = rk.place(BOWL, UPRIGHT, STILL, (0.0, 0.0, -R))
    return rk.normal_mode_motion(BOWL, rest, 0.1)


@pytest.mark.parametrize("angle", [0.3, 0.9, 1.5])
def test_pendulum_in_a_bowl(swing, angle):
    """From a guess with a wrong period, at the energy of the guess."""
    del swing  # the same compiled programs
    place = R * np.sin(angle), 0.0, -R * np.cos(angle)
    start = rk.place(BOWL, UPRIGHT, STILL, place)
    expected = pendulum_period(-G * (R - r) * np.cos(angle))
    found = rk.periodic_motion(BOWL, start, 1.02 * expected, hold={"energy": None})
    # runs at rtol 1e-12 of some 1e2 steps
    assert found.period == pytest.approx(expected, rel=1e-10)
    assert found.energy == pytest.approx(-G * (R - r) * np.cos(angle), rel=1e-12)
    np.testing.assert_allclose(list(found.group.values()), 0.0, atol=1e-9)


def test_a_family_from_a_normal_mode_to_large_amplitude(swing):
    most = G * (R - r)
    found = rk.periodic_family(BOWL, swing, "energy", (-1.1 * most, 0.98 * most))
    # from near the rest, where the way ends, to 169 degrees (rolling is bilateral)
    assert found.ends == ("steady motion", "span")
    number, ends = str(found).splitlines()
    assert number.startswith(f"{len(found.points)} periodic motions, energy from ")
    assert ends == "  begins: steady motion; ends: span"
    energies = found.along("energy")
    assert energies[-1] == pytest.approx(0.98 * most, rel=1e-12)
    assert energies[0] < -0.999 * most
    assert len(found.points) > 40
    # as above; near the top a rounding of the energy counts 1 / (1 - reach) = 100 times
    np.testing.assert_allclose(found.periods, pendulum_period(energies), rtol=1e-10)
    assert found.stable.all()
    assert not found.critical
    # all of them are expected: four symmetries, the flow, energy; the directions of
    # motions that go round, two more: the turn about the vertical and the ball's spin
    for point in found.points[::10]:
        assert point.multipliers.size == 0
        assert sorted(point.expected[-3:]) == ["energy", "family", "family"]
        assert point.volume_ratio == pytest.approx(1.0, abs=1e-8)


@pytest.mark.slow  # in part by the example of docs/periodic.md
def bob(alpha):
    return jnp.stack([alpha[0], 0.0 * alpha[0], 0.0 * alpha[0] - 0.02])[None]


def spring(alpha, stiffness):
    return 0.5 * stiffness * alpha[0] ** 2


@pytest.mark.slow
def test_slow_modes_beside_a_fast_one():
    """A bob h above the contact, d below the middle, that a stiff spring holds there.

    Of the tilts: ``omega^2 = g ((1 + m) c r^2 + m d) / (1.4 r^2 + m h^2)``, with the
    curvature c of the middle's path; of the bob against a ball that gives way:
    ``omega^2 = rate^2 (1 + m h^2 / (1.4 r^2))``.
    """
    stiff = 0.3 * 1e5**2
    inside = rk.PointMasses(
        [0.3], bob, potential=spring, parameters=stiff, coordinates=1
    )
    ball = rk.Body(1.0, 0.4 * r * r * np.eye(3), rk.Sphere(r))
    base = rk.Base(rk.Graph(height, {"a": 1.0, "b": 1.3}))
    scene = rk.Scene(ball, base, supported=inside)
    at = rk.place(scene, UPRIGHT, STILL, STILL, alpha=[0.0], alpha_dot=[0.0])
    found = rk.normal_modes(scene, at).frequencies
    assert found.size == 3
    m, d, h = 0.3, 0.02, 0.08
    path = np.array([1.0 / (1.0 - r), 1.3 / (1.0 - 1.3 * r)])
    own = 1.4 * r**2
    slow = np.sqrt(G * ((1.0 + m) * path * r**2 + m * d) / (own + m * h**2))
    fast = 1e5 * np.sqrt(1.0 + m * h**2 / own)
    # the spring gives way by (slow / fast)^2 = 2e-9, times ratios of masses up to 1e2
    np.testing.assert_allclose(found, [*slow, fast], rtol=2e-7)


@pytest.mark.slow
def test_swings_of_similar_balls_are_similar():
    """Froude's law: of lengths L times go as the root of L, and multipliers stay."""
    found = []
    for L in (1.0, 1e-5):
        inertia = 0.4 * (0.1 * L) ** 2 * np.eye(3)
        ball = rk.Body(1.0, inertia, rk.Sphere(0.1 * L))
        bowl = rk.Graph(height, {"a": 1.0 / L, "b": 1.7 / L})
        scene = rk.Scene(ball, rk.Base(bowl))
        rest = rk.place(scene, UPRIGHT, STILL, STILL)
        motion = rk.normal_mode_motion(scene, rest, 0.5, mode=1)  # half a radian
        found.append((motion.period / np.sqrt(L), motion.multipliers))
    # runs at rtol 1e-12 of some 1e2 steps
    assert found[1][0] == pytest.approx(found[0][0], rel=1e-10)
    np.testing.assert_allclose(found[1][1], found[0][1], atol=1e-8)


def test_a_family_goes_to_its_span_s_end_beside_the_rest():
    """The end lies between the last step and the rest that it would pass."""
    low, high = (-G * (R - r) * np.cos(angle) for angle in (0.02, 0.7))
    place = R * np.sin(0.6), 0.0, -R * np.cos(0.6)
    start = rk.place(BOWL, UPRIGHT, STILL, place)
    swing = rk.periodic_motion(BOWL, start, 2.3, hold={"energy": None})
    family = rk.periodic_family(BOWL, swing, "energy", (low, high), points=8)
    assert family.ends[0] == "span"
    assert family.values[0] == pytest.approx(low, rel=1e-12)


@pytest.mark.slow
def test_a_guess_that_leads_to_no_numbers_is_refused():
    """A millimetre ball 20 m up the side of a wide bowl, whose equations overflow."""
    size = 1e-3
    ball = rk.Body(1.0, 0.4 * size**2 * np.eye(3), rk.Sphere(size))
    scene = rk.Scene(ball, rk.Base(rk.Graph(height, {"a": 1e-3, "b": 1.7e-3})))
    far = 20.0
    start = rk.place(scene, UPRIGHT, STILL, (0.0, far, 0.85e-3 * far**2))
    guess = 2.0 * np.pi / np.sqrt(5.0 / 7.0 * G * 1.7e-3)
    try:
        found = rk.periodic_motion(scene, start, guess, hold={"energy": None})
    except rk.FieldError:
        return
    assert found.period == pytest.approx(guess, rel=1e-2)  # nearly harmonic


def test_multipliers_of_small_swings():
    """Of the motion along y, in x: ``exp(+-2 pi i omega_x / omega_y)``."""
    a, b, small = 1.0, 1.7, 1e-3
    for x_curvature in (a, -a):
        scene = two_bowls(x_curvature, b)
        start = rk.place(
            scene, UPRIGHT, STILL, (0.0, small, height(0, small, {"a": 0, "b": b}))
        )
        period = 2.0 * np.pi / np.sqrt(rate(b))
        expected = np.exp(1j * np.emath.sqrt(rate(x_curvature)) * period)
        for segments in (1, 3):
            found = rk.periodic_motion(
                scene, start, period, hold={"energy": None}, segments=segments
            )
            assert found.stable == (x_curvature > 0.0)
            # of order (amplitude curvature)^2 of exponents up to 4.2
            for value in (expected, 1.0 / expected):
                near = np.min(np.abs(found.multipliers / value - 1.0))
                assert near < 2e-5
            assert found.multipliers.size == 2
            # a homogeneous ball keeps a measure; det of entries to 65, runs to 1e-10
            assert found.volume_ratio == pytest.approx(1.0, abs=1e-8)
            names = {"spin about x", "spin about y", "spin about z", "flow"}
            assert set(found.expected[:4]) == names
            assert found.expected[4:] == ("energy", "family")


@pytest.mark.slow  # in part by the example of docs/periodic.md
def test_a_swing_that_loses_its_stability():
    """The multiplier by differences of runs, and where it leaves the unit circle."""
    scene = two_bowls(1.0, 1.7)
    rest = rk.place(scene, UPRIGHT, STILL, STILL)
    modes = rk.normal_modes(scene, rest)
    # frequencies are eigenvalues of a matrix of order 10
    np.testing.assert_allclose(
        modes.frequencies, np.sqrt([rate(1.0), rate(1.7)]), rtol=1e-10
    )
    along_y = rk.normal_mode_motion(scene, rest, 1.0, mode=1)
    found = rk.periodic_family(
        scene, along_y, "energy", (along_y.energy, 4.0), points=12
    )
    (critical,) = found.critical
    assert critical.kind == "one"
    for shift, stays in ((-1e-4, True), (1e-4, False)):
        energy = critical.value + shift
        near = rk.periodic_motion(
            scene,
            critical.motion.state,
            critical.motion.period,
            hold={"energy": energy},
        )
        assert near.stable == stays
    # at a collision of two multipliers, mu - 1 is the root of the distance: 1e-8 of the
    # span, some 3e-8 J, with a slope of order one
    assert abs(critical.multiplier - 1.0) < 1e-3
    last = found.points[-1]
    assert not last.stable
    assert found.points[0].stable
    around = IndependentCoordinates(scene, jnp.zeros(()), last.state)
    values, vectors = np.linalg.eig(last.monodromy)
    k = int(np.argmax(np.abs(values)))
    assert abs(values[k] - last.multipliers[0]) < 1e-6
    direction = np.real(vectors[:, k]) * 1e-5

    @jax.jit
    def returned(x):
        times = jnp.array([0.0, last.period])
        run = rk.simulate(scene, around.state(x), times, rtol=1e-12)
        moved = rk.symmetries(scene).moved(run.final_state, steps)
        return around.coordinates(moved)

    steps = -np.array(list(last.group.values()))
    ahead, behind = (np.asarray(returned(s * direction)) for s in (1.0, -1.0))
    # third order: (1e-5)^2 times 1e3; roundings 1e-11 over 1e-5
    np.testing.assert_allclose(
        (ahead - behind) / 2.0, last.multipliers[0].real * direction, atol=1e-5 * 1e-5
    )


@pytest.mark.slow
def test_a_rolling_discs_nutation():
    """A relative periodic motion, by another integrator: it comes back moved."""
    known = load_scene("rolling-disc")
    found = rk.periodic_motion(known.scene, known.start, 0.6)
    assert found.stable
    assert found.multipliers.size == 0
    group = rk.symmetries(known.scene)
    assert set(found.expected) == {*group.names, "flow", "energy", "family"}
    run = rk.simulate(
        known.scene,
        found.state,
        np.linspace(0.0, 2.0 * found.period, 101),
        rtol=1e-12,
        method="diffrax",
    )
    # the disc leans alike, and alike fast, after a period; 1e-12 in 1e3 steps
    np.testing.assert_allclose(
        run.position[50:, 2], run.position[:51, 2], rtol=0, atol=1e-9
    )
    middle = jax.tree.map(lambda leaf: leaf[50], run.state)
    moved = group.moved(found.state, np.array(list(found.group.values())))
    sign = np.sign(moved.orientation @ middle.orientation)
    for name in ("angular_velocity", "contact_on_base"):
        np.testing.assert_allclose(
            getattr(middle, name), getattr(moved, name), rtol=0, atol=1e-8
        )
    np.testing.assert_allclose(
        sign * middle.orientation, moved.orientation, rtol=0, atol=1e-8
    )


@pytest.mark.slow
def test_a_shaken_and_damped_swing():
    """Isolated; its multipliers' product is the exponential of the divergence."""
    rate_, far = 2.0, 0.02
    shaken = rk.BaseMotion(
        lambda t: jnp.stack([far * jnp.cos(rate_ * t), 0.0 * t, 0.0 * t]),
        lambda t: jnp.eye(3),
    )
    c = 0.02
    losses = rk.RollingResistance(viscous=c), rk.SpinningResistance(viscous=c)
    scene = rk.Scene(
        BALL, rk.Base(rk.Sphere(R, inside=True), shaken), loads=(rk.Gravity(), *losses)
    )
    start = rk.place(scene, UPRIGHT, STILL, (0.02, 0.0, -np.sqrt(R * R - 0.02**2)))
    period = 2.0 * np.pi / rate_
    found = rk.periodic_motion(scene, start, period)
    assert found.period == period
    assert found.stable
    assert "family" not in found.expected
    nodes, weights = np.polynomial.legendre.leggauss(24)
    times = jnp.asarray([0.0, *(0.5 * period * (nodes + 1.0)), period])
    run = rk.simulate(scene, found.state, times, rtol=1e-12)
    inside = jax.tree.map(lambda leaf: leaf[1:-1], run.state)
    rates = jax.vmap(lambda t, s: divergence(scene, t, s))(times[1:-1], inside)
    integral = 0.5 * period * float(weights @ np.asarray(rates))
    assert integral < -1.0
    # a smooth integrand; relative errors of the multipliers 1e-9 each
    assert np.log(found.volume_ratio) == pytest.approx(integral, abs=1e-6)
    with pytest.raises(rk.FieldError, match="period: is not one of the scene"):
        rk.periodic_motion(scene, start, 1.01 * period)


def test_a_rest_repeats_only_after_the_period_of_what_shakes_it():
    """It does not move, whatever the time; what is beside it does."""
    rate_, bowl = 9.0, rk.Graph(lambda x, y: 0.75 * x * x + 1.25 * y * y)
    shaken = rk.BaseMotion(
        lambda t: jnp.stack([0.0 * t, 0.0 * t, 0.05 * jnp.cos(rate_ * t)])
    )
    scene = rk.Scene(BALL, rk.Base(bowl, shaken))
    for spin in (STILL, (0.0, 0.0, 3.0)):
        start = rk.place(scene, UPRIGHT, spin, STILL)
        for period in (0.65, 1.0):
            with pytest.raises(rk.FieldError, match="period: is not one of the scene"):
                rk.periodic_motion(scene, start, period)


@pytest.mark.slow
def test_a_slow_growth_is_no_family():
    """Of an ellipsoid in a bowl, which may rest with any yaw; its swings turn it.

    A multiplier within 0.2 of one, in a block with shears of order one, whose smallest
    singular value is that of its square: the energy of a yaw is of second order.
    """
    known = load_scene("ellipsoid-in-bowl")
    rest = rk.place(known.scene, UPRIGHT, STILL, STILL)
    found = rk.normal_mode_motion(known.scene, rest, 0.2)
    assert not found.stable
    largest = found.multipliers[0]
    assert 1.0 < largest.real < 1.5
    # with its inverse: the swing is reversible
    assert np.min(np.abs(found.multipliers * largest - 1.0)) < 1e-6
    # followed by runs alone: a small yaw grows by this factor in each period
    around = IndependentCoordinates(known.scene, jnp.zeros(()), found.state)
    values, vectors = np.linalg.eig(found.monodromy)
    k = int(np.argmin(np.abs(values - largest)))
    x = 1e-6 * np.real(vectors[:, k])
    times = np.array([0.0, found.period])
    run = rk.simulate(known.scene, around.state(jnp.asarray(x)), times, rtol=1e-12)
    # second order: 1e-6 times 1e2, over the factor's distance from one
    grown = np.asarray(around.coordinates(run.final_state))
    assert (grown @ x) / (x @ x) == pytest.approx(largest.real, rel=1e-3)


def test_expected_multipliers_are_split_off_jordan_blocks():
    """A flow with an energy's shear, a family's block, and two pairs to be told."""
    draw = np.random.default_rng(3)
    told = np.array([2.0, 0.5, np.exp(1.1j), np.exp(-1.1j)])
    turn = np.array([[np.cos(1.1), -np.sin(1.1)], [np.sin(1.1), np.cos(1.1)]])
    blocks = np.zeros((8, 8))
    blocks[:2, :2] = [[1.0, 3.0], [0.0, 1.0]]  # flow; energy
    blocks[2:4, 2:4] = [[1.0, -2.0], [0.0, 1.0]]  # a family of two dimensions
    blocks[4:6, 4:6] = np.diag([2.0, 0.5])
    blocks[6:, 6:] = turn
    basis = np.linalg.qr(draw.standard_normal((8, 8)))[0] + 0.1 * np.eye(8)
    inverse = np.linalg.inv(basis)
    matrix = basis @ blocks @ inverse
    found = floquet(matrix, ("flow",), basis[:, :1].T, ("energy",), inverse[1:2])
    assert found.expected == ("flow", "energy", "family", "family")
    # an orthogonal basis but for a tenth: conditions of order ten
    for value in told:
        assert np.min(np.abs(found.multipliers - value)) < 1e-12
    assert found.multipliers.size == 4
    # eigenvalues alone would be scattered by the root of the rounding
    scattered = np.sort(np.abs(np.linalg.eigvals(matrix) - 1.0))[:4]
    assert scattered.max() > 1e-10


def test_refusals(swing):
    rest = rk.place(BOWL, UPRIGHT, STILL, (0.0, 0.0, -R))
    high = rk.place(BOWL, UPRIGHT, STILL, (np.sin(0.5), 0.0, -np.cos(0.5)))
    fast = rk.place(BOWL, UPRIGHT, (0.0, 1.0, 1.0), (0.0, 0.0, -R))
    for guess, period, keywords, said in (
        (rest, 2.0, {}, "guess: leads to a steady motion"),
        (high, -2.0, {}, "period: must be positive"),
        (high, 2.0, {"hold": {"colour": 1.0}}, "'colour'.: is not known.*'energy'"),
        (high, 2.0, {"hold": {"energy": "much"}}, "must be made of numbers"),
        (high, 2.0, {"hold": 3}, "hold: is no name of a quantity"),
        (fast, 2.0, {"hold": {"spin": None}}, "'spin'.: is not left as it is"),
        (high, 2.0, {"segments": 0}, "segments: must be a whole number"),
        (
            swing.state,
            swing.period,
            {"hold": {"energy": 0.0, "period": swing.period}},
            "no periodic motion.*energy = 0, period = 2.2.*rank",
        ),
    ):
        with pytest.raises(rk.FieldError, match=said):
            rk.periodic_motion(BOWL, guess, period, **keywords)
    single = jax.tree.map(lambda leaf: leaf.astype(np.float32), high)
    with pytest.raises(rk.FieldError, match="single precision"):
        rk.periodic_motion(
            jax.tree.map(lambda x: x.astype(np.float32), BOWL), single, 2.0
        )
    with pytest.raises(rk.FieldError, match="does not stay at rest"):
        rk.normal_modes(BOWL, high)
    with pytest.raises(rk.FieldError, match="mode: is not one of the 2"):
        rk.normal_mode_motion(BOWL, rest, 0.1, mode=2)
    with pytest.raises(rk.FieldError, match="span: does not hold"):
        rk.periodic_family(BOWL, swing, "energy", (0.0, 1.0))
    heavier = eqx.tree_at(lambda s: s.body.mass, BOWL, 2.0 * BOWL.body.mass)
    with pytest.raises(rk.FieldError, match="is not the scene of the motion"):
        rk.periodic_family(heavier, swing, "energy", (-1.0, 1.0))
