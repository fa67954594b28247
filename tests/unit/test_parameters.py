"""Free and tied parameters: paths, coordinates, bounds, and what is refused."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk
from rollkane.files.scene_files import builtin_scenes, load_scene
from rollkane.identification.inertia_transforms import (
    DiagonalInertia,
    FlatInertia,
    FullInertia,
    inertia_transform,
)
from rollkane.identification.layout import Layout, known_paths
from rollkane.identification.parameters import Model
from rollkane.identification.start_coordinates import (
    Across,
    Directions,
    OnSurface,
    _of_contact,
)
from rollkane.identification.transforms import Plain, Positive, Rotated, Scaled

from ..quick import A_FEW, slow_but

EPS = np.finfo(float).eps
ASKEW = np.array([[4e-4, 2e-5, 1e-5], [2e-5, 6e-4, -3e-5], [1e-5, -3e-5, 7e-4]])
TIMES = np.linspace(0.0, 0.5, 11)
GYRO = rk.Gyro(np.ones((11, 3)), 0.01, delay=0.001)
RECORD = rk.Record(TIMES, {"gyro": GYRO})
MODES = rk.Modes(friction=0.0, restitution=0.5)


def scene_of(inertia=ASKEW, base=None):
    body = rk.Body(0.5, inertia, rk.Ellipsoid((0.06, 0.05, 0.04)))
    loads = rk.Gravity(), rk.Drag(0.0, 0.1)
    return rk.Scene(body, rk.Base(rk.Plane()) if base is None else base, loads=loads)


SCENE = scene_of()
START = rk.place(SCENE, (1.0, 0.0, 0.0, 0.0), (8.0, 3.0, 2.0), (0.0, 0.0, 0.0))
MODEL = Model(SCENE, START, RECORD.start_time, MODES, RECORD.channels)


def entry_of(*free, models=(MODEL,)):
    return Layout(models, free).entries[0]


# Inertias


def physical(inertia):
    """Smallest moment, and the smallest excess of two moments over the third.

    The eigenvalues of an exactly representable matrix are good to some eps of the
    largest; the inertia's entries are sums of up to six terms: 16 eps of its trace.
    """
    moments = np.linalg.eigvalsh(inertia)
    return moments[0], moments[0] + moments[1] - moments[2], 16 * EPS * moments.sum()


BODIES = {
    "askew": (ASKEW, FullInertia),
    "ball": (4e-3 * np.eye(3), FullInertia),
    "disc": (np.diag([0.015625, 0.015625, 0.03125]), FlatInertia),
    "needle": (np.diag([1e-7, 1.0, 1.0]), FullInertia),
    "flat and long": (np.diag([1e-6, 1.0, 1.000001]), FlatInertia),
}


def turned(inertia, seed=0):
    turn, _ = np.linalg.qr(np.random.default_rng(seed).standard_normal((3, 3)))
    whole = turn @ inertia @ turn.T
    return 0.5 * (whole + whole.T)


@pytest.mark.parametrize("name", BODIES)
def test_an_inertia_stays_that_of_a_body(name):
    """Whatever the coordinates are, up to factors of e^12 of them."""
    inertia, kind = BODIES[name]
    random = np.random.default_rng(1)
    for known in (inertia, turned(inertia)):
        transform = inertia_transform("I", jnp.asarray(known), None)
        assert type(transform) is kind
        z0 = transform.start()
        # S and back: Cholesky's factor squared, 3 terms, and a logarithm of up to 20
        # whose rounding is 20 eps of the number
        kept = np.asarray(transform.value(jnp.asarray(z0)))
        np.testing.assert_allclose(kept, known, rtol=0, atol=64 * EPS * np.trace(known))
        for _ in range(50):
            z = z0 + random.uniform(-6.0, 6.0, z0.size)
            least, excess, rounding = physical(
                np.asarray(transform.value(jnp.asarray(z)))
            )
            assert least > -rounding
            assert excess > -rounding


def test_a_disc_stays_flat():
    """Its largest moment is the sum of the others, about the same axis."""
    flat = turned(BODIES["disc"][0])
    normal = np.linalg.eigh(flat)[1][:, 2]
    transform = inertia_transform("I", jnp.asarray(flat), None)
    for seed in range(20):
        z = np.random.default_rng(seed).uniform(-3.0, 3.0, 3)
        inertia = np.asarray(transform.value(jnp.asarray(z)))
        _, _, rounding = physical(inertia)
        moment = normal @ inertia @ normal
        assert abs(np.trace(inertia) - 2.0 * moment) < rounding
        assert np.abs(inertia @ normal - moment * normal).max() < rounding


def test_a_needle_without_width_is_refused():
    needle = jnp.asarray(np.diag([1e-12, 1.0, 1.0]))
    with pytest.raises(rk.FieldError, match='form="scale"'):
        inertia_transform("I", needle, None)


def test_forms_of_an_inertia():
    entry = entry_of(
        rk.Free("body.inertia", form="diagonal"),
        models=[MODEL._replace(scene=scene_of(np.diag([4e-4, 6e-4, 7e-4])))],
    )
    assert type(entry.transform) is DiagonalInertia
    assert entry.transform.labels() == (".xx", ".yy", ".zz")
    scaled = entry_of(rk.Free("body.inertia", form="scale"))
    assert type(scaled.transform) is Scaled
    # one factor: e^0.3 of every entry, to a few roundings
    found, shown, _, _ = scaled.at(np.array([0.3]))
    np.testing.assert_allclose(found, np.exp(0.3) * ASKEW, rtol=8 * EPS)
    np.testing.assert_allclose(shown, np.exp(0.3), rtol=8 * EPS)


# Other coordinates


def test_quaternions_stay_of_unit_length():
    unit = np.array([0.5, -0.5, 0.1, 0.7])
    transform = Rotated(jnp.asarray(unit / np.linalg.norm(unit)))
    random = np.random.default_rng(0)
    for size in (0.0, 1e-9, 1e-4, 1e-3, 1.0, 30.0):
        z = size * random.standard_normal(3)
        found = np.asarray(transform.value(jnp.asarray(z)))
        assert abs(np.linalg.norm(found) - 1.0) < 16 * EPS  # products of 4 terms


@pytest.mark.parametrize("size", [0.0, 0.99e-4, 1.01e-4, 0.7])
def test_a_quaternion_turns_by_its_coordinates(size):
    """By an angle |z| about z on fixed axes, on both sides of the series' limit."""
    z = size * np.array([2.0, -1.0, 2.0]) / 3.0
    identity = Rotated(jnp.array([1.0, 0.0, 0.0, 0.0]))
    found = np.asarray(identity.value(jnp.asarray(z)))
    axis = np.array([2.0, -1.0, 2.0]) / 3.0
    expected = np.concatenate([[np.cos(size / 2)], np.sin(size / 2) * axis])
    # the series leaves |z|^4 / 384: 3e-19 at 1e-4
    np.testing.assert_allclose(found, expected, atol=8 * EPS)


