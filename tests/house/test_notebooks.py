"""Every notebook runs from its first cell to its last."""

import subprocess
import sys
from pathlib import Path

import pytest

NOTEBOOKS = sorted((Path(__file__).parents[2] / "notebooks").glob("*.py"))
FIRST = "first_steps"


@pytest.mark.parametrize(
    "notebook",
    [
        pytest.param(p, marks=() if p.stem == FIRST else pytest.mark.slow, id=p.stem)
        for p in NOTEBOOKS
    ],
)
def test_notebook_runs(notebook):
    run = subprocess.run(
        [sys.executable, str(notebook)], capture_output=True, text=True, check=False
    )
    assert run.returncode == 0, run.stderr
