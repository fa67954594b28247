"""Steady motions and their stability against closed forms and linear equations."""

import jax
import numpy as np
import pytest

import rollkane as rk

G = 9.81
EDGEWISE = (np.sqrt(0.5), np.sqrt(0.5), 0.0, 0.0)  # the body's z axis along -y
UPRIGHT, ORIGIN = (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)


def wheel(share, a=0.3):
    """A rim with C = share m a^2, A = C / 2: hoop 1, disc 1/2."""
    inertia = share * a * a * np.diag([0.5, 0.5, 1.0])
    return rk.Scene(rk.Body(1.0, inertia, rk.DiscEdge(a)))


def rolling_straight(scene, speed):
    a = float(scene.body.surface.radius)
    return rk.place(scene, EDGEWISE, (0.0, speed / a, 0.0), ORIGIN)


@pytest.fixture(scope="module")
def disc():
    scene = wheel(0.5)
    start = rolling_straight(scene, 1.5)
    return scene, rk.steady_motion(scene, start, ("speed", "tilt"))


@pytest.mark.parametrize(("share", "part"), [(1.0, 0.25), (0.5, 1.0 / 3.0)])
def test_critical_speed_of_hoop_and_disc(share, part):
    """v^2 = g a / 4 and g a / 3."""
    scene = wheel(share)
    critical = np.sqrt(part * G * 0.3)
    motion = rk.steady_motion(
        scene, rolling_straight(scene, 1.5), {"speed": 1.5, "tilt": None}
    )
    assert motion.stable
    # the disc: translations, heading, turn of the wheel; speed and lean go on steadily
    assert list(motion.zeros) == [
        "translation x",
        "translation y",
        "turn about z",
        "spin about z",
        "family: speed",
        "family: tilt",
    ]
    assert motion.family == 2
    branch = rk.steady_family(scene, motion, "hold.speed", (0.3, 3.0), points=40)
    (found,) = branch.critical
    assert found.kind == "zero crossing"
    # the determinant's rounding, 1e-14 of its slope, and a root to rounding
    assert abs(found.value - critical) < 1e-12
    np.testing.assert_array_equal(branch.stable, branch.values > critical)
    # eigenvalues: s^2 = -(the critical one's law) k (v^2 - v_c^2)
    squares = np.array([p.eigenvalues[0] ** 2 for p in branch.points]).real
    law = np.polynomial.polynomial.polyfit(branch.values**2, squares, 1)
    line = np.polynomial.polynomial.polyval(branch.values**2, law)
    # of squares up to 60, from a matrix with some 1e2 roundings
    np.testing.assert_allclose(squares, line, rtol=0, atol=1e-10)


def circle(scene, lean, spin):
    """Rates of a disc that leans and turns steadily: precession by the quadratic."""
    a, m = float(scene.body.surface.radius), float(scene.body.mass)
    A, C = (float(scene.body.inertia[k, k]) for k in (0, 2))
    s, c = np.sin(lean), np.cos(lean)
    # moments about the centre: (C + m a^2) n W s - A W^2 s c + m g a c = 0, with
    # n = w . e3 and W the precession
    return np.roots([-A * s * c, (C + m * a * a) * spin * s, m * G * a * c])


def leaning(scene, lean, spin, precession):
    half = 0.5 * lean
    q = (np.cos(half), np.sin(half), 0.0, 0.0)
    axis = np.array([0.0, -np.sin(lean), np.cos(lean)])  # e3
    across = np.array([0.0, np.cos(lean), np.sin(lean)])  # up the disc's plane
    w = spin * axis + precession * np.sin(lean) * across
    return rk.place(scene, q, w, ORIGIN)


@pytest.mark.parametrize("root", [0, 1])
def test_steady_circles_of_a_leaning_disc(disc, root):
    scene, _ = disc
    lean, spin = 1.1, 9.0
    precession = np.sort(circle(scene, lean, spin))[root]
    guess = leaning(scene, lean + 0.02, spin, precession * 1.02)
    motion = rk.steady_motion(scene, guess, {"spin": spin, "tilt": lean})
    # Newton's method ends at rounding of numbers up to the fast root, 120
    assert abs(motion.generator["turn about z"] - precession) < 1e-11
    own = sorted(np.imag(list(motion.zeros.values())))
    # the centre of the circle turns with the frame: a pair of plus and minus i W
    np.testing.assert_allclose(own[0], -abs(precession), rtol=1e-12)
    np.testing.assert_allclose(own[-1], abs(precession), rtol=1e-12)
    np.testing.assert_allclose(own[1:-1], 0.0, rtol=0, atol=1e-9)


