"""Records and their channels: what is refused, and what is kept."""

import numpy as np
import pytest

import rollkane as rk

TIMES = np.array([0.0, 0.1, 0.25, 0.3])
ROWS = np.arange(12.0).reshape(4, 3)
ONES = np.tile([1.0, 0.0, 0.0, 0.0], (4, 1))
GYRO = rk.Gyro(ROWS, 0.1)


def swapped(row):
    times = TIMES.copy()
    times[[row - 1, row]] = times[[row, row - 1]]
    return times


def with_entry(array, index, value):
    array = array.copy()
    array[index] = value
    return array


CHANNELS = {
    "two columns": (lambda: rk.Gyro(ROWS[:, :2]), "Gyro.values", r"\(T, 3\)"),
    "one row of a table": (lambda: rk.Position(ROWS[0]), "Position.values", r"\(T, 3"),
    "words": (lambda: rk.Gyro([["a", "b", "c"]]), "Gyro.values", "real numbers"),
    "ragged": (lambda: rk.Gyro([[1.0], [1.0, 2.0]]), "Gyro.values", "made of numbers"),
    "infinite": (
        lambda: rk.Marker(with_entry(ROWS, (2, 1), np.inf)),
        "Marker.values",
        "infinite in row 2",
    ),
    "two forces": (lambda: rk.NormalForce(ROWS[:, :2]), "NormalForce.values", "T, 1"),
    "three of a quaternion": (
        lambda: rk.Orientation(ROWS),
        "Orientation.values",
        r"\(T, 4\)",
    ),
    "quaternion of zeros": (
        lambda: rk.Orientation(with_entry(ONES, 1, 0.0)),
        "Orientation.values",
        "is 0 in row 1",
    ),
    "sigma of two": (lambda: rk.Gyro(ROWS, [0.1, 0.2]), "Gyro.sigma", "3 numbers"),
    "sigma zero": (lambda: rk.Gyro(ROWS, 0.0), "Gyro.sigma", "must be positive"),
    "sigma NaN": (lambda: rk.Gyro(ROWS, np.nan), "Gyro.sigma", "must be positive"),
    "sigma infinite": (lambda: rk.Gyro(ROWS, np.inf), "Gyro.sigma", "positive"),
    "sigma in words": (lambda: rk.Gyro(ROWS, "small"), "Gyro.sigma", "a number or 3"),
    "bias of two": (lambda: rk.Gyro(ROWS, bias=[1.0, 2.0]), "Gyro.gain", "3 numbers"),
    "bias NaN": (lambda: rk.Gyro(ROWS, bias=np.nan), "Gyro.bias", "finite"),
    "gain infinite": (
        lambda: rk.Position(ROWS, gain=np.inf),
        "Position.gain",
        "finite",
    ),
    "gain in words": (lambda: rk.ContactPath(ROWS, gain="x"), "ContactPath.gain", "3"),
    "a number of misalignment": (
        lambda: rk.Gyro(ROWS, misalignment=0.1),
        "Gyro.misalignment",
        r"shape \(3\)",
    ),
    "delay of two": (lambda: rk.Gyro(ROWS, delay=[0.1, 0.2]), "Gyro.delay", "shape"),
    "delay NaN": (lambda: rk.Gyro(ROWS, delay=np.nan), "Gyro.delay", "finite"),
    "place in a plane": (
        lambda: rk.Accelerometer(ROWS, at=(0.1, 0.2)),
        "Accelerometer.at",
        r"shape \(3\)",
    ),
    "marker nowhere": (
        lambda: rk.Marker(ROWS, at=(0.1, np.inf, 0.0)),
        "Marker.at",
        "finite",
    ),
    "no function": (lambda: rk.Observed(3.0, ROWS), "Observed.function", "a function"),
}


@pytest.mark.parametrize("name", CHANNELS)
def test_channels_that_are_refused(name):
    make, field, says = CHANNELS[name]
    with pytest.raises(rk.FieldError, match=says) as caught:
        make()
    assert caught.value.field == field
    assert caught.value.remedy


