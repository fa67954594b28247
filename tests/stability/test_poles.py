"""Contact through former poles: the ends of axes, where charts by angles break."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk

from .. import problems

AXES = np.array([0.2, 0.14, 0.1])
MOMENTS = np.array([0.010, 0.014, 0.018])
TIMES = np.linspace(0.0, 0.4, 6)
# steps of rtol 1e-12 over 0.8 s (some 60) leave 1e-10; 1e-9 is the promise
PROMISE = 1e-9


def axis_down(axis: int, sign: int, beside: float):
    """Rotation with body axis ``sign * axis`` pointing down, tilted by ``beside``."""
    down = np.zeros(3)
    down[axis] = sign
    other, third = np.roll(np.eye(3), -axis, axis=0)[1:]
    down = np.cos(beside) * down + np.sin(beside) * (0.6 * other + 0.8 * third)
    side = np.cross(down, third)
    side /= np.linalg.norm(side)
    R = np.stack([side, np.cross(-down, side), -down])  # rows: fixed axes in the body
    return R


def through(surface, permutation, R, base=None, contact=(0.0, 0.0, 0.0)):
    """Backwards and forwards from the pole; positions and turns of the body."""
    P = np.eye(3)[list(permutation)]  # new body axes on old ones
    scene = rk.Scene(
        rk.Body(1.5, np.diag(P @ MOMENTS), surface, P @ [0.003, -0.004, 0.002]), base
    )
    q = problems.quaternion(R @ P.T)
    start = rk.place(scene, q, (2.0, 5.0, 0.5), contact)
    out = []
    for times in (TIMES, -TIMES):
        result = rk.simulate(scene, start, times, rtol=1e-12)
        assert bool(result.succeeded)
        rotation = np.stack(
            [problems.matrix(q) for q in np.asarray(result.orientation)]
        )
        out.append((np.asarray(result.position), rotation @ P))
        energy = np.asarray(result.energy)
        assert np.ptp(energy) < PROMISE * abs(energy[0])
    return out


CYCLES = [(0, 1, 2), (1, 2, 0)]


@pytest.mark.parametrize("beside", [0.0, 1e-6])
@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_end_of_every_axis(axis, sign, beside):
    """The motion does not depend on how the body's axes are called."""
    R = axis_down(axis, sign, beside)
    first, second = (
        through(rk.Ellipsoid(AXES[list(cycle)]), cycle, R) for cycle in CYCLES
    )
    for (x, turn), (x2, turn2) in zip(first, second, strict=True):
        assert np.abs(x - x2).max() < PROMISE
        assert np.abs(turn - turn2).max() < PROMISE


@pytest.mark.parametrize("beside", [0.0, pytest.param(1e-6, marks=pytest.mark.slow)])
@pytest.mark.slow
def test_bodies_that_carry_their_point(beside):
    """By a direction and as a level set, through the end of the last axis."""
    R = axis_down(2, 1, beside)

    def support(direction):
        stretched = jnp.asarray(AXES) ** 2 * direction
        return stretched / jnp.sqrt(jnp.sum(stretched * direction))

    exact = through(rk.Ellipsoid(AXES), CYCLES[0], R)
    for surface in (
        rk.Parametric(support, of_direction=True),
        rk.Implicit(lambda p: jnp.sum((p / jnp.asarray(AXES)) ** 2) - 1.0),
    ):
        for (x, turn), (x2, turn2) in zip(
            exact, through(surface, CYCLES[0], R), strict=True
        ):
            assert np.abs(x - x2).max() < PROMISE
            assert np.abs(turn - turn2).max() < PROMISE


@pytest.mark.parametrize("beside", [0.0, pytest.param(1e-6, marks=pytest.mark.slow)])
def test_poles_of_a_body_of_revolution(beside):
    """A meridian through the axis against the same spheroid by its normal."""
    R = axis_down(2, 1, beside)

    def meridian(s):
        return 0.2 * jnp.sin(s), -0.1 * jnp.cos(s)

    round_ = rk.Revolution(meridian)
    assert round_.poles == (True, True)
    exact = through(rk.Ellipsoid((0.2, 0.2, 0.1)), CYCLES[0], R)
    for (x, turn), (x2, turn2) in zip(
        exact, through(round_, CYCLES[0], R), strict=True
    ):
        assert np.abs(x - x2).max() < PROMISE
        assert np.abs(turn - turn2).max() < PROMISE


@pytest.mark.parametrize("beside", [0.0, pytest.param(1e-6, marks=pytest.mark.slow)])
@pytest.mark.slow
def test_poles_of_the_base(beside):
    """A ball over the top of a sphere: as a normal and as a meridian through it."""
    top = np.array([2.0 * np.sin(beside), 0.0, 2.0 * np.cos(beside)])
    bases = (
        rk.Sphere(2.0),
        rk.Revolution(lambda s: (2.0 * jnp.sin(s), -2.0 * jnp.cos(s))),
        rk.Implicit(lambda p: jnp.sum(p * p) - 4.0, size=3.0),
    )
    R = axis_down(0, 1, 0.3)
    first, *others = (
        through(rk.Ellipsoid(AXES), CYCLES[0], R, rk.Base(base), top) for base in bases
    )
    for other in others:
        for (x, turn), (x2, turn2) in zip(first, other, strict=True):
            assert np.abs(x - x2).max() < PROMISE
            assert np.abs(turn - turn2).max() < PROMISE


def test_gradient_at_a_pole():
    """Derivatives of a run from the very pole, by its spin and by its tilt."""
    q0 = jnp.asarray(problems.quaternion(axis_down(2, 1, 0.0)))

    def end(surface, given):
        spin, first, second = given
        scene = rk.Scene(rk.Body(1.5, np.diag(MOMENTS), surface))
        omega = jnp.stack([spin, jnp.asarray(5.0), jnp.asarray(0.5)])
        w, x, y, z = q0
        # tilted about axes of the body's rim, to first order: (0, first, second, 0) / 2
        by_first, by_second = jnp.stack([-x, w, z, -y]), jnp.stack([-y, -z, w, x])
        q = q0 + 0.5 * (first * by_first + second * by_second)
        start = rk.place(scene, q / jnp.sqrt(q @ q), omega, (0.0, 0.0, 0.0))
        return rk.simulate(scene, start, (0.0, 0.4), rtol=1e-12).final_state.orientation

    round_ = rk.Revolution(lambda s: (0.2 * jnp.sin(s), -0.1 * jnp.cos(s)))
    at = jnp.array([2.0, 0.0, 0.0])
    exact = jax.jit(jax.jacfwd(lambda x: end(rk.Ellipsoid((0.2, 0.2, 0.1)), x)))(at)
    found = jax.jit(jax.jacfwd(lambda x: end(round_, x)))(at)
    np.testing.assert_allclose(found, exact, atol=1e-8)
