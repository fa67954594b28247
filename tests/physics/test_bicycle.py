"""Whipple's bicycle against published numbers."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import brentq

import rollkane as rk
from rollkane import kane
from rollkane.codegen.compile_effort import for_one_call

from ..quick import slow_but


def torque(bicycle):
    return bicycle.steer_torque


@pytest.fixture(scope="module")
def linear():
    """Matrices of lean, steer and their rates at a speed."""
    system = kane.whipple_bicycle()

    def at(speed):
        state = kane.bicycle_state(speed)
        return kane.linearize(system, 0.0, state, kane.LEAN_AND_STEER, (1, 3), torque)

    return at


@pytest.mark.parametrize(
    "v", [*(pytest.param(v, marks=pytest.mark.slow) for v in (0.0, 1.0, 10.0)), 5.0]
)
def test_rows_of_the_symbolic_model(linear, v):
    """Pinned by SymPy's own test of its model to 1e-12."""
    lean = [9.48977444677355, -0.891197738059089 * v**2 - 0.571523173729245,
            -0.105522449805691 * v, -0.330515398992311 * v]  # fmt: skip
    steer = [11.7194768719633, -1.97171508499972 * v**2 + 30.9087533932407,
             3.67680523332152 * v, -3.08486552743311 * v]  # fmt: skip
    found = linear(v)
    np.testing.assert_allclose(found.A[:2], np.eye(4)[2:], atol=1e-12)
    np.testing.assert_allclose(found.A[2:], [lean, steer], rtol=0, atol=1e-10)
    np.testing.assert_allclose(found.f, 0.0, atol=1e-11)


def growth(linear, v, oscillating):
    """Largest growth rate among the modes of one kind [1/s]."""
    modes = np.linalg.eigvals(np.asarray(linear(v).A))
    kind = np.abs(modes.imag) > 1e-6 if oscillating else np.abs(modes.imag) < 1e-6
    return modes.real[kind].max()


def test_weave_and_capsize_speeds(linear):
    """Meijaard et al. (2007): v_w = 4.29238253634111, v_c = 6.02426201538837 m/s.

    Roots to 1e-12 of functions with slopes near one; eigenvalues lose some 1e-13.
    """
    weave = brentq(lambda v: growth(linear, v, True), 4.0, 5.0, xtol=1e-12)
    capsize = brentq(lambda v: growth(linear, v, False), 5.5, 6.5, xtol=1e-12)
    np.testing.assert_allclose(weave, 4.29238253634111, atol=1e-10)
    np.testing.assert_allclose(capsize, 6.02426201538837, atol=1e-10)


def test_steer_torque_acts_through_the_mass_matrix(linear):
    """B = M^-1 (0, 1) with the published mass matrix of lean and steer."""
    M = np.array([[80.81722, 2.31941332208709], [2.31941332208709, 0.29784188199686]])
    np.testing.assert_allclose(linear(3.0).B[:2], 0.0, atol=1e-14)
    np.testing.assert_allclose(
        linear(3.0).B[2:, 0], np.linalg.solve(M, [0.0, 1.0]), rtol=1e-10
    )


@pytest.mark.slow
def test_the_bicycle_rides(linear):
    """Between weave and capsize speed a lean dies out as the linear model has it.

    A lean of 1e-4 rad differs from its linear model by some 1e-4 of its size squared.
    """
    system = kane.whipple_bicycle()
    straight = kane.bicycle_state(5.0)
    times = np.linspace(0.0, 2.0, 21)
    start = kane.KaneState(straight.q, straight.u.at[0].set(1e-4))
    run = kane.simulate(system, start, times, rtol=1e-10)
    modes, vectors = np.linalg.eig(np.asarray(linear(5.0).A))
    part = np.linalg.solve(vectors, [0.0, 0.0, 1e-4, 0.0])
    expected = (vectors @ (part[:, None] * np.exp(np.outer(modes, times)))).real
    found = run.q[:, jnp.asarray(kane.LEAN_AND_STEER)]
    np.testing.assert_allclose(found, expected[:2].T, atol=1e-7)
    # both wheels stay on the ground, and nothing is lost
    height = jax.vmap(lambda t, q, u: system.at(system.configuration, t, q, u))
    touching = height(run.time, run.q, run.u)
    np.testing.assert_allclose(touching, 0.0, atol=1e-10)


@pytest.mark.slow
def test_matrices_have_derivatives_by_the_trail():
    """The determinant, whose zeros are the capsize speeds, by differences."""

    def determinant(trail):
        bicycle = kane.Bicycle(trail=trail)
        system = kane.whipple_bicycle(bicycle)
        state = kane.bicycle_state(5.0, bicycle)
        A = kane.linearize(system, 0.0, state, kane.LEAN_AND_STEER, (1, 3)).A
        return jnp.linalg.det(A)

    along = for_one_call(lambda c: jax.jvp(determinant, (c,), (jnp.ones_like(c),)))
    trail, step = jnp.asarray(0.08), 1e-4
    high, low = along(trail + step)[0], along(trail - step)[0]
    # a second difference of a smooth function of size 100: 1e-8 of the slope
    np.testing.assert_allclose(along(trail)[1], (high - low) / (2 * step), rtol=1e-6)


@pytest.mark.parametrize(
    "field",
    slow_but(["frame_mass"], ["frame_mass", "rear_moments", "fork_inertia"]),
)
def test_masses_are_varied_with_the_parameters(field):
    """Was: copies in the parts stayed behind, and the derivatives were zero."""
    made, state = kane.Bicycle(), kane.bicycle_state(5.0)
    value = jnp.asarray(getattr(made, field))
    leans = eqx.tree_at(lambda s: s.q, state, state.q.at[3].set(0.1))

    def rates(value):
        bicycle = eqx.tree_at(lambda b: getattr(b, field), made, value)
        return kane.kane_derivative(kane.whipple_bicycle(bicycle), 0.0, leans).u

    system = kane.whipple_bicycle(eqx.tree_at(lambda b: getattr(b, field), made, value))
    found = kane.linearize(system, 0.0, leans, inputs=lambda b: getattr(b, field)).B
    right = jax.jacfwd(rates)(value).reshape(3, -1)
    # the same numbers in another order: rounding of inertias up to 11 kg m^2
    np.testing.assert_allclose(found[-3:], right, rtol=1e-9, atol=1e-11)
    assert np.abs(right).max() > 1e-3


@pytest.mark.slow
def test_a_family_over_a_mass_is_one_of_other_bicycles():
    system, state = kane.whipple_bicycle(), kane.bicycle_state(5.0)
    motion = rk.steady_motion(system, state, ("u[2]",))
    branch = rk.steady_family(system, motion, "parameters.frame_mass", (84.0, 86.0))
    last = branch.points[-1]
    other = kane.whipple_bicycle(kane.Bicycle(frame_mass=86.0))
    right = kane.linearize(other, 0.0, state, kane.LEAN_AND_STEER, (1, 3)).A
    right = np.sort_complex(np.linalg.eigvals(right))
    found = np.sort_complex(np.asarray(last.eigenvalues))
    # motions are solved to 1e-10, and eigenvalues lose some ten of it
    for value in right:  # the model of the family has more, of yaw and forward speed
        assert np.abs(found - value).min() < 1e-8 * np.abs(right).max()
