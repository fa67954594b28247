"""Symmetries of scenes, and independent coordinates around their states."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk
from rollkane.codegen.compile_effort import for_one_call
from rollkane.dynamics.consistency import consistent
from rollkane.dynamics.rolling import contact_of
from rollkane.kinematics.coordinates import pack
from rollkane.stability.independent_coordinates import independent_coordinates
from rollkane.stability.symmetries import symmetries

from ..quick import slow_but

EGG = rk.Body(1.0, np.diag([0.3, 0.3, 0.2]), rk.Ellipsoid((0.5, 0.5, 0.7)))
POTATO = rk.Body(
    1.0, np.diag([0.3, 0.4, 0.5]), rk.Ellipsoid((0.5, 0.6, 0.7)), (0.0, 0.1, 0.0)
)
HOOP = rk.Body(1.0, np.diag([0.3, 0.3, 0.5]), rk.Ring(0.5))
RING = rk.Body(1.0, np.diag([0.3, 0.3, 0.5]), rk.Torus(0.5, 0.1))
BALL = rk.Body(1.0, 0.4 * 0.01 * np.eye(3), rk.Sphere(0.1))
BOWL = rk.Graph(lambda x, y: 0.1 * (x**2 + y**2))
TUBE = rk.Cylinder(2.0, inside=True)
TROUGH = rk.Graph(lambda x, y: 0.1 * x**2)
UPRIGHT, ORIGIN = (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
TILT = (np.cos(0.1), np.sin(0.1), 0.0, 0.0)


def pendulum(angle):
    return 0.2 * jnp.stack([jnp.sin(angle[0]), jnp.cos(angle[0]), 0.0 * angle[0]])[None]


FLAT = "translation x", "translation y", "turn about z"
SCENES = {
    "egg on a plane": (rk.Scene(EGG), (*FLAT, "spin about z")),
    "potato on a plane": (rk.Scene(POTATO), FLAT),
    "potato under rubber": (rk.Scene(POTATO, contact=rk.RubberRolling()), FLAT),
    "egg that slips": (
        rk.Scene(EGG, contact=rk.Slipping(rk.CoulombFriction(0.3))),
        (*FLAT, "spin about z"),
    ),
    "potato on a slope": (
        rk.Scene(POTATO, loads=rk.Gravity((1.0, 0.0, -9.0))),
        FLAT[:2],
    ),
    "ring in a bowl": (
        rk.Scene(RING, rk.Base(BOWL)),
        ("turn about z", "spin about z"),
    ),
    "ring in a trough": (
        rk.Scene(RING, rk.Base(TROUGH)),
        ("translation y", "spin about z"),
    ),
    "ring in a bowl, slipping": (
        rk.Scene(RING, rk.Base(BOWL), contact=rk.Slipping(rk.ViscousFriction(0.3))),
        ("turn about z", "spin about z"),
    ),
    "hoop in a bowl, rubber": (
        rk.Scene(HOOP, rk.Base(BOWL), contact=rk.RubberRolling()),
        ("turn about z", "spin about z"),
    ),
    "egg in an upright tube, weightless": (
        rk.Scene(EGG, rk.Base(TUBE), loads=()),
        ("translation z", "turn about z", "spin about z"),
    ),
    "egg in a lying tube": (
        rk.Scene(
            EGG, rk.Base(rk.Cylinder(2.0, inside=True)), loads=rk.Gravity((-9.0, 0, 0))
        ),
        ("translation z", "spin about z"),
    ),
    "egg pulled to a point": (
        rk.Scene(
            EGG, loads=(rk.Gravity(), rk.Potential(lambda p: p[0] ** 2 + p[1] ** 2))
        ),
        ("turn about z", "spin about z"),
    ),
    "egg on a turntable": (
        rk.Scene(EGG, rk.Base(motion=rk.Spin(2.0))),
        ("turn about z", "spin about z"),
    ),
    "egg on a tilted turntable": (
        rk.Scene(EGG, rk.Base(motion=rk.Spin(2.0, TILT))),
        ("spin about z",),
    ),
    "homogeneous ball": (
        rk.Scene(BALL),
        (*FLAT, "spin about x", "spin about y", "spin about z"),
    ),
    "ball with a free pendulum": (
        rk.Scene(BALL, supported=rk.PointMasses(0.1, pendulum), loads=()),
        (*FLAT, "spin about z - alpha[0]"),
    ),
}
CASES = slow_but(("egg on a plane", "egg on a tilted turntable"), SCENES)


def random_state(scene, seed):
    """A state that the contact allows, anywhere but near the ends of surfaces."""
    draw = np.random.default_rng(seed)
    normal = lambda *n: jnp.asarray(draw.standard_normal(n))
    count, body = scene.base.surface.coordinate_count, scene.body.surface
    own = body.coordinate_count if scene.has_contact_coordinates else 0
    parts = normal(4), normal(3), 0.3 * normal(count), 0.3 * normal(own)
    n = scene.coordinate_count
    state = rk.State(*parts, normal(n), normal(n))
    if scene.contact.slips:
        state = rk.SlidingState(*parts, normal(n), normal(n), normal(3))
    return consistent(scene, jnp.zeros(()), state)


@pytest.mark.parametrize("name", CASES)
def test_symmetries_have_names(name):
    scene, names = SCENES[name]
    assert symmetries(scene).names == names
    # near a state, too, where rounding is of another size
    assert symmetries(scene, random_state(scene, 4)).names == names


@pytest.mark.parametrize("name", CASES)
def test_motions_go_over_into_motions(name):
    """Rates of a moved state are the rates moved, for group elements of any size."""
    scene, names = SCENES[name]
    found, state = symmetries(scene), random_state(scene, 3)
    steps = np.random.default_rng(4).standard_normal(len(names))
    t = jnp.zeros(())

    @for_one_call
    def both(state):
        rates = rk.rolling_derivative(scene, t, state)
        move = lambda y: found.moved(y, steps)
        moved, pushed = jax.jvp(move, (state,), (rates,))
        tangent = found.generator(state, steps)
        _, along = jax.jvp(lambda s: found.moved(state, s * steps), (0.0,), (1.0,))
        return (
            pack(pushed),
            pack(rk.rolling_derivative(scene, t, moved)),
            (
                pack(tangent),
                pack(along),
            ),
        )

    pushed, rates, tangents = both(state)
    # some 1e3 roundings of numbers up to the largest rate
    loose = 1e-12 * np.max(np.abs(rates))
    np.testing.assert_allclose(rates, pushed, rtol=0, atol=loose)
    np.testing.assert_allclose(*tangents, rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    "name",
    slow_but(["egg on a tilted turntable"], [n for n in SCENES if "turntable" in n]),
)
def test_time_carries_states_along(name):
    """What time does is taken out: carried states have rates that do not know it."""
    scene, _ = SCENES[name]
    found, state, t = symmetries(scene), random_state(scene, 5), jnp.asarray(0.7)

    @for_one_call
    def both(state):
        rates = rk.rolling_derivative(scene, jnp.zeros(()), state)
        own = jax.tree.map(jnp.subtract, rates, found.carrying(state))
        move = lambda t, y: found.carried(y, t)
        moved, pushed = jax.jvp(move, (t, state), (1.0, own))
        return pack(pushed), pack(rk.rolling_derivative(scene, t, moved))

    pushed, rates = both(state)
    # some 1e3 roundings, as above
    np.testing.assert_allclose(
        rates, pushed, rtol=0, atol=1e-12 * np.max(np.abs(rates))
    )


def test_what_depends_on_time_is_told():
    shaken = rk.BaseMotion(lambda t: jnp.stack([jnp.sin(t), 0.0 * t, 0.0 * t]))
    found = symmetries(rk.Scene(EGG, rk.Base(motion=shaken)))
    assert "spin about z" in found
    assert "turn about z" not in found
    with pytest.raises(rk.FieldError, match="depends on time"):
        found.carrying(random_state(found.scene, 0))
    with pytest.raises(
        rk.FieldError, match="is no symmetry of the scene, got 'turn about z'"
    ):
        found["turn about z"]


def late(t, point):
    del point
    return jnp.stack([jnp.where(t > 5.0, 0.5, 0.0), 0.0 * t, 0.0 * t])


def brief(t, point):
    del point
    return jnp.stack([jnp.where((t > 60.0) & (t < 65.0), 0.5, 0.0), 0.0 * t, 0.0 * t])


@pytest.mark.parametrize("force", [late, brief])
def test_a_force_that_is_constant_near_time_zero_is_told(force):
    """No derivative by time tells of it, since it is constant on both sides."""
    scene = rk.Scene(EGG, loads=(rk.Gravity(), rk.Force(force)))
    found = symmetries(scene)
    assert found.drift is None
    assert "turn about z" not in found  # at no time but before it
    assert "translation x" in found


def test_a_record_that_begins_at_rest_is_told():
    motion = np.zeros((201, 3))
    motion[100:, 0] = np.sin(np.arange(101) * 0.05)
    record = rk.RecordedMotion(np.arange(201) * 0.1, motion)
    scene = rk.Scene(EGG, rk.Base(motion=record))
    assert symmetries(scene).drift is None


SIZES = {
    "egg on a plane": 8,
    "potato under rubber": 7,
    "ring in a bowl": 8,
    "ring in a bowl, slipping": 10,
    "hoop in a bowl, rubber": 7,
    "egg that slips": 10,
    "ball with a free pendulum": 10,
}


@pytest.mark.parametrize("name", slow_but(("egg that slips",), SIZES))
def test_coordinates_of_what_the_contact_allows(name):
    scene, _ = SCENES[name]
    made = independent_coordinates(scene, random_state(scene, 6))
    assert made.count == len(made.names) == SIZES[name]
    x = jnp.asarray(0.3 * np.random.default_rng(7).standard_normal(made.count))
    t = jnp.zeros(())

    @for_one_call
    def told(x):
        state = made.state(x)
        contact = contact_of(scene, t, state)
        again = consistent(scene, t, state)
        rates = rk.rolling_derivative(scene, t, state)
        velocity = made.velocity(x, rates)
        moved = jax.jvp(made.image, (state,), (rates,))[1]
        near = made.coordinates(made.state(1e-4 * x))
        identity = jax.jacfwd(lambda x: made.coordinates(made.state(x)))(0.0 * x)
        return contact, state, again, made.basis(x) @ velocity, moved, near, identity

    contact, state, again, back, moved, near, identity = told(x)
    out = contact.rotation @ contact.normal
    ground = scene.base.surface.geometry(state.contact_on_base).normal
    # of unit vectors, after some ten roundings
    np.testing.assert_allclose(out, -ground, rtol=0, atol=2e-15)
    for spare in (contact.spare_spin, contact.spare_slip):
        if spare is not None:
            assert abs(float(spare)) < 1e-14  # of velocities of order one
    np.testing.assert_allclose(pack(state), pack(again), rtol=0, atol=1e-14)
    # rates lie in the tangent space: nothing of them is lost; 1e2 roundings, twice
    loose = 1e-12 * np.max(np.abs(moved))
    np.testing.assert_allclose(back, moved, rtol=0, atol=loose)
    np.testing.assert_allclose(identity, np.eye(made.count), rtol=0, atol=1e-12)
    # second order of 1e-4, times curvatures up to ten
    np.testing.assert_allclose(near, 1e-4 * x, rtol=0, atol=1e-6)


def test_states_of_another_kind_are_refused():
    scene, _ = SCENES["egg on a plane"]
    state = random_state(scene, 0)
    flying = rk.FlyingState(*jax.tree.leaves(state), jnp.zeros(3), jnp.zeros(3))
    with pytest.raises(rk.FieldError, match="FlyingState"):
        independent_coordinates(scene, flying)
