"""Steady motions and their stability against closed forms and linear equations."""

import jax
import jax.numpy as jnp
import jax.scipy.linalg
import numpy as np
import pytest

import rollkane as rk
from rollkane.files.scene_files import load_scene
from rollkane.stability.independent_coordinates import independent_coordinates

from ..quick import slow_but

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


@pytest.mark.slow
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


@pytest.mark.parametrize("hold", [("turn about z",), {"turn about z": None}])
def test_a_group_velocity_without_a_value_is_the_guess_s(hold):
    scene = rk.Scene(rk.Body(1.0, np.diag([2e-3, 3e-3, 4e-3]), rk.Sphere(0.1)))
    guess = rk.place(scene, UPRIGHT, (0.0, 0.0, 20.0), ORIGIN)
    motion = rk.steady_motion(scene, guess, hold)
    assert motion.held == {"turn about z": pytest.approx(20.0, rel=1e-12)}
    assert float(motion.state.angular_velocity[2]) == pytest.approx(20.0, rel=1e-12)


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
    for unnamed in (3, (3,), {3: 1.0}):
        with pytest.raises(rk.FieldError, match="hold: is no name of a quantity"):
            rk.steady_motion(scene, guess, unnamed)
    loose = rk.steady_motion(scene, guess)
    with pytest.raises(rk.FieldError, match="leaves a family of 2 dimensions free"):
        rk.steady_family(scene, loose, "hold.speed", (0.5, 2.0))
    with pytest.raises(rk.FieldError, match="is nothing that can be varied"):
        rk.steady_family(scene, motion, "body.mas", (0.5, 2.0))
    with pytest.raises(rk.FieldError, match="does not hold the motion's own value"):
        rk.steady_family(scene, motion, "hold.speed", (2.0, 3.0))
    with pytest.raises(rk.FieldError, match="no range"):
        rk.steady_family(scene, motion, "hold.speed", (3.0, 2.0))
    for count in ({"points": 0}, {"points": 2.5}, {"max_points": -1}):
        with pytest.raises(rk.FieldError, match=r"steady_family\..*points"):
            rk.steady_family(scene, motion, "hold.speed", (0.5, 2.0), **count)
    other = wheel(0.6)
    with pytest.raises(rk.FieldError, match="is not the scene of the motion"):
        rk.steady_family(other, motion, "hold.speed", (0.5, 2.0))
    with pytest.raises(rk.FieldError, match="is not the scene of the motion"):
        rk.linearize(other, motion)


def test_a_crossing_from_which_no_other_branch_leaves(disc):
    """Straight rolling turns unstable, and meets turning on the spot at rest alone.

    Steadily turning upright needs Omega w (C + m a^2) = 0 of its rates.
    """
    scene, motion = disc
    branch = rk.steady_family(scene, motion, "hold.speed", (0.5, 1.6), points=20)
    assert branch.ends == ("span", "span")
    assert branch.values[[0, -1]].tolist() == [0.5, 1.6]
    with pytest.raises(rk.FieldError, match="has no other branch"):
        rk.switch_branch(branch, branch.critical[0])
    with pytest.raises(rk.FieldError, match="is no Critical"):
        rk.switch_branch(branch, branch.critical[0].value)
    with pytest.raises(rk.FieldError, match="is no Branch"):
        rk.switch_branch(motion, branch.critical[0])
    cut = rk.steady_family(
        scene, motion, "hold.speed", (0.5, 1.6), points=20, max_points=3
    )
    assert cut.ends == ("max_points", "span")
    assert "begins within the span: max_points" in str(cut)


def test_a_slope_has_no_steady_motion():
    scene = rk.Scene(
        rk.Body(1.0, 0.4 * 0.01 * np.eye(3), rk.Sphere(0.1)),
        loads=rk.Gravity((1.0, 0.0, -9.0)),
    )
    guess = rk.place(scene, UPRIGHT, (0.0, 1.0, 0.0), ORIGIN)
    with pytest.raises(rk.FieldError, match=r"no steady motion near it; of 8 rates"):
        rk.steady_motion(scene, guess)


