"""Records from tables: what is read as what, and what is refused with which words."""

import warnings

import numpy as np
import pandas
import pytest
import xarray

import rollkane as rk
from rollkane.files.csv_table import axes_of, write_csv
from rollkane.files.scene_files import load_scene

GYRO = {"gyro": ("wx", "wy", "wz")}
TIMES = np.array([0.0, 0.01, 0.03, 0.04, 0.06])
RATES = np.array(
    [[1.0, 2.0, 3.0], [1.5, 2.5, 3.5], [0.25, -1.0, 4.0], [7.0, 8.0, 9.0], [1, 0, -1]]
)
# numbers are written with all of their digits, and read back exactly
WRITTEN = [f"{t},{x},{y},{z}" for t, (x, y, z) in zip(TIMES, RATES, strict=True)]
HEADER = "t,wx,wy,wz"


@pytest.fixture
def csv_file(tmp_path):
    def write(*lines):
        path = tmp_path / "run.csv"
        path.write_text("\n".join(lines) + "\n")
        return path

    return write


def refusal(path, *arguments, **options):
    with pytest.raises(rk.FieldError) as caught:
        rk.read_record(path, *arguments, **options)
    return str(caught.value)


@pytest.mark.parametrize("separator", [",", ";", "\t"])
def test_separators_comments_and_blanks(csv_file, separator):
    lines = ["# made on a table", HEADER, *WRITTEN[:2], "", "  # paused", *WRITTEN[2:]]
    path = csv_file(*(line.replace(",", separator) for line in lines))
    record = rk.read_record(path, **GYRO, sigma={"gyro": 0.02})
    np.testing.assert_array_equal(record.time, TIMES)
    gyro = record.channels["gyro"]
    assert isinstance(gyro, rk.Gyro)
    np.testing.assert_array_equal(gyro.values, RATES)
    np.testing.assert_array_equal(gyro.sigma, np.full(3, 0.02))
    assert record.start_time == TIMES[0]


def test_order_and_other_columns_do_not_matter(csv_file):
    path = csv_file('note,"wz", t,wx,wy', "begun,3,0,1,2", "ended,6,0.1,4,5")
    record = rk.read_record(path, **GYRO)
    np.testing.assert_array_equal(
        record.channels["gyro"].values, [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]
    )


@pytest.mark.parametrize(
    ("time", "rate", "worth"),
    [
        ("t [ms]", "[deg/s]", np.pi / 180.0),
        ("t (msec)", "(deg/s)", np.pi / 180.0),
        ("t[ms]", "_[rad/s]", 1.0),
    ],
)
def test_units_in_columns_names_count(csv_file, time, rate, worth):
    names = [f"w{axis} {rate}" for axis in "xyz"]
    path = csv_file(",".join([time, *names]), "0,1,2,3", "10,4,5,6")
    for source in (path, pandas.read_csv(path)):
        record = rk.read_record(source, time, gyro=names)
        np.testing.assert_array_equal(record.time, [0.0, 0.01])
        known = worth * np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])
        np.testing.assert_array_equal(record.channels["gyro"].values, known)
    # what is said counts more
    record = rk.read_record(path, time, gyro=names, units={"gyro": "rad/s"})
    np.testing.assert_array_equal(record.channels["gyro"].values[0], [1.0, 2.0, 3.0])


def test_an_unknown_unit_in_a_columns_name_is_refused(csv_file):
    names = [f"w{axis} [dps]" for axis in "xyz"]
    path = csv_file(",".join(["t", *names]), "0,1,2,3", "0.1,4,5,6")
    told = refusal(path, gyro=names)
    assert "is no known unit of column 'wx [dps]', got 'dps'" in told
    assert "units={'gyro': ...}, one of: rad/s, deg/s" in told


