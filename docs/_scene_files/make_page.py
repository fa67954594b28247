"""Write the pages on scene files, from their schema and from examples.

``python docs/_scene_files/make_page.py``; a test holds the pages to it.
"""

import re
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from rollkane.files import scene_file_limits as limits
from rollkane.files.scene_files.formulas import FUNCTIONS
from rollkane.files.scene_files.tables import scene_schema

HERE = Path(__file__).parent
Schema = Mapping[str, Any]

# Where a table stands in a file -> how its section is called; kinds follow their place.
PLACES = {
    "file": "The file itself",
    "body": "`[body]`: what rolls",
    "start": "`[start]`: where it is, and how it moves",
    "run": "`[run]`: how long, how exactly",
    "modes": "`[modes]`: changes of the contact",
    "events": "`[[events]]`: what a run looks for",
    "surface": "`surface`: of body and base",
    "base": "`[base]`: what it rolls on",
    "base.motion": "`[base.motion]`: how the base moves",
    "loads": "`[[loads]]`: forces on the body",
    "contact": "`[contact]`: what holds at the contact",
    "supported": "`[[supported]]`: what the body carries",
    "rolling": "`[[rolling]]`: bodies that roll on or in the body",
    "rolling.start": "`[rolling.start]`: where such a body is",
}
# Page -> its beginning, and the places that it has.
PAGES = {
    "scene_files": ("", ("file", "body", "start", "run")),
    "scene_surfaces": (
        """# Surfaces in scene files

A `surface` stands in `[body]`, in `[base]` and in `[[rolling]]`; its `kind` says which
other fields it has. [Scene files](scene_files.md) say how a file is written,
[Surfaces](reference/surfaces.md) what each is in Python.
""",
        ("surface",),
    ),
    "scene_bases": (
        """# Bases and loads in scene files

What a body rolls on, how that moves, and which forces act:
[Scene files](scene_files.md) say how a file is written.
""",
        ("base", "base.motion", "loads", "contact"),
    ),
    "scene_changes": (
        """# Changes of the contact, and events, in scene files

How a body comes to slip, to fly and to land in a run, and what the run looks for:
[Scene files](scene_files.md) say how a file is written.
""",
        ("modes", "events"),
    ),
    "scene_parts": (
        """# What a body carries in scene files

Masses and bodies inside of the body, and bodies that roll on or in it:
[Scene files](scene_files.md) say how a file is written.
""",
        ("supported", "rolling", "rolling.start"),
    ),
}


class Place(NamedTuple):
    """A table and where it stands."""

    place: str
    kind: str  # its `kind`; empty, where there is only one
    schema: Schema


def tables(schema: Schema | None = None) -> Iterator[Place]:
    """All tables of the schema, in the order of the page."""
    schema = schema or scene_schema()
    body = _target(schema, schema["properties"]["body"])
    base = _target(schema, schema["properties"]["base"])
    rolling = _target(schema, schema["properties"]["rolling"]["items"])
    places = {
        "file": schema,
        "surface": body["properties"]["surface"],
        "base.motion": base["properties"]["motion"],
        "rolling.start": rolling["properties"]["start"],
    }
    for place in PLACES:
        given = places.get(place) or schema["properties"][place]
        given = given.get("items", given)
        if "oneOf" not in given or place == "file":
            yield Place(place, "", _target(schema, given))
        else:
            for kind, name in given["discriminator"]["mapping"].items():
                yield Place(place, kind, _target(schema, {"$ref": name}))


def _target(schema: Schema, given: Schema) -> Schema:
    """What a reference refers to, or the schema that is given."""
    name = given.get("$ref", "").rpartition("/")[2]
    return schema["$defs"][name] if name else given


def examples(place: Place) -> list[str]:
    """Examples of a table, each a part of a file."""
    given = tomllib.loads((HERE / "examples.toml").read_text())
    found = given[place.place]
    return found[place.kind] if place.kind else found


def fields(place: Place) -> list[str]:
    """Names of a table's fields, without its `kind`."""
    return [name for name in place.schema["properties"] if name != "kind"]


