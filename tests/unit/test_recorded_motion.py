"""The clock of a record: which are taken, and that every time finds its samples."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk
from rollkane.identification.layout import known_paths
from rollkane.identification.parameters import Model
from rollkane.validation.checks import FieldError

# clocks as files print them: count, step [s], decimals; off by up to 0.15 of a step
PRINTED = {
    "exact": (200, 0.01, 9),
    "1/150 s to a millisecond": (3000, 1 / 150, 3),
    "1/128 s to a millisecond": (1000, 1 / 128, 3),
    "three samples": (3, 1 / 3, 1),
    "two samples": (2, 0.3, 1),
}


def clock(name):
    count, step, decimals = PRINTED[name]
    return np.round(2.0 + step * np.arange(count), decimals)


def between(time):
    """Times inside each interval, on the samples and beside them."""
    inside = time[:-1, None] + np.diff(time)[:, None] * np.linspace(0.0, 1.0, 12)[:-1]
    beside = np.nextafter(time[1:-1, None], [-1e9, 1e9])
    return np.sort(np.concatenate([inside.ravel(), beside.ravel(), time[-1:]]))


@jax.jit
def all_at(motion, times):
    return jax.vmap(motion.at)(times)


@pytest.mark.parametrize("name", PRINTED)
def test_every_time_finds_its_samples(name):
    time = clock(name)
    values = np.random.default_rng(7).uniform(-1.0, 1.0, (len(time), 3))
    motion = rk.RecordedMotion(time, values)
    t = between(time)
    found = all_at(motion, jnp.asarray(t)).acceleration
    for axis in range(3):
        expected = np.interp(t, time, values[:, axis])
        # a slope of 2 in a step of at least 1/150 s, times the rounding of t up to 22 s
        np.testing.assert_allclose(found[:, axis], expected, atol=300 * 2e-15 * 22)


def test_velocity_and_position_are_continuous_on_a_printed_clock():
    """The pieces meet: on both sides of every sample the same motion."""
    time = clock("1/150 s to a millisecond")[:400]
    values = np.random.default_rng(8).uniform(-1.0, 1.0, len(time))
    motion = rk.RecordedMotion(time, values)
    before, behind = (
        all_at(motion, jnp.asarray(np.nextafter(time[1:-1], side)))
        for side in (-1e9, 1e9)
    )
    # the motion of one rounding of the time, 9e-16 s, at less than 3 m/s, and sums
    for name in ("velocity", "position"):
        np.testing.assert_allclose(
            getattr(before, name), getattr(behind, name), atol=1e-13
        )
    np.testing.assert_allclose(behind.velocity, motion.velocity[1:-1], atol=1e-13)


def drifting(part, count=30_000):
    """Steps that are a part shorter in the first half than in the second."""
    halves = np.sign(np.arange(count) - count / 2)
    return np.cumsum(0.01 * (1.0 + part * halves))


@pytest.mark.parametrize("part", [5e-4, 1e-4, 2e-5])
def test_a_drifting_clock_is_refused(part):
    """Each step is good to a thousandth, and the middle is off by count / 2 of that."""
    time = drifting(part)
    off = 15_000 * part * 0.01
    with pytest.raises(
        FieldError, match=r"RecordedMotion\.time: must grow by equal"
    ) as e:
        rk.RecordedMotion(time, np.zeros(len(time)))
    (found,) = [word for word in str(e.value).split() if word == f"{off:.3g}"]
    assert float(found) == pytest.approx(off, rel=5e-3)


def test_a_sample_that_is_missing_is_noticed():
    """Wherever it is, and however few there are."""
    for count in range(4, 40):
        for gone in range(1, count - 1):
            time = np.delete(0.02 * np.arange(count), gone)
            with pytest.raises(FieldError, match="must grow by equal steps"):
                rk.RecordedMotion(time, np.zeros(count - 1))


DISORDER = {
    "falling": ([0.0, 0.1, 0.3, 0.2], "row 3 has 0.2 s after 0.3 s"),
    "twice the same": ([0.0, 0.1, 0.1, 0.2], "row 2 has 0.1 s after 0.1 s"),
    "all the same": ([0.5, 0.5], "row 1 has 0.5 s after 0.5 s"),
    "backwards": ([3.0, 2.0, 1.0, 0.0], "row 1 has 2.0 s after 3.0 s"),
    "by a rounding": (
        [0.1 + 0.2, 0.3, 0.6],
        "row 1 has 0.3 s after 0.30000000000000004",
    ),
    "after a gap": ([0.0, 0.1, 0.9, 1.0, 0.95], "row 4 has 0.95 s after 1.0 s"),
}


@pytest.mark.parametrize("name", DISORDER)
def test_times_out_of_order_are_told_from_a_gap(name):
    """By the first pair, and with what mends it: a gap's remedy does not."""
    time, pair = DISORDER[name]
    with pytest.raises(FieldError, match=pair) as caught:
        rk.RecordedMotion(time, np.zeros(len(time)))
    assert caught.value.field == "RecordedMotion.time"
    assert "sort" in caught.value.remedy
    assert "leave out repeated" in caught.value.remedy


