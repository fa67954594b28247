"""Bodies that are in their base elsewhere, and runs that reach it a second time."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk
from rollkane.dynamics import clearance
from rollkane.geometry.surfaces import AbstractSurface

from .. import outputs_alone
from ..quick import slow_but

LEVEL = (1.0, 0.0, 0.0, 0.0)
STILL = (0.0, 0.0, 0.0)
INERTIA = 0.01 * np.eye(3)
UPRIGHT = (np.cos(np.pi / 4), np.sin(np.pi / 4), 0.0, 0.0)


def scene(body, base):
    return rk.Scene(rk.Body(1.0, INERTIA, body), rk.Base(base))


def peanut(d):
    return (0.6 + 0.35 * (2.0 * d[2] ** 2 - 1.0)) * d


BOWL = rk.Revolution(lambda s: (s, 2.0 * s * s), domain=(0.0, 1.5), inside=True)
WIDE = rk.Graph(lambda x, y: 0.1 * (1.0 - jnp.cos(5.0 * x)))
clearance_of = jax.jit(clearance.clearance)


def about_y(angle):
    return (np.cos(angle / 2), 0.0, np.sin(angle / 2), 0.0)


def across_the_bowl() -> float:
    """How deep an egg that stands on one wall of BOWL is in the other one [m].

    Both in their plane of symmetry, by points: of the egg's far end, whose distance
    from the nearest point of the wall is largest where they are farthest in.
    """
    along = np.array([-2.0, 0.0, 1.0])[[0, 2]] / np.sqrt(5.0)  # out of the wall
    across = np.array([along[1], -along[0]])
    t = np.linspace(-0.6, 0.6, 2001)[:, None]
    origin = np.array([0.5, 0.5]) + 0.9 * along
    egg = origin + 0.9 * np.cos(t) * along + 0.2 * np.sin(t) * across
    x = np.linspace(-1.2, -0.4, 8001)
    wall = np.stack([x, 2.0 * x * x], axis=1)
    outside = egg[:, 1] < 2.0 * egg[:, 0] ** 2
    away = egg[outside][:, None] - wall[None]
    return float(np.sqrt((away**2).sum(-1).min(1).max()))


# the body's z to the wall's normal (-2, 0, 1); its x up; its x along a slope
ON_THE_WALL = about_y(-np.arctan(2.0))
ON_END = about_y(-np.pi / 2)
SLOPE = about_y(-np.arctan(0.5 * np.sin(1.75)))
# depths with their certainty: where the base tells distances (a torus) to 2e-5 of the
# distance of samples (0.1 m); else of first order in a depth that is not small
DEEP = {
    # an egg across a bowl that is narrower than it is long
    "egg in a paraboloid": (
        scene(rk.Ellipsoid((0.2, 0.2, 0.9)), BOWL),
        ON_THE_WALL,
        (0.5, 0.0, 0.5),
        (across_the_bowl(), 0.35),
    ),
    # on end: 0.6 m high in a tube that is 0.4 m wide
    "egg inside a torus": (
        scene(rk.Ellipsoid((0.3, 0.05, 0.05)), rk.Torus(1.0, 0.2, inside=True)),
        ON_END,
        (1.0, 0.0, -0.2),
        (0.2, 1e-3),
    ),
    # standing: 0.4 m in 0.36 m
    "torus within a torus": (
        scene(rk.Torus(0.15, 0.05), rk.Torus(1.0, 0.18, inside=True)),
        ON_END,
        (1.0, 0.0, -0.18),
        (0.04, 1e-3),
    ),
    "peanut in a ball": (
        scene(rk.Parametric(peanut, of_direction=True), rk.Sphere(0.7, inside=True)),
        UPRIGHT,
        (0.0, 0.0, -0.7),
        None,
    ),
    # down a slope, through the trough and into the next hill
    "rod across hills": (
        scene(rk.Ellipsoid((1.0, 0.03, 0.03)), WIDE),
        SLOPE,
        (0.35, 0.0, 0.1 * (1.0 - np.cos(1.75))),
        None,
    ),
}


@pytest.mark.parametrize("name", slow_but(["torus within a torus"], DEEP))
def test_a_body_that_is_in_its_base_elsewhere_is_refused(name):
    pair, turned, at, depth = DEEP[name]
    with pytest.raises(rk.FieldError, match="puts the body into the base") as caught:
        rk.place(pair, turned, STILL, at)
    assert caught.value.field == "place.contact_on_base"
    allowed = rk.place(pair, turned, STILL, at, allow_overlap=True)
    found = clearance_of(pair, jnp.zeros(()), allowed)
    assert found.gap < -2e-3
    if depth is not None:
        np.testing.assert_allclose(-found.gap, depth[0], rtol=depth[1])


def test_traced_members_fail_alone():
    pair, turned, at, _ = DEEP["egg inside a torus"]
    placed = jax.jit(jax.vmap(lambda at: rk.place(pair, turned, STILL, at)))
    # beside it one that misses the base
    lost = placed(jnp.asarray([at, (1.0, 0.0, 0.0)]))
    assert np.isnan(np.asarray(lost.orientation)).all()
    level = jax.jit(lambda q: rk.place(pair, q, STILL, at, allow_overlap=True))
    assert np.isfinite(np.asarray(level(jnp.asarray(turned)).orientation)).all()


CLEAR = {
    "small egg in a paraboloid": (
        scene(rk.Ellipsoid((0.05, 0.05, 0.1)), BOWL),
        UPRIGHT,
        (0.0, 0.0, 0.0),
    ),
    "ball in a pipe": (
        scene(rk.Sphere(0.19), rk.Cylinder(0.2, inside=True)),
        LEVEL,
        (0.2, 0, 0),
    ),
    "ball that almost fits": (
        scene(rk.Sphere(0.1999998), rk.Sphere(0.2, inside=True)),
        LEVEL,
        (0.0, 0.0, -0.2),
    ),
    "ball on a hoop": (scene(rk.Sphere(0.1), rk.Ring(0.5)), LEVEL, (0.5, 0.0, 0.0)),
    "shell round a ball": (
        scene(rk.Sphere(0.5, inside=True), rk.Sphere(0.2)),
        LEVEL,
        (0.0, 0.0, 0.2),
    ),
}


@pytest.mark.parametrize("name", CLEAR)
def test_a_body_that_is_clear_is_accepted(name):
    pair, turned, at = CLEAR[name]
    start = rk.place(pair, turned, STILL, at)
    found = clearance_of(pair, jnp.zeros(()), start)
    # it touches: least is the contact itself, to rounding
    assert abs(float(found.gap)) < 1e-12


def waves(x, y):
    crossed = 0.03 * jnp.sin(12.0 * x) + 0.03 * jnp.cos(9.6 * y + 1.0)
    return crossed + 0.015 * jnp.sin(23.0 * x + 5.0 * y)


def test_a_second_place_in_the_valley_of_the_first_is_found():
    """A ball in waves that nearly fit it: its other place is half a radius away."""
    x, y = -1.2071, 0.3787
    wavy = scene(rk.Sphere(0.1), rk.Graph(waves))
    turns = np.random.default_rng(7).normal(size=(40, 4))
    turns /= np.linalg.norm(turns, axis=1)[:, None]
    where = jnp.stack([x, y, waves(x, y)])

    def gap_of(turn):
        start = rk.place(wavy, turn, STILL, where, allow_overlap=True)
        return clearance.clearance(wavy, jnp.zeros(()), start).gap

    slopes = np.array(jax.grad(waves, (0, 1))(x, y))
    normal = np.append(-slopes, 1.0) / np.sqrt(1.0 + slopes @ slopes)
    other = jnp.array([-1.25520836, 0.37011984])  # nearest to its middle, to 1e-7 m
    way = np.append(other, waves(*other)) - (np.array(where) + 0.1 * normal)
    depth = 0.1 - float(np.linalg.norm(way))
    assert depth > 5e-5
    gaps = jax.jit(jax.vmap(gap_of))(turns)
    # a search ends beside the place along a valley of curvature 0.1 / m or so by less
    # than 1e-3 m, 5e-8 m of depth; where the place was missed gaps were zero
    np.testing.assert_allclose(gaps, -depth, rtol=1e-3)


def test_two_convex_bodies_are_not_looked_at():
    for body in (rk.Sphere(0.1), rk.Ellipsoid((0.1, 0.2, 0.3)), rk.DiscEdge(0.1)):
        for base in (rk.Plane(), rk.Sphere(2.0), rk.Cylinder(1.0), rk.Cone(-1.0, True)):
            assert not clearance.may_touch_twice(scene(body, base))
    assert clearance.may_touch_twice(scene(rk.Sphere(0.1), rk.Cone(1.0, inside=True)))
    for body in (rk.Ring(0.1), rk.Torus(0.1, 0.02)):  # on a plane as their hulls
        assert not clearance.may_touch_twice(scene(body, rk.Plane()))
        assert clearance.may_touch_twice(scene(body, rk.Sphere(2.0)))
    tube = rk.Torus(0.1, 0.02, inside=True)
    assert clearance.may_touch_twice(scene(tube, rk.Plane()))


SURFACES: dict[str, AbstractSurface] = {
    "sphere": rk.Sphere(0.7, (0.1, 0.2, 0.0)),
    "torus": rk.Torus(0.7, 0.2),
    "cylinder": rk.Cylinder(0.7),
    "pipe": rk.Cylinder(0.7, inside=True),
    "cone": rk.Cone(0.7),
    "funnel": rk.Cone(0.7, inside=True),
    "tube": rk.Revolution(
        lambda s: (0.7 + 0.2 * jnp.cos(s), 0.2 * jnp.sin(s)), domain=(0, 2 * np.pi)
    ),
    "ball": rk.Revolution(lambda s: (0.7 * jnp.sin(s), -0.7 * jnp.cos(s))),
    "direction": rk.Parametric(lambda d: 0.7 * d, of_direction=True),
    "chart": rk.Parametric(
        lambda a, b: (
            0.7
            * jnp.stack([jnp.cos(a) * jnp.cos(b), jnp.sin(a) * jnp.cos(b), jnp.sin(b)])
        )
    ),
}


@pytest.mark.parametrize("name", SURFACES)
def test_signed_distances(name):
    """A point off a surface, along its normal, is as far from it as it was moved."""
    surface = SURFACES[name]
    draw = np.random.default_rng(3)
    low, high = np.array(surface.chart_domain).T
    # away from tips, poles and seams
    q = low + (high - low) * draw.uniform(0.2, 0.8, (20, 2))
    away = draw.uniform(-0.1, 0.1, 20)

    def moved(q, away):
        place = surface.chart_geometry(q)
        return place.position + away * place.normal

    points = jax.vmap(moved)(jnp.asarray(q), jnp.asarray(away))
    found = jax.vmap(surface.signed_distance)(points)
    # nearest points by Newton's steps on a known function: to 1e-9 of a length
    np.testing.assert_allclose(found, away, rtol=0, atol=1e-9)


@pytest.mark.parametrize("name", ["ellipsoid", "graph", "implicit"])
def test_distances_of_first_order(name):
    """Right on the surface, of the right sign anywhere, and twice as far is twice."""
    surface = {
        "ellipsoid": rk.Ellipsoid((0.7, 0.5, 0.4)),
        "graph": rk.Graph(lambda x, y: 0.3 * jnp.sin(2.0 * x) * y),
        "implicit": rk.Implicit(lambda x, y, z: x * x + 2 * y * y + 3 * z**4 - 0.1),
    }[name]
    u = jnp.asarray(surface.samples())[7:300:23]
    place = jax.vmap(surface.geometry)(u)
    for away in (-1e-5, 1e-5):
        points = place.position + away * place.frame[:, :, 2]
        found = jax.vmap(surface.signed_distance)(points)
        # off by half the curvature, up to 20 per metre, times its square
        np.testing.assert_allclose(found, away, rtol=0, atol=1e-8)


def hill(x, y):
    return 0.25 * jnp.exp(-((x - 1.0) ** 2 + y * y) / 0.002)


def reaches_the_post() -> float:
    """Where a ball of 0.1 m that rolls along the plane touches the hill's foot [m]."""
    angle = np.linspace(0.3, np.pi / 2, 20001)  # from its lowest point, forwards
    low, high = 0.5, 1.0
    for _ in range(40):
        x = 0.5 * (low + high)
        p, z = x + 0.1 * np.sin(angle), 0.1 - 0.1 * np.cos(angle)
        inside = (z < 0.25 * np.exp(-((p - 1.0) ** 2) / 0.002)).any()
        low, high = (low, x) if inside else (x, high)
    return low