def test_a_search_that_ends_in_rest_says_so():
    """Chaplygin's ball: any spin leads to rest if nothing is held."""
    file = load_scene("chaplygin-ball")
    says = r"leads to rest, where all families of steady motions meet: the search slows"
    with pytest.raises(rk.FieldError, match=says):
        rk.steady_motion(file.scene, file.start)
    # as the remedy says: about an upright principal axis, with its energy
    start = rk.place(file.scene, UPRIGHT, (0.03, 0.05, 4.0), ORIGIN)
    motion = rk.steady_motion(file.scene, start, ("energy",))
    w = np.asarray(motion.state.angular_velocity)
    # solved to 1e-10 of a step
    np.testing.assert_allclose(w / np.linalg.norm(w), [0.0, 0.0, 1.0], atol=1e-9)


def test_linear_models_of_a_ball():
    """Seven fifths of the mass to a force, and what the base's acceleration does."""
    a, m = 0.1, 2.0
    ball = rk.Scene(rk.Body(m, 0.4 * m * a * a * np.eye(3), rk.Sphere(a)))
    still = rk.place(ball, UPRIGHT, ORIGIN, ORIGIN)
    inputs = "force x", "base acceleration y", "torque z", "loads[0].acceleration[2]"
    outputs = "contact on base 1", "normal force"
    model = rk.linearize(ball, still, inputs, outputs)
    expected = np.zeros((8, 4))
    w = [model.names.index(f"angular velocity {axis}") for axis in "xyz"]
    expected[w[1], 0] = 1.0 / (1.4 * m * a)
    expected[w[0], 1] = 1.0 / (1.4 * a)  # against the frame's field
    expected[w[2], 2] = 1.0 / (0.4 * m * a * a)
    # of numbers up to 125, from some 1e2 roundings
    np.testing.assert_allclose(model.B, expected, rtol=0, atol=1e-11)
    np.testing.assert_allclose(model.f, 0.0, rtol=0, atol=1e-13)
    assert model.A.shape == (8, 8)
    assert np.linalg.matrix_rank(model.A) == 3  # positions follow velocities: no more
    np.testing.assert_array_equal(model.C[0], np.eye(8)[3])
    np.testing.assert_allclose(model.D[1], [0.0, 0.0, 0.0, -m], atol=1e-13)
    with pytest.raises(rk.FieldError, match="did you mean 'force x'"):
        rk.linearize(ball, still, ("forse x",))


@pytest.mark.slow
def test_forces_on_what_is_carried_are_inputs():
    """A motor on each coordinate, against differences of runs' rates with that force.

    Beside its own spring and damper; a pendulum and a mass on a rail in one ball.
    """
    push = 0.1  # rates are linear in a force: of any size, to rounding

    def hanging(alpha):
        zero = 0.0 * alpha[0]
        return 0.05 * jnp.stack([jnp.sin(alpha[0]), zero, -jnp.cos(alpha[0])])[None]

    def on_rail(alpha):
        return jnp.stack([0.0 * alpha[0], alpha[0], 0.02 + 0.0 * alpha[0]])[None]

    def scene_of(first, second):
        swing = rk.PointMasses(
            0.3,
            hanging,
            force=lambda t, a, a_dot: first - 0.01 * a_dot,
            potential=lambda a: 0.4 * a[0] ** 2,
        )
        slide = rk.PointMasses(0.2, on_rail, force=lambda t, a, a_dot: second - 3.0 * a)
        ball = rk.Body(1.0, 0.004 * np.eye(3), rk.Sphere(0.1))
        return rk.Scene(ball, supported=(swing, slide))

    scene = scene_of(0.0, 0.0)
    alphas = {"alpha": (0.3, 0.01), "alpha_dot": (0.2, -0.1)}
    state = rk.place(scene, UPRIGHT, (0.3, 0.5, 0.7), ORIGIN, **alphas)
    inputs = "force alpha[1]", "force alpha[0]", "torque x"
    model = rk.linearize(scene, state, inputs)
    for column, pushes in enumerate(((0.0, push), (push, 0.0))):
        pushed = rk.linearize(scene_of(*pushes), state)
        expected = (pushed.f - model.f) / push
        # rates up to 1e2, of some 1e3 operations, over the push
        np.testing.assert_allclose(model.B[:, column], expected, rtol=0, atol=1e-10)
        assert np.max(np.abs(expected)) > 1.0
    with pytest.raises(rk.FieldError, match=r"did you mean 'force alpha\[1\]'"):
        rk.linearize(scene, state, ("force alpha[2]",))


