"""Run the code cells of a page in docs/jobs, one after the other, as the site does."""

from __future__ import annotations

import os
import re
from functools import cache
from pathlib import Path

import matplotlib
import matplotlib.pyplot as plt

PAGES = Path(__file__).parents[2] / "docs" / "jobs"
CELL = re.compile(r"^```\{code-cell\}.*?\n(.*?)^```", re.MULTILINE | re.DOTALL)


@cache
def names_of(page: str, folder: Path) -> dict:
    """Run a page in a folder of its own; return its names.   page : name without .md."""
    matplotlib.use("Agg")
    text = (PAGES / f"{page}.md").read_text(encoding="utf-8")
    names: dict = {"__name__": page}
    before = Path.cwd()
    os.chdir(folder)
    try:
        for cell in CELL.findall(text):
            code = "\n".join(line for line in cell.splitlines() if line[:1] not in ":!")
            exec(compile(code, f"{page}.md", "exec"), names)
    finally:
        os.chdir(before)
        plt.close("all")
    return names
