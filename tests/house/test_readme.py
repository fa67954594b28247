"""The README's commands and example are true."""

import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text()


PAGES = sorted((ROOT / "docs").glob("*.md"))


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


def test_python_examples_run(tmp_path):
    """Each block is a program of its own; x64 is set inside, as a reader would."""
    examples = [
        *blocks("python"),
        *(block for page in PAGES for block in blocks("python", page.read_text())),
    ]
    assert len(examples) > 2
    for example in examples:
        run = subprocess.run(
            [sys.executable, "-W", "error", "-c", example],
            capture_output=True,
            text=True,
            cwd=tmp_path,  # some of them write files
            check=False,
        )
        assert run.returncode == 0, run.stderr


def test_images_exist():
    pictures = re.findall(r"!\[[^\]]*\]\(([^)]+)\)", README)
    assert pictures
    for picture in pictures:
        assert (ROOT / picture).is_file()
