"""The documentation site has every page, fetches nothing and leads nowhere wrong."""

import importlib.util
import re
import subprocess
import sys
from pathlib import Path

import pytest

import rollkane as rk
from rollkane.files.scene_files import load_scene

from ..browser.chromium import Browser, command
from ..browser.page_heights import heights, too_tall
from .test_public_face import PUBLIC
from .test_readme import PROGRAMS, blocks

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"


def contents(page):
    """The pages that a page's tables of contents name, from the folder of the docs."""
    path = DOCS / f"{page}.md"
    found = []
    for block in re.findall(r"```\{toctree\}\n(.*?)```", path.read_text(), re.DOTALL):
        lines = [x for x in block.splitlines() if x and not x.startswith(":")]
        found += [str((path.parent / x).relative_to(DOCS)) for x in lines]
    return found


LISTED = [x for page in ("index", "reference/index", "theory") for x in contents(page)]


def test_every_page_is_in_the_contents_once():
    sources = [p for x in ("", "reference/", "theory/") for p in DOCS.glob(f"{x}*.md")]
    pages = {str(p.relative_to(DOCS).with_suffix("")) for p in sources}
    books = {f"notebooks/{p.stem}" for p in (ROOT / "notebooks").glob("*.py")}
    assert sorted(LISTED) == sorted((pages - {"index"}) | books)


def test_every_public_name_is_in_the_reference_once():
    directive = r"^\.\. auto\w+:: rollkane\.([\w.]+)$"
    pages = [p.read_text() for p in (DOCS / "reference").glob("*.md")]
    names = re.findall(directive, "\n".join(pages), re.MULTILINE)
    assert len(names) == len(set(names))
    assert {x for x in names if x.count(".") < 2 and x[0] != "_"} >= set(PUBLIC)


def test_links_of_the_readme_lead_somewhere():
    links = re.findall(r"\]\(([^)#]+)\)", (ROOT / "README.md").read_text())
    assert len(links) > 20
    for link in links:
        assert (ROOT / link).is_file(), link


def gallery():
    """Name of a scene -> its file, from the page."""
    page = (DOCS / "gallery.md").read_text()
    shown = r"!\[([\w-]+)\]\(images/gallery/\1\.png\) \*\*\1\*\*: [^|]+ "
    shown += r"\(\[file\]\((.+?)\)\)"
    return {name: (DOCS / path).resolve() for name, path in re.findall(shown, page)}


def test_the_gallery_has_picture_and_file_of_each_scene():
    source = (DOCS / "images" / "gallery.py").read_text()
    assert list(gallery()) == re.findall(r'Shown\("([\w-]+)"', source)
    built_in = {p.stem for p in (ROOT / "src/rollkane/scenes").glob("*.toml")}
    own = {p.stem for p in (DOCS / "gallery").glob("*.toml")}
    assert set(gallery()) == built_in | own
    for name, path in gallery().items():
        assert path.is_file()
        assert (DOCS / "images" / "gallery" / f"{name}.png").is_file()


@pytest.mark.slow
@pytest.mark.parametrize(
    "path", sorted((DOCS / "gallery").glob("*.toml")), ids=lambda p: p.stem
)
def test_scenes_of_the_gallery_run(path):
    file = load_scene(path)
    times = file.times[::20]
    run = rk.simulate(file.scene, file.start, times, rtol=file.rtol, modes=file.modes)
    assert run.succeeded


def test_every_name_has_an_example():
    programs = [x for page in PROGRAMS.values() for x in blocks("python", page)]
    programs += [p.read_text() for p in (ROOT / "notebooks").glob("*.py")]
    text = "\n".join(programs)
    used = set(re.findall(r"\brk\.((?:kane\.)?\w+)", text))
    used |= {f"kane.{name}" for name in re.findall(r"\bkane\.(\w+)", text)}
    assert set(PUBLIC) <= used


def site_checker():
    spec = importlib.util.spec_from_file_location("check", DOCS / "check_site.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


FINE = """<html><head><link rel="stylesheet" href="style.css"></head>
<body id="here"><a href="#here">x</a><a href="b.html#there">y</a>
<a href="https://example.org">out</a></body></html>"""


@pytest.mark.parametrize(
    ("wrong", "told"),
    [
        ('<script src="https://x.org/a.js"></script>', "fetches https://x.org/a.js"),
        ('<link rel="stylesheet" href="//x.org/a.css">', "fetches //x.org/a.css"),
        ('<img src="http://x.org/a.png">', "fetches http://x.org/a.png"),
        ("<style>@import 'https://x.org/f.css';</style>", "fetches https://x.org/f"),
        ('<p style="background: url(//x.org/f.png)">', "fetches //x.org/f.png"),
        ('<a href="c.html">z</a>', "c.html leads nowhere"),
        ('<a href="b.html#nowhere">z</a>', "b.html#nowhere leads nowhere"),
        ('<img src="gone.png">', "gone.png leads nowhere"),
    ],
)
def test_problems_of_a_site_are_found(tmp_path, wrong, told):
    checker = site_checker()
    (tmp_path / "a.html").write_text(FINE)
    (tmp_path / "b.html").write_text('<p id="there">')
    (tmp_path / "style.css").write_text("p { color: red }")
    assert checker.problems(tmp_path) == []
    (tmp_path / "b.html").write_text(f'<p id="there">{wrong}')
    (problem,) = checker.problems(tmp_path)
    assert told in problem


def test_sheets_of_a_site_are_read(tmp_path):
    (tmp_path / "a.html").write_text("")
    (tmp_path / "a.css").write_text("@font-face { src: url('https://x.org/f.woff2') }")
    (problem,) = site_checker().problems(tmp_path)
    assert "fetches https://x.org/f.woff2" in problem


@pytest.mark.slow
def test_the_site_builds_without_warnings(tmp_path):
    """All but what notebooks print, which tests of their own look at."""
    pytest.importorskip("myst_nb", reason="`make docs` installs what builds the site")
    site = tmp_path / "site"
    build = [sys.executable, "-m", "sphinx", "-q", "--fail-on-warning", "--keep-going"]
    build += ["-D", "nb_execution_mode=off", "-d", str(tmp_path / "trees"), str(DOCS)]
    run = subprocess.run(
        [*build, str(site)], capture_output=True, text=True, check=False
    )
    assert run.returncode == 0, run.stderr
    assert site_checker().problems(site) == []
    pages = {str(p.relative_to(site).with_suffix("")) for p in site.rglob("*.html")}
    assert pages > set(LISTED)
    if command() is not None:  # apt-get install chromium
        browser = Browser(tmp_path)
        try:
            assert too_tall(heights(site, browser)) == []
        finally:
            browser.close()