def test_a_loaded_ball_on_a_slope_folds_where_it_can_rest_no_more():
    """gx / gz = e sin t / (r - e cos t) has its largest value e / sqrt(r^2 - e^2).

    Mass centre e below the middle of a ball r; t is the tilt. Beyond the fold at
    cos t = e / r the rest is unstable.
    """
    r, e = 0.1, 0.03
    body = rk.Body(1.0, np.diag([3e-3, 3e-3, 4e-3]), rk.Sphere(r), (0.0, 0.0, -e))
    scene = rk.Scene(body, loads=(rk.Gravity((0.1, 0.0, -G)),))
    start = rk.place(scene, (1.0, 0.0, 0.02, 0.0) / np.sqrt(1.0004), ORIGIN, ORIGIN)
    rest = rk.steady_motion(scene, start, ("spin about z",))
    branch = rk.steady_family(scene, rest, "loads[0].acceleration[0]", (0.0, 4.0))
    (fold,) = [c for c in branch.critical if c.kind == "fold"]
    # located to a few roundings of the value
    np.testing.assert_allclose(fold.value, G * e / np.sqrt(r * r - e * e), rtol=1e-13)
    down = cosine_of_tilt(fold.state)
    # the place of a fold on its branch is known to the root of a rounding
    np.testing.assert_allclose(down, e / r, rtol=0, atol=1e-7)
    stable = [p.stable for p in branch.points]
    turned = int(np.argmax([p.value for p in branch.points]))
    assert all(stable[: turned - 1])
    assert not any(stable[turned + 2 :])
    # a plain Jacobian is singular at every rest (the ball may lie anywhere, turned by
    # any angle), and shows no fold; with the symmetry solved for it is regular on the
    # whole branch, the fold included
    plain = [np.linalg.det(p.solution.local.slope) for p in branch.points]
    dets = np.abs([p.told.determinant for p in branch.points])
    assert np.max(np.abs(plain)) < 1e-9 * np.max(dets)
    assert np.min(dets) > 1e-4 * np.max(dets)


def cosine_of_tilt(state):
    """Cosine of the tilt of the body's z axis."""
    q = np.asarray(state.orientation) / np.linalg.norm(state.orientation)
    return 1.0 - 2.0 * (q[1] ** 2 + q[2] ** 2)


@pytest.mark.slow
def test_linear_model_off_steady_motion_against_differences(disc):
    """A at a state that is no steady motion: differences of the rates themselves."""
    scene, _ = disc
    state = leaning(scene, 0.9, 3.0, 1.0)
    model = rk.linearize(scene, state)
    around = independent_coordinates(scene, state)
    rates = jax.jit(
        lambda x: around.velocity(
            x, rk.rolling_derivative(scene, jnp.zeros(()), around.state(x))
        )
    )
    step = 1e-5
    differences = np.stack(
        [(rates(step * e) - rates(-step * e)) / (2.0 * step) for e in np.eye(8)], axis=1
    )
    # step^2 times third derivatives (1e2), and rounding 1e-14 / step
    np.testing.assert_allclose(model.A, differences, rtol=0, atol=1e-7)


def spinning_bowl(rate):
    bowl = rk.Graph(lambda x, y: 0.5 * (2.0 * x**2 + y**2))
    ball = rk.Body(1.0, 0.4 * 0.01 * np.eye(3), rk.Sphere(0.1))
    scene = rk.Scene(ball, rk.Base(bowl, rk.Spin(rate)))
    return scene, rk.place(scene, UPRIGHT, (0.0, 0.0, rate), ORIGIN)


def test_rest_in_a_spinning_bowl_and_the_branches_that_leave_it():
    """Omega^2 = g k / (1 - k a) at the bottom; Omega^2 (r - a sin b) = g tan b beside.

    The place of the centre, with tan b = k r the slope where the ball touches.
    """
    scene, start = spinning_bowl(2.0)
    motion = rk.steady_motion(scene, start, ("spin about z",))
    branch = rk.steady_family(scene, motion, "base.motion.rate", (1.0, 6.0), points=30)
    critical = [np.sqrt(G * k / (1.0 - 0.1 * k)) for k in (1.0, 2.0)]
    # a determinant's root, to rounding
    np.testing.assert_allclose([c.value for c in branch.critical], critical, rtol=1e-12)
    # what a plain Jacobian cannot tell: with the symmetry left in it is singular at
    # every point; with it taken out, at the two crossings alone
    dets = [p.told.determinant for p in branch.points]
    plain = [np.linalg.det(p.solution.local.slope) for p in branch.points]
    assert np.min(np.abs(dets)) > 1e-3 * np.max(np.abs(dets))
    assert np.max(np.abs(plain)) < 1e-9 * np.max(np.abs(dets))
    for which, k in enumerate((1.0, 2.0)):
        beside = rk.switch_branch(
            branch, branch.critical[which], points=30, max_points=12
        )
        places = np.array([p.state.contact_on_base for p in beside.points])
        r = places[:, 1 - which]
        assert np.max(r) > 0.2
        assert np.min(r) < -0.2
        np.testing.assert_allclose(places[:, which], 0.0, rtol=0, atol=1e-10)
        slope = np.arctan(k * r)
        balance = beside.values**2 * (r - 0.1 * np.sin(slope)) - G * np.tan(slope)
        # of accelerations up to 10, solved to 1e-10 of a step
        np.testing.assert_allclose(balance, 0.0, rtol=0, atol=1e-9)


