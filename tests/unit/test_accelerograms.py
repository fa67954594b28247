"""Readers of recorded accelerations, and what they refuse."""

import re

import numpy as np
import pytest

import rollkane as rk
from rollkane.accelerograms import BUILTIN_RECORDS

G = 9.80665
AT2 = """SOME DATA BASE

SOME QUAKE, STATION, 360

ACCELERATION TIME HISTORY IN UNITS OF G
{header}
   .1000000E-02  -.2000000E-02   .3000000E-02
  -.4000000E-02   .5000000E-02
"""


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


def v2a(counts=(12, 5, 5), step="0.0200", cut=None):
    """A file with two components whose fields touch."""
    lines = []
    for name, sign in (("N28W", 1), ("Up", -1)):
        text = ["Corrected accelerogram TEST", *["text"] * 15]
        text[12] = f"Component {name}   Some axis"
        numbers = ["       1" * 10] * 10
        numbers[3] = "".join(f"{x:8d}" for x in (65536, 250, 250, *counts, 0, 0, 2, 3))
        numbers[6] = (
            "  327.68    5.00    5.00    1.00  0.0050" + f"{step:>8}" + "      0."
        )
        lines += text + numbers
        for block, count in enumerate(counts):
            values = sign * (-10000.1 - np.arange(count)) * (block == 0)
            rows = [values[i : i + 10] for i in range(0, count, 10)]
            lines += ["".join(f"{x:8.1f}" for x in row) for row in rows]
    return "\n".join(lines[:cut]) + "\n"


def test_v2a_with_touching_fields(tmp_path):
    record = rk.read_v2a(write(tmp_path, v2a()))
    assert record.components == ("N28W", "Up")
    expected = -1e-3 * (10000.1 + np.arange(12))
    np.testing.assert_allclose(record.acceleration[:, 0], expected, rtol=1e-12)
    np.testing.assert_allclose(record.acceleration[:, 1], -expected, rtol=1e-12)
    np.testing.assert_allclose(record.time, 0.02 * np.arange(12), rtol=1e-15)


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


COLUMNS = "t a\n0.00 1\n0.01 2\n0.02 3\n{row}\n0.04 5\n0.05 6\n"
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


def test_unknown_names():
    with pytest.raises(rk.FieldError, match=r"unit.*'in'.*use one of: g, m/s2"):
        rk.read_two_column("x", unit="in")
    with pytest.raises(rk.FieldError, match=r"'kobe'.*kaikoura"):
        rk.builtin_record("kobe")