def test_a_steady_motion_goes_on_as_its_group_says(disc):
    scene, _ = disc
    precession = np.sort(circle(scene, 1.1, 9.0))[0]
    guess = leaning(scene, 1.1, 9.0, precession)
    motion = rk.steady_motion(scene, guess, ("spin", "tilt"))
    run = rk.simulate(scene, motion.state, (0.0, 0.7, 2.0), rtol=1e-11, atol=1e-13)
    for k, t in enumerate(run.time):
        expected, found = (
            rk.contact_of(scene, t, y)
            for y in (motion.at(t), jax.tree.map(lambda x, k=k: x[k], run.state))
        )
        # some 300 steps of 1e-11, in part along the orbit
        np.testing.assert_allclose(found.position, expected.position, atol=1e-8)
        np.testing.assert_allclose(found.rotation, expected.rotation, atol=1e-8)


def sleeping(scene, spin):
    return rk.place(scene, UPRIGHT, (0.0, 0.0, spin), ORIGIN)


def sleeping_roots(scene, height, radius, spin):
    """``(A + m h^2) mu^2 - (C + m h r) n mu + m g (h - r) = 0``, fixed axes."""
    m = float(scene.body.mass)
    A, C = (float(scene.body.inertia[k, k]) for k in (0, 2))
    return np.roots(
        [
            A + m * height**2,
            -(C + m * height * radius) * spin,
            m * G * (height - radius),
        ]
    ).astype(complex)


@pytest.fixture(scope="module")
def spheroid():
    a, c = 0.2, 0.3
    inertia = 0.2 * np.diag([a * a + c * c, a * a + c * c, 2.0 * a * a])
    return rk.Scene(rk.Body(1.0, inertia, rk.Ellipsoid((a, a, c))))


@pytest.fixture(scope="module")
def routh():
    body = rk.Body(1.0, np.diag([0.004, 0.004, 0.003]), rk.Sphere(0.1), (0, 0, 0.02))
    return rk.Scene(body)


@pytest.mark.parametrize(
    ("name", "height", "radius"),
    [
        ("spheroid", 0.3, 0.04 / 0.3),
        pytest.param("routh", 0.12, 0.1, marks=pytest.mark.slow),
    ],
)
def test_sleeping_tops(name, height, radius, request):
    """Eigenvalues i mu, and the threshold where both roots meet."""
    scene = request.getfixturevalue(name)
    m = float(scene.body.mass)
    A, C = (float(scene.body.inertia[k, k]) for k in (0, 2))
    threshold = (
        2.0
        * np.sqrt((A + m * height**2) * m * G * (height - radius))
        / (C + m * height * radius)
    )
    fast = 1.5 * threshold
    motion = rk.steady_motion(scene, sleeping(scene, fast), ("spin",))
    # what turns the state only as the other does: all by the spin
    assert abs(motion.generator["turn about z"]) < 1e-13 * fast
    assert motion.generator["spin about z"] == pytest.approx(-fast, rel=1e-14)
    roots = sleeping_roots(scene, height, radius, fast)
    expected = np.concatenate([1j * roots, -1j * roots.conj()])
    for value in expected:
        # some 1e2 roundings of a matrix of the size of the spin
        assert np.min(np.abs(motion.eigenvalues - value)) < 1e-12 * fast
    span = 0.5 * threshold, 2.0 * threshold
    branch = rk.steady_family(scene, motion, "hold.spin", span, points=40)
    (found,) = branch.critical
    assert found.kind == "collision"
    # a square of distance whose rounding is 1e-13 of its slope
    assert abs(found.value / threshold - 1.0) < 1e-11
    np.testing.assert_array_equal(branch.stable, branch.values > threshold)


def rattleback(skew):
    inertia = [[2e-4, -skew, 0.0], [-skew, 1.6e-3, 0.0], [0.0, 0.0, 1.7e-3]]
    return rk.Scene(
        rk.Body(1.0, inertia, rk.Ellipsoid((0.2, 0.03, 0.02)), (0.0, 0.0, -0.01))
    )


