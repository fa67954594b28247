"""The rolling core against Kane's method, which knows nothing of it."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk
from rollkane import kane
from rollkane.codegen.compile_effort import for_one_call
from rollkane.dynamics import observables, rolling
from tests.kane_by_hand import by_hand, with_the_core
from tests.random_scenes import stacked

# as in test_twins: 10^3 roundings of terms up to ten times larger
AGREE = 1e-10
CASES = [
    ("ellipsoid in ellipsoid", -1),
    pytest.param(("rim on cylinder", -1), marks=pytest.mark.slow),
    pytest.param(("torus on graph", 1), marks=pytest.mark.slow),
]


@pytest.mark.parametrize("case", CASES, ids=str)
def test_random_scenes(case):
    """Moving base, three masses, springs, drag: accelerations and contact forces."""

    def both(scene, t, state):
        state = rk.to_pole_free(scene, state, t)
        system = kane.rolling_system(scene, state, reactions=True)
        own = kane.kane_state(state)
        rates = rk.rolling_derivative(scene, t, state)
        found = kane.kane_derivative(system, t, own)
        return (
            (jnp.concatenate([rates.angular_velocity, rates.alpha_dot]), found.u),
            (
                rolling.contact_force(scene, t, state),
                kane.reactions(system, t, own),
            ),
            (
                observables.kinetic_energy(scene, t, state)[None],
                kane.kinetic_energy(system, t, own)[None],
            ),
        )

    compared = for_one_call(lambda *all_of: jax.vmap(both)(*all_of))
    for core, twin in compared(*stacked(*case, 18)):
        core, twin = np.asarray(core), np.asarray(twin)
        assert np.isfinite(core).all()
        size = np.abs(core).max(axis=1, keepdims=True)
        assert (np.abs(twin - core) < AGREE * size).all()


@pytest.mark.parametrize(
    "law", [rk.RubberRolling(), rk.Slipping(rk.ViscousFriction(0.5))]
)
def test_other_laws_are_refused(law):
    """The twin writes down rolling alone; it would be that of another motion."""
    body = rk.Body(1.0, 0.01 * np.eye(3), rk.Sphere(0.1))
    rolls = rk.Scene(body)
    start = rk.place(rolls, (1.0, 0, 0, 0), (0.0, 1.0, 2.0), (0.0, 0.0, 0.0))
    kane.rolling_system(rolls, start)
    with pytest.raises(rk.FieldError, match="another law of the contact than Rolling"):
        kane.rolling_system(rk.Scene(body, contact=law), start)


@pytest.mark.slow
def test_ellipsoid_with_particle_on_a_hill():
    """The same motion for 10 s from equations that were written down by hand.

    270 steps of 1e-11 on a motion whose errors grow tenfold: some 1e-8 at most.
    """
    times = np.linspace(0.0, 10.0, 101)
    scene, start = with_the_core()
    run = rk.simulate(scene, start, times, rtol=1e-11)
    system, own = by_hand()
    twin = kane.simulate(system, own, times, rtol=1e-11)
    np.testing.assert_allclose(twin.q[:, 4:], run.contact_on_base[:, :2], atol=1e-8)
    np.testing.assert_allclose(twin.u, run.state.angular_velocity, atol=1e-8)
    e = np.asarray(twin.q[:, :4])[:, [3, 0, 1, 2]]
    alike = np.abs((e * np.asarray(run.orientation)).sum(axis=1))
    np.testing.assert_allclose(alike, 1.0, atol=1e-14)  # cosine of 1e-8