def test_missing_samples(csv_file):
    path = csv_file(HEADER, "0,1,,3", "1e-2,nan,5,6", "2e-2,7,8, NaN")
    values = rk.read_record(path, **GYRO).channels["gyro"].values
    nan = np.nan
    np.testing.assert_array_equal(values, [[1, nan, 3], [nan, 5, 6], [7, 8, nan]])


# of each kind: columns, a unit, what one of it is by the unit's definition in SI
KINDS = {
    "gyro": (3, "deg/s", np.pi / 180, rk.Gyro),
    "accelerometer": (3, "g", 9.80665, rk.Accelerometer),
    "position": (3, "mm", 1e-3, rk.Position),
    "orientation": (4, "1", 1.0, rk.Orientation),
    "marker": (3, "cm", 1e-2, rk.Marker),
    "marker2": (3, "cm", 1e-2, rk.Marker),
    "contact_path": (3, "cm", 1e-2, rk.ContactPath),
    "normal_force": (1, "kN", 1e3, rk.NormalForce),
}


@pytest.mark.parametrize("name", KINDS)
def test_every_kind_in_another_unit(csv_file, name):
    count, unit, worth, kind = KINDS[name]
    names = [f"c{k}" for k in range(count)]
    # of length 1, since quaternions must be
    samples = np.full((2, count), 1.0 / np.sqrt(count))
    rows = [",".join(map(str, [10 * t, *row])) for t, row in enumerate(samples)]
    path = csv_file(",".join(["ms", *names]), *rows)
    has_place = kind in (rk.Accelerometer, rk.Position, rk.Marker)
    placed = {"at": {name: (0.1, 0.2, 0.3)}} if has_place else {}
    columns = names if count > 1 else names[0]
    units = {name: unit, "time": "ms"}
    record = rk.read_record(path, "ms", **{name: columns}, units=units, **placed)
    channel = record.channels[name]
    assert type(channel) is kind
    # one product and one quotient of rounded numbers: two roundings of 1.1e-16
    np.testing.assert_allclose(channel.values, worth * samples, rtol=3e-16)
    np.testing.assert_allclose(record.time, [0.0, 0.01], rtol=3e-16)
    if placed:
        np.testing.assert_array_equal(channel.at, (0.1, 0.2, 0.3))


def test_a_part_keeps_its_times(csv_file):
    path = csv_file(HEADER, *WRITTEN)
    record = rk.read_record(path, **GYRO, between=(0.01, 0.04))
    np.testing.assert_array_equal(record.time, TIMES[1:4])
    np.testing.assert_array_equal(record.channels["gyro"].values, RATES[1:4])
    assert record.start_time == TIMES[1]
    later = rk.read_record(path, **GYRO, between=(0.01, None))
    np.testing.assert_array_equal(later.time, TIMES[1:])


def test_a_data_frame():
    frame = pandas.DataFrame(
        {"t": TIMES, **dict(zip(GYRO["gyro"], RATES.T, strict=True))}
    )
    frame.loc[2, "wy"] = None
    values = rk.read_record(frame, **GYRO).channels["gyro"].values
    assert np.isnan(values[2, 1])
    np.testing.assert_array_equal(np.delete(values, 2, 0), np.delete(RATES, 2, 0))
    words = refusal(frame.astype({"wx": str}).replace({"wx": {"7.0": "x"}}), **GYRO)
    assert "row 3, column 'wx'" in words


