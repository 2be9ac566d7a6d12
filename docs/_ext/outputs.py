"""Outputs of a notebook's cells: what they must show, what they must not, and their width.

A cell that ends in an expression or a command has to show something. No output has a path of the
machine that built the site, nor the address of an object. Long lines of text are wrapped as by a
terminal of 80 columns; tables keep their lines, and scroll.
"""

from __future__ import annotations

import ast
import re
import sys
import tempfile
import textwrap
from pathlib import Path
from typing import Any

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util import logging

logger = logging.getLogger(__name__)

COLUMNS = 80
ROOT = Path(__file__).parents[2]
MACHINE = re.compile("|".join(
    [re.escape(str(path)) for path in (ROOT, sys.prefix, tempfile.gettempdir(), Path.home())]
    + [r"ipykernel_\d", r"site-packages"]
))  # fmt: skip
ADDRESS = re.compile(r"\bat 0x[0-9a-f]{6,}")
TABLE = re.compile(r"\S(  |\t)|[│─━|]")


def unfit(text: str) -> str:
    """Return why a page must not show a text, or nothing."""
    if found := MACHINE.search(text):
        return f"an output has a path of this machine, {found[0]!r}: catch the error or warning"
    if found := ADDRESS.search(text):
        return f"an output has an object's address, {found[0]!r}: end the cell with ; or assign it"
    return ""


def wrapped(text: str) -> str:
    """Return the text with lines of at most 80 columns, but for tables and long words."""
    return "\n".join(part for line in text.split("\n") for part in _lines_of(line))


def _lines_of(line: str) -> list[str]:
    if len(line) <= COLUMNS or TABLE.search(line):
        return [line]
    indent = line[: len(line) - len(line.lstrip())]
    return textwrap.wrap(
        line, COLUMNS, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
    )


def _parts(node: nodes.Element, name: str) -> list[nodes.Element]:
    return [part for part in node.findall(nodes.container) if part.get("nb_element") == name]


def _shall_show(code: str) -> bool:
    """Whether the last line is a command, or the last statement an expression without a ;."""
    lines = code.rstrip().splitlines()
    if lines[-1].startswith("!") or (len(lines) > 1 and lines[-2].endswith("\\")):
        return True
    if lines[-1].endswith(";"):
        return False
    body = ast.parse("\n".join(line for line in lines if line[:1] not in ("!", "%"))).body
    return bool(body) and isinstance(body[-1], ast.Expr)


def _is_shell(code: str) -> bool:
    """Whether a cell has commands only, of one or more lines."""
    return all(line[:1] == "!" for line in code.replace("\\\n", " ").splitlines())


def _check(app: Sphinx, doctree: nodes.document) -> None:
    if app.config.nb_execution_mode == "off":
        return
    for cell in _parts(doctree, "cell_code"):
        outputs = _parts(cell, "cell_code_output")
        shown = any(x.astext().strip() or list(x.findall(nodes.image)) for x in outputs)
        sources = _parts(cell, "cell_code_source")
        source = "".join(part.astext() for part in sources)
        if not shown and (not source or _shall_show(source)):
            logger.warning("the cell shows nothing: %s", source[-60:], location=cell)
        for block in (x for part in sources for x in part.findall(nodes.literal_block)):
            if _is_shell(block.astext()):  # Python's lexer does not know lines that go on
                block["language"] = "bash"
        for block in (x for part in outputs for x in part.findall(nodes.literal_block)):
            text = block.astext()
            if reason := unfit(text):
                logger.warning("%s", reason, location=cell)
            block.rawsource = wrapped(text)
            block.children = [nodes.Text(block.rawsource)]


def setup(app: Sphinx) -> dict[str, Any]:
    app.connect("doctree-read", _check)
    return {"parallel_read_safe": True}
