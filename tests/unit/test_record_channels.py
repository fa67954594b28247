"""What a fit says of each channel of a record is of that channel."""

import numpy as np
import pytest

import rollkane as rk
from rollkane.identification.fitting import problem_of
from rollkane.identification.residuals import grouped, with_delay_bounds
from rollkane.simulation.run_options import RunOptions

from .. import problems


def test_misfits_bear_the_name_of_their_channel():
    """In any order of the names: JAX puts those of a dictionary in its own."""
    scene, start = problems.disc()
    times = np.linspace(0.0, 0.1, 5)
    run = rk.simulate(scene, start, times, rtol=1e-10)
    turning, place = run.state.angular_velocity, run.position
    channels = {
        "turning": rk.Gyro(turning + 0.03, sigma=0.01),
        "place": rk.Position(place - 0.001, sigma=0.001),
    }
    for names in ("turning", "place"), ("place", "turning"):
        record = rk.Record(times, {name: channels[name] for name in names})
        free = (rk.Free("body.mass"),)
        options = RunOptions(1e-10, None, None, "auto")
        problem = problem_of(scene, [start], [record], free, None, options)
        (found,) = problem.channel_misfits(problem.layout.start)
        # the offsets over their deviations; both runs are of the same steps, whose
        # errors of 1e-10 a step over the smaller deviation are 1e-7, of 100 steps 1e-5
        np.testing.assert_allclose(found["turning"], 3.0, rtol=0, atol=1e-5)
        np.testing.assert_allclose(found["place"], -1.0, rtol=0, atol=1e-5)


def turned_about_z(angles):
    half = 0.5 * np.asarray(angles)
    still = np.zeros_like(half)
    return np.stack([np.cos(half), still, still, np.sin(half)], axis=1)


def test_a_variation_has_the_shape_of_the_misfits():
    """Of quaternions, too, of either sign; where one is missing it has no number."""
    angles = np.array([-0.3, 0.3, -0.1, 0.1, 0.0])
    samples = turned_about_z(angles) * np.array([[1.0], [-1.0], [1.0], [1.0], [-1.0]])
    whole = np.concatenate([samples, [[np.nan] * 4, [1.0, np.nan, 0.0, 0.0]]])
    channel = rk.Orientation(whole, 0.1)
    found = channel.variation()
    assert found.shape == channel.misfit(channel.values).shape
    # about the middle, which is that of no turn by symmetry: 2 sin(angle / 2) about z;
    # an eigenvector of four numbers and a product of quaternions, some ten roundings
    expected = np.zeros((5, 3))
    expected[:, 2] = 2.0 * np.sin(0.5 * angles)
    np.testing.assert_allclose(found[:5], expected, rtol=0, atol=4e-15)
    assert np.isnan(found[5:]).all()
    gyro = rk.Gyro([[1.0, 0.0, np.nan], [3.0, 0.0, 5.0]], 0.1)
    # means of two small whole numbers are exact
    np.testing.assert_array_equal(
        gyro.variation(), [[-1.0, 0.0, np.nan], [1.0, 0.0, 0.0]]
    )


def test_orientations_over_growing_horizons():
    """From a guess that they leave: a search that looks at a record's variation."""
    surface = rk.Ellipsoid((0.1, 0.08, 0.06))
    scene = rk.Scene(rk.Body(1.0, np.diag([2e-3, 3e-3, 4e-3]), surface))
    place = lambda spin: rk.place(scene, (1, 0, 0, 0), (1.0, 2.0, spin), (0, 0, 0))
    times = np.linspace(0.0, 1.0, 26)
    samples = np.array(rk.simulate(scene, place(3.0), times).orientation)
    samples[::3] *= -1.0
    samples[7] = np.nan
    record = rk.Record(times, {"pose": rk.Orientation(samples, 0.01)})
    free = rk.Free("start.angular_velocity")
    found = rk.fit(scene, place(5.0), record, free, strategy="progressive")
    assert len(found.stages) > 1
    # samples without noise: the search ends within 1e-3 of a standard error, of which
    # the largest is 0.03
    away = found.estimates["start.angular_velocity"] - np.array([1.0, 2.0, 3.0])
    assert (np.abs(away) < 1e-2 * found.standard_errors[free.path]).all()


@pytest.mark.parametrize(
    ("bounds", "before", "left"),
    [(None, 0.0, 100), ((0.0, 0.025), 0.0, 118), (None, 0.205, 121)],
)
def test_a_free_delay_leaves_out_what_may_show_the_time_before(bounds, before, left):
    """Of 121 samples, 10 ms apart, as docs/fit.md has it."""
    times = 0.01 * np.arange(121)
    channel = {"gyro": rk.Gyro(np.zeros((121, 3)), sigma=0.1)}
    record = rk.Record(times, channel, start_time=-before)
    free = with_delay_bounds((rk.Free("gyro.delay", bounds=bounds),), [record])
    (group,) = grouped(record, free, {})
    assert group.time.shape == (left,)
