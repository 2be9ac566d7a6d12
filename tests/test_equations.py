"""From the paper to the line that runs: docs/equations.md names both, and each names the other."""

import importlib
import inspect
import re
from pathlib import Path

import pytest

PAGE = (Path(__file__).parent.parent / "docs" / "equations.md").read_text(encoding="utf-8")
TITLE = "### From the paper to the line that runs"
NAME = re.compile(r"`(lierb\.[\w.]+)`")
MUST = (
    "dexpInvSO3",
    "dexpInvSE3Park",
    "expX",
    "expSO3xR3",
    "MultDirectProduct",
    "index1",
    "Poincare1",
)


def _rows():
    """Cells of each row of the table below that title."""
    section = PAGE.partition(TITLE)[2].partition("\n#")[0]
    lines = [line for line in section.splitlines() if line.startswith("|")][2:]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


PAIRS = [
    pytest.param(of_paper, that_runs, id=f"{of_paper}-{that_runs}".replace("lierb.kernels.", ""))
    for _, textbook, running in _rows()
    for of_paper in NAME.findall(textbook)
    for that_runs in NAME.findall(running)
]


def _documented(name):
    """The docstring of a function or method, in one line."""
    holder, _, last = name.rpartition(".")
    try:
        found = getattr(importlib.import_module(holder), last)
    except ModuleNotFoundError:
        module, _, kind = holder.rpartition(".")
        found = getattr(getattr(importlib.import_module(module), kind), last)
    return " ".join(inspect.getdoc(found).split())


def _short(name):
    """A name as docstrings of neighbouring modules have it: module.function or class.method."""
    return f"`{'.'.join(name.split('.')[-2:])}`"


def test_the_table_has_the_papers_equations():
    cells = [cell for cell, _, _ in _rows()]
    assert all(any(f"`{label}`" in cell for cell in cells) for label in MUST)
    assert len(PAIRS) >= len(cells)


@pytest.mark.parametrize(("of_paper", "that_runs"), PAIRS)
def test_a_formula_and_the_one_that_runs_name_each_other(of_paper, that_runs):
    assert _short(that_runs) in _documented(of_paper)
    assert _short(of_paper) in _documented(that_runs)
