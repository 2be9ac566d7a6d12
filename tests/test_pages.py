"""Pages as a reader meets them: code that fits, runs as printed, and shows nothing of a machine."""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from test_site import DOCUMENTED

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"
PAGES = [
    ROOT / "README.md",
    *sorted(page for page in DOCS.rglob("*.md") if not page.is_relative_to(DOCS / "_build")),
]
SCRIPTS = sorted((*DOCS.glob("gallery/*.py"), *ROOT.glob("examples/**/*.py")))
INTERNALS = {"equations.md", "architecture.md", "decisions", "deprecation.md"}  # are about the code
BLOCK = re.compile(r"^(`{3,})(\{[\w-]+\}|[a-z]*)[^\n`]*\n(.*?)^\1`*$", re.MULTILINE | re.DOTALL)
OPTION = re.compile(r"^:[\w-]+:.*\n", re.MULTILINE)
IMPORT = re.compile(r"^(?:>>> )?\s*from (lierb[\w.]*) import ([\w, ]+)", re.MULTILINE)


def _blocks(page: Path, *languages: str) -> Iterator[tuple[str, str]]:
    """Options and code of each block of a page in these languages; "" is of none."""
    for _, language, text in BLOCK.findall(page.read_text(encoding="utf-8")):
        if language in languages:
            yield "".join(OPTION.findall(text)), OPTION.sub("", text)


def _tree(code: str) -> ast.Module:
    """Python of a cell, without its commands of IPython."""
    lines, continued = [], False
    for line in code.splitlines():
        is_command = continued or line.lstrip()[:1] in ("!", "%")
        continued = is_command and line.endswith("\\")
        lines.append("pass" if is_command else line)
    return ast.parse("\n".join(lines))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_code_is_at_most_80_columns_wide(page):
    """As wide as the page's text, so that a reader need not scroll."""
    languages = ("{code-cell}", "python", "console", "sh", "toml", "")
    code = [line for _, text in _blocks(page, *languages) for line in text.splitlines()]
    assert not [line for line in code if len(line) > 80]


@pytest.mark.parametrize("file", sorted(ROOT.glob("examples/*.py")), ids=lambda file: file.name)
def test_printed_example_is_at_most_80_columns_wide(file):
    """Cells print these files, and a long line of their output would be wrapped."""
    assert not [x for x in file.read_text(encoding="utf-8").splitlines() if len(x) > 80]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_visible_cells_need_no_hidden_one(page):
    """A reader has what is printed: no variable of the build's environment, no hidden name."""
    cells = [(options, _tree(code)) for options, code in _blocks(page, "{code-cell}")]
    hidden = [tree for options, tree in cells if "remove-input" in options]
    visible = [tree for options, tree in cells if "remove-input" not in options]
    assert not {"environ", "getenv"} & _names(visible, ast.Load)
    own = _names(visible, ast.Store)
    assert not (_names(hidden, ast.Store) - own) & _names(visible, ast.Load)


def _names(trees: list[ast.Module], context: type[ast.expr_context]) -> set[str]:
    """Names and attributes that are read, or that are assigned or imported."""
    found = set()
    for node in (node for tree in trees for node in ast.walk(tree)):
        if isinstance(node, ast.Name) and isinstance(node.ctx, context):
            found.add(node.id)
        elif isinstance(node, ast.Attribute) and context is ast.Load:
            found.add(node.attr)
        elif isinstance(node, ast.alias) and context is ast.Store:
            found.add((node.asname or node.name).partition(".")[0])
    return found


@pytest.mark.parametrize("file", [*PAGES, *SCRIPTS], ids=lambda file: file.stem)
def test_code_imports_public_names_only(file):
    """Public are the names in the reference (docs/deprecation.md)."""
    text = file.read_text(encoding="utf-8")
    imported = {f"{m}.{n.strip()}" for m, names in IMPORT.findall(text) for n in names.split(",")}
    assert {name for name in imported if not name.startswith("lierb._")} <= DOCUMENTED.keys()


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_prose_names_public_names_only(page):
    if INTERNALS & {page.name, page.parent.name}:
        return
    prose = BLOCK.sub("", page.read_text(encoding="utf-8"))
    named = set(re.findall(r"`(lierb\.(?:\w+\.)+\w+)\b", prose))
    holders = tuple(f"{name}." for name in DOCUMENTED if name != "lierb")
    assert not [x for x in named if x not in DOCUMENTED and not x.startswith(holders)]


def test_every_job_is_listed():
    """On the page of jobs, on the front page's menu and in README."""
    jobs = {page.stem for page in DOCS.glob("jobs/*.md")} - {"index"}
    for page, folder in ((DOCS / "jobs/index.md", ""), (ROOT / "README.md", "docs/jobs/")):
        listed = re.findall(rf"\]\({folder}(\w+)\.md\)", page.read_text(encoding="utf-8"))
        assert jobs <= set(listed)
    menu = re.findall(r"^jobs/(\w+)$", (DOCS / "index.md").read_text(encoding="utf-8"), re.M)
    assert set(menu) == jobs | {"index"}


# ---- outputs of cells --------------------------------------------------------------------------


@pytest.fixture
def outputs(monkeypatch):
    pytest.importorskip("sphinx")
    monkeypatch.syspath_prepend(str(DOCS / "_ext"))
    import outputs

    yield outputs
    sys.modules.pop("outputs")


@pytest.mark.parametrize(
    "text",
    [
        f"File {ROOT}/lierb/methods/tableau.py:96, in __post_init__",
        "/tmp/ipykernel_1619/4101569694.py:20: LeftOutWarning: left out",
        f"{sys.prefix}/lib/python3/site-packages/numpy/linalg.py:1: RuntimeWarning",
        "[Text(0, 0.5, 'off'), [<matplotlib.axis.XTick at 0x7f66de9dd4d0>]]",
        "<function course at 0x7f66de9dd4d0>",
    ],
)
def test_output_with_a_trace_of_the_machine_is_refused(outputs, text):
    assert outputs.unfit(text)


def test_other_output_is_accepted(outputs):
    assert not outputs.unfit("results/tops: 4 of 4 parts, energy off by 0x1p-3 J at 3 s")


def test_long_lines_of_text_are_wrapped_and_tables_are_not(outputs):
    message = "    " + "pose0 does not close the loop pin " * 9
    table = "upper  reduced  " + "d1 " * 40
    rule, word = "─" * 120, "x" * 120
    lines = outputs.wrapped("\n".join([message, table, rule, word])).split("\n")
    assert lines[-3:] == [table, rule, word]
    assert max(map(len, lines[:-3])) <= 80
    assert all(line.startswith("    ") for line in lines[:-3])
    assert " ".join(" ".join(lines[:-3]).split()) == message.strip()
