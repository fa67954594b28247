"""The theory is true: every function and every test that its pages name is there."""

import ast
import importlib
import re
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parents[2]
CONTENTS = (ROOT / "docs" / "theory.md").read_text()
SECTIONS = {  # title and page of each section, in order
    name: (ROOT / "docs" / f"{name}.md").read_text()
    for name in re.findall(r"^(theory/\w+)$", CONTENTS, re.M)
}
PAGE = "\n".join([CONTENTS, *SECTIONS.values()])
ROWS = re.findall(
    r"^\| (.+?) \| .+? \| `([\w.]+)` \| `([\w/.]+)::(\w+)` \|$", PAGE, re.M
)


def test_the_table_is_read():
    listed = [line for line in PAGE.splitlines() if "::" in line]
    assert len(ROWS) == len(listed) > 20


# (1.17) writes derivatives of vectors out by components: automatic here
PAPER = {f"1.{k}" for k in range(1, 17)} | {f"2.{k}" for k in range(1, 11)}
NUMBERS = r"\(([1-9]\d?\.\d+)\)(?: to \(([1-9]\d?\.\d+)\))?"
OWN = re.findall(r"^\$\$ \((\d+\.\d+)\)$", PAGE, re.M)


def numbers_of(text: str) -> tuple[list[str], list[str]]:
    """Numbers of equations that a text cites: of the paper, and of the pages' own.

    Those behind "[A] (1.9), " are the paper's, too; of "(8.6) to (8.10)" all.
    """
    paper, own = [], []
    found = own
    for part in re.split(r"(\[[AB]\]|[;.:] |\n\n|docs/theory\.md)", text):
        if re.fullmatch(r"\[[AB]\]|[;.:] |\n\n|docs/theory\.md", part):
            found = {"[A]": paper, "[B]": []}.get(part, own)
            continue
        for first, last in re.findall(NUMBERS, part):
            chapter, begin = first.split(".")
            end = int(last.split(".")[1] if last else begin)
            found += [f"{chapter}.{k}" for k in range(int(begin), end + 1)]
    return paper, own


def test_equations_are_numbered_in_order():
    expected = []
    for number in OWN:
        chapter = number.split(".")[0]
        count = sum(x.startswith(f"{chapter}.") for x in expected)
        expected.append(f"{chapter}.{count + 1}")
    assert expected == OWN
    assert {x.split(".")[0] for x in OWN} == {str(k) for k in range(1, 12)}


def test_the_contents_tell_where_equations_are():
    """Each section is a page; its title and the range of its numbers are told."""
    row = r"^\| \[(.+?)\]\((theory/\w+)\.md\) \| \((.+?)\) to \((.+?)\) \|"
    told = {x[1]: (x[0], *x[2:]) for x in re.findall(row, CONTENTS, re.M)}
    assert list(told) == list(SECTIONS)
    for number, (name, text) in enumerate(SECTIONS.items(), 1):
        title, first, last = told[name]
        numbers = re.findall(r"^\$\$ \((\d+\.\d+)\)$", text, re.M)
        assert text.startswith(f"# {title}\n")
        assert title.startswith(f"{number}. ")
        assert (first, last) == (numbers[0], numbers[-1])
        assert {x.split(".")[0] for x in numbers} == {str(number)}


def test_every_numbered_equation_has_a_row():
    rows = [numbers_of(equation) for equation, *_ in ROWS]
    assert {x for paper, _ in rows for x in paper} == PAPER
    assert {x for _, own in rows for x in own} == set(OWN)


def test_what_the_code_cites_is_there():
    """Equations and sections of the pages, in docstrings and comments."""
    sections = set(re.findall(r"^# (\d+)\.", PAGE, re.M))
    looked_at = 0
    for path in (ROOT / "src").rglob("*.py"):
        for text in texts_of(path):
            assert not re.search(r"\btheory,? (section|\d)", text), path.name
            paper, own = numbers_of(text)
            assert set(paper) <= PAPER | {"1.17"}, (path.name, paper)
            assert set(own) <= set(OWN), (path.name, own)
            for named in re.findall(r"docs/theory\.md, sections? ([\d, and]+)", text):
                assert set(re.findall(r"\d", named)) <= sections, path.name
                looked_at += 1
            looked_at += len(own)
    assert looked_at > 60


def texts_of(path: Path) -> list[str]:
    """Docstrings and comments of a module."""
    text = path.read_text()
    nodes = ast.walk(ast.parse(text))
    kinds = ast.Module, ast.ClassDef, ast.FunctionDef
    told = [ast.get_docstring(node) for node in nodes if isinstance(node, kinds)]
    comments = re.findall(r"((?:^[ \t]*# .*\n)+)", text, re.M)
    return [x for x in told if x] + comments


@pytest.mark.parametrize(("equation", "name", "path", "test"), ROWS)
def test_function_and_test_exist(equation, name, path, test):
    thing = importlib.import_module("rollkane")
    for attribute in name.split("."):
        if isinstance(thing, ModuleType) and not hasattr(thing, attribute):
            importlib.import_module(f"{thing.__name__}.{attribute}")
        thing = getattr(thing, attribute)
    assert callable(thing)
    assert re.search(rf"^def {test}\(", (ROOT / "tests" / path).read_text(), re.M)