def test_a_traced_clock_is_judged_too():
    values = jnp.zeros(3000)

    def position(time):
        return rk.RecordedMotion(time, values).at(time[3]).position[0]

    good, bad = (jnp.asarray(drifting(part, 3000)) for part in (0.0, 2e-4))
    lanes = jax.jit(jax.vmap(position))(jnp.stack([good, bad]))
    assert lanes[0] == 0.0
    assert np.isnan(lanes[1])


def test_velocity_and_position_follow_the_samples():
    """Of a record whose samples are exchanged, scaled or differentiated by."""
    time, rng = clock("1/128 s to a millisecond")[:60], np.random.default_rng(9)
    values = rng.uniform(-1.0, 1.0, (60, 3))
    start = rng.uniform(-1.0, 1.0, (2, 3))
    motion = rk.RecordedMotion(time, values, *start)
    moved = eqx.tree_at(lambda m: m.acceleration, motion, 2.0 * motion.acceleration)
    t = jnp.asarray(between(time)[5:300:7])
    twice = all_at(rk.RecordedMotion(time, 2.0 * values, *start), t)
    for name in ("acceleration", "velocity", "position"):
        same = getattr(all_at(moved, t), name), getattr(twice, name)
        # roundings of sums of 60 numbers of at most 2
        np.testing.assert_allclose(*same, atol=60 * 2 * 2.3e-16)

    def along(scale):
        samples = motion.acceleration * scale
        return all_at(eqx.tree_at(lambda m: m.acceleration, motion, samples), t)

    # all are linear in the samples
    _, rates = jax.jvp(along, (1.0,), (1.0,))
    still = all_at(rk.RecordedMotion(time, 0.0 * values, *start), t)
    for name in ("acceleration", "velocity", "position"):
        change = getattr(twice, name) - getattr(still, name)
        np.testing.assert_allclose(2.0 * getattr(rates, name), change, atol=1e-13)


def test_free_numbers_of_a_record_are_those_it_is_made_of():
    motion = rk.RecordedMotion([0.0, 0.1, 0.2], np.ones(3))
    scene = rk.Scene(
        rk.Body(1.0, 0.004 * np.eye(3), rk.Sphere(0.1)), rk.Base(rk.Plane(), motion)
    )
    start = rk.place(scene, (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    offered = known_paths(Model(scene, start, jnp.zeros(()), None, {}))
    assert [path for path in offered if path.startswith("base.motion.")] == [
        "base.motion.acceleration",
        "base.motion.start_velocity",
        "base.motion.start_position",
    ]


@pytest.mark.parametrize("path", ["base.motion.time", "base.motion.time[1]"])
def test_the_clock_of_a_record_is_not_free(path):
    """Its times would come out of order."""
    motion = rk.RecordedMotion([0.0, 0.1, 0.2], np.ones(3))
    scene = rk.Scene(
        rk.Body(1.0, 0.004 * np.eye(3), rk.Sphere(0.1)), rk.Base(rk.Plane(), motion)
    )
    start = rk.place(scene, (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    record = rk.Record([0.0, 0.1], {"gyro": rk.Gyro(np.ones((2, 3)), 0.1)})
    tied = [rk.Free("body.mass"), rk.Tied(path, lambda v: v["body.mass"])]
    for free in (rk.Free(path), tied):
        with pytest.raises(FieldError, match="delay of a channel") as caught:
            rk.fit(scene, start, record, free)
        assert caught.value.field == "Free.path"


@pytest.mark.parametrize("traced", [False, True])
def test_a_long_record_in_single_precision(traced):
    """Times of 160 s are rounded to 8e-6 s, which is no news of a step of 20 ms."""
    time = 0.02 * np.arange(8192)
    values = np.random.default_rng(10).standard_normal((8192, 3))
    exactly = rk.RecordedMotion(time, values)
    made = lambda values: rk.RecordedMotion(jnp.float32(time), values).position
    found = (jax.jit(made) if traced else made)(jnp.float32(values))
    assert found.dtype == jnp.float32
    # as of 8192 rounded samples; where sums are rounded as well, of velocities that
    # are some 100 samples high and 8192 long: 8192 * 6e-8 of the way at most
    size = np.abs(exactly.position).max()
    np.testing.assert_allclose(found, exactly.position, atol=5e-4 * size)


def test_a_clock_whose_samples_are_uneven_is_taken_as_it_is():
    """Rounding aside, steps are what the times say, in either precision."""
    time = clock("1/128 s to a millisecond")
    values = np.random.default_rng(11).standard_normal((1000, 3))
    wide = rk.RecordedMotion(time, values).velocity
    narrow = rk.RecordedMotion(jnp.float32(time), jnp.float32(values)).velocity
    step = np.diff(time)[:, None]
    gained = np.cumsum(step * (values[1:] + values[:-1]) / 2.0, axis=0)
    # rounding of sums of 1000 numbers below 4 / 128; of times up to 10 s, in any step
    np.testing.assert_allclose(wide[1:], gained, atol=1000 * 0.03 * 2.3e-16)
    np.testing.assert_allclose(narrow[1:], gained, atol=1000**0.5 * 4.0 * 5e-7)
