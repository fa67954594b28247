"""``rollkane fit``: what it prints and writes, and how it refuses; its pictures."""

import html.parser
import io
import json
import math
import os
import re
import sys
import tomllib

import click.testing
import numpy as np
import pytest

import rollkane as rk
from rollkane.cli import fit_command, main
from rollkane.cli.json_text import json_text
from rollkane.files.scene_files import load_scene
from rollkane.identification import fitting, inertia_transforms, losses

SIGMA = 0.05  # rad/s, some hundredth of the rates
FREE = ("--free", "body.inertia", "--free", "body.mass")
FREE += ("--free", "start.angular_velocity")
COLUMNS = ("--gyro", "wx,wy,wz", "--sigma", f"gyro={SIGMA}")


def table(times, rates):
    rows = [",".join(map(repr, map(float, row))) for row in np.c_[times, rates]]
    return "\n".join(["t,wx,wy,wz", *rows]) + "\n"


@pytest.fixture(scope="module")
def rates():
    """Times, and what a gyro reads on the built-in rattleback, with noise."""
    file = load_scene("rattleback")
    times = np.linspace(0.0, 0.5, 51)
    run = rk.simulate(file.scene, file.start, times, rtol=1e-9)
    read = np.asarray(run.state.angular_velocity)
    noise = np.random.default_rng(3).standard_normal(read.shape)
    return times, read + SIGMA * noise


@pytest.fixture
def folder(tmp_path, monkeypatch, rates):
    times, values = rates
    (tmp_path / "run.csv").write_text(table(times, values))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def fit_with(*arguments):
    kept = {"XLA_FLAGS": os.environ.get("XLA_FLAGS")}
    command = ["fit", "rattleback", "run.csv", *arguments]
    return click.testing.CliRunner(env=kept).invoke(main, command)


class Page(html.parser.HTMLParser):
    """Which elements are open, and the text of the cells of tables."""

    def __init__(self, text):
        super().__init__()
        self.open, self.kinds, self.text = [], [], []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.kinds.append(tag)
        if tag not in ("meta", "img"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)


def test_what_it_finds_and_writes(folder):
    files = ("--json", "a.json", "--report", "a.html", "--plot", "a.png")
    result = fit_with(*COLUMNS, *FREE, *files)
    assert result.exit_code == 0, result.output
    for name in ("chi2 / degrees of freedom", "body.inertia.xz", "Not seen", "a.html"):
        assert name in result.output
    found = json.loads((folder / "a.json").read_text())
    assert {
        *("estimates", "standard_errors", "names", "covariance", "sigma"),
        *("chi2", "degrees_of_freedom", "converged", "rollouts", "unseen"),
        "start",
    } == set(found)
    assert found["converged"] is True
    # 153 samples, 10 coordinates, of which a common factor is not seen
    assert found["degrees_of_freedom"] == 153 - 9
    assert np.shape(found["covariance"]) == (len(found["names"]),) * 2
    assert found["sigma"] == {"gyro": [SIGMA] * 3}
    # rates tell mass and inertia by their ratio only
    (sentence,) = found["unseen"]
    assert "body.inertia and body.mass" in sentence
    assert found["standard_errors"]["body.mass"] is None
    assert found["standard_errors"]["body.inertia"][0][0] is None
    errors = np.array(found["standard_errors"]["start.angular_velocity"])
    estimate = np.array(found["estimates"]["start.angular_velocity"])
    truth = np.asarray(load_scene("rattleback").start.angular_velocity)
    # five standard errors: normal noise leaves them once in 6e5 draws of three
    assert np.all(np.abs(estimate - truth) < 5.0 * errors)
    assert (folder / "a.png").read_bytes().startswith(b"\x89PNG")
    _check_page((folder / "a.html").read_text(), found)


def _check_page(text, found):
    page = Page(text)
    assert page.open == []
    assert page.kinds.count("img") == 1
    assert "script" not in page.kinds
    assert "link" not in page.kinds
    # nothing is fetched: base64 has no colon, so that no picture can hold an address
    assert "://" not in text
    assert set(re.findall(r'(?:src|href)="([^:"]+:)', text)) == {"data:"}
    for name in found["names"]:
        assert name in page.text
    for sentence in found["unseen"]:
        assert sentence in page.text


