"""The command that sweeps: its grid, its table, its files, and how it refuses."""

import csv
import json
import re
from pathlib import Path

import numpy as np
import pytest

import rollkane as rk
from rollkane.cli import sweep_command
from rollkane.codegen.run_watch import _WATCH
from rollkane.files.scene_files import load_scene
from rollkane.pictures import plot_sweep
from tests.unit.test_cli import BALL, rollkane_with

SPIN, MASS = "start.angular_velocity[2]", "body.mass"


@pytest.fixture(scope="module")
def ball(tmp_path_factory):
    path = tmp_path_factory.mktemp("sweep") / "ball.toml"
    path.write_text(BALL.replace("outputs = 21", "outputs = 3"))
    return path


def table(path):
    with Path(path).open() as file:
        return list(csv.DictReader(file))


@pytest.fixture(scope="module")
def swept(ball):
    """A grid of two numbers, written as both tables and a picture."""
    out, nc = ball.with_suffix(".csv"), ball.with_suffix(".nc")
    arguments = ["sweep", str(ball), "--vary", f"{SPIN}=1:3:3", "--vary", f"{MASS}=1,2"]
    arguments += ["--observe", "position", "--observe", "spin"]
    plot = ball.with_suffix(".png")
    done = rollkane_with(*arguments, "--out", str(out), "--plot", str(plot), "-v")
    assert done.exit_code == 0, done.output
    again = rollkane_with(*arguments, "--out", str(nc), "--json")
    assert again.exit_code == 0, again.output
    return done.output, out, nc, json.loads(again.output), plot


def test_the_table_is_the_runs(ball, swept):
    """Each row is the run of a scene file that has these numbers."""
    text, out, _, _, plot = swept
    rows = table(out)
    grid = [(float(row[SPIN]), float(row[MASS])) for row in rows]
    assert grid == [(1, 1), (1, 2), (2, 1), (2, 2), (3, 1), (3, 2)]
    for row in rows[1:3]:
        file = load_scene(ball, {path: row[path] for path in (SPIN, MASS)})
        run = rk.simulate(file.scene, file.start, file.times, rtol=file.rtol)
        # both land on the outputs with errors of their own, 1e-9 a step by default and
        # some hundred steps; measured 2e-11
        for k, axis in enumerate("xyz"):
            own = np.asarray(run.position)[:, k]
            named = f"position_{axis}"
            for said, x in (
                (("last"), own[-1]),
                ("min", own.min()),
                ("max", own.max()),
            ):
                assert float(row[f"{named}_{said}"]) == pytest.approx(x, abs=1e-7)
        assert row["outcome"] == "completed"
        assert float(row["final_time"]) == 1.0
    assert plot.read_bytes().startswith(b"\x89PNG")
    assert "loop native" in text


def test_the_file_over_time_and_json_say_the_same(swept):
    import xarray

    _, out, nc, printed, _ = swept
    rows = table(out)
    with xarray.open_dataset(nc, engine="h5netcdf") as data:
        assert data["position"].dims == (SPIN, MASS, "time", "axis")
        last = data["position"].isel(time=-1).sel(axis="x").values.ravel()
        np.testing.assert_array_equal(
            last, [float(row["position_x_last"]) for row in rows]
        )
        assert data["spin"].attrs["units"] == "rad/s"
        assert set(data["outcome"].values.ravel()) == {"completed"}
    assert list(printed["columns"]) == list(rows[0])
    assert printed["columns"]["spin_last"] == [float(row["spin_last"]) for row in rows]


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--vary", "body.mass"], "is not PATH=LOW:HIGH:COUNT"),
        (["--vary", "body.mass=1:2"], "neither LOW:HIGH:COUNT"),
        (["--vary", "body.mass=1:2:1"], "with a COUNT >= 2"),
        (["--vary", "body.mass=1:nan:3"], "'nan' is not a finite number"),
        (["--vary", "body.mass=1:2:100001"], "more than 100,000"),
        (["--vary", "a=1:2:1000", "--vary", "b=1:2:1000"], "1,000,000 points"),
        (
            ["--vary", "body.mass=1,2", "--vary", "body.mass=3,4"],
            "names body.mass twice",
        ),
        (["--vary", "body.mass=1,-1"], "at body.mass = -1"),
        (["--vary", "body.mas=1,2"], "body.mas"),
        (["--vary", "body.mass=1,2", "--observe", "colour"], "colour"),
        (["--vary", "body.mass=1,2", "--out", "table.txt"], "ending .txt is not known"),
    ],
)
def test_what_cannot_be_swept_is_told(ball, options, says):
    done = rollkane_with("sweep", str(ball), *options)
    assert done.exit_code == 2
    assert says in " ".join(re.sub(r"[│\n]", " ", done.output).split())


