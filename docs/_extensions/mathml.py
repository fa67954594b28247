"""Equations as MathML, made from TeX while the site is built.

No script renders them in the reader's browser and nothing is fetched: the browser's own
layout shows them, in a font that the site brings. TeX that is not understood is a
warning, so that a build with warnings as errors ends there.
"""

import html
import re
from pathlib import Path
from typing import Any

from docutils.nodes import SkipNode
from math_core import LatexError, LatexToMathML
from sphinx.application import Sphinx
from sphinx.util import logging
from sphinx.util.fileutil import copy_asset
from ziamath import fonts

FONT = Path(fonts.__file__).parent / "STIXTwoMath-Regular.ttf"
LOGGER = logging.getLogger(__name__)
TRANSLATE = LatexToMathML(fancy_error=False)


def mathml(tex: str, node: Any, *, displayed: bool) -> str:
    """MathML of TeX; its text, with a warning, where it is not understood."""
    if re.search(r"[\x00-\x09\x0b-\x1f]", tex):  # an escape that Python took for one
        LOGGER.warning("a control character in an equation: %r", tex, location=node)
    try:
        return TRANSLATE.convert_with_local_state(tex, displaystyle=displayed)
    except LatexError as error:
        LOGGER.warning("%s: %s", error, tex, location=node)
        return f"<code>{html.escape(tex)}</code>"


def inline(translator: Any, node: Any) -> None:
    """An equation in a line of text."""
    translator.body.append(mathml(node.astext(), node, displayed=False))


def displayed(translator: Any, node: Any) -> None:
    """An equation of its own, with the number that its label gives."""
    tex = node.astext().strip()
    label = node.get("label") or ""
    number = f"({label})" if re.fullmatch(r"\d+\.\d+", label) else ""
    anchor = f' id="equation-{label.replace(".", "-")}"' if number else ""
    translator.body.append(
        f'<div class="equation"{anchor}><div class="formula">'
        f"{mathml(tex, node, displayed=True)}</div>"
        f'<span class="number">{number}</span></div>\n'
    )


def leave(translator: Any, node: Any) -> None:
    """Nothing is left open."""


def skip(render: Any) -> Any:
    """A visitor that renders a node and nothing below it."""

    def visit(translator: Any, node: Any) -> None:
        render(translator, node)
        raise SkipNode

    return visit


def add_font(app: Sphinx, failed: Exception | None) -> None:
    """The font of the equations, beside the other files of the site."""
    if failed is None and app.builder.format == "html":
        copy_asset(FONT, app.outdir / "_static")


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the renderer."""
    app.add_html_math_renderer(
        "mathml", (skip(inline), leave), (skip(displayed), leave)
    )
    app.connect("build-finished", add_font)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
