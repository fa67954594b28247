"""A file is what the ending of its name says, and replaces no other unasked."""

import csv
import os

import numpy as np
import pytest
from click.testing import CliRunner

import rollkane as rk
from rollkane.cli import main, output_files
from rollkane.files.csv_table import write_csv
from rollkane.files.export import to_xarray, write_netcdf
from rollkane.pictures.plotting import plot_contact_path

from .. import problems

BEGINS = {
    "a.png": b"\x89PNG",
    "a.SVG": b"<?xml",
    "a.pdf": b"%PDF",
    "a.csv": b"time,",
    "a.nc": b"\x89HDF",
    "a.h5": b"\x89HDF",
}


@pytest.fixture(scope="module")
def run():
    return rk.simulate(*problems.disc(6.0), np.linspace(0.0, 0.5, 6))


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder with nothing in it, in which commands run."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def command(*words):
    return CliRunner().invoke(main, ["simulate", "rolling-disc", "-q", *words])


@pytest.mark.parametrize("name", ["a.png", "a.SVG", "a.pdf"])
def test_pictures_by_their_endings(run, tmp_path, name):
    assert run.plot(tmp_path / name) is None
    assert (tmp_path / name).read_bytes().startswith(BEGINS[name])
    if name != "a.png":  # PNG files have no date
        plot_contact_path(run, tmp_path / name)
        first = (tmp_path / name).read_bytes()
        assert b"CreationDate" not in first
        assert b"<dc:date>" not in first


@pytest.mark.parametrize("name", ["a", "a.gif", "run.png.tmp", ".png"])
def test_other_endings_are_refused(run, tmp_path, name):
    with pytest.raises(rk.FieldError, match=r"\.png, \.svg or \.pdf"):
        run.plot(tmp_path / name)
    with pytest.raises(rk.FieldError, match=r"\.nc, .* or \.hdf5"):
        write_netcdf(run, tmp_path / name)
    assert os.listdir(tmp_path) == []


def test_a_table_holds_the_same_numbers(run, tmp_path):
    write_csv(run, tmp_path / "a.csv")
    with open(tmp_path / "a.csv", newline="") as file:
        names, *rows = csv.reader(file)
    table = dict(zip(names, np.array(rows, float).T, strict=True))
    data = to_xarray(run)
    assert np.array_equal(table["time"], data["time"])
    assert np.array_equal(table["position_z"], data["position"].sel(axis="z"))
    assert np.array_equal(table["orientation_w"], data["orientation"][:, 0])
    assert np.array_equal(table["energy"], data["energy"])
    wide = [name for name in data.data_vars if data[name].ndim == 2]
    own = [name for name in data.data_vars if data[name].ndim == 1]
    assert len(table) == 1 + len(own) + sum(data[name].shape[1] for name in wide)
    # and it is a record that can be read
    record = rk.read_record(
        tmp_path / "a.csv",
        time="time",
        position=["position_x", "position_y", "position_z"],
        sigma={"position": 1e-3},
    )
    assert np.array_equal(record.time, run.time)


def test_a_batch_is_no_table(tmp_path):
    scene, start = problems.disc(6.0)
    import jax

    batch = jax.vmap(lambda _: rk.simulate(scene, start, [0.0, 0.1]))(np.arange(2))
    with pytest.raises(rk.FieldError, match=r"is a batch.*\.nc"):
        write_csv(batch, tmp_path / "a.csv")


def test_the_command_line_goes_by_endings(folder):
    words = ["--out", "a.csv", "--plot", "a.pdf", "--path", "a.SVG"]
    done = command("--duration", "0.1", *words)
    assert (done.exit_code, done.output) == (0, "")
    for name in words[1::2]:
        assert (folder / name).read_bytes().startswith(BEGINS[name])


@pytest.mark.parametrize(
    ("option", "name", "says"),
    [
        ("--plot", "a.jpg", "the ending .jpg is not known; end the name in .png, .svg"),
        ("--out", "a.xlsx", "the ending .xlsx is not known; end the name in .nc,"),
        ("--path", "a", "a: has no ending; end the name in .png"),
        ("--view", "a.png", "the ending .png is not known; end the name in .html"),
        ("--gif", "a.mp4", "the ending .mp4 is not known; end the name in .gif"),
        ("--mp4", "a.gif", "the ending .gif is not known; end the name in .mp4"),
        ("--glb", "a.gltf", "the ending .gltf is not known; end the name in .glb"),
    ],
)
def test_unknown_endings_are_refused_before_the_run(folder, option, name, says):
    done = command(option, name)
    assert done.exit_code == 2
    assert says in " ".join(done.output.split())
    assert os.listdir(folder) == []


def test_files_are_replaced_by_force_or_after_a_question(folder, monkeypatch):
    (folder / "a.csv").write_text("old")
    (folder / "a.html").write_text("old")
    words = ["--duration", "0.1", "--out", "a.csv", "--view", "a.html"]
    refused = command(*words)
    assert refused.exit_code == 2
    assert "a.csv is there; give --force to replace it" in refused.output
    monkeypatch.setattr(output_files, "_is_asked", lambda: True)
    runner, line = CliRunner(), ["simulate", "rolling-disc", "-q", *words]
    declined = runner.invoke(main, line, input="y\nn\n")
    assert declined.exit_code == 2
    assert "a.html is there; replace it? [y/N]" in declined.output
    assert {p.read_text() for p in folder.iterdir()} == {"old"}
    assert runner.invoke(main, line, input="y\ny\n").exit_code == 0
    assert not any(p.read_text() == "old" for p in folder.iterdir())
    (folder / "a.csv").write_text("old")
    assert runner.invoke(main, [*line, "--force"]).exit_code == 0
    assert (folder / "a.csv").read_bytes().startswith(BEGINS["a.csv"])
    assert set(os.listdir(folder)) == {"a.csv", "a.html"}
