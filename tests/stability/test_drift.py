"""Long runs: the pose is an output, so nothing drifts off the surface."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk
from rollkane.dynamics.rolling import contact_of
from rollkane.geometry.small_linear import cross
from rollkane.validation.checks import FieldError

from .. import problems

RADIUS, OFFSET, MASS, I1, I3 = 0.1, 0.02, 0.5, 1.6e-3, 2.1e-3


def routh_sphere(surface):
    scene = rk.Scene(rk.Body(MASS, np.diag([I1, I1, I3]), surface, (0.0, 0.0, -OFFSET)))
    q = problems.turn(0, 50.0)
    start = rk.place(scene, q, (0.4, -0.7, 6.0), (0.0, 0.0, 0.0))
    return scene, start


def constants(scene, t, state):
    """Jellett's and Routh's constants [J s] and [J s kg^(1/2) m].

    r from the mass centre to the contact: Jellett L . r with L about the mass centre,
    Routh w3 sqrt(I1 I3 + m r . I r) (Routh 1905, articles 243-244).
    """
    r = contact_of(scene, t, state).body_point - scene.body.center_of_mass
    w = state.angular_velocity
    inertia = jnp.array([I1, I1, I3])
    jellett = jnp.sum(inertia * w * r)
    routh = w[2] * jnp.sqrt(I1 * I3 + MASS * jnp.sum(r * inertia * r))
    return jnp.stack([jellett, routh])


def gap(scene, t, state):
    """Distance of the body's contact point from the base, and normals' misfit."""
    seen = contact_of(scene, t, state)
    rotation = seen.rotation
    height = (seen.position + rotation @ seen.body_point)[2]
    centre = seen.position[2] - RADIUS  # of a ball whose origin is its centre
    up = -(rotation @ seen.normal)
    tilt = jnp.abs(cross(up, jnp.array([0.0, 0.0, 1.0])))
    orthonormal = jnp.abs(rotation @ rotation.T - jnp.eye(3))
    return jnp.stack([jnp.abs(height), jnp.abs(centre), tilt.max(), orthonormal.max()])


@pytest.mark.parametrize(
    ("surface", "end"),
    [
        (rk.Sphere(RADIUS), 1000.0),
        (rk.Implicit(lambda p: jnp.sum(p * p) - RADIUS**2, size=0.2), 100.0),
    ],
    ids=["by its normal", "carrying its point"],
)
def test_routh_sphere(surface, end):
    scene, start = routh_sphere(surface)
    times = np.linspace(0.0, end, 201)
    result = rk.simulate(scene, start, times, rtol=1e-12, atol=1e-14)
    assert bool(result.succeeded)
    # rounding of lengths of 0.1 m and of unit vectors through about 50 operations
    assert float(jnp.max(result.each(gap))) < 1e-14
    energy = np.asarray(result.energy)
    assert np.ptp(energy) < 1e-9 * energy[0]
    kept = np.asarray(result.each(constants))
    assert (np.ptp(kept, axis=0) < 1e-9 * np.abs(kept[0])).all()


def test_energy_is_kept_by_projection():
    """To rounding at a loose tolerance; the motion stays that of the tolerance.

    The energy is summed of some 20 products; some 5 10^3 steps of 1e-7 on a place
    10 m away leave 5e-3 m.
    """
    scene, start = routh_sphere(rk.Sphere(RADIUS))
    solver = rk.keeping_energy(scene, start)
    times = np.linspace(0.0, 100.0, 11)
    kept = rk.simulate(scene, start, times, rtol=1e-7, solver=solver)
    exact = rk.simulate(scene, start, times, rtol=1e-12)
    energy = np.asarray(kept.energy)
    assert np.abs(energy - energy[0]).max() < 1e-13 * energy[0]
    assert float(jnp.abs(kept.position - exact.position).max()) < 1e-2
    turning = rk.Scene(scene.body, rk.Base(rk.Plane(), rk.Spin(1.0)))
    with pytest.raises(FieldError, match=r"keeping_energy\.scene"):
        rk.keeping_energy(turning, start)


def test_there_and_back():
    """Time reversed: 100 s away and home, within the errors of both ways.

    Each of some 2 10^4 steps of 1e-12 leaves at most itself, and the motion is regular.
    """
    scene, start = routh_sphere(rk.Sphere(RADIUS))
    away = rk.simulate(scene, start, (0.0, 100.0), rtol=1e-12)
    home = rk.simulate(scene, away.final_state, (100.0, 0.0), rtol=1e-12)
    assert bool(home.succeeded)
    w, v = home.final_state.angular_velocity, start.angular_velocity
    np.testing.assert_allclose(w, v, atol=1e-8)
    q = home.final_state.orientation
    np.testing.assert_allclose(q / jnp.linalg.norm(q), start.orientation, atol=1e-8)


def test_chaplygin_ball():
    """K = I w + m r^2 e_z x (w x e_z) stays fixed in space."""
    scene, start, case = problems.reference_case("c16")
    result = rk.simulate(scene, start, case["times"], rtol=1e-12)
    inertia = scene.body.inertia
    mass, radius = scene.body.mass, scene.body.surface.radius

    def momentum(scene, t, state):
        R = contact_of(scene, t, state).rotation
        e = R.T @ jnp.array([0.0, 0.0, 1.0])
        w = state.angular_velocity
        own = inertia @ w + mass * radius**2 * cross(e, cross(w, e))
        return R @ own

    kept = np.asarray(result.each(momentum))
    # 4e3 steps of 1e-12, and momentum is linear in the angular velocity
    assert np.abs(kept - kept[0]).max() < 1e-8 * np.abs(kept[0]).max()


def test_single_precision():
    """float32 runs at its own default tolerance, to about its own digits."""
    scene, start = problems.disc()
    small = jax.tree.map(lambda x: x.astype(jnp.float32), (scene, start))
    times = np.linspace(0.0, 2.0, 5)
    exact = rk.simulate(scene, start, times, rtol=1e-10)
    found = rk.simulate(*small, times)
    assert found.position.dtype == jnp.float32
    assert bool(found.succeeded)
    # some 70 steps of the default rtol 1e-5 on numbers up to 8 rad/s, over sizes 0.25 m
    assert (
        float(jnp.max(jnp.abs(found.position - exact.position.astype(jnp.float32))))
        < 1e-3
    )
    energy = np.asarray(found.energy)
    assert np.ptp(energy) < 1e-3 * energy[0]