def test_two_equal_eigenvalues_that_pass_zero_together():
    """In a damped spinning bowl of revolution, at Omega^2 = g k / (1 - k a)."""
    bowl = rk.Graph(lambda x, y: 0.5 * (x**2 + y**2))
    ball = rk.Body(1.0, 0.4 * 0.01 * np.eye(3), rk.Sphere(0.1))
    loads = rk.Gravity(), rk.RollingResistance(viscous=0.005)
    scene = rk.Scene(ball, rk.Base(bowl, rk.Spin(2.0)), loads=loads)
    start = rk.place(scene, UPRIGHT, (0.0, 0.0, 2.0), ORIGIN)
    motion = rk.steady_motion(scene, start, ("spin about z",))
    branch = rk.steady_family(scene, motion, "base.motion.rate", (2.0, 4.0), points=15)
    (critical,) = branch.critical
    # of two that are one no square root of rounding is left: as a determinant's root
    np.testing.assert_allclose(critical.value, np.sqrt(G / 0.9), rtol=1e-12)
    assert critical.kind == "zero crossing"
    # the place's 3e-12 rad/s, times a slope of order one
    assert abs(critical.eigenvalue) < 1e-11
    np.testing.assert_array_equal(branch.stable, branch.values < critical.value)
    with pytest.raises(rk.FieldError, match="several eigenvalues pass zero together"):
        rk.switch_branch(branch, critical)


def uneven_bowl(x, y, p):
    far = x**2 + y**2
    return 0.5 * (x**2 + 1.5 * y**2) + 0.3 * far**2 + p["e"] * x


@pytest.mark.slow
def test_long_steps_do_not_jump_from_a_branch_to_its_neighbour():
    """Where a pitchfork is broken, e from the branch that goes on without a turn.

    On the other side of its rate a ball near the middle is unstable; the branch that
    begins at rest goes out to one side, through no crossing.
    """
    body = rk.Body(1.0, 0.004 * np.eye(3), rk.Sphere(0.1))
    base = rk.Base(rk.Graph(uneven_bowl, {"e": 1e-3}), motion=rk.Spin(1.0))
    scene = rk.Scene(body, base)
    guess = rk.place(scene, UPRIGHT, (0.0, 0.0, 1.0), ORIGIN)
    start = rk.steady_motion(scene, guess).state
    motion = rk.steady_motion(scene, start, {"spin about z": 0.0})
    branch = rk.steady_family(scene, motion, "base.motion.rate", (0.5, 3.8), points=20)
    assert branch.stable.all()
    assert not branch.critical
    places = np.array([float(p.state.contact_on_base[0]) for p in branch.points])
    assert branch.values[-1] == 3.8
    assert (np.diff(places) < 0.0).all()
    # of the rest in the rotating bowl, slope = curvature of the circle at 3.8 rad/s
    assert places[-1] < -0.5


def test_a_ball_on_a_turntable_goes_round_two_sevenths_as_fast():
    """Circles about the axis: 2/7 of the table's rate, whatever their radius."""
    rate = 3.0
    ball = rk.Body(1.0, 0.4 * 0.01 * np.eye(3), rk.Sphere(0.1))
    scene = rk.Scene(ball, rk.Base(motion=rk.Spin(rate)))
    start = rk.place(scene, UPRIGHT, (0.0, 0.0, 2.0), (0.3, 0.0, 0.0))
    motion = rk.steady_motion(scene, start)
    # the group turns it on the table; some 1e2 roundings of numbers of order one
    turn = rate + motion.generator["turn about z"]
    assert abs(turn - 2.0 / 7.0 * rate) < 1e-12
    # beside it: circles about any other centre, which turn with the frame
    assert np.min(np.abs(motion.eigenvalues - 1j * turn)) < 1e-12