@pytest.mark.parametrize("way", slow_but(["steps"], ["steps", "modes"]))
def test_a_run_ends_where_its_body_reaches_the_base_again(way):
    """A ball rolls at a thin post, whose foot is sharper than the ball."""
    pair = scene(rk.Sphere(0.1), rk.Graph(hill))
    start = rk.place(pair, LEVEL, (0.0, 5.0, 0.0), STILL)
    options: dict = {"modes": rk.Modes(friction=9.0)} if way == "modes" else {}
    run = rk.simulate(pair, start, [0.0, 2.0], second_contact=True, **options)
    assert run.code == rk.Code.SECOND_CONTACT
    assert "second place" in run.reason
    assert (run.method, run.why) == ("native", "")
    # at 0.5 m/s on what is flat: where it touches the plane, the hill is lower than
    # 0.25 exp(-0.1^2 / 0.002) = 1.7 mm, which lifts the ball and slows it: 1 mm
    where = reaches_the_post()
    assert 0.85 < where < 0.95
    np.testing.assert_allclose(0.5 * float(run.final_time), where, rtol=0, atol=2e-3)
    final = run.final_state.parts if way == "modes" else run.final_state
    found = clearance_of(pair, run.final_time, final)
    # a ball of 0.1 m is allowed 1e-10 m
    assert -1.1e-10 < found.gap < 0.0


