"""`{study-file}`: the tables and keys of a study file, out of study.schema.json."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

SCHEMA = Path(__file__).parents[1] / "study.schema.json"
WORDS = {"number": "number", "integer": "whole number", "string": "text", "boolean": "flag",
         "object": "table", "null": ""}  # fmt: skip


class StudyFile(SphinxDirective):
    """A section for each table of the file, with a table of its keys."""

    def run(self) -> list[nodes.Node]:
        self.env.note_dependency(str(SCHEMA))
        schema = json.loads(SCHEMA.read_text(encoding="utf-8"))
        return self.parse_text_to_nodes("\n".join(_lines(schema)), allow_section_headings=True)


def _lines(schema: dict[str, Any]) -> Iterator[str]:
    """Markdown."""
    for name, value in schema["properties"].items():
        if not (section := _table_of(schema, value)):
            continue
        needed = name in schema.get("required", ())
        yield from (f"## `[{name}]`", "", section.get("description", ""), "")
        yield from ("" if needed else "May be left out.", "")
        yield from _keys(section)
        for key, within in section["properties"].items():
            if inner := _table_of(schema, within.get("items", {})):
                yield from (f"### `[[{name}.{key}]]`", "", inner.get("description", ""), "")
                yield from _keys(inner)


def _table_of(schema: dict[str, Any], value: dict[str, Any]) -> dict[str, Any]:
    """The table that a value is, or may be; none for other values."""
    refs = [each["$ref"] for each in (value, *value.get("anyOf", ())) if "$ref" in each]
    return schema["$defs"][refs[0].rpartition("/")[2]] if refs else {}


def _keys(section: dict[str, Any]) -> Iterator[str]:
    yield from ("| key | value | default |", "|---|---|---|")
    required = section.get("required", ())
    for key, value in section["properties"].items():
        default = "required" if key in required else _default(value.get("default"))
        yield f"| `{key}` | {_type(value)} | {default} |"
    yield ""


def _default(value: Any) -> str:
    is_empty = value in (None, [])
    if isinstance(value, dict):
        is_empty = all(each is None for each in value.values())
    return "" if is_empty else f"`{json.dumps(value)}`"


def _type(value: dict[str, Any]) -> str:
    if "enum" in value:
        return ", ".join(f"`{json.dumps(item)}`" for item in value["enum"])
    if "anyOf" in value:
        return " or ".join(filter(None, (_type(each) for each in value["anyOf"])))
    if value.get("type") == "array":
        length = value.get("minItems") if value.get("minItems") == value.get("maxItems") else None
        inner = _type(value["items"]) if value.get("items") else "value"
        each = inner.replace("list of", "lists of") if "list of" in inner else f"{inner}s"
        each = f"rows of {inner}" if inner[:1].isdigit() else each
        return f"{length} {each}" if length else f"list of {each}"
    word = WORDS.get(value.get("type", ""), "table" if "$ref" in value else "value")
    bounds = {"exclusiveMinimum": ">", "minimum": "≥", "maximum": "≤", "exclusiveMaximum": "<"}
    said = [f"{sign} {value[key]:g}" for key, sign in bounds.items() if key in value]
    return " ".join([word, *said])


def setup(app: Sphinx) -> dict[str, Any]:
    app.add_directive("study-file", StudyFile)
    return {"parallel_read_safe": True}
