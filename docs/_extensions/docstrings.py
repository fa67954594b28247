"""Docstrings of public names, as the reference shows them.

Those in Google's form become fields; every name is called as a reader calls it
(``rk.Body``), and is followed by the pages whose programs use it.
"""

import inspect
import re
from collections import defaultdict
from pathlib import Path
from typing import Any

from docutils import nodes
from sphinx.addnodes import desc_addname
from sphinx.application import Sphinx
from sphinx.ext.napoleon import Config, GoogleDocstring

FORM = Config(
    napoleon_use_ivar=True, napoleon_use_rtype=False, napoleon_attr_annotations=False
)
BLOCK = re.compile(r"```python\n(.*?)```", re.DOTALL)
NAME = re.compile(r"\brk\.((?:kane\.)?[A-Za-z_]\w*)")
MOST = 6  # pages that are named
USES: dict[str, list[str]] = {}


def uses(folder: Path) -> dict[str, list[str]]:
    """Public name -> the pages, by their names, whose programs use it."""
    found: dict[str, set[str]] = defaultdict(set)
    for path in sorted([*folder.glob("*.md"), *folder.glob("notebooks/*.py")]):
        text = path.read_text()
        programs = BLOCK.findall(text) if path.suffix == ".md" else [text]
        page = path.relative_to(folder).with_suffix("").as_posix()
        for name in NAME.findall("\n".join(programs)):
            found[name].add(page)
    return {name: sorted(pages) for name, pages in found.items()}


def process(
    app: Sphinx, what: str, name: str, thing: Any, options: Any, lines: list[str]
) -> None:
    """Fields of a docstring, and where its name is used."""
    if what in ("class", "exception", "function", "method"):
        lines[:] = GoogleDocstring(lines, FORM, app, what, name, thing, options).lines()
    # a class comes twice, the second time with its constructor's docstring
    pages = USES.pop(name.removeprefix("rollkane."), ())
    if pages:
        links = ", ".join(f":doc:`/{page}`" for page in pages[:MOST])
        lines += ["", f"*Used in:* {links}", ""]


def read_uses(app: Sphinx) -> None:
    """Where names are used, from the sources of all pages."""
    USES.clear()
    USES.update(uses(Path(app.srcdir)))


def sign(
    app: Sphinx, what: str, name: str, thing: Any, options: Any, *given: Any
) -> tuple[str, str] | None:
    """An instance that is public by itself has no signature."""
    known = inspect.isroutine(thing) or inspect.isclass(thing)
    return None if known or what != "function" else ("", "")


def call_as_readers_do(app: Sphinx, document: nodes.document) -> None:
    """``rollkane.Body`` is ``rk.Body`` in a reader's program."""
    for node in document.findall(desc_addname):
        text = node.astext()
        if text in ("rollkane.", "rollkane.kane."):
            node.children = [nodes.Text(text.replace("rollkane.", "rk."))]


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the steps."""
    app.setup_extension("sphinx.ext.autodoc")
    app.connect("builder-inited", read_uses)
    app.connect("autodoc-process-docstring", process)
    app.connect("autodoc-process-signature", sign)
    app.connect("doctree-read", call_as_readers_do)
    return {"parallel_read_safe": False, "parallel_write_safe": True}