def test_netcdf(tmp_path):
    data = xarray.Dataset(
        {
            "rate": (("t", "axis"), RATES, {"units": "deg/s"}),
            "force": ("t", RATES[:, 0], {"units": "pounds"}),
        },
        {"t": ("t", TIMES, {"units": "s"}), "axis": ["x", "y", "z"]},
    )
    path = tmp_path / "run.nc"
    data.to_netcdf(path, engine="h5netcdf")
    gyro = {"gyro": ("rate_x", "rate_y", "rate_z")}
    record = rk.read_record(path, **gyro)
    np.testing.assert_array_equal(record.time, TIMES)
    np.testing.assert_allclose(  # one product of rounded numbers
        record.channels["gyro"].values, np.deg2rad(RATES), rtol=3e-16
    )
    told = rk.read_record(path, **gyro, units={"gyro": "rad/s"})
    np.testing.assert_array_equal(told.channels["gyro"].values, RATES)
    words = refusal(path, normal_force="force")
    assert "'pounds'" in words
    assert "of column 'force'" in words
    assert "N, kN, mN" in words
    for name in ("run.NC4", "run.h5", "run.hdf5"):  # as --out writes it, too
        (tmp_path / name).write_bytes(path.read_bytes())
        again = rk.read_record(tmp_path / name, **gyro)
        np.testing.assert_array_equal(again.time, TIMES)
    (tmp_path / "no.nc").write_text("t,wx\n")
    assert "cannot be read" in refusal(tmp_path / "no.nc", **gyro)


def test_columns_of_another_clock_are_refused(tmp_path):
    """They were cut, or read at the times of the other, without a word."""
    data = xarray.Dataset(
        {
            "rate": (("fast", "axis"), np.tile(RATES, (2, 1))),
            "place": (("t", "axis"), RATES),
            "turned": (("axis", "t"), RATES.T),
        },
        {
            "fast": ("fast", np.linspace(0.0, 0.06, 10)),
            "t": ("t", TIMES),
            "axis": ["x", "y", "z"],
        },
    )
    path = tmp_path / "two.nc"
    data.to_netcdf(path, engine="h5netcdf")
    place = {"position": ("place_x", "place_y", "place_z")}
    rate = {"gyro": ("rate_x", "rate_y", "rate_z")}
    assert rk.read_record(path, **place).time.size == TIMES.size
    assert rk.read_record(path, "fast", **rate).time.size == 10
    for time, channels in (("t", rate), ("fast", place), ("t", {**place, **rate})):
        words = refusal(path, time, **channels)
        assert "over 'fast'" in words
        assert "over 't'" in words
    turned = {"position": tuple(f"turned_{k}" for k in TIMES[:3])}
    assert "over 'axis'" in refusal(path, **turned)
    with pytest.raises(rk.FieldError, match="over 't'"):
        rk.Empirical.from_table(path, ("fast", "place_x"))


@pytest.mark.parametrize("form", ["run.nc", "run.csv", "frame"])
def test_results_on_fixed_axes_are_no_gyro(tmp_path, form):
    """They were read as if they were on body axes: of a table with our columns, too."""
    scene = rk.Scene(rk.Body(1.0, np.eye(3), rk.Sphere(0.1)))
    start = rk.place(scene, (1, 0, 0, 0), (1, 2, 3), (0, 0, 0))
    path = tmp_path / form
    run = rk.simulate(scene, start, TIMES)
    if form == "run.nc":
        run.to_xarray().to_netcdf(path, engine="h5netcdf")
    else:
        write_csv(run, path)
    if form == "frame":
        path = pandas.DataFrame(np.genfromtxt(path, delimiter=",", names=True))
    rates = tuple(f"angular_velocity_{x}" for x in "xyz")
    words = refusal(path, "time", gyro=rates)
    assert "'angular_velocity_x' on fixed axes, and gyro is on body axes" in words
    places = tuple(f"position_{x}" for x in "xyz")
    found = rk.read_record(path, "time", position=places).channels["position"]
    np.testing.assert_array_equal(found.values, run.position)


def test_axes_of_every_column_that_a_run_writes(tmp_path):
    """As the data set has them, of bodies that roll in the body, too."""
    scene = load_scene("ball-in-rolling-shell")
    run = rk.simulate(scene.scene, scene.start, scene.times[:2])
    path = tmp_path / "run.csv"
    write_csv(run, path)
    names = path.read_text().partition("\n")[0].split(",")
    found, data = axes_of(names), run.to_xarray()
    for name, own in data.data_vars.items():
        columns = [x for x in names if x == name or x.startswith(f"{name}_")]
        columns = [x for x in columns if len(x) <= len(name) + 4]
        assert columns
        assert {found.get(x) for x in columns} == {own.attrs.get("axes")}
    assert axes_of(["time", "angular_velocity_x"]) == {}  # of anybody's table