def test_three_numbers_cannot_be_drawn(ball):
    options = [f"--vary={name}=1,2" for name in ("a", "b", "c")]
    done = rollkane_with("sweep", str(ball), *options, "--plot", "a.png")
    assert done.exit_code == 2
    assert "draws one or two numbers" in done.output


def test_the_scale_of_colours_tells_its_ends(tmp_path, monkeypatch):
    """The least and the greatest value, where the bar ends, with their unit."""
    kept = []
    monkeypatch.setattr(
        plot_sweep, "write_picture", lambda path, figure: kept.append(figure)
    )
    grids = [("body.mass", (1.0, 2.0)), ("start.spin", (1.0, 2.0, 3.0))]
    last = np.array([0.3, 0.7, 0.1, 0.2, 0.9, 0.5])
    columns = {"spin_last": last, "outcome": np.full(6, "completed")}
    plot_sweep.plot_sweep(grids, columns, {"spin": "rad/s"}, tmp_path / "a.png")
    (figure,) = kept
    (bar,) = [x for x in figure.axes if "at the end" in x.get_ylabel()]
    assert bar.get_ylabel() == "spin [rad/s] at the end"
    assert list(bar.get_ylim()) == [0.1, 0.9]
    np.testing.assert_allclose(bar.get_yticks()[[0, -1]], [0.1, 0.9])


def test_many_scales_of_colours_stand_in_rows(tmp_path, monkeypatch):
    """Three side by side; what is constant but for rounding has one value."""
    kept = []
    monkeypatch.setattr(
        plot_sweep, "write_picture", lambda path, figure: kept.append(figure)
    )
    grids = [("body.mass", (1.0, 2.0)), ("start.spin", (1.0, 2.0))]
    height = 0.11 + np.array([0.0, 0.0, 1e-17, 0.0])
    columns = {f"spin{i}_last": np.arange(4.0) for i in range(3)}
    columns |= {"height_last": height, "outcome": np.full(4, "completed")}
    units = {"spin": "rad/s", "height": "m"}
    plot_sweep.plot_sweep(grids, columns, units, tmp_path / "a.png")
    (figure,) = kept
    *_, bar = (x for x in figure.axes if "at the end" in x.get_ylabel())
    assert len(figure.axes) == 8  # four panels, each with its bar
    assert bar.get_ylabel() == "height [m] at the end"
    np.testing.assert_allclose(bar.get_yticks(), [0.11], rtol=1e-15)  # roundings
    width, high = figure.get_size_inches()
    assert width < 2.5 * high  # 2; all in one row five times


def test_motions_that_end_early_are_counted(ball):
    done = rollkane_with(
        "sweep", str(ball), "--vary", "body.mass=1,2", "--max-steps", "5", "-q"
    )
    assert done.exit_code == 3
    assert done.output == "error: 2 of 2 motions ended early: see outcome\n"


def test_ctrl_c_keeps_the_points_that_were_done(ball, monkeypatch):
    """The first block comes, then the signal: the rest is told as not run."""
    blocks = sweep_command._blocks

    def then_ctrl_c(*given):
        for found in blocks(*given):
            yield found
            _WATCH.ends = 1

    def as_interrupted(work, share, quiet):
        found = real(work, share, quiet)
        return found._replace(interrupted=True)

    real = sweep_command.waited
    monkeypatch.setattr(sweep_command, "_BLOCK", 2)
    monkeypatch.setattr(sweep_command, "_blocks", then_ctrl_c)
    monkeypatch.setattr(sweep_command, "waited", as_interrupted)
    out = ball.with_name("part.csv")
    done = rollkane_with(
        "sweep", str(ball), "--vary", "body.mass=1:2:5", "--out", str(out), "-q"
    )
    assert (done.exit_code, done.output) == (130, "stopped: 2 of 5 points were kept\n")
    outcomes = [row["outcome"] for row in table(out)]
    assert outcomes == ["completed"] * 2 + ["not run"] * 3


EVENT = """
[[events]]
name = "low"
of = "tilt"
level = 0.5
stop = true
"""
# a ball inside of a wavy base may touch it twice
POST = 'kind = "graph"\nf = "0.25 * exp(-((x - 0.4)**2 + y * y) / 0.002)"'


@pytest.fixture
def tilting(tmp_path):
    """The ball rolls about y at first: its z axis tilts by 0.5 on the way."""
    path = tmp_path / "tilting.toml"
    path.write_text(BALL + EVENT)
    return path


def swept_table(path, *options):
    out = path.with_suffix(".csv")
    done = rollkane_with("sweep", str(path), *options, "--out", str(out), "--force")
    assert done.exit_code == 0, done.output
    return table(out)


def alone(path, changes):
    """A point by itself, as simulate runs it."""
    file = load_scene(path, changes)
    how = {"rtol": file.rtol, "events": file.events}
    return rk.simulate(file.scene, file.start, file.times, **how)


