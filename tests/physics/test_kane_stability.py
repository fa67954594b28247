"""Equilibria of Kane systems by closed forms, and what is critical between them."""

import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk
from rollkane import kane

# Eigenvalues and places of points that are solved to 1e-10 (newton.SOLVED); Newton's
# method squares what is left, so that rounding stays.
CLOSE = 1e-10


def oscillator(force, **parameters):
    """A unit mass on a line, ``q'' = force(q, u, p)``."""

    def along(t, q, u):
        return [u[0], 0.0, 0.0]

    return kane.KaneSystem(
        *(1, 1, lambda t, q, u: u, [kane.Particle(1.0, along)]),
        generalized_forces=lambda t, q, u, p: force(q, u, p),
        parameters=parameters,
    )


def at(q, u=0.0):
    return kane.KaneState(jnp.array([q]), jnp.array([u]))


DAMPED = {
    "spring": (lambda q, u, p: p["k"] * (2.0 - q) - p["c"] * u, 2.0, 4.0),
    "pendulum": (
        lambda q, u, p: 2.0 - p["k"] * jnp.sin(q) - p["c"] * u,
        np.arcsin(0.5),
        4.0 * np.cos(np.arcsin(0.5)),
    ),
    "well": (lambda q, u, p: p["k"] * (1.0 - q**2) - p["c"] * u, 1.0, 8.0),
}


@pytest.mark.parametrize("name", DAMPED)
@pytest.mark.parametrize("damping", [0.0, 0.3, 3.0])
def test_an_equilibrium_is_found_from_beside_it(name, damping):
    """Whatever speed a step towards it leaves over: rounding, beside small motions."""
    force, place, stiffness = DAMPED[name]
    system = oscillator(force, k=4.0, c=damping)
    found = rk.steady_motion(system, at(0.8 * place, 0.1))
    assert float(found.state.q[0]) == pytest.approx(place, rel=CLOSE)
    assert abs(float(found.state.u[0])) < CLOSE
    wanted = np.roots([1.0, damping, stiffness])
    both = np.sort_complex(found.eigenvalues), np.sort_complex(wanted)
    np.testing.assert_allclose(*both, rtol=CLOSE)
    assert found.stable


@pytest.mark.parametrize("span", [(-1.0, 1.0), (-2.0, 2.0), (-1.0, 1.1), (-0.9, 0.77)])
def test_a_hopf_point_is_found_where_the_branch_has_a_point_on_it(span):
    """Of ``q'' = (mu - q^2) q' - q``: at mu = 0, a point of a round span's branch."""
    system = oscillator(lambda q, u, p: (p["mu"] - q**2) * u - q, mu=-0.5)
    start = rk.steady_motion(system, at(0.0))
    family = rk.steady_family(system, start, "parameters.mu", span)
    (critical,) = family.critical
    assert critical.kind == "Hopf"
    assert abs(critical.value) < CLOSE
    assert abs(critical.eigenvalue.imag) == pytest.approx(1.0, rel=CLOSE)
    values = np.asarray(family.values)
    beside = np.abs(values) > 1e-6
    assert (np.asarray(family.stable) == (values < 0.0))[beside].all()


@pytest.mark.parametrize("span", [(-1.0, 1.0), (-2.0, 2.0), (-1.0, 1.1)])
def test_a_pitchfork_is_found_where_the_branch_has_a_point_on_it(span):
    """Of ``q'' = mu q - q^3 - q'``: at mu = 0."""
    system = oscillator(lambda q, u, p: p["mu"] * q - q**3 - u, mu=-0.5)
    start = rk.steady_motion(system, at(0.0))
    family = rk.steady_family(system, start, "parameters.mu", span)
    (critical,) = family.critical
    assert critical.kind == "zero crossing"
    assert abs(critical.value) < CLOSE


def test_pairs_that_meet_on_the_axis_are_told_as_that():
    """Ziegler's kind: two modes coupled by a following force meet at p = 1."""

    def along(k):
        return lambda t, q, u: [u[k], 0.0, 0.0]

    def forces(t, q, u, p):
        # squares of frequencies: 2 -+ sqrt(1 - p^2)
        turn = p["p"] * jnp.array([q[1], -q[0]])
        return -jnp.array([q[0], 3.0 * q[1]]) + turn

    system = kane.KaneSystem(
        *(2, 2, lambda t, q, u: u, [kane.Particle(1.0, along(k)) for k in range(2)]),
        generalized_forces=forces,
        parameters={"p": 0.3},
    )
    start = rk.steady_motion(system, kane.KaneState(jnp.zeros(2), jnp.zeros(2)))
    for span in (0.0, 2.0), (0.1, 1.77):
        family = rk.steady_family(system, start, "parameters.p", span)
        (critical,) = family.critical
        assert critical.kind == "collision"
        # where two meet, eigenvalues go with the root of what is left
        assert critical.value == pytest.approx(1.0, abs=1e-8)
