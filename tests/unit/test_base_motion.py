"""Kinematics of the base, and how many coordinates a carried part has."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk
from rollkane.dynamics import observables
from rollkane.geometry.rotations import rotation_matrix
from rollkane.identification import paths
from rollkane.validation.checks import FieldError

ROUNDED = 1e-13  # some dozen roundings of numbers of order 1 to 10
TIMES = (-0.4, 0.0, 0.7, 2.3)


def swing(t):
    return rotation_matrix(
        jnp.stack([jnp.cos(t), 0.3 * jnp.sin(2.0 * t), 0.1 * t, jnp.sin(0.7 * t)])
    )


def skew(w):
    return np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])


@pytest.mark.parametrize("t", TIMES)
def test_turning_is_the_derivative_of_the_rotation(t):
    """On base axes, A' = A skew(w) and A'' = A (skew(w') + skew(w)^2)."""
    now = rk.BaseMotion(rotation=swing).at(jnp.asarray(t))
    A, S = np.asarray(now.rotation), skew(np.asarray(now.angular_velocity))
    once, twice = jax.jacfwd(swing), jax.jacfwd(jax.jacfwd(swing))
    np.testing.assert_allclose(once(t), A @ S, atol=ROUNDED)
    change = skew(np.asarray(now.angular_acceleration))
    np.testing.assert_allclose(twice(t), A @ (change + S @ S), atol=1e-12)
    assert now.position is None
    assert now.velocity is None
    assert now.acceleration is None


@pytest.mark.parametrize("t", TIMES)
def test_material_points_move_as_their_places_do(t):
    """Velocity and acceleration of a base point, by differentiating where it is."""
    glide = lambda t: jnp.stack([jnp.sin(t), 0.2 * t * t, jnp.cos(2.0 * t)])
    motion, point = rk.BaseMotion(glide, swing), jnp.array([0.3, -0.5, 0.2])
    where = lambda t: motion.at(t).placed(point)
    now = motion.at(jnp.asarray(t))
    velocity = now.to_fixed(now.velocity_at(point))
    np.testing.assert_allclose(velocity, jax.jacfwd(where)(t), atol=ROUNDED)
    acceleration = now.to_fixed(now.acceleration_at(point))
    second = jax.jacfwd(jax.jacfwd(where))(t)
    np.testing.assert_allclose(acceleration, second, atol=1e-12)


@pytest.mark.parametrize("t", TIMES)
def test_a_spin_is_the_motion_of_its_rotation(t):
    tilt = jnp.array([0.8, 0.6, 0.0, 0.0])
    spin = rk.Spin(1.7, orientation=tilt, position=(1.0, 2.0, 3.0)).at(jnp.asarray(t))
    about_z = lambda t: jnp.stack(
        [jnp.cos(0.85 * t), 0.0 * t, 0.0 * t, jnp.sin(0.85 * t)]
    )
    rotation = lambda t: rotation_matrix(tilt) @ rotation_matrix(about_z(t))
    twin = rk.BaseMotion(rotation=rotation).at(jnp.asarray(t))
    for name in ("rotation", "angular_velocity"):
        np.testing.assert_allclose(
            getattr(spin, name), getattr(twin, name), atol=ROUNDED
        )
    np.testing.assert_allclose(twin.angular_acceleration, 0.0, atol=1e-12)
    assert spin.angular_acceleration is None
    assert spin.position.tolist() == [1.0, 2.0, 3.0]


def test_a_record_of_pieces_of_lines_is_integrated_exactly():
    """a = c t has x = c t^3 / 6, between the samples too."""
    time = np.linspace(0.0, 2.0, 5)
    slope = np.array([3.0, -1.0])
    record = rk.RecordedMotion(
        time, np.outer(time, slope), start_velocity=(0.0, 0.5, 0.0)
    )
    for t in (0.0, 0.3, 0.5, 1.9, 2.0):
        now = record.at(jnp.asarray(t))
        np.testing.assert_allclose(now.acceleration[:2], slope * t, atol=ROUNDED)
        np.testing.assert_allclose(
            now.velocity[:2], slope * t**2 / 2 + [0.0, 0.5], atol=ROUNDED
        )
        np.testing.assert_allclose(
            now.position[:2], slope * t**3 / 6 + [0.0, 0.5 * t], atol=ROUNDED
        )
        assert (now.position[2], now.rotation) == (0.0, None)
    for t in (-0.1, 2.1):
        assert np.isnan(record.at(jnp.asarray(t)).position).all()
    assert record.kinks.tolist() == time.tolist()


def test_how_many_coordinates_a_part_has_is_found():
    place = lambda *numbers: jnp.stack(numbers)[None]
    counts = {
        1: lambda a: place(a[0], 0.0 * a[0], jnp.sin(a[0])),
        2: lambda a: place(a[0], a[1], a[0] * a[1]),
        3: lambda a: a[None, :3],
    }
    for count, position in counts.items():
        assert rk.PointMasses((1.0,), position).count == count
    assert rk.PointMasses((1.0,), lambda a: jnp.ones((1, 3))).count == 0
    # said, or seen in the forces, where the places do not tell
    assert rk.PointMasses((1.0,), counts[1], coordinates=2).count == 2
    pushed = rk.PointMasses((1.0,), counts[1], lambda t, a, v: -v[:1])
    assert pushed.count == 1
    with pytest.raises(FieldError, match="must be a whole number"):
        rk.PointMasses((1.0,), counts[1], coordinates=1.5)


def test_a_mass_that_is_bolted_on_is_part_of_the_body():
    """Ballast without coordinates, against a body with its mass, centre and inertia."""
    r, m, M = np.array([0.03, -0.02, 0.05]), 0.4, 1.0
    inertia = np.diag([0.01, 0.012, 0.015])
    ballast = rk.PointMasses((m,), lambda a: jnp.asarray(r)[None])
    surface = rk.Ellipsoid((0.2, 0.15, 0.1))
    carrying = rk.Scene(rk.Body(M, inertia, surface), supported=ballast)
    centre = m * r / (M + m)
    shift = lambda mass, d: mass * (d @ d * np.eye(3) - np.outer(d, d))
    whole = inertia + shift(M, centre) + shift(m, r - centre)
    solid = rk.Scene(rk.Body(M + m, whole, surface, centre))
    how = ((1.0, 0.0, 0.0, 0.0), (1.0, 2.0, 3.0), (0.0, 0.0, 0.0))
    t = jnp.zeros(())
    for of in (
        lambda scene, s: rk.rolling_derivative(scene, t, s).angular_velocity,
        lambda scene, s: observables.energy(scene, t, s),
        lambda scene, s: observables.momentum(scene, t, s),
    ):
        found = of(carrying, rk.place(carrying, *how))
        np.testing.assert_allclose(found, of(solid, rk.place(solid, *how)), rtol=1e-12)


@pytest.mark.parametrize("t", [1, np.float64(0.3)])
def test_plain_numbers_are_times_too(t):
    driven = rk.PointMasses(
        (1.0,), lambda a: a[0] * jnp.ones((1, 3)), lambda t, a, v: -v
    )
    pushed = rk.Prescribed(driven, lambda t: jnp.stack([jnp.sin(t)]))
    body = rk.Body(1.0, 0.01 * np.eye(3), rk.Sphere(0.1))
    glide = lambda t: jnp.stack([jnp.sin(t), t, t])
    record = rk.RecordedMotion(np.arange(3.0), np.ones(3))
    for motion in (rk.Spin(1.0), rk.BaseMotion(glide, swing), record):
        scene = rk.Scene(body, rk.Base(motion=motion), supported=(driven, pushed))
        how = ((1.0, 0.0, 0.0, 0.0), (1.0, 2.0, 3.0), (0.0, 0.0, 0.0), [0.1], [0.2])
        start = rk.place(scene, *how)
        for of in (rk.rolling_derivative, observables.power):
            found, expected = (
                of(scene, t, start),
                of(scene, jnp.asarray(float(t)), start),
            )
            for a, b in zip(
                jax.tree.leaves(found), jax.tree.leaves(expected), strict=True
            ):
                np.testing.assert_array_equal(a, b)


def parts_with_parameters(p):
    """Everything that takes several functions with the same parameters."""
    place = lambda a, p: p["k"] * jnp.stack([a[0], 0.0 * a[0], 1.0 + a[0] ** 2])
    spring = lambda a, p: 0.5 * p["k"] * a[0] ** 2
    push = lambda t, a, v, p: -p["k"] * v
    cross = jnp.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    turn = lambda a, p: jax.scipy.linalg.expm(p["k"] * jnp.reshape(a, ()) * cross)
    inertia = 0.01 * np.eye(3)
    masses = lambda a, p: place(a, p)[None]
    at = lambda t, p: p["k"] * jnp.stack([jnp.sin(t), t**2, 0.0 * t])
    return {
        "PointMasses": rk.PointMasses(1.0, masses, push, spring, p, 1),
        "SupportedBody": rk.SupportedBody(
            1.0, inertia, place, turn, push, spring, p, 1
        ),
        "BaseMotion": rk.BaseMotion(at, lambda t, p: turn(jnp.sin(t), p), p),
    }


def all_values(part):
    """Numbers that all of a part's functions go into."""
    t, alpha, rate = jnp.asarray(0.3), jnp.array([0.4]), jnp.array([0.7])
    if isinstance(part, rk.BaseMotion):
        return jax.tree.leaves(part.at(t))
    pushed = part.applied(t, alpha, rate)
    return [*jax.tree.leaves(part.carried(t, alpha, rate)), *pushed]