@pytest.mark.parametrize(
    ("times", "said"),
    [
        (pandas.to_timedelta(TIMES, unit="s"), "dates or spans of time"),
        (pandas.to_datetime(TIMES, unit="s"), "dates or spans of time"),
        (TIMES + 0.0j, "complex numbers"),
    ],
)
def test_frames_of_other_things_than_numbers_are_refused(times, said):
    """Spans were read as their whole numbers, 0.1 s as 1e8."""
    frame = pandas.DataFrame({"t": times, "wx": RATES[:, 0]})
    words = refusal(frame, normal_force="wx")
    assert said in words
    twice = pandas.DataFrame(np.c_[TIMES, RATES[:, :2]], columns=["t", "a", "a"])
    assert "two columns 'a'" in refusal(twice, normal_force="a")


REFUSED = {
    "a missing column": (
        (HEADER, *WRITTEN),
        {"gyro": ("wx", "wy", "w_z")},
        ("no column 'w_z'", "did you mean 'wz'?", "t, wx, wy, wz"),
    ),
    "two of a name": (
        ("t,wx,wx,wz", *WRITTEN),
        GYRO,
        ("two columns 'wx'",),
    ),
    "times out of order": (
        ("# a comment", HEADER, WRITTEN[0], WRITTEN[2], "", WRITTEN[1]),
        GYRO,
        ("line 6", "0.01 after 0.03", "sort"),
    ),
    "a row without a time": ((HEADER, *WRITTEN, ",1,2,3"), GYRO, ("line 7", "no time")),
    "no rows": ((HEADER,), GYRO, ("no rows of samples",)),
    "nothing": (("",), GYRO, ("no rows of samples",)),
    "no header": (WRITTEN, GYRO, ("line 1", "where the header should be")),
    "a word": (
        (HEADER, *WRITTEN[:2], "0.02,1,off,3"),
        GYRO,
        ("line 4, column 'wy'", "not a number", "'off'"),
    ),
    "an infinite number": (
        (HEADER, *WRITTEN[:2], "0.02,1,inf,3"),
        GYRO,
        ("line 4, column 'wy'", "not a number"),
    ),
    "a decimal comma": (
        ("t;wx;wy;wz", "0;1,5;2;3", "0.1;1;2;3"),
        GYRO,
        ("line 2, column 'wx'", "decimal points"),
    ),
    "an open quote": (
        ("t,wx,wy,wz,note", '0,1,2,3,"begun', '0.1,1,2,3,"'),
        GYRO,
        ("a quote that goes on",),
    ),
    "a short row": ((HEADER, *WRITTEN[:2], "0.02,1"), GYRO, ("line 4", "2 cells")),
    "an unknown unit": (
        (HEADER, *WRITTEN),
        {**GYRO, "units": {"gyro": "rpm"}},
        ("units['gyro']", "'rpm'", "rad/s, deg/s"),
    ),
    "a unit of nothing": (
        (HEADER, *WRITTEN),
        {**GYRO, "units": {"gyros": "deg/s"}},
        ("read_record.units", "did you mean 'gyro'?"),
    ),
    "no place": (
        (HEADER, *WRITTEN),
        {"accelerometer": ("wx", "wy", "wz")},
        ("read_record.at", "'accelerometer': (x, y, z)"),
    ),
    "a place of none": (
        (HEADER, *WRITTEN),
        {**GYRO, "at": {"gyro": (0.0, 0.0, 0.0)}},
        ("read_record.at", "at any place"),
    ),
    "an unknown channel": (
        (HEADER, *WRITTEN),
        {"giro": ("wx", "wy", "wz")},
        ("read_record.giro", "did you mean 'gyro'?"),
    ),
    "a unit at a name's end": (
        ("t,x_cm,y_cm,z_cm", *WRITTEN),
        {"position": ("x_cm", "y_cm", "z_cm")},
        ("units['position']", "'x_cm' ends like 'cm'", "units={'position': 'cm'}"),
    ),
    "times that end in another unit": (
        ("t_ms,wx,wy,wz", *WRITTEN),
        {"time": "t_ms", **GYRO},
        ("units['time']", "ends like 'ms'"),
    ),
    "a column twice": (
        (HEADER, *WRITTEN),
        {"gyro": ("wx", "wy", "wy")},
        ("names a column twice",),
    ),
    "times as samples": (
        (HEADER, *WRITTEN),
        {"gyro": ("t", "wy", "wz")},
        ("or that of the times",),
    ),
    "no channel": ((HEADER, *WRITTEN), {}, ("names no channel",)),
    "too few columns": (
        (HEADER, *WRITTEN),
        {"gyro": ("wx",)},
        ("must name 3 columns",),
    ),
    "an empty part": (
        (HEADER, *WRITTEN),
        {**GYRO, "between": (0.015, 0.035)},
        ("less than two rows", "0 to 0.06 s"),
    ),
    "no part": ((HEADER, *WRITTEN), {**GYRO, "between": 3.0}, ("must be two times",)),
}


