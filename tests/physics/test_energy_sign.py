"""The sign of the kept energy at steady motions, against closed forms."""

import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk

from ..quick import slow_but

G = 9.81
UPRIGHT, ORIGIN = (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
TURNED = (0.0, 1.0, 0.0, 0.0)  # upside down


def loaded(moments, below=0.02):
    """A ball of radius 0.1 m whose mass centre is below its middle."""
    body = rk.Body(1.0, np.diag(moments), rk.Sphere(0.1), (0.0, 0.0, -below))
    return rk.Scene(body)


def told(scene, orientation, spin, hold="spin"):
    start = rk.place(scene, orientation, (0.0, 0.0, spin), ORIGIN)
    return rk.steady_motion(scene, start, (hold,))


def counts(motion):
    sign = motion.energy_sign
    return sign.positive, sign.negative, sign.zero


@pytest.mark.slow
def test_a_loaded_ball_at_rest():
    """Of three velocities and two tilts; tilts raise the mass centre, or lower it."""
    scene = loaded((0.004, 0.0042, 0.003))
    low, high = told(scene, UPRIGHT, 0.0), told(scene, TURNED, 0.0)
    assert counts(low) == (5, 0, 0)
    assert low.energy_sign.definite
    assert low.energy_sign.modes == (1, 1, 1, 1)
    assert counts(high) == (3, 2, 0)
    assert not high.energy_sign.definite
    assert high.energy_sign.modes == (0, 0, 0, 0)  # they grow and decay
    assert low.energy_sign.momenta == {}
    assert "sign of energy: 5 positive, 0 negative, 0 zero, definite" in str(low)


@pytest.mark.parametrize("share", [0.98, 1.02])
def test_a_sleeping_top_is_definite_above_its_threshold(share):
    """Routh's sphere, the mass centre above: both integrals together decide.

    The threshold is that of its linear model, ``n^2 (C + m h r)^2 = 4 (A + m h^2) m g
    (h - r)``; the sign is definite above it, and there is none below.
    """
    A, C, h, r = 0.004, 0.003, 0.12, 0.1
    scene = loaded((A, A, C), below=-0.02)
    threshold = 2.0 * np.sqrt((A + h * h) * G * (h - r)) / (C + h * r)
    motion = told(scene, UPRIGHT, share * threshold)
    sign = motion.energy_sign
    assert motion.stable is sign.definite is (share > 1.0)
    assert "Jellett's integral" in sign.momenta
    assert counts(motion) == ((4, 0, 0) if share > 1.0 else (2, 2, 0))
    assert sign.modes == ((1,) * 4 if share > 1.0 else (0,) * 4)


@pytest.mark.slow
def test_a_balanced_ball_spins_about_its_axes_as_a_free_body_does():
    """Chaplygin's ball: definite about the largest and least moment of inertia.

    K about the contact stands still in space, so that |K|^2 is kept as well: of E less
    multiples of K_z and of it, one is definite where the axis is not the middle one.
    """
    made = {
        "least": (0.005, 0.006, 0.004),
        "middle": (0.004, 0.006, 0.005),
        "largest": (0.004, 0.0042, 0.005),
    }
    motions = {}
    for name, moments in made.items():
        scene = rk.Scene(rk.Body(1.0, np.diag(moments), rk.Sphere(0.1)))
        motions[name] = told(scene, UPRIGHT, 5.0)
    assert counts(motions["largest"]) == (4, 0, 0)
    assert counts(motions["middle"]) == (3, 1, 0)
    assert counts(motions["least"]) == (0, 4, 0)  # the greatest energy of its K
    signs = {name: motion.energy_sign for name, motion in motions.items()}
    for name, motion in motions.items():
        assert motion.stable is signs[name].definite is (name != "middle")
    assert signs["least"].modes == (-1,) * 4
    assert signs["largest"].modes == (1,) * 4
    # K_z = C n and E = C n^2 / 2 of the family: dE = n dK_z, known to rounding
    known = {"moment about the contact z": pytest.approx(5.0, rel=1e-12)}
    assert signs["largest"].momenta == known


def spinning_bowl(rate):
    bowl = rk.Graph(lambda x, y: 0.5 * (2.0 * x**2 + y**2))
    ball = rk.Body(1.0, 0.4 * 0.01 * np.eye(3), rk.Sphere(0.1))
    scene = rk.Scene(ball, rk.Base(bowl, rk.Spin(rate)))
    return told(scene, UPRIGHT, rate, "spin about z")


@pytest.mark.parametrize(
    ("rate", "negative", "stable"),
    [
        pytest.param(3.0, 0, True, marks=pytest.mark.slow),
        pytest.param(4.0, 1, False, marks=pytest.mark.slow),
        pytest.param(6.0, 2, True, marks=pytest.mark.slow),
    ],
)
def test_rest_in_a_spinning_bowl(rate, negative, stable):
    """Each axis of curvature k turns over at Omega^2 = g k / (1 - k a): 3.30 and 4.95.

    Between them one direction goes down, and the rest is unstable; above both it is
    stable again by turning alone, which the energy cannot tell: two of its modes have
    negative energy.
    """
    motion = spinning_bowl(rate)
    sign = motion.energy_sign
    limits = np.sqrt(G * np.array([1.0, 2.0]) / (1.0 - 0.1 * np.array([1.0, 2.0])))
    assert negative == np.sum(rate > limits)
    assert sign.energy == "moving energy"
    assert counts(motion) == (5 - negative, negative, 0)
    assert motion.stable is stable
    assert sign.definite is (negative == 0)
    if negative == 2:
        assert sorted(sign.modes) == [-1, -1, 1, 1]
    if negative == 1:
        assert sorted(sign.modes) == [0, 0, 1, 1]


@pytest.mark.slow
def test_where_none_is_told():
    """Of a rattleback's spin: no momentum that is kept has the energy's slope."""
    inertia = [[2e-4, -2e-5, 0.0], [-2e-5, 1.6e-3, 0.0], [0.0, 0.0, 1.7e-3]]
    axes = rk.Ellipsoid((0.2, 0.03, 0.02))
    scene = rk.Scene(rk.Body(1.0, inertia, axes, (0.0, 0.0, -0.01)))
    sign = told(scene, UPRIGHT, 5.0).energy_sign
    assert "does not vanish on the constraint manifold" in sign.reason
    assert not sign.definite
    assert str(sign).startswith("energy: none, its first variation")
    assert (sign.positive, sign.negative, sign.zero, sign.modes) == (0, 0, 0, ())


@pytest.mark.parametrize("ratio", slow_but([1.0], [1.0, 1.5]))
def test_a_potential_round_a_turntable_s_axis(ratio):
    """Its moving energy is kept where the spring is alike along x and y.

    E - Omega J is definite where the spring holds more than the turning throws out: of
    a ball that rests on the table, m Omega^2 below k.
    """
    ball = rk.Body(1.0, 0.004 * np.eye(3), rk.Sphere(0.1))
    spring = rk.Potential(lambda p: 2.0 * (p[0] ** 2 + ratio * p[1] ** 2))
    loads = rk.Gravity(), spring
    turning = rk.Scene(ball, rk.Base(rk.Plane(), rk.Spin(1.0)), loads=loads)
    start = rk.place(turning, UPRIGHT, (0.0, 0.0, 1.0), ORIGIN)
    motion = rk.steady_motion(turning, start, ("spin about z",))
    sign = motion.energy_sign
    if ratio != 1.0:
        assert "keeps no energy" in sign.reason
        return
    assert sign.energy == "moving energy"
    assert counts(motion) == (5, 0, 0)
    assert sign.definite
    assert motion.stable


@pytest.mark.parametrize("drag", slow_but([0.0], [0.0, 1e-6]))
def test_a_force_across_the_velocity_does_no_work(drag):
    """A ball in a bowl; the same with a drag, however small, keeps no energy."""

    def across(t, point, parameters):
        turned = jnp.cross(jnp.array([0.0, 0.0, -1.0]), point.velocity)
        return turned - parameters["drag"] * point.velocity

    ball = rk.Body(1.0, 0.004 * np.eye(3), rk.Sphere(0.1))
    bowl = rk.Base(rk.Sphere(1.0, inside=True))
    force = rk.Force(across, parameters={"drag": drag})
    scene = rk.Scene(ball, bowl, loads=(rk.Gravity(), force))
    start = rk.place(scene, UPRIGHT, ORIGIN, (0.0, 0.0, -1.0))
    sign = rk.steady_motion(scene, start).energy_sign
    if drag:
        assert "keeps no energy" in sign.reason
        return
    assert sign.energy == "energy"
    assert (sign.positive, sign.negative, sign.zero) == (5, 0, 0)
    assert sign.definite
    assert sign.modes == (1,) * 4


@pytest.mark.slow
def test_a_scene_that_keeps_no_energy_has_no_sign():
    body = rk.Body(1.0, 0.004 * np.eye(3), rk.Sphere(0.1), (0.0, 0.0, -0.02))
    lossy = rk.Scene(body, loads=(rk.Gravity(), rk.Drag(0.1)))
    assert "keeps no energy" in told(lossy, UPRIGHT, 0.0).energy_sign.reason
