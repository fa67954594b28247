"""Velocities that jump at a kink are impacts: refused; what else jumps there is not."""

import jax.numpy as jnp
import numpy as np
import pytest

from rollkane import kane
from rollkane.validation.checks import FieldError

LENGTH, PULL, JUMP = 0.7, 9.81, 0.5
TIMES = np.linspace(0.0, 1.0, 5)


def moved(t):
    return jnp.where(t > JUMP, t - JUMP, 0.0)


def moves(t):
    return jnp.where(t > JUMP, 1.0, 0.0)


def weight(t, q, u):
    return [0.0, -PULL, 0.0]


def by_angle(velocity, kinks=(JUMP,)):
    """A pendulum under a support that moves along x."""

    def bob(t, q, u):
        x, y = jnp.cos(q[0]) * u[0], jnp.sin(q[0]) * u[0]
        return [velocity(t) + LENGTH * x, LENGTH * y, 0.0]

    return kane.KaneSystem(
        *(1, 1, lambda t, q, u: u, [kane.Particle(1.0, bob)]),
        [kane.Load(bob, weight)],
        kinks=kinks,
    ), kane.KaneState(jnp.array([0.3]), jnp.zeros(1))


def by_places(dependent):
    """The same in Cartesian coordinates, the rod a constraint."""
    bob = lambda t, q, u: [u[0], u[1], 0.0]
    closed = lambda t, q, u: [(q[0] - moved(t)) * (u[0] - moves(t)) + q[1] * u[1]]
    system = kane.KaneSystem(
        *(2, 2, lambda t, q, u: u, [kane.Particle(1.0, bob)]),
        [kane.Load(bob, weight)],
        constraints=closed,
        dependent=dependent,
        kinks=[JUMP],
    )
    count = 2 if dependent is None else 1
    q = LENGTH * jnp.array([jnp.sin(0.3), -jnp.cos(0.3)])
    return system, kane.KaneState(q, jnp.zeros(count))


@pytest.mark.parametrize("dependent", [None, (0,), (1,)])
def test_a_constraint_that_asks_for_a_jump_is_refused(dependent):
    with pytest.raises(FieldError, match="constraints: asks for speeds that jump"):
        kane.simulate(*by_places(dependent), TIMES)


def test_a_support_whose_velocity_jumps_is_refused():
    with pytest.raises(FieldError, match=r"parts\[0\].velocity: jumps at the kink t ="):
        kane.simulate(*by_angle(moves), TIMES)
    # not where the run does not come there, or begins there
    for times in (TIMES[:2], TIMES[2:]):
        assert kane.simulate(*by_angle(moves), times).succeeded


def test_a_share_of_speeds_that_jumps_is_seen_at_rest():
    """A skate that is turned at once, and stands still at the start."""
    point = lambda t, q, u: [u[0], u[1], 0.0]
    system = kane.KaneSystem(
        *(2, 2, lambda t, q, u: u, [kane.Particle(1.0, point)]),
        [kane.Load(point, lambda t, q, u: [1.0, 0.0, 0.0])],
        constraints=lambda t, q, u: [u[1] - 0.5 * moves(t) * u[0]],
        dependent=(1,),
        kinks=[JUMP],
    )
    with pytest.raises(FieldError, match="impact"):
        kane.simulate(system, kane.KaneState(jnp.zeros(2), jnp.zeros(1)), TIMES)


def test_corners_of_a_velocity_and_what_moves_no_mass_are_not_refused():
    run = kane.simulate(*by_angle(moved), TIMES, rtol=1e-12)
    # the two parts as runs of their own, whose support has one acceleration each
    first = kane.simulate(*by_angle(lambda t: 0.0 * t, ()), TIMES[:3], rtol=1e-12)
    system, _ = by_angle(lambda t: t - JUMP, ())
    second = kane.simulate(system, first.final_state, TIMES[2:], rtol=1e-12)
    # twenty steps, each of 1e-12 of speeds up to 3
    np.testing.assert_allclose(run.u[2:], second.u, rtol=0, atol=20 * 3e-12)
    pointer = kane.KaneSystem(
        *(2, 2, lambda t, q, u: u),
        [kane.Particle(1.0, lambda t, q, u: [u[0], 0.0, 0.0])],
        constraints=lambda t, q, u: [u[1] - moves(t)],
        dependent=(1,),
        kinks=[JUMP],
    )
    run = kane.simulate(pointer, kane.KaneState(jnp.zeros(2), jnp.ones(1)), TIMES)
    np.testing.assert_allclose(run.q[-1], [1.0, 0.5], rtol=0, atol=1e-13)
