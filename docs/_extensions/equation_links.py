"""Numbers of equations in the theory's pages lead to the equations.

"(4.3)" is a link wherever it stands in these pages; not so the numbers of the sources,
which stand behind their letters: "[A] (1.9), (1.10)".
"""

import re
from collections.abc import Iterator
from pathlib import Path

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.osutil import relative_uri

NUMBERED = re.compile(r"^\$\$ \((\d+\.\d+)\)$", re.MULTILINE)
# what ends the reach of a source's letter, and the numbers
PARTS = re.compile(r"(\[[AB]\]|[;.:]\s|\(\d+\.\d+\))")
SECTIONS: dict[str, str] = {}
# texts that stay as they are
LEFT = nodes.literal, nodes.math, nodes.math_block, nodes.reference, nodes.title


def read_sections(app: Sphinx) -> None:
    """Which page has which equation."""
    SECTIONS.clear()
    for path in Path(app.srcdir).glob("theory/*.md"):
        for number in NUMBERED.findall(path.read_text()):
            SECTIONS[number] = f"theory/{path.stem}"


def links(app: Sphinx, parts: list[str]) -> Iterator[nodes.Node]:
    """Nodes in the place of a text, the reach of "[A]" being kept in the first part."""
    page = app.builder.get_target_uri(app.env.docname)
    for part in filter(None, parts[1:]):
        if not part.startswith("("):
            if PARTS.fullmatch(part):
                parts[0] = part
            yield nodes.Text(part)
            continue
        number = part[1:-1]
        if parts[0] in ("[A]", "[B]") or number not in SECTIONS:
            yield nodes.Text(part)
            continue
        there = relative_uri(page, app.builder.get_target_uri(SECTIONS[number]))
        anchor = f"{there}#equation-{number.replace('.', '-')}"
        yield nodes.reference("", part, refuri=anchor, internal=True)


def link(app: Sphinx, document: nodes.document) -> None:
    """Replace the numbers in the texts of a page of the theory."""
    if not app.env.docname.startswith("theory"):
        return
    for block in document.findall(nodes.TextElement):
        if isinstance(block, LEFT):
            continue
        reach = ""
        for text in [x for x in block.children if isinstance(x, nodes.Text)]:
            parts = [reach, *PARTS.split(text.astext())]
            block.replace(text, list(links(app, parts)))
            reach = parts[0]


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the steps."""
    app.connect("builder-inited", read_sections)
    app.connect("doctree-read", link)
    return {"parallel_read_safe": False, "parallel_write_safe": True}