BALL = rk.Body(1.0, 0.4 * 0.01 * np.eye(3), rk.Sphere(0.1))
EGG = rk.Body(1.0, np.diag([0.003, 0.003, 0.002]), rk.Ellipsoid((0.1, 0.1, 0.15)))
TORUS = rk.Body(1.0, np.diag([0.003, 0.003, 0.005]), rk.Torus(0.1, 0.03))
SLOPE = rk.Gravity((1.0, 0.0, -9.8))
LEANING = (np.cos(0.3), np.sin(0.3), 0.0, 0.0)


def gliding(t):
    return jnp.stack([2.0 * t, 0.0 * t, 0.0 * t])


def hanging(angle):
    x = angle[0]
    return 0.05 * jnp.stack([jnp.sin(x), 0.0 * x, -jnp.cos(x)])[None]


def kinds():
    """Scene, guess, what is held, and how many zeros there are by theory.

    Zeros: dimensions of the group that move the state, of the family of steady motions,
    and of the ways in which it drifts steadily along itself.
    """
    one = rk.Scene(BALL)
    yield "ball", one, (UPRIGHT, (0.0, 5.0, 2.0), ORIGIN, {}), (), 6 + 2
    bowl = rk.Graph(lambda x, y: 0.3 * (x**2 + 2.0 * y**2))
    still = UPRIGHT, (0.0, 0.1, 0.0), ORIGIN, {}
    # CM above the contact: two conditions on five coordinates; yaw drifts
    oval = rk.Body(1.0, np.diag([0.003, 0.004, 0.005]), rk.Ellipsoid((0.2, 0.15, 0.1)))
    yield "rest in a bowl", rk.Scene(oval, rk.Base(bowl)), still, (), 3 + 1
    smooth = rk.Slipping(rk.ViscousFriction(0.0))
    spun = LEANING, (0.0, 0.0, 90.0), ORIGIN, {"slip": (0.3, 0.0, 0.0)}
    # on ice: two translations, turn, spin; lean and spin
    yield "egg on ice", rk.Scene(EGG, contact=smooth), spun, ("tilt",), 4 + 2
    thick = rk.RollingResistance(viscous=0.02)
    rolls = UPRIGHT, (0.0, 3.0, 0.0), ORIGIN, {}
    # two translations, three spins; the spin about the normal is free
    down = rk.Scene(BALL, loads=(SLOPE, thick))
    yield "ball that rolls down steadily", down, rolls, (), 5 + 1
    base = rk.Base(motion=rk.BaseMotion(position=gliding))
    fast = UPRIGHT, (0.0, 0.0, 30.0), ORIGIN, {}
    # asleep: translations, and turn and spin as one; the spin is free
    yield "egg on a gliding base", rk.Scene(EGG, base), fast, ("spin",), 3 + 1
    shell = rk.Scene(BALL, supported=rk.PointMasses(0.3, hanging))
    swings = UPRIGHT, ORIGIN, ORIGIN, {"alpha": (0.2,), "alpha_dot": (0.0,)}
    # at rest: translations, turn; any turn of the shell about the level axis of the
    # pendulum, for it hangs down; steady spins about the vertical
    yield "ball with a pendulum", shell, swings, (), None
    yield (
        "ring in a bowl",
        rk.Scene(TORUS, rk.Base(bowl)),
        (
            (np.sqrt(0.5), np.sqrt(0.5), 0.0, 0.0),
            (0.0, 0.1, 0.0),
            ORIGIN,
            {},
        ),
        (),
        None,
    )


KINDS = {name: rest for name, *rest in kinds()}


