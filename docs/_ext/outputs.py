"""A cell of a notebook that ends in an expression or a command has to show something."""

from __future__ import annotations

import ast
from typing import Any

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util import logging

logger = logging.getLogger(__name__)


def _parts(node: nodes.Element, name: str) -> list[nodes.Element]:
    return [part for part in node.findall(nodes.container) if part.get("nb_element") == name]


def _shall_show(code: str) -> bool:
    """Whether the last line is a command, or the last statement an expression."""
    lines = code.rstrip().splitlines()
    if lines[-1].startswith("!"):
        return True
    body = ast.parse("\n".join(line for line in lines if line[:1] not in ("!", "%"))).body
    return bool(body) and isinstance(body[-1], ast.Expr)


def _check(app: Sphinx, doctree: nodes.document) -> None:
    if app.config.nb_execution_mode == "off":
        return
    for cell in _parts(doctree, "cell_code"):
        outputs = _parts(cell, "cell_code_output")
        shown = any(x.astext().strip() or list(x.findall(nodes.image)) for x in outputs)
        source = "".join(part.astext() for part in _parts(cell, "cell_code_source"))
        if not shown and (not source or _shall_show(source)):
            logger.warning("the cell shows nothing: %s", source[-60:], location=cell)


def setup(app: Sphinx) -> dict[str, Any]:
    app.connect("doctree-read", _check)
    return {"parallel_read_safe": True}
