"""Entries of the joint catalogue in the reference: rows, motions and arguments of each."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from lierb.joints import JointType

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


def setup(app: Sphinx) -> dict[str, Any]:
    app.connect("autodoc-process-docstring", _process)
    return {"parallel_read_safe": True}
