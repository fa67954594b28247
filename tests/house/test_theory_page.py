"""docs/theory.md is true: every function and every test that it names is there."""

import importlib
import re
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "theory.md").read_text()
ROWS = re.findall(
    r"^\| (.+?) \| .+? \| `([\w.]+)` \| `([\w/.]+)::(\w+)` \|$", PAGE, re.M
)


def test_the_table_is_read():
    listed = [line for line in PAGE.splitlines() if "::" in line]
    assert len(ROWS) == len(listed) > 20


def test_every_numbered_equation_has_a_row():
    # (1.17) writes derivatives of vectors out by components: automatic here
    expected = {f"1.{k}" for k in range(1, 17)} | {f"2.{k}" for k in range(1, 11)}
    # those of this page's own
    own = set(re.findall(r"^    \((7\.\d+)\)", PAGE, re.M))
    assert own == {f"7.{k}" for k in range(1, 12)}
    cited = [number for equation, *_ in ROWS for number in numbers_of(equation)]
    assert set(cited) == expected | own


def numbers_of(equation: str) -> list[str]:
    """Numbers of equations, those of "(7.6) to (7.10)" one by one."""
    between = re.fullmatch(r"\((\d)\.(\d+)\) to \(\1\.(\d+)\)", equation)
    if between:
        part, first, last = between.groups()
        return [f"{part}.{k}" for k in range(int(first), int(last) + 1)]
    return re.findall(r"\((\d\.\d+)\)", equation)


@pytest.mark.parametrize(("equation", "name", "path", "test"), ROWS)
def test_function_and_test_exist(equation, name, path, test):
    thing = importlib.import_module("rollkane")
    for attribute in name.split("."):
        if isinstance(thing, ModuleType) and not hasattr(thing, attribute):
            importlib.import_module(f"{thing.__name__}.{attribute}")
        thing = getattr(thing, attribute)
    assert callable(thing)
    assert re.search(rf"^def {test}\(", (ROOT / "tests" / path).read_text(), re.M)
