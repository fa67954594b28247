"""Pictures of the gallery open the pages that play their motion, where these were made.

``make docs`` writes them into ``build/gallery``; without them pictures are pictures.
"""

from pathlib import Path

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.fileutil import copy_asset

FOLDER = Path(__file__).parents[2] / "build" / "gallery"


def link(app: Sphinx, document: nodes.document) -> None:
    """Wrap each picture in a link to its page."""
    if app.env.docname != "gallery":
        return
    for image in list(document.findall(nodes.image)):
        name = Path(image["uri"]).stem
        if (FOLDER / f"{name}.html").exists():
            opened = nodes.reference("", "", refuri=f"_pages/{name}.html")
            image.replace_self(opened)
            opened += image


def add_pages(app: Sphinx, failed: Exception | None) -> None:
    """The pages, beside the site's own."""
    if failed is None and app.builder.format == "html" and FOLDER.exists():
        copy_asset(FOLDER, app.outdir / "_pages")


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the steps."""
    app.connect("doctree-read", link)
    app.connect("build-finished", add_pages)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
