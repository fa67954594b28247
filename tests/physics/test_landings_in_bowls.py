"""Derivatives through landings where contact coordinates are directions."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk

from ..quick import slow_but

BODY = rk.Body(
    0.8, np.diag([0.003, 0.0035, 0.004]), rk.Sphere(0.1), (0.01, -0.006, 0.004)
)
MODES = rk.Modes(friction=0.3, restitution=0.5)
BOWLS = {
    "sphere": (rk.Sphere(0.5, inside=True), -0.25),
    "ellipsoid": (rk.Ellipsoid((0.5, 0.45, 0.4), inside=True), -0.2),
}
STEP = 1e-6  # of differences [m]
# Runs at rtol 1e-9 repeat to some 1e-12 of sizes of one beside each other; that over
# the step is 1e-6. Directions of other lengths were off by 1e-4 to 4e-3.
CLOSE = 1e-5


def throws(count):
    draw = np.random.default_rng(0)
    for _ in range(count):
        orientation = draw.standard_normal(4)
        turning = 4.0 * draw.standard_normal(3)
        flight = 0.5 * draw.standard_normal(3)
        yield orientation / np.linalg.norm(orientation), turning, flight


@pytest.mark.parametrize("name", slow_but(["sphere"], BOWLS))
def test_what_is_behind_a_landing_moves_with_what_is_before(name):
    """First landings of twenty throws; the search has several starts to end from."""
    base, height = BOWLS[name]
    scene = rk.Scene(BODY, rk.Base(base))

    def landed(aside, orientation, turning, flight):
        place = jnp.array([0.05, 0.03, height]).at[0].add(aside)
        start = rk.release(scene, orientation, turning, place, flight)
        run = rk.simulate(scene, start, (0.0, 0.4), modes=MODES, rtol=1e-9, atol=1e-11)
        first = run.switches
        state = first.state
        parts = state.position[0], state.velocity[0], state.angular_velocity[0]
        return jnp.concatenate([first.time[:1], *parts])

    tangent = jax.jit(lambda x, *a: jax.jvp(lambda y: landed(y, *a), (x,), (1.0,)))
    value = jax.jit(landed)
    for throw in throws(20):
        now, slope = tangent(0.0, *throw)
        assert np.isfinite(now).all()
        difference = (value(STEP, *throw) - value(-STEP, *throw)) / (2.0 * STEP)
        size = np.abs(difference).max()
        np.testing.assert_allclose(slope, difference, atol=CLOSE * size)
