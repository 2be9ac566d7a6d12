"""The reference: joint catalogue, dashes in lists of parameters, examples of commands."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

from docutils import nodes

from lierb.model.joints.joint_type import JointType

if TYPE_CHECKING:
    from sphinx.application import Sphinx


def _described(joint: JointType) -> list[str]:
    """Description of an entry, in reStructuredText."""
    rows = " ".join(map(str, joint.rows)) or "none"
    motions = f"{joint.subgroup}, a subgroup of SE(3)" if joint.subgroup else "no group"
    takes = ", ".join(f"``{name}``" for name in sorted(joint.options))
    summary = f"{joint.summary[0].upper()}{joint.summary[1:]}."
    return [
        summary, "",
        f"Rows: ``{rows}``. Motions: {motions}.{f' Also takes {takes}.' if takes else ''}", "",
    ]  # fmt: skip


def _process(
    _app: Sphinx, _what: str, _name: str, obj: Any, _options: Any, lines: list[str]
) -> None:
    if isinstance(obj, JointType):
        lines[:] = _described(obj)


def _dashed(_app: Sphinx, doctree: nodes.document) -> None:
    """Sphinx puts ` -- ` before what it says of a parameter, for smart quotes to make a dash of."""
    for field in doctree.findall(nodes.field):
        for text in list(field.findall(nodes.Text)):
            if re.match(r"\)? -- ", text):
                text.parent.replace(text, nodes.Text(text.replace("--", "–", 1)))


def _commands(_app: Sphinx, doctree: nodes.document) -> None:
    """Make code of the lines of commands in a help text; no address in one is a link."""
    for block in list(doctree.findall(nodes.line_block)):
        text = "\n".join(line.astext() for line in block.findall(nodes.line))
        if text.startswith("lierb "):
            block.replace_self(nodes.literal_block(text, text, language="console"))
    for link in list(doctree.findall(nodes.reference)):
        if link.get("refuri", "").startswith("tcp:"):
            link.replace_self(nodes.literal("", link.astext()))


def setup(app: Sphinx) -> dict[str, Any]:
    app.connect("autodoc-process-docstring", _process)
    app.connect("doctree-read", _dashed)
    app.connect("doctree-read", _commands)
    return {"parallel_read_safe": True}
