"""Members of a study: the same however they are computed, and as simulate has them."""

from concurrent.futures import ThreadPoolExecutor

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk
from rollkane.uncertainty.fingerprint import fingerprint
from rollkane.uncertainty.sampling import sampler
from rollkane.uncertainty.study_model import StudyModel
from tests import small_studies as small
from tests.small_studies import compiled_once, equal

__all__ = ["compiled_once"]
pytestmark = pytest.mark.usefixtures("compiled_once")

# Of numbers of order one that a program of another shape rounds otherwise: some 20
# steps of the ball's motion, each with a few roundings of 1e-16, grown by less than 10.
ROUNDED = {"rtol": 1e-12, "atol": 1e-12}


def alone(study, seed, member, **how):
    """One member, by ``rk.simulate`` of its own draw."""
    u = sampler("plain", study.draws.dimension, seed, 10**6).uniforms(member, 1)[0]
    scene, start = study.make(study.draws.draw(jnp.asarray(u)))
    return scene, rk.simulate(scene, start, study.times, **how)


@pytest.mark.parametrize("sampling", ["plain", "latin", "sobol"])
def test_members_are_the_same_in_all_blocks_and_threads(sampling):
    """2100 members: two units of 1024, and a part of one."""
    study = small.rolling()
    how = {"seed": 3, "sampling": sampling}
    first = rk.monte_carlo(study, 2100, **how, block=64, workers=1)
    assert first.rates.method == "native"
    for block, workers in ((4096, 1), (700, 3), (1024, 2)):
        again = rk.monte_carlo(study, 2100, **how, block=block, workers=workers)
        assert equal(first, again)
        # statistics depend on the members and their order alone
        assert str(again) == str(first)
        for name, mean in first.mean.items():
            np.testing.assert_array_equal(again.mean[name], mean)


def test_members_do_not_depend_on_how_many_there_are():
    study = small.rolling()
    few, many = (rk.monte_carlo(study, n, seed=4) for n in (10, 1100))
    for name in few.columns:
        np.testing.assert_array_equal(few.values(name), many.values(name)[:10])


def test_a_pool_of_the_user_s_own_computes_the_same():
    study = small.rolling()
    with ThreadPoolExecutor(2) as pool:
        own = rk.monte_carlo(study, 300, seed=3, executor=pool, block=100)
    assert equal(own, rk.monte_carlo(study, 300, seed=3))


@pytest.mark.parametrize("member", [0, 1, 1030])
def test_a_member_is_what_simulate_makes_of_its_draw(member):
    study = small.rolling()
    found = rk.monte_carlo(study, 1031, seed=5)
    scene, run = alone(study, 5, member)
    for name in study.draws.names:
        kept = found.values(f"draw.{name}")[member]
        own = scene.body.mass if name == "mass" else run.angular_velocity[0, 1]
        np.testing.assert_allclose(kept, own, rtol=1e-14)  # roundings of one product
    of = lambda name: found.values(name)[member]
    np.testing.assert_allclose(of("energy"), run.energy[-1], **ROUNDED)
    np.testing.assert_allclose(of("end"), run.position[-1], **ROUNDED)
    np.testing.assert_allclose(of("way"), run.position[:, 0], **ROUNDED)
    assert of("fast") == float(run.state.angular_velocity[-1, 1] > 4.0)
    assert of("final_time") == 0.1
    # rolls 0.04 m in 0.1 s where it is faster than 4 rad/s, drag aside
    assert of("passes.count") == int(run.position[-1, 0] > 0.04)