TURN = np.array([0.8, 0.0, -0.6, 0.0])
DISC = np.diag([1.0, 1.0, 2.0])
SEEN = jnp.array([0.3, 0.6, -0.8])  # of which the last two may be a direction
TRANSFORMS = {
    "direction": Directions(jnp.array([0.0, 0.6, -0.8]), ((0, 3),)),
    "direction in a plane": Directions(SEEN, ((1, 3),)),
    "two directions": Directions(jnp.array([0.6, 0.8, 0.0, -1.0]), ((0, 2), (2, 4))),
    "across": Across(SEEN, jnp.array([0.0, 0.8, 0.6])),
    "plain": Plain(jnp.array([0.0, -3.0])),
    "positive": Positive(jnp.array([1e-9, 2.0])),
    "scaled": Scaled(jnp.array([0.0, -3.0])),
    "turned": Rotated(jnp.asarray(TURN)),
    "full": inertia_transform("I", jnp.asarray(ASKEW), None),
    "flat": inertia_transform("I", jnp.asarray(DISC), None),
    "diagonal": inertia_transform("I", jnp.asarray(DISC), "diagonal"),
    "ratios": inertia_transform("I", jnp.asarray(ASKEW), "ratios"),
}


@pytest.mark.parametrize("name", TRANSFORMS)
def test_every_value_has_its_coordinates(name):
    """However far it is from the given one: factors of e^6, turns of up to 3 rad."""
    transform = TRANSFORMS[name]
    random = np.random.default_rng(2)
    z0 = transform.start()
    given = np.asarray(transform.reference)
    np.testing.assert_array_equal(transform.coordinates(given), z0)
    for _ in range(20):
        most = 1.7 if "turn" in name or "direction" in name else 6.0
        z = z0 + random.uniform(-most, most, z0.size)
        value = np.asarray(transform.value(jnp.asarray(z)))
        # second moments e^24 times each other: of the less there are left
        # e^-24 / eps = 2e5 units, of which a few are off
        np.testing.assert_allclose(transform.coordinates(value), z, rtol=0, atol=1e-4)