RECORDS = {
    "one sample": (TIMES[:1], {"gyro": rk.Gyro(ROWS[:1])}, None, "time", "T >= 2"),
    "a table of times": (ROWS, {"gyro": GYRO}, None, "time", r"\(T,\)"),
    "words": (["now", "then"], {"gyro": GYRO}, None, "time", "real numbers"),
    "NaN": (with_entry(TIMES, 2, np.nan), {"gyro": GYRO}, None, "time", "row 2"),
    "out of order": (
        swapped(2),
        {"gyro": GYRO},
        None,
        "time",
        "row 2 has 0.1 s after 0.25 s",
    ),
    "twice the same": (
        with_entry(TIMES, 2, 0.1),
        {"gyro": GYRO},
        None,
        "time",
        "row 2 has 0.1 s after 0.1 s.*leave out repeated times",
    ),
    "no channel": (TIMES, {}, None, "channels", "must name channels"),
    "a list": (TIMES, [GYRO], None, "channels", "must name channels"),
    "an array": (TIMES, {"gyro": ROWS}, None, "channels['gyro']", "must be a channel"),
    "a name of the scene": (
        TIMES,
        {"body": GYRO},
        None,
        "channels['body']",
        "cannot be the name",
    ),
    "a name with a space": (
        TIMES,
        {"left gyro": GYRO},
        None,
        "channels['left gyro']",
        "cannot be the name",
    ),
    "other lengths": (
        TIMES,
        {"gyro": rk.Gyro(ROWS[:3])},
        None,
        "channels['gyro']",
        "has 3 samples at 4 times",
    ),
    "nothing read": (
        TIMES,
        {"gyro": rk.Gyro(np.nan * ROWS)},
        None,
        "channels['gyro']",
        "all are NaN",
    ),
    "long quaternions": (
        TIMES,
        {"pose": rk.Orientation(1.2 * ONES)},
        None,
        "channels['pose']",
        "length 1.2",
    ),
    "a late start": (TIMES, {"gyro": GYRO}, 0.05, "start_time", "first sample, at 0 s"),
    "a start without end": (TIMES, {"gyro": GYRO}, -np.inf, "start_time", "finite"),
    "a start in words": (TIMES, {"gyro": GYRO}, "noon", "start_time", "made of"),
}


@pytest.mark.parametrize("name", RECORDS)
def test_records_that_are_refused(name):
    times, channels, start, field, says = RECORDS[name]
    with pytest.raises(rk.FieldError, match=says) as caught:
        rk.Record(times, channels, start)
    assert caught.value.field == f"Record.{field}"
    assert caught.value.remedy


def test_what_a_record_keeps():
    gaps = with_entry(ROWS, (1, 2), np.nan)
    force = rk.NormalForce(np.arange(4.0), 2.0)
    record = rk.Record(TIMES, {"gyro": rk.Gyro(gaps), "force": force}, -0.5)
    np.testing.assert_array_equal(record.time, TIMES)
    np.testing.assert_array_equal(record.channels["gyro"].values, gaps)
    np.testing.assert_array_equal(force.values, np.arange(4.0)[:, None])
    np.testing.assert_array_equal(force.sigma, [2.0])
    assert record.start_time == -0.5
    assert rk.Record(TIMES, {"gyro": GYRO}).start_time == TIMES[0]
    assert record.channels["gyro"].sigma is None


def test_numbers_of_a_sensor_are_one_for_each_column():
    gyro = rk.Gyro(ROWS, [0.1, 0.2, 0.3], bias=0.5, gain=[1.0, 2.0, 3.0])
    np.testing.assert_array_equal(gyro.bias, [0.5, 0.5, 0.5])
    np.testing.assert_array_equal(gyro.gain, [1.0, 2.0, 3.0])
    np.testing.assert_array_equal(gyro.sigma, [0.1, 0.2, 0.3])
    observed = rk.Observed(lambda scene, t, state: t, np.arange(4.0), bias=1.0)
    assert observed.values.shape == (4, 1)
    assert observed.bias.shape == (1,)