def test_statistics_are_those_of_the_members():
    study = small.rolling()
    found = rk.monte_carlo(study, 5000, seed=6, block=512)
    end, fast = found.values("end"), found.values("fast")
    # sums of 5000 numbers of order one: roundings of 1e-16 each
    np.testing.assert_allclose(found.mean["end"], end.mean(0), rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(
        found.standard_error["end"],
        end.std(0, ddof=1) / np.sqrt(5000),
        rtol=1e-10,
        atol=1e-15,  # of a height that all share, to rounding
    )
    assert found.probability["fast"] == fast.mean()
    passed = found.values("passes.count") > 0
    assert found.probability["passes"] == passed.mean()
    times = found.values("passes.time")[passed, 0]
    np.testing.assert_allclose(found.mean["passes time"], times.mean(), rtol=1e-12)
    assert np.isnan(found.values("passes.time")[~passed]).all()
    # of a normal rate, 4 in the middle, drag slows it: about a half, 6 sigma of 5000
    assert abs(found.probability["fast"] - 0.46) < 0.05


def test_events_that_stop_motions():
    study = small.stopping()
    found = rk.monte_carlo(study, 100, seed=7)
    code, at = found.values("code"), found.values("final_time")
    stopped = code == rk.Code.STOPPED
    assert 20 < stopped.sum() < 80  # half of the rates, see above
    assert found.failed == 0
    end = found.values("end")[:, 0]
    # where the event was found: its time is good to 1e-12 s or so, speeds below 1 m/s
    np.testing.assert_allclose(end[stopped], 0.04, atol=1e-10)
    assert (at[stopped] < 0.1).all()
    assert (at[~stopped] == 0.1).all()
    way, times = found.values("way"), np.asarray(small.TIMES)
    np.testing.assert_array_equal(np.isfinite(way), times <= at[:, None])


def test_failed_members_are_counted_and_in_no_statistic():
    study = small.failing()
    found = rk.monte_carlo(study, 2000, seed=8)
    bad = found.values("draw.mass") <= 0.0
    np.testing.assert_array_equal(found.values("code") == rk.Code.BAD_SCENE, bad)
    assert found.failed == bad.sum()
    assert 400 < bad.sum() < 600  # a quarter, 5 sigma
    assert sum(found.reasons.values()) == 2000
    reasons = [(why, n) for why, n in found.reasons.items() if "body.mass" in why]
    assert [n for _, n in reasons] == [bad.sum()]
    for name in ("energy", "one", "fast", "ones", "more"):
        lost = np.isnan(found.values(name))
        assert lost[bad].all(), name
        assert not lost[~bad].any(), name
    assert found.mean["one"] == 1.0
    assert found.probability["fast"] == found.values("fast")[~bad].mean()
    assert found.probability["passes"] == np.mean(found.values("passes.count")[~bad])
    np.testing.assert_allclose(
        found.mean["energy"], found.values("energy")[~bad].mean(), rtol=1e-12
    )


def test_a_study_of_which_all_fail_has_no_mean():
    found = rk.monte_carlo(small.tiring(), 50, seed=9)
    assert found.failed == found.size == 50
    assert found.codes == {rk.Code.MAX_STEPS: 50}
    assert np.isnan(found.mean["energy"])
    assert "50" in str(found)


def test_codes_that_count_as_good_ends():
    strict, loose = (small.falling(ends) for ends in ((), (rk.Code.SURFACE_EDGE,)))
    left, right = (rk.monte_carlo(s, 64, seed=10) for s in (strict, loose))
    flat = left.values("code") == rk.Code.SURFACE_EDGE
    np.testing.assert_array_equal(left.values("code"), right.values("code"))
    assert 10 < flat.sum() < 64
    assert left.failed == flat.sum()
    assert right.failed == 0
    np.testing.assert_array_equal(np.isnan(left.values("energy")), flat)
    assert np.isfinite(right.values("energy")).all()
    assert fingerprint(strict) != fingerprint(loose)


@pytest.mark.parametrize(
    "name", ["shaking", pytest.param("bouncing", marks=pytest.mark.slow)]
)
def test_bases_that_move_and_contacts_that_change(name):
    """Blocks of a unit and of parts of it; members as simulate has them."""
    study = getattr(small, name)()
    found = rk.monte_carlo(study, 100, seed=11, block=64, workers=1)
    assert found.failed == 0
    assert equal(found, rk.monte_carlo(study, 100, seed=11, block=30, workers=3))
    _, run = alone(study, 11, 70, modes=study.modes)
    np.testing.assert_allclose(found.values("end")[70], run.position[-1], **ROUNDED)
    if name == "bouncing":
        assert run.switches.count > 0


def test_drawn_friction():
    """Balls that slip and grip, by Coulomb's law: each at its own friction.

    A ball thrown along a lane grips at t = 2 v / (7 mu g), with 5/7 of its speed. The
    runs are at rtol 1e-9, some hundred steps of it at most: 1e-7 of 30 m.
    """
    radius, speed, end, g = 0.11, 8.0, 4.0, 9.81
    ball = rk.Body(6.0, 0.4 * 6.0 * radius**2 * np.eye(3), rk.Sphere(radius))
    slips = rk.Scene(ball, contact=rk.Slipping(rk.CoulombFriction(0.2)))
    along = lambda v: jnp.stack([v, 0.0 * v, 0.0 * v])

    def thrown(draw):
        v = draw["speed"]
        start = rk.place(
            slips, small.UPRIGHT, small.ORIGIN, small.ORIGIN, velocity=along(v)
        )
        return slips, start, rk.Modes(friction=draw["friction"])

    drawn = {"friction": rk.Uniform(0.1, 0.3), "speed": rk.Normal(speed, 0.5)}
    seen = {"x": small.distance, "w": lambda scene, t, x: x.angular_velocity[1]}
    study = rk.Study(thrown, drawn, [0.0, end], seen, rtol=1e-9)
    found = rk.monte_carlo(study, 100, seed=14)
    mu, v = (found.values(f"draw.{name}") for name in drawn)
    grips = 2.0 * v / (7.0 * mu * g)
    away = v * grips - 0.5 * mu * g * grips**2 + 5.0 / 7.0 * v * (end - grips)
    np.testing.assert_allclose(found.values("x"), away, rtol=0.0, atol=3e-6)
    rolls = 5.0 * v / (7.0 * radius)
    np.testing.assert_allclose(found.values("w"), rolls, rtol=1e-7)
    # away = 5/7 v end + v grips / 7, and grips goes as 1 / mu
    slopes = StudyModel(study).value_and_gradient(np.full((1, 2), 0.5), "x")
    by_friction = -(speed * 2.0 * speed / (49.0 * g)) / 0.2**2  # [m]
    np.testing.assert_allclose(slopes.gradients[0, 0], by_friction * 0.2, rtol=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize("executor", ["processes", "dask"])
@pytest.mark.parametrize("name", ["rolling", "bouncing"])
def test_other_processes_compute_the_same(executor, name):
    study = getattr(small, name)()
    here = rk.monte_carlo(study, 1500, seed=12, block=500)
    there = rk.monte_carlo(
        study, 1500, seed=12, block=500, executor=executor, workers=2
    )
    assert equal(here, there)
    assert there.rates.members == 1500


def test_draws_reach_members_alone_and_together():
    """What vmap of the study's own function makes is what members are made of."""
    study = small.rolling()
    found = rk.monte_carlo(study, 8, seed=13)
    u = sampler("plain", 2, 13, 8).uniforms(0, 8)
    made = jax.vmap(lambda u: study.make(study.draws.draw(u))[0].body.mass)(u)
    np.testing.assert_allclose(found.values("draw.mass"), made, rtol=1e-14)