NOWHERE = {
    "direction": [[0.0, 1.2, -1.6], np.zeros(3), np.full(3, np.nan)],
    "direction in a plane": [[0.3, 1.2, -1.6], [np.nan, 0.6, -0.8]],
    "plain": [[np.nan, 1.0], [np.inf, 1.0]],
    "positive": [[1.0, 0.0], [-1.0, 1.0], [np.inf, 1.0], [np.nan, 1.0]],
    "scaled": [[0.0, 3.0], [0.0, 0.0], [1.0, -3.0], [np.nan, np.nan]],
    "turned": [2.0 * TURN, np.zeros(4), np.full(4, np.nan)],
    "full": [np.diag([1.0, 1.0, 3.0]), ASKEW + np.eye(3, k=1), -ASKEW, DISC],
    "flat": [np.diag([1.0, 1.0, 1.9]), np.diag([1.0, 2.0, 1.0])],
    "diagonal": [np.diag([1.0, 1.0, 3.0]), DISC + 1e-3 * np.eye(3)[::-1]],
    "ratios": [2.0 * ASKEW, np.diag([1.0, 1.0, 3.0])],
}


@pytest.mark.parametrize("name", NOWHERE)
def test_what_no_parameter_can_be_has_no_coordinates(name):
    for value in NOWHERE[name]:
        assert np.isnan(TRANSFORMS[name].coordinates(np.asarray(value))).all()


ROUND = {
    "plane": rk.Plane(),
    "sphere": rk.Sphere(1.0, inside=True),
    "ellipsoid": rk.Ellipsoid((1.0, 0.9, 0.8)),
    "torus": rk.Torus(1.0, 0.3),
    "cylinder": rk.Cylinder(1.0),
    "rim": rk.DiscEdge(1.0),
    "ring": rk.Ring(1.0),
    "cone": rk.Cone(0.5, inside=True),
    "graph": rk.Graph(lambda x, y: 0.5 * (x * x + y * y)),
    "one pole": rk.Revolution(lambda s: jnp.stack([s, s * s]), domain=(0.0, 1.0)),
    "two poles": rk.Revolution(lambda s: jnp.stack([jnp.sin(s), jnp.cos(s)])),
    "by direction": rk.Parametric(lambda u: 0.3 * u, of_direction=True),
    "implicit": rk.Implicit(lambda x, y, z: x * x + 2.0 * y * y + 3.0 * z * z - 1.0),
}


@pytest.mark.parametrize("name", ROUND)
def test_contact_coordinates_have_no_spare_number(name):
    """Two move the point over the surface, or a rim's normal, and nothing else does."""
    surface = ROUND[name]
    u = jnp.asarray(surface.samples()[7])
    transform = _of_contact(surface, u) or Plain(u)
    z = jnp.asarray(transform.start())
    assert z.size == 2

    def placed(z):
        geometry = surface.geometry(transform.value(z))
        return jnp.concatenate([geometry.position, geometry.normal])

    np.testing.assert_allclose(transform.value(z), u, rtol=0, atol=16 * EPS)
    slopes = np.linalg.svd(jax.jacfwd(placed)(z), compute_uv=False)
    assert slopes[-1] > 0.1  # no radius here is above 2 m, nor below 0.1 m


