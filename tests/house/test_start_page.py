"""A newcomer's walk, docs/start.md: every step is short, and runs after another."""

import re
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from rollkane.pictures.summary import _SIDE

from .test_readme import run_program

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "start.md").read_text()
STEPS = re.findall(r"```(\w+)\n(.*?)```", PAGE, re.DOTALL)
SETTING_UP = ("python3 -m venv .venv", ". .venv/bin/activate")
COMMAND = "import sys; from rollkane.cli import main; main(sys.argv[1:])"


def commands(text):
    return text.replace("\\\n", " ").strip().splitlines()


def test_every_step_is_short():
    assert len(STEPS) > 8
    for kind, text in STEPS:
        lines = [line for line in text.splitlines() if line]
        assert len(lines) < {"toml": 13}.get(kind, 10), text


def test_a_reversal_is_what_a_summary_counts():
    """The spin beyond the same share of its largest the other way, on every page."""
    (study,) = (tomllib.loads(text) for _, text in STEPS if "[[events]]" in text)
    (event,) = study["events"]
    (spin,) = study["vary"].values()
    assert (event["name"], event["of"]) == ("reversal", "spin")
    assert event["level"] == -_SIDE * spin["mean"]
    for page in (PAGE, (ROOT / "README.md").read_text()):
        assert f"{100 * _SIDE:g} % of its largest the other way" in " ".join(
            page.split()
        )
        assert not re.search(r"turn(s|ed)? back", page)


def test_extras_and_written_files_are_known():
    from importlib.metadata import metadata

    extras = set(metadata("rollkane").get_all("Provides-Extra"))
    asked = re.findall(r'pip install "\.\[([\w,]+)\]"', PAGE)
    assert asked
    assert {name for names in asked for name in names.split(",")} <= extras


def run_command(line, folder):
    if line.startswith(("pip install", *SETTING_UP)):
        return
    program, *arguments = shlex.split(line)
    assert program == "rollkane", line
    run = subprocess.run(
        [sys.executable, "-c", COMMAND, *arguments],
        capture_output=True,
        text=True,
        cwd=folder,
        check=False,
    )
    assert run.returncode == 0, f"{line}\n{run.stdout}{run.stderr}"


@pytest.mark.slow
def test_the_walk(tmp_path):
    for kind, text in STEPS:
        if kind == "python":
            run_program(text, tmp_path)
        elif kind == "toml":
            name = re.match(r"# (\S+\.toml)\n", text)[1]
            (tmp_path / name).write_text(text)
        else:
            for line in commands(text):
                run_command(line, tmp_path)
    written = {path.name for path in tmp_path.iterdir()}
    assert {"rattleback.html", "stone.html", "fan.png", "fit.html"} < written
    assert "study.png" in written
