"""Where a surface ends, and a contact must not jump: discs, wires, tips, cups."""

import diffrax as dfx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk

from ..quick import slow_but

LEVEL = (1.0, 0.0, 0.0, 0.0)
UPRIGHT = (np.sqrt(0.5), np.sqrt(0.5), 0.0, 0.0)
STILL = (0.0, 0.0, 0.0)
ORIGIN = (0.0, 0.0, 0.0)
TILT = 0.6  # rad, of a disc over its plane
TILTED = (np.cos(TILT / 2), np.sin(TILT / 2), 0.0, 0.0)
DISC_INERTIA = np.diag([0.0625, 0.0625, 0.125])  # a thin disc of 1 kg and 0.5 m
ROUND = 0.004 * np.eye(3)  # a ball of 1 kg and 0.1 m
BALL = rk.Body(1.0, ROUND, rk.Sphere(0.1))
HILL = rk.Base(rk.Sphere(2.0, (0.0, 0.0, -2.0)))


def disc(surface, base=None, **options):
    scene = rk.Scene(rk.Body(1.0, DISC_INERTIA, surface), base)
    return scene, rk.place(scene, TILTED, options.pop("spin", STILL), ORIGIN, **options)


def no_jump(run, times):
    """The body's origin never moves faster than its own velocity says."""
    reached = np.isfinite(np.asarray(run.energy))
    places, w = np.asarray(run.position)[reached], np.asarray(run.angular_velocity)
    steps = np.linalg.norm(np.diff(places, axis=0), axis=1)
    # no point of the body is farther than 0.6 m from the contact
    fastest = 0.6 * np.linalg.norm(w[reached], axis=1).max()
    assert (steps <= 1.5 * fastest * np.diff(np.asarray(times)[reached]) + 1e-12).all()


def falls_flat(inertia: float, radius: float, tilt: float) -> float:
    """Time in which a disc that stands still on its rim falls flat [s].

    Without spin it turns about its lowest point: I' th'^2 / 2 = m g a (sin th0 - sin
    th), with I' = I + m a^2; by 200 points of Gauss and Legendre in u = sqrt(th0 - th),
    in which the square root at the start is smooth.
    """
    x, weight = np.polynomial.legendre.leggauss(200)
    end = np.sqrt(tilt)
    u, weight = 0.5 * end * (x + 1.0), 0.5 * end * weight
    fall = np.sin(tilt) - np.sin(tilt - u * u)
    speed = np.sqrt(2.0 * 9.81 * radius * fall / (inertia + radius**2))
    return float(np.sum(weight * 2.0 * u / speed))


WAYS = {
    "diffrax": {"method": "diffrax"},
    "native": {"method": "native"},
    "Voronets": {"coordinates": "voronets"},
    "twin": {"formulation": "euler_lagrange", "coordinates": "voronets"},
    "modes": {"modes": rk.Modes(friction=50.0)},
    "user's steps": {"stepsize_controller": dfx.ConstantStepSize(), "dt0": 1e-3},
}


@pytest.mark.parametrize(
    "way", slow_but(["diffrax", "native", "modes", "user's steps"], WAYS)
)
def test_a_disc_that_falls_straight_stops_when_it_lies(way):
    """Past flat it would touch with the other side of its rim, a metre away."""
    scene, start = disc(rk.DiscEdge(0.5))
    times = np.linspace(0.0, 0.5, 51)
    run = rk.simulate(scene, start, times, **WAYS[way])
    when = falls_flat(0.0625, 0.5, TILT)
    assert run.code == rk.Code.SURFACE_EDGE
    assert "lie on its face" in run.reason
    if way == "user's steps":  # they cannot be shortened: it ends a step before
        assert when - 1.1e-3 < run.final_time < when
    else:
        # default tolerance 1e-9 of a motion of 0.3 s that ends at 2.5 rad/s
        np.testing.assert_allclose(run.final_time, when, rtol=0, atol=1e-8)
    no_jump(run, times)


