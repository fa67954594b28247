"""docs/architecture.md is short and true: its folders and files are there."""

import re
from pathlib import Path

from .test_imports import FOLDERS, SOURCE

PAGE = (Path(__file__).parents[2] / "docs" / "architecture.md").read_text()
PICTURE = PAGE.split("\n\n")[2]


def test_it_is_short():
    assert len(PAGE.splitlines()) <= 120


def test_the_picture_has_every_folder():
    for folder in FOLDERS:
        assert re.search(rf"\b{folder}\b", PICTURE), folder


def test_files_exist():
    named = set(re.findall(r"`([\w/]+\.(?:pyi?|c))`", PAGE))
    assert len(named) > 30
    for name in named:
        here = SOURCE / ("codegen" if name.endswith(".c") else "")
        assert (here / name).is_file() or (SOURCE.parents[1] / name).is_file(), name