def test_a_point_stays_on_its_surface():
    """A way of 0.2 m along the tangents of a surface with radii of a third and more."""
    surface = ROUND["implicit"]
    for u in np.asarray(surface.samples()[::100]):
        transform = OnSurface(jnp.asarray(u), surface)
        for z in ([0.2, 0.0], [-0.1, 0.15]):
            value = np.asarray(transform.value(jnp.array(z)))
            assert abs(surface.f(jnp.asarray(value))) < 16 * EPS  # sums of four terms
            np.testing.assert_allclose(transform.coordinates(value), z, atol=16 * EPS)
        assert np.isnan(transform.coordinates(1.1 * u)).all()


def test_both_quaternions_of_a_rotation_have_its_coordinates():
    transform = TRANSFORMS["turned"]
    value = np.asarray(transform.value(jnp.array([0.1, 0.2, -0.3])))
    for one in (value, -value):
        # a few products of four terms
        np.testing.assert_allclose(
            transform.coordinates(one), [0.1, 0.2, -0.3], atol=32 * EPS
        )


def test_every_quaternion_is_turned():
    """Whatever its field is called, and never one entry of it."""
    inner = rk.RollingBody(
        rk.Body(0.1, ASKEW, rk.Sphere(0.01)),
        rk.Sphere(0.03, inside=True),
        rotation=TURN,
    )
    base = rk.Base(rk.Plane(), rk.Spin(1.0, orientation=(1.0, 0.0, 0.0, 0.0)))
    scene = rk.Scene(SCENE.body, base, supported=inner)
    own = inner.place(TURN, (0.0, 0.0, 1.0), (0.0, 0.0, -0.03))
    start = rk.place(scene, TURN, (0.0, 0.0, 1.0), (0.0, 0.0, 0.0), supported=own)
    model = Model(scene, start, jnp.zeros(()), None, {})
    quaternions = [
        path
        for path in known_paths(model)
        if Layout([model], [rk.Free(path)]).entries[0].transform.reference.shape == (4,)
    ]
    assert quaternions == [
        "base.motion.orientation",
        "supported[0].rotation",
        "start.orientation",
        "start.supported[0].orientation",
    ]
    # where it touches: a pair in the plane, a direction in the ball
    for path in ("start.contact_on_base", "start.supported[0].contact_on_base"):
        assert Layout([model], [rk.Free(path)]).size == 2
    for path in quaternions:
        (entry,) = Layout([model], [rk.Free(path)]).entries
        assert type(entry.transform) is Rotated
        with pytest.raises(rk.FieldError, match="is only a part"):
            Layout([model], [rk.Free(f"{path}[1]")])


def test_masses_and_lengths_stay_positive():
    for path in ("body.mass", "body.surface.semi_axes"):
        entry = entry_of(rk.Free(path))
        z = entry.transform.start()
        assert (entry.at(z - 300.0).value > 0.0).all()
        known = np.ravel(np.asarray(known_value(path)))
        # exp(log(x)), x of 1e-2 to 1: log of up to 4 with a rounding of 4 eps
        np.testing.assert_allclose(np.ravel(entry.at(z).value), known, rtol=16 * EPS)


def known_value(path):
    return SCENE.body.mass if path.endswith("mass") else SCENE.body.surface.semi_axes


@pytest.mark.parametrize("name", slow_but(A_FEW, builtin_scenes()))
def test_every_number_that_is_offered_can_be_free(name):
    """And has the scene's value at the start."""
    file = load_scene(name)
    model = Model(file.scene, file.start, jnp.asarray(file.times[0]), None, {})
    offered = known_paths(model)
    assert {"body.mass", "body.inertia", "start.angular_velocity"} <= set(offered)
    for path in offered:
        layout = Layout([model], [rk.Free(path)])
        (entry,) = layout.entries
        _, model_after = entry, layout.model(0, layout.start)
        before, after = (jax.tree.leaves(m) for m in (model, model_after))
        for old, new in zip(before, after, strict=True):
            # as of an inertia and of a logarithm
            size = np.max(np.abs(np.asarray(old)), initial=0.0)
            np.testing.assert_allclose(new, old, rtol=0, atol=200 * EPS * size)


