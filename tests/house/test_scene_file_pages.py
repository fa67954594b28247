"""The pages on scene files have every field, and their examples can be read."""

import importlib.util
import json
import tomllib
from pathlib import Path

import pytest

from rollkane.files.scene_files import load_scene
from rollkane.files.scene_files.tables import scene_schema

from .test_readme import blocks

DOCS = Path(__file__).parents[2] / "docs"


def page_maker():
    path = DOCS / "_scene_files" / "make_page.py"
    spec = importlib.util.spec_from_file_location("make_page", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


MAKER = page_maker()
TABLES = list(MAKER.tables())
SLOW = "surface", "rolling", "rolling.start"  # a search over a surface is compiled
EXAMPLES = [
    pytest.param(
        text,
        id=f"{table.place}-{table.kind}-{i}".replace("--", "-"),
        marks=[pytest.mark.slow] if table.place in SLOW else [],
    )
    for table in TABLES
    for i, text in enumerate(MAKER.examples(table))
]
(SHORTEST,) = blocks("toml", (DOCS / "_scene_files" / "introduction.md").read_text())


def test_the_pages_are_as_they_are_made():
    for name, text in MAKER.pages().items():
        made = "run: python docs/_scene_files/make_page.py"
        assert (DOCS / f"{name}.md").read_text() == text, made


def test_every_field_of_the_schema_is_there():
    """Every definition of the schema is a table of the pages, with its fields."""
    schema = scene_schema()
    defined = [schema, *schema["$defs"].values()]
    assert len(TABLES) == len(defined) > 30
    text = "\n".join(MAKER.pages().values())
    count = 0
    for table in defined:
        for name, field in table["properties"].items():
            if name != "kind":
                count += 1
                assert f"| `{name}` |" in text
            elif "const" in field:
                assert f'kind = "{field["const"]}"' in text
    assert text.count("\n| `") == count > 100


@pytest.mark.parametrize("table", TABLES, ids=lambda t: f"{t.place}-{t.kind}")
def test_every_field_is_in_an_example(table):
    given = [keys(tomllib.loads(text)) for text in MAKER.examples(table)]
    if table.place == "body":
        given.append(keys(tomllib.loads(SHORTEST)))
    others = set(MAKER.PLACES) if table.place == "file" else set()
    assert set(MAKER.fields(table)) <= set().union(others, *given)


def keys(document):
    """Keys of a document at any depth."""
    if isinstance(document, list):
        return set().union(*map(keys, document))
    if not isinstance(document, dict):
        return set()
    return set(document).union(*map(keys, document.values()))


def filled(given, rest):
    """A document with what it lacks of another; alternatives exclude each other."""
    either = [
        {"orientation", "rotations"},
        {"angular_velocity", "angular_velocity_body"},
    ]
    for name, value in rest.items():
        if isinstance(value, dict) and isinstance(given.get(name, {}), dict):
            given[name] = filled(dict(given.get(name, {})), value)
        elif not any(name in both and both & set(given) for both in either):
            given.setdefault(name, value)
    return given


def as_toml(value):
    """A value in TOML, tables within lines."""
    if isinstance(value, dict):
        inner = [f"{json.dumps(k)} = {as_toml(v)}" for k, v in value.items()]
        return f"{{ {', '.join(inner)} }}"
    if isinstance(value, list):
        return f"[{', '.join(map(as_toml, value))}]"
    return json.dumps(value)


@pytest.mark.parametrize("text", EXAMPLES)
def test_examples_can_be_read(text, tmp_path):
    given, rest = tomllib.loads(text), tomllib.loads(SHORTEST)
    if "surface" in given.get("body", {}):
        del rest["body"]["surface"]
    document = filled(given, rest)
    lines = [f"{key} = {as_toml(value)}" for key, value in document.items()]
    path = tmp_path / "example.toml"
    path.write_text("\n".join(lines))
    (tmp_path / "shaking.txt").write_text("0.0 0.0\n1.0 3.0\n2.0 0.0\n")
    assert load_scene(path).start is not None
