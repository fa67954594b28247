"""The pages on records are true: every row of its tables is what the readers do."""

import inspect
import re
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

import rollkane as rk
from rollkane.files.accelerogram_units import (
    PER_SECOND_SQUARED,
    QUANTITIES,
    TIMES,
    UNITS,
    said,
)
from rollkane.files.scene_files.motion_building import _READERS
from rollkane.files.scene_files.moving_tables import RecordTable

from .. import record_files

DOCS = Path(__file__).parents[2] / "docs"
PAGES = "records", "record_headers"


def tables():
    """Rows of each table of the pages, by the first cell of its head."""
    found, rows = {}, None
    text = "\n".join((DOCS / f"{name}.md").read_text() for name in PAGES)
    for line in text.splitlines():
        cells = [cell.strip() for cell in line.strip().strip("|").split("|")]
        if not line.startswith("|"):
            rows = None
        elif rows is None:
            rows = found.setdefault(tuple(cells), [])
        elif set(line) - set("|- "):
            rows.append(cells)
    return found


TABLES = tables()


def rows_of(*start):
    (rows,) = [rows for head, rows in TABLES.items() if head[: len(start)] == start]
    assert rows
    return rows


def code(cell):
    """The texts between backticks, in which two blanks may stand for themselves."""
    return re.findall(r"`([^`]*)`", cell)


def reader_of(cell):
    return getattr(rk, code(cell)[0])


def test_readers_are_those_of_scene_files():
    rows = rows_of("reader", "`format`")
    by_format = {code(row[1])[0]: reader_of(row[0]) for row in rows}
    assert by_format == _READERS
    formats = get_args(RecordTable.model_fields["format"].annotation)
    assert set(formats) == set(by_format)
    for read in by_format.values():
        assert inspect.signature(read).parameters["unit"].default is None


@pytest.mark.parametrize("row", rows_of("reader", "`format`"), ids=lambda row: row[0])
def test_the_unit_where_nobody_says_one(tmp_path, row):
    record = read(tmp_path, code(row[0])[0], "some quake", None)
    assert one(record) == pytest.approx(UNITS[code(row[3])[0]], rel=1e-15)


def test_units():
    """All units that the argument takes, and every spelling of them."""
    rows = {code(unit)[0]: (factor, names) for unit, factor, names in rows_of("`unit`")}
    assert {unit: float(factor) for unit, (factor, _) in rows.items()} == UNITS
    choices, _ = get_args(RecordTable.model_fields["unit"].annotation)
    assert set(get_args(choices)) == set(UNITS)
    for unit, (_, names) in rows.items():
        for name in code(names):
            phrase = name if name.endswith("units") else f"in units of {name}"
            for text in (phrase, phrase.upper(), phrase.lower()):
                assert said(text).units == (("acceleration", unit),), text


def test_no_spelling_is_left_out():
    """What stands for a unit in the code is in the table, as the page writes it."""
    written = "".join(names for *_, names in rows_of("`unit`")).lower()
    for word, (_, unit) in QUANTITIES.items():
        length = next((x for x in ("cm", "mm", "m") if word.startswith(x)), "")
        form = word[len(length) :]
        if unit in UNITS and form in PER_SECOND_SQUARED:
            shown = {"s-2": f"{length} s^-2"}.get(form, word)
            assert f"`{shown}`" in written, word
        elif unit in UNITS:
            assert word in written, word


def test_units_of_time():
    written = {}
    for factor, names in rows_of("[s]"):
        for name in code(names):
            written[name.lower()] = float(factor)
    # the two letters for micro look alike
    assert written == {x: TIMES[x] for x in TIMES if "μ" not in x}
    assert TIMES["μs"] == TIMES["µs"]


def read(folder, reader, line, unit, name="record.txt"):
    """What a reader makes of a file whose samples are 1, with a line in its header."""
    path = folder / name
    counting = re.search(r"NPTS|^\.?\d", line)
    if reader == "read_at2":
        size = "" if counting else "NPTS= 3, DT= .02 SEC\n"
        text = f"{line}\n{size}1.0 1.0 1.0\n"
    elif reader == "read_single_column":
        text = f"title\n{line}" if counting else f"{line}\n3 0.02"
        text += "\n1.0\n1.0\n1.0\n"
    elif reader == "read_two_column":
        text = f"{line}\n0.00 1.0\n0.02 1.0\n0.04 1.0\n"
    else:
        place = {"I": 10, "N": 9}.get(line[0], 13)
        # samples that grow by 1 from 1
        text = record_files.v2a(text={place: line}, first=-1.0)
    path.write_text(text, encoding="utf-8")
    return getattr(rk, reader)(path, unit)


def one(record):
    return abs(record.acceleration[0, 0])


def matches(sentence, message):
    """Whether a message has the parts of a sentence in their order."""
    pattern = ".*".join(re.escape(part.strip()) for part in sentence.split("…"))
    return re.search(pattern, message, re.DOTALL)