def test_entries_of_arrays():
    """A path may end in an array: only that entry moves."""
    layout = Layout([MODEL], [rk.Free("body.surface.semi_axes[1]")])
    axes = layout.model(0, layout.start + np.log(2.0)).scene.body.surface.semi_axes
    np.testing.assert_allclose(axes, [0.06, 0.1, 0.04], rtol=16 * EPS)


# Bounds, priors, ties

HELD = {
    "body.mass": (0.1, 2.0),
    "body.surface.semi_axes": (0.01, [0.06, 0.1, 0.1]),
    "loads[1].linear": (None, 3.0),
    "gyro.delay": (None, 0.1),
    "gyro.bias": (-1.0, None),
    "modes.friction": None,
    "modes.restitution": None,
}


@pytest.mark.parametrize("path", HELD)
def test_bounds_in_coordinates(path):
    """Those that were given and those of physics, at the edge and not beyond."""
    entry = entry_of(rk.Free(path, bounds=HELD[path]))
    given = (None, None) if HELD[path] is None else HELD[path]
    physics = {"modes.restitution": 1.0}.get(path, np.inf)
    least = 0.0 if "bias" not in path else -np.inf
    low, high = (
        x if g is None else g for g, x in zip(given, (least, physics), strict=True)
    )
    # exp(log(x)) as above
    for side, wanted in ((entry.lower, low), (entry.upper, high)):
        reached = np.ravel(entry.at(side).value)
        expected = np.ravel(np.broadcast_to(wanted, np.shape(entry.at(side).value)))
        np.testing.assert_allclose(reached, expected, rtol=16 * EPS)


def test_a_start_on_its_bounds_is_allowed():
    for low, high in ((0.5, 1.0), (0.1, 0.5)):
        entry = entry_of(rk.Free("body.mass", bounds=(low, high)))
        start = entry.transform.start()
        assert (start == entry.lower).any() or (start == entry.upper).any()


def test_ties_follow():
    """A body whose mass and size go with one length, and a bias with another."""
    free = [
        rk.Free("body.surface.semi_axes", form="scale"),
        rk.Tied("body.mass", lambda v: 4e3 * jnp.prod(v["body.surface.semi_axes"])),
        rk.Tied("gyro.bias", lambda v: v["body.surface.semi_axes"][0]),
    ]
    layout = Layout([MODEL], free)
    model = layout.model(0, layout.start + np.log(2.0))
    # products of three numbers with a few roundings each
    axes = 2.0 * np.array([0.06, 0.05, 0.04])
    np.testing.assert_allclose(model.scene.body.mass, 4e3 * axes.prod(), rtol=32 * EPS)
    np.testing.assert_allclose(model.channels["gyro"].bias, 3 * [0.12], rtol=32 * EPS)


def test_records_share_what_is_not_of_their_starts():
    other = MODEL._replace(channels={"pose": RECORD.channels["gyro"]})
    free = [
        rk.Free("body.mass"),
        rk.Free("start.angular_velocity"),
        rk.Free("loads[1].linear", shared=False),
        rk.Free("gyro.bias"),
        rk.Free("pose.bias", shared=False),
    ]
    layout = Layout([MODEL, other, MODEL], free)
    listed = [(e.free.path, e.record) for e in layout.entries]
    assert listed == [
        ("body.mass", None),
        *(("start.angular_velocity", k) for k in range(3)),
        *(("loads[1].linear", k) for k in range(3)),
        ("gyro.bias", None),
        ("pose.bias", 1),
    ]
    # 1 mass, 3 angular velocities, 3 drags, 3 + 3 biases
    assert layout.size == 1 + 9 + 3 + 3 + 3
    z = layout.start + np.arange(layout.size)
    assert np.isfinite(np.asarray(layout.model(1, z).scene.body.mass))
    first, second, third = (layout.model(k, z) for k in range(3))
    assert first.scene.body.mass == second.scene.body.mass == third.scene.body.mass
    np.testing.assert_array_equal(
        first.channels["gyro"].bias, third.channels["gyro"].bias
    )
    np.testing.assert_array_equal(second.channels["pose"].bias, z[-3:])
    rates = [np.asarray(m.start.angular_velocity) for m in (first, second, third)]
    assert len({tuple(r) for r in rates}) == 3