def to_its_post(radius, reach, speed, method="native"):
    """How a ball ends that rolls at a post at a distance."""
    hill_there = lambda x, y: hill(x + 1.0 - reach, y)
    pair = scene(rk.Sphere(radius), rk.Graph(hill_there))
    start = rk.place(pair, LEVEL, jnp.array([0.0, 1.0, 0.0]) * speed, STILL)
    found = rk.simulate(pair, start, [0.0, 1.0], second_contact=True, method=method)
    return found.final_time, found.code, found.final_state, found.steps


@pytest.mark.slow
def test_a_batch_of_runs_at_a_second_place_is_each_alone():
    """Balls of their own at posts of their own, of which some are reached."""
    given = jnp.array([[0.1, 0.5, 5.0], [0.09, 2.0, 4.0], [0.12, 0.45, 4.5]]).T
    times, codes, states, steps = jax.jit(jax.vmap(to_its_post))(*given)
    assert codes.tolist() == [10, 0, 10]  # SECOND_CONTACT, COMPLETED
    one = jax.jit(to_its_post)
    for i in range(3):
        alone = one(*given[:, i])
        # to the last bit, as all native runs
        assert (times[i], codes[i], steps[i]) == (alone[0], alone[1], alone[3])
        pairs = zip(jax.tree.leaves(states), jax.tree.leaves(alone[2]), strict=True)
        assert all((a[i] == b).all() for a, b in pairs)