@pytest.mark.parametrize("name", ["PointMasses", "SupportedBody", "BaseMotion"])
def test_parameters_of_several_functions_are_one_number(name):
    """A derivative by it is that of all of them, under each of its names."""
    made = lambda k: parts_with_parameters({"k": k})[name]
    part = made(jnp.asarray(1.3))
    listed = [x for x in paths.floats(part) if "parameters" in x]
    assert listed == ["parameters.k"]
    k = jnp.asarray(1.3)
    _, expected = jax.jvp(lambda k: all_values(made(k)), (k,), (1.0,))
    assert all(np.any(x != 0.0) for x in expected[-1:])
    for path in ("parameters.k", "position.parameters.k"):
        keys = paths.keys_of(path)
        assert paths.found(part, keys) == 1.3
        moved = lambda k, keys=keys: all_values(paths.replaced(part, keys, k))
        _, found = jax.jvp(moved, (k,), (1.0,))
        for mine, other in zip(found, expected, strict=True):
            np.testing.assert_allclose(mine, other, atol=1e-14)


def test_functions_that_close_over_traced_numbers_keep_their_parameters():
    def value(a, k, moved):
        at = lambda t, p: a * p["k"] * jnp.stack([t, t**2, 0.0 * t])
        motion = rk.BaseMotion(at, parameters={"k": k})
        motion = eqx.tree_at(lambda m: m.parameters["k"], motion, moved)
        return motion.at(jnp.asarray(2.0)).position[1]

    two, three, five = map(jnp.asarray, (2.0, 3.0, 5.0))
    slopes = jax.grad(value, (0, 1, 2))(two, three, five)
    assert [float(x) for x in slopes] == [20.0, 0.0, 8.0]
