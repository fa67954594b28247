"""Dependent speeds that the constraints stop determining: a motion ends there."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk
from rollkane import kane
from rollkane.kane.linear_solves import determinant
from rollkane.validation.checks import FieldError

from ..quick import slow_but

MASS, INERTIA, BEHIND = 2.0, 0.3, 0.2
HEADING, AHEAD, TURN = 0.3, 1.0, 2.0  # at the start [rad], [m/s], [rad/s]
TIMES = np.linspace(0.0, 3.0, 31)  # it heads along y after 1.23 s


def velocity(t, q, u):
    return [u[0], u[1], 0.0]


def sleigh(dependent, mass=MASS):
    """Chaplygin's: a knife edge behind the mass centre, which does not slide aside."""

    def aside(t, q, u):
        return [jnp.cos(q[2]) * u[1] - jnp.sin(q[2]) * u[0] - BEHIND * u[2]]

    body = kane.RigidBody(
        lambda p: p,
        INERTIA * np.eye(3),
        velocity,
        lambda t, q, u: [0.0 * u[2], 0.0, u[2]],
    )
    return kane.KaneSystem(
        *(3, 3, lambda t, q, u: u, [body]),
        constraints=aside,
        dependent=dependent,
        parameters=mass,
    )


def started(dependent, heading=HEADING):
    c, s = np.cos(heading), np.sin(heading)
    aside = BEHIND * TURN
    u = np.array([c * AHEAD - s * aside, s * AHEAD + c * aside, TURN])
    kept = np.delete(u, dependent or ())
    return kane.KaneState(jnp.array([0.0, 0.0, heading]), jnp.asarray(kept))


def moved(dependent, mass=MASS, **options):
    start = started(dependent)
    return kane.simulate(sleigh(dependent, mass), start, TIMES, **options)


@pytest.mark.parametrize("method", ["native", "diffrax"])
@pytest.mark.parametrize("rtol", [1e-3, 1e-6, 1e-9])
def test_a_motion_ends_where_its_dependent_speed_is_not_determined(method, rtol):
    """The speed along y, where the sleigh heads along y; no step jumps across."""
    run = moved((1,), rtol=rtol, method=method)
    assert int(run.code) == rk.Code.DEPENDENT_SPEEDS
    assert "dependent=None" in run.reason
    # the determinant, cos(heading) over the row's length, which stays, is then that of
    # the start times the root of the tolerance, or a hundredth
    share = min(3.0 * np.sqrt(rtol), 1e-2) * np.cos(HEADING)
    assert np.cos(float(run.final_state.q[2])) == pytest.approx(share, rel=2e-3)
    wanted = moved(None, rtol=1e-11)
    assert wanted.succeeded
    reached = float(run.final_time) >= TIMES
    assert 5 < reached.sum() < TIMES.size
    assert not np.isfinite(run.q[~reached]).any()
    # some ten steps, each wrong by rtol of places and speeds of a metre and 2 m/s
    error = np.abs(np.asarray(run.q - wanted.q))[reached].max()
    assert error < 10 * 2.0 * rtol


@pytest.mark.parametrize("rtol", [1e-3, 1e-6, 1e-9, 1e-11])
@pytest.mark.parametrize("depth", [1.00001, 1.001, 1.1])
def test_a_brief_dip_through_such_a_place_is_not_stepped_over(depth, rtol):
    """A bead on a wire whose slope is below zero for a moment, by its speed along y."""
    slope = lambda x: 1.0 - depth * jnp.exp(-((x / 0.3) ** 2))
    bead = lambda t, q, u: [u[0], u[1], 0.0]
    system = kane.KaneSystem(
        *(2, 2, lambda t, q, u: u, [kane.Particle(1.0, bead)]),
        [kane.Load(bead, lambda t, q, u: [0.0, -1.0, 0.0])],
        constraints=lambda t, q, u: [u[1] - slope(q[0]) * u[0]],
        dependent=(0,),
    )
    along = 1.5 * slope(-1.0)
    start = kane.KaneState(jnp.array([-1.0, 0.0]), along[None])
    run = kane.simulate(system, start, (0.0, 1.0, 2.0), rtol=rtol)
    assert int(run.code) == rk.Code.DEPENDENT_SPEEDS
    # where it is level is the root of exp(-(x / 0.3)^2) = 1 / depth; it ends before
    level = -0.3 * np.sqrt(np.log(depth))
    assert -0.2 < float(run.final_state.q[0]) < level


