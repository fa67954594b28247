"""The library speaks as its field does: words of our own do not come back."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
# Each with what the field says instead.
REPLACED = {
    r"rooms? (that|of|stand|for three)": "module",
    r"\bfloors? (that|of|table)": "folder",
    r"given by (its|their) normal": "parametrized by its normal (inverse Gauss map)",
    r"carr(y|ies) (its|their) (contact )?point": "explicit contact coordinates",
    r"\.carries_point": "has_contact_coordinates",
    r"[Bb]rought ?back|BroughtBack": "projected",
    r"\.room\b|\b_?ROOM\b": "workspace",
    r"manieth": "n-th",
    r"motion that pulls": "tensile contact force",
}
MODULES = [
    "numberwise",
    "rearrangements",
    "carried_functions",
    "refused_placements",
    "rolling_run",
    "keeping",
    "solving",
    "timed_runs",
    "whole_file",
    "step_source",
    "mode_changes",
    "hidden_events",
    "root_search",
    "flight_watch",
    "attempting",
    "acting",
]


def pages():
    kinds = ("*.py", "*.md", "*.c", "*.h", "*.pyi", "*.toml")
    files = [p for kind in kinds for p in (ROOT / "src").rglob(kind)]
    files += [ROOT / "README.md", *(ROOT / "docs").glob("*.md")]
    files += (ROOT / "docs" / "theory").glob("*.md")
    return [p for p in files if p.name != "moved_modules.py"]


TEXTS = {path.relative_to(ROOT): path.read_text() for path in pages()}


def test_the_pages_are_read():
    assert len(TEXTS) > 150


@pytest.mark.parametrize("word", REPLACED)
def test_words(word):
    found = {path for path, text in TEXTS.items() if re.search(word, text)}
    assert not found, f"say {REPLACED[word]!r}"


@pytest.mark.parametrize("name", MODULES)
def test_names_of_modules(name):
    found = {
        path
        for path, text in TEXTS.items()
        if path.stem == name or re.search(rf"import {name}\b|`{name}[`.]", text)
    }
    assert not found