def judged(folder, reader, line, unit, wanted, value_of, approximate):
    if re.fullmatch(r"[\d.]+", wanted):
        found = value_of(read(folder, reader, line, unit))
        assert found == pytest.approx(float(wanted), rel=approximate)
        return
    with pytest.raises(rk.FieldError) as caught:
        read(folder, reader, line, unit)
    message = str(caught.value)
    assert matches(wanted, message), message
    assert re.search(r"record\.txt, line \d+", message), message


@pytest.mark.parametrize(
    "row", rows_of("reader", "line"), ids=lambda row: f"{row[0]} {row[1]}"
)
def test_lines_with_count_and_step(tmp_path, row):
    reader, line, wanted = row
    step = lambda record: record.time[1] - record.time[0]
    # one multiplication, and for columns the difference of two times
    (reader,), (line,) = code(reader), code(line)
    judged(tmp_path, reader, line, None, wanted, step, approximate=1e-12)


@pytest.mark.parametrize(
    "row", rows_of("reader", "header"), ids=lambda row: " ".join(row[:3])
)
def test_headers(tmp_path, row):
    reader, line, unit, wanted = row
    (reader,), (line,), unit = code(reader), code(line), (*code(unit), None)[0]
    judged(tmp_path, reader, line, unit, wanted, one, approximate=1e-15)


def written(folder, text, name="record.txt"):
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def _at2(text):
    header = "NPTS=  5, DT= .02000 SEC"
    return lambda folder: rk.read_at2(
        written(folder, text(record_files.AT2.format(header=header)))
    )


def _v2a(change):
    def refused(folder):
        lines = record_files.v2a_lines()
        return rk.read_v2a(written(folder, "\n".join(change(lines)) + "\n"))

    return refused


def _columns(row, **how):
    text = record_files.COLUMNS.format(row=row)
    return lambda folder: rk.read_two_column(written(folder, text), **how)


_DATA = record_files.HEADER
_ALL = len(record_files.v2a_lines()) // 3
DRIFT = np.cumsum(0.01 * (1.0 + 5e-4 * np.sign(np.arange(30_000) - 15_000)))
REFUSED = {
    "more or fewer samples than the header counts": _at2(lambda t: t + "0.1\n"),
    "a V2A file that is cut off in a block": _v2a(lambda lines: lines[: _DATA + 1]),
    "a V2A file that is cut off in the text of a component": _v2a(
        lambda lines: lines[: _ALL + 3]
    ),
    "a V2A file that is cut off between components": _v2a(lambda lines: lines[:_ALL]),
    "a V2A file with a blank line in a block": _v2a(
        lambda lines: [*lines[: _DATA + 1], "", *lines[_DATA + 1 :]]
    ),
    "a V2A file with a line missing from a block": _v2a(
        lambda lines: [*lines[:_DATA], *lines[_DATA + 1 :]]
    ),
    "a line of a V2A file that is cut off": _v2a(
        lambda lines: [*lines[:_DATA], lines[_DATA][:-3]]
    ),
    "a file that stops within its last number": _at2(lambda t: t.rstrip()[:-1]),
    "a word that is no number": _at2(lambda t: t.replace("-.4", "oops")),
    "1e400": _at2(lambda t: t.replace(".5000000E-02", "1e400")),
    "1e308 in g": _at2(lambda t: t.replace(".5000000E-02", "1e308")),
    "decimal commas": _columns("0,03 4"),
    "a first row that is spoilt": lambda folder: rk.read_two_column(
        written(folder, "0.00 nan\n0.01 2\n0.02 3\n")
    ),
    "a row with more columns": _columns("0.03 4 4"),
    "a gap in a time column": _columns(""),
    "times that fall, or repeat, in a time column": _columns("0.01 4"),
    "a .VT2 or .DT2 file whose header says nothing": lambda folder: rk.read_at2(
        written(folder, "title\nNPTS= 2, DT= .02 SEC\n1 2\n", "record.VT2")
    ),
    "a unit that is not known, or no text": _columns("0.03 4", unit=["g"]),
    "what is no path": lambda folder: rk.read_v2a(None),
    "binary data": lambda folder: rk.read_at2(written(folder, "\0\1")),
    "`window(-5, 10)` of a record from 0 s on": lambda folder: rk.builtin_record(
        "eqsig-test-motion"
    ).window(-5, 10),
    '`window("0", 10)`': lambda folder: rk.builtin_record("eqsig-test-motion").window(
        "0", 10
    ),
    "a clock of `RecordedMotion` that drifts": lambda folder: rk.RecordedMotion(
        DRIFT, np.zeros(len(DRIFT))
    ),
    "times of `RecordedMotion` that fall, or repeat": lambda folder: rk.RecordedMotion(
        DRIFT[[0, 1, 1, 2]], np.zeros(4)
    ),
}


def test_all_refusals_of_the_page_are_tried():
    assert [row[0] for row in rows_of("file or argument")] == [*REFUSED]


@pytest.mark.parametrize(
    "row", rows_of("file or argument"), ids=lambda row: row[0].strip("`")
)
def test_refusals(tmp_path, row):
    with pytest.raises(rk.FieldError) as caught:
        REFUSED[row[0]](tmp_path)
    assert matches(row[1], str(caught.value)), str(caught.value)