@pytest.mark.parametrize("angle", [0.03, 0.2, 0.45])
def test_no_motion_goes_across_where_a_row_vanishes(angle):
    """A rod as long as its crank: upright the slider is free, and motions part."""
    r, inertia = 0.2, 0.003 * np.eye(3)
    crank = kane.RigidBody(
        0.5, inertia, lambda t, q, u: [0.0, 0.0, 0.0], lambda t, q, u: [0.0, 0.0, u[0]]
    )
    slider = kane.Particle(0.7, lambda t, q, u: [u[2], 0.0, 0.0])
    closed = lambda t, q, u: [
        -r * jnp.sin(q[0]) * u[0] - r * jnp.sin(q[1]) * u[1] - u[2],
        r * jnp.cos(q[0]) * u[0] + r * jnp.cos(q[1]) * u[1],
    ]
    system = kane.KaneSystem(
        *(3, 3, lambda t, q, u: u, [crank, slider]),
        constraints=closed,
        dependent=(1, 2),
    )
    q = np.array([angle, -angle, 2.0 * r * np.cos(angle)])
    run = kane.simulate(system, kane.KaneState(q, np.array([3.0])), [0.0, 4.0])
    assert int(run.code) == rk.Code.DEPENDENT_SPEEDS
    # the row is as long as the cosine: of that of the start, as in the first test
    end, share = run.final_state.q, 3.0 * np.sqrt(1e-9) * np.cos(angle)
    assert np.cos(float(end[0])) == pytest.approx(share, rel=2e-3)
    # on the motion that it began: 1e-9 for each of some thirty steps
    np.testing.assert_allclose(end[1], -end[0], rtol=0, atol=30 * 1e-9)


def test_choices_that_stay_determined_agree_with_multipliers():
    wanted = moved(None, rtol=1e-11)
    for chosen in (0,), (2,):
        run = moved(chosen, rtol=1e-11)
        assert run.succeeded
        assert run.method == "native"
        # thirty steps of either, each wrong by 1e-11 of 2 m/s at most
        np.testing.assert_allclose(run.q, wanted.q, atol=2 * 30 * 2e-11)


def test_a_member_that_ends_there_ends_alone_and_has_no_derivatives_behind():
    def end(mass, late):
        start = started((1,))
        start = kane.KaneState(start.q.at[2].add(late), start.u)
        return kane.simulate(sleigh((1,), mass), start, (0.0, 0.5))

    runs = jax.vmap(end, in_axes=(None, 0))(MASS, jnp.array([0.0, 1.0]))
    assert runs.code.tolist() == [rk.Code.COMPLETED, rk.Code.DEPENDENT_SPEEDS]
    slopes = jax.vmap(jax.grad(lambda m, late: end(m, late).q[-1, 0]), (None, 0))(
        MASS, jnp.array([0.0, 1.0])
    )
    assert np.isfinite(slopes[0])
    assert np.isnan(slopes[1])


@pytest.mark.parametrize("off", [0.0, 1e-9, -1e-9])
def test_a_start_there_is_refused(off):
    system = sleigh((1,))
    q = jnp.array([0.0, 0.0, 0.5 * np.pi + off])
    start = kane.KaneState(q, jnp.array([0.0, TURN]))
    with pytest.raises(FieldError, match="do not determine the dependent speeds"):
        kane.simulate(system, start, (0.0, 1.0))


@pytest.mark.parametrize("off", [0.0, 1e-9, 1e-7])
def test_constraints_by_multipliers_that_nearly_agree_are_refused(off):
    """From them the accelerations would follow to 1e-16 / off^2."""
    system = kane.KaneSystem(
        *(3, 3, lambda t, q, u: u, [kane.Particle(1.0, lambda t, q, u: u)]),
        constraints=lambda t, q, u: [u[2] - u[0], u[2] - u[0] * (1.0 + off)],
        dependent=None,
    )
    start = kane.KaneState(jnp.zeros(3), jnp.zeros(3))
    with pytest.raises(FieldError, match="follow from each other"):
        kane.simulate(system, start, (0.0, 1.0))