@pytest.mark.parametrize("name", slow_but(["ball"], KINDS))
def test_motions_of_every_kind_go_on_as_their_group_says(name):
    scene, (q, w, place, more), hold, count = KINDS[name]
    guess = rk.place(scene, q, w, place, **more)
    motion = rk.steady_motion(scene, guess, hold)
    if count is not None:
        assert len(motion.zeros) == count
    assert len(motion.zeros) + motion.eigenvalues.size == len(motion.coordinates)
    run = rk.simulate(scene, motion.state, (0.0, 0.5), rtol=1e-11, atol=1e-13)
    last = jax.tree.map(lambda x: x[-1], run.state)
    expected = motion.at(0.5)
    contacts = [rk.contact_of(scene, jnp.asarray(0.5), y) for y in (expected, last)]
    # some 1e3 steps of 1e-11; unstable ones grow by exp(0.5 * growth), at most 1e2
    loose = 1e-8 * np.exp(0.5 * max(motion.growth, 0.0))
    np.testing.assert_allclose(*(c.rotation for c in contacts), rtol=0, atol=loose)
    np.testing.assert_allclose(*(c.place for c in contacts), rtol=0, atol=loose)
    if name == "ball that rolls down steadily":
        # moments about the contact: m g_x a = c w
        speed = 1.0 * 0.1 / 0.02 * 0.1
        assert abs(motion.generator["translation x"] - speed) < 1e-12


@pytest.mark.slow
def test_the_linear_model_is_the_long_run_s():
    """Of 20 random tops: ``exp(A T)`` and its eigenvalues against tangents of runs."""
    draw = np.random.default_rng(5)
    horizon = 1.5
    for _ in range(20):
        a, c, lift = *(0.1 + 0.2 * draw.random(2)), 0.05 * (draw.random() - 0.5)
        A, C = 0.02 * (1.0 + draw.random()), 0.02 * (1.0 + 0.5 * draw.random())
        shape = rk.Ellipsoid((a, a, c))
        body = rk.Body(1.0, np.diag([A, A, C]), shape, (0.0, 0.0, lift))
        scene = rk.Scene(body)
        half = 0.2 + 0.3 * draw.random()
        q = (np.cos(half), np.sin(half), 0.0, 0.0)
        spin = np.array([0.0, 0.0, 4.0 + 6.0 * draw.random()])
        guess = rk.place(scene, q, spin, ORIGIN)
        motion = rk.steady_motion(scene, guess, ("tilt",))
        found = rk.symmetries(scene)
        around = independent_coordinates(scene, motion.state)
        steps = -horizon * np.array(list(motion.generator.values()))

        def after(x, scene=scene, around=around, found=found, steps=steps):
            run = rk.simulate(
                scene, around.state(x), (0.0, horizon), rtol=1e-13, atol=1e-15
            )
            last = jax.tree.map(lambda y: y[-1], run.state)
            return around.coordinates(found.moved(last, steps))

        monodromy = jax.jacfwd(after)(jnp.zeros(8))
        slope = motion.solution.local.slope
        expected = np.asarray(jax.scipy.linalg.expm(jnp.asarray(slope * horizon)))
        size = np.linalg.norm(expected)
        # some 1e3 steps of 1e-13, whose errors along the orbit grow with time and turn
        # rate: ten times more; of tangents of the size of the matrix
        np.testing.assert_allclose(monodromy, expected, rtol=0, atol=1e-8 * size)
        multipliers = np.linalg.eigvals(monodromy)
        for value in motion.eigenvalues:
            gap = np.min(np.abs(multipliers - np.exp(value * horizon)))
            assert gap < 1e-8 * size
        assert motion.eigenvalues.size + len(motion.zeros) == 8
        # translations, turn, spin; a family of two: for each lean and each spin one
        assert motion.family == 2
        assert len(motion.zeros) == 6


@pytest.mark.slow
def test_weave_and_capsize_of_the_benchmark_bicycle():
    """Meijaard, Papadopoulos, Ruina and Schwab (2007): 4.292382536341, 6.024262015388.

    Their speeds are given to 12 decimals.
    """
    bicycle = rk.kane.whipple_bicycle()
    start = rk.kane.bicycle_state(5.0)
    motion = rk.steady_motion(bicycle, start, ("u[2]",))
    assert motion.stable
    span = -10.0 / 0.3, -1.0 / 0.3
    branch = rk.steady_family(bicycle, motion, "hold.u[2]", span)
    found = {c.kind: -0.3 * c.value for c in branch.critical}
    assert abs(found["Hopf"] - 4.292382536341) < 1e-11
    assert abs(found["zero crossing"] - 6.024262015388) < 1e-11
    # eigenvalues at 5 m/s, table 2 there, to 14 digits
    table = [
        -0.32286642900409,
        -14.07838969279822,
        -0.77534188219585 + 4.46486771378823j,
    ]
    for value in table:
        assert np.min(np.abs(motion.eigenvalues - value)) < 1e-12
