"""Constraints by multipliers that come to follow from each other: motions part."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import rollkane as rk
from rollkane import kane

LENGTH, MASSES, PULL, TORQUE, LAST = 0.4, (1.0, 1.3, 1.6), 3.0, 0.2, 6.0
ABOUT_PIVOT = LENGTH**2 * (MASSES[0] / 3.0 + MASSES[1] + MASSES[2] / 3.0)
LEVER = LENGTH * (0.5 * MASSES[0] + MASSES[1] + 0.5 * MASSES[2])


def normal(angle):
    return jnp.stack([-jnp.sin(angle), jnp.cos(angle), 0.0 * angle])


def parallelogram():
    """Cranks of one length, one unit apart, and a rod between them, flat every turn."""

    def turn(k):
        return lambda t, q, u: [0.0, 0.0, u[k]]

    middles = (
        lambda t, q, u: 0.5 * LENGTH * normal(q[0]) * u[0],
        lambda t, q, u: LENGTH * normal(q[0]) * u[0] + 0.5 * normal(q[1]) * u[1],
        lambda t, q, u: 0.5 * LENGTH * normal(q[2]) * u[2],
    )
    parts = [
        kane.RigidBody(m, m * length**2 / 12.0 * np.eye(3), middle, turn(k))
        for k, (m, length, middle) in enumerate(
            zip(MASSES, (LENGTH, 1.0, LENGTH), middles, strict=True)
        )
    ]
    loads = [
        kane.Load(middle, lambda t, q, u, m=m: [0.0, -m * PULL, 0.0])
        for m, middle in zip(MASSES, middles, strict=True)
    ]
    ends = lambda of, q: LENGTH * of(q[0]) + of(q[1]) - LENGTH * of(q[2])
    return kane.KaneSystem(
        *(3, 3, lambda t, q, u: u, parts),
        [*loads, kane.Load(turn(0), lambda t, q, u: [0.0, 0.0, TORQUE])],
        constraints=lambda t, q, u: (
            LENGTH * normal(q[0]) * u[0]
            + normal(q[1]) * u[1]
            - LENGTH * normal(q[2]) * u[2]
        )[:2],
        dependent=None,
        configuration=lambda t, q, u: [
            ends(jnp.cos, q) - 1.0,
            ends(jnp.sin, q),
        ],
        dependent_coordinates=(1, 2),
    )


SYSTEM = parallelogram()
# of one turn and of many, by tolerances from loose to fine
STARTS = [(0.3, 3.0), (1.0, 7.0), (1.8, -9.0), (2.6, 7.0)]


@pytest.mark.parametrize("rtol", [1e-3, 1e-5, 1e-7, 1e-9])
def test_no_motion_turns_off_where_constraints_follow_from_each_other(rtol):
    """The cranks stay parallel, or the run ends: it is never on the crossed linkage."""
    ended = 0
    for angle, rate in STARTS:
        start = kane.KaneState(
            jnp.array([angle, 0.0, angle]), jnp.array([rate, 0.0, rate])
        )
        run = kane.simulate(SYSTEM, start, np.linspace(0.0, LAST, 25), rtol=rtol)
        wanted = solve_ivp(
            lambda t, y: [y[1], (TORQUE - PULL * LEVER * np.cos(y[0])) / ABOUT_PIVOT],
            (0.0, LAST),
            (angle, rate),
            t_eval=run.time,
            **{"rtol": 1e-11, "atol": 1e-11, "method": "DOP853"},
        ).y[0]
        code = int(run.code)
        assert code in (rk.Code.COMPLETED, rk.Code.DEPENDENT_SPEEDS)
        reached = np.asarray(run.time) <= float(run.final_time)
        assert reached.sum() > 1
        if code == rk.Code.DEPENDENT_SPEEDS:
            ended += 1
            assert "motions part" in run.reason
            flat = np.abs(np.sin(np.asarray(run.final_state.q[0])))
            # three roots of the tolerance, or a tenth, of what the start has, which
            # is a sine, too
            assert flat < 1.2 * min(3.0 * np.sqrt(rtol), 0.1)
        # errors of a hundred or two steps, each of rtol of angles up to 70, which a
        # pendulum that goes round keeps in its rate: some tens of times as long
        error = np.abs(np.asarray(run.q)[reached, 0] - wanted[reached]).max()
        assert error < 2e3 * rtol * (1.0 + np.abs(wanted).max())
    assert ended > 0


def test_members_of_a_batch_end_alone():
    def end(angle, rate):
        start = kane.KaneState(
            jnp.stack([angle, 0.0 * angle, angle]), jnp.stack([rate, 0.0 * rate, rate])
        )
        return kane.simulate(SYSTEM, start, (0.0, 0.3), rtol=1e-9)

    # one swings back before it is flat, one comes there
    runs = jax.vmap(end)(jnp.array([1.5, 0.3]), jnp.array([0.5, -9.0]))
    assert int(runs.code[0]) == rk.Code.COMPLETED
    assert int(runs.code[1]) in (rk.Code.COMPLETED, rk.Code.DEPENDENT_SPEEDS)
    assert np.isfinite(runs.q[0]).all()


@pytest.mark.slow
def test_loops_of_which_one_parts_among_many():
    """What one row adds to the others is asked for, not a product of all."""
    count = 5

    def one(k, function, q):
        a, b, c = q[3 * k], q[3 * k + 1], q[3 * k + 2]
        return function(a), function(b), function(c)

    def rows(t, q, u):
        found = []
        for k in range(count):
            s, c = one(k, jnp.sin, q), one(k, jnp.cos, q)
            v = u[3 * k : 3 * k + 3]
            found += [LENGTH * (s[2] * v[2] - s[0] * v[0]) - s[1] * v[1]]
            found += [LENGTH * (c[0] * v[0] - c[2] * v[2]) + c[1] * v[1]]
        return found

    def configuration(t, q, u):
        found = []
        for k in range(count):
            s, c = one(k, jnp.sin, q), one(k, jnp.cos, q)
            found += [
                LENGTH * (c[0] - c[2]) + c[1] - 1.0,
                LENGTH * (s[0] - s[2]) + s[1],
            ]
        return found

    def turn(k):
        return lambda t, q, u: [0.0, 0.0, u[k]]

    still = lambda t, q, u: [0.0, 0.0, 0.0]
    moments = np.array([0.3, 0.2, 0.4] * count)
    system = kane.KaneSystem(
        *(3 * count, 3 * count, lambda t, q, u: u),
        [
            kane.RigidBody(1.0, m * np.eye(3), still, turn(k))
            for k, m in enumerate(moments)
        ],
        # springs that turn the rates of each loop, so that steps are short
        generalized_forces=lambda t, q, u: -3.0 * jnp.sin(q) * jnp.asarray(moments),
        constraints=rows,
        dependent=None,
        configuration=configuration,
        dependent_coordinates=[k for k in range(3 * count) if k % 3],
    )
    # the first comes to be flat, the others swing about a right angle
    angles = np.array([1.0, 1.4, 1.5, 1.6, 1.7])
    rates = np.array([-7.0, 0.3, -0.2, 0.1, 0.2])
    q = np.stack([angles, 0.0 * angles, angles], axis=1).ravel()
    u = np.stack([rates, 0.0 * rates, rates], axis=1).ravel()
    run = kane.simulate(system, kane.KaneState(q, u), np.linspace(0.0, 6.0, 25))
    crossed = np.asarray(run.q)[:, 0] - np.asarray(run.q)[:, 2]
    # ended, or parallel to the errors of some hundred steps
    assert np.nanmax(np.abs(crossed)) < 1e-6
    assert int(run.code) in (rk.Code.COMPLETED, rk.Code.DEPENDENT_SPEEDS)