# Refusals

BAD_FREE = {
    "text": (lambda: "body.mass", "fit.free", "must be a parameter"),
    "nothing": (list, "free", "must hold parameters"),
    "a tie alone": (
        lambda: rk.Tied("body.mass", lambda v: 1.0),
        "free",
        "must hold parameters",
    ),
    "a number as path": (lambda: rk.Free(3), "Free.path", "must be text"),
    "no path": (lambda: rk.Free("body..mass"), "Free.path", "is not a path"),
    "empty": (lambda: rk.Free(""), "Free.path", "is not a path"),
    "a slip of the pen": (
        lambda: rk.Free("body.mas"),
        "Free.path",
        "did you mean 'body.mass'",
    ),
    "a channel's slip": (
        lambda: rk.Free("gyro.baias"),
        "Free.path",
        "did you mean 'gyro.bias'",
    ),
    "no such load": (lambda: rk.Free("loads[7].linear"), "Free.path", "is no number"),
    "no such channel": (lambda: rk.Free("force.bias"), "Free.path", "is no number"),
    "no modes": (lambda: rk.Free("modes.friction"), "Free.path", "is no number"),
    "a part of the scene": (
        lambda: rk.Free("body.surface"),
        "Free.path",
        "did you mean 'body.surface",
    ),
    "no such entry": (
        lambda: rk.Free("body.surface.semi_axes[3]"),
        "Free.path",
        "is no number",
    ),
    "samples": (lambda: rk.Free("gyro.values"), "Free.path", "is no number"),
    "noise": (lambda: rk.Free("gyro.sigma"), "Free.path", "is no number"),
    "twice": (
        lambda: [rk.Free("body.mass"), rk.Free("scene.body.mass")],
        "Free.path",
        "is there twice",
    ),
    "free and tied": (
        lambda: [rk.Free("body.mass"), rk.Tied("body.mass", lambda v: 1.0)],
        "Free.path",
        "is there twice",
    ),
    "an array and its entry": (
        lambda: [
            rk.Free("body.surface.semi_axes[0]"),
            rk.Free("body.surface.semi_axes"),
        ],
        "Free.path",
        "overlaps 'body.surface.semi_axes",
    ),
    "a part of an inertia": (
        lambda: rk.Free("body.inertia[0][1]"),
        "Free('body.inertia[0][1]')",
        "free 'body.inertia'",
    ),
    "a part of a quaternion": (
        lambda: rk.Free("start.orientation[2]"),
        "Free('start.orientation[2]')",
        "free 'start.orientation'",
    ),
    "form": (
        lambda: rk.Free("body.mass", form="round"),
        "Free('body.mass').form",
        "use one of",
    ),
    "diagonal of a mass": (
        lambda: rk.Free("body.mass", form="diagonal"),
        "Free('body.mass').form",
        "is of inertias",
    ),
    "diagonal of an askew inertia": (
        lambda: rk.Free("body.inertia", form="diagonal"),
        "Free('body.inertia')",
        "is not diagonal",
    ),
    "scale of zeros": (
        lambda: rk.Free("gyro.bias", form="scale"),
        "Free('gyro.bias')",
        "has no scale",
    ),
    "shared by half": (
        lambda: rk.Free("body.mass", shared=1),
        "Free('body.mass').shared",
        "True or False",
    ),
    "bounds of one": (
        lambda: rk.Free("body.mass", bounds=1.0),
        "Free('body.mass').bounds",
        "must be a pair",
    ),
    "bounds of three": (
        lambda: rk.Free("gyro.delay", bounds=(0.0, 0.1, 0.2)),
        "Free('gyro.delay').bounds",
        "must be a pair",
    ),
    "bounds out of order": (
        lambda: rk.Free("body.mass", bounds=(2.0, 0.1)),
        "Free('body.mass').bounds",
        "order them",
    ),
    "bounds NaN": (
        lambda: rk.Free("body.mass", bounds=(np.nan, 1.0)),
        "Free('body.mass').bounds",
        "order them",
    ),
    "bounds in words": (
        lambda: rk.Free("gyro.delay", bounds=("short", "long")),
        "Free('gyro.delay').bounds",
        "do not fit",
    ),
    "bounds of another shape": (
        lambda: rk.Free("gyro.bias", bounds=([0.0, 0.0], 1.0)),
        "Free('gyro.bias').bounds",
        r"shape \(3,\)",
    ),
    "bounds beside the start": (
        lambda: rk.Free("body.mass", bounds=(0.6, 1.0)),
        "Free('body.mass').bounds",
        "do not hold the start",
    ),
    "bounds of an inertia": (
        lambda: rk.Free("body.inertia", bounds=(0.0, 1.0)),
        "Free('body.inertia').bounds",
        "give a prior",
    ),
    "bounds of a scale": (
        lambda: rk.Free("body.mass", form="scale", bounds=(0.1, 1.0)),
        "Free('body.mass').bounds",
        "for plain numbers",
    ),
    "a delay longer than the record": (
        lambda: rk.Free("gyro.delay", bounds=(0.0, 1.0)),
        "gyro.delay",
        "leaves no samples",
    ),
    "a prior of one": (
        lambda: rk.Free("body.mass", prior=1.0),
        "Free('body.mass').prior",
        "must be a pair",
    ),
    "a prior without deviation": (
        lambda: rk.Free("body.mass", prior=(1.0, 0.0)),
        "Free('body.mass').prior",
        "a positive deviation",
    ),
    "a prior of a negative mass": (  # fitted by a mass of zero
        lambda: rk.Free("body.mass", prior=(-1.0, 0.1)),
        "Free('body.mass').prior",
        "only can be positive",
    ),
    "a prior of NaN": (
        lambda: rk.Free("body.mass", prior=(np.nan, 1.0)),
        "Free('body.mass').prior",
        "a finite mean",
    ),
    "a prior of another shape": (
        lambda: rk.Free("body.inertia", prior=(np.ones(2), 1.0)),
        "Free('body.inertia').prior",
        "does not fit",
    ),
    "a prior in words": (
        lambda: rk.Free("body.mass", prior=("heavy", 1.0)),
        "Free('body.mass').prior",
        "does not fit",
    ),
    "a tie to nothing": (
        lambda: [rk.Free("body.mass"), rk.Tied("body.weight", lambda v: 1.0)],
        "Free.path",
        "is no number",
    ),
    "a tie without function": (
        lambda: [rk.Free("body.mass"), rk.Tied("gyro.bias", 1.0)],
        "Tied('gyro.bias').value",
        "must be a function",
    ),
    "a tie to what is not free": (
        lambda: [rk.Free("body.mass"), rk.Tied("gyro.bias", lambda v: v["body.size"])],
        "Tied('gyro.bias').value",
        "use those of",
    ),
    "a tie of another shape": (
        lambda: [rk.Free("body.mass"), rk.Tied("gyro.bias", lambda v: jnp.ones(2))],
        "Tied('gyro.bias').value",
        r"numbers of shape \(3,\)",
    ),
    "a tied delay": (
        lambda: [rk.Free("body.mass"), rk.Tied("gyro.delay", lambda v: 0.01)],
        "Tied('gyro.delay').value",
        "free it, with bounds",
    ),
}