@pytest.mark.slow
def test_second_places_by_both_loops_and_of_ensembles():
    pair = scene(rk.Sphere(0.1), rk.Graph(hill))
    speeds = jnp.array([[0.0, 5.0, 0.0], [0.0, 2.0, 0.0]])
    starts = jax.vmap(lambda w: rk.place(pair, LEVEL, w, STILL))(speeds)
    runs = rk.ensemble(pair, starts, [0.0, 2.0], second_contact=True)
    assert (runs.method, runs.code.tolist()) == ("native", [10, 0])
    # both end between the touch and the 1e-9 of the size that are allowed, 1e-10 m:
    # less than 1e-9 s apart at some 0.5 m/s towards a post that stands upright
    one, other = (to_its_post(0.1, 0.5, 5.0, way) for way in ("native", "diffrax"))
    assert one[1] == other[1] == rk.Code.SECOND_CONTACT
    np.testing.assert_allclose(other[0], one[0], rtol=0, atol=1e-9)


@pytest.mark.slow
def test_derivatives_where_a_second_place_is_looked_for():
    """Looking changes no step of a run that reaches none, nor its derivatives."""
    pair = scene(rk.Ellipsoid((0.1, 0.15, 0.12)), rk.Graph(hill))

    def height(speed, **options):
        start = rk.place(pair, LEVEL, jnp.array([0.3, 1.0, 0.1]) * speed, STILL)
        run = rk.simulate(pair, start, [0.0, 0.5], **options)
        return run.position[-1, 2]

    looks = jax.value_and_grad(height)(2.0, second_contact=True)
    assert looks == jax.value_and_grad(height)(2.0)


