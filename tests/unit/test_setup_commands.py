"""Commands to begin with: new, scenes --show, doctor; and numbers set for one run."""

import json
import os
import re
import tomllib
from importlib import resources
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from rollkane.cli import main
from rollkane.codegen import compiler
from rollkane.files.scene_files import SceneFileError, load_scene


def run(*arguments):
    # commands set XLA_FLAGS for their own process; the runner takes that back
    kept = {"XLA_FLAGS": os.environ.get("XLA_FLAGS")}
    return CliRunner(env=kept).invoke(main, [str(one) for one in arguments])


def text_of(name):
    return (resources.files("rollkane") / "scenes" / f"{name}.toml").read_text()


def test_new_writes_a_scene_that_is_right_and_overwrites_nothing(tmp_path):
    target = tmp_path / "mine.toml"
    done = run("new", tmp_path / "mine", "--like", "rolling-disc")
    assert done.exit_code == 0
    assert target.read_text() == text_of("rolling-disc")
    assert run("check", target).exit_code == 0
    target.write_text("kept")
    again = run("new", target)
    assert again.exit_code == 2
    assert "is there" in again.output
    assert target.read_text() == "kept"
    unknown = run("new", tmp_path / "other", "--like", "rolling-disk")
    assert unknown.exit_code == 2
    assert "rolling-disc" in unknown.output
    assert not (tmp_path / "other.toml").exists()
    nowhere = run("new", tmp_path / "none" / "mine")
    assert nowhere.exit_code == 1
    assert "cannot write" in nowhere.output


def test_scenes_shows_a_file():
    shown = run("scenes", "--show", "rattleback")
    assert shown.exit_code == 0
    assert tomllib.loads(shown.output) == tomllib.loads(text_of("rattleback"))
    unknown = run("scenes", "--show", "rattlebak")
    assert unknown.exit_code == 2
    assert "did you mean rattleback" in unknown.output


def test_doctor_lists_every_extra_that_is_asked_for():
    """Whose missing import anywhere says how to install it."""
    asked = set()
    for file in Path(str(resources.files("rollkane"))).rglob("*.py"):
        asked |= set(re.findall(r"rollkane\[(\w+)\]", file.read_text()))
    listed = set(json.loads(run("doctor", "--json").output)["extra"])
    assert asked - listed <= {"compiler"}  # of which the loop tells


def test_doctor_says_which_loop_runs_take(monkeypatch):
    found = json.loads(run("doctor", "--json").output)
    assert found["package"]["jax"]
    assert found["runs"].startswith("native") == (
        not found["compiler"].startswith("none")
    )

    def none():
        raise compiler.NoCompilerError("no C compiler was found")

    monkeypatch.setattr(compiler, "compiler_command", none)
    without = run("doctor")
    assert without.exit_code == 0
    assert "no C compiler was found" in without.output
    assert "diffrax" in without.output


CHANGES = {
    "body.mass": "2.0",
    "body.surface.semi_axes[1]": "0.05",
    "loads[0].acceleration": "[0.0, 0.0, -1.62]",
    "run.duration": "3.0",
}


def test_numbers_are_set_in_the_place_of_the_files():
    plain, changed = load_scene("rattleback"), load_scene("rattleback", CHANGES)
    assert float(changed.scene.body.mass) == 2.0
    np.testing.assert_array_equal(
        changed.scene.body.surface.semi_axes, [0.2, 0.05, 0.02]
    )
    np.testing.assert_array_equal(
        changed.scene.loads[0].acceleration, [0.0, 0.0, -1.62]
    )
    assert changed.times[-1] == 3.0
    np.testing.assert_array_equal(changed.scene.body.inertia, plain.scene.body.inertia)
    # a table that the file has not, and text without quotes
    slips = {"contact.kind": "rubber"}
    assert load_scene("rattleback", slips).scene.contact.without_spin


@pytest.mark.parametrize(
    ("path", "value", "says"),
    [
        ("body.mas", "2", "did you mean mass"),
        ("body.mass", "-2", "must be positive"),
        ("body.mass", "heavy", "body.mass"),
        ("loads[3].kind", "drag", "not there to be changed"),
        ("body.mass.unit", "1", "no table"),
        ("2body", "1", "no path"),
        ("[0]", "1", "no path"),
    ],
)
def test_what_cannot_be_set_is_told(path, value, says):
    with pytest.raises(SceneFileError, match=says):
        load_scene("rattleback", {path: value})


def test_the_command_sets_numbers(tmp_path):
    short = "--duration", 0.01, "--outputs", 2
    done = run("simulate", "ball-on-plane", *short, "--set", "body.mass=2")
    assert done.exit_code == 0
    wrong = run("simulate", "ball-on-plane", *short, "--set", "body.mass")
    assert wrong.exit_code == 2
    assert "PATH=VALUE" in wrong.output
    refused = run("simulate", "ball-on-plane", *short, "--set", "body.mass=0")
    assert refused.exit_code == 2
    assert "must be positive" in refused.output