@pytest.mark.parametrize("way", ["diffrax", "native", "modes"])
def test_a_start_from_which_no_step_can_be_taken_is_shown(way):
    """A disc within roundings of its face: the first output is the time it reached."""
    scene, _ = disc(rk.DiscEdge(0.5))
    start = rk.place(scene, (1.0, 5e-13, 0.0, 0.0), (0.1, 0.2, 0.3), ORIGIN)
    run = rk.simulate(scene, start, [0.0, 0.5], **WAYS[way])
    assert run.code == rk.Code.SURFACE_EDGE
    assert run.final_time == 0.0
    for quantity in ("orientation", "angular_velocity"):
        first, second = np.asarray(getattr(run.state, quantity))
        np.testing.assert_array_equal(first, getattr(run.final_state, quantity))
        assert np.isnan(second).all()
    np.testing.assert_array_equal(run.final_state.orientation, start.orientation)


@pytest.mark.parametrize("surface", [rk.Ring(0.5), rk.Torus(0.45, 0.05)])
def test_on_a_plane_wires_and_tyres_lie_flat_too(surface):
    scene, start = disc(surface)
    times = np.linspace(0.0, 0.5, 51)
    run = rk.simulate(scene, start, times)
    assert run.code == rk.Code.SURFACE_EDGE
    no_jump(run, times)


def test_members_of_an_ensemble_lie_down_at_their_own_times():
    scene, _ = disc(rk.DiscEdge(0.5))
    tilts = jnp.asarray([0.3, 0.6, 0.9])

    def fallen(tilt):
        q = jnp.stack([jnp.cos(tilt / 2), jnp.sin(tilt / 2), 0.0 * tilt, 0.0 * tilt])
        return rk.place(scene, q, STILL, ORIGIN)

    runs = rk.ensemble(scene, jax.vmap(fallen)(tilts), [0.0, 1.0], method="native")
    assert (runs.code == rk.Code.SURFACE_EDGE).all()
    wanted = [falls_flat(0.0625, 0.5, float(tilt)) for tilt in tilts]
    np.testing.assert_allclose(runs.final_time, wanted, rtol=0, atol=1e-8)


@pytest.mark.slow
def test_on_a_hill_a_disc_stops_and_a_wire_goes_round():
    """The same motion until the disc would pass on to its face."""
    spin = (0.3, 0.2, 1.0)
    times = np.linspace(0.0, 0.6, 121)
    runs = []
    for surface in (rk.DiscEdge(0.5), rk.Ring(0.5)):
        scene, start = disc(surface, HILL, spin=spin)
        runs.append(rk.simulate(scene, start, times, rtol=1e-11))
        no_jump(runs[-1], times)
    solid, wire = runs
    assert solid.code == rk.Code.SURFACE_EDGE
    assert wire.code == rk.Code.COMPLETED
    assert 0.1 < solid.final_time < 0.5
    both = times < float(solid.final_time)
    # rtol 1e-11 in two kinds of coordinates, next to a place where one is singular
    np.testing.assert_allclose(
        solid.position[both], wire.position[both], rtol=0, atol=1e-8
    )
    # round the wire: in the disc's plane, its normal away from the axis and back to it
    lean = np.asarray(wire.state.contact_on_body)
    cosine = lean[:, 2] / np.hypot(lean[:, 2], lean[:, 3])
    assert cosine[0] > 0.5
    assert cosine.min() < -0.1
    # the energy of a run at rtol 1e-11: 12 J, 200 steps
    np.testing.assert_allclose(wire.energy, wire.energy[0], rtol=1e-9)
    # nearly flat its contact whips round, but it never jumps to another side
    fine = rk.simulate(scene, start, np.linspace(0.0, 0.6, 2401), rtol=1e-11)
    steps = np.linalg.norm(np.diff(np.asarray(fine.contact_on_body), axis=0), axis=1)
    assert (steps[1:-1] < 1.5 * np.maximum(steps[:-2], steps[2:])).all()


def test_a_wire_starts_flat_where_it_is_told_to():
    scene = rk.Scene(rk.Body(1.0, DISC_INERTIA, rk.Ring(0.5)), HILL)
    with pytest.raises(rk.FieldError, match="near_on_body"):
        rk.place(scene, LEVEL, STILL, ORIGIN)
    start = rk.place(scene, LEVEL, STILL, ORIGIN, near_on_body=(0.0, 0.3, 0.0))
    run = rk.simulate(scene, start, [0.0, 0.1])
    np.testing.assert_allclose(run.contact_on_body[0], [0.0, 0.5, 0.0], atol=1e-15)
    assert run.succeeded


