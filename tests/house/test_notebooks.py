"""Every notebook runs from its first cell to its last."""

from pathlib import Path

import pytest

from .test_readme import run_program

NOTEBOOKS = sorted((Path(__file__).parents[2] / "notebooks").glob("*.py"))


@pytest.mark.slow
@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda p: p.stem)
def test_notebook_runs(notebook, tmp_path):
    run_program(notebook.read_text(), tmp_path)
