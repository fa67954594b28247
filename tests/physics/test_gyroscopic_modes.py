"""Vibrations with forces across the velocity, and with damping, by hand."""

import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk
from rollkane.stability.normal_modes import _shapes

from ..quick import slow_but

G = 9.81
UPRIGHT, STILL = (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
r = 0.1
BALL = rk.Body(1.0, 0.4 * r**2 * np.eye(3), rk.Sphere(r))


def across(t, point, parameters):
    """As of a charge in a field along z."""
    del t
    return parameters["field"] * jnp.cross(jnp.array([0.0, 0.0, 1.0]), point.velocity)


def height(x, y, p):
    return 0.5 * (p["a"] * x**2 + p["b"] * y**2)


def bowl(a, b):
    return rk.Base(rk.Graph(height, {"a": a, "b": b}))


def gyroscopic(stiffness, turn):
    """Frequencies of x'' = -k x - turn y', y'' = -h y + turn x' [rad/s]."""
    A = np.zeros((4, 4))
    A[:2, 2:] = np.eye(2)
    A[2:, :2] = -np.diag(stiffness)
    A[2:, 2:] = [[0.0, -turn], [turn, 0.0]]
    return np.sort(np.linalg.eigvals(A).imag)[2:]


@pytest.mark.parametrize("other", slow_but([1.0], [1.0, 1.7]))
def test_each_frequency_comes_once(other):
    """A ball in a bowl, of revolution or not, under a force across its velocity."""
    force = rk.Force(across, parameters={"field": 2.0})
    scene = rk.Scene(BALL, bowl(1.0, other), loads=(rk.Gravity(), force))
    rest = rk.place(scene, UPRIGHT, STILL, STILL)
    found = rk.normal_modes(scene, rest)
    stiffness = [5.0 / 7.0 * G * k / (1.0 - k * r) for k in (1.0, other)]
    # eigenvalues of a matrix of order 10
    wanted = gyroscopic(stiffness, 2.0 * 5.0 / 7.0)
    np.testing.assert_allclose(found.frequencies, wanted, rtol=1e-10)
    assert found.shapes.shape == (2, len(found.coordinates))
    # each with its velocities, the largest of its places being one
    places = [not name.startswith("angular") for name in found.coordinates]
    np.testing.assert_allclose(np.abs(found.shapes[:, places]).max(axis=1), 1.0)
    assert np.all(np.abs(found.shapes[:, np.logical_not(places)]).max(axis=1) > 0.1)


@pytest.mark.slow
def test_the_second_mode_is_not_the_first_again():
    """A flywheel in the ball that is kept turning about its axis."""

    def turned(alpha):
        c, s = jnp.cos(alpha[0]), jnp.sin(alpha[0])
        return jnp.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])

    wheel = rk.SupportedBody(
        0.3, np.diag([6e-4, 6e-4, 1e-3]), lambda alpha: jnp.zeros(3), turned
    )
    turns = rk.Prescribed(wheel, lambda t: jnp.stack([30.0 * t]))
    shell = rk.Body(0.7, 0.004 * np.eye(3), rk.Sphere(r))
    scene = rk.Scene(shell, bowl(1.0, 1.7), supported=turns)
    rest = rk.place(scene, UPRIGHT, STILL, STILL)
    own = 0.0046 + r**2
    stiffness = [r**2 * G * k / (1.0 - k * r) / own for k in (1.0, 1.7)]
    wanted = gyroscopic(stiffness, 0.03 / own)
    found = rk.normal_modes(scene, rest).frequencies
    np.testing.assert_allclose(found, wanted, rtol=1e-10)
    # of the amplitude's square, 1e-6
    fast = rk.normal_mode_motion(scene, rest, 1e-3, mode=1)
    assert 2.0 * np.pi / fast.period == pytest.approx(wanted[1], rel=1e-5)


@pytest.mark.parametrize("turn", [0.0, 1.3])
def test_equal_frequencies_come_as_often_as_they_are(turn):
    """Two oscillators that are alike, seen along skew axes: four kinds of motion."""
    one = np.zeros((4, 4))
    one[:2, 2:] = np.eye(2)
    one[2:] = [[-4.0, 0.0, 0.0, -turn], [0.0, -4.0, turn, 0.0]]
    # places first, velocities then, of both; mixed among themselves
    draw = np.random.default_rng(2)
    mix = np.kron(np.eye(2), draw.standard_normal((4, 4)))
    order = [0, 1, 4, 5, 2, 3, 6, 7]
    A = np.kron(np.eye(2), one)[np.ix_(order, order)]
    A = mix @ A @ np.linalg.inv(mix)
    values, vectors = np.linalg.eig(A)
    rate = gyroscopic([4.0, 4.0], turn)[1]
    same = np.abs(values - 1j * rate) < 1e-6
    count = 2 if turn else 4
    assert np.sum(same) == count
    still = np.arange(8) < 4
    shapes = _shapes(vectors[:, same], still)
    assert shapes.shape == (count, 8)
    # with what each passes a quarter of a period later they are all of the motions
    both = np.concatenate([shapes, shapes @ A.T / rate])
    both /= np.linalg.norm(both, axis=1)[:, None]
    assert np.linalg.svd(both, compute_uv=False)[-1] > 1e-3
    if not turn:
        np.testing.assert_allclose(shapes[:, ~still], 0.0, atol=1e-9)


def test_vibrations_that_decay_are_refused():
    """Drag of a ten-thousandth: the rest is stable, and nothing repeats about it."""
    loads = rk.Gravity(), rk.Drag(linear=1e-4)
    scene = rk.Scene(BALL, bowl(1.0, 1.7), loads=loads)
    rest = rk.place(scene, UPRIGHT, STILL, STILL)
    for ask in (rk.normal_modes, lambda *given: rk.normal_mode_motion(*given, 0.1)):
        with pytest.raises(rk.FieldError, match=r"all decay, .* by -3\.57e-05"):
            ask(scene, rest)


def test_a_rest_about_which_nothing_vibrates_has_no_modes():
    """A ball on top of another."""
    scene = rk.Scene(BALL, rk.Base(rk.Sphere(1.0)))
    rest = rk.place(scene, UPRIGHT, STILL, (0.0, 0.0, 1.0))
    assert rk.normal_modes(scene, rest).frequencies.size == 0
    with pytest.raises(rk.FieldError, match="give a rest that vibrates"):
        rk.normal_mode_motion(scene, rest, 0.1)