def rattleback_by_hand(scene, spin):
    """Linear equations about a steady spin, on body axes: tilt g and w, horizontal.

    ``g' = -w x g``, ``m (v' + w x v) = F - m g g``, ``I w' + w x I w = r x F`` with
    ``v = r x w`` and the contact point r from the mass centre where the normal is -g.
    """
    body = scene.body
    m, I = float(body.mass), np.asarray(body.inertia)
    a, b, c = np.asarray(body.surface.semi_axes)
    h = c + float(body.center_of_mass[2])
    J = np.array([[0.0, -1.0], [1.0, 0.0]])  # k x, in the plane
    R = np.diag([a * a / c, b * b / c])
    # g = k + x, w = n k + y (to first order), r = -h k - R x, F = m g k + f
    # x' = n (x across k) + y across k: -w x g
    x_by = [-spin * J, J]
    # v = r x w = -h k x y - n R x x k
    v_by = [spin * J @ R, -h * J]
    # f = m (v' + n k x v + g x): v' by the chain, y' unknown
    f_by_y_dot = m * v_by[1]
    f_by = [
        m * (v_by[0] @ x_by[k] + spin * J @ v_by[k])
        + (m * G * np.eye(2) if not k else 0)
        for k in range(2)
    ]
    # (r x F): -h k x f - R x x m g k
    own = I[:2, :2]
    left = own + h * J @ f_by_y_dot
    gyro = spin * (J @ own - I[2, 2] * J)  # w x I w, first order
    right = [-h * J @ f_by[0] + m * G * J @ R, -h * J @ f_by[1] - gyro]
    y_by = [np.linalg.solve(left, part) for part in right]
    return np.block([x_by, y_by])


@pytest.mark.parametrize("spin", [0.0, 5.0, -5.0])
def test_a_rattleback_rocks_and_grows(spheroid, spin):
    """Both frequencies, and the growth that tells the directions of spin apart."""
    scene = rattleback(2e-5)
    motion = rk.steady_motion(scene, sleeping(scene, spin), ("spin",))
    expected = np.linalg.eigvals(rattleback_by_hand(scene, spin))
    assert motion.eigenvalues.size == 4
    for value in expected:
        # some 1e2 roundings of a matrix of norm 1e3
        assert np.min(np.abs(motion.eigenvalues - value)) < 1e-10
    if spin:
        assert not motion.stable
        grows = expected[np.argmax(expected.real)]
        assert abs(motion.eigenvalues[0].real - grows.real) < 1e-10
    assert "family: spin" in motion.zeros or spin == 0.0


def test_refusals_name_ranks_and_directions(disc):
    scene, motion = disc
    guess = motion.state
    with pytest.raises(rk.FieldError, match="not left fixed by the symmetry 'transl"):
        rk.steady_motion(scene, guess, ("contact_on_base[0]",))
    with pytest.raises(rk.FieldError, match="a family of 2 dimensions, of which"):
        rk.steady_motion(scene, guess, ("speed", "tilt", "energy"))
    with pytest.raises(rk.FieldError, match=r"is no quantity.*did you mean 'speed'"):
        rk.steady_motion(scene, guess, ("sped",))
    with pytest.raises(rk.FieldError, match="none with these values"):
        rk.steady_motion(scene, guess, {"energy": -5.0})
    loose = rk.steady_motion(scene, guess, ("speed",))
    with pytest.raises(rk.FieldError, match="leaves a family of 2 dimensions free"):
        rk.steady_family(scene, loose, "body.mass", (0.5, 2.0))
    with pytest.raises(rk.FieldError, match="is nothing that can be varied"):
        rk.steady_family(scene, motion, "body.mas", (0.5, 2.0))
    with pytest.raises(rk.FieldError, match="does not hold the motion's own value"):
        rk.steady_family(scene, motion, "hold.speed", (2.0, 3.0))
    with pytest.raises(rk.FieldError, match="no range"):
        rk.steady_family(scene, motion, "hold.speed", (3.0, 2.0))


def test_a_slope_has_no_steady_motion():
    scene = rk.Scene(
        rk.Body(1.0, 0.4 * 0.01 * np.eye(3), rk.Sphere(0.1)),
        loads=rk.Gravity((1.0, 0.0, -9.0)),
    )
    guess = rk.place(scene, UPRIGHT, (0.0, 1.0, 0.0), ORIGIN)
    with pytest.raises(rk.FieldError, match=r"no steady motion near it; of 8 rates"):
        rk.steady_motion(scene, guess)