@pytest.mark.parametrize("method", ["native", "diffrax"])
def test_a_start_that_cannot_be_takes_no_time_and_no_steps(method):
    start = started(None)
    bad = kane.KaneState(start.q, start.u.at[0].set(np.nan))
    run = kane.simulate(sleigh(None), bad, TIMES, method=method)
    assert int(run.code) == rk.Code.BAD_START
    assert "start.u" in run.reason
    ended = float(run.final_time), int(run.steps), int(run.rejected_steps)
    assert ended == (0.0, 0, 0)


@pytest.mark.parametrize("size", [1, 2, 3, 5, 12, 14])
def test_determinants_are_those_of_numpy(size):
    draw = np.random.default_rng(size)
    for _ in range(4):
        C = draw.standard_normal((size, size))
        C[0, 0] = 0.0  # needs an exchange of rows, where there are some
        found, wanted = float(determinant(jnp.asarray(C))), np.linalg.det(C)
        # eliminations by largest pivots, both: some roundings of each product
        scale = np.prod(np.linalg.norm(C, axis=1))
        assert found == pytest.approx(wanted, abs=1e2 * np.finfo(float).eps * scale)


@pytest.mark.parametrize("count", slow_but([2], [2, 7, 15]))
def test_chains_of_many_dependent_speeds_go_on(count):
    """Two speeds a link follow from the angles' rates; rows of any size."""

    def held(scale):
        def constraints(t, q, u):
            x = jnp.cumsum(-jnp.sin(q) * u[:count])
            y = jnp.cumsum(jnp.cos(q) * u[:count])
            gaps = u[count : 2 * count] - x, u[2 * count :] - y
            return scale * jnp.concatenate(gaps)

        def bob(i):
            return lambda t, q, u: [u[count + i], u[2 * count + i], 0.0]

        bobs = [bob(i) for i in range(count)]
        return kane.KaneSystem(
            *(count, 3 * count, lambda t, q, u: u[:count]),
            [kane.Particle(1.0, v) for v in bobs],
            [kane.Load(v, lambda t, q, u: [9.81, 0.0, 0.0]) for v in bobs],
            constraints=constraints,
            dependent=range(count, 3 * count),
        )

    start = kane.KaneState(jnp.full(count, 0.3), jnp.zeros(count))
    times = np.linspace(0.0, 1.0, 3)
    runs = [kane.simulate(held(scale), start, times) for scale in (1.0, 1e-3)]
    for run in runs:
        assert run.succeeded
        # the weight is along x: what falls stays in the energy
        fallen = jnp.sum(jnp.cumsum(jnp.cos(run.q), axis=1), axis=1)
        energy = run.kinetic_energy - 9.81 * fallen
        # some hundred steps at 1e-9 of speeds up to ten
        np.testing.assert_allclose(energy, energy[0], atol=1e-5)
    # roundings of 30 terms, which a chain magnifies by a hundred at most in a second
    np.testing.assert_allclose(runs[0].q, runs[1].q, atol=1e-6)


@pytest.mark.parametrize("count", [1, 2, 3, 4])
def test_any_number_of_dependent_speeds_runs_in_c(count):
    """Masses on a line, each geared to the first; the last under a force."""
    gears = 1.0 + 0.5 * np.arange(1, count + 1)

    def along(k):
        return lambda t, q, u: [u[k], 0.0, 0.0]

    system = kane.KaneSystem(
        *(count + 1, count + 1, lambda t, q, u: u),
        [kane.Particle(1.0, along(k)) for k in range(count + 1)],
        [kane.Load(along(count), lambda t, q, u: [3.0, 0.0, 0.0])],
        constraints=lambda t, q, u: [u[k + 1] - gears[k] * u[0] for k in range(count)],
        dependent=range(1, count + 1),
    )
    start = kane.KaneState(jnp.zeros(count + 1), jnp.zeros(1))
    run = kane.simulate(system, start, (0.0, 2.0))
    assert (run.method, run.why) == ("native", "")
    rate = 3.0 * gears[-1] / (1.0 + np.sum(gears**2))
    # evenly accelerated: steps of order 8 are exact, up to some roundings each
    assert float(run.q[-1, 0]) == pytest.approx(0.5 * rate * 4.0, rel=1e-13)
