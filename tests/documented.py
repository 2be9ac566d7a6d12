"""numpydoc's sections of a docstring, as the tests read them."""

from __future__ import annotations

import inspect
import re
from itertools import pairwise

SECTIONS = (
    "Parameters", "Attributes", "Returns", "Raises", "Warns", "Notes", "References", "Examples",
)  # fmt: skip
HEADING = re.compile(r"^(\w[\w ]*)\n(-+)\n", re.MULTILINE)
ENTRY = re.compile(r"^(\S[^:\n]*?)(?: : (.*))?\n((?:(?:    .*)?\n)*)", re.MULTILINE)


def sections(text: str) -> dict[str, str]:
    """Text of each section by its heading; "" has what stands before the first one.

    A heading that is unknown, out of order, repeated or underlined at another length is an error.
    """
    text = inspect.cleandoc(text) + "\n"
    headings = list(HEADING.finditer(text))
    names = [heading[1] for heading in headings]
    assert names == [name for name in SECTIONS if name in names], names
    assert all(len(heading[1]) == len(heading[2]) for heading in headings), names
    starts = [0, *(heading.end() for heading in headings)]
    ends = [*(heading.start() for heading in headings), len(text)]
    return {name: text[a:b] for name, a, b in zip(["", *names], starts, ends)}


def entries(section: str) -> dict[str, tuple[str, str]]:
    """Type and description of each entry of a section, by its name."""
    found = list(ENTRY.finditer(section))
    edges = [0, *(x for entry in found for x in entry.span()), len(section)]
    between = [section[a:b] for a, b in list(pairwise(edges))[::2]]
    assert not "".join(between).strip(), f"no entries: {between}"
    listed = {entry[1]: (entry[2] or "", entry[3].strip()) for entry in found}
    assert len(listed) == len(found), "a name is listed twice"
    return listed
