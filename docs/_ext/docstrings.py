"""Docstrings as lierb writes them, made into what Sphinx reads.

Arguments stand one a line as `name : what, unit`, short ones beside each other with three spaces
between; further lines of one are indented. A block indented on its own is code.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from itertools import groupby
from typing import TYPE_CHECKING, Any

import lierb
from lierb.joints import JointType

if TYPE_CHECKING:
    from sphinx.application import Sphinx

NAMES = r"[A-Za-z_]\w*(?:(?:,| or) [A-Za-z_]\w*)*"
ENTRY = re.compile(rf"({NAMES}) ?: (?=\S)")
BESIDE = re.compile(rf"\s{{3,}}(?={NAMES} ?: )")
ERROR = re.compile(r"(?<![\w`.])([A-Z]\w+(?:Error|Warning))\b(?!`)")
SPECIAL = re.compile(r"([*|\\])|(?<=\w)(_)(?!\w)")  # of reStructuredText, in prose


def restructured(lines: list[str]) -> list[str]:
    """The same docstring in reStructuredText."""
    out: list[str] = []
    for is_blank, group in groupby(lines, key=lambda line: not line.strip()):
        if not is_blank:
            out += [*_paragraph(list(group)), ""]
    return out


def _paragraph(lines: list[str]) -> list[str]:
    first = lines[0]
    if first.lstrip().startswith(">>>"):
        return lines
    if first.startswith("    "):
        return [".. code-block:: python", "", *lines]
    if not ENTRY.match(first):
        return [_prose(line) for line in lines]
    return [line for entry in _entries(lines) for line in entry]


def _entries(lines: list[str]) -> Iterator[list[str]]:
    """Definition lists of the arguments, and sentences that follow them."""
    entry: list[str] = []
    for line in (part for whole in lines for part in BESIDE.split(whole)):
        ends = entry and entry[-1].endswith(".") and line[:1].isupper()
        if found := ENTRY.match(line):
            if entry:
                yield [*entry, ""]
            entry = [f"``{found[1]}``", f"    {_prose(line[found.end() :])}"]
        elif ends:
            yield [*entry, ""]
            entry = [_prose(line)]
        else:
            indent = "    " if entry[0].startswith("``") else ""
            entry.append(indent + _prose(line.strip()))
    yield entry


def _prose(line: str) -> str:
    """A line with links to errors; what reStructuredText would take for markup is escaped."""
    parts = line.split("`")  # outside and inside of backticks, in turn
    for i in range(0, len(parts), 2):
        parts[i] = SPECIAL.sub(lambda m: "\\" + m[0], parts[i])
        parts[i] = ERROR.sub(_error, parts[i])
    return "`".join(parts)


def _error(found: re.Match[str]) -> str:
    name = found[1]
    return f":py:exc:`~lierb.errors.{name}`" if hasattr(lierb.errors, name) else name


def _catalogue_entry(joint: JointType) -> list[str]:
    """What an entry of the catalogue says of itself."""
    rows = " ".join(map(str, joint.rows)) or "none"
    motions = f"{joint.subgroup}, a subgroup of SE(3)" if joint.subgroup else "no group"
    takes = ", ".join(f"``{name}``" for name in sorted(joint.options))
    said = f"{joint.summary[0].upper()}{joint.summary[1:]}."
    return [
        said, "",
        f"Rows: ``{rows}``. Motions: {motions}.{f' Also takes {takes}.' if takes else ''}", "",
    ]  # fmt: skip


def _process(
    _app: Sphinx, _what: str, _name: str, obj: Any, _options: Any, lines: list[str]
) -> None:
    lines[:] = _catalogue_entry(obj) if isinstance(obj, JointType) else restructured(lines)


def setup(app: Sphinx) -> dict[str, Any]:
    app.connect("autodoc-process-docstring", _process)
    return {"parallel_read_safe": True}