@pytest.mark.parametrize("name", BAD_FREE)
def test_parameters_that_are_refused(name):
    make, field, says = BAD_FREE[name]
    with pytest.raises(rk.FieldError, match=says) as caught:
        rk.fit(SCENE, START, RECORD, make())
    assert caught.value.field == field
    assert caught.value.remedy


FREE = rk.Free("body.inertia")
BAD_FITS = {
    "a body": ((SCENE.body, START, RECORD, FREE), {}, "fit.scene", "must be a Scene"),
    "an array": ((SCENE, START, TIMES, FREE), {}, "fit.record", "must be a Record"),
    "a rate": ((SCENE, np.ones(3), RECORD, FREE), {}, "fit.start", "must be a State"),
    "one start of two": (
        (SCENE, START, [RECORD, RECORD], FREE),
        {},
        "fit.start",
        "one start for each record",
    ),
    "no record": ((SCENE, [], [], FREE), {}, "fit.record", "is missing"),
    "loss": (
        (SCENE, START, RECORD, FREE),
        {"loss": "absolute"},
        "fit.loss",
        "use one of",
    ),
    "strategy": (
        (SCENE, START, RECORD, FREE),
        {"strategy": "fast"},
        "fit.strategy",
        "use one of",
    ),
    "no guess": ((SCENE, START, RECORD, FREE), {"starts": 0}, "fit.starts", "at least"),
    "seed": (
        (SCENE, START, RECORD, FREE),
        {"starts": 2, "seed": -1},
        "fit.seed",
        "whole number",
    ),
    "no points": (
        (SCENE, START, RECORD, FREE),
        {"max_evaluations": 0},
        "fit.max_evaluations",
        "at least",
    ),
    "spread": (
        (SCENE, START, RECORD, FREE),
        {"starts": 3, "spread": -0.1},
        "fit.spread",
        "negative",
    ),
    "modes": (
        (SCENE, START, RECORD, FREE),
        {"modes": "all"},
        "simulate.modes",
        "must be Modes",
    ),
    "method": (
        (SCENE, START, RECORD, FREE),
        {"method": "fast"},
        "simulate.method",
        "native",
    ),
}