@pytest.mark.slow
@pytest.mark.parametrize("looks", [True, False])
def test_a_flight_that_ends_at_two_places(looks):
    """A rod falls across two humps: its ends arrive first, and both at once."""
    base = rk.Graph(lambda x, y: 0.3 * x * x + 0.0 * y)
    rod = scene(rk.Ellipsoid((0.6, 0.05, 0.05)), base)
    up = rk.release(rod, LEVEL, STILL, (0.0, 0.0, 0.3), STILL)
    modes = rk.Modes(friction=0.5, restitution=0.2)
    run = rk.simulate(rod, up, [0.0, 0.5], modes=modes, second_contact=looks)
    assert run.code == rk.Code.SECOND_CONTACT
    assert run.method == "native"
    # the rod's lower side, z = h - 0.05 sqrt(1 - (x / 0.6)^2), over 0.3 x^2
    x = np.linspace(-0.6, 0.6, 200001)
    drop = 0.3 - (0.3 * x * x + 0.05 * np.sqrt(1.0 - (x / 0.6) ** 2)).max()
    when = np.sqrt(2.0 * drop / 9.81)
    np.testing.assert_allclose(run.final_time, when, rtol=0, atol=1e-7)


@pytest.mark.slow
def test_random_placements_are_clear_or_refused():
    """As the whole class is tried from outside: 19 of 192 were in their base."""
    draw = np.random.default_rng(5)
    cases = [("egg", "bowl"), ("torus", "tyre"), ("ellipsoid", "hills")]
    accepted = 0
    for body, base in cases:
        pair = outputs_alone.scene_of("rolling", body, base, "rest")
        shape, ground = outputs_alone.BODIES[body][1], outputs_alone.BASES[base][1]
        for _ in range(25):
            q = draw.normal(size=4)
            at = outputs_alone.BASES[base][2](*draw.uniform(-0.9, 0.9, 2))
            turned = q / np.linalg.norm(q)
            try:
                start = rk.place(pair, turned, STILL, at)
            except rk.FieldError:
                continue
            accepted += 1
            R = outputs_alone._matrices(turned[None])[0]
            contact = rk.contact_of(pair, jnp.zeros(()), start)
            points = np.asarray(contact.position) + shape.points @ R.T
            # of 3,000 points; a contact that is off by a rounding of half the digits
            assert ground.level(points).min() > -2e-6
    assert accepted > 20
