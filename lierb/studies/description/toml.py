"""Write tables as the text of a study's file, with arrays on as few lines as fit 80 columns."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import tomli_w

WIDTH = 80
INDENT = "    "


def toml_of(tables: Mapping[str, Any]) -> str:
    """Return TOML of tables."""
    return "".join(f"{line}\n" for line in _compact(tomli_w.dumps(tables).split("\n")[:-1]))


def _compact(lines: list[str]) -> Iterator[str]:
    """Yield lines in which arrays, which tomli_w writes an item a line, are filled."""
    opened: list[tuple[str, list[list[str]]]] = []  # first line and items of each array
    for line in lines:
        bare = line.strip()
        if bare == "[" if opened else line.endswith(" = ["):
            opened.append((bare if opened else line, []))
            continue
        if not opened:
            yield line
            continue
        item = [bare]
        if bare in ("]", "],"):
            item = _filled(*opened.pop(), bare)
            if not opened:
                yield from item
                continue
        opened[-1][1].append(item)


def _filled(first: str, items: list[list[str]], last: str) -> list[str]:
    """Return the lines of an array: one, or items side by side; arrays in it are not mixed."""
    if all(len(item) == 1 for item in items):
        flat = [item[0] for item in items]
        one = f"{first}{' '.join(flat).removesuffix(',')}{last}"
        if len(one) <= WIDTH - len(INDENT) * (first == "["):
            return [one]
        if not flat[0].startswith(("[", "{")):
            return [first, *_side_by_side(flat), last]
    return [first, *(INDENT + line for item in items for line in item), last]


def _side_by_side(items: list[str]) -> Iterator[str]:
    line = ""
    for item in items:
        if line and len(line) + 1 + len(item) > WIDTH - len(INDENT):
            yield line
            line = ""
        line = f"{line} {item}" if line else INDENT + item
    yield line
