"""The documentation names things that exist: code, tests, files, headings; its examples run."""

from __future__ import annotations

import ast
import doctest
import importlib
import inspect
import re
from collections import ChainMap
from pathlib import Path

import pytest
import readme
from cases import tiered

import lierb

ROOT = Path(__file__).parent.parent
BUILT = ROOT / "docs" / "_build"
PAGES = [
    *sorted(page for page in (ROOT / "docs").rglob("*.md") if not page.is_relative_to(BUILT)),
    *(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md", "bench/README.md")),
]
KERNELS = (
    "forces",
    "theory",
    "events",
    "control",
    "output",
    "derivatives",
    "fitting",
    "from_scipy",
    "from_mujoco",
    "install",
)  # have some of their own
LONG = ("control", "derivatives", "fitting", "forces", "from_scipy")  # have many
QUICK = [page for page in PAGES if page.stem not in KERNELS]
SLOW_PAGES = [page for page in PAGES if page.stem not in LONG]

SPAN = re.compile(r"`([^`\n]+)`")
NAME = re.compile(r'\b(lierb(?:\.\w+)+)(?:\["(\w+)"\])?')
TEST = re.compile(r"\b(tests/[\w/]+\.py)(?:::(\w+))?")
LINK = re.compile(r"\]\((?!\w+:)([^)\s]+)\)")  # relative ones
HEADING = re.compile(r"^#+ (.+)$", re.MULTILINE)
FENCE = re.compile(r"^```.*?^```", re.MULTILINE | re.DOTALL)


def _found(pattern: re.Pattern, group_by_span: bool = True) -> list:
    """(page, match) for everything that `pattern` finds outside code blocks."""
    params = []
    for page in PAGES:
        prose = FENCE.sub("", page.read_text(encoding="utf-8"))
        texts = SPAN.findall(prose) if group_by_span else [prose]
        unique = {match.group(): match for text in texts for match in pattern.finditer(text)}
        params += [pytest.param(page, m, id=f"{page.stem}-{m.group()}") for m in unique.values()]
    return params


def _resolved(name: str):
    """Object of a dotted name; a field without a default gives its annotation."""
    item, path = lierb, "lierb"
    for part in name.split(".")[1:]:
        path += f".{part}"
        if hasattr(item, part):
            item = getattr(item, part)
        elif isinstance(item, type):
            item = ChainMap(*map(inspect.get_annotations, item.__mro__))[part]
        else:
            item = importlib.import_module(path)
    return item


def _anchors(page: Path) -> set[str]:
    """Anchors as GitHub makes them of headings, and those written as <a id>."""
    text = page.read_text(encoding="utf-8")
    slugs = (re.sub(r"[^\w\- ]", "", h.lower()).replace(" ", "-") for h in HEADING.findall(text))
    return {*slugs, *re.findall(r'<a id="([^"]+)">', text)}


def test_pages_are_found():
    assert {"architecture.md", "equations.md", "theory.md"} <= {page.name for page in PAGES}


@pytest.mark.parametrize(("page", "match"), _found(NAME))
def test_named_object_exists(page, match):
    found = _resolved(match[1])
    if match[2] is not None:
        assert match[2] in found


@pytest.mark.parametrize(("page", "match"), _found(TEST))
def test_named_test_exists(page, match):
    source = (ROOT / match[1]).read_text(encoding="utf-8")
    names = {node.name for node in ast.parse(source).body if isinstance(node, ast.FunctionDef)}
    assert match[2] is None or match[2] in names


@pytest.mark.parametrize(("page", "match"), _found(LINK, group_by_span=False))
def test_link_leads_somewhere(page, match):
    target, _, anchor = match[1].partition("#")
    file = (page.parent / target).resolve() if target else page
    assert file.exists()
    if anchor:
        assert anchor in _anchors(file)


def _with_examples() -> list[str]:
    """Modules whose docstrings have some."""
    files = (f for f in (ROOT / "lierb").rglob("*.py") if ">>> " in f.read_text(encoding="utf-8"))
    names = (".".join(f.relative_to(ROOT).with_suffix("").parts) for f in files)
    return sorted(name.removesuffix(".__init__") for name in names)


SLOW = (  # with kernels that no quick test needs
    "lierb.analysis.fitting",
    "lierb.analysis.paper",
    "lierb.analysis.propagation_result",
    "lierb.model.forces.stiction",
    "lierb.model.functions.ground_motion",
    "lierb.model.functions.turns",
    "lierb.results.result",
    "lierb.results.states",
)
# tests/derivatives has the same with other kernels
LONG_MODULES = tuple(
    f"lierb.analysis.{name}" for name in ("adjoint", "fit_result", "many_fits", "propagation")
)
QUICK_MODULES = [name for name in _with_examples() if name not in (*SLOW, *LONG_MODULES)]


@pytest.mark.usefixtures("papers_kernels")
@pytest.mark.parametrize("name", tiered(_with_examples(), QUICK_MODULES, SLOW))
def test_examples_of_docstrings_run(name):
    outcome = doctest.testmod(importlib.import_module(name))
    assert outcome.attempted > 0
    assert outcome.failed == 0


@pytest.mark.parametrize("page", tiered(PAGES, QUICK, SLOW_PAGES), ids=lambda page: page.stem)
def test_examples_run(page):
    result = doctest.testfile(  # outputs may be wrapped
        str(page), module_relative=False, encoding="utf-8",
        optionflags=doctest.NORMALIZE_WHITESPACE,
    )  # fmt: skip
    assert result.failed == 0


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_cells_are_python(page):
    """The site runs them; its build takes minutes."""
    for cell in re.findall(r"```\{code-cell\}[^\n]*\n(.*?)\n```", page.read_text("utf-8"), re.S):
        code = re.sub(r"\A(?::[\w-]+:.*\n)+", "", cell)
        commands = r"^( *)[!%](?:.*\\\n)*.*$"  # of IPython
        ast.parse(re.sub(commands, r"\1pass", code, flags=re.M))


@pytest.mark.slow
def test_readme_examples_print_what_they_say():
    readme.run()
