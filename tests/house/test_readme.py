"""The README's commands and example are true."""

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text()


DOCS = ROOT / "docs"
PAGES = sorted([*DOCS.glob("*.md"), *DOCS.glob("reference/*.md")])


def blocks(language, text=README):
    return re.findall(rf"```{language}\n(.*?)```", text, re.DOTALL)


def test_make_commands_exist():
    makefile = (ROOT / "Makefile").read_text()
    targets = set(re.findall(r"^([a-z-]+):", makefile, re.MULTILINE))
    commands = re.findall(r"^make ([a-z-]+)", "\n".join(blocks("sh")), re.MULTILINE)
    assert {"demo", "test"} <= set(commands)
    assert set(commands) <= targets
    assert "make test" in (ROOT / ".ci" / "run").read_text()


def test_rollkane_commands_exist():
    from rollkane.cli import main

    said = re.findall(r"^rollkane ([a-z-]+)", "\n".join(blocks("sh")), re.MULTILINE)
    assert said
    assert set(said) <= set(main.commands)


# What tells by which loop every run of a program went, as it ends.
TOLD = """
import atexit, json, pathlib
import rollkane.integration.backends as methods
known, taken = [], methods.Taken
methods.Taken = lambda *told: known.append(told[1:]) or taken(*told)
atexit.register(lambda: pathlib.Path("told").write_text(json.dumps(known)))
"""


def run_program(text, folder):
    """A program of its own; where there is a C compiler, all of its runs are native."""
    run = subprocess.run(
        [sys.executable, "-W", "error", "-c", TOLD + text],
        capture_output=True,
        text=True,
        cwd=folder,  # some of them write files
        check=False,
    )
    assert run.returncode == 0, run.stderr
    told = json.loads((folder / "told").read_text())
    if any(map(shutil.which, ("cc", "gcc", "clang"))):
        assert told == [["native", ""]] * len(told)


# Pages whose programs compile for a minute; what they call has tests of its own.
LONG = ("events.md", "fit.md", "monte_carlo.md", "periodic.md", "steady.md")
LONG += ("control.md", "distributions.md", "rolling_contacts.md")
LONG += ("sensitivity_indices.md", "rolling-on-rolling.md")
LONG += ("contributing.md", "ensembles.md")
# Pages whose programs go on from what was before: test_start_page.py, test_mistakes.py
IN_ORDER = "start.md", "mistakes.md"
PROGRAMS = {str(page.relative_to(DOCS)): page.read_text() for page in PAGES}
PROGRAMS = {"README.md": README} | PROGRAMS


def is_long(page):
    return page in LONG or page.startswith("reference/")


@pytest.mark.parametrize(
    "page",
    [
        pytest.param(page, marks=[pytest.mark.slow] if is_long(page) else [])
        for page, text in PROGRAMS.items()
        if blocks("python", text) and page not in IN_ORDER
    ],
)
def test_python_examples_run(page, tmp_path):
    """Each block is a program of its own; x64 is set inside, as a reader would.

    All of their runs are native, where there is a compiler.
    """
    for example in blocks("python", PROGRAMS[page]):
        run_program(example, tmp_path)


def test_images_exist():
    pictures = re.findall(r"!\[[^\]]*\]\(([^)]+)\)", README)
    assert pictures
    for picture in pictures:
        assert (ROOT / picture).is_file()
