"""Readers of recorded accelerations, and what they refuse."""

import re
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk
from rollkane.files.accelerograms import BUILTIN_RECORDS

from ..record_files import AT2, COLUMNS, HEADER, SINGLE, v2a, v2a_lines

G = 9.80665
# real records, of which only some may be redistributed
ROOT = Path(__file__).parents[2]
FOLDERS = (ROOT / "shared" / "data", ROOT.parent / "shared" / "data")
DATA = next((folder for folder in FOLDERS if folder.is_dir()), None)


def write(folder, text, name="record.txt"):
    path = folder / name
    path.write_text(text)
    return path


@pytest.mark.parametrize("header", ["NPTS=  5, DT= .02000 SEC", "  5  .0200  NPTS, DT"])
def test_at2(tmp_path, header):
    record = rk.read_at2(write(tmp_path, AT2.format(header=header)))
    np.testing.assert_allclose(record.time, 0.02 * np.arange(5), rtol=1e-15)
    expected = G * 1e-3 * np.array([1.0, -2.0, 3.0, -4.0, 5.0])
    np.testing.assert_allclose(record.acceleration[:, 0], expected, rtol=1e-15)
    assert record.title.startswith("SOME DATA BASE SOME QUAKE")


@pytest.mark.parametrize("gap", [" ", "\t", ", ", ";"])
def test_two_columns(tmp_path, gap):
    """Times of 1/150 s printed with three places; two components in cm/s^2."""
    time = np.arange(20) / 150
    rows = [gap.join((f"{t:.3f}", f"{i}", f"{-2 * i}")) for i, t in enumerate(time)]
    text = "A title\nTime[s]" + gap + "Accel\n" + "\n".join(rows) + "\n"
    record = rk.read_two_column(write(tmp_path, text), unit="cm/s2")
    assert record.acceleration.shape == (20, 2)
    np.testing.assert_allclose(record.acceleration[:, 1], -0.02 * np.arange(20))
    # the last time is printed with an error of at most 5e-4 s
    np.testing.assert_allclose(record.time, time, atol=5.01e-4)
    assert np.ptp(np.diff(record.time)) < 1e-15
    rk.RecordedMotion(record.time, record.acceleration)


def test_v2a_with_touching_fields(tmp_path):
    record = rk.read_v2a(write(tmp_path, v2a()))
    assert record.components == ("N28W", "S62W", "Up")
    expected = -1e-3 * (10000.1 + np.arange(12))
    for column, sign in zip(record.acceleration.T, (1, -1, 1), strict=True):
        np.testing.assert_allclose(column, sign * expected, rtol=1e-12)
    np.testing.assert_allclose(record.time, 0.02 * np.arange(12), rtol=1e-15)


def test_v2a_of_fewer_components_ends_with_the_vertical_one(tmp_path):
    record = rk.read_v2a(write(tmp_path, v2a(names=("N28W", "Up"))))
    assert record.components == ("N28W", "Up")
    for names in (("N28W", "S62W"), ("N28W",), ("A", "B", "C", "D")):
        with pytest.raises(rk.FieldError, match="and a V2A file has three"):
            rk.read_v2a(write(tmp_path, v2a(names=names)))


@pytest.mark.parametrize("name", BUILTIN_RECORDS)
def test_builtin_records(name):
    record = rk.builtin_record(name)
    motion = rk.RecordedMotion(record.time, record.acceleration)
    assert motion.time.shape == record.time.shape
    if name.startswith("kaikoura"):
        # peaks that the station's own file states [mm/s^2]
        peaks = 1e3 * np.abs(record.acceleration).max(axis=0)
        np.testing.assert_allclose(peaks, [9733.1, 7966.4, 18021.9], rtol=1e-12)
        rms = 1e3 * np.sqrt(np.mean(record.acceleration**2, axis=0))
        np.testing.assert_allclose(rms, [719.0, 594.7, 828.8], atol=0.051)
        strong = record.window(40.0, 60.0)
        assert strong.time.shape == (1001,)
        assert strong.time[0] == 0.0
        with pytest.raises(rk.FieldError, match=r"window.*not within.*give a start"):
            record.window(160.0, 170.0)