def test_a_prior_tells_what_is_not_seen(folder):
    prior = ("--prior", "body.mass=1.0,0.02", "--json", "a.json", "--quiet")
    result = fit_with(*COLUMNS, *FREE, *prior)
    assert (result.exit_code, result.output) == (0, "")
    found = json.loads((folder / "a.json").read_text())
    assert found["unseen"] == []
    # the record says nothing of a common factor, so that the mass is known by its prior
    # alone; runs and derivatives are good to 1e-7, a condition number of 1e3 left of it
    np.testing.assert_allclose(found["standard_errors"]["body.mass"], 0.02, rtol=1e-4)


TURNED = """
[body]
mass = 1.3
inertia = [[2e-3, 0.0, 0.0], [0.0, 3e-3, 0.0], [0.0, 0.0, 4e-3]]
surface = { kind = "ellipsoid", semi_axes = [0.2, 0.15, 0.1] }
[base]
surface = { kind = "plane" }
[[loads]]
kind = "gravity"
[start]
rotations = [["x", 20.0], ["z", 45.0]]
angular_velocity = [0.5, 1.0, 3.0]
contact_on_base = [0.2, 0.1, 0.0]
[run]
duration = 0.5
outputs = 51
rtol = 1e-10
"""


def test_a_start_for_the_scene_file(folder):
    """Estimates are of the state, along body axes; a scene file has fixed ones."""
    scene = folder / "turned.toml"
    scene.write_text(TURNED)
    file = load_scene(scene)
    run = rk.simulate(file.scene, file.start, file.times, rtol=1e-10)
    (folder / "run.csv").write_text(table(file.times, run.state.angular_velocity))
    free = ("--free", "start.angular_velocity", "--json", "a.json")
    kept = {"XLA_FLAGS": os.environ.get("XLA_FLAGS")}
    command = ["fit", "turned.toml", "run.csv", *COLUMNS, *free]
    result = click.testing.CliRunner(env=kept).invoke(main, command)
    assert result.exit_code == 0, result.output
    found = json.loads((folder / "a.json").read_text())
    # without noise: runs at 1e-10, of numbers up to 3, by 51 samples
    wanted = {"angular_velocity": [0.5, 1.0, 3.0], "contact_on_base": [0.2, 0.1, 0.0]}
    for name, value in wanted.items():
        np.testing.assert_allclose(found["start"][name], value, rtol=0, atol=1e-7)
    estimate = found["estimates"]["start.angular_velocity"]
    own = np.asarray(file.start.angular_velocity)
    np.testing.assert_allclose(estimate, own, rtol=0, atol=1e-7)
    assert np.abs(own - [0.5, 1.0, 3.0]).max() > 1.0
    told = result.output[result.output.index("  [start]") :].split("  wrote")[0]
    assert tomllib.loads(told)["start"] == found["start"]


def test_times_in_another_unit_are_told_of(folder, rates, monkeypatch):
    """Before the search, which would run for minutes."""

    def found(*_, **__):
        raise rk.FieldError("fit.start", "...", "was not asked for", "go on")

    monkeypatch.setattr(fitting, "fit", found)
    times, values = rates
    long = "lasts 500 s, and SCENE runs for 20 s"
    milliseconds = 1e3 * times
    for shown, options, told in (
        (milliseconds, (), True),
        (milliseconds, ("--units", "time=ms"), False),
        (times, (), False),
    ):
        (folder / "run.csv").write_text(table(shown, values))
        result = fit_with(*COLUMNS, *FREE, *options)
        assert "was not asked for" in result.output
        assert (long in result.output) == told
        assert ("--units time=ms" in result.output) == told


def test_profiles(folder):
    free = ("--free", "start.angular_velocity", "--profile", "--json", "a.json")
    result = fit_with(*COLUMNS, *free)
    assert result.exit_code == 0, result.output
    assert "intervals by profiles" in result.output
    found = json.loads((folder / "a.json").read_text())
    low, high = found["intervals"]["start.angular_velocity"]
    for at, least, most in zip(
        found["estimates"]["start.angular_velocity"], low, high, strict=True
    ):
        assert least < at < most


def test_profiles_of_another_loss_are_refused_before_the_search(folder):
    """And before the record is read, which is not there."""
    (folder / "run.csv").unlink()
    result = fit_with(*COLUMNS, *FREE, "--profile", "--loss", "huber")
    assert result.exit_code == 2
    assert "--loss linear alone" in " ".join(result.output.split())


