"""Flights over bases that go on beyond their domain, and over the ends of others."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk

from ..quick import slow_but

G, RADIUS = 9.81, 0.08
BALL = rk.Body(0.7, 0.4 * 0.7 * RADIUS**2 * np.eye(3), rk.Sphere(RADIUS))
LEVEL, STILL = (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
# bases that are straight along x, with their slope and where their domain ends [m]
BASES = {
    "parametric": (
        rk.Parametric(
            lambda u, w: jnp.stack([u, w, 0.1 * u]), domain=((-1.0, 1.0), (-1.0, 1.0))
        ),
        0.1,
    ),
    "revolution": (
        rk.Revolution(lambda s: (s, 0.2 * s), domain=(0.3, 1.0), inside=True),
        0.2,
    ),
}
# An event is found to a rounding of the clock, by distances that are known to some ten
# roundings of places, at a metre a second
CLOSE = 1e-13


def lands(slope, place, velocity):
    """When a ball that is thrown in the plane of x and z touches the slope [s]."""
    n = np.array([-slope, 1.0]) / np.sqrt(1.0 + slope**2)
    gap, rate = n @ np.asarray(place) - RADIUS, n @ np.asarray(velocity)
    pull = 0.5 * G * n[1]
    return (rate + np.sqrt(rate**2 + 4.0 * pull * gap)) / (2.0 * pull)


@pytest.mark.parametrize("kind", slow_but(["parametric"], BASES))
def test_flights_land_beyond_the_domain(kind):
    """Near its end, and far from it; they fell through."""
    base, slope = BASES[kind]
    scene = rk.Scene(BALL, rk.Base(base))

    @jax.jit
    def thrown(place, velocity):
        three = lambda v: jnp.stack([v[0], 0.0 * v[0], v[1]])
        start = rk.release(scene, LEVEL, STILL, three(place), three(velocity))
        modes = rk.Modes(friction=0.4, restitution=0.6)
        run = rk.simulate(scene, start, [0.0, 2.0], modes=modes)
        return run.switches.time[0], run.position[-1]

    for place, velocity in (
        ((0.9, 0.5), (1.5, 0.0)),
        ((0.9, 0.5), (4.0, 2.0)),
        ((2.5, 1.0), (1.0, 1.0)),
    ):
        first, end = thrown(jnp.array(place), jnp.array(velocity))
        wanted = lands(slope, place, velocity)
        reached = place[0] + wanted * velocity[0]
        assert reached > 1.1
        np.testing.assert_allclose(first, wanted, rtol=0, atol=CLOSE)
        # it stays above, by how far its centre is along the normal
        assert end[2] - slope * end[0] > RADIUS


def test_a_ball_is_released_beside_the_rim_of_a_disc():
    """Over a rim the nearest point's normal is towards the ball; all were refused."""
    scene = rk.Scene(BALL, rk.Base(rk.DiscEdge(0.2)))
    for aside, height in ((0.2, 0.0), (0.05, 0.2), (0.1, 0.03)):
        place = (0.2 + aside, 0.0, height)
        found = rk.release(scene, LEVEL, STILL, place, STILL).contact_on_base
        wanted = np.array([aside, 0.0, height]) / np.hypot(aside, height)
        # ten roundings of a direction
        np.testing.assert_allclose(found, wanted, rtol=0, atol=2e-15)


CUP = rk.Revolution(
    lambda s: (0.7 * jnp.sin(s), 0.7 * (1.0 - jnp.cos(s))),
    domain=(0.0, 1.2),
    inside=True,
)


@pytest.mark.parametrize(
    ("base", "place", "velocity", "end"),
    [
        # over the face of a solid disc no point has a normal towards the ball
        (rk.DiscEdge(0.2), (0.21, 0.0, 0.1), (-0.5, 0.0, 0.0), 0.02),
        # out of a cup, past its rim
        (CUP, (0.5, 0.0, 0.8), (1.5, 0.0, 0.5), None),
    ],
)
def test_flights_end_where_their_base_does(base, place, velocity, end):
    """They were said to be stuck in a singular place."""
    scene = rk.Scene(BALL, rk.Base(base))
    start = rk.release(scene, LEVEL, STILL, place, velocity)
    modes = rk.Modes(friction=0.4, restitution=0.6)
    run = rk.simulate(scene, start, [0.0, 1.0], modes=modes)
    assert run.code == rk.Code.SURFACE_EDGE
    assert int(run.switches.count) == 0
    if end is not None:
        np.testing.assert_allclose(run.final_time, end, rtol=0, atol=CLOSE)


def test_nothing_is_hit_behind_the_rim_of_a_dome():
    """A ball bounced 5 mm above nothing, where the meridian would go on."""
    ball = rk.Body(1.0, 0.4 * 0.05**2 * np.eye(3), rk.Sphere(0.05))
    rim, modes = 0.72, rk.Modes(friction=0.4, restitution=0.5)
    dome = rk.Revolution(
        lambda s: jnp.stack([s, 0.3 * jnp.exp(-((s / 0.4) ** 2))]), domain=(0.0, rim)
    )
    scene = rk.Scene(ball, rk.Base(dome))

    def thrown(speed):  # too fast for the top: it flies from there
        start = rk.place(scene, LEVEL, (0.0, speed / 0.05, 0.0), (0.0, 0.0, 0.3))
        return rk.simulate(scene, start, [0.0, 0.3], modes=modes)

    # at 2.95 m/s it lands at 0.708 m, then at 0.723 to 0.744 m, and at 3.2 nowhere
    runs = jax.jit(jax.vmap(thrown))(jnp.array([2.95, 3.0, 3.025, 3.05, 3.075, 3.2]))
    places = np.linalg.norm(runs.switches.state.contact_on_base, axis=-1)
    assert np.nanmax(places) < rim
    edge, done = int(rk.Code.SURFACE_EDGE), int(rk.Code.COMPLETED)
    assert runs.code.tolist() == [done, edge, edge, edge, edge, done]
    assert runs.switches.count.tolist() == [2, 1, 1, 1, 1, 1]