@pytest.mark.parametrize("name", BAD_FITS)
def test_fits_that_are_refused(name):
    given, options, field, says = BAD_FITS[name]
    with pytest.raises(rk.FieldError, match=says) as caught:
        rk.fit(*given, **options)
    assert caught.value.field == field


def test_parameters_of_several_functions_have_one_name_at_a_time():
    spring = rk.PointMasses(
        0.1,
        lambda a, p: p["k"] * jnp.stack([a[0], 0.0 * a[0], 0.0 * a[0]])[None],
        potential=lambda a, p: p["k"] * a[0] ** 2,
        parameters={"k": 2.0},
    )
    scene = rk.Scene(SCENE.body, supported=spring)
    model = Model(scene, START, jnp.zeros(()), None, {})
    one, other = (f"supported[0].{name}parameters.k" for name in ("", "position."))
    assert [x for x in known_paths(model) if x.startswith("supp")][-1] == one
    with pytest.raises(rk.FieldError, match="is there twice"):
        Layout([model], [rk.Free(one), rk.Free(other)])


@pytest.mark.parametrize("delay", [None, -0.02])
def test_a_record_longer_than_the_base_is_known(delay):
    """By the last sample, or by what the least delay puts behind it."""
    clock = np.linspace(0.0, 0.51 if delay else 0.4, 52)
    motion = rk.RecordedMotion(clock, np.zeros(52))
    scene = scene_of(base=rk.Base(rk.Plane(), motion))
    free = FREE if delay is None else rk.Free("gyro.delay", bounds=(delay, 0.02))
    with pytest.raises(rk.FieldError, match=r"within the record of Base\.motion"):
        rk.fit(scene, START, RECORD, free)
    with pytest.raises(rk.FieldError, match=r"within the record of Base\.motion"):
        rk.identifiability(scene, START, RECORD, free)


def test_a_function_asks_for_parameters_of_its_owner():
    spring = rk.PointMasses(
        0.1,
        lambda a, p: p["k"] * jnp.stack([a[0], 0.0 * a[0], 0.0 * a[0]])[None],
        parameters={"k": 2.0},
    )
    alpha = jnp.asarray([0.5])
    place = spring.position(alpha, spring.parameters)
    np.testing.assert_array_equal(place, [[1.0, 0.0, 0.0]])
    with pytest.raises(rk.FieldError, match=r"part\.position\(alpha, part\.param"):
        spring.position(alpha)