def test_each_point_runs_for_its_own_time(ball):
    """And at its own outputs: as many as are given, whole numbers where they are."""
    options = "--vary=run.duration=0.5,1", "--vary=run.outputs=3:5:3"
    rows = swept_table(ball, *options, "--observe", "position")
    assert [float(row["final_time"]) for row in rows] == [0.5] * 3 + [1.0] * 3
    for row in rows[1::3]:
        changes = {"run.duration": row["run.duration"], "run.outputs": "4"}
        x = np.asarray(alone(ball, changes).position)[:, 0]
        told = [float(row[f"position_x_{of}"]) for of in ("last", "min", "max")]
        # 1e-9 a step, some hundred steps, as above
        np.testing.assert_allclose(told, [x[-1], x.min(), x.max()], atol=1e-7)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--vary=run.duration=1,2", "--out=a.nc"], "output times of their own"),
        (["--vary=run.duration=1,2", "--duration=2"], "--duration sets for all"),
        (["--vary=run.outputs=3,4.5"], "must be a whole number, got 4.5"),
    ],
)
def test_times_that_differ_are_not_mixed_up(ball, monkeypatch, options, says):
    """Refused before anything runs."""
    monkeypatch.setattr(sweep_command, "_blocks", None)
    monkeypatch.chdir(ball.parent)
    done = rollkane_with("sweep", str(ball), *options)
    assert done.exit_code == 2
    assert says in " ".join(re.sub(r"[│\n]", " ", done.output).split())


def test_an_event_ends_a_point_as_it_ends_a_run(tilting):
    """Its own level for each; what is told last is where it ended."""
    rows = swept_table(tilting, "--vary=events[0].level=0.3,0.5,9", "--observe=tilt")
    for row in rows[:2]:
        level = row["events[0].level"]
        run = alone(tilting, {"events[0].level": level})
        # the search goes to rounding; times differ by steps of 1e-9, as above
        assert float(row["final_time"]) == pytest.approx(
            float(run.final_time), abs=1e-7
        )
        assert float(row["tilt_last"]) == pytest.approx(float(level), abs=1e-7)
        assert row["tilt_max"] == row["tilt_last"]
        assert (row["outcome"], row["low_count"]) == ("stopped: low", "1.0")
        assert row["low_time"] == row["final_time"]
    assert rows[2]["outcome"] == "completed"
    assert (rows[2]["low_count"], rows[2]["low_time"]) == ("0.0", "nan")


def test_events_are_in_the_file_over_time(tilting):
    import xarray

    nc = tilting.with_suffix(".nc")
    done = rollkane_with(
        *("sweep", str(tilting), "--vary=body.mass=1,2", f"--out={nc}", "-q")
    )
    assert (done.exit_code, done.output) == (0, "")
    with xarray.open_dataset(nc, engine="h5netcdf") as data:
        assert data["low_count"].values.tolist() == [1.0, 1.0]
        np.testing.assert_array_equal(data["low_time"], data["final_time"])


def test_stopped_points_have_no_cross():
    outcome = np.array(["completed", "stopped: low", "max steps", "not run"])
    early = plot_sweep._early({"outcome": outcome})
    assert early.tolist() == [False, False, True, True]


def test_a_second_contact_ends_a_point(tmp_path):
    """A ball that rolls at a post, and one that does not come to it."""
    path = tmp_path / "graph.toml"
    text = BALL.replace('kind = "sphere"\nradius = 0.5', POST)
    text = text.replace("[0.0, 0.0, 0.5]", "[0.0, 0.0, 0.0]")
    path.write_text(text + "second_contact = true\n")
    vary = "--vary=start.angular_velocity[1]=0.5,5"
    done = rollkane_with("sweep", str(path), vary, "--json")
    assert done.exit_code == 3  # as a run that ends early
    columns = json.loads(done.stdout)["columns"]
    assert columns["outcome"] == ["completed", "second contact"]


def test_events_that_a_table_cannot_tell_apart_are_refused(tilting):
    """The first one was lost."""
    named = [EVENT.replace('"low"', f'"{name}"') for name in ("a/b", "a_b")]
    tilting.write_text(tilting.read_text().replace(EVENT, "".join(named)))
    done = rollkane_with("sweep", str(tilting), "--vary=body.mass=1,2")
    assert done.exit_code == 2
    assert "two events would have the columns of 'a_b'" in " ".join(done.output.split())


def test_an_event_that_would_hide_a_column_is_refused(tilting):
    tilting.write_text(tilting.read_text().replace('"low"', '"final"'))
    done = rollkane_with("sweep", str(tilting), "--vary=body.mass=1,2")
    assert done.exit_code == 2
    assert "give it another name" in " ".join(done.output.split())
