"""Flights over bases that go on beyond the domain in which they are searched."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk

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


@pytest.mark.parametrize("kind", BASES)
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
