"""Formulations agree on random scenes; Gamma and epsilon equal their definition."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk
from rollkane.codegen.compile_effort import for_one_call
from rollkane.dynamics import observables
from rollkane.dynamics.rolling import contact_force
from rollkane.paper.euler_lagrange import EQUATIONS
from rollkane.paper.quasi_energy import (
    Configuration,
    angular_momentum_about_contact,
    inertia_of,
    kinetic_energy_with_slip,
    place_of,
)

from ..by_definition import defined_symbols
from ..random_scenes import PAIRS, stacked

SEEDS = 18  # times one case; 180 of both signs with the slow ones
# Accelerations are of order 10 to 1000 and go through a linear solve; the formulations
# differ in the order of some 10^3 roundings of 1e-16 of terms ten times larger.
AGREE = 1e-10

# every other case costs another minute of compiling
FAST = {
    ("ellipsoid in ellipsoid", -1),
}
CASES = [
    pytest.param(case, marks=() if case in FAST else pytest.mark.slow)
    for case in itertools.product(PAIRS, (-1, 1))
]


def configuration(t, state):
    return Configuration(
        state.contact_on_body, state.contact_on_base, state.angle, state.alpha, t
    )


@pytest.fixture(scope="module", params=CASES, ids=lambda c: f"{c[0]}, s={c[1]:+d}")
def case(request):
    pair, sign = request.param
    return stacked(pair, sign, SEEDS)


def once(function):
    """For one call over all seeds."""
    return for_one_call(lambda *case: jax.vmap(function)(*case))


def accelerations(rates):
    return jnp.concatenate([rates.angular_velocity, rates.alpha_dot])


def test_formulations_agree(case):
    @once
    def all_of(scene, t, state):
        twins = [rk.euler_lagrange_derivative(scene, t, state, e) for e in EQUATIONS]
        rolling = rk.rolling_derivative(scene, t, state)
        return [accelerations(rates) for rates in (rolling, *twins)]

    rolling, *twins = (np.asarray(x) for x in all_of(*case))
    size = np.abs(rolling).max(axis=1, keepdims=True)
    assert np.isfinite(rolling).all()
    for name, twin in zip(EQUATIONS, twins, strict=True):
        assert (np.abs(twin - rolling) < AGREE * size).all(), name


def test_symbols_equal_their_definition(case):
    @once
    def both(scene, t, state):
        paper = rk.paper_quantities(rk.contact_of(scene, t, state))
        return (paper.Gamma, paper.epsilon), defined_symbols(scene, t, state)

    (Gamma, epsilon), (Gamma_defined, epsilon_defined) = both(*case)
    for found, defined in ((Gamma, Gamma_defined), (epsilon, epsilon_defined)):
        found, defined = np.asarray(found), np.asarray(defined)
        # those with a slip among their lower indices are multiplied by zero
        lower = np.s_[:, :, 2:, 2:] if found.ndim == 4 else np.s_[:, :, 2:]
        found, defined = found[lower], defined[lower]
        assert np.abs(found).max() > 0.1
        np.testing.assert_allclose(found, defined, atol=AGREE * np.abs(defined).max())


def test_gradient_of_the_energy_is_the_angular_momentum(case):
    """m' = dTheta'/d(sigma, tau, n) = (1.15) + (1.16) = K^M, and T' is the energy."""

    @once
    def all_of(scene, t, state):
        x, sign = configuration(t, state), state.sign
        U = jnp.concatenate([jnp.zeros(2), state.angular_velocity])
        T = lambda U: kinetic_energy_with_slip(scene, x, U, state.alpha_dot, sign)
        value, gradient = jax.value_and_grad(T)(U)
        contact = rk.contact_of(scene, t, state)
        E = contact.rotation @ contact.shell.frame
        K = E.T @ observables.contact_angular_momentum(scene, t, state)
        P = E.T @ observables.momentum(scene, t, state)
        place, body = place_of(scene, x, sign), inertia_of(scene, x, state.alpha_dot)
        m = angular_momentum_about_contact(place, body, state.angular_velocity)
        energy = observables.kinetic_energy(scene, t, state)
        return (
            (value, energy),
            (gradient[2:], K),
            (K, place.frame.T @ m),
            (
                gradient[:2],
                P[:2],
            ),
        )

    for found, expected in all_of(*case):
        size = np.abs(np.asarray(expected)).max()
        np.testing.assert_allclose(found, expected, atol=AGREE * size)


def test_power_is_the_rate_of_the_energy(case):
    @once
    def both(scene, t, state):
        rates = rk.rolling_derivative(scene, t, state)
        energy = lambda t, s: observables.energy(scene, t, s)
        rate = jax.jvp(energy, (t, state), (jnp.ones_like(t), rates))[1]
        return rate, observables.power(scene, t, state)

    rate, power = (np.asarray(x) for x in both(*case))
    np.testing.assert_allclose(rate, power, atol=AGREE * np.abs(power).max())


def test_both_coordinates_have_the_same_rates(case):
    """The pole-free state of a Voronets state turns and slides alike."""

    @once
    def both(scene, t, state):
        plain = rk.to_pole_free(scene, state, t)
        contact = rk.contact_of(scene, t, state)
        charts, free = (
            rk.rolling_derivative(scene, t, s).angular_velocity for s in (state, plain)
        )
        turned = charts - jnp.cross(contact.frame_turn, state.angular_velocity)
        seen = rk.contact_of(scene, t, plain)
        return (
            (contact.shell.frame @ turned, free),
            (contact.velocity, seen.velocity),
            (contact.position, seen.position),
            (contact_force(scene, t, state), contact_force(scene, t, plain)),
        )

    for charts, free in both(*case):
        size = np.abs(np.asarray(free)).max()
        np.testing.assert_allclose(charts, free, atol=AGREE * size)