def type_of(field: Schema) -> str:
    """What a field takes, in words."""
    if "const" in field or "enum" in field:
        values = field.get("enum", [field.get("const")])
        return " or ".join(f"`{written(value)}`" for value in values)
    names = {
        "number": "number",
        "integer": "whole number",
        "string": "text",
        "boolean": "`true` or `false`",
        "object": "table of numbers",
    }
    if field.get("type") != "array":
        return names.get(field.get("type", ""), "table")
    size, items = field.get("minItems"), field.get("items", {})
    if items.get("type") == "array":
        inner = items.get("minItems")
        if items.get("prefixItems"):
            return "list of turns"
        return f"{size} x {inner} numbers" if size == inner else "lists"
    if items.get("type") in ("number", "string") and "enum" not in items:
        kind = {"number": "numbers", "string": "texts"}[items["type"]]
        fixed = size if size == field.get("maxItems") else None
        return f"{fixed} {kind}" if fixed else f"list of {kind}"
    return "tables" if "$ref" in items or "oneOf" in items else "list of texts"


def written(value: Any) -> str:
    """A value as TOML writes it."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, list):
        return f"[{', '.join(map(written, value))}]"
    if isinstance(value, dict):
        return "{}"
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def unit_and_meaning(description: str) -> tuple[str, str]:
    """The unit that ends in square brackets in a description, and the rest of it."""
    units = re.findall(r" \[([^\]\[\",]+)\]", description)
    if len(units) != 1 or "table" in description:
        return "", description
    return units[0], description.replace(f" [{units[0]}]", "")


CODE = re.compile(r"""\{[^{}]*\}|\[\[\w+\]\]|\[\[.*\]|\[[\w., ]*\]|"[^"]*\"""")


def row(name: str, field: Schema, *, required: bool) -> str:
    """A field as a line of its table."""
    unit, meaning = unit_and_meaning(field.get("description", ""))
    default = f"`{written(field['default'])}`" if "default" in field else "-"
    cells = [f"`{name}`", type_of(field), unit, "required" if required else default]
    meaning = CODE.sub(lambda found: f"`{found[0]}`", meaning)
    cells.append(meaning[:1].upper() + meaning[1:])
    return f"| {' | '.join(cells)} |".replace("|  |", "| |")


def section(place: Place) -> list[str]:
    """A table's fields and examples."""
    lines = []
    if place.kind:
        lines += [f'### `kind = "{place.kind}"`', ""]
    if place.place != "file":
        lines += [place.schema.get("description", ""), ""]
    known, required = place.schema["properties"], place.schema.get("required", ())
    if fields(place):
        lines += [
            "| field | takes | unit | default | meaning |",
            "|---|---|---|---|---|",
        ]
        lines += [row(x, known[x], required=x in required) for x in fields(place)]
        lines.append("")
    for text in examples(place):
        lines += ["```toml", text.strip(), "```", ""]
    return lines


def introduction() -> str:
    """The beginning of the first page."""
    text = (HERE / "introduction.md").read_text()
    told = {
        "functions": ", ".join(f"`{x}`" for x in FUNCTIONS),
        "outputs": f"{limits.MOST_OUTPUTS:,}",
        "parts": str(limits.MOST_PARTS),
        "levels": str(limits.MOST_LEVELS),
        "characters": f"{limits.MOST_CHARACTERS:,}",
    }
    for name, value in told.items():
        text = text.replace(f"{{{name}}}", value)
    return text


def pages() -> dict[str, str]:
    """Page -> its text."""
    made = {}
    for name, (beginning, places) in PAGES.items():
        lines, last = [beginning or introduction()], ""
        for place in tables():
            if place.place not in places:
                continue
            if place.place != last:
                lines += [f"## {PLACES[place.place]}", ""]
            last = place.place
            lines += section(place)
        made[name] = "\n".join(lines).rstrip() + "\n"
    return made


if __name__ == "__main__":
    for name, text in pages().items():
        (HERE.parent / f"{name}.md").write_text(text)
