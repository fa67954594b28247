"""Problems of a built site: what it would fetch from elsewhere, and links to nothing.

python docs/check_site.py site
"""

import re
import sys
from html.parser import HTMLParser
from pathlib import Path
from typing import NamedTuple
from urllib.parse import unquote, urlsplit

# What a browser fetches by itself when it shows a page: element -> attributes.
FETCHED = {
    "audio": ("src",),
    "embed": ("src",),
    "iframe": ("src",),
    "img": ("src", "srcset"),
    "link": ("href",),
    "object": ("data",),
    "script": ("src",),
    "source": ("src", "srcset"),
    "video": ("src", "poster"),
}
ELSEWHERE = re.compile(r"(?:https?:)?//")
# Style sheets may fetch by url(...) and @import.
STYLE = re.compile(r"""(?:url\(\s*|@import\s+)["']?((?:https?:)?//[^"')\s]+)""")


class Page(NamedTuple):
    """What a page refers to, and what may be referred to in it."""

    fetched: list[str]
    links: list[str]
    anchors: set[str]
    styles: str


class _Reader(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.page = Page([], [], {"", "top"}, "")
        self.styles: list[str] = []
        self.in_style = False

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = {name: value or "" for name, value in attrs}
        self.in_style = tag == "style"
        self.styles.append(given.get("style", ""))
        for name in ("id", "name"):
            if name in given:
                self.page.anchors.add(given[name])
        if tag == "a" and "href" in given:
            self.page.links.append(given["href"])
        if tag == "link" and given.get("rel") in ("canonical", "author", "license"):
            return
        self.page.fetched.extend(given[x] for x in FETCHED.get(tag, ()) if x in given)

    def handle_data(self, data: str) -> None:
        if self.in_style:
            self.styles.append(data)

    def handle_endtag(self, tag: str) -> None:
        self.in_style = False


def read(path: Path) -> Page:
    """A page of the site."""
    reader = _Reader()
    reader.feed(path.read_text())
    return reader.page._replace(styles="\n".join(reader.styles))


def problems(site: Path) -> list[str]:
    """What is wrong with a site, a line each."""
    pages = {path.resolve(): read(path) for path in sorted(site.rglob("*.html"))}
    found = [] if pages else [f"{site}: no page"]
    for sheet in site.rglob("*.css"):
        found += [f"{sheet}: fetches {x}" for x in STYLE.findall(sheet.read_text())]
    for path, page in pages.items():
        outside = [x for x in page.fetched if ELSEWHERE.match(x)]
        outside += STYLE.findall(page.styles)
        found += [f"{path}: fetches {x}" for x in outside]
        found += [f"{path}: {x} leads nowhere" for x in _dead(path, page, pages)]
    return found


def _dead(path: Path, page: Page, pages: dict[Path, Page]) -> list[str]:
    """References to files or anchors that are not there."""
    dead = []
    for link in [*page.links, *page.fetched]:
        parts = urlsplit(link)
        if parts.scheme or parts.netloc:
            continue
        there = (path.parent / unquote(parts.path)).resolve() if parts.path else path
        anchor = unquote(parts.fragment)
        if not there.exists() or (
            there in pages and link in page.links and anchor not in pages[there].anchors
        ):
            dead.append(link)
    return dead


if __name__ == "__main__":
    told = problems(Path(sys.argv[1]))
    print("\n".join(told) if told else f"{sys.argv[1]}: no problem")
    sys.exit(bool(told))
