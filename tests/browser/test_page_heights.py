"""Pages that are too tall are found."""

import pytest

from tests.browser.chromium import Browser, command
from tests.browser.page_heights import LIMIT, heights, too_tall

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(command() is None, reason="chromium is not installed"),
]
PAGE = "<!DOCTYPE html><style>div {{ height: {} }}</style><aside><div></div></aside>"
PAGE += "<article><div></div></article>"


def test_tall_pages_are_named(tmp_path):
    site = tmp_path / "site"
    for name, height in {
        "low": LIMIT,
        "a/tall": LIMIT + 1,
        "_pages/ball": 9000,
    }.items():
        path = site / f"{name}.html"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(PAGE.format(f"{height}px"))
    browser = Browser(tmp_path)
    try:
        found = heights(site, browser)
    finally:
        browser.close()
    assert found == {"low.html": LIMIT, "a/tall.html": LIMIT + 1}
    assert too_tall(found) == [f"a/tall.html: {LIMIT + 1} px, over {LIMIT}"]
