"""The notebooks of the repository, as pages of the site.

They lie beside the documentation, as programs with cells; a copy below it, which is not
kept, is what the site is built of.
"""

from pathlib import Path
from typing import Any

import jupytext
from sphinx.application import Sphinx

KERNEL = {"name": "python3", "display_name": "Python 3", "language": "python"}
LANGUAGE = {"name": "python", "pygments_lexer": "ipython3"}


def read(text: str) -> Any:
    """A notebook of a program with cells; all of them are Python."""
    notebook = jupytext.reads(text, fmt="py:percent")
    notebook.metadata |= {"kernelspec": KERNEL, "language_info": LANGUAGE}
    return notebook


def copy(app: Sphinx) -> None:
    """Copies of notebooks, written only where they differ."""
    folder = Path(app.srcdir) / "notebooks"
    folder.mkdir(exist_ok=True)
    sources = {p.name: p for p in (folder.parents[1] / "notebooks").glob("*.py")}
    for path in folder.glob("*.py"):
        if path.name not in sources:
            path.unlink()
    for name, source in sources.items():
        there = folder / name
        text = source.read_text()
        if not there.exists() or there.read_text() != text:
            there.write_text(text)


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the step, before sources are looked for."""
    app.connect("builder-inited", copy, priority=100)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