@pytest.mark.parametrize("method", ["diffrax", "native"])
@pytest.mark.parametrize("coordinates", ["pole-free", "voronets"])
@pytest.mark.parametrize("aside", [0.0, 1e-9])
def test_a_ball_stops_at_a_tip(coordinates, method, aside):
    """Straight up a cone, and next to straight: the normal would turn at once."""
    scene = rk.Scene(BALL, rk.Base(rk.Cone(-0.3, inside=True)))
    # the ball's own contact goes round its equator, away from its chart's poles
    start = rk.place(scene, UPRIGHT, (aside, 60.0, 0.0), (-0.5, 0.0, -0.15))
    times = np.linspace(0.0, 0.2, 41)
    run = rk.simulate(
        scene, start, times, coordinates=coordinates, method=method, rtol=1e-10
    )
    where = {rk.Code.SURFACE_EDGE, rk.Code.CHART_EDGE}
    assert int(run.code) in where
    # v' = -g sin(beta) 5/7 up the slope, v = 6 m/s, over 0.5 / cos(beta)
    beta = np.arctan(0.3)
    a, v, way = 9.81 * np.sin(beta) * 5 / 7, 6.0, 0.5 / np.cos(beta)
    when = (v - np.sqrt(v * v - 2 * a * way)) / a
    # charts end a thousandth of their size before the tip
    close = 1e-8 if coordinates == "pole-free" else 1e-3
    np.testing.assert_allclose(run.final_time, when, rtol=0, atol=close)
    no_jump(run, times)


@pytest.mark.parametrize("way", slow_but(["native"], ["diffrax", "native", "modes"]))
def test_a_ball_stops_at_the_rim_of_a_cup(way):
    cup = rk.Revolution(lambda s: (s, s * s), domain=(0.0, 1.0), inside=True)
    scene = rk.Scene(BALL, rk.Base(cup))
    start = rk.place(scene, LEVEL, (0.0, 80.0, 0.0), ORIGIN)
    run = rk.simulate(scene, start, np.linspace(0.0, 1.0, 101), **WAYS[way])
    assert run.code == rk.Code.SURFACE_EDGE
    reached = np.isfinite(np.asarray(run.energy))
    radius = np.hypot(*np.asarray(run.contact_on_base)[reached, :2].T)
    assert 0.9 < radius.max() <= 1.0
    # the last state is on the rim, as near as a step of the clock
    end = (
        np.hypot(*np.asarray(run.final_state.parts.contact_on_base))
        if (way == "modes")
        else np.hypot(*np.asarray(run.final_state.contact_on_base))
    )
    np.testing.assert_allclose(end, 1.0, rtol=0, atol=1e-9)


@pytest.mark.slow
def test_a_ball_goes_round_a_hoop_and_stops_on_the_edge_of_a_plate():
    """From above over the wire to its inner side, or on to the plate."""
    times = np.linspace(0.0, 0.8, 161)
    runs = []
    for surface in (rk.Ring(0.5), rk.DiscEdge(0.5)):
        scene = rk.Scene(BALL, rk.Base(surface))
        lean = 1.2
        out = (np.cos(lean), 0.0, np.sin(lean))
        start = rk.place(scene, LEVEL, (0.0, -4.0, 0.0), (0.5, 0, 0), base_normal=out)
        runs.append(rk.simulate(scene, start, times, rtol=1e-11))
    hoop, plate = runs
    assert hoop.succeeded
    assert plate.code == rk.Code.SURFACE_EDGE
    inwards = np.asarray(hoop.position[:, 0]) - 0.5
    assert inwards[0] > 0.0
    assert inwards.min() < -0.05
    # by hand: a ball that turns about a wire, I' = 0.4 m r^2 + m r^2
    swing = np.arctan2(np.asarray(hoop.position[:, 2]), inwards)
    rate = np.asarray(hoop.angular_velocity[:, 1])
    kept = 0.5 * 1.4 * 0.01 * rate**2 + 9.81 * 0.1 * np.sin(swing)
    np.testing.assert_allclose(kept, kept[0], rtol=1e-9)
    np.testing.assert_allclose(plate.final_state.contact_on_base[:2], 0.0, atol=1e-9)


def test_a_tip_on_a_meridian_is_refused():
    with pytest.raises(rk.FieldError, match="right angle at s = 0"):
        rk.Revolution(lambda s: (s, 0.3 * s), domain=(0.0, 1.0))
    with pytest.raises(rk.FieldError, match="right angle at s = 1"):
        rk.Revolution(lambda s: (1.0 - s, 0.3 * (1.0 - s) ** 1), domain=(0.0, 1.0))
