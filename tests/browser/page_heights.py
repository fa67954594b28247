"""How tall the pages of a built site are, as a headless Chromium lays them out.

python -m tests.browser.page_heights site
"""

import sys
import tempfile
from pathlib import Path

from .chromium import Browser, command

LIMIT = 6000  # of a page's text [px]: what one scrolls through without getting lost
WINDOW = 1280, 900  # px
# The article alone: not the bars beside it, and not the footer below it.
_ARTICLE = "document.querySelector('article')?.scrollHeight ?? 0"


def heights(site: Path, browser: Browser) -> dict[str, int]:
    """Heights of the articles of a site's pages [px], by their paths in it."""
    found: dict[str, int] = {}
    for path in sorted(site.rglob("*.html")):
        name = path.relative_to(site).as_posix()
        if not name.startswith("_"):  # motions that play, which have no text
            browser.open(path, size=WINDOW)
            found[name] = int(browser.run(_ARTICLE))
    return found


def too_tall(found: dict[str, int]) -> list[str]:
    """A line for each page above the limit."""
    tall = {name: height for name, height in found.items() if height > LIMIT}
    return [f"{name}: {height} px, over {LIMIT}" for name, height in tall.items()]


def main(site: Path) -> int:
    """Print what is too tall; 1 if anything is."""
    if command() is None:
        print("heights of pages: not measured (apt-get install chromium)")
        return 0
    with tempfile.TemporaryDirectory() as folder:
        browser = Browser(Path(folder))
        try:
            found = heights(site, browser)
        finally:
            browser.close()
    tallest = max(found, key=lambda name: found[name])
    print(f"{len(found)} pages, the tallest {tallest}: {found[tallest]} px")
    problems = too_tall(found)
    for problem in problems:
        print(problem)
    return int(bool(problems))


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