def test_one_that_does_not_converge(folder):
    files = ("--max-evaluations", "1", "--json", "a.json")
    given = ("--sigma", "gyro=1e-6", "--gyro", "wx,wy,wz")
    result = fit_with(*given, *FREE, *files, "--strategy", "single")
    assert result.exit_code == 3
    assert "did not converge" in result.stderr
    assert json.loads((folder / "a.json").read_text())["converged"] is False


def test_degrees_are_noticed(folder, rates):
    times, values = rates
    (folder / "run.csv").write_text(table(times, np.rad2deg(values)))
    told = fit_with(
        *COLUMNS, *FREE, "--max-evaluations", "1", "--strategy", "single"
    ).stderr
    assert "warning: gyro: its values look like degrees" in told
    assert '"deg/s"' in told
    again = fit_with(*COLUMNS, *FREE, "--units", "gyro=deg/s")
    assert (again.exit_code, again.stderr) == (0, "")


REFUSED = {
    "no parameter": (COLUMNS, "Missing option '--free'"),
    "an unknown one": ((*COLUMNS, "--free", "body.mas"), "did you mean 'body.mass'?"),
    "no channel": (FREE, "names no channel"),
    "a missing column": ((*FREE, "--gyro", "wx,wy,wq"), "no column 'wq'"),
    "no value": ((*COLUMNS, *FREE, "--units", "gyro"), "'gyro' is not NAME=VALUE"),
    "twice": ((*COLUMNS, *FREE, "--sigma", "gyro=1"), "names gyro twice"),
    "a channel twice": (
        (*COLUMNS, *FREE, "--channel", "gyro=wy,wx,wz"),
        "names gyro, which an option of its own gives, too",
    ),
    "two spellings": (
        (*COLUMNS, *FREE, "--sigma", "contact-path=1", "--sigma", "contact_path=2"),
        "names contact_path twice",
    ),
    "no numbers": ((*FREE, "--gyro", "wx,wy,wz", "--sigma", "gyro=a"), "not made of"),
    "one of two": ((*COLUMNS, *FREE, "--between", "0.1"), "is not two numbers"),
    "half a prior": (
        (*COLUMNS, *FREE, "--prior", "body.mass=1,"),
        "a mean and a standard deviation",
    ),
    "bounds of none": (
        (*COLUMNS, *FREE, "--bounds", "body.center_of_mass=0,1"),
        "--free body.center_of_mass, too",
    ),
    "the data's own name": ((*COLUMNS, *FREE, "--json", "run.csv"), "file of DATA"),
    "no folder": ((*COLUMNS, *FREE, "--report", "none/a.html"), "does not exist"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_refusals(folder, case):
    arguments, words = REFUSED[case]
    before = (folder / "run.csv").read_bytes()
    result = fit_with(*arguments)
    assert result.exit_code == 2
    assert words in result.stderr
    assert [path.name for path in folder.iterdir()] == ["run.csv"]
    assert (folder / "run.csv").read_bytes() == before


def test_parameters_with_all_that_is_said_of_them():
    named = {
        "bounds": {"body.mass": "0.5,", "gyro.bias": "-1,1"},
        "prior": {"body.mass": "1,0.1"},
        "form": {"body.inertia": "diagonal"},
    }
    assert fit_command._free(["body.mass", "gyro.bias", "body.inertia"], named) == [
        rk.Free("body.mass", bounds=(0.5, None), prior=(1.0, 0.1)),
        rk.Free("gyro.bias", bounds=(-1.0, 1.0)),
        rk.Free("body.inertia", form="diagonal"),
    ]


def test_choices_are_those_of_fit():
    assert fit_command.STRATEGIES == fitting.STRATEGIES
    assert tuple(losses.LOSSES) == fit_command.LOSSES
    assert inertia_transforms.FORMS == fit_command.FORMS
    told = click.testing.CliRunner().invoke(main, ["fit", "--help"]).output
    assert ", ".join(fit_command.FORMS) in " ".join(told.split())


def test_what_is_infinite_is_null():
    given = {"a": np.array([[1.0, np.inf]]), "b": (math.nan, 2, "x", True)}
    assert json.loads(json_text(given)) == {
        "a": [[1.0, None]],
        "b": [None, 2, "x", True],
    }


def test_progress_on_a_terminal(monkeypatch):
    terminal = io.StringIO()
    terminal.isatty = lambda: True
    monkeypatch.setattr(sys, "stderr", terminal)
    with fit_command._progress(quiet=False) as told:
        told(7, 12.5)
        assert "runs 7, chi2 12.5" in terminal.getvalue()
    with fit_command._progress(quiet=True) as told:
        assert told is None