@pytest.mark.parametrize("case", REFUSED)
def test_refusals(csv_file, case):
    lines, options, words = REFUSED[case]
    said = refusal(csv_file(*lines), **options)
    for word in words:
        assert word in said


def test_a_file_that_is_not_there(tmp_path):
    assert "No such file" in refusal(tmp_path / "none.csv", **GYRO)


def test_times_that_look_like_milliseconds(csv_file):
    path = csv_file(HEADER, *(f"{10 * k},1,2,3" for k in range(5)))
    with pytest.warns(UserWarning, match="look like milliseconds"):
        rk.read_record(path, **GYRO)
    with warnings.catch_warnings():  # a unit that is given is taken
        warnings.simplefilter("error")
        record = rk.read_record(path, **GYRO, units={"time": "s"})
    assert record.time[-1] == 40.0


@pytest.mark.parametrize("form", ["%.6f", "%.9e"])
def test_a_file_that_ends_within_its_last_number_is_refused(tmp_path, form):
    """Printed alike, with no line end: what is left of 12.5 would be 12, or 1."""
    samples = np.random.default_rng(0).normal(scale=9.0, size=(60, 4))
    samples[:, 0] = 0.01 * np.arange(60)
    path = tmp_path / "cut.csv"
    np.savetxt(path, samples, form, ",", header="t,x,y,z", comments="")
    whole = path.read_text()
    axes = {"gyro": ("x", "y", "z")}
    for end in (0, 1):  # the whole file, and without its last line end
        path.write_text(whole[: len(whole) - end])
        assert rk.read_record(path, **axes).time.size == 60
    for end in range(2, 8):
        path.write_text(whole[:-end])
        with pytest.raises(rk.FieldError, match=r"line 61: ends within the number"):
            rk.read_record(path, **axes)
    path.write_text(whole[:-2] + "\n")  # a line that ends is whole
    assert rk.read_record(path, **axes).time.size == 60


def test_numbers_of_any_length_need_no_line_end(tmp_path):
    """As Python and JavaScript print them, a tenth is shorter than the others."""
    path = tmp_path / "whole.csv"
    values = [*(0.01 * np.round(np.arange(1, 60))), 2.0]
    rows = "\n".join(f"{k / 100},{x!r}" for k, x in enumerate(map(float, values)))
    path.write_text(f"t,n\n{rows}")
    read = rk.read_record(path, normal_force="n").channels["normal_force"].values
    assert read[-1] == 2.0