BAD = {
    "no file": (rk.read_at2, None, r"cannot be read.*give a file's path"),
    "binary": (rk.read_two_column, "\0\1\2", r"binary data.*text file"),
    "empty": (rk.read_v2a, "", r"is empty.*give a V2A"),
    "count": (
        rk.read_at2,
        AT2.format(header="NPTS=  6, DT= .02000 SEC"),
        r"holds 5 samples.*says 6.*mend",
    ),
    "no header": (rk.read_at2, AT2.format(header="nothing"), r"no line with NPTS"),
    "no number": (
        rk.read_at2,
        AT2.format(header="NPTS=  5, DT= .02000 SEC").replace("-.4", "oops"),
        r"line 8: holds 'oops.*not a number",
    ),
    "NaN": (
        rk.read_two_column,
        COLUMNS.format(row="0.03 nan"),
        r"line 5: holds 'nan', not a number",
    ),
    "gap": (
        rk.read_two_column,
        COLUMNS.format(row=""),
        r"line 6: comes 0.02 s after.*usual step is 0.01 s.*fill the gap",
    ),
    "columns": (
        rk.read_two_column,
        COLUMNS.format(row="0.03 4 4"),
        r"line 5: holds 3 columns, not 2",
    ),
    "single count": (rk.read_single_column, "t\n3 0.01\n1\n2\n", r"2 samples.*says 3"),
    "single step": (
        rk.read_single_column,
        "t\n2 0\n1\n2\n",
        r"line 2: .*positive",
    ),
    "cut off": (rk.read_v2a, v2a(cut=27), r"ends too early.*whole file"),
    "not v2a": (rk.read_v2a, "x\n" * 30, r"line 13: does not name a component"),
    "v2a of no samples": (
        rk.read_v2a,
        v2a(counts=(0, 5, 5)),
        r"line 20: needs two samples of acceleration",
    ),
    "v2a count": (rk.read_v2a, v2a(counts=("12.5", 5, 5)), r"line 20: .*12.5.*whole"),
    "v2a step": (rk.read_v2a, v2a(step="1e999"), r"line 23: holds 1e999.*too large"),
    "v2a of no numbers": (
        rk.read_v2a,
        "\n".join(x[:16] if i == 19 else x for i, x in enumerate(v2a_lines())),
        r"line 20: holds 2 numbers, and 6 are needed",
    ),
    "v2a velocities first": (
        rk.read_v2a,
        v2a(text={13: "Velocity:      peak -1016.55 mm/s"}),
        r"line 14: names a velocity",
    ),
    "single time": (rk.read_single_column, "t\n2 1e400\n1\n2\n", r"1e400.*large"),
    "endless": (rk.read_single_column, "t\n3 1e308\n1\n2\n3\n", r"line 2: needs two"),
    "zero with a power": (
        rk.read_two_column,
        "t a\n0e999 1\n0e999 2\n",
        r"line 3: has the time 0\.0 s after 0\.0 s",
    ),
    "a time twice": (
        rk.read_two_column,
        "0.0 1\n0.1 2\n0.1 3\n0.2 4\n",
        r"line 3: has the time 0\.1 s after 0\.1 s.*leave out repeated ones",
    ),
    "rows that are not sorted": (
        rk.read_two_column,
        "0.0 1\n0.1 2\n0.3 3\n0.2 4\n",
        r"line 4: has the time 0\.2 s after 0\.3 s.*sort the rows by time",
    ),
    "negative count": (rk.read_single_column, "t\n-2 0.1\n1\n2\n", r"two samples"),
    "huge count": (rk.read_single_column, "t\n1e18 0.1\n1\n2\n", r"its header says"),
    "drifting columns": (
        rk.read_two_column,
        "".join(f"{0.01 * i + 1e-5 * abs(i - 50):.5f} 1\n" for i in range(101)),
        r"comes .* after the row before",
    ),
    "columns of velocities": (
        rk.read_two_column,
        "t a v\n0.0 1 2\n0.1 2 3\n",
        r"line 1: names columns that are not accelerations",
    ),
    "European commas": (
        rk.read_two_column,
        "t a\n0,00;1,5\n1,00;1,7\n2,00;1,9\n",
        r"line 2: has decimal commas",
    ),
    "first time misprinted": (
        rk.read_two_column,
        "t a\nO.00 1\n0.01 2\n0.02 3\n",
        r"line 2: holds 'O.00', not a number",
    ),
    "two units": (
        rk.read_two_column,
        "time (s), x (cm/s2), y (m/s2)\n0.0 1 2\n0.1 2 3\n",
        r"line 1: names the unit m/s2, and line 1 names cm/s2",
    ),
    "time in two units": (
        rk.read_single_column,
        "time in ms\n2 0.1 SEC\n1\n2\n",
        r"line 2: has a step in SEC, and line 1 names ms",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_files(tmp_path, name):
    read, text, words = BAD[name]
    path = tmp_path / "record.txt"
    if text is not None:
        path.write_text(text)
    with pytest.raises(rk.FieldError) as caught:
        read(path)
    message = str(caught.value)
    assert message.startswith(f"{read.__name__}.path")
    assert "record.txt" in message
    assert re.search(words, message), message


@pytest.mark.parametrize("unit", ["in", "G", ["g"], 5, ("m/s2",), {"g": 1}])
@pytest.mark.parametrize(
    "read", [rk.read_at2, rk.read_single_column, rk.read_two_column, rk.read_v2a]
)
def test_unknown_units(read, unit):
    """Also those that cannot be looked up, and before the file is."""
    with pytest.raises(rk.FieldError, match=r"\.unit: is not known.*use one of: g, m"):
        read("x", unit=unit)


@pytest.mark.parametrize("name", ["kobe", ["kobe"], None])
def test_unknown_records(name):
    with pytest.raises(rk.FieldError, match=r"builtin_record\.name.*kaikoura"):
        rk.builtin_record(name)


@pytest.mark.parametrize("path", [None, 5, "a\0b"])
def test_what_is_no_path(path):
    with pytest.raises(rk.FieldError, match=r"path: .*give a file's path"):
        rk.read_at2(path)


def test_windows():
    record = rk.builtin_record("eqsig-test-motion")
    part = record.window(jnp.asarray(1.0), np.float64(2.0))
    np.testing.assert_array_equal(part.acceleration, record.acceleration[100:201])
    assert part.time[0] == 0.0
    shifted = record._replace(time=record.time - 5.0)
    assert shifted.window(-5, 10).time.shape == (1501,)
    for window in ((-5, 10), (-0.02, 1.0), (5.0, 47.0), (10.0, 5.0), (1.0, 1.001)):
        with pytest.raises(rk.FieldError, match=r"is not within the record"):
            record.window(*window)
    for window in (("0", 10), (True, 10), (None, 1), (0.0, [1.0]), (0.0, np.ones(2))):
        with pytest.raises(rk.FieldError, match="must be two times"):
            record.window(*window)
    for window in ((np.nan, 10), (0.0, np.inf)):
        with pytest.raises(rk.FieldError, match="must be finite"):
            record.window(*window)
    with pytest.raises(rk.FieldError, match="two samples or more"):
        record._replace(time=record.time[:1]).window(0, 1)


def test_the_issue_s_samples_of_100(tmp_path):
    """Samples of 100 cm/s^2 are 1 m/s^2 in every format."""
    at2 = "quake\nNPTS= 2, DT= .01 SEC\n100 100\n"
    files = {
        rk.read_at2: at2,
        rk.read_single_column: "quake\n2 0.01\n100\n100\n",
        rk.read_two_column: "t a\n0.00 100\n0.01 100\n",
        rk.read_v2a: v2a(first=-100.0),
    }
    for read, text in files.items():
        record = read(write(tmp_path, text), "cm/s2")
        assert record.acceleration[0, 0] == pytest.approx(1.0, rel=1e-15)


def test_a_header_may_be_in_any_encoding(tmp_path):
    """A byte order mark is no header, and line ends of PEER count once."""
    path = tmp_path / "record.txt"
    path.write_bytes(b"\xef\xbb\xbf0.00 1\n0.01 2\n0.02 3\n")
    assert rk.read_two_column(path).time.shape == (3,)
    path.write_bytes(b"S\xe9isme, acc. en (m/s\xb2)\n0.00 1\n0.01 2\n")
    assert rk.read_two_column(path).acceleration[0, 0] == 1.0
    path.write_bytes(b"0.00 1\r\r\n0.01 2\r\r\n0.02 x\r\r\n")
    with pytest.raises(rk.FieldError, match="line 3: holds 'x'"):
        rk.read_two_column(path)


@pytest.mark.parametrize("form", ["{:.3f}", "{:.3E}", "{:.6E}"])
def test_times_printed_in_any_form(tmp_path, form):
    """Off by half a unit of the last place: 5e-4 s, or that of the largest time."""
    time = np.arange(300) / 150
    text = "".join(f"{form.format(t)} 1\n" for t in time)
    record = rk.read_two_column(write(tmp_path, text))
    off = 0.5e-6 if "6" in form else 0.5e-3
    np.testing.assert_allclose(record.time, time, atol=1.01 * off)


def same(a, b):
    return all(
        np.array_equal(x, y)
        for x, y in zip((a.time, a.acceleration), (b.time, b.acceleration), strict=True)
    )


ROWS = "time acc\n" + "".join(
    f"{0.01 * i:.2f} {(-1) ** i * 0.0012 * (i + 1):.4f}\n" for i in range(8)
)
FILES = {
    "at2": (rk.read_at2, AT2.format(header="NPTS=  5, DT= .02000 SEC")),
    "single": (rk.read_single_column, SINGLE),
    "columns": (rk.read_two_column, ROWS),
    "v2a": (rk.read_v2a, v2a()),
    # whole lines only: what is lost does not show in the last line of a block
    "v2a of tens": (rk.read_v2a, v2a(counts=(20, 10, 10))),
}


@pytest.mark.parametrize("name", FILES)
def test_a_file_cut_anywhere_is_refused(tmp_path, name):
    """Refused, or read whole; rows have no count.

    At every character; in the long files at every 61st (fields have 8, lines 80), about
    every line end, and in the last two lines.
    """
    read, text = FILES[name]
    whole = read(write(tmp_path, text))
    taken = 0
    long, tail = len(text) > 1000, len(text) - 170
    for end in range(len(text)):
        middle = end % 61 and "\n" not in text[end - 1 : end + 2]
        if long and middle and end < tail:
            continue
        path = write(tmp_path, text[:end])
        try:
            record = read(path)
        except rk.FieldError:
            continue
        taken += 1
        rows = len(record.time)
        assert same(record, rk.Accelerogram(whole[0][:rows], whole[1][:rows], (), ""))
        assert rows == len(whole.time) or name == "columns", text[:end][-40:]
    # the last line end, and for rows the two sides of each line end
    assert taken == (1 if name != "columns" else 2 * 6 + 1)


@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize("change", ["blank", "missing", "twice"])
def test_a_line_more_or_less_is_refused(tmp_path, name, change):
    """At every line: refused, or the same samples at the same times."""
    read, text = FILES[name]
    whole, lines = read(write(tmp_path, text)), text.splitlines()
    refused = 0
    for i, line in enumerate(lines):
        middle = {"blank": ["", line], "missing": [], "twice": [line, line]}[change]
        path = write(tmp_path, "\n".join([*lines[:i], *middle, *lines[i + 1 :], ""]))
        try:
            record = read(path)
        except rk.FieldError:
            refused += 1
            continue
        # rows may be missing from both ends of a file without a count
        ends = {1, len(lines) - 1} if change == "missing" else {}
        if not (name == "columns" and i in ends):
            assert same(record, whole), (i, line)
    samples = {"at2": 2, "single": 5, "columns": 6, "v2a": 12, "v2a of tens": 12}
    # blank lines between samples lose nothing
    least = 0 if change == "blank" and "v2a" not in name else samples[name]
    assert refused >= least


@pytest.mark.parametrize("count", [1, 4, 6, 50])
def test_counts_other_than_what_follows(tmp_path, count):
    at2 = AT2.format(header=f"NPTS= {count}, DT= .02 SEC")
    single = SINGLE.replace("5 0.0100", f"{count} 0.0100")
    for read, text in ((rk.read_at2, at2), (rk.read_single_column, single)):
        with pytest.raises(rk.FieldError, match=r"its header says|two samples"):
            read(write(tmp_path, text))
    lines = v2a_lines()
    start = HEADER - 7
    assert lines[start][24:32] == "      12"
    for field in (3, 4, 5):
        row = lines[start][: 8 * field] + f"{count:8d}" + lines[start][8 * field + 8 :]
        changed = "\n".join([*lines[:start], row, *lines[start + 1 :]])
        with pytest.raises(rk.FieldError, match=r"record.txt"):
            rk.read_v2a(write(tmp_path, changed))


# samples, step [s] and peak [m/s^2], as ../shared/data/SOURCES.md has them
REAL = {
    "ARL360_Northridge1994_PEER.AT2": (rk.read_at2, 2000, 0.02, [3.02]),
    "IELC180_ElCentro1940_PEER.AT2": (rk.read_at2, 4000, 0.01, [3.07]),
    "RIO270_CapeMendocino1992.AT2": (rk.read_at2, 1800, 0.02, None),
    "elCentro1940_Peknold.AT2": (rk.read_at2, 1559, 0.02, [3.13]),
    "Northridge1994_CDMG24278_090.dat": (rk.read_two_column, 3989, 0.01, None),
    "eqsig_test_motion_dt0p01.txt": (rk.read_single_column, 4684, 0.01, None),
    "20161113_110259_WTMC_20.V2A": (rk.read_v2a, 8192, 0.02, [9.73, 7.97, 18.02]),
}


@pytest.mark.skipif(DATA is None, reason="the records are not at hand")
@pytest.mark.parametrize("name", REAL)
def test_real_records(name):
    """Against the plain numbers of the file, with and without their own unit."""
    read, count, step, peaks = REAL[name]
    record = read(DATA / name)
    np.testing.assert_array_equal(record.time, step * np.arange(count))
    if peaks is not None:
        found = np.abs(record.acceleration).max(axis=0)
        np.testing.assert_allclose(found, peaks, atol=0.00501)
    if name.endswith("V2A"):
        np.testing.assert_array_equal(
            record.acceleration, rk.builtin_record("kaikoura-2016-wtmc").acceleration
        )
        unit, other = "mm/s2", "g"
    else:
        words = (DATA / name).read_text().split()
        last = words[-2 * count :][1::2] if "Accel[g]" in words else words[-count:]
        expected = G * np.array(last, float)
        np.testing.assert_array_equal(record.acceleration[:, 0], expected)
        unit, other = "g", "cm/s2"
    assert same(read(DATA / name, unit), record)
    if name.startswith("eqsig"):  # its header has no unit
        other_unit = read(DATA / name, other).acceleration
        np.testing.assert_allclose(other_unit * G, 0.01 * record.acceleration)
        return
    with pytest.raises(rk.FieldError, match=rf"unit: .*, line \d+ names.*{unit}"):
        read(DATA / name, other)


@pytest.mark.parametrize(
    "header",
    [
        "Accel (1E-3 g)",
        "Accel, 1E-3 g",
        "ACCELERATION IN 1.0E-3 G",
        "acceleration (1e-3 m/s2)",
        "ACCELERATION (X 0.001 G)",
        "Acceleration (x 0.01 g)",
        "acceleration x500 (g)",
        "ACCELERATION (G)*100",
        "Acc (G) X 100",
        "Acc*1000 (g)",
        "1000 x acceleration (g)",
        "Acc (m/s2) x1e-3",
        "acceleration in terms of g x 10^-3",
        "acceleration in 10 * cm/s2",
        "UNITS=CM/S/S*1000",
        "Acc (ug)",
        "Acc (µg)",
        "Acc (kgal)",
        "Acc (dm/s2)",
        "Acceleration (decimeter/s2)",
        "Acceleration (%)",
        "SI",
    ],
)
def test_no_factor_and_no_unknown_unit_is_dropped(tmp_path, header):
    path = write(tmp_path, f"quake\n{header}\nNPTS= 2, DT= .01 SEC\n100 100\n")
    with pytest.raises(rk.FieldError, match=r"not known.*convert|usually g.*argument"):
        rk.read_at2(path)


@pytest.mark.parametrize(
    ("header", "unit"),
    [
        ("time_s,acc_ms2", 1.0),
        ("time_s,acc_m_s2", 1.0),
        ("time,ax_m_s2", 1.0),
        ("time,acc_mss", 1.0),
        ("time,acc_SI", 1.0),
        ("t / s, a / m s^-2", 1.0),
        ("t/s,a/(m/s^2)", 1.0),
        ("t/s,a/g", 9.80665),
        ("time,acc_cms2", 0.01),
        ("time,acc_cm_s2", 0.01),
        ("time_s,acc_g", 9.80665),
        ("# peak acceleration 0.3 g\ntime, acceleration", 9.80665),
        ("time, acceleration (g), component (x)", 9.80665),
    ],
)
def test_units_in_names_of_columns(tmp_path, header, unit):
    """A sample of 1 is one unit, exactly."""
    path = write(tmp_path, f"{header}\n0.00,1\n0.01,1\n0.02,1\n")
    record = rk.read_two_column(path)
    assert (record.acceleration == unit).all()
    assert record.time[1] == pytest.approx(0.01, rel=1e-12)  # ten roundings of 1e-16
    if unit == 1.0:
        assert (rk.read_two_column(path, unit="m/s2").acceleration == unit).all()


@pytest.mark.parametrize(
    ("columns", "header", "says"),
    [
        (2, "acc (m/s2),time (s)", "'time .s.', as column 2, not the first"),
        (2, "Acc Time", "'Time', as column 2, not the first"),
        (2, '"acc_g"\t"time_s"', "as column 2, not the first"),
        (3, "n,time (s),acc (g)", "'time .s.', as column 2, not the first"),
        (3, "#,time,acc", "'time', as column 2, not the first"),
        (
            3,
            "acc NS (g, raw), acc EW (g), t / s",
            "'t / s', as column 3, not the first",
        ),
        (2, "sample,acc (g)", "'sample' as the first column, which is no time"),
        (2, "No. acc_g", "'No.' as the first column, which is no time"),
        (2, "Period (s), acceleration (g)", "'Period .s.' as the first column"),
        (2, "t [s]; omega [rad/s]", "'omega .rad/s.', which is no acceleration"),
        (2, "t / s, tilt / deg", "'tilt / deg', which is no acceleration"),
        (3, "time (s), acc (m/s2), flag", "'flag', which is no acceleration"),
        (3, "quake\ntime, ax, omega\n# in g", "line 2.*'omega', which is no accel"),
    ],
)
def test_columns_that_a_header_names_otherwise(tmp_path, columns, header, says):
    """By order or by what they are: no time, no acceleration."""
    rows = "".join(f"{t}{',1' * (columns - 1)}\n" for t in (0.0, 0.01))
    path = write(tmp_path, f"{header}\n{rows}")
    with pytest.raises(rk.FieldError, match=rf"{says}.*(put the time|leave only)"):
        rk.read_two_column(path)


@pytest.mark.parametrize(
    "header",
    [
        "time (s), acc NS (g), EW",
        "time [s]; NS [g]; Up (vertical) [g]",
        "Time, N-S, E/W",
        "Time (s)  S36E (g)  090 (g)",
        "Elapsed time (s), a_x, a_y",
        "t, a1, a2",
        "time, channel 1 (N/S), channel 2 (E/W)",
        "time, station A, station B",
        "Acceleration Time History",
        "Acceleration in g, corrected, 20 Hz",
        "Kobe 1995, origin time 05:46, component NS",
        "Some quake, sample rate 100 Hz, NS",
        "N E Z",
    ],
)
def test_columns_that_a_header_names_in_order_or_not_at_all(tmp_path, header):
    path = write(tmp_path, f"{header}\n0.00,1,2\n0.01,1,2\n")
    record = rk.read_two_column(path, "g")
    np.testing.assert_array_equal(record.acceleration, [[G, 2.0 * G]] * 2)


@pytest.mark.parametrize(
    "line", ["2 100 NPTS, SPS", "2 100 Hz", "2 100 points, samples/s"]
)
def test_a_rate_is_no_step(tmp_path, line):
    path = write(tmp_path, f"quake\n{line}\n100\n100\n")
    with pytest.raises(rk.FieldError, match=r"gives a rate.*step in seconds"):
        rk.read_single_column(path)
    path = write(tmp_path, f"quake\n{line}\n100 100\n")
    with pytest.raises(rk.FieldError, match=r"gives a rate|no line with NPTS"):
        rk.read_at2(path)
