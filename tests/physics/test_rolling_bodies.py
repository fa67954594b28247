"""Bodies that roll on and in the rolling body: twins, laws, closed forms."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk
from rollkane.dynamics.rolling_body_observables import OfRollingBody

from ..outputs_alone import FIRST
from ..quick import slow_but
from ..random_pairs import CHAOTIC, KINDS, SEEDS, Pairs

LEVEL = (1.0, 0.0, 0.0, 0.0)
BALL, SHELL = 0.1, 0.3


def twin_errors(kind, seed, span):
    """Differences of positions [m] and of contact forces [relative] from the twin."""
    pairs = Pairs(kind, seed)
    times = np.linspace(0.0, span, 6)
    run = rk.simulate(pairs.scene, pairs.start, times, rtol=1e-12)
    assert run.code == rk.Code.COMPLETED
    assert run.method == "native"
    states = pairs.model.run(pairs.twin_start(run), times)
    twin = [pairs.model.split(y) for y in states]
    forces = [pairs.model.rates(t, y)[1] for t, y in zip(times, states, strict=True)]
    off, pulled = 0.0, 0.0
    for k, (body, path) in enumerate(zip(pairs.bodies, pairs.paths, strict=True)):
        seen = pairs.motion_of(run, path)
        origins = np.array([r[k] - R[k] @ body.center for r, R, *_ in twin])
        off = max(off, np.abs(origins - seen.position).max())
        force = np.array(forces)[:, k]
        error = np.abs(force - seen.contact_force).max()
        pulled = max(pulled, error / np.abs(force).max())
    return off, pulled


QUICK = ("ball on ball on turntable",)


@pytest.mark.parametrize("kind", slow_but(QUICK, KINDS))
def test_twins_agree(kind):
    off, pulled = twin_errors(kind, 0, 1.0)
    # rtol 1e-12 a step, some hundred steps, of motions that part by less than 1e3 in a
    # second; forces are as exact as velocities times a rate of some 10 / s
    assert off < 1e-9
    assert pulled < 1e-8


@pytest.mark.slow
@pytest.mark.parametrize("turn", range(4))
@pytest.mark.parametrize("kind", KINDS)
def test_twins_agree_for_five_seconds(kind, turn):
    seed = SEEDS.get(kind, range(1, 5))[turn]
    off, _ = twin_errors(kind, seed, CHAOTIC.get(kind, 5.0))
    assert off < 1e-9


def in_shell(on, body, supported=(), **options):
    """A body in a homogeneous ball with a cavity, on a plane."""
    outer = rk.Body(1.0, 0.05 * np.diag([1.0, 0.9, 1.1]), rk.Sphere(SHELL))
    part = rk.RollingBody(body, on, supported, **options)
    return rk.Scene(outer, supported=part)


def ball(center=(0.0, 0.0, 0.0)):
    return rk.Body(0.7, 2.8e-3 * np.eye(3), rk.Sphere(BALL), center)


def placed(scene, *inner, w=(0.5, 1.0, 2.0), **options):
    part = scene.supported[0]
    own = part.place(*inner, **options)
    return rk.place(scene, LEVEL, w, (0.0, 0.0, 0.0), supported=own)


def blob(p):
    """A rounded cube of half a width 0.1."""
    x = p / 0.1
    return 0.3 * jnp.sum(x**4) + jnp.sum(x**2) - 1.3


TILT = (np.cos(0.2), np.sin(0.2), 0.0, 0.0)
# the surface of the carrier, the body's, its orientation, and where it touches
PAIRS = {
    "disc in a hoop": (
        rk.Cylinder(0.28, inside=True),
        rk.DiscEdge(0.1),
        TILT,
        (0.28, 0.0, 0.0),
    ),
    "ring in a ball": (
        rk.Sphere(0.28, inside=True),
        rk.Ring(0.1),
        TILT,
        (0.0, -0.168, -0.224),
    ),
    "torus in a cavity": (
        rk.Ellipsoid((0.25, 0.28, 0.27), inside=True),
        rk.Torus(0.08, 0.03),
        TILT,
        (0.25, 0.0, 0.0),
    ),
    "rounded cube in a ball": (
        rk.Sphere(0.28, inside=True),
        rk.Implicit(blob),
        TILT,
        (0.0, 0.0, -0.28),
    ),
    "ellipsoid on a graph": (
        rk.Graph(lambda x, y: 0.5 * x * x + 0.3 * y * y + 0.2 * x * y - 0.1),
        rk.Ellipsoid((0.1, 0.12, 0.08)),
        TILT,
        (0.0, 0.0, -0.1),
    ),
}
STEP = 5e-4  # s, of nine-point stencils: an error of (w h)^8 w^2 / 630, w some 60 rad/s


def residuals(scene, run, step):
    """Of Newton's and Euler's equations of both bodies, by outputs alone, relative."""
    seen = run.rolling_body(0)
    bodies = (scene.body, run), (scene.supported[0].body, seen)
    pairs = ((run.contact_force, None), (seen.contact_force, seen.contact_place))
    g = np.array([0.0, 0.0, -9.81])
    turns = [rotations(motion.orientation) for _, motion in bodies]
    place = run.position + np.einsum("tij,tj->ti", turns[0], run.contact_on_body)
    pairs = ((pairs[0][0], place), pairs[1])
    found = {}
    for k, (body, motion) in enumerate(bodies):
        R, w = turns[k], np.asarray(motion.angular_velocity)
        arm = R @ np.asarray(body.center_of_mass)
        center, v = motion.position + arm, motion.velocity + np.cross(w, arm)
        spin = np.einsum("tij,jk,tlk,tl->ti", R, np.asarray(body.inertia), R, w)
        mass = float(body.mass)
        force, moment = np.zeros_like(v[4]), np.zeros_like(v[4])
        for sign, (push, where) in zip((1.0, -1.0), pairs[k:], strict=False):
            force = force + sign * push[4]
            moment = moment + sign * np.cross(where[4] - center[4], push[4])
        size = np.abs(pairs[k][0][4]).max()
        newton = mass * (derivative(v, step) - g) - force
        euler = derivative(spin, step) - moment
        glide = derivative(center, step) - v[4]
        found |= {f"Newton {k}": np.abs(newton).max() / size}
        found |= {f"Euler {k}": np.abs(euler).max() / (size * BALL)}
        found |= {f"velocity {k}": np.abs(glide).max()}
    return found


def rotations(orientation):
    w, x, y, z = np.moveaxis(np.asarray(orientation), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def derivative(values, step):
    """First derivative in the middle of nine samples."""
    return np.tensordot(FIRST / step, np.asarray(values), axes=1)


def slip_and_gap(run):
    """Of the inner contact, by outputs alone: [m/s] and [m]."""
    seen = run.rolling_body(0)
    place = np.asarray(seen.contact_place)
    velocities = [
        motion.velocity + np.cross(motion.angular_velocity, place - motion.position)
        for motion in (run, seen)
    ]
    R = rotations(run.orientation)
    on_carrier = np.einsum("tij,tj->ti", R, np.asarray(seen.contact_on_carrier))
    gap = run.position + on_carrier - place
    return np.abs(velocities[1] - velocities[0]).max(), np.abs(gap).max()


@pytest.mark.parametrize("name", slow_but(["torus in a cavity"], PAIRS))
def test_newton_and_euler_by_outputs_alone(name):
    on, surface, tilt, point = PAIRS[name]
    body = rk.Body(0.7, 2.8e-3 * np.diag([1.0, 1.1, 1.3]), surface)
    scene = in_shell(on, body)
    start = placed(scene, tilt, (0.7, -0.4, 1.1), point, allow_overlap=True)
    times = 0.5 + STEP * np.arange(-4, 5)
    run = rk.simulate(scene, start, np.concatenate([[0.0], times]), rtol=1e-13)
    assert run.code == rk.Code.COMPLETED
    part = jax.tree.map(lambda x: x[1:], run.state)
    run = eqx.tree_at(lambda r: (r.time, r.state), run, (run.time[1:], part))
    # the integrator's 1e-13 of velocities of 1 m/s over a step of the stencil: 2e-10 of
    # a force, and less from (60 * 5e-4)^8 * 3600 / 630 = 4e-12
    worst = residuals(scene, run, STEP)
    assert max(worst.values()) < 1e-9, worst
    slip, gap = slip_and_gap(run)
    assert slip < 1e-12
    assert gap < 1e-12


def test_small_oscillations_of_a_ball_in_a_rolling_shell():
    """In a plane; the shell rolls under it. Energies by hand, quadratic in rates."""
    M, m, R, r = 1.0, 0.7, SHELL, BALL
    I1, I2, g = 0.05, 2.8e-3, 9.81
    a = M * R**2 + I1 + m * R**2 + I2 * R**2 / r**2
    b = (R - r) * (m * R + I2 * R / r**2)
    c = (R - r) ** 2 * (m + I2 / r**2)
    w = np.sqrt(m * g * (R - r) / (c - b * b / a))  # the shell's momentum is zero
    scene = in_shell(rk.Sphere(R, inside=True), ball())
    tilt = 1e-5
    point = (0.0, R * np.sin(tilt), -R * np.cos(tilt))
    start = placed(scene, LEVEL, (0.0, 0.0, 0.0), point, w=(0.0, 0.0, 0.0))
    quarter = 0.5 * np.pi / w
    times = quarter * np.array([0.0, 1.0, 2.0, 40.0])
    run = rk.simulate(scene, start, times, rtol=1e-12)
    seen = run.rolling_body(0)
    angle = (seen.position - run.position)[:, 1] / (R - r)
    # a pendulum's period differs by tilt^2 / 16 of itself, 6e-12; at 40 quarters the
    # phase by 60 times that
    off = np.abs(angle / tilt - np.cos(w * times))
    np.testing.assert_allclose(off, 0.0, atol=1e-9)


HOOP = 0.32  # m, its outer radius


@pytest.mark.slow
def test_first_pulls_of_an_ensemble():
    """As of each member alone."""
    scene = in_shell(rk.Sphere(SHELL), ball())
    point = (0.0, SHELL * np.sin(0.1), SHELL * np.cos(0.1))
    spins = [(k, 0.0, 0.0) for k in (0.0, 2.0, 8.0)]
    starts = [placed(scene, LEVEL, (0.0, 0.0, 0.0), point, w=w) for w in spins]
    together = jax.tree.map(lambda *x: jnp.stack(x), *starts)
    times = np.linspace(0.0, 1.5, 31)
    many = rk.ensemble(scene, together, times)
    inner, outer = many.rolling_body(0).first_pull, many.first_pull
    for k, start in enumerate(starts):
        one = rk.simulate(scene, start, times)
        # of the same states, by programs of other shapes: a force that falls by some
        # newtons a second, rounded to 1e-15 N, is zero within 1e-15 s of some tenths
        expected = one.rolling_body(0).first_pull
        np.testing.assert_allclose(inner[k], expected, rtol=1e-12)
    assert np.isfinite(inner).all()
    pressed = np.all(many.normal_force > 0, axis=1)
    assert set(pressed) == {False, True}
    np.testing.assert_array_equal(np.isnan(outer), pressed)
    with pytest.raises(rk.FieldError, match="ends alone"):
        _ = many.final.rolling_body(0).first_pull


def test_a_ratio_of_nothing_has_no_slope():
    """A ball at rest in the bottom of a shell pulls nowhere along it."""

    def last(mass):
        inner = eqx.tree_at(lambda b: b.mass, ball(), mass)
        scene = in_shell(rk.Sphere(0.28, inside=True), inner)
        still = (0.0, 0.0, 0.0)
        start = placed(scene, LEVEL, still, (0.0, 0.0, -0.28), w=still)
        run = rk.simulate(scene, start, [0.0, 0.2])
        return run.rolling_body(0).friction_ratio[-1]

    # what is left of a force of 10 N without a part along the surface is its rounding
    value, slope = jax.value_and_grad(last)(jnp.asarray(1.0))
    assert abs(value) < 1e-14
    assert abs(slope) < 1e-14


@pytest.mark.parametrize("inner", ["ball", "cylinder"])
def test_small_oscillations_in_a_rolling_hoop(inner):
    """A ball, or a cylinder by its rim, in a hoop that stands on its edge and rolls.

    In a plane, with the hoop's spin W and the inner body's angle phi: the hoop's middle
    goes by a W and the inner one's, at first order, by a W + l phi'. Where they touch
    the hoop's material goes by a W - R W and the body's by a W + l phi' - r w, so that
    w = (l phi' + R W) / r. Of the kinetic energy A W^2 / 2 + B W phi' + C phi'^2 / 2
    the momentum A W + B phi' is zero, as nothing acts along the ground in W.
    """
    M, m, a, R, r = 1.0, 0.7, HOOP, SHELL, BALL
    surface, share = {
        "ball": (rk.Sphere(r), 0.4),
        "cylinder": (rk.DiscEdge(r), 0.5),
    }[inner]
    I1, I2, g, long = 0.09, share * m * r**2, 9.81, R - r
    A = (M + m) * a**2 + I1 + I2 * R**2 / r**2
    B = long * (m * a + I2 * R / r**2)
    C = long**2 * (m + I2 / r**2)
    w = np.sqrt(m * g * long / (C - B * B / A))
    hoop = rk.Body(M, np.diag([0.05, 0.05, I1]), rk.DiscEdge(a))
    body = rk.Body(m, I2 * np.diag([0.6, 0.6, 1.0]), surface)
    part = rk.RollingBody(body, rk.Cylinder(R, inside=True))
    scene = rk.Scene(hoop, supported=part)
    tilt, still = 1e-5, (0.0, 0.0, 0.0)
    point = (R * np.sin(tilt), -R * np.cos(tilt), 0.0)
    own = part.place(LEVEL, still, point)
    on_edge = (np.sqrt(0.5), np.sqrt(0.5), 0.0, 0.0)  # its axis level, y up
    start = rk.place(scene, on_edge, still, still, supported=own)
    times = 0.25 * np.pi / w * np.arange(9)  # one period: then a hoop falls over
    run = rk.simulate(scene, start, times, rtol=1e-12)
    angle = (run.rolling_body(0).position - run.position)[:, 0] / long
    # as in the shell; what falls over grows from roundings by exp(4) in a period
    off = np.abs(angle / tilt - np.cos(w * times))
    np.testing.assert_allclose(off, 0.0, atol=1e-9)


def drive(t, state, gain):
    """A torque that brakes the relative rotation, and a steady one."""
    steady = jnp.stack([0.1 + 0.0 * t, jnp.sin(t), 0.0 * t])
    return gain * (steady - 0.2 * state.angular_velocity)


def swing(t):
    return 0.03 * jnp.stack([jnp.cos(3.0 * t), jnp.sin(2.0 * t), 0.0 * t])


def place_in(alpha):
    return alpha[None]


@pytest.mark.parametrize("law", [rk.Rolling(), rk.RubberRolling()])
def test_energy_changes_by_the_power(law):
    """Torques, drives inside a body that rolls inside, and a base that moves."""
    inner = rk.Prescribed(rk.PointMasses(0.2, place_in, coordinates=3), swing)
    part = rk.RollingBody(
        ball((0.01, 0.0, 0.02)),
        rk.Sphere(0.28, inside=True),
        inner,
        law,
        torque=drive,
        parameters=0.05,
    )
    outer = rk.Body(1.0, 0.05 * np.diag([1.0, 0.9, 1.1]), rk.Sphere(SHELL))
    scene = rk.Scene(outer, rk.Base(rk.Plane(), rk.Spin(0.7)), part)
    assert scene.does_work
    start = placed(scene, LEVEL, (1.0, -0.5, 0.3), (0.0, 0.0, -0.28))
    times = 0.4 + 1e-3 * np.arange(-4, 5)
    run = rk.simulate(scene, start, np.concatenate([[0.0], times]), rtol=1e-13)
    change = derivative(run.energy[1:], 1e-3)
    # rounding of 4 J over a stencil of 1e-3 s, and (20 * 1e-3)^8 * 20^2 / 630
    assert abs(change - run.power[5]) < 4e-11 * 4.0
    assert abs(run.power[5]) > 1e-2


def test_rubber_does_not_spin():
    pairs = Pairs("rubber ball in rubber shell", 0)
    run = rk.simulate(pairs.scene, pairs.start, [0.0, 0.5, 1.0], rtol=1e-12)
    seen = run.rolling_body(0)
    relative = seen.angular_velocity - run.angular_velocity
    normal = run.each(OfRollingBody("outward", (0,)))
    # an invariant of the rates, kept to the integrator's 1e-12 of 10 rad/s a step
    assert np.abs(np.sum(relative * normal, axis=1)).max() < 1e-10


def test_gradients_both_ways():
    """Of the inner ball's place by every number of scene and start, both ways."""
    scene = in_shell(rk.Sphere(0.28, inside=True), ball((0.01, 0.02, 0.0)))
    start = placed(scene, TILT, (1.0, 2.0, -0.5), (0.0, 0.1, -np.sqrt(0.0684)))
    times = jnp.asarray([0.0, 0.4])

    @eqx.filter_jit
    def place(model):
        run = rk.simulate(*model, times, rtol=1e-12)
        return run.each(OfRollingBody("position", (0,)))[-1, 0]

    model = scene, start
    back = jax.grad(place)(model)
    draw = np.random.default_rng(0)
    leaves, tree = jax.tree.flatten(model)
    sized = lambda x: jnp.max(jnp.abs(x)) if x.size else 0.0
    steps = [sized(x) * jnp.asarray(draw.normal(size=x.shape)) for x in leaves]
    way = jax.tree.unflatten(tree, steps)
    _, forward = jax.jvp(place, (model,), (way,))
    both = jax.tree.map(lambda a, b: jnp.sum(a * b), back, way)
    total = sum(jax.tree.leaves(both))
    size = sum(abs(float(x)) for x in jax.tree.leaves(both))
    assert abs(total - forward) < 1e-9 * size
    # against differences of the fourth order, of numbers that move by h of their size:
    # h^4 / 30 of a fifth derivative below 1e4, and steps' errors of 1e-11 / h
    h = 2e-3
    moved = lambda k: place(jax.tree.map(lambda x, v: x + k * h * v, model, way))
    slope = (8 * (moved(1) - moved(-1)) - (moved(2) - moved(-2))) / (12 * h)
    assert abs(slope - forward) < 1e-7 * size


def test_an_ensemble_is_its_members():
    scene = in_shell(rk.Sphere(0.28, inside=True), ball())
    starts = [
        placed(scene, LEVEL, (k, 2.0, -0.5), (0.0, 0.0, -0.28)) for k in (0.0, 1.0, 2.0)
    ]
    together = jax.tree.map(lambda *x: jnp.stack(x), *starts)
    times = [0.0, 0.3, 0.6]
    many = rk.ensemble(scene, together, times)
    assert many.method == "native"
    for k, start in enumerate(starts):
        one = rk.simulate(scene, start, times)
        # the same steps: roundings of a few hundred operations
        np.testing.assert_allclose(
            many.rolling_body(0).position[k], one.rolling_body(0).position, atol=1e-12
        )


def test_first_pull_of_the_inner_contact():
    """A ball on top of a ball that is held by its own weight rolls off and pulls."""
    scene = in_shell(rk.Sphere(SHELL), ball())
    point = (0.0, SHELL * np.sin(0.1), SHELL * np.cos(0.1))
    start = placed(scene, LEVEL, (0.0, 0.0, 0.0), point, w=(0.0, 0.0, 0.0))
    times = np.linspace(0.0, 1.5, 151)
    run = rk.simulate(scene, start, times)
    seen = run.rolling_body(0)
    assert 0.0 < seen.first_pull < 1.5
    k = int(np.searchsorted(times, seen.first_pull))
    assert seen.normal_force[k - 1] > 0 > seen.normal_force[k]
