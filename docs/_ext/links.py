"""Links that lead out of docs/, and names of lierb's in pages, made into links of the site.

The pages are read in a checkout as well, where `../CONTRIBUTING.md` is a file. On the site that is
a page; any other file is offered as a download, or, where GitHub builds the site, linked to there.
"""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any

from docutils import nodes
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.transforms import SphinxTransform

DOCS = Path(__file__).parents[1]
ROOT = DOCS.parent
PAGES = {"CONTRIBUTING.md": "contributing", "CHANGELOG.md": "changelog",
         "README.md": "index", "bench/README.md": "benchmarks"}  # fmt: skip
LINK = re.compile(r"(!?\[[^\]]*\])\((?!\w+:|#|/)([^)#\s]+)(#[^)\s]*)?\)")
NAME = re.compile(r"lierb(?:\.[A-Za-z_]\w*)+")


def _repository() -> str:
    """Where files of this version are on GitHub, "" where it does not build this."""
    known = [os.environ.get(f"GITHUB_{part}", "") for part in ("SERVER_URL", "REPOSITORY", "SHA")]
    return "{}/{}/blob/{}".format(*known) if all(known) else ""


def relinked(text: str, folder: Path, page_folder: Path) -> str:
    """`text`, of a file in `folder`, as it has to stand in a page in `page_folder`."""

    def replaced(found: re.Match[str]) -> str:
        label, target, anchor = found[1], found[2], found[3] or ""
        file = (folder / target).resolve()
        if not file.is_relative_to(ROOT) or not file.exists():
            return found[0]
        inside = file.relative_to(ROOT).as_posix()
        if inside in PAGES:
            return f"{label}(/{PAGES[inside]}.md{anchor})"
        if file.is_relative_to(DOCS) or label.startswith("!"):
            return f"{label}({os.path.relpath(file, page_folder)}{anchor})"
        if repository := _repository():
            return f"{label}({repository}/{inside}{anchor})"
        return f"{label}({os.path.relpath(file, page_folder)})" if file.is_file() else label[1:-1]

    return LINK.sub(replaced, text)


def _page_read(app: Sphinx, docname: str, source: list[str]) -> None:
    folder = Path(app.env.doc2path(docname)).parent
    source[0] = relinked(source[0], folder, folder)


def _include_read(app: Sphinx, file: Path, parent: str, content: list[str]) -> None:
    if Path(file).suffix == ".md":
        page = Path(app.env.doc2path(parent)).parent
        content[0] = relinked(content[0], (DOCS / file).resolve().parent, page)


class NamesAreLinks(SphinxTransform):
    """`lierb.joints.spherical` leads to where the reference has it."""

    default_priority = 400

    def apply(self, **_options: Any) -> None:
        for node in list(self.document.findall(nodes.literal)):
            text = node.astext()
            is_linked = isinstance(node.parent, (nodes.reference, addnodes.pending_xref))
            if is_linked or not NAME.fullmatch(text):
                continue
            link = addnodes.pending_xref(
                "", node.deepcopy(), refdomain="py", reftype="obj", reftarget=text,
                refdoc=self.env.docname, refexplicit=True, refwarn=False,
            )  # fmt: skip
            node.replace_self(link)


def setup(app: Sphinx) -> dict[str, Any]:
    app.connect("source-read", _page_read)
    app.connect("include-read", _include_read)
    app.add_transform(NamesAreLinks)
    return {"parallel_read_safe": True}
